"""Subfilters of the theodolite: each excludes one source.

There is one subfilter for each source except the telescope, because a mounting shift of the telescope has the same
effect on beacons as a slip of the encoders. The subfilter without a drone gives no weight to the drone's beacon. The
subfilters without encoders or ship's attitude add an unknown change of the excluded source's error before every
sighting. These subfilters still use the rotation that this source measures between two sightings, because there is no
pointing without this rotation. No subfilter uses a source that fault detection has excluded.

Subfilters have no error budget. Each covariance is one matrix, and one sighting updates all subfilters in one step.
"""

from collections.abc import Set
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.fault_detection.subfilters import (
    FilterInnovations,
    SubfilterTable,
    subfilter_innovations,
    update_subfilters,
)
from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.integrity.protection_levels import SigmaMultipliers, sigma_multipliers
from ship_estimation.kalman.kalman_filter import LinearMeasurement, StateModel, propagate_covariance
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_kalman
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.model import ShipErrorProcess

BEACON_PREFIX = "beacon."
ENCODER = "encoder"
SHIP = "ship_attitude"
TELESCOPE = "telescope"
AXIS_SOURCES = frozenset({ENCODER, SHIP, TELESCOPE})
"""Sources that determine the predicted attitude of the telescope."""

_UNKNOWN_CHANGE_SIGMA = {ENCODER: 72_000.0 * ARCSEC, SHIP: 3600.0 * ARCSEC, TELESCOPE: 3600.0 * ARCSEC}
"""Standard deviation of the unknown change of an error between two sightings, rad.

This change covers stuck encoders of a rotating axis, a drift of the ship's attitude (its rates reveal a larger step),
and a shift of the telescope on the main axis."""

_ONLY_SOURCE = 0
"""Index of the only error source in the covariance of a subfilter."""


@dataclass(frozen=True)
class SubfilterStates:
    """States of h subfilters of n errors; each subfilter excludes one source.

    Attributes:
        time_ns: time of all subfilters; None before the first sighting or jump of the INS.
        mean: estimated errors, shape (h, n).
        covariances: covariances, shape (h, 1, n, n); the second axis is for error sources and has one entry.
        ship_covariance_n: stated covariance of the ship's error, rad², shape (3, 3); None if the messages state none.
    """

    time_ns: int | None
    mean: FloatArray
    covariances: FloatArray
    ship_covariance_n: FloatArray | None = None


@dataclass(frozen=True)
class SubfilterInnovations:
    """Innovations of one sighting of l beacons in h subfilters.

    Attributes:
        accepted: True for each subfilter in which the sighting passes the gate, shape (h,).
        beacon_nis: normalised innovation squared of each beacon, in the main filter and in every subfilter, shape (h +
            1, l).
        whitened_innovation: whitened innovation along the two axes of the detector; the third component is 0; shape
            (h + 1, l, 3).
    """

    accepted: NDArray[np.bool_]
    beacon_nis: FloatArray
    whitened_innovation: FloatArray


class _MeasurementPattern(NamedTuple):
    """Components of a sighting of l beacons, m = 2 l, that each of h subfilters uses.

    Attributes:
        uses: 1 for the components that each subfilter uses, shape (h, m).
        conditioning: 1 for the components of other beacons that condition the innovation of each beacon, in the main
            filter and in every subfilter, shape (l, h + 1, m). Without encoders or ship the attitude of the telescope
            is unknown, so a beacon can be consistent only relative to the other beacons.
        updated_states: 1 for the states that a sighting updates, which are all states, shape (h, n).
        gates: gate for the components that each subfilter uses, shape (h,).
    """

    uses: NDArray[np.uint8]
    conditioning: NDArray[np.uint8]
    updated_states: NDArray[np.uint8]
    gates: FloatArray


class AxisSubfilters(SubfilterTable):
    """Subfilters of a configuration: initial states, propagation and measurement update.

    Args:
        config: parameters of the node.
        model: states of the filter.
        ship_error: process of the ship's error.

    Attributes:
        k: sigma multipliers K of the protection levels.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel, ship_error: ShipErrorProcess) -> None:
        drones, prior = tuple(BEACON_PREFIX + id_ for id_ in config.beacons), config.integrity.prior_per_h
        prior_per_h = dict.fromkeys(drones, prior.beacon) | {ENCODER: prior.encoder, SHIP: prior.ship_attitude}
        super().__init__(drones, tuple((name,) for name in prior_per_h), prior_per_h, config.integrity)
        self.k: SigmaMultipliers = sigma_multipliers(config.integrity, self.priors_per_h)
        self._model, self._ship_error = model, ship_error
        first_axis = model.slices["axes"].start
        zero_points = first_axis + np.array([NAMES.index("g"), NAMES.index("h")])
        self._patterns: dict[tuple[tuple[str, ...], frozenset[str], float], _MeasurementPattern] = {}
        self._states = {
            ENCODER: zero_points,
            SHIP: model.state_indices("ship.attitude"),
            TELESCOPE: model.state_indices("parallelism"),
        }

    def unknown_states(self, excluded: Set[str]) -> NDArray[np.intp]:
        """Return the indices of the states that are unknown while some sources are excluded."""
        found = [self._states[name] for name in sorted(excluded & self._states.keys())]
        return np.concatenate([np.empty(0, dtype=np.intp), *found])

    def initial_states(self, mean: FloatArray, covariance: FloatArray) -> SubfilterStates:
        """Return the initial states of all subfilters, equal to the state of the main filter."""
        return self.restart_from_estimate(SubfilterStates(None, mean, covariance), mean, covariance)

    def restart_from_estimate(
        self, subfilters: SubfilterStates, mean: FloatArray, covariance: FloatArray
    ) -> SubfilterStates:
        """Restart all subfilters from one mean, shape (n,), and covariance, shape (n, n)."""
        count = len(self.names)
        parts = np.broadcast_to(covariance, (count, 1, *covariance.shape)).copy()
        return replace(subfilters, mean=np.tile(mean, (count, 1)), covariances=parts)

    def propagate(
        self, subfilters: SubfilterStates, time_ns: int, new_ship_covariance_n: FloatArray | None
    ) -> SubfilterStates:
        """Propagate the subfilters to a later time; for the arguments see ``CalibrationFilter.propagate``."""
        dt_s = 0.0 if subfilters.time_ns is None else max(time_ns - subfilters.time_ns, 0) * 1e-9
        decay, noise = self._model.transition(dt_s)
        mean, ship, count = decay * subfilters.mean, self._ship_error.columns, len(subfilters.mean) + 1
        parts = propagate_covariance(subfilters.covariances[:, 0], decay, noise, self._model.source_of, count)[:, None]
        mean[:, ship] = self._ship_error.propagate(subfilters.mean[:, ship], decay[ship])
        self._ship_error.apply_stated_covariance(
            mean, parts, decay[ship], subfilters.ship_covariance_n, new_ship_covariance_n, _ONLY_SOURCE
        )
        later_ns = time_ns if subfilters.time_ns is None else max(time_ns, subfilters.time_ns)
        return SubfilterStates(later_ns, mean, parts, new_ship_covariance_n)

    def inflate_covariance(
        self, subfilters: SubfilterStates, states: NDArray[np.intp], covariance: FloatArray
    ) -> SubfilterStates:
        """Inflate the covariance of some states in every subfilter by the covariance of a jump."""
        parts = subfilters.covariances.copy()
        parts[..., states[:, None], states] += covariance
        return replace(subfilters, covariances=parts)

    def add_unknown_errors(self, subfilters: SubfilterStates, excluded: Set[str]) -> SubfilterStates:
        """Add to each subfilter, before a sighting, the unknown error changes of its source and of ``excluded``."""
        parts = subfilters.covariances.copy()
        for row, source in enumerate(self.names):
            self.add_unknown_changes(parts[row], _ONLY_SOURCE, {source, *excluded})
        return replace(subfilters, covariances=parts)

    def add_unknown_changes(self, parts: FloatArray, source_index: int, excluded: Set[str]) -> None:
        """Add the unknown error changes of sources to a covariance by source, in place, shape (n_sources, n, n).

        Correlations with the other states are kept. Independent errors at every sighting would be wrong, because a
        constant error would then seem known to sigma / sqrt(sightings).
        """
        for name in excluded & self._states.keys():
            parts[source_index, self._states[name], self._states[name]] += _UNKNOWN_CHANGE_SIGMA[name] ** 2

    def _pattern(self, names: tuple[str, ...], excluded: frozenset[str], probability: float) -> _MeasurementPattern:
        """Return the pattern for beacons with these names, which is created once."""
        key = names, excluded, probability
        if key in self._patterns:
            return self._patterns[key]
        unknown = excluded & self._states.keys()
        has_unknown_states = [bool(unknown), *(bool(unknown) or source in self._states for source in self.names)]
        uses = np.ones((self.count, 2 * len(names)), dtype=bool)
        for light, name in enumerate(names):
            uses[self.subfilter_of(BEACON_PREFIX + name), 2 * light : 2 * light + 2] = False
        # Components of the other beacons for each beacon, shape (l, 1, m).
        others = ~np.repeat(np.eye(len(names), dtype=bool), 2, axis=1)[:, None]
        conditioning = uses & np.array(has_unknown_states)[:, None] & others
        degrees = np.count_nonzero(uses[1:], axis=1).tolist()
        pattern = self._patterns[key] = _MeasurementPattern(
            uses=uses[1:].astype(np.uint8),
            conditioning=conditioning.astype(np.uint8),
            updated_states=np.ones((len(self.names), self._model.size), dtype=np.uint8),
            gates=np.array([chi_square_gate(probability, count) if count else np.inf for count in degrees]),
        )
        return pattern

    def update_by_beacons(
        self,
        subfilters: SubfilterStates,
        names: tuple[str, ...],
        measurement: LinearMeasurement,
        main_filter: tuple[FloatArray, FloatArray],
        excluded: Set[str],
        probability: float,
    ) -> tuple[SubfilterStates, SubfilterInnovations]:
        """Update each subfilter whose gate the sighting of beacons passes; return the subfilters and all innovations.

        Args:
            subfilters: subfilters, propagated to the time of the sighting.
            names: names of the beacons, without beacons of excluded drones.
            measurement: measurement with two components for each beacon and the residual of the main filter.
            main_filter: propagated mean of the main filter, shape (n,), and covariance of its residual, shape (m, m).
            excluded: excluded sources, which no subfilter uses.
            probability: probability of the gate.
        """
        pattern = self._pattern(names, frozenset(excluded), probability)
        parts = np.ascontiguousarray(subfilters.covariances[:, 0])
        residual, gain, nis, whitened_innovation = compiled_kalman.beacon_innovations(
            subfilters.mean - main_filter[0],
            parts,
            measurement.residual,
            measurement.jacobian,
            measurement.noise,
            main_filter[1],
            pattern.uses,
            pattern.conditioning,
        )
        accepted = nis <= pattern.gates  # NaN is rejected
        gain[~accepted] = 0.0
        corrections, updated = compiled_kalman.update(
            parts,
            measurement.jacobian,
            residual,
            gain,
            pattern.updated_states,
            ((_ONLY_SOURCE, measurement.noise),),
            measurement.noise,
        )
        mean = subfilters.mean + corrections
        beacon_nis = np.einsum("hlk,hlk->hl", whitened_innovation, whitened_innovation)
        return replace(subfilters, mean=mean, covariances=updated[:, None]), SubfilterInnovations(
            accepted, beacon_nis, whitened_innovation
        )

    def update_by_stars(
        self,
        subfilters: SubfilterStates,
        measurement: LinearMeasurement,
        main_mean: FloatArray,
        rotation_jacobian: FloatArray,
        probability: float,
    ) -> SubfilterStates:
        """Update each subfilter with an exposure of stars if the exposure passes the gate of that subfilter.

        No subfilter excludes the stars, because the many stars of an exposure are checked against one another.

        Args:
            subfilters: subfilters, propagated to the time of the exposure.
            measurement: measurement of the stars with the residual of the main filter.
            main_mean: propagated mean of the main filter, shape (n,).
            rotation_jacobian: derivative of the residual with respect to a rotation of the camera, shape (m, 3).
            probability: probability of the gate.
        """
        stack = subfilters.covariances[:, 0]
        innovations = subfilter_innovations(subfilters.mean, stack, measurement, main_mean, rotation_jacobian)
        accepted = innovations.nis <= chi_square_gate(probability, len(measurement.residual))  # NaN is rejected
        updated_states = np.repeat(accepted[:, None], self._model.size, axis=1)
        # Subfilters have no error budget, so all noise is assigned to one source.
        without_budget = LinearMeasurement(
            measurement.residual, measurement.jacobian, {_ONLY_SOURCE: measurement.noise}
        )
        corrections, stack = update_subfilters(stack, without_budget, innovations, updated_states)
        return replace(subfilters, mean=subfilters.mean + corrections, covariances=stack[:, None])


def beacon_innovation(residual: FloatArray, covariance: FloatArray, noise: FloatArray) -> FilterInnovations:
    """Return the innovation of one beacon in one filter; the whitened innovation is along the axes of the detector.

    Args:
        residual: residual of the beacon's point, m, shape (2,).
        covariance: covariance of the residual, shape (2, 2).
        noise: part of ``covariance`` from the noise of the sighting, shape (2, 2).
    """
    # The root is the inverse symmetric root of the covariance.
    (first, mixed), (_, second) = covariance
    area = np.sqrt(first * second - mixed * mixed)
    scale = 1.0 / (area * np.sqrt(first + second + 2.0 * area))
    root = np.array([[(second + area) * scale, -mixed * scale], [-mixed * scale, (first + area) * scale]])
    whitened_innovation, whitened_noise = np.zeros((1, 3)), np.eye(3)
    whitened_innovation[0, :2], whitened_noise[:2, :2] = root @ residual, root @ noise @ root
    nothing = np.empty(0)
    return FilterInnovations(
        residual[None],
        covariance[None],
        np.sum(whitened_innovation**2, axis=-1),
        nothing,
        whitened_innovation,
        whitened_noise,
        nothing,
    )

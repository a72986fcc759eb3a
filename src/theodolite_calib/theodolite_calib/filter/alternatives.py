"""The estimates that do without one source each, beside the estimate by all of them.

One row for each source but the telescope: to the lights its knock is what a slip of the encoders is, and the estimate
before it goes on. A row without a drone gives its light no weight. A row without the encoders, or without the
ship's attitude, lets their error change by an unknown amount before every sighting: what they say of the turn from one
sighting to the next is used, or there would be no pointing between them. A source that is excluded is left out of every
row.

The rows have no error budget: their covariance is one matrix, and a sighting changes all of them in one step.
"""

from collections.abc import Set
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_steps
from ship_estimation.gates import chi_square_gate
from ship_estimation.hypotheses import RowsCompared, compare_rows, update_rows
from ship_estimation.kalman import LinearMeasurement, StateModel, predict
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.chain.axes import NAMES
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter import compiled_rows
from theodolite_calib.filter.model import ShipErrorProcess

BEACON = "beacon."
ENCODER = "encoder"
SHIP = "ship_attitude"
TELESCOPE = "telescope"
CHAIN = frozenset({ENCODER, SHIP, TELESCOPE})
"""What leads from the horizon to the telescope."""

_UNKNOWN = {ENCODER: 72_000.0 * ARCSEC, SHIP: 3600.0 * ARCSEC, TELESCOPE: 3600.0 * ARCSEC}
"""Standard deviation of the unknown change of an error from one sighting to the next: of encoders that stood still
while the axis turned; of a ship's attitude that crept away, for its rates tell a larger step; of a telescope that was
knocked on the main axis."""
_ONLY_SOURCE = 0


@dataclass(frozen=True)
class Alternatives:
    """The estimates without one source each; h rows of n states.

    Attributes:
        time_ns: moment of all of them; None before the first sighting.
        mean: shape (h, n).
        parts: covariance, as the only part of itself, shape (h, 1, n, n).
        ship_steady_n: stated covariance that the ship's error follows, rad², shape (3, 3); None where none is stated.
    """

    time_ns: int | None
    mean: FloatArray
    parts: FloatArray
    ship_steady_n: FloatArray | None = None


@dataclass(frozen=True)
class RowsSeen:
    """What the rows see of one sighting.

    Attributes:
        accepted: whether what each row uses of it passes the gate, shape (h,).
        light_nis: normalised innovation squared of each light, in the estimate by all sources and in every row, shape
            (h + 1, l).
        light_turn: its residual whitened, along the axes of the detector and 0, shape (h + 1, l, 3).
    """

    accepted: NDArray[np.bool_]
    light_nis: FloatArray
    light_turn: FloatArray


class _Pattern(NamedTuple):
    """Which components of the lights each row sees; h rows, l lights, m = 2 l components.

    Attributes:
        sees: shape (h, m).
        known: the components of other lights that are taken as known where a light is looked at: in the estimate by all
            sources and in every row, shape (l, h + 1, m). To a row of which the encoders or the ship are unknown a
            light alone says nothing, but beside the others it does.
        learns: all states of every row, shape (h, n).
        gates: of what each row sees, shape (h,).
    """

    sees: NDArray[np.uint8]
    known: NDArray[np.uint8]
    learns: NDArray[np.uint8]
    gates: FloatArray


class SourceRows:
    """Steps of the rows of a configuration.

    Args:
        config: the node's parameters.
        model: states of the filter.
        ship_error: how the ship's error evolves.

    Attributes:
        sources: the source that each row does without: the drones, the encoders, the ship's attitude.
        beacons: ids of the drones.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel, ship_error: ShipErrorProcess) -> None:
        self.beacons = tuple(config.beacons)
        self.sources = (*(BEACON + id_ for id_ in self.beacons), ENCODER, SHIP)
        self._model, self._ship_error = model, ship_error
        first_axis = model.slices["axes"].start
        zero_points = first_axis + np.array([NAMES.index("g"), NAMES.index("h")])
        self._patterns: dict[tuple[tuple[str, ...], frozenset[str], float], _Pattern] = {}
        self._states = {
            ENCODER: zero_points,
            SHIP: model.rows("ship.attitude"),
            TELESCOPE: model.rows("parallelism"),
        }

    def states_of(self, excluded: Set[str]) -> NDArray[np.intp]:
        """The states of which nothing is known while some sources are excluded."""
        found = [self._states[name] for name in sorted(excluded & self._states.keys())]
        return np.concatenate([np.empty(0, dtype=np.intp), *found])

    def start(self, mean: FloatArray, covariance: FloatArray) -> Alternatives:
        """All rows as the estimate by all sources."""
        return self.restarted(Alternatives(None, mean, covariance), mean, covariance)

    def restarted(self, rows: Alternatives, mean: FloatArray, covariance: FloatArray) -> Alternatives:
        """All rows from one estimate on, shapes (n,), (n, n)."""
        count = len(self.sources)
        parts = np.broadcast_to(covariance, (count, 1, *covariance.shape)).copy()
        return replace(rows, mean=np.tile(mean, (count, 1)), parts=parts)

    def predicted(self, rows: Alternatives, time_ns: int, ship_now_n: FloatArray | None) -> Alternatives:
        """The rows carried to a later moment; arguments as of ``CalibrationFilter.predicted``."""
        dt_s = 0.0 if rows.time_ns is None else max(time_ns - rows.time_ns, 0) * 1e-9
        decay, noise = self._model.transition(dt_s)
        mean, ship, of_no_budget = decay * rows.mean, self._ship_error.columns, len(rows.mean) + 1
        parts = predict(rows.parts[:, 0], decay, noise, self._model.source_of, of_no_budget)[:, None]
        mean[:, ship] = self._ship_error.later(rows.mean[:, ship], decay[ship])
        mean, parts, _ = self._ship_error.carried(
            mean, parts, ship, decay[ship], rows.ship_steady_n, ship_now_n, _ONLY_SOURCE
        )
        later_ns = time_ns if rows.time_ns is None else max(time_ns, rows.time_ns)
        return Alternatives(later_ns, mean, parts, ship_now_n)

    def opened(self, rows: Alternatives, states: NDArray[np.intp], covariance: FloatArray) -> Alternatives:
        """The rows after a jump of some states by as much as a covariance says."""
        parts = rows.parts.copy()
        parts[..., states[:, None], states] += covariance
        return replace(rows, parts=parts)

    def unknown(self, rows: Alternatives, excluded: Set[str]) -> Alternatives:
        """The rows before a sighting: the errors of the sources that they do without may have changed by any amount."""
        parts = rows.parts.copy()
        for row, source in enumerate(self.sources):
            for name in {source, *excluded} & self._states.keys():
                add_unknown_change(parts[row], self._states[name], _ONLY_SOURCE, _UNKNOWN[name])
        return replace(rows, parts=parts)

    def with_unknown(self, parts: FloatArray, source_index: int, excluded: Set[str]) -> FloatArray:
        """The same for covariance parts (n_sources, n, n) of the estimate by all sources that are not excluded."""
        parts = parts.copy()
        for name in sorted(excluded & self._states.keys()):
            add_unknown_change(parts, self._states[name], source_index, _UNKNOWN[name])
        return parts

    def _pattern(self, names: tuple[str, ...], excluded: frozenset[str], probability: float) -> "_Pattern":
        """What each row sees of lights with these names; made once for all sightings of them."""
        key = names, excluded, probability
        if key not in self._patterns:
            self._patterns[key] = self._new_pattern(names, excluded, probability)
        return self._patterns[key]

    def _new_pattern(self, names: tuple[str, ...], excluded: frozenset[str], probability: float) -> "_Pattern":
        unknown = excluded & self._states.keys()
        unknown_rows = [bool(unknown), *(bool(unknown) or source in self._states for source in self.sources)]
        sees = np.ones((1 + len(self.sources), 2 * len(names)), dtype=bool)
        for light, name in enumerate(names):
            sees[1 + self.sources.index(BEACON + name), 2 * light : 2 * light + 2] = False
        # Of each light, the components of the others: shape (l, 1, m).
        others = ~np.repeat(np.eye(len(names), dtype=bool), 2, axis=1)[:, None]
        known = sees & np.array(unknown_rows)[:, None] & others
        degrees = np.count_nonzero(sees[1:], axis=1).tolist()
        return _Pattern(
            sees=sees[1:].astype(np.uint8),
            known=known.astype(np.uint8),
            learns=np.ones((len(self.sources), self._model.size), dtype=np.uint8),
            gates=np.array([chi_square_gate(probability, count) if count else np.inf for count in degrees]),
        )

    def seen(
        self,
        rows: Alternatives,
        names: tuple[str, ...],
        measurement: LinearMeasurement,
        first: tuple[FloatArray, FloatArray],
        excluded: Set[str],
        probability: float,
    ) -> tuple[Alternatives, RowsSeen]:
        """The rows after a sighting, and what they see of it.

        Args:
            rows: predicted to its moment.
            names: of its lights, none of them of a drone that is excluded.
            measurement: with two components for each light; its residual is that of the estimate by all sources.
            first: mean of that estimate, predicted, shape (n,), and the covariance of its residual, shape (m, m).
            excluded: the sources that every row does without.
            probability: of the gate.
        """
        pattern, parts = self._pattern(names, frozenset(excluded), probability), np.ascontiguousarray(rows.parts[:, 0])
        residual, gain, nis, light_turn = compiled_rows.rows_seen(
            rows.mean - first[0],
            parts,
            measurement.residual,
            measurement.jacobian,
            measurement.noise,
            first[1],
            pattern.sees,
            pattern.known,
        )
        accepted = nis <= pattern.gates  # NaN is not
        gain[~accepted] = 0.0
        corrections, updated = compiled_steps.updated(
            parts,
            measurement.jacobian,
            residual,
            gain,
            pattern.learns,
            ((_ONLY_SOURCE, measurement.noise),),
            measurement.noise,
        )
        mean = rows.mean + corrections
        light_nis = np.einsum("hlk,hlk->hl", light_turn, light_turn)
        return replace(rows, mean=mean, parts=updated[:, None]), RowsSeen(accepted, light_nis, light_turn)


    def seen_stars(
        self,
        rows: Alternatives,
        measurement: LinearMeasurement,
        first_mean: FloatArray,
        by_turn: FloatArray,
        probability: float,
    ) -> Alternatives:
        """The rows after an exposure of stars: each that the stars fit learns of them.

        No row does without stars: a fault of them is told by themselves, which are many.

        Args:
            rows: predicted to its moment.
            measurement: the stars; its residual is that of the estimate by all sources.
            first_mean: of that estimate, predicted, shape (n,).
            by_turn: derivative of the residual by a turn of the camera, shape (m, 3).
            probability: of the gate.
        """
        stack = rows.parts[:, 0]
        compared = compare_rows(rows.mean, stack, measurement, first_mean, by_turn)
        accepted = compared.nis <= chi_square_gate(probability, len(measurement.residual))  # NaN is not
        learns = np.repeat(accepted[:, None], self._model.size, axis=1)
        # The rows have no budget: all noise is the only part of each.
        of_no_budget = LinearMeasurement(measurement.residual, measurement.jacobian, {_ONLY_SOURCE: measurement.noise})
        corrections, stack = update_rows(stack, of_no_budget, compared, learns)
        return replace(rows, mean=rows.mean + corrections, parts=stack[:, None])


def add_unknown_change(parts: FloatArray, states: NDArray[np.intp], source_index: int, sigma_rad: float) -> None:
    """Add to the covariance what states may have changed since the last sighting, in parts of shape (n_sources, n, n).

    The correlations with the other states stay. Were the states drawn again at every sighting, an error that stays
    would count as so many independent ones: their mean would seem known to sigma / sqrt(sightings).
    """
    parts[source_index, states, states] += sigma_rad**2


def light_compared(residual: FloatArray, covariance: FloatArray, noise: FloatArray) -> RowsCompared:
    """A light beside one estimate; what it turns is told along the axes of the detector.

    Args:
        residual: shape (2,).
        covariance: of the residual, shape (2, 2).
        noise: share of the sighting's own noise in it, shape (2, 2).
    """
    root = _whitening(covariance)
    turn, turn_noise = np.zeros((1, 3)), np.eye(3)
    turn[0, :2], turn_noise[:2, :2] = root @ residual, root @ noise @ root
    nothing = np.empty(0)
    return RowsCompared(residual[None], covariance[None], np.sum(turn**2, axis=-1), nothing, turn, turn_noise, nothing)


def _whitening(covariance: FloatArray) -> FloatArray:
    """The inverse of the symmetric root of covariances of two components, shape (..., 2, 2)."""
    first, second, mixed = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    area = np.sqrt(first * second - mixed * mixed)
    scale = 1.0 / (area * np.sqrt(first + second + 2.0 * area))
    root = np.empty(covariance.shape)
    root[..., 0, 0], root[..., 1, 1] = (second + area) * scale, (first + area) * scale
    root[..., 0, 1] = root[..., 1, 0] = -mixed * scale
    return root

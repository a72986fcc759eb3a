"""Pointings at encoder readings with their protection levels, from a filter state and the ship's attitude.

One function computes both the single pointing of a live node and the pointings of a batch. The protection levels follow
from the solution separations of the subfilters (:mod:`ship_estimation.integrity.protection_levels`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.integrity.protection_levels import (
    IntegrityReport,
    alert_limit_text,
    integrity_report,
    protection_levels,
    separation_inflation,
)
from ship_estimation.rejection_rules import Rejection, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation, rotation_from_angles
from ship_geometry.mount.axes import DEFORMATION, SHIP
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_pointing
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import (
    SOURCE_DEFORMATION,
    SOURCE_ENCODER,
    SOURCE_SAVED,
    SOURCE_SHIP,
    SOURCE_SHIP_NOISE,
    axis_state_indices,
    ship_error_steps,
)
from theodolite_calib.filter.subfilters import BEACON_PREFIX
from theodolite_calib.samples.samples import EncoderSample, Mode, PointingEstimate
from theodolite_calib.samples.tracks import ShipAt

QUANTITIES = ("azimuth_cos_elevation", "elevation", "image_rotation")
"""Quantities bounded by the protection levels."""

_NO_STEP = np.empty((0, 3)), np.empty((0, 3, 3))
"""Empty factors and added covariances, if the ship's error has no step."""

_TWO_LIGHTS, _ONE_LIGHT, _ENCODER = int(Mode.TWO_LIGHTS), int(Mode.ONE_LIGHT), int(Mode.ENCODER)
_STARS, _STARS_AND_LIGHTS = int(Mode.STARS), int(Mode.STARS_AND_LIGHTS)


class PointingLevels:
    """Protection levels of pointings from one state of the filter; created once per state.

    Args:
        filter_: filter with its model.
        config: parameters of the node.
        state: state of the filter, also an attribute.
    """

    def __init__(self, filter_: CalibrationFilter, config: OpticalAxisConfig, state: CalibrationState) -> None:
        self.state, self._config = state, config.integrity
        sources, self._multipliers = filter_.subfilters.names, filter_.subfilters.k
        self._axis_indices = axis_state_indices(filter_.model)
        excluded = {name: one.since_ns for name, one in state.fault_state.excluded.items()}
        self._subfilter_indices = np.array(
            [row for row, name in enumerate(sources) if name not in excluded], dtype=np.intp
        )
        self._names = tuple([sources[row] for row in self._subfilter_indices])
        self._excluded = tuple(sorted(excluded.items()))
        self._has_unresolved_fault = state.fault_state.unresolved_fault is not None or state.consecutive_rejections > 0

    def integrity_of(self, estimate: PointingEstimate) -> IntegrityReport:
        """Return the integrity of a pointing."""
        azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm).tolist()
        to_angles = angle_errors_from_rotation_vector(azimuth, elevation)
        to_angles[0] *= math.cos(elevation)
        # The levels already include the separations. Errors besides the state, such as the noise of the encoders, are
        # equal in every subfilter.
        result = protection_levels(
            self._multipliers,
            self._subfilter_indices,
            self._axis_indices,
            (to_angles, to_angles @ estimate.by_error_n, estimate.covariance_without_separation_n),
            self.state.mean,
            self.state.subfilters.mean,
            self.state.covariance_by_source,
            self.state.subfilters.covariances[:, 0],
        )
        # Encoders and ship's attitude are unchecked without beacons and stars, and so are stars alone.
        mode, status = estimate.mode, estimate.status
        is_by_unchecked = mode is Mode.ENCODER or (mode is Mode.STARS and status is Status.DEGRADED)
        is_unchecked = self._has_unresolved_fault or is_by_unchecked or status is Status.INVALID
        return integrity_report(
            estimate.time_ns,
            self._config,
            self._multipliers,
            self._names,
            result,
            self._excluded,
            is_checked=not is_unchecked,
        )


class PendingPointing(NamedTuple):
    """Encoder reading with the ship's attitude at its time: the inputs of a pointing.

    Attributes:
        sample: the reading.
        ship: ship's attitude at the time of the reading.
        unconfirmed_reason: reason why encoders or ship's attitude are unconfirmed; empty if both are confirmed.
        unconfirmed_sigma_rad: additional standard deviation of each angle while unconfirmed, rad.
        state: state of the filter after the last applied exposure.
    """

    sample: EncoderSample
    ship: ShipAt
    unconfirmed_reason: str
    unconfirmed_sigma_rad: float
    state: CalibrationState

    @property
    def time_ns(self) -> int:
        """Stamp of the reading."""
        return self.sample.time_ns


class AxesAt(NamedTuple):
    """Main axis at N times.

    Attributes:
        rotation_nm: horizon from main frame, shape (N, 3, 3).
        by_error_n: derivative of the main axis' rotation vector in n with respect to ``AXIS_STATES``, shape (N, 3, k).
        covariance_by_source_n: error covariance of the main axis by source, rotation vector in n, rad², shape (N,
            n_sources, 3, 3).
        time_ns: the times in ascending order, shape (N,).
        rotation_dm: as in :class:`PointingEstimate`, shape (N, 3, 3).
    """

    rotation_nm: FloatArray
    by_error_n: FloatArray
    covariance_by_source_n: FloatArray
    time_ns: StampArray
    rotation_dm: FloatArray


class CorrectedAxis:
    """Main axis corrected by one filter state; created once per state, used at the encoder's rate.

    Only the states that rotate the main axis (:data:`theodolite_calib.filter.model.AXIS_STATES`) are propagated.

    Args:
        filter_: filter with its model.
        state: state of the filter after the last sighting.

    Attributes:
        state: state of the filter after the last sighting.
        rotation_mt: main frame from telescope, shape (3, 3).
        separation_inflation: covariance added to the propagated states by the solution separations, shape (k, k).
        statuses: status and reason of pointings from this state, by mode and status of the ship's attitude.
    """

    def __init__(self, filter_: CalibrationFilter, state: CalibrationState) -> None:
        self.state = state
        self.statuses: dict[tuple[int, Status], tuple[Status, str]] = {}
        model, rows = filter_.model, axis_state_indices(filter_.model)
        ship, deformation = model.blocks["ship.attitude"], model.blocks["deformation"]
        self._parts = np.ascontiguousarray(state.covariance_by_source[:, rows[:, None], rows])
        self._errors = filter_.sightings.geometry_errors(state.mean)
        self._exceeds_model = np.zeros(DEFORMATION.stop, dtype=np.uint8)
        self._exceeds_model[SHIP] = filter_.ship_error.exceeds_model(self._errors[SHIP])
        self._time_s = np.concatenate([ship.time_s, deformation.time_s])
        self._stationary_covariance = np.array([np.diag(ship.sigma**2), np.diag(deformation.sigma**2)])
        if state.ship_covariance_n is not None:
            self._stationary_covariance[0] += state.ship_covariance_n
        self._sources = tuple(
            model.sources.index(source)
            for source in (SOURCE_SHIP, SOURCE_DEFORMATION, SOURCE_ENCODER, SOURCE_SHIP_NOISE)
        )
        self.rotation_mt = rotation_from_angles(*filter_.sightings.parallelism(state.mean)).T.copy()
        self.separation_inflation = separation_inflation(
            (state.subfilters.mean - state.mean)[:, rows], state.solution_separation
        )

    def axes(self, readings: Sequence[PendingPointing]) -> AxesAt:
        """Return the main axis at N readings; for readings before the state's time, the state is not propagated.

        The result depends only on the arguments and the state. A reading alone and a reading among others give equal
        results to the last bit.

        Args:
            readings: readings in ascending order, all with a stated covariance of the ship's attitude, or all without.
        """
        samples, ships = [one.sample for one in readings], [one.ship for one in readings]
        time_ns = np.array([sample.time_ns for sample in samples])
        since_ns = np.zeros_like(time_ns) if self.state.time_ns is None else time_ns - self.state.time_ns
        stated_n = [ship.correlated_covariance_n for ship in ships if ship.correlated_covariance_n is not None]
        step = ship_error_steps(self.state.ship_covariance_n, np.array(stated_n)) if stated_n else None
        rotation_nm, by_error_n, covariance_by_source_n = compiled_pointing.pointings(
            since_ns,
            np.array([ship.rotation_nd for ship in ships]),
            np.array([ship.rate_d for ship in ships]),
            np.array([ship.noise for ship in ships]),
            np.array([sample.vector for sample in samples]),
            np.array([one.sample.sigma**2 + one.unconfirmed_sigma_rad**2 for one in readings]),
            *(_NO_STEP if step is None else (step.retained, step.added_n)),
            self._errors,
            self._exceeds_model,
            self._time_s,
            self._stationary_covariance,
            self._parts,
            *self._sources,
        )
        chords_nd = [ship.chord_nd for ship in ships if ship.chord_nd is not None]
        if chords_nd:
            rotation_dm = np.array(chords_nd).swapaxes(1, 2) @ rotation_nm
        else:
            rotation_dm = np.full((len(time_ns), 3, 3), np.nan)
        return AxesAt(rotation_nm, by_error_n, covariance_by_source_n, time_ns, rotation_dm)


@dataclass(frozen=True)
class PointingSeries:
    """Pointings of the main axis at N times in ascending order, from one state.

    The fields have the meaning of :class:`PointingEstimate`, with a leading axis of N except for ``state``.
    """

    time_ns: StampArray
    rotation_nm: FloatArray
    covariance_by_source_n: FloatArray
    covariance_n: FloatArray
    covariance_without_separation_n: FloatArray
    rotation_nt: FloatArray
    mode: NDArray[np.int64]
    status: list[Status]
    light_count: NDArray[np.int64]
    state: CalibrationState = field(repr=False)
    text: list[str]
    by_error_n: FloatArray
    rotation_dm: FloatArray

    def subset(self, indices: slice) -> "PointingSeries":
        """Return a slice of the series."""
        values = {name: value if name == "state" else value[indices] for name, value in vars(self).items()}
        return PointingSeries(**values)

    def estimate(self, index: int) -> PointingEstimate:
        """Return one pointing of the series."""
        return PointingEstimate(
            time_ns=int(self.time_ns[index]),
            rotation_nm=self.rotation_nm[index],
            covariance_by_source_n=self.covariance_by_source_n[index],
            covariance_n=self.covariance_n[index],
            covariance_without_separation_n=self.covariance_without_separation_n[index],
            rotation_nt=self.rotation_nt[index],
            mode=Mode(self.mode[index]),
            status=self.status[index],
            light_count=int(self.light_count[index]),
            state=self.state,
            text=self.text[index],
            by_error_n=self.by_error_n[index],
            rotation_dm=self.rotation_dm[index],
        )


class PointingOutput:
    """Computes pointings from states of a filter; each pointing depends only on the arguments of the call.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._config, self._filter = config, filter_
        self._recent_ns = round(config.lights_recent_s * SECOND_NS)
        self._corrected: CorrectedAxis | None = None
        self._levels: PointingLevels | None = None
        self._saved = filter_.model.sources.index(SOURCE_SAVED)
        self._disagreement_source = filter_.model.sources.index(SOURCE_SHIP)

    def compute_pending(self, pending: Sequence[PendingPointing]) -> list[tuple[slice, PointingSeries | Rejection]]:
        """Compute pending pointings; return slices of ``pending``, each with its series or its failure."""
        found: list[tuple[slice, PointingSeries | Rejection]] = []
        for _, group in groupby(pending, key=lambda one: (id(one.state), one.ship.correlated_covariance_n is None)):
            group_pointings, start = list(group), found[-1][0].stop if found else 0
            series = self._series_or_failure(group_pointings)
            if isinstance(series, PointingSeries):
                found.append((slice(start, start + len(group_pointings)), series))
            else:
                # Each pointing is computed singly, so that a failure affects no other pointing.
                single_pointings = enumerate(map(self._series_or_failure, ([one] for one in group_pointings)), start)
                found += [(slice(number, number + 1), one) for number, one in single_pointings]
        return found

    def _series_or_failure(self, pending: Sequence[PendingPointing]) -> PointingSeries | Rejection:
        try:
            return self.series(pending)
        except Exception as error:
            return failure_rejection(error)

    def estimate(self, pending: PendingPointing) -> PointingEstimate:
        """Return the pointing at one reading."""
        return self.series([pending]).estimate(0)

    def series(self, readings: Sequence[PendingPointing]) -> PointingSeries:
        """Return the pointings at N readings from one state; for the readings see :meth:`CorrectedAxis.axes`."""
        state = readings[0].state
        if self._corrected is None or self._corrected.state is not state:
            self._corrected = CorrectedAxis(self._filter, state)
        axes = self._corrected.axes(readings)
        if state.fault_state.unresolved_fault is not None:
            axes.covariance_by_source_n[:, self._disagreement_source] += state.fault_state.unresolved_fault.covariance_n
        lights = self._is_recent(axes.time_ns, state.last_beacons_ns)
        stars = self._is_recent(axes.time_ns, state.last_stars_ns)
        recent = lights | stars
        # Solution separations do not apply to a pointing without beacons and stars.
        covariance_without_separation_n, covariance_n = compiled_pointing.totals(
            axes.covariance_by_source_n,
            axes.by_error_n,
            self._corrected.separation_inflation,
            recent.view(np.uint8),
            self._disagreement_source,
        )
        mode = np.where(lights, _ONE_LIGHT if state.light_count == 1 else _TWO_LIGHTS, _ENCODER)
        mode = np.where(stars, np.where(lights, _STARS_AND_LIGHTS, _STARS), mode)
        statuses = self._pointing_statuses(self._corrected, mode.tolist(), readings)
        rotation_nt = axes.rotation_nm @ self._corrected.rotation_mt
        rotation_nt[~lights] = np.nan
        series = PointingSeries(
            time_ns=axes.time_ns,
            rotation_nm=axes.rotation_nm,
            covariance_by_source_n=axes.covariance_by_source_n,
            covariance_n=covariance_n,
            covariance_without_separation_n=covariance_without_separation_n,
            rotation_nt=rotation_nt,
            mode=mode,
            status=[status for status, _ in statuses],
            light_count=lights * state.light_count,
            state=state,
            text=[text for _, text in statuses],
            by_error_n=axes.by_error_n,
            rotation_dm=axes.rotation_dm,
        )
        if self._config.integrity.alert_limit_arcsec:
            self._degrade_above_limit(series)
        return series

    def _is_recent(self, time_ns: StampArray, used_ns: int | None) -> NDArray[np.bool_]:
        """True for each time at which the sighting at ``used_ns`` is recent, shape (N,); False without a sighting."""
        if used_ns is None:
            return np.zeros(len(time_ns), dtype=bool)
        recent: NDArray[np.bool_] = time_ns - used_ns <= self._recent_ns
        return recent

    def integrity(self, estimate: PointingEstimate) -> IntegrityReport:
        """Return protection levels and test statistics of a pointing."""
        if self._levels is None or self._levels.state is not estimate.state:
            self._levels = PointingLevels(self._filter, self._config, estimate.state)
        return self._levels.integrity_of(estimate)

    def _degrade_above_limit(self, series: PointingSeries) -> None:
        """Set pointings to DEGRADED if a protection level exceeds its alert limit or is not available."""
        for number, status in enumerate(series.status):
            if status is not Status.DEGRADED:
                text = alert_limit_text(self.integrity(series.estimate(number)), QUANTITIES)
                if text:
                    series.status[number], series.text[number] = Status.DEGRADED, text

    def _pointing_statuses(
        self, corrected: CorrectedAxis, modes: list[int], readings: Sequence[PendingPointing]
    ) -> list[tuple[Status, str]]:
        """Return status and reason of each pointing; the reason of a VALID pointing is empty."""
        statuses = []
        for mode, one in zip(modes, readings, strict=True):
            if one.unconfirmed_reason:
                statuses.append((Status.DEGRADED, one.unconfirmed_reason))
                continue
            kind = mode, one.ship.status
            status = corrected.statuses.get(kind)
            if status is None:
                status = corrected.statuses[kind] = self._confirmed_status(corrected.state, *kind)
            statuses.append(status)
        return statuses

    def _confirmed_status(self, state: CalibrationState, mode: int, ship_status: Status) -> tuple[Status, str]:
        """Return status and reason of a pointing from confirmed data; the reason of a VALID pointing is empty."""
        if state.consecutive_rejections:
            text = "the last lights or stars were inconsistent with encoders and ship's attitude: "
            return Status.DEGRADED, text + state.rejection_text
        if state.fault_state.unresolved_fault is not None:
            return Status.DEGRADED, state.fault_state.unresolved_fault.text
        for source, record in state.fault_state.excluded.items():
            unconfirmed = state.last_update_ns is None or state.last_update_ns < record.since_ns
            if mode == Mode.ENCODER or unconfirmed or not source.startswith(BEACON_PREFIX):
                return Status.DEGRADED, f"{source} is excluded: {record.reason}"
        if ship_status is Status.DEGRADED:
            return Status.DEGRADED, "the ship's attitude is DEGRADED"
        if state.last_update_ns is None and not np.any(state.covariance_by_source[self._saved]):
            text = "no light or star used yet and no calibration loaded: axis errors as configured"
            return Status.DEGRADED, text
        if mode == Mode.ENCODER:
            return Status.COASTING, "no lights, no stars: pointing by encoders, axis errors and the ship's attitude"
        return Status.VALID, ""


def invalid_pointing(filter_: CalibrationFilter, state: CalibrationState, now_ns: int, text: str) -> PointingEstimate:
    """Return an INVALID pointing."""
    unknown = np.full((3, 3), np.nan)
    return PointingEstimate(
        time_ns=now_ns,
        rotation_nm=unknown,
        covariance_by_source_n=np.full((len(filter_.model.sources), 3, 3), np.nan),
        covariance_n=unknown,
        covariance_without_separation_n=unknown,
        rotation_nt=unknown,
        mode=Mode.ENCODER,
        status=Status.INVALID,
        light_count=0,
        state=state,
        text=text,
        by_error_n=np.full((3, len(axis_state_indices(filter_.model))), np.nan),
        rotation_dm=unknown,
    )

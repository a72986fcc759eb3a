"""INS attitudes corrected by filter states, as published: covariance by error source, status and protection levels.

Protection levels of heading, pitch and roll bound the error in the presence of an undetected fault. They are computed
from the solution separations of the subfilters by :mod:`ship_estimation.integrity.protection_levels`.
"""

import copy
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ins_errors.process import InsErrorPropagation, PropagatedInsErrors, own_error_matrix
from ship_attitude_star.ship_attitude.config import GEODETIC, GRAVITY, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.faults.ins_fault_handling import UNKNOWN_INS_RAD_PER_SQRT_S
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.device import SOURCE_INTERPOLATION
from ship_attitude_star.ship_attitude.model import ALL_STARS, INS, SOURCE_DEFLECTION, SOURCE_INS_NOISE
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.common_error import with_common_error
from ship_estimation.integrity.protection_levels import (
    IntegrityReport,
    alert_limit_text,
    integrity_report,
    protection_levels,
)
from ship_estimation.kalman.kalman_filter import exceeds_model
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.frames import angle_errors_from_rotation_vector, angles_from_rotation
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import InterpolatedAttitude, PropagatedBlock
from ship_kernels import compiled_rotations
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeSeries, Horizon

QUANTITIES = ("heading", "pitch", "roll")
"""Quantities with a protection level."""

_ATTITUDE, _TIME_OFFSET = slice(0, 3), 3
"""Indices of the states that correct an INS attitude: the correlated error (north, up, east) and the time offset."""

_AFTER_ALL_SAMPLES_NS = np.iinfo(np.int64).max
"""Stamp later than every sample."""


class CorrectedIns:
    """Corrections of INS attitudes by one filter state; computed once per state, used at the INS rate.

    Only the correlated error and the time offset of the INS are needed, so only their covariance is propagated.

    Args:
        filter_: filter and model.
        state: filter state after the last measurement.
        config: configuration of the node.

    Attributes:
        state: the filter state.
        config: configuration of the node.
        propagation_s: time by which an INS sample is propagated to be the attitude at its stamp, s.
        since_ns: time of the state, from which the error is propagated. Before the first measurement ``since_ns`` is
            later than every sample, so that nothing is propagated.
        newest_star_ns: stamp of the last accepted star measurement; None without such a measurement.
        error_n: estimated correlated error, rad, shape (3,).
        exceeds_model: nonzero for the components of ``error_n`` that do not decay, because they exceed the error model,
            shape (3,), uint8.
        covariance_by_source: covariance of correlated error and time offset by error source, shape (n_sources, 4, 4).
            The other states of an INS error process follow, if there is one, for example the deflection of the
            vertical.
        model_constants: correlation time, steady-state variance and white variance of the INS error, shape (3,) each,
            and indices of the error sources INS drift, INS noise and interpolation.
        drift_index: index of the error source INS drift.
        error_propagation: propagation of the INS error if the filter needs the vertical; else None.
    """

    def __init__(self, filter_: ShipFilter, state: FilterState, config: ShipAttitudeConfig) -> None:
        model, ins_attitude = filter_.model, filter_.model.ins_attitude_block
        self.drift_index = model.sources.index(ins_attitude.source)
        self.model_constants = (
            ins_attitude.time_s,
            ins_attitude.sigma**2,
            model.blocks["ins.noise"].sigma ** 2,
            self.drift_index,
            model.sources.index(SOURCE_INS_NOISE),
            model.sources.index(SOURCE_INTERPOLATION),
        )
        self._filter, self._correlated_sigma, self.config = filter_, ins_attitude.sigma, config
        self.error_propagation: InsErrorPropagation | None = None
        if filter_.vertical is not None:
            assert model.ins_process is not None
            sources = self.drift_index, model.source_indices.get(SOURCE_DEFLECTION, self.drift_index)
            models_deflection = SOURCE_DEFLECTION in model.source_indices
            self.error_propagation = InsErrorPropagation(
                model.ins_process, filter_.vertical, sources, models_deflection, config.horizon == GRAVITY
            )
        attitude, others = np.split(model.process_indices, [3])
        self._rows = np.concatenate([attitude, model.state_indices("ins.time_offset"), others])
        self._set_state(state)

    def with_state(self, state: FilterState) -> "CorrectedIns":
        """Return the corrections by another filter state."""
        other = copy.copy(self)
        other._set_state(state)
        return other

    def _set_state(self, state: FilterState) -> None:
        rows, self.state = self._rows, state
        mean = self._mean = state.mean[rows]
        self.error_n = mean[_ATTITUDE]
        self.propagation_s = -(self.config.ins.time_offset_s + float(mean[_TIME_OFFSET]))
        self.exceeds_model = exceeds_model(self.error_n, self._correlated_sigma).view(np.uint8)
        self.covariance_by_source: FloatArray = state.covariance_by_source[:, rows[:, None], rows]
        self.since_ns = _AFTER_ALL_SAMPLES_NS if state.time_ns is None else state.time_ns
        self.newest_star_ns = newest_star_ns(self._filter, state)

    def errors(self, times_ns: Sequence[int]) -> PropagatedInsErrors:
        """Return the INS errors at some times, only for a filter that needs the vertical."""
        assert self.error_propagation is not None
        since_ns = self.state.time_ns
        # A sample older than the state is treated as a sample at the time of the state.
        until_ns = times_ns if since_ns is None else [max(time_ns, since_ns) for time_ns in times_ns]
        return self.error_propagation.errors(
            since_ns, self.state.vertical, self._mean, self.covariance_by_source, until_ns
        )

    def estimate(self, time_ns: int, ins: InterpolatedAttitude) -> AttitudeEstimate:
        """Return the attitude at the stamp of an INS sample, with its status."""
        propagated = ins.rotation_nd[None], ins.rate_d[None], np.array([ins.noise_gain]), ins.error_covariance_d[None]
        (series,) = corrected_estimates([self], [1], np.array([time_ns]), PropagatedBlock(*propagated))
        return series.estimate(0)

    def attitudes_with_errors(
        self, propagated: PropagatedBlock, error_n: FloatArray, covariance_by_source: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the results of :func:`corrected_attitudes` for INS errors that are known at the N times themselves.

        Args:
            propagated: INS samples propagated by the time offset.
            error_n: attitude error of the INS at each time, rad, shape (N, 3).
            covariance_by_source: covariance of attitude error and time offset, shape (N, n_sources, 4, 4).
        """
        count, constants = len(error_n), self.model_constants
        unpropagated = np.arange(count, dtype=np.intp), np.zeros(count)
        exceeding = np.ones((count, 3), dtype=np.uint8)
        found: tuple[FloatArray, FloatArray] = compiled_rotations.corrected_attitudes(
            *unpropagated, *propagated, error_n, exceeding, *constants[:3], covariance_by_source, *constants[3:]
        )
        return found

    def statuses(self, star_age_s: FloatArray) -> tuple[list[Status], list[str]]:
        """Return the statuses of N attitudes, and the reasons why they are DEGRADED.

        Args:
            star_age_s: time since the last accepted star measurement, in ascending order, s, shape (N,).
        """
        ages_s = star_age_s.tolist()
        first, last = self._attitude_status(ages_s[0]), self._attitude_status(ages_s[-1])
        found = [first] * len(ages_s) if first == last else [self._attitude_status(age_s) for age_s in ages_s]
        return [status for status, _ in found], [text for _, text in found]

    def sources(self, time_ns: StampArray) -> list[tuple[str, ...]]:
        """Return the sources of each attitude: the INS, and sources with a recently accepted measurement."""
        recent_ns = round(self.config.coasting_after_s * SECOND_NS)

        def at(stamp_ns: int) -> tuple[str, ...]:
            used = [source for source, used_ns in self.state.last_used_ns.items() if used_ns >= stamp_ns - recent_ns]
            return INS, *sorted(used)

        first, last = at(int(time_ns[0])), at(int(time_ns[-1]))
        # Without new measurements sources can only time out.
        return [first] * len(time_ns) if first == last else [at(stamp_ns) for stamp_ns in time_ns.tolist()]

    def degrade_above_limit(self, series: AttitudeSeries) -> None:
        """Set the status to DEGRADED for attitudes with a protection level that is missing or above the alert limit."""
        for number, status in enumerate(series.status):
            if status is not Status.DEGRADED:
                text = alert_limit_text(integrity_of(self._filter, self.config, series.estimate(number)), QUANTITIES)
                if text:
                    series.status[number], series.text[number] = Status.DEGRADED, text

    def _attitude_status(self, star_age_s: float) -> tuple[Status, str]:
        """Return the status of an attitude, and the reason why it is DEGRADED."""
        if self.state.unresolved_fault is not None:
            return Status.DEGRADED, self.state.unresolved_fault.text
        if math.isnan(star_age_s):
            return Status.DEGRADED, "INS alone, no star yet"
        if self.state.unconfirmed_step is not None:
            return Status.DEGRADED, self.state.unconfirmed_step.text
        if star_age_s <= self.config.coasting_after_s:
            return Status.VALID, ""
        if INS in self.state.excluded:
            return Status.DEGRADED, "no star measurement is used, and the INS contradicted the stars"
        return Status.COASTING, ""


def corrected_attitudes(
    corrected: Sequence[CorrectedIns], state_index: NDArray[np.intp], since_s: FloatArray, propagated: PropagatedBlock
) -> tuple[FloatArray, FloatArray]:
    """Return the corrected attitudes at N times and their covariance by error source, horizon frame, rad².

    The result does not depend, to the last bit, on which attitudes are computed together.

    Args:
        corrected: corrections by states of one filter.
        state_index: index of the corrections of each attitude, shape (N,).
        since_s: time from the state to each attitude, at least 0, s, shape (N,).
        propagated: INS samples propagated by the time offset.

    Returns:
        Attitudes, shape (N, 3, 3), and covariances, shape (N, n_sources, 3, 3).
    """
    found: tuple[FloatArray, FloatArray] = compiled_rotations.corrected_attitudes(
        state_index,
        since_s,
        *propagated,
        np.array([one.error_n for one in corrected]),
        np.array([one.exceeds_model for one in corrected]),
        *corrected[0].model_constants[:3],
        np.array([one.covariance_by_source for one in corrected]),
        *corrected[0].model_constants[3:],
    )
    return found


def corrected_estimates(
    corrected: Sequence[CorrectedIns],
    counts: Sequence[int],
    time_ns: StampArray,
    propagated: PropagatedBlock,
) -> list[AttitudeSeries]:
    """Return the attitudes at the stamps of N INS samples, one series per filter state.

    Args:
        corrected: corrections by states of one filter.
        counts: number of successive samples of each of these states, at least one.
        time_ns: stamps, in ascending order, shape (N,).
        propagated: samples propagated by the time offset.
    """
    state_index = np.repeat(np.arange(len(counts), dtype=np.intp), counts)
    since_ns = np.maximum(time_ns - np.array([one.since_ns for one in corrected])[state_index], 0)
    stops = np.cumsum(counts).tolist()
    segments = [slice(stop - count, stop) for stop, count in zip(stops, counts, strict=True)]
    if corrected[0].error_propagation is None:
        rotation_nd, covariance_by_source = corrected_attitudes(
            corrected, state_index, 1e-9 * since_ns.astype(np.float64), propagated
        )
        vertical_known = None
    else:
        errors = [one.errors(time_ns[some].tolist()) for one, some in zip(corrected, segments, strict=True)]
        rotation_nd, covariance_by_source = corrected[0].attitudes_with_errors(
            propagated,
            np.concatenate([one.error_n for one in errors]),
            np.concatenate([one.covariance_by_source for one in errors]),
        )
        vertical_known = np.concatenate([one.vertical_known for one in errors])
    for one, some in zip(corrected, segments, strict=True):
        if one.state.unresolved_fault is not None:
            covariance_by_source[some, one.drift_index] += one.state.unresolved_fault.covariance_n
        if INS in one.state.excluded:
            unknown = UNKNOWN_INS_RAD_PER_SQRT_S**2 * since_ns[some] * 1e-9
            covariance_by_source[some, one.drift_index] += unknown[:, None, None] * np.eye(3)
    covariance_n = covariance_without_separation_n = covariance_by_source.sum(axis=1)
    for one, some in zip(corrected, segments, strict=True):
        if one.state.separation_covariance_n is not None:
            covariance_by_source[some, one.drift_index] += one.state.separation_covariance_n
            covariance_n = covariance_by_source.sum(axis=1)
    star_age_s = _star_ages_s(corrected, state_index, time_ns)
    config, all_series = corrected[0].config, []
    horizon = _horizons(star_age_s, vertical_known, config)
    for one, some in zip(corrected, segments, strict=True):
        status, text = one.statuses(star_age_s[some])
        series = AttitudeSeries(
            time_ns=time_ns[some],
            rotation_nd=rotation_nd[some],
            covariance_by_source_n=covariance_by_source[some],
            covariance_n=covariance_n[some],
            covariance_without_separation_n=covariance_without_separation_n[some],
            rate_d=propagated.rate_d[some],
            status=status,
            horizon=horizon[some],
            sources=one.sources(time_ns[some]),
            star_age_s=star_age_s[some],
            state=one.state,
            text=text,
        )
        if config.integrity.alert_limit_arcsec:
            one.degrade_above_limit(series)
        all_series.append(series)
    return all_series


def _horizons(
    star_age_s: FloatArray, vertical_known: NDArray[np.bool_] | None, config: ShipAttitudeConfig
) -> NDArray[np.int64]:
    """Return the horizon of each of N attitudes, shape (N,)."""
    # NaN compares false. Before the first star the horizon is therefore the horizon of the INS, unless the vertical is
    # known.
    is_geodetic = star_age_s <= config.ins.tilt_time_s
    if vertical_known is not None:
        is_geodetic = (is_geodetic | vertical_known) & (config.horizon == GEODETIC)
    return np.where(is_geodetic, Horizon.GEODETIC, Horizon.GRAVITY)


def _star_ages_s(corrected: Sequence[CorrectedIns], state_index: NDArray[np.intp], time_ns: StampArray) -> FloatArray:
    """Return the time since the last accepted star measurement for each time, s; NaN without such a measurement."""
    newest_ns = np.array([one.newest_star_ns or 0 for one in corrected])
    none_yet = np.array([one.newest_star_ns is None for one in corrected])
    ages_s: FloatArray = np.where(none_yet[state_index], np.nan, (time_ns - newest_ns[state_index]) / SECOND_NS)
    return ages_s


def newest_star_ns(filter_: ShipFilter, state: FilterState) -> int | None:
    """Return the stamp of the last accepted star measurement; None without such a measurement."""
    stars = (used_ns for source, used_ns in state.last_used_ns.items() if filter_.devices[source].is_star)
    return max(stars, default=None)


def integrity_of(filter_: ShipFilter, config: ShipAttitudeConfig, estimate: AttitudeEstimate) -> IntegrityReport:
    """Return protection levels, solution separations and exclusions of an attitude.

    Args:
        filter_: filter and model.
        config: configuration of the node.
        estimate: the attitude, with its filter state.
    """
    state, subfilters = estimate.state, filter_.fault_detector.subfilters
    relevant = subfilters.relevant_hypotheses(estimate.sources, state.excluded)
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd).tolist()
    to_angles, source_count = angle_errors_from_rotation_vector(heading, pitch), len(state.stack) - len(state.means) + 1
    means, stack = relative_to_horizon(filter_, config, state, estimate.time_ns)
    # The covariance is without the inflation for large separations, because the levels contain the separations.
    found = protection_levels(
        subfilters.k,
        relevant.indices,
        filter_.model.state_indices("ins.attitude"),
        (to_angles, to_angles, estimate.covariance_without_separation_n),
        means[0],
        means[1:],
        stack[:source_count],
        stack[source_count:],
    )
    names = relevant.names
    if INS not in state.excluded and relevant.is_cross_checked:
        angle_covariance = to_angles @ estimate.covariance_without_separation_n @ to_angles.T
        found = with_common_error(
            found,
            subfilters.k,
            subfilters.common_k_md,
            subfilters.common_threshold,
            state.correction_sums,
            to_angles,
            angle_covariance,
        )
        names = *names, ALL_STARS
    excluded = tuple(sorted((name, exclusion.since_ns) for name, exclusion in state.excluded.items()))
    has_unresolved_fault = (
        state.unresolved_fault is not None or state.unconfirmed_step is not None or estimate.status is Status.INVALID
    )
    is_checked = relevant.is_cross_checked and not has_unresolved_fault
    return integrity_report(estimate.time_ns, config.integrity, subfilters.k, names, found, excluded, is_checked)


def relative_to_horizon(
    filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState, time_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Return means and covariances of all filters, with the INS error relative to the published horizon."""
    if config.horizon == GEODETIC or filter_.vertical is None:
        return state.means, state.stack
    # The gravity horizon differs by the deflection, whose two states follow the three states of the INS attitude.
    indices, to_own = filter_.model.process_indices[:5], np.eye(filter_.model.size)
    to_own[indices[:3, None], indices] = own_error_matrix(filter_.vertical.at(time_ns))
    return state.means @ to_own.T, to_own @ state.stack @ to_own.T

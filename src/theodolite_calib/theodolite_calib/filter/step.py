"""Step of the filter with one sighting of beacons: propagation, fault detection, gate and update.

The state is propagated to the time of the sighting. Drones whose baselines have jumped are excluded, and excluded
drones are monitored. The gate (:mod:`theodolite_calib.filter.sighting_gate`) tests the other beacons in the main
filter. Main filter and subfilters are each updated if the beacons pass the gate of that filter. Fault detection
(:mod:`theodolite_calib.filter.fault_detection`) uses the innovations of all filters.
"""

from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import GateConfig, chi_square_gate
from ship_estimation.integrity.protection_levels import separation_sigma
from ship_estimation.rejection_rules import Reason, Rejection, singular_covariance
from ship_geometry.rotations import FloatArray, exp_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.fault_detection import (
    AxisExclusion,
    AxisFaultDetector,
    AxisFaultState,
    isolate_drift_fault,
    isolate_step_fault,
    record_acceptance,
    with_unresolved_fault,
)
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Comparison
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.filter.sighting_gate import SightingGate
from theodolite_calib.filter.subfilters import (
    AXIS_SOURCES,
    BEACON_PREFIX,
    ENCODER,
    SHIP,
    SubfilterStates,
    beacon_innovation,
)
from theodolite_calib.samples.samples import Exposure, ExposureDecision
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.samples.stream_consistency import StreamConsistency
from theodolite_calib.samples.tracks import BaselineJump


class SightingStep:
    """Step from one state to the next with one sighting of beacons.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        stream_consistency: function of two times, ns, that returns the consistency of the encoder and ship streams
            between these times, or None if not evaluated.
        has_ship_drifted: function of a time, ns, that returns True if the ship's attitude has departed from the
            integral of its rates before that time, or None if unknown.
        stream_faults: function of a time, ns, that returns which of the encoder and ship streams were stuck, jumped or
            repeated a stamp shortly before that time.
    """

    def __init__(
        self,
        config: OpticalAxisConfig,
        filter_: CalibrationFilter,
        stream_consistency: Callable[[int, int], StreamConsistency | None] = lambda since_ns, until_ns: None,
        has_ship_drifted: Callable[[int], bool | None] = lambda time_ns: None,
        stream_faults: Callable[[int], Set[str]] = lambda time_ns: frozenset(),
    ) -> None:
        self._stream_consistency, self._has_ship_drifted = stream_consistency, has_ship_drifted
        self._stream_faults = stream_faults
        self._filter, self._gate, self._return_after_s = filter_, config.gate, config.integrity.return_after_s
        self._sighting_gate = SightingGate(filter_, config.gate)
        self._fault_detector = AxisFaultDetector(filter_.subfilters, config.gate, config.integrity)
        self._axis_indices = axis_state_indices(filter_.model)

    def __call__(
        self,
        state: CalibrationState,
        sighting: Sighting,
        exposure: Exposure,
        jumps: tuple[tuple[str, BaselineJump], ...] = (),
    ) -> tuple[CalibrationState, ExposureDecision]:
        """Return state and decision after a sighting.

        Args:
            state: state after the previous sighting.
            sighting: beacons with complete data.
            exposure: exposure of the sighting.
            jumps: baseline jumps of the sighting's beacons, by name.
        """
        predicted = self._filter.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        drones = [BEACON_PREFIX + name for name in sighting.names]
        fault_state = self._fault_detector.restart_timers(predicted.fault_state, drones, sighting.time_ns)
        predicted = replace(predicted, fault_state=fault_state)
        for name, jump in jumps:
            predicted = self._apply_baseline_jump(predicted, sighting, name, jump)
        try:
            after, decision = self._evaluate(state, predicted, sighting, exposure)
        except np.linalg.LinAlgError:
            rejection = singular_covariance()
            after, decision = state, ExposureDecision(exposure, rejection.reason, text=rejection.text)
        return after, replace(decision, excluded_sources=tuple(sorted(after.fault_state.excluded)))

    def _apply_baseline_jump(
        self, predicted: CalibrationState, sighting: Sighting, name: str, jump: BaselineJump
    ) -> CalibrationState:
        """Exclude the drone of a baseline that has jumped, or record the jump if the drone is already excluded."""
        source, fault_state = BEACON_PREFIX + name, predicted.fault_state
        if source in fault_state.excluded:
            return replace(predicted, fault_state=self._fault_detector.record_baseline_jump(fault_state, source, jump))
        if fault_state.known_jumps_ns.get(source, jump.time_ns - 1) >= jump.time_ns:
            return predicted
        reason = f"its baseline has jumped by {np.linalg.norm(jump.jump_n):.2f} m, more than its flight can explain"
        exclusion = AxisExclusion(
            sighting.time_ns,
            reason=reason,
            jump_sum_n=jump.jump_n,
            jump_sum_sigma_m=jump.sigma_m,
            last_jump_ns=jump.time_ns,
        )
        return self._exclude_source(predicted, source, exclusion)

    def _exclude_source(
        self, state: CalibrationState, source: str, exclusion: AxisExclusion, explaining_subfilter: str | None = None
    ) -> CalibrationState:
        """Exclude a source; all filters restart from the subfilter without this source, if this subfilter exists."""
        fault_state = self._fault_detector.exclude_source(state.fault_state, source, exclusion, explaining_subfilter)
        return replace(self._filter.exclude_source(state, source), fault_state=fault_state)

    def _evaluate(
        self, state: CalibrationState, predicted: CalibrationState, sighting: Sighting, exposure: Exposure
    ) -> tuple[CalibrationState, ExposureDecision]:
        """Return state and decision; ``predicted`` is the propagated state, possibly with further excluded sources."""
        excluded = predicted.fault_state.excluded.keys()
        unused_state = state if excluded == state.fault_state.excluded.keys() else predicted
        rows = range(len(sighting.names))
        used_rows = [row for row in rows if BEACON_PREFIX + sighting.names[row] not in excluded]
        excluded_beacons = tuple(
            (name, Rejection(Reason.EXCLUDED, predicted.fault_state.excluded[BEACON_PREFIX + name].reason))
            for name in sighting.names
            if BEACON_PREFIX + name in excluded
        )
        prepared = self._filter.add_unknown_errors(predicted)
        for source in sorted(excluded & AXIS_SOURCES):
            predicted = self._monitor_prediction(predicted, sighting, used_rows, source)
        fault_state = self._monitor_beacons(predicted.fault_state, prepared, sighting, bool(used_rows))
        if not used_rows:
            unused_state = replace(unused_state, subfilters=predicted.subfilters, fault_state=fault_state)
            reason, text = Reason.EXCLUDED, "the drones of all lights in the image are excluded"
            return unused_state, ExposureDecision(exposure, reason, text=text, rejected_parts=excluded_beacons)
        prepared = replace(prepared, fault_state=fault_state)
        chosen = sighting if len(used_rows) == len(rows) else sighting.select(used_rows)
        if excluded & AXIS_SOURCES:
            prepared = self._filter.align_unknown_errors(prepared, chosen)
        result = self._sighting_gate.evaluate_sighting(prepared, chosen, exposure)
        decision = replace(result.decision, rejected_parts=excluded_beacons + result.decision.rejected_parts)
        if result.sighting is not None and result.comparison is not None:
            after, final_comparison = self._filter.update_by_beacons(prepared, result.sighting, result.comparison)
            if ENCODER in excluded:
                # The predicted attitude depends on the excluded encoders, so the attitude after the update is used.
                rotation_step = exp_rotation(final_comparison.prediction.by_state_n @ (after.mean - prepared.mean))
                rotation_nt = rotation_step @ result.comparison.prediction.rotation_nt
                telescope_dt = result.sighting.deck_from_telescope(rotation_nt), _attitude_sigma(final_comparison)
                decision = replace(decision, telescope_dt=telescope_dt)
            return self._record_accepted(prepared, after, result.sighting.names, final_comparison, decision)
        comparison = self._filter.compare(prepared, chosen)
        unused_state = replace(unused_state, fault_state=fault_state)
        if comparison is None:
            return count_rejection(unused_state, decision, self._gate, "lights")
        return self._record_rejected(unused_state, prepared, chosen, comparison, decision)

    def _update_subfilters(
        self, predicted: CalibrationState, names: tuple[str, ...], comparison: Comparison, is_used: bool, time_ns: int
    ) -> tuple[SubfilterStates, AxisFaultState]:
        excluded, main_filter = predicted.fault_state.excluded.keys(), (predicted.mean, comparison.covariance)
        subfilters, innovations = self._filter.subfilters.update_by_beacons(
            predicted.subfilters, names, comparison.measurement, main_filter, excluded, self._gate.probability
        )
        return subfilters, self._fault_detector.update_means(
            predicted.fault_state, names, innovations, is_used, time_ns
        )

    def _record_accepted(
        self,
        before: CalibrationState,
        after: CalibrationState,
        names: tuple[str, ...],
        comparison: Comparison,
        decision: ExposureDecision,
    ) -> tuple[CalibrationState, ExposureDecision]:
        """Update subfilters and fault state with an accepted sighting; ``before`` is the propagated state."""
        time_ns, prediction = decision.measurement.time_ns, comparison.prediction
        subfilters, fault_state = self._update_subfilters(before, names, comparison, True, time_ns)
        separation = solution_separations(
            after, subfilters, self._axis_indices, prediction.rotation_nt, prediction.by_state_n
        )
        after_acceptance = record_acceptance(fault_state, time_ns, self._return_after_s)
        after = replace(after, subfilters=subfilters, fault_state=after_acceptance, solution_separation=separation)
        is_detected, source, explaining_sources = self._fault_detector.isolate_source(
            after.fault_state, after.solution_separation, time_ns
        )
        if is_detected and not fault_state.excluded:
            is_common = self._fault_detector.drift_together(fault_state, time_ns)
            source = isolate_drift_fault(source, explaining_sources, is_common, self._has_ship_drifted(time_ns))
            source = self._prefer_stream_fault(source, explaining_sources, time_ns)
        elif not is_detected and self._fault_detector.indicates_ship_drift(fault_state, time_ns):
            source = SHIP if self._has_ship_drifted(time_ns) else source
        if source is not None:
            return self._exclude_faulty_source(after, source, decision)
        if is_detected:
            spread_n = self._largest_disagreement_n(after, comparison)
            unresolved = with_unresolved_fault(after.fault_state, spread_n, is_persistent=True)
            after = replace(after, fault_state=unresolved)
        return after, decision

    def _record_rejected(
        self,
        unused_state: CalibrationState,
        predicted: CalibrationState,
        sighting: Sighting,
        comparison: Comparison,
        decision: ExposureDecision,
    ) -> tuple[CalibrationState, ExposureDecision]:
        """Update subfilters and fault state with a rejected sighting; ``predicted`` is the propagated state."""
        time_ns = sighting.time_ns
        subfilters, fault_state = self._update_subfilters(predicted, sighting.names, comparison, False, time_ns)
        is_detected, explaining_subfilter, explaining_sources = self._fault_detector.isolate_source(
            fault_state, np.zeros(len(self._filter.subfilters.names)), time_ns
        )
        after = replace(predicted, subfilters=subfilters, fault_state=fault_state)
        source = explaining_subfilter
        if explaining_subfilter in (ENCODER, SHIP) and not unused_state.fault_state.excluded:
            source = self._isolate_by_streams(unused_state, explaining_subfilter, explaining_sources, decision)
            source = self._prefer_stream_fault(source, explaining_sources, time_ns)
        if source is not None:
            return self._exclude_faulty_source(
                replace(after, consecutive_rejections=unused_state.consecutive_rejections + 1),
                source,
                decision,
                explaining_subfilter,
            )
        fault_state = with_unresolved_fault(fault_state, _disagreement_n(comparison), is_persistent=is_detected)
        return count_rejection(
            replace(unused_state, subfilters=subfilters, fault_state=fault_state), decision, self._gate, "lights"
        )

    def _isolate_by_streams(
        self, unused_state: CalibrationState, source: str, explaining_sources: Set[str], decision: ExposureDecision
    ) -> str | None:
        """Isolate a fault of encoders or ship with steps in their streams; return the faulty source or None."""
        time_ns = decision.measurement.time_ns
        since_ns = unused_state.last_beacons_ns
        streams = None if since_ns is None else self._stream_consistency(since_ns, time_ns)
        if streams is None:
            return source
        return isolate_step_fault(source, explaining_sources, streams, float(np.max(np.abs(decision.residual))))

    def _prefer_stream_fault(self, source: str | None, explaining_sources: Set[str], time_ns: int) -> str | None:
        """Return the source to exclude: ``source``, or the other source of encoders and ship if its stream had a fault.

        If recently only the stream of the other source had a fault, there are two cases. The other source is returned
        if its exclusion explains the innovations. Otherwise no source is isolated.
        """
        stream_faults = self._stream_faults(time_ns)
        if source not in AXIS_SOURCES or source in stream_faults or len(stream_faults) != 1:
            return source
        (other,) = stream_faults
        return other if other in explaining_sources else None

    def _exclude_faulty_source(
        self, state: CalibrationState, source: str, decision: ExposureDecision, explaining_subfilter: str | None = None
    ) -> tuple[CalibrationState, ExposureDecision]:
        """Exclude an isolated source.

        If the source has no subfilter, the innovation means restart from those of ``explaining_subfilter``.
        """
        reason = f"{source} is inconsistent with the other sources, which are consistent without it"
        largest = float(np.max(np.abs(decision.residual), initial=0.0))
        residual_m = largest * self._filter.sightings.focal_length_m(state.mean)
        exclusion = AxisExclusion(decision.measurement.time_ns, reason=reason, rejected_residual_m=residual_m)
        subfilter = source if source in self._filter.subfilters.names else explaining_subfilter
        state = self._exclude_source(state, source, exclusion, subfilter)
        text = f"{decision.text}; excluded: {reason}" if decision.text else f"excluded: {reason}"
        return replace(state, consecutive_rejections=0), replace(decision, text=text)

    def _largest_disagreement_n(self, state: CalibrationState, comparison: Comparison) -> FloatArray:
        """Return the largest solution separation of the pointing, as a covariance of a rotation vector in n, rad²."""
        separation_n = (state.subfilters.mean - state.mean)[:, self._axis_indices] @ (
            comparison.prediction.by_state_n[:, self._axis_indices].T
        )
        farthest = separation_n[np.argmax(np.sum(separation_n**2, axis=1))]
        return np.outer(farthest, farthest)

    def _monitor_prediction(
        self, predicted: CalibrationState, sighting: Sighting, used_rows: list[int], source: str
    ) -> CalibrationState:
        """Compare the used beacons with the prediction from excluded encoders or ship's attitude."""
        comparison = self._filter.compare(predicted, sighting.select(used_rows)) if used_rows else None
        is_consistent = comparison is not None and comparison.nis <= chi_square_gate(
            self._gate.probability, 2 * len(used_rows)
        )
        fault_state = self._fault_detector.monitor_prediction(
            predicted.fault_state, source, is_consistent, sighting.time_ns
        )
        return replace(predicted, fault_state=fault_state)

    def _monitor_beacons(
        self, fault_state: AxisFaultState, state: CalibrationState, sighting: Sighting, has_others: bool
    ) -> AxisFaultState:
        """Compare the beacons of excluded drones with the estimate from the other sources."""
        for row, name in enumerate(sighting.names):
            source = BEACON_PREFIX + name
            if source not in state.fault_state.excluded:
                continue
            comparison = self._filter.compare(state, sighting.select([row]))
            if comparison is not None:
                measurement = comparison.measurement
                innovation = beacon_innovation(measurement.residual, comparison.covariance, measurement.noise)
                exclusion = fault_state.excluded[source]
                expected_rejection_m = self._expected_rejection_m(exclusion, comparison, has_others)
                fault_state = self._fault_detector.monitor_beacon(
                    fault_state, source, innovation, sighting.time_ns, expected_rejection_m
                )
        return fault_state

    @staticmethod
    def _expected_rejection_m(exclusion: AxisExclusion, comparison: Comparison, has_others: bool) -> float:
        """Return the residual on the detector that the fault of an excluded drone would cause now, m.

        Without a jump the residual is 0 if beacons of other drones are used; 0 omits the test.
        """
        direction_n = comparison.prediction.lines.direction_n[0]
        across_m = np.linalg.norm(np.cross(exclusion.jump_sum_n, direction_n))
        distance_m = comparison.prediction.lines.distance_m[0]
        by_jump = float(comparison.focal_length_m * across_m / distance_m)
        if np.any(exclusion.jump_sum_n):
            # A jump along the line of sight has no residual; the smallest positive number prevents a reinstatement.
            return max(by_jump, np.finfo(float).tiny)
        return 0.0 if has_others else exclusion.rejected_residual_m


def count_rejection(
    state: CalibrationState, decision: ExposureDecision, gate: GateConfig, measured: str
) -> tuple[CalibrationState, ExposureDecision]:
    """Count a rejection; after consecutive rejections report a conflict and inflate the main filter's covariance.

    A conflict between the lights themselves is only counted.

    Args:
        state: state before the rejected sighting.
        decision: decision about the sighting.
        gate: gate with the numbers of consecutive rejections for conflict and inflation.
        measured: name of the measured objects in the text.
    """
    count = state.consecutive_rejections + 1
    state = replace(state, consecutive_rejections=count, rejection_text=decision.text)
    if decision.reason is Reason.LIGHT_CONFLICT:
        return state, decision
    reason, text = decision.reason, decision.text
    if count >= gate.conflict_after:
        reason = Reason.ATTITUDE_CONFLICT
        text = f"{count} rejections in a row: {measured} are inconsistent with encoders and ship's attitude; {text}"
    if gate.reopen_after and count % gate.reopen_after == 0:
        state = replace(state, covariance_by_source=state.covariance_by_source * gate.reopen_factor)
        text += f"; covariance inflated by {gate.reopen_factor:g}"
    return state, replace(decision, reason=reason, text=text)


def solution_separations(
    state: CalibrationState,
    subfilters: SubfilterStates,
    axis_indices: NDArray[np.intp],
    rotation_nc: FloatArray,
    by_state_n: FloatArray,
) -> FloatArray:
    """Return each subfilter's solution separation about the worst axis, in standard deviations, shape (h,).

    Args:
        state: state of the main filter.
        subfilters: states of the subfilters.
        axis_indices: indices, in the state vector, of the errors that rotate the main axis.
        rotation_nc: rotation from a camera on the main axis to the horizon, shape (3, 3).
        by_state_n: Jacobian of the camera's rotation vector in n with respect to the state, shape (3, n).
    """
    to_axes = rotation_nc.T @ by_state_n[:, axis_indices]
    separation = (subfilters.mean - state.mean)[:, axis_indices] @ to_axes.T
    covariance = np.concatenate(
        [
            state.covariance_by_source[:, axis_indices[:, None], axis_indices].sum(axis=0)[None],
            subfilters.covariances[:, 0, axis_indices[:, None], axis_indices],
        ]
    )
    variance = (to_axes @ covariance * to_axes).sum(axis=-1)
    statistic: FloatArray = np.abs(separation / separation_sigma(variance[1:], variance[0])).max(axis=-1)
    return statistic


def _attitude_sigma(comparison: Comparison) -> float:
    """Return the standard deviation about the worst axis of the telescope's attitude from beacons alone, rad."""
    by_attitude, noise = comparison.prediction.by_attitude_n, comparison.measurement.noise
    information = by_attitude.T @ np.linalg.solve(noise, by_attitude)
    return float(np.sqrt(1.0 / max(np.linalg.eigvalsh(information)[0], 1.0)))


def _disagreement_n(comparison: Comparison) -> FloatArray:
    """Return the rotation from the predicted telescope attitude to the beacons' attitude, as covariance in n, rad²."""
    by_attitude = comparison.prediction.by_attitude_n
    rotation_n = np.linalg.pinv(by_attitude, rcond=1e-6) @ comparison.measurement.residual
    return np.outer(rotation_n, rotation_n)

"""Effects of an accepted or rejected measurement on its source: counters, conflict, and inflation of the covariance."""

from collections.abc import Mapping
from dataclasses import replace

from ship_attitude_star.plausibility.diagnosis_hints import AttitudeResidual, diagnosis_hint
from ship_attitude_star.ship_attitude.faults.fault_detection import ShipFaultDetector
from ship_attitude_star.ship_attitude.measurements.kind import Device
from ship_attitude_star.ship_attitude.measurements.prediction import LinearisedMeasurement, NotEvaluable
from ship_attitude_star.ship_attitude.state import NO_PIXEL_DWELLS, FilterState
from ship_estimation.fault_detection.detector import UnconfirmedStep, with_changes, with_entry, without_entry
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import log_rotation
from ship_stars.attitude_samples import AttitudeDecision
from ship_stars.solution.exposure import StarExposure


class DecisionEffects:
    """Records accepted and rejected measurements in the filter state.

    Args:
        gate: numbers of consecutive rejections with an effect.
        devices: devices of the filter by source.
        fault_detector: fault detection of the filter.
    """

    def __init__(self, gate: GateConfig, devices: Mapping[str, Device], fault_detector: ShipFaultDetector) -> None:
        self._gate, self._devices, self._fault_detector = gate, devices, fault_detector

    def reject(
        self, state: FilterState, measurement: Measurement, not_evaluable: NotEvaluable
    ) -> tuple[FilterState, AttitudeDecision]:
        """Reject a measurement that cannot be evaluated.

        The rejection is counted for its source only if the measurement contradicts the predicted state.
        """
        rejection, text = not_evaluable.rejection, not_evaluable.rejection.text
        if not_evaluable.is_contradiction:
            state, inflation_text = self._inflate_after_rejections(
                self._count_rejection(state, measurement.source), measurement.source
            )
            state = self._fault_detector.ins_fault.with_not_evaluable(state, measurement.time_ns)
            text += inflation_text
        return state, AttitudeDecision(measurement, rejection.reason, text=text, ins_time_ns=not_evaluable.ins_time_ns)

    def _count_rejection(self, state: FilterState, source: str) -> FilterState:
        """Return the state with the consecutive rejections of a source increased by one."""
        return with_changes(
            state,
            consecutive_rejections=with_entry(
                state.consecutive_rejections, source, state.consecutive_rejections.get(source, 0) + 1
            ),
        )

    def _inflate_after_rejections(self, state: FilterState, source: str) -> tuple[FilterState, str]:
        """Inflate the covariance after every ``gate.reopen_after`` consecutive rejections of a source.

        The source is then reinstated, and all filters restart from the main filter.

        Returns:
            The state, and a text about the inflation, which is empty without an inflation.
        """
        if not self._gate.reopen_after or state.consecutive_rejections[source] % self._gate.reopen_after:
            return state, ""
        state = with_changes(state, stack=state.stack * self._gate.reopen_factor, pixel_dwells=NO_PIXEL_DWELLS)
        state = with_changes(state, excluded=without_entry(state.excluded, source))
        state = self._fault_detector.restart_subfilters(state)
        return state, f"; covariance inflated by a factor of {self._gate.reopen_factor:g}"

    def record_accepted(self, state: FilterState, measurement: Measurement) -> FilterState:
        """Record an accepted measurement, reset the rejection counter of its source and store the stamp."""
        source, unconfirmed = measurement.source, state.unconfirmed_step
        if self._devices[source].is_star:
            if unconfirmed is not None:
                unconfirmed = unconfirmed.with_confirmation(measurement.time_ns, source)
            elif not any(device.is_star and state.has_used(name) for name, device in self._devices.items()):
                unconfirmed = _unconfirmed_first_star(source, measurement.time_ns)
        rejection_counts = (
            state.consecutive_rejections
            if state.consecutive_rejections.get(source) == 0
            else with_entry(state.consecutive_rejections, source, 0)
        )
        used_ns = with_entry(state.last_used_ns, source, measurement.time_ns)
        pixel_dwells = state.pixel_dwells
        if isinstance(measurement, StarExposure) and measurement.pixel_dwell is not None:
            pixel_dwells = with_entry(pixel_dwells, source, measurement.pixel_dwell)
        return with_changes(
            state,
            consecutive_rejections=rejection_counts,
            last_used_ns=used_ns,
            pixel_dwells=pixel_dwells,
            unconfirmed_step=unconfirmed,
        )

    def reject_by_gate(
        self, state: FilterState, decision: AttitudeDecision, linearised: LinearisedMeasurement
    ) -> tuple[FilterState, AttitudeDecision]:
        """Return state and decision for a measurement that failed the innovation gate.

        After ``gate.conflict_after`` consecutive rejections the reason is a conflict, and the text contains diagnosis
        hints. After ``gate.reopen_after`` rejections the covariance is inflated.
        """
        source, ins, compared = decision.measurement.source, linearised.ins, linearised.compared
        # The measured deck attitude is the INS attitude, rotated by the rotation from the predicted to the measured
        # device attitude.
        measured_nd = compared.rotation_nv @ compared.predicted_nv.T @ ins.rotation_nd
        rotation_n = log_rotation(measured_nd @ ins.rotation_nd.T)
        residual = AttitudeResidual(decision.measurement.time_ns, rotation_n, compared.attitude_noise_n)
        state = with_changes(
            self._count_rejection(state, source),
            rejected_residuals=with_entry(state.rejected_residuals, source, residual),
        )
        count = state.consecutive_rejections[source]
        reason, text = Reason.GATE, f"NIS {decision.nis:.1f} exceeds gate {decision.gate:.1f}"
        if count >= self._gate.conflict_after:
            reason = Reason.ATTITUDE_CONFLICT
            hint = diagnosis_hint(
                source,
                self._devices[source].heading_parameter,
                state.consecutive_rejections,
                state.last_used_ns,
                state.rejected_residuals,
                ins.rotation_nd,
                measured_nd,
            )
            text = f"{count} rejections in a row: {source} and the INS disagree{hint}"
        state, inflation_text = self._inflate_after_rejections(state, source)
        return state, replace(decision, reason=reason, accepted=False, text=text + inflation_text)


def _unconfirmed_first_star(source: str, time_ns: int) -> UnconfirmedStep:
    """Return the unconfirmed step that is set by the first accepted star measurement."""
    return UnconfirmedStep(time_ns - 1, "the attitude depends on a single star measurement", "stars", time_ns, source)

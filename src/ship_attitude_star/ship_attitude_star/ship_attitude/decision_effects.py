"""Effects of an accepted or rejected measurement on its source: counters, conflict, and inflation of the covariance.

For a lasting disagreement between a source and the INS, a diagnosis hint states the probable cause and the parameters
to check.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ship_attitude_star.ship_attitude.faults.fault_detection import ShipFaultDetector
from ship_attitude_star.ship_attitude.measurements.device import Device
from ship_attitude_star.ship_attitude.measurements.prediction import LinearisedMeasurement, NotEvaluable
from ship_attitude_star.ship_attitude.state import NO_PIXEL_DWELLS, AttitudeResidual, FilterState
from ship_estimation.fault_detection.exclusion import UnconfirmedStep, with_changes, with_entry, without_entry
from ship_estimation.innovations.gates import GateConfig, chi_square_gate, normalized_error_squared
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import FloatArray, angle_between, log_rotation, wrap_pi
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import AttitudeDecision

_HEADING_TOLERANCE_RAD: float = np.deg2rad(5.0)
"""Maximum remaining difference for a heading mistake to explain a disagreement, rad."""

_MIN_HEADING_ERROR_RAD = np.deg2rad(10.0)
"""Minimum heading difference for a hint, rad.

Near the headings 45° and 225°, heading and yaw (90° - heading) are almost equal, so yaw would explain any small
difference.
"""

_SAME_TILT_RAD = np.deg2rad(15.0)
"""Maximum tilt difference for a heading mistake, rad, because a heading mistake does not change the tilt."""

_QUARTER_TURN = 0.5 * np.pi
_REFERENCE = "reference."
_SAME_RATIO = 0.5
"""Maximum difference of two residuals that count as equal, divided by the smaller residual."""

_RECENT_NS = 10_000_000_000
"""Maximum age, at the stamp of the last rejected measurement of the source, of other measurements in a hint, ns."""

_SAME_CHI2 = chi_square_gate(0.999, 3)


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
            state = self._count_rejection(state, measurement.source)
            state, inflation_text = self._inflate_after_rejections(state, measurement.source)
            state = self._fault_detector.ins_fault.with_not_evaluable(state, measurement.time_ns)
            text += inflation_text
        return state, AttitudeDecision(measurement, rejection.reason, text=text, ins_time_ns=not_evaluable.ins_time_ns)

    def _count_rejection(self, state: FilterState, source: str) -> FilterState:
        counts = state.consecutive_rejections
        return with_changes(state, consecutive_rejections=with_entry(counts, source, counts.get(source, 0) + 1))

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
            elif not any(
                # Used at any time, even if excluded since.
                device.is_star and (name in state.last_used_ns or name in state.exclusion_counts)
                for name, device in self._devices.items()
            ):
                text = "the attitude depends on a single star measurement"
                unconfirmed = UnconfirmedStep(measurement.time_ns - 1, text, "stars", measurement.time_ns, source)
        rejection_counts, used_ns = state.consecutive_rejections, state.last_used_ns
        if rejection_counts.get(source) != 0:
            rejection_counts = with_entry(rejection_counts, source, 0)
        pixel_dwells = state.pixel_dwells
        if isinstance(measurement, StarExposure) and measurement.pixel_dwell is not None:
            pixel_dwells = with_entry(pixel_dwells, source, measurement.pixel_dwell)
        return with_changes(
            state,
            consecutive_rejections=rejection_counts,
            last_used_ns=with_entry(used_ns, source, measurement.time_ns),
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
        noise_n = compared.rotation_nv @ compared.attitude_noise_v @ compared.rotation_nv.T
        residual = AttitudeResidual(decision.measurement.time_ns, rotation_n, noise_n)
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


def diagnosis_hint(
    source: str,
    heading_parameter: str,
    consecutive_rejections: Mapping[str, int],
    last_used_ns: Mapping[str, int],
    rejected_residuals: Mapping[str, AttitudeResidual],
    ins_nd: FloatArray,
    measured_nd: FloatArray,
) -> str:
    """Return a diagnosis hint for a lasting disagreement between a source and the INS.

    Args:
        source: source that disagrees with the INS.
        heading_parameter: name of the parameter of its mounting that determines the heading.
        consecutive_rejections: number of consecutive rejections by source.
        last_used_ns: stamp of the last accepted measurement by source, ns.
        rejected_residuals: residual of the last rejected measurement by source.
        ins_nd: attitude of the deck by the INS, shape (3, 3).
        measured_nd: attitude of the deck by the source, shape (3, 3).
    """
    since_ns = rejected_residuals[source].time_ns - _RECENT_NS
    consistent = [
        name
        for name, time_ns in last_used_ns.items()
        if time_ns >= since_ns and not consecutive_rejections.get(name, 0)
    ]
    inconsistent = {
        name: residual
        for name, residual in rejected_residuals.items()
        if residual.time_ns >= since_ns and consecutive_rejections.get(name, 0)
    }
    ins_confirmed = bool(consistent) and len(inconsistent) == 1
    hint = heading_hint(ins_nd, measured_nd, source, heading_parameter, ins_confirmed)
    return f"{hint}; {consistency_text(source, consistent, inconsistent)}"


def heading_hint(
    ins_nd: FloatArray, measured_nd: FloatArray, source: str, heading_parameter: str, ins_confirmed: bool
) -> str:
    """Return a hint if the headings differ by a common mistake of marine drivers; otherwise return an empty text.

    Args:
        ins_nd: attitude of the deck by the INS, shape (3, 3).
        measured_nd: attitude of the deck by the other source, shape (3, 3).
        source: the other source, for example ``reference.<name>``.
        heading_parameter: name of the parameter of its mounting that determines the heading.
        ins_confirmed: True if other sources are consistent with the INS and only ``source`` is not; then the INS is not
            the cause.
    """
    by_ins, measured = angles_from_rotation(ins_nd)[0], angles_from_rotation(measured_nd)[0]
    difference = abs(float(wrap_pi(measured - by_ins)))
    # Row 1 is the direction Up in the deck frame.
    tilt = float(angle_between(ins_nd[1], measured_nd[1]))
    # With the condition in this form, NaN gives no hint.
    if not (difference > _MIN_HEADING_ERROR_RAD and tilt < _SAME_TILT_RAD):
        return ""
    is_reference = source.startswith(_REFERENCE)
    if _is_near(by_ins + measured, _QUARTER_TURN) and (is_reference or not ins_confirmed):
        of, driver = "ins", "the INS"
        if ins_confirmed:
            of, driver = f"references.{source.removeprefix(_REFERENCE)}", source
        return f", as if heading were given as yaw (90° - heading): check {of}.convention and the driver of {driver}"
    if _is_near(difference, _QUARTER_TURN):
        ins = "" if ins_confirmed else "ins.convention, ins.installation_heading_deg and "
        return f" by about 90° in heading: check {ins}{heading_parameter}"
    if _is_near(difference, np.pi):
        ins = "" if ins_confirmed else " and ins.installation_heading_deg"
        return f" by about 180° in heading: check {heading_parameter}{ins}"
    return ""


def consistency_text(source: str, consistent: Sequence[str], inconsistent: Mapping[str, AttitudeResidual]) -> str:
    """Return a text that states which sources are consistent with the INS and which are not.

    Args:
        source: source that disagrees with the INS.
        consistent: other sources that are consistent with the INS.
        inconsistent: residuals of the sources that disagree with the INS, ``source`` included.
    """
    others = [other for other in inconsistent if other != source]
    against = f"{', '.join(sorted(inconsistent))} disagree with the INS"
    if consistent:
        agree = f"{', '.join(sorted(consistent))} {'agree' if len(consistent) > 1 else 'agrees'} with the INS"
        return f"{against}, {agree}" if others else f"only {source} differs, {agree}"
    if not others:
        return "no other source shows which of the two is faulty"
    if all(_is_same_residual(first, second) for first, second in combinations(inconsistent.values(), 2)):
        return f"only the INS differs, {against} equally"
    return f"{against} and with each other"


def _is_same_residual(first: AttitudeResidual, second: AttitudeResidual) -> bool:
    """True if two residuals are equal within half the smaller residual, or within their noise."""
    difference = first.turn_n - second.turn_n
    size = min(float(np.linalg.norm(first.turn_n)), float(np.linalg.norm(second.turn_n)))
    if float(np.linalg.norm(difference)) <= _SAME_RATIO * size:
        return True
    noise_n = first.noise_n + second.noise_n
    return bool(noise_n.any()) and bool(normalized_error_squared(difference, noise_n) <= _SAME_CHI2)


def _is_near(angle: float, target: float) -> bool:
    return abs(float(wrap_pi(angle - target))) < _HEADING_TOLERANCE_RAD

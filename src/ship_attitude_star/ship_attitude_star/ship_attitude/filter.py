"""Error-state Kalman filter of the ship attitude, from state and measurement to next state and decision."""

import math
from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.config import SOURCE_STAR_COMMON, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.decision_effects import DecisionEffects
from ship_attitude_star.ship_attitude.faults.fault_detection import ShipFaultDetector
from ship_attitude_star.ship_attitude.measurements.device import ComparedMeasurement
from ship_attitude_star.ship_attitude.measurements.prediction import (
    Linearisation,
    LinearisedMeasurement,
    NotEvaluable,
)
from ship_attitude_star.ship_attitude.model import INS, SOURCE_DEFLECTION, SOURCE_INS, ShipStateModel
from ship_attitude_star.ship_attitude.state import NO_PIXEL_DWELLS, FilterState
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.fault_detection.exclusion import UnconfirmedStep, with_changes, with_entry
from ship_estimation.fault_detection.subfilters import FilterInnovations, add_error, subfilter_innovations
from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.plausibility.checked_ins import InsChange
from ship_estimation.rejection_rules import Reason, Rejection, singular_covariance
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack, ExtraNoise
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.field_scale import check_estimated_focal_length
from ship_stars.attitude_samples import AttitudeDecision, AttitudeMeasurement
from ship_stars.camera.errors import SOURCE_OPTICS
from ship_stars.sky.sky_model import SkyModel

_MAX_CLOCK_STEP_SIGMAS = 8.0
"""Maximum clock step of the INS that can be estimated, in standard deviations of the configured clock offset."""

_AGAINST_PREDICTION = (Reason.GATE, Reason.ATTITUDE_CONFLICT, Reason.MISIDENTIFIED, Reason.UNIDENTIFIED)
"""Reasons of rejections after which a measurement may still be accepted with another predicted state."""


class ShipFilter:
    """Kalman filter for a configuration, without a stored state: each step receives a state and returns the next state.

    Args:
        config: configuration of the node.
        vertical: vertical along the track; None if the configuration does not need it.
        records_updates: True to record in the state the update by each accepted measurement, for smoothing. The
            smoothing core records the changes of the INS.
    """

    def __init__(
        self, config: ShipAttitudeConfig, vertical: VerticalTrack | None = None, records_updates: bool = False
    ) -> None:
        self.model, self.vertical = ShipStateModel(config), vertical
        self.devices = config.devices
        deflection_track = vertical if config.models_deflection else None
        self.linearisation = Linearisation(self.model, self.devices, deflection_track)
        self.fault_detector = ShipFaultDetector(config, self.model, self.devices)
        self.fault_detector.records_updates = records_updates
        self._effects = DecisionEffects(config.gate, self.devices, self.fault_detector)
        self._gate_probability = config.gate.probability
        self._ins_index = self.model.sources.index(SOURCE_INS)
        self._deflection_index = self.model.source_indices.get(SOURCE_DEFLECTION, self._ins_index)
        self._common_index = self.model.sources.index(SOURCE_STAR_COMMON) if config.star_sensors else -1

    def initial_state(self) -> FilterState:
        """Return the state before any measurement, with the configured covariance."""
        return self.fault_detector.initial_state(np.zeros(self.model.size), self.model.initial_covariance_by_source())

    def propagate(self, state: FilterState, time_ns: int) -> FilterState:
        """Propagate a state to a later time; return it unchanged if the time is not later."""
        if state.time_ns is None:
            return self._initialise(state, time_ns)
        if time_ns <= state.time_ns:
            return state
        dt_s = (time_ns - state.time_ns) * 1e-9
        decay, means, stack = self.model.propagate(dt_s, state.means, state.stack, "ins.attitude")
        here = None if self.vertical is None else self.vertical.at(time_ns)
        if here is not None:
            self._propagate_ins(state, means, stack, time_ns)
        for source, steady in state.common_n.items():
            common = self.model.slices[f"{source}.common"]
            new_share = 1.0 - decay.item(common.start) ** 2
            add_error(stack, len(means), self._common_index, common, new_share * steady)
        self.fault_detector.ins_fault.propagate(state, stack, dt_s)
        return with_changes(state, time_ns=time_ns, means=means, stack=stack, vertical=here)

    def _initialise(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the initial state at its first time; the vertical at this time initialises the INS error process."""
        if self.vertical is None:
            return with_changes(state, time_ns=time_ns)
        assert self.model.ins_process is not None
        here = self.vertical.at(time_ns)
        initial_mean, covariance = self.model.ins_process.initial_state(here)
        means, stack = state.means.copy(), state.stack.copy()
        means[:, self.model.process_indices] += initial_mean
        self._inflate_process_states(stack, len(means), self._deflection_index, covariance)
        return with_changes(state, time_ns=time_ns, means=means, stack=stack, vertical=here)

    def _propagate_ins(self, state: FilterState, means: FloatArray, stack: FloatArray, time_ns: int) -> None:
        """Propagate the states of the INS error process from the time of a state to a later time, in place."""
        process, indices, before = self.model.ins_process, self.model.process_indices, state.vertical
        assert process is not None
        assert before is not None
        assert state.time_ns is not None
        assert self.vertical is not None
        propagation = process.propagation(state.time_ns, before, [time_ns], self.vertical)
        means[:, indices] = process.propagated_means(means[:, indices], before, propagation)[0]
        (transition,) = propagation.transition
        stack[:, indices] = transition @ stack[:, indices]
        stack[:, :, indices] = stack[:, :, indices] @ transition.T
        self._inflate_process_states(stack, len(means), self._ins_index, propagation.ins_noise[0])
        self._inflate_process_states(stack, len(means), self._deflection_index, propagation.deflection_noise[0])

    def _inflate_process_states(
        self, stack: FloatArray, count: int, source_index: int, process_covariance: FloatArray
    ) -> None:
        """Inflate the covariance of the states of the INS error process in all filters, in place."""
        indices, covariance = self.model.process_indices, np.zeros((self.model.size, self.model.size))
        covariance[indices[:, None], indices] = process_covariance
        add_error(stack, count, source_index, slice(None), covariance)

    def apply_ins_change(self, state: FilterState, change: InsChange) -> FilterState:
        """Inflate the covariance for a jump of the INS or a change of its noise; exclude a drifting INS if possible.

        The clocks of the INS and of a device may differ, so a measurement with a stamp before the jump may match an INS
        attitude after the jump. Therefore the inflation takes effect before the jump (:meth:`change_effective_ns`). A
        later measurement that matches an INS attitude before the jump is rejected.
        """
        if isinstance(change, ExtraNoise):
            return self._with_uncertain_clock(state, change)
        effective_ns = self.change_effective_ns(change)
        state = self.propagate(state, effective_ns)
        if change.is_drift:
            state = self.fault_detector.exclude_drifting_ins(state, effective_ns)
            if INS in state.excluded:
                return state
        state = self.fault_detector.reset_for_ins_jump(state, effective_ns)
        stack, means, count = state.stack.copy(), state.means, len(state.means)
        ins_attitude, clock = self.model.slices["ins.attitude"], self.model.blocks["ins.time_offset"]
        # A small clock step is estimated as a clock offset. After a larger step the INS and the ship rotate differently
        # at one stamp, so no offset is estimated.
        if abs(change.clock_s) <= _MAX_CLOCK_STEP_SIGMAS * clock.sigma[0]:
            both = np.r_[self.model.state_indices("ins.attitude"), self.model.state_indices(clock.name)]
            moved, shared = change.shared_with_clock
            means, covariance = means.copy(), np.zeros((self.model.size, self.model.size))
            means[:, both] += moved
            covariance[both[:, None], both] = shared
            add_error(stack, count, self._ins_index, slice(None), covariance)
        else:
            add_error(stack, count, self._ins_index, ins_attitude, change.covariance_n)
            if change.is_clock_step:
                state = self.fault_detector.ins_fault.exclude_for_clock_step(state, effective_ns)
        return with_changes(
            state,
            means=means,
            stack=stack,
            pixel_dwells=NO_PIXEL_DWELLS,
            unconfirmed_step=_unconfirmed_ins_jump(effective_ns),
            ins_jump_ns=change.time_ns,
            ins_fault_ns=change.time_ns,
        )

    def change_effective_ns(self, change: InsChange) -> int:
        """Return the stamp from which the covariance is inflated for a change of the INS, ns."""
        return change.time_ns - round(self.linearisation.longest_shift_s * SECOND_NS)

    def _with_uncertain_clock(self, state: FilterState, noise: ExtraNoise) -> FilterState:
        """Inflate the covariance of the INS clock offset where the noise of the INS stamps changes.

        The mean delay of the stamps may change as well.
        """
        clock = self.model.blocks["ins.time_offset"]
        if not (noise.clock_sigma_s > 0.0 and clock.sigma[0] > 0.0):
            return state
        state = self.propagate(state, self.change_effective_ns(noise))
        stack, offset = state.stack.copy(), self.model.slices[clock.name]
        add_error(stack, len(state.means), self._ins_index, offset, np.array([[noise.clock_sigma_s**2]]))
        return with_changes(state, stack=stack)

    def step(
        self,
        state: FilterState,
        measurement: Measurement,
        track: AttitudeTrack,
        sky_model: SkyModel | None,
        may_wait: bool = False,
    ) -> tuple[FilterState, AttitudeDecision] | None:
        """Propagate the state to a measurement, evaluate the measurement, and update the state after acceptance.

        A measurement in a gap of the track is rejected. If no filter uses the measurement, all filters stay
        bit-identical and are not propagated; only counters and innovation means change.

        The optics of a camera may have changed due to temperature or shock. If the stars of an exposure are rejected,
        they are compared again with an inflated covariance of the optics. An exposure that implies a focal length far
        from the configured focal length is rejected.

        Args:
            state: state after the previous measurement.
            measurement: measurement of any kind.
            track: attitudes of the INS.
            sky_model: sky model; None if no sensor needs it.
            may_wait: True if INS samples may still arrive.

        Returns:
            The next state and the decision; None if the measurement needs INS samples that may still arrive.
        """
        result = self._step(state, measurement, track, sky_model, may_wait)
        optics = self.model.slices.get(f"{measurement.source}.optics")
        if result is None or optics is None or not isinstance(measurement, StarExposure):
            return result
        if result[1].reason in _AGAINST_PREDICTION:
            again = self._step(self._with_inflated_optics(state, optics), measurement, track, sky_model)
            if again is not None and again[1].reason not in _AGAINST_PREDICTION:
                result = again
            elif again is not None and not again[1].components:
                # The stars contradict each other with these optics too, so the attitude is not evaluated.
                rejection = Rejection(again[1].reason, again[1].text)
                return self._effects.reject(state, measurement, NotEvaluable(rejection, again[1].ins_time_ns))
        contradiction = self._optics_contradiction(result[0], measurement, optics)
        if contradiction is not None:
            return self._effects.reject(state, measurement, NotEvaluable(contradiction, result[1].ins_time_ns))
        return result

    def _step(
        self,
        state: FilterState,
        measurement: Measurement,
        track: AttitudeTrack,
        sky_model: SkyModel | None,
        may_wait: bool = False,
    ) -> tuple[FilterState, AttitudeDecision] | None:
        """Perform :meth:`step` with the optics as estimated in ``state``."""
        if self._is_latitude_missing(measurement.time_ns):
            # An assumed latitude would cause estimation errors that last longer than the wait for a fix.
            missing = Rejection(Reason.NO_FIX, "no position fix yet: ins.model 'schuler' needs the latitude (gnss/fix)")
            return self._effects.reject(state, measurement, NotEvaluable(missing, measurement.time_ns))
        predicted = self.propagate(state, measurement.time_ns)
        compared = measurement
        if isinstance(measurement, StarExposure):
            compared = measurement.with_pixel_dwell(state.pixel_dwells.get(measurement.source))
        linearised = self.linearisation.linearise(
            compared, predicted.mean, predicted.covariance, state.last_used_ns, track, sky_model, may_wait
        )
        if linearised is None:
            return None
        if isinstance(linearised, NotEvaluable):
            return self._effects.reject(state, measurement, linearised)
        if state.ins_jump_ns is not None and linearised.matched_ins_ns <= state.ins_jump_ns:
            before = Rejection(Reason.GAP, "the INS attitude at this time is from before the last jump of the INS")
            return self._effects.reject(state, measurement, NotEvaluable(before, linearised.ins_time_ns))
        if isinstance(linearised.measurement, AttitudeMeasurement):
            predicted = self._with_common_error(predicted, linearised.measurement)
        return self._evaluate(state, predicted, measurement, linearised)

    def _optics_contradiction(self, state: FilterState, exposure: StarExposure, optics: slice) -> Rejection | None:
        """Return the rejection of an exposure that contradicts the configured focal length; None for any other."""
        if exposure.optics is None:
            return None
        variance = float(state.covariance_by_source[:, optics.start, optics.start].sum())
        return check_estimated_focal_length(exposure.optics, state.mean.item(optics.start), variance)

    def _with_inflated_optics(self, state: FilterState, optics: slice) -> FilterState:
        """Inflate the covariance of the optics by the prior variance and the square of the estimated change."""
        stack, estimated = state.stack.copy(), state.mean[optics]
        source_index = self.model.source_indices[SOURCE_OPTICS]
        # The states of the optics are in units of their prior sigma.
        add_error(stack, len(state.means), source_index, optics, np.diag(1.0 + estimated**2))
        return with_changes(state, stack=stack)

    def _evaluate(
        self, state: FilterState, predicted: FilterState, measurement: Measurement, linearised: LinearisedMeasurement
    ) -> tuple[FilterState, AttitudeDecision]:
        """Evaluate a linearised measurement by the gate of each filter, update the filters and detect faults.

        Args:
            state: state before the measurement.
            predicted: ``state`` propagated to the time of the measurement.
            measurement: the measurement.
            linearised: the linearised measurement.

        Returns:
            The next state and the decision.
        """
        linear, source = linearised.compared.linear, measurement.source
        gate = chi_square_gate(self._gate_probability, len(linear.residual))
        try:
            predicted, innovations = self._innovations_after_inflation(predicted, source, linearised.compared, gate)
        except np.linalg.LinAlgError:
            singular = NotEvaluable(singular_covariance(), linearised.ins_time_ns)
            return self._effects.reject(state, measurement, singular)
        # NaN is not accepted.
        accepted = innovations.nis <= gate
        decision = AttitudeDecision(
            measurement=measurement,
            reason=Reason.NONE,
            accepted=bool(accepted[0]) and source not in state.excluded,
            ins_time_ns=linearised.ins_time_ns,
            residual=linear.residual,
            sigma=np.sqrt(innovations.covariance[0].diagonal()),
            components=linearised.compared.components,
            covariance=innovations.covariance[0],
            noise=linear.noise,
            nis=float(innovations.nis[0]),
            gate=gate,
            rejected_parts=linearised.compared.rejected_stars,
        )
        after = self.fault_detector.update_filters(
            state, predicted, measurement, linearised.compared, innovations, accepted
        )
        if decision.accepted:
            after = self._effects.record_accepted(after, linearised.measurement)
        elif source in state.excluded and (accepted[0] or state.excluded[source].offset is None):
            decision = replace(decision, reason=Reason.EXCLUDED)
        else:
            after, decision = self._effects.reject_by_gate(after, decision, linearised)
        ins, detector = linearised.ins.sample, self.fault_detector
        rates_ns = None if ins is None or ins.rate_d is None else linearised.ins_time_ns
        if self.devices[source].is_star and not (accepted[0] or detector.is_ins_confirmed(after, rates_ns)):
            # The rates of the INS do not rule out that it has jumped.
            after = with_changes(after, unconfirmed_step=_unconfirmed_ins_jump(measurement.time_ns))
        after, text = detector.detect_faults(after, source, innovations, rates_ns, measurement.time_ns)
        return after, self._with_fault_text(decision, after, text) if text else decision

    def _is_latitude_missing(self, time_ns: int) -> bool:
        """True if the propagation of the INS error needs a latitude that is not known yet."""
        process = self.model.ins_process
        if process is None or self.vertical is None or not process.needs_latitude:
            return False
        return math.isnan(self.vertical.at(time_ns).latitude)

    def _innovations_after_inflation(
        self, predicted: FilterState, source: str, compared: ComparedMeasurement, gate: float
    ) -> tuple[FilterState, FilterInnovations]:
        """Return the innovations of all filters, where necessary after an inflation of the INS error covariance.

        A filter that does not use the INS must not reject measurements because of a change of the INS error
        (:meth:`~ship_attitude_star.ship_attitude.faults.ins_fault_handling.InsFaultHandling.inflate_against`).

        Args:
            predicted: state propagated to the time of the measurement.
            source: source of the measurement.
            compared: the measurement compared with the main filter.
            gate: threshold of the NIS.

        Returns:
            The state, with the inflated covariances, and the innovations.
        """
        linear, rotation_jacobian, at_mean = compared.linear, compared.rotation_jacobian, predicted.means[0]
        innovations = subfilter_innovations(predicted.means, predicted.stack, linear, at_mean, rotation_jacobian)
        # NaN inflates nothing, and is rejected by the gate afterwards.
        if not (innovations.nis > gate).any():
            return predicted, innovations
        inflated, subfilters = self.fault_detector.ins_fault.inflate_against(
            predicted, source, innovations, compared.predicted_nv, gate
        )
        if not subfilters:
            return predicted, innovations
        inflated_innovations = subfilter_innovations(predicted.means, inflated, linear, at_mean, rotation_jacobian)
        # Fault detection uses the innovations from before the inflation.
        whitened, root = inflated_innovations.whitened_innovation.copy(), inflated_innovations.whitening_root.copy()
        whitened[subfilters] = innovations.whitened_innovation[subfilters]
        root[subfilters] = innovations.whitening_root[subfilters]
        mixed = inflated_innovations._replace(whitened_innovation=whitened, whitening_root=root)
        return with_changes(predicted, stack=inflated), mixed

    def _with_fault_text(self, decision: AttitudeDecision, state: FilterState, text: str) -> AttitudeDecision:
        """Return the decision with the text of fault detection; a rejection if the source is excluded now."""
        if decision.measurement.source in state.excluded and decision.reason in (Reason.NONE, Reason.EXCLUDED):
            return replace(decision, accepted=False, reason=Reason.EXCLUDED, text=text)
        return replace(decision, text=f"{text}; {decision.text}" if decision.text else text)

    def _with_common_error(self, state: FilterState, measurement: AttitudeMeasurement) -> FilterState:
        """Return the state with the covariance of a sensor's correlated error as stated in its message.

        The first message sets the covariance of the states of the common error. Later messages set only the
        steady-state covariance, which these states approach with their time constant.
        """
        stack, source, common_n = state.stack, measurement.source, measurement.common_n
        is_zero = not any(common_n.ravel().tolist())
        if source not in state.common_n:
            if is_zero:
                return state
            stack = stack.copy()
            common = self.model.slices[f"{source}.common"]
            add_error(stack, len(state.means), self._common_index, common, common_n)
        elif is_zero or common_n.tobytes() == state.common_n[source].tobytes():
            return state
        return with_changes(state, stack=stack, common_n=with_entry(state.common_n, source, common_n))


def _unconfirmed_ins_jump(since_ns: int) -> UnconfirmedStep:
    return UnconfirmedStep(since_ns, "the INS has jumped, or may have jumped", "stars")

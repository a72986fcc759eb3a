"""The error-state filter: one measurement in, one decision and the next state out. No time, no memory of its own.

A :class:`FilterState` is never changed in place, so that the time-ordered log can keep and return to any of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from ship_attitude_star.guards.hints import Departure, who_is_wrong
from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeMeasurement
from ship_attitude_star.ship_attitude.comparison import Compared, compare
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import (
    SOURCE_INS,
    SOURCE_INTERPOLATION,
    SOURCE_STAR_COMMON,
    Device,
    devices,
    ins_time_of,
    predict_attitude,
    state_model,
)
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_estimation.gates import GateConfig, chi_square_gate
from ship_estimation.ins import InsJump
from ship_estimation.kalman import LinearMeasurement, innovation, predict, slow_error_later, update
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_geometry.exposure_mean import turning_over
from ship_geometry.rotations import FloatArray, log_rotation

Value = TypeVar("Value")

_STEPS = 5
_LARGE_STEP = 5e-3
"""The square of a smaller correction (rad) is nothing beside the errors of what was measured."""


@dataclass(frozen=True)
class FilterState:
    """Everything the filter knows after its last measurement.

    Attributes:
        time_ns: moment of the state; None before the first measurement.
        mean: estimated errors, shape (n,).
        parts: covariance by source, shape (n_sources, n, n).
        common_n: by star sensor, the steady covariance of its common error, rad², horizon frame.
        refusals: by source, its refusals in a row.
        used_ns: by source, the stamp of its last measurement used.
        jumped: whether the INS has jumped since the last star measurement used.
        departures: by source, its last measurement refused.
    """

    time_ns: int | None
    mean: FloatArray
    parts: FloatArray
    common_n: MappingProxyType[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    refusals: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    used_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    jumped: bool = False
    departures: MappingProxyType[str, Departure] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors, shape (n, n)."""
        total: FloatArray = self.parts.sum(axis=0)
        return total


class ShipFilter:
    """The model of a configuration and the step from state to state.

    Args:
        config: the node's configuration.
    """

    def __init__(self, config: ShipAttitudeConfig) -> None:
        self.model = state_model(config)
        self.devices: dict[str, Device] = devices(config)
        self._gate: GateConfig = config.gate
        self._interpolation_index = self.model.sources.index(SOURCE_INTERPOLATION)

    @property
    def longest_shift_s(self) -> float:
        """Bound on how far the INS's stamp of an attitude may lie from a device's: configured offsets and 5 sigma."""
        return max((self._longest_shift_s(device) for device in self.devices.values()), default=0.0)

    def _longest_shift_s(self, device: Device) -> float:
        sigma_s = [self.model.blocks[name].sigma[0] for name, _ in device.ins_time_states]
        return abs(device.ins_time_s) + 5.0 * float(np.linalg.norm(sigma_s))

    def initial_state(self) -> FilterState:
        """The state before any measurement: no error known, all of them possible."""
        return FilterState(None, np.zeros(self.model.size), self.model.initial_parts())

    def ins_time_ns(self, state: FilterState, measurement: Measurement) -> int:
        """Stamp (ns) of the INS for the attitude that was measured."""
        device = self.devices[measurement.source]
        return ins_time_of(device, self.model, state.mean, measurement.time_ns)

    def predicted(self, state: FilterState, time_ns: int) -> FilterState:
        """The state carried to a later moment."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        dt_s = max(time_ns - state.time_ns, 0) * 1e-9
        decay, noise = self.model.transition(dt_s)
        parts = predict(state.parts, decay, self.model.booked_noise(noise))
        for source, steady in state.common_n.items():
            rows = self.model.slices[f"{source}.common"]
            fresh = 1.0 - decay[rows.start] ** 2
            parts[self._common_index, rows, rows] += fresh * steady
        mean, rows = decay * state.mean, self.model.slices["ins.attitude"]
        mean[rows] = self.ins_error(state.mean[rows], decay[rows])
        return replace(state, time_ns=max(time_ns, state.time_ns), mean=mean, parts=parts)

    def ins_error(self, error_n: FloatArray, decay: FloatArray) -> FloatArray:
        """The INS's slow error later, shape (3,)."""
        return slow_error_later(error_n, decay, self.model.blocks["ins.attitude"].sigma)

    def opened(self, state: FilterState, jump: InsJump) -> FilterState:
        """The state after a jump of the INS: its slow error may be as large as that."""
        state = self.predicted(state, jump.time_ns)
        rows, parts = self.model.slices["ins.attitude"], state.parts.copy()
        parts[self.model.sources.index(SOURCE_INS), rows, rows] += jump.covariance_n
        return replace(state, parts=parts, jumped=True)

    def step(
        self,
        state: FilterState,
        measurement: Measurement,
        track: AttitudeTrack,
        watch: SkyWatch | None,
        may_wait: bool = False,
    ) -> tuple[FilterState, AttitudeDecision] | None:
        """Predict to the measurement, judge it, and use it where the gate lets it pass.

        The track must span the moment of the measurement; in a gap of it the measurement is refused.

        Args:
            state: after the measurement before.
            measurement: to be used.
            track: attitudes of the INS.
            watch: the sky; None where no sensor needs it.
            may_wait: whether samples of the INS may still come.

        Returns:
            The next state and the decision; None where samples that may still come belong to the measurement.
        """
        ins_time_ns = self.ins_time_ns(state, measurement)
        if may_wait and not track.covers(ins_time_ns + measurement.reach_ns):
            return None
        ins = track.at(ins_time_ns)
        if ins is None:
            text = "no INS samples on both sides of it: it cannot be compared"
            return state, AttitudeDecision(measurement, Reason.GAP, text=text, ins_time_ns=ins_time_ns)
        device = self.devices[measurement.source]
        looked = self._looked_at(measurement, device, track, ins, ins_time_ns, watch)
        if isinstance(looked, Refusal):
            return state, AttitudeDecision(measurement, looked.reason, text=looked.text, ins_time_ns=ins_time_ns)
        looked_at, ins = looked
        before, state = state, self._with_common(self.predicted(state, measurement.time_ns), looked_at)
        predicted = predict_attitude(device, self.model, state.mean, ins)
        compared = compare(looked_at, predicted, self.model, state.mean, state.covariance, watch)
        if isinstance(compared, Refusal):
            return before, AttitudeDecision(measurement, compared.reason, text=compared.text, ins_time_ns=ins_time_ns)
        linear = self._linear(compared, device, compared.residual)
        try:
            covariance, nis = innovation(state.parts, linear)
        except np.linalg.LinAlgError as error:
            refused = AttitudeDecision(measurement, Reason.BAD_COVARIANCE, text=str(error), ins_time_ns=ins_time_ns)
            return before, refused
        decision = AttitudeDecision(
            measurement=measurement,
            reason=Reason.NONE,
            accepted=True,
            ins_time_ns=ins_time_ns,
            residual=linear.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            components=compared.components,
            nis=nis,
            gate=chi_square_gate(self._gate.probability, len(linear.residual)),
            left_out=compared.left_out,
        )
        # Written so that NaN fails.
        if not nis <= decision.gate:
            # Not even the prediction is kept: the state stays, to the last bit, as without this measurement.
            # The deck as the measurement has it: the predicted deck turned as the predicted device must be.
            measured_nd = compared.rotation_nv @ predicted.rotation_nv.T @ ins.rotation_nd
            return self._refused(before, decision, compared.attitude_noise_n, ins.rotation_nd, measured_nd)

        def linearised(mean: FloatArray) -> LinearMeasurement | None:
            there = predict_attitude(device, self.model, mean, ins)
            compared = compare(looked_at, there, self.model, mean, state.covariance, watch)
            if isinstance(compared, Refusal):
                return None
            return self._linear(compared, device, compared.residual + compared.jacobian @ (mean - state.mean))

        return self._used(state, device, measurement, *self._updated(state, linear, covariance, linearised)), decision

    def _linear(self, compared: Compared, device: Device, residual: FloatArray) -> LinearMeasurement:
        """What was compared as the Kalman step takes it, its noise by source."""
        source_index = self.model.sources.index(device.noise_source)
        noise = {source_index: compared.noise, self._interpolation_index: compared.interpolation}
        return LinearMeasurement(residual, compared.jacobian, noise)

    @staticmethod
    def _used(
        state: FilterState, device: Device, measurement: Measurement, correction: FloatArray, parts: FloatArray
    ) -> FilterState:
        """The state after a measurement that passed the gate."""
        return replace(
            state,
            mean=state.mean + correction,
            parts=parts,
            refusals=_with(state.refusals, device.name, 0),
            used_ns=_with(state.used_ns, device.name, measurement.time_ns),
            jumped=state.jumped and not device.is_star,
        )

    @staticmethod
    def _looked_at(
        measurement: Measurement,
        device: Device,
        track: AttitudeTrack,
        ins: InterpolatedAttitude,
        ins_time_ns: int,
        watch: SkyWatch | None,
    ) -> tuple[Measurement, InterpolatedAttitude] | Refusal:
        """What of a measurement is compared, and with which attitude of the INS; or why it cannot be."""
        if isinstance(measurement, InertialAttitude):
            assert watch is not None
            turned = in_horizon(measurement, watch)
            return turned if isinstance(turned, Refusal) else (turned, ins)
        if isinstance(measurement, StarExposure) and measurement.length is not None:
            turning = turning_over(track, ins_time_ns, measurement.length.nodes)
            if turning is None:
                text = f"no INS samples over its whole exposure of {measurement.length.exposure_s:g} s"
                return Refusal(Reason.GAP, text)
            # What is predicted is the mean over the exposure: its errors are those of the mean.
            ins = replace(ins, noise_gain=turning.noise_gain, error_covariance_d=turning.error_covariance)
            return at_middle(measurement, turning.mounted(device.rotation_dv0)), ins
        return measurement, ins

    def _updated(
        self,
        state: FilterState,
        linear: LinearMeasurement,
        covariance: FloatArray,
        linearised: Callable[[FloatArray], LinearMeasurement | None],
    ) -> tuple[FloatArray, FloatArray]:
        """Correction of the mean and parts of the covariance after a measurement.

        Where the INS is found to be far off, as after a jump, the measurement is linearised anew at the estimate until
        that stays (Gauss–Newton).
        """
        rows, found_n = self.model.slices["ins.attitude"], np.zeros(3)
        for _ in range(_STEPS):
            correction, parts = update(state.parts, linear, covariance)
            step = float(np.linalg.norm(correction[rows] - found_n))
            there = linearised(state.mean + correction) if step > _LARGE_STEP else None
            if there is None:
                break
            linear, found_n = there, correction[rows]
            covariance, _ = innovation(state.parts, linear)
        return correction, parts

    @property
    def _common_index(self) -> int:
        return self.model.sources.index(SOURCE_STAR_COMMON)

    def _with_common(self, state: FilterState, measurement: Measurement) -> FilterState:
        """The common error of this sensor's messages, as large as the message says."""
        if not isinstance(measurement, AttitudeMeasurement) or not measurement.common_n.any():
            return state
        parts = state.parts
        if measurement.source not in state.common_n:
            rows = self.model.slices[f"{measurement.source}.common"]
            parts = parts.copy()
            parts[self._common_index, rows, rows] += measurement.common_n
        return replace(
            state, parts=parts, common_n=_with(state.common_n, measurement.source, measurement.common_n)
        )

    def _refused(
        self,
        state: FilterState,
        decision: AttitudeDecision,
        noise_n: FloatArray,
        ins_nd: FloatArray,
        measured_nd: FloatArray,
    ) -> tuple[FilterState, AttitudeDecision]:
        """Hold the estimate; after a run of refusals say so and, where configured, re-open the gate."""
        source, turn_n = decision.measurement.source, log_rotation(measured_nd @ ins_nd.T)
        departure = Departure(decision.measurement.time_ns, turn_n, noise_n)
        run = state.refusals.get(source, 0) + 1
        state = replace(
            state,
            refusals=_with(state.refusals, source, run),
            departures=_with(state.departures, source, departure),
        )
        reason, text = Reason.GATE, f"improbable: NIS {decision.nis:.1f} > gate {decision.gate:.1f}"
        if run >= self._gate.conflict_after:
            reason = Reason.ATTITUDE_CONFLICT
            who = who_is_wrong(source, state.refusals, state.used_ns, state.departures, ins_nd, measured_nd)
            text = f"{run} refusals in a row: {source} and the INS disagree{who}"
        if self._gate.reopen_after and run % self._gate.reopen_after == 0:
            state = replace(state, parts=state.parts * self._gate.reopen_factor)
            text += f"; gate re-opened: covariance times {self._gate.reopen_factor:g}"
        return state, replace(decision, reason=reason, accepted=False, text=text)


def _with(mapping: MappingProxyType[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    return MappingProxyType({**mapping, key: value})

"""The error-state filter: one measurement in, one decision and the next state out. No time, no memory of its own.

A :class:`FilterState` is never changed in place, so that the time-ordered log can keep and return to any of them.
"""

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from ship_attitude_star.guards.hints import Departure, who_is_wrong
from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeMeasurement
from ship_attitude_star.ship_attitude.comparison import Compared, compare, predict_attitude
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import SOURCE_INS, SOURCE_STAR_COMMON, Device, ShipStateModel, devices
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_estimation.gates import GateConfig, chi_square_gate
from ship_estimation.ins import InsJump
from ship_estimation.kalman import innovation, predict, slow_error_later, update
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal, singular_covariance
from ship_geometry.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_geometry.exposure_mean import turning_over
from ship_geometry.rotations import FloatArray, log_rotation
from ship_geometry.time_scales import SECOND_NS

Value = TypeVar("Value")

_STEPS = 5
_LARGE_STEP = 5e-3
"""The square of a smaller correction (rad) is nothing beside the errors of what was measured."""


@dataclass(frozen=True)
class FilterState:
    """Everything the filter knows after its last measurement.

    :meth:`ShipFilter.predicted` and :meth:`ShipFilter.opened` take ``mean`` and ``parts`` with leading axes (...) too,
    one entry for each of several hypotheses; a measurement is compared with one of them.

    Attributes:
        time_ns: moment of the state; None before the first measurement.
        mean: estimated errors, shape (..., n).
        parts: covariance by source, shape (..., n_sources, n, n).
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
        """Covariance of the errors, shape (..., n, n)."""
        total: FloatArray = self.parts.sum(axis=-3)
        return total


class ShipFilter:
    """The model of a configuration and the step from state to state.

    Args:
        config: the node's configuration.
    """

    def __init__(self, config: ShipAttitudeConfig) -> None:
        self.model = ShipStateModel(config)
        self.devices: dict[str, Device] = devices(config)
        self._gate: GateConfig = config.gate
        self._ins_index = self.model.sources.index(SOURCE_INS)
        self._common_index = self.model.sources.index(SOURCE_STAR_COMMON) if config.star_sensors else -1

    @property
    def longest_shift_s(self) -> float:
        """Bound on how far the INS's stamp of an attitude may lie from a device's: configured offsets and 5 sigma."""
        longest_s = 0.0
        for device in self.devices.values():
            sigma_s = [self.model.blocks[name].sigma[0] for name, _ in device.ins_time_states]
            longest_s = max(longest_s, abs(device.ins_time_s) + 5.0 * float(np.linalg.norm(sigma_s)))
        return longest_s

    def initial_state(self) -> FilterState:
        """The state before any measurement: no error known, all of them possible."""
        return FilterState(None, np.zeros(self.model.size), self.model.initial_parts())

    def ins_time_ns(self, state: FilterState, measurement: Measurement) -> int:
        """Stamp (ns) of the INS for the attitude that was measured."""
        device = self.devices[measurement.source]
        shift_s = device.ins_time_s
        for name, sign in device.ins_time_states:
            shift_s += sign * state.mean[self.model.slices[name]][0]
        return measurement.time_ns + round(shift_s * SECOND_NS)

    def predicted(self, state: FilterState, time_ns: int) -> FilterState:
        """The state carried to a later moment."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        decay, noise = self.model.transition(max(time_ns - state.time_ns, 0) * 1e-9)
        parts = predict(state.parts, decay, self.model.booked_noise(noise))
        for source, steady in state.common_n.items():
            rows = self.model.slices[f"{source}.common"]
            fresh = 1.0 - decay[rows.start] ** 2
            parts[..., self._common_index, rows, rows] += fresh * steady
        mean, rows = decay * state.mean, self.model.slices["ins.attitude"]
        sigma = self.model.blocks["ins.attitude"].sigma
        mean[..., rows] = slow_error_later(state.mean[..., rows], decay[rows], sigma)
        return replace(state, time_ns=max(time_ns, state.time_ns), mean=mean, parts=parts)

    def opened(self, state: FilterState, jump: InsJump) -> FilterState:
        """The state after a jump of the INS: its slow error may be as large as that."""
        state = self.predicted(state, jump.time_ns)
        rows, parts = self.model.slices["ins.attitude"], state.parts.copy()
        parts[..., self._ins_index, rows, rows] += jump.covariance_n
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

        The track must span the moment of the measurement; in a gap of it the measurement is refused. Of a measurement
        that is refused not even the prediction is kept: the estimate stays, to the last bit, as without it.

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
        judged: tuple[FilterState, AttitudeDecision] | Refusal
        if ins is None:
            judged = Refusal(Reason.GAP, "no INS samples on both sides of it: it cannot be compared")
        else:
            paired = self._paired(measurement, ins, track, ins_time_ns, watch)
            judged = paired if isinstance(paired, Refusal) else self._judged(state, measurement, paired, watch)
        if isinstance(judged, Refusal):
            return state, AttitudeDecision(measurement, judged.reason, text=judged.text, ins_time_ns=ins_time_ns)
        return judged

    def _judged(
        self, state: FilterState, measurement: Measurement, paired: "_Paired", watch: SkyWatch | None
    ) -> tuple[FilterState, AttitudeDecision] | Refusal:
        """The next state and the decision; the refusal of a measurement that cannot be compared at all."""
        predicted = self.predicted(state, measurement.time_ns)
        if isinstance(paired.measurement, AttitudeMeasurement) and paired.measurement.common_n.any():
            predicted = self._with_common(predicted, paired.measurement)
        compared = self._compared(paired, predicted, predicted.mean, watch)
        if isinstance(compared, Refusal):
            return compared
        try:
            covariance, nis = innovation(predicted.parts, compared.linear)
        except np.linalg.LinAlgError:
            return singular_covariance()
        decision = AttitudeDecision(
            measurement=measurement,
            reason=Reason.NONE,
            accepted=True,
            ins_time_ns=paired.ins_time_ns,
            residual=compared.linear.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            components=compared.components,
            nis=nis,
            gate=chi_square_gate(self._gate.probability, len(compared.linear.residual)),
            left_out=compared.left_out,
        )
        # Written so that NaN fails.
        if not nis <= decision.gate:
            return self._held(state, decision, compared, paired.ins)
        updated = update(predicted.parts, compared.linear, covariance)
        return self._used(predicted, measurement, *self._settled(paired, predicted, *updated, watch)), decision

    def _paired(
        self,
        measurement: Measurement,
        ins: InterpolatedAttitude,
        track: AttitudeTrack,
        ins_time_ns: int,
        watch: SkyWatch | None,
    ) -> "_Paired | Refusal":
        """What of a measurement is compared, with the attitude of the INS that belongs to it; or why it cannot be."""
        device = self.devices[measurement.source]
        if isinstance(measurement, InertialAttitude):
            assert watch is not None
            turned = in_horizon(measurement, watch)
            return turned if isinstance(turned, Refusal) else _Paired(turned, device, ins, ins_time_ns)
        if isinstance(measurement, StarExposure) and measurement.length is not None:
            turning = turning_over(track, ins_time_ns, measurement.length.nodes)
            if turning is None:
                text = f"no INS samples over its whole exposure of {measurement.length.exposure_s:g} s"
                return Refusal(Reason.GAP, text)
            # What is predicted is the mean over the exposure: its errors are those of the mean.
            ins = replace(ins, noise_gain=turning.noise_gain, error_covariance_d=turning.error_covariance)
            return _Paired(at_middle(measurement, turning.mounted(device.rotation_dv0)), device, ins, ins_time_ns)
        return _Paired(measurement, device, ins, ins_time_ns)

    def _compared(
        self, paired: "_Paired", state: FilterState, mean: FloatArray, watch: SkyWatch | None
    ) -> Compared | Refusal:
        """A measurement against its prediction by a mean that may differ from that of the state."""
        predicted = predict_attitude(paired.device, self.model, mean, paired.ins)
        return compare(paired.measurement, paired.device, predicted, self.model, mean, state.parts, watch)

    def _settled(
        self,
        paired: "_Paired",
        state: FilterState,
        correction: FloatArray,
        parts: FloatArray,
        watch: SkyWatch | None,
    ) -> tuple[FloatArray, FloatArray]:
        """Correction and parts after a measurement, from those of its first linearisation.

        Where the INS is found to be far off, as after a jump, the measurement is linearised anew at the estimate until
        that stays (Gauss–Newton).
        """
        found = np.zeros_like(correction)
        rows = self.model.slices["ins.attitude"]
        for _ in range(_STEPS - 1):
            if not np.linalg.norm(correction[rows] - found[rows]) > _LARGE_STEP:
                break
            there = self._compared(paired, state, state.mean + correction, watch)
            if isinstance(there, Refusal):
                break
            residual = there.linear.residual + there.linear.jacobian @ (state.mean + correction - state.mean)
            linear = replace(there.linear, residual=residual)
            covariance, _ = innovation(state.parts, linear)
            found, (correction, parts) = correction, update(state.parts, linear, covariance)
        return correction, parts

    def _used(
        self, state: FilterState, measurement: Measurement, correction: FloatArray, parts: FloatArray
    ) -> FilterState:
        """The state after a measurement that passed the gate."""
        source = measurement.source
        return replace(
            state,
            mean=state.mean + correction,
            parts=parts,
            refusals=_with(state.refusals, source, 0),
            used_ns=_with(state.used_ns, source, measurement.time_ns),
            jumped=state.jumped and not self.devices[source].is_star,
        )

    def _with_common(self, state: FilterState, measurement: AttitudeMeasurement) -> FilterState:
        """The common error of this sensor's messages, as large as the message says."""
        parts = state.parts
        if measurement.source not in state.common_n:
            rows = self.model.slices[f"{measurement.source}.common"]
            parts = parts.copy()
            parts[..., self._common_index, rows, rows] += measurement.common_n
        return replace(state, parts=parts, common_n=_with(state.common_n, measurement.source, measurement.common_n))

    def _held(
        self, state: FilterState, decision: AttitudeDecision, compared: Compared, ins: InterpolatedAttitude
    ) -> tuple[FilterState, AttitudeDecision]:
        """Hold the estimate; after a run of refusals say so and, where configured, re-open the gate."""
        source = decision.measurement.source
        # The deck as the measurement has it: the predicted deck turned as the predicted device must be.
        measured_nd = compared.rotation_nv @ compared.predicted_nv.T @ ins.rotation_nd
        turn_n = log_rotation(measured_nd @ ins.rotation_nd.T)
        departure = Departure(decision.measurement.time_ns, turn_n, compared.attitude_noise_n)
        run = state.refusals.get(source, 0) + 1
        state = replace(
            state,
            refusals=_with(state.refusals, source, run),
            departures=_with(state.departures, source, departure),
        )
        reason, text = Reason.GATE, f"improbable: NIS {decision.nis:.1f} > gate {decision.gate:.1f}"
        if run >= self._gate.conflict_after:
            reason = Reason.ATTITUDE_CONFLICT
            who = who_is_wrong(source, state.refusals, state.used_ns, state.departures, ins.rotation_nd, measured_nd)
            text = f"{run} refusals in a row: {source} and the INS disagree{who}"
        if self._gate.reopen_after and run % self._gate.reopen_after == 0:
            state = replace(state, parts=state.parts * self._gate.reopen_factor)
            text += f"; gate re-opened: covariance times {self._gate.reopen_factor:g}"
        return state, replace(decision, reason=reason, accepted=False, text=text)


@dataclass(frozen=True)
class _Paired:
    """A measurement as it is compared, its device, and the attitude of the INS that belongs to it, with its stamp."""

    measurement: Measurement
    device: Device
    ins: InterpolatedAttitude
    ins_time_ns: int


def _with(mapping: MappingProxyType[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    return MappingProxyType({**mapping, key: value})

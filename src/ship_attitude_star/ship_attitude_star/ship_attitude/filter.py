"""The error-state filter: one measurement in, one decision and the next state out. No time, no memory of its own.

A :class:`FilterState` is never changed in place, so that the time-ordered log can keep and return to any of them.
"""

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from ship_attitude_star.guards.hints import Departure, who_is_wrong
from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeMeasurement
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.linearised import Linearisation, Linearised, NotCompared
from ship_attitude_star.ship_attitude.model import SOURCE_INS, SOURCE_STAR_COMMON, Device, ShipStateModel, devices
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.gates import GateConfig, chi_square_gate
from ship_estimation.ins import InsJump
from ship_estimation.kalman import innovation, predict, slow_error_later, update
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, singular_covariance
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.rotations import FloatArray, log_rotation

Value = TypeVar("Value")


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
        self.linearisation = Linearisation(self.model, self.devices)
        self._gate: GateConfig = config.gate
        self._ins_index = self.model.sources.index(SOURCE_INS)
        self._common_index = self.model.sources.index(SOURCE_STAR_COMMON) if config.star_sensors else -1

    def initial_state(self) -> FilterState:
        """The state before any measurement: no error known, all of them possible."""
        return FilterState(None, np.zeros(self.model.size), self.model.initial_parts())

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
        predicted = self.predicted(state, measurement.time_ns)
        mean, covariance = predicted.mean, predicted.covariance
        found = self.linearisation.of(measurement, mean, covariance, track, watch, may_wait)
        if found is None:
            return None
        if isinstance(found, NotCompared):
            return self._refused(state, measurement, found)
        if isinstance(found.measured, AttitudeMeasurement) and found.measured.common_n.any():
            predicted = self._with_common(predicted, found.measured)
        return self._judged(state, predicted, measurement, found)

    def _judged(
        self, state: FilterState, predicted: FilterState, measurement: Measurement, found: Linearised
    ) -> tuple[FilterState, AttitudeDecision]:
        """The next state and the decision, by the gate."""
        linear = found.compared.linear
        try:
            covariance, nis = innovation(predicted.parts, linear)
        except np.linalg.LinAlgError:
            return self._refused(state, measurement, NotCompared(singular_covariance(), found.ins_time_ns))
        decision = AttitudeDecision(
            measurement=measurement,
            reason=Reason.NONE,
            accepted=True,
            ins_time_ns=found.ins_time_ns,
            residual=linear.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            components=found.compared.components,
            covariance=covariance,
            noise=linear.noise,
            nis=nis,
            gate=chi_square_gate(self._gate.probability, len(linear.residual)),
            left_out=found.compared.left_out,
        )
        # Written so that NaN fails.
        if not nis <= decision.gate:
            return self._held(state, decision, found)
        correction, parts = update(predicted.parts, linear, covariance)
        return self._used(predicted, measurement, correction, parts), decision

    def _refused(
        self, state: FilterState, measurement: Measurement, why: NotCompared
    ) -> tuple[FilterState, AttitudeDecision]:
        """Of a measurement that cannot be compared nothing is kept."""
        refusal = why.refusal
        return state, AttitudeDecision(measurement, refusal.reason, text=refusal.text, ins_time_ns=why.ins_time_ns)

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
        self, state: FilterState, decision: AttitudeDecision, found: Linearised
    ) -> tuple[FilterState, AttitudeDecision]:
        """Hold the estimate; after a run of refusals say so and, where configured, re-open the gate."""
        source, ins, compared = decision.measurement.source, found.ins, found.compared
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


def _with(mapping: MappingProxyType[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    return MappingProxyType({**mapping, key: value})

"""INS and star attitudes in, the ship's attitude out: the core that the node and the replay share.

Knows no ROS, no files, no clock. Measurements enter in any order; within ``lag_s`` each is applied at its own time.
Arrivals and ticks are given in the time of waiting (:mod:`ship_estimation.output_order`), stamps in that of the data.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ship_attitude_star.guards.arrivals import Arrivals
from ship_attitude_star.measurements.samples import (
    AttitudeEstimate,
    AttitudeMeasurement,
    Decision,
    Measurement,
    Outcome,
)
from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.ship_attitude.alignment import (
    Alignment,
    AlignmentPrior,
    alignment_of,
    prior_of,
    state_from_prior,
)
from ship_attitude_star.ship_attitude.comparison import attitude_alone
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import FilterState, ShipFilter
from ship_attitude_star.ship_attitude.output import CorrectedIns, estimate_from_star, no_estimate
from ship_attitude_star.sky.sky_inputs import SkyInput
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.ins_guard import InsJump
from ship_estimation.output_order import OutputOrder
from ship_estimation.rate_guard import Rates
from ship_estimation.refusals import Reason, failure, same_stamp
from ship_estimation.time_ordered_log import TimeOrderedLog
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_geometry.rotations import FloatArray

_SECOND_NS = 1_000_000_000


class ShipAttitudeCore:
    """The estimator of the ship's attitude.

    Args:
        config: the node's parameters.
        watch: the sky; None where no sensor looks at it itself.
    """

    def __init__(self, config: ShipAttitudeConfig, watch: SkyWatch | None = None) -> None:
        self.config = config
        self._watch = watch
        self.filter = ShipFilter(config)
        self._start: tuple[AlignmentPrior, int] | None = None
        self._max_gap_ns = round(config.ins.max_gap_s * _SECOND_NS)
        self._longest_shift_ns = round(self.filter.longest_shift_s * _SECOND_NS)
        self._silence_ns = round(config.ins.silence_s * _SECOND_NS)
        exposes = any(star.input == "observations" for star in config.star_sensors.values())
        self._exposure_reach_ns = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns if exposes else 0
        self._order = OutputOrder()
        self.reset()

    def start_from(self, prior: AlignmentPrior, now_ns: int) -> list[str]:
        """Reset to a saved alignment; returns what is to be said of it."""
        self._start = (prior, now_ns)
        self.reset()
        return state_from_prior(self.filter, self.config, prior, now_ns)[1]

    def reset(self, clock_jumped: bool = False) -> None:
        """Forget all measurements. After a jump of the clock, outputs may start again at earlier times."""
        self._forget_estimate()
        self._track = AttitudeTrack(self._max_gap_ns)
        self._arrivals = Arrivals(self.config)
        self._ins_arrival_ns: int | None = None
        self._newest_star: tuple[Measurement, int] | None = None
        if self._watch is not None:
            self._watch.reset()
        if clock_jumped:
            self._order.restart()

    def _forget_estimate(self) -> None:
        """Back to the configured errors, or to those of the saved alignment."""
        initial = self.filter.initial_state()
        if self._start is not None:
            initial, _ = state_from_prior(self.filter, self.config, *self._start)
        self._log: TimeOrderedLog[FilterState, Measurement, Decision] = TimeOrderedLog(initial)
        self._jump: InsJump | None = None
        self._corrected = CorrectedIns(self.filter, initial)

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """Go on with other noise and gates; geometry and the set of devices stay."""
        self.config = config
        self.filter = ShipFilter(config)
        self._corrected = CorrectedIns(self.filter, self.state)
        self._arrivals.reconfigure(config)

    def add_ins(self, sample: AttitudeSample, arrival_ns: int | None = None, estimate: bool = True) -> Outcome:
        """An INS sample: stamp and attitude of the deck as the INS has it.

        Args:
            sample: attitude, and rate where the INS measures it.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
            estimate: False where only the filter's state matters, as in a Monte Carlo run.
        """
        arrival_ns = sample.time_ns if arrival_ns is None else arrival_ns
        judged = self._arrivals.judge_ins(sample, self._track)
        sample, outcome = judged.sample, Outcome(judged.refusal)
        if judged.rates_wrong_after_ns is not None:
            self._forget_rates(judged.rates_wrong_after_ns, outcome)
        if judged.refusal is not None:
            return outcome
        known = self._track.get(sample.time_ns)
        if known is not None:
            outcome.refusal = same_stamp(_ins_content(known), _ins_content(sample))
            if _ins_content(known) <= _ins_content(sample):
                return outcome
        if judged.jump is not None:
            self._log.insert((judged.jump.time_ns, judged.jump.source), judged.jump)
            self._track.cut(judged.jump.time_ns)
            self._jump = judged.jump
        changed_after_ns = self._track.insert(sample)
        if changed_after_ns is not None:
            self._rewind(changed_after_ns)
        self._advance(sample.time_ns, outcome)
        # An attitude that is moved by a clock offset needs its rate. Without it the sample leads to nothing.
        movable = self._track.newest_rate_known or self.state.time_ns is None
        if self._track.newest is sample and movable:
            self._ins_arrival_ns = arrival_ns
            if estimate and self._order.follows(sample.time_ns):
                self._put_out(outcome, sample.time_ns, self._estimate_from_ins, arrival_ns, self._silence_ns)
        return outcome

    def add_sky_input(self, sky_input: SkyInput) -> Outcome:
        """Where the ship is, or the air around it; what was compared with another sky is compared anew."""
        assert self._watch is not None
        outcome = Outcome(sky_input.refusal(self._watch))
        changed_after_ns = sky_input.insert(self._watch)
        if changed_after_ns is not None:
            self._log.rewind_where(
                lambda decision: decision.measurement.time_ns > changed_after_ns
                and not isinstance(decision.measurement, AttitudeMeasurement)
            )
            self._apply(outcome)
        return outcome

    def add_measurement(self, measurement: Measurement, arrival_ns: int | None = None) -> Outcome:
        """What a star sensor or another attitude system has measured.

        Args:
            measurement: an attitude or single stars.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
        """
        arrival_ns = measurement.time_ns if arrival_ns is None else arrival_ns
        refusal = self._arrivals.measurement_refusal(measurement, self._track)
        if refusal is not None:
            return Outcome(refusal)
        key = (measurement.time_ns, measurement.source)
        known = self._log.get(key)
        if known is not None:
            outcome = Outcome(same_stamp(known.content(), measurement.content()))
            if known.content() <= measurement.content():
                return outcome
        else:
            outcome = Outcome()
        self._log.insert(key, measurement)
        self._arrivals.used(measurement)
        self._advance(measurement.time_ns, outcome)
        if self._may_carry(measurement.source) and self._order.follows(measurement.time_ns):
            self._newest_star = measurement, arrival_ns
        self._carry(outcome, arrival_ns)
        return outcome

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> Outcome:
        """Says INVALID, once a second, when no attitude was put out any more, whatever came in.

        Args:
            now_ns: the time now.
            waiting_ns: the same in the time of waiting; None where the two are one.
        """
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        outcome = Outcome()
        self._carry(outcome, waiting_ns)
        if self._order.invalid_due(waiting_ns):
            outcome.estimates.append(no_estimate(self.filter, self.state, now_ns))
        return outcome

    def alignment(self) -> Alignment:
        """What the filter now knows of the INS's errors, installation angles and clocks."""
        return alignment_of(self.filter, self.config, self.state)

    def alignment_to_save(self) -> AlignmentPrior | None:
        """The part of it that the next voyage can start from; None where nothing was ever measured."""
        if self.state.time_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_of(self.filter, self.config, self.state)

    @property
    def state(self) -> FilterState:
        """The filter's state after the last measurement applied."""
        return self._log.state

    @property
    def rates(self) -> Rates:
        """What the INS's rates are worth: only where they are measured, or not judged yet, they are used."""
        return self._arrivals.rates

    # -- time order -----------------------------------------------------------------------------------------

    def _advance(self, time_ns: int, outcome: Outcome) -> None:
        """Apply what can be applied now, then close the window behind ``lag_s``."""
        self._arrivals.newest_ns = max(self._arrivals.newest_ns, time_ns)
        self._apply(outcome)
        # The INS's stamps differ from a device's, and an INS sample changes what is compared within a gap of it.
        reach_ns = self._arrivals.oldest_ns - self._max_gap_ns - self._longest_shift_ns - self._exposure_reach_ns
        self._log.forget_before(reach_ns)
        self._track.drop_before(reach_ns - self._longest_shift_ns - self._exposure_reach_ns)
        if self._watch is not None:
            self._watch.drop_before(reach_ns)

    def _forget_rates(self, after_ns: int, outcome: Outcome) -> None:
        """Rates of samples after a stamp were none: what was compared by them is compared anew without."""
        changed_after_ns = self._track.forget_rates(after_ns)
        if changed_after_ns is not None:
            self._rewind(changed_after_ns)
            self._apply(outcome)

    def _rewind(self, changed_after_ns: int) -> None:
        """The INS's attitudes after a stamp have changed: compare anew what was compared with them."""
        self._log.rewind_where(
            lambda decision: decision.ins_time_ns + _reach_ns(decision.measurement) > changed_after_ns
        )

    def _apply(self, outcome: Outcome) -> None:
        for decision, previous in self._log.apply(self._step, _failed, self._arrivals.window_ns):
            if isinstance(decision.measurement, InsJump):
                continue
            if previous is None:
                outcome.decisions.append(decision)
            elif previous.accepted != decision.accepted:
                outcome.decisions.append(replace(decision, revised=True))

    def _step(self, state: FilterState, measurement: Measurement) -> tuple[FilterState, Decision] | None:
        if isinstance(measurement, InsJump):
            return self.filter.opened(state, measurement), Decision(measurement, Reason.NONE, measurement.time_ns)
        needed_ns = self.filter.ins_time_ns(state, measurement) + _reach_ns(measurement)
        awaited = not self._track.covers(needed_ns)
        if awaited and measurement.time_ns >= self._arrivals.oldest_ns:
            return None
        return self.filter.step(state, measurement, self._track, self._watch)

    # -- outputs --------------------------------------------------------------------------------------------

    def _put_out(
        self,
        outcome: Outcome,
        time_ns: int,
        estimate: Callable[[int], AttitudeEstimate | None],
        waiting_ns: int,
        patience_ns: int,
    ) -> None:
        """Put out the attitude of a moment where there is one. Where that fails it is said, and the next is tried."""
        try:
            found = estimate(time_ns)
        except Exception as error:
            outcome.failures.append((time_ns, failure(error)))
            return
        if found is not None:
            outcome.estimates.append(found)
            self._order.claimed(time_ns, waiting_ns, patience_ns)

    def _estimate_from_ins(self, time_ns: int) -> AttitudeEstimate:
        # A jump counts at once, also where measurements of before it still wait.
        state, jump = self.state, self._jump
        if jump is not None and (state.time_ns is None or state.time_ns < jump.time_ns):
            state = self.filter.opened(state, jump)
        if state is not self._corrected.state:
            self._corrected = CorrectedIns(self.filter, state)
        moved_s = -(self.config.ins.time_offset_s + self._corrected.time_offset_s)
        return self._corrected.estimate(time_ns, self._track.newest_moved(moved_s), self.config)

    def _carry(self, outcome: Outcome, waiting_ns: int) -> None:
        """With the INS gone, put out the attitude by the newest star measurement, once, while it is young."""
        if self._newest_star is None or not self._ins_silent(waiting_ns):
            return
        (measurement, arrival_ns), self._newest_star = self._newest_star, None
        if waiting_ns - arrival_ns > _SECOND_NS or not self._order.follows(measurement.time_ns):
            return

        def by_star(_time_ns: int) -> AttitudeEstimate | None:
            untold = np.deg2rad(self.config.ins.untold_acceleration_deg_per_s2)
            attitude = attitude_alone(measurement, self._watch, float(untold))
            return None if attitude is None else estimate_from_star(self.filter, self.state, attitude)

        self._put_out(outcome, measurement.time_ns, by_star, waiting_ns, _SECOND_NS)

    def _ins_silent(self, waiting_ns: int) -> bool:
        """Whether the last INS sample that led on came too long ago; those refused or late lead nowhere."""
        return self._ins_arrival_ns is None or waiting_ns - self._ins_arrival_ns > self._silence_ns

    def _may_carry(self, source: str) -> bool:
        """Star sensors may carry the attitude alone, unless they were in conflict with the INS to the last."""
        in_conflict = self.state.refusals.get(source, 0) >= self.config.gate.conflict_after
        return self.filter.devices[source].is_star and not in_conflict


def _failed(measurement: Measurement, error: Exception) -> Decision:
    refusal = failure(error)
    return Decision(measurement, refusal.reason, measurement.time_ns, text=refusal.text)


def _reach_ns(measurement: Measurement) -> int:
    """How far from its moment the INS must be known to compare a measurement with it."""
    return measurement.reach_ns if isinstance(measurement, StarExposure) else 0


def _ins_content(sample: AttitudeSample) -> bytes:
    rate: FloatArray | None = sample.rate_d
    return sample.rotation_nd.tobytes() + (b"" if rate is None else rate.tobytes())

"""INS and star attitudes in, the ship's attitude out: the core that the node and the replay share.

Knows no ROS, no files, no clock. The core is a model, the filter with the INS's samples and the sky that measurements
are compared with, in the shell of every estimator (:mod:`ship_estimation.estimator_shell`): the shell decides when a
measurement is applied and which output may follow. What belongs to the ship's attitude alone stands here: the guards
of the INS and of the star sensors, and who carries the attitude when the INS is gone.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ship_attitude_star.guards.stream_guards import StreamGuards
from ship_attitude_star.measurements.readings import DeflectionReading, PositionFix, SkyInput
from ship_attitude_star.measurements.samples import (
    AttitudeDecision,
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeOutcome,
    AttitudeRun,
    StampArray,
)
from ship_attitude_star.ship_attitude.ahead import InsAhead
from ship_attitude_star.ship_attitude.alignment import (
    Alignment,
    AlignmentPrior,
    alignment_of,
    installed,
    prior_of,
    state_from_prior,
)
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.integrity import integrity_of
from ship_attitude_star.ship_attitude.linearised import Linearised
from ship_attitude_star.ship_attitude.manoeuvre import RecentSource, TurnHint, worthwhile_turn
from ship_attitude_star.ship_attitude.memory import (
    departure_sigmas,
    is_undisputed,
    memory_residual,
    propagate_memory,
    start_from_memory,
)
from ship_attitude_star.ship_attitude.observability import ToldStates, learnt
from ship_attitude_star.ship_attitude.output import attitude_alone, estimate_from_star, no_estimate
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.ship_attitude.utc_steps import with_utc_compared, with_utc_step
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.estimator_shell import EstimatorShell, Model, surely_in_time
from ship_estimation.exclusion import HEARD_NS
from ship_estimation.ins import InsChange, InsJump
from ship_estimation.ins_guard import JudgedIns
from ship_estimation.outcome import Measurement, Status
from ship_estimation.protection import IntegrityReport
from ship_estimation.rate_guard import Rates
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.refusals import Refusal
from ship_estimation.time_shift import with_shifted_stamps
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack, SampleBlock
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

INS = "ins"

_MOST_JUMPS = 100
"""Jumps of the INS that are kept until they are asked for, once a second."""


class ShipAttitudeCore:
    """The estimator of the ship's attitude.

    Args:
        config: the node's parameters.
        watch: the sky; None where no sensor looks at it itself.
        closed: takes states that can no longer change, in order; None where nobody asks for them.
    """

    filter_class: ClassVar[type[ShipFilter]] = ShipFilter

    def __init__(
        self,
        config: ShipAttitudeConfig,
        watch: SkyWatch | None = None,
        closed: Callable[[Sequence[FilterState]], None] | None = None,
    ) -> None:
        self.config = config
        self._watch = watch
        self.vertical: VerticalTrack | None = None
        if config.follows_vertical:
            self.vertical = VerticalTrack(config.gravity, config.sky)
        self.filter = self.filter_class(config, self.vertical)
        self._start: tuple[AlignmentPrior, int] | None = None
        self._silence_ns = round(config.ins.silence_s * SECOND_NS)
        self._max_gap_ns = round(config.ins.max_gap_s * SECOND_NS)
        exposes = any(star.input == "observations" for star in config.star_sensors.values())
        exposure_reach_ns = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns if exposes else 0
        # The INS's stamps differ from a device's, and an INS sample changes what is compared within a gap of it.
        self._stamp_reach_ns = round(self.filter.linearisation.longest_reach_s * SECOND_NS) + exposure_reach_ns
        model: Model[FilterState, Measurement, AttitudeDecision, InsChange] = Model(
            step=self._step,
            opened=self._opened,
            failed=_failed,
            until_ns=lambda decision: decision.ins_time_ns + decision.measurement.reach_ns,
            forget_before=self._forget_before,
            decided=self._note_used,
            closed=closed,
        )
        self._shell: EstimatorShell[FilterState, Measurement, AttitudeDecision, InsChange, AttitudeEstimate]
        self._shell = EstimatorShell(
            model, self.filter.initial_state(), config.lag_s, self._max_gap_ns + self._stamp_reach_ns
        )
        self.reset()

    def start_from(self, prior: AlignmentPrior, now_ns: int) -> list[str]:
        """Reset to a saved alignment; returns remarks for the operator."""
        self._start = (prior, now_ns)
        self.reset()
        return self._initial()[1]

    def _initial(self) -> tuple[FilterState, list[str]]:
        """The state before any measurement, as configured or by the saved alignment, and remarks for the operator."""
        if self._start is None:
            return self.filter.initial_state(), []
        return state_from_prior(self.filter, self.config, *self._start)

    def reset(self, clock_jumped: bool = False) -> None:
        """Forget all measurements. After a jump of the clock, outputs may start again at earlier times."""
        initial, _ = self._initial()
        self._shell.reset(initial, clock_jumped)
        if self._watch is not None:
            self._watch.reset()
        if self.vertical is not None:
            self.vertical.reset()
        self._begin(initial)

    def step_time_base(self, step_ns: int, state: FilterState) -> None:
        """Go on by clocks that have stepped: no time has passed for the INS, the mountings and the ship's place.

        Args:
            step_ns: the step.
            state: before it.
        """
        stars = [source for source, device in self.filter.devices.items() if device.is_star]
        if stars and all(source in state.excluded for source in stars):
            # What they contradicted may have been UTC.
            state = self.filter.suspects.begun_anew(state)
        state = with_utc_step(with_shifted_stamps(state, step_ns), self.filter.model, step_ns)
        self._shell.step_time_base(state, step_ns)
        if self._watch is not None:
            self._watch.step_time_base(step_ns)
        if self.vertical is not None:
            self.vertical.step_time_base(step_ns)
        self._begin(state)

    def _begin(self, state: FilterState) -> None:
        """Start from a state, without samples of the INS."""
        self._corrected = CorrectedIns(self.filter, state, self.config.horizon)
        self._track = AttitudeTrack(self._max_gap_ns)
        self._guards = StreamGuards(self.config.ins)
        self._ins_arrival_ns: int | None = None
        self._newest_star: tuple[Measurement, int] | None = None
        self._lately: dict[str, RecentSource] = {}
        self._ins_jumps: deque[InsJump] = deque(maxlen=_MOST_JUMPS)

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """Go on with other noise and gates; geometry and the set of devices stay."""
        self.config = config
        self.filter = self.filter_class(config, self.vertical)
        self._corrected = CorrectedIns(self.filter, self.state, config.horizon)
        self._guards.ins.reconfigure(config.ins)

    def add_ins(self, sample: AttitudeSample, arrival_ns: int | None = None, estimate: bool = True) -> AttitudeOutcome:
        """An INS sample: stamp and attitude of the deck as the INS has it.

        Args:
            sample: attitude, and rate where the INS measures it.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
            estimate: False where only the filter's state matters, as in a Monte Carlo run.
        """
        if sample.time_ns < self._shell.window.oldest_ns:
            return AttitudeOutcome(self._shell.window.late(sample.time_ns))
        outcome = AttitudeOutcome()
        judged = self._guards.ins.judge(sample, self._track, self._guards.witnesses)
        return self._use_ins(judged, sample.time_ns if arrival_ns is None else arrival_ns, outcome, estimate)

    def look_ahead(self, block: SampleBlock, arrivals_ns: StampArray) -> InsAhead | None:
        """Judge samples of the INS before their turn, from the first one on, as long as they go the usual way.

        Until all of them had their turn (:meth:`take_ahead`) no other sample of the INS is taken.

        Args:
            block: samples with rates, in the order of their stamps.
            arrivals_ns: when each comes, in the time of waiting, shape (N,).

        Returns:
            None where the first one is to be taken by itself.
        """
        first_ns = int(block.times_ns[0])
        # What is known of the vertical at a sample may change with the fixes that come before the block ends.
        if self.vertical is not None or not self._guards.ins.looks_ahead(first_ns):
            return None
        newest, before = self._track.newest, self._track.recent_rates()
        if newest is None or before is None or self._ins_arrival_ns is None:
            return None
        if not (newest.time_ns < first_ns and self._shell.follows(first_ns)):
            return None
        # No sample after a gap, none before which a tick says that the INS is silent, and none that may come too late.
        steps_ns = np.diff(block.times_ns, prepend=newest.time_ns)
        waits_ns = np.diff(arrivals_ns, prepend=self._ins_arrival_ns)
        near = (steps_ns <= self._max_gap_ns) & (waits_ns >= 0) & (waits_ns <= min(self._silence_ns, SECOND_NS))
        near &= surely_in_time(block.times_ns, arrivals_ns, self.config.lag_s)
        block = block.some(slice(len(near) if near.all() else int(np.argmin(near))))
        if not len(block.times_ns):
            return None
        samples = block.samples()
        followed = self._guards.ins.look_ahead(samples, block)
        if not followed.count:
            return None
        extra = self._track.extra_noise(first_ns)
        return InsAhead(samples[: followed.usual], block, arrivals_ns, followed, before, extra)

    def take_ahead(self, ahead: InsAhead, stop: int) -> None:
        """Samples that were judged ahead have their turn, up to one that is not included."""
        while ahead.taken < stop:
            if self._shell.is_idle:
                end = stop
                self._track.extend(ahead.samples[ahead.taken : end])
                self._shell.move_to(ahead.samples[end - 1].time_ns)
            else:
                # A measurement waits: it may be for this very sample.
                end, outcome = ahead.taken + 1, AttitudeOutcome()
                self._shell.add_sample(INS, self._track, ahead.samples[ahead.taken], outcome)
                if outcome.decisions or outcome.failures:
                    ahead.told.append((ahead.taken, outcome))
            doubts = None
            if self._shell.contradictions:
                doubts = [self._doubt(sample.time_ns) for sample in ahead.samples[ahead.taken : end]]
            ahead.had_turn(self._shell.state_now, end, doubts)
            self._ins_arrival_ns = int(ahead.arrivals_ns[end - 1])
            self._shell.was_put_out(ahead.samples[end - 1].time_ns, self._ins_arrival_ns, self._silence_ns)
            self._guards.ins.by_rates = ahead.followed.by_rates(end - 1)

    def end_ahead(self, ahead: InsAhead) -> AttitudeOutcome | None:
        """All samples that were judged ahead had their turn; what the one led to that did not go the usual way."""
        values, last = ahead.block.rotations_nd[: ahead.followed.count], ahead.followed.last
        self._guards.ins.arrive(values, ahead.followed, self._guards.witnesses)
        if last is None:
            return None
        return self._use_ins(last, int(ahead.arrivals_ns[len(ahead.samples)]), AttitudeOutcome(), True)

    def estimates_ahead(self, ahead: InsAhead) -> list[tuple[slice, AttitudeRun | Refusal]]:
        """The attitudes at the stamps of samples that were judged ahead; see :meth:`InsAhead.attitudes`."""
        return ahead.attitudes(self._corrected_by, self._moved_s, self.config)

    def _use_ins(
        self, judged: JudgedIns, arrival_ns: int, outcome: AttitudeOutcome, estimate: bool
    ) -> AttitudeOutcome:
        """Use a sample that was judged, and put out the attitude at its stamp."""
        time_ns = judged.sample.time_ns
        if judged.rates_wrong_after_ns is not None:
            # The rates proved wrong. Measurements compared with their help are compared again without rates.
            changed_after_ns = self._track.forget_rates(judged.rates_wrong_after_ns)
            if changed_after_ns is not None:
                self._shell.data_changed(changed_after_ns)
                self._shell.apply(outcome)
        if judged.noise is not None:
            # What was compared with the samples since then is compared again with their measured noise.
            since_ns = self._track.add_noise(judged.noise)
            self._shell.add_jump(self.filter.opens_ns(judged.noise), INS, judged.noise, since_ns)
            self._shell.apply(outcome)
        self._ins_jumps.extend(judged.jumps)
        for jump in judged.jumps:
            self._shell.add_jump(self.filter.opens_ns(jump), INS, jump, self._track.cut(jump.time_ns))
        if judged.refusal is not None:
            outcome.refusal = judged.refusal
            self._shell.add_refused(INS, self._track, judged.sample)
            return outcome
        if not self._shell.add_sample(INS, self._track, judged.sample, outcome):
            return outcome
        # An attitude that is moved by a clock offset needs its rate. Without a rate no attitude is put out for the
        # sample.
        if self._track.newest is judged.sample and (self._track.newest_rate_known or self.state.time_ns is None):
            self._ins_arrival_ns = arrival_ns
            if estimate:

                def by_ins(state: FilterState) -> AttitudeEstimate:
                    return self._estimate_by_newest_ins(state, time_ns)

                self._shell.put_out(outcome, time_ns, arrival_ns, by_ins, self._silence_ns)
        return outcome

    def add_sky_input(self, sky_input: SkyInput) -> AttitudeOutcome:
        """Where the ship is, or the air around it; what was compared with another sky is compared anew."""
        outcome = AttitudeOutcome()
        if self._watch is not None:
            outcome.refusal = self._watch.surroundings.refusal(sky_input)
            self._shell.contradictions.note(sky_input.source, sky_input.time_ns, outcome.refusal)
            changed_after_ns = self._watch.surroundings.insert(sky_input)
            # An attitude that is nothing but itself is compared without the sky; a SolvedAttitude is not.
            self._compare_anew(changed_after_ns, lambda used: type(used) is not AttitudeMeasurement)
        if self.vertical is not None and isinstance(sky_input, PositionFix):
            if self._watch is None:
                outcome.refusal = self.vertical.refusal(sky_input)
                self._shell.contradictions.note(sky_input.source, sky_input.time_ns, outcome.refusal)
            self._compare_anew(self.vertical.insert(sky_input), lambda _used: True)
        self._shell.apply(outcome)
        return outcome

    def add_deflection(self, reading: DeflectionReading) -> AttitudeOutcome:
        """The deflection of the vertical at the ship; what came after its stamp is carried there anew."""
        assert self.vertical is not None
        outcome = AttitudeOutcome(self.vertical.refusal(reading))
        self._shell.contradictions.note(reading.source, reading.time_ns, outcome.refusal)
        self._compare_anew(self.vertical.insert(reading), lambda _used: True)
        self._shell.apply(outcome)
        return outcome

    def contest(self, source: str, text: str) -> None:
        """Set that two publishers send as a source; an empty text ends it."""
        self._shell.contradictions.contest(source, self._shell.window.newest_ns, text)

    def add_measurement(self, measurement: Measurement, arrival_ns: int | None = None) -> AttitudeOutcome:
        """What a star sensor or another attitude system has measured.

        Args:
            measurement: an attitude or single stars.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
        """
        if measurement.time_ns < self._shell.window.oldest_ns:
            return AttitudeOutcome(self._shell.window.late(measurement.time_ns))
        arrival_ns = measurement.time_ns if arrival_ns is None else arrival_ns
        outcome = AttitudeOutcome(self._guards.check(measurement, self._track))
        if outcome.refusal is not None or not self._shell.add(measurement, outcome):
            return outcome
        if self._shell.follows(measurement.time_ns) and self._may_carry(measurement.source):
            self._newest_star = measurement, arrival_ns
        self._carry(outcome, arrival_ns)
        return outcome

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> AttitudeOutcome:
        """Says INVALID, once a second, when no attitude was put out any more, whatever came in.

        Args:
            now_ns: the time now.
            waiting_ns: the same in the time of waiting; None where the two are one.
        """
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        outcome = AttitudeOutcome()
        self._shell.tick(now_ns, outcome)
        self._carry(outcome, waiting_ns)
        self._shell.say_invalid(outcome, waiting_ns, lambda: no_estimate(self.filter, self.state, now_ns))
        return outcome

    def no_output(self, now_ns: int, text: str) -> AttitudeEstimate:
        """Return the output that claims no attitude, for the reason that the text gives."""
        return no_estimate(self.filter, self.state, now_ns, text)

    def linearised(self, measurement: Measurement) -> Linearised | None:
        """A measurement against the INS, linearised at the estimate of now; None where it cannot be compared.

        The samples of the INS around its stamp must still be remembered: to be asked when it has just been judged.
        """
        state = self.state
        # Its own use is in the state already: what it shares with others is left out.
        found = self.filter.linearisation.of(measurement, state.mean, state.covariance, {}, self._track, self._watch)
        return found if isinstance(found, Linearised) else None

    def alignment(self) -> Alignment:
        """What the filter now knows of the INS's errors, installation angles and clocks."""
        return alignment_of(self.filter, self.config, self.state)

    def star_installation(self, id_: str) -> FloatArray:
        """Rotation "deck from star sensor" as the filter now has it, shape (3, 3)."""
        return installed(self.filter, self.state, f"star.{id_}")

    def deflection(self, time_ns: int) -> DeflectionReading | None:
        """The deflection of the vertical at a moment, as given and estimated; None where it is no state."""
        if self.vertical is None or not self.config.gravity.is_modelled:
            return None
        errors = self._corrected_by(self.state).errors([time_ns])
        return DeflectionReading(time_ns, errors.deflection[0], errors.deflection_covariance[0])

    def learnt(self) -> ToldStates:
        """What the data have told of the states, and what they left open."""
        return learnt(self.filter, self.config, self.state)

    def worthwhile_turn(self, rotation_nd: FloatArray) -> TurnHint | None:
        """The turn that would bring most to a ship that lies as she does now; None where none is worth it."""
        return worthwhile_turn(self.filter, self.state, rotation_nd, self._lately)

    def integrity(self, estimate: AttitudeEstimate) -> IntegrityReport:
        """How far an attitude may be wrong although nothing says so, and who is excluded."""
        return integrity_of(self.filter, self.config, estimate)

    def alignment_to_save(self) -> AlignmentPrior | None:
        """The part of it that the next voyage can start from; None where nothing was ever measured."""
        if self.state.time_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_of(self.filter, self.config, self.state)

    @property
    def state(self) -> FilterState:
        """The filter's state after the last measurement applied."""
        return self._shell.state

    # -- recovery: see ship_estimation.recovery.recovery.RecoverableCore -----------------------------------------

    @property
    def excluded(self) -> Set[str]:
        """The sources that are excluded."""
        return self.state.excluded.keys()

    @property
    def is_undisputed(self) -> bool:
        """True if its state rests on stars, no source is excluded and none contradicts another."""
        return is_undisputed(self.filter, self.state, self.config.gate.degraded_after)

    @property
    def is_contradicted(self) -> bool:
        """True if its sources contradict one another and no source is found to be faulty."""
        return self.state.doubt is not None or self.state.utc is not None

    def make_second(self, memory: FilterState | None) -> "ShipAttitudeCore":
        """Return another estimator that starts from a remembered state; from the saved alignment or the prior without.

        With a memory it also starts with the position and the air as they are known here.
        """
        second = self._another(None if self._watch is None else self._watch.twin(memory is not None))
        second._start = self._start
        if memory is None:
            second.reset()
            return second
        if self.vertical is not None:
            second.vertical = self.vertical.twin()
            second.filter = second.filter_class(second.config, second.vertical)
        state = start_from_memory(second.filter, memory, self.state)
        second._shell.reset(state)
        second._begin(state)
        return second

    def _another(self, watch: SkyWatch | None) -> "ShipAttitudeCore":
        """Return an estimator of the same class and configuration."""
        return type(self)(self.config, watch)

    def take_jumps(self) -> list[InsJump]:
        """Return the jumps of the INS that its own rates showed since the last call."""
        jumps = list(self._ins_jumps)
        self._ins_jumps.clear()
        return jumps

    def propagate_memory(self, memory: FilterState, jumps: Sequence[InsJump]) -> FilterState:
        """Return a remembered state propagated to the oldest time that measurements may still have."""
        return propagate_memory(self.filter, memory, jumps, self._shell.window.oldest_ns)

    def memory_residuals(self, decision: AttitudeDecision, memory: FilterState) -> Mapping[str, MemoryResidual]:
        """Return how far stars that were just judged are from a remembered state; nothing for other measurements."""
        measurement = decision.measurement
        if not self.filter.devices[measurement.source].is_star:
            return {}
        residual = memory_residual(self.filter, memory, measurement, self._track, self._watch)
        return {} if residual is None else {measurement.source: residual}

    def departure_sigmas(self, state: FilterState, memory: FilterState, is_later: bool = False) -> float:
        """Return the largest difference of a lasting state from the remembered one, in standard deviations of both."""
        return departure_sigmas(self.filter, state, memory, is_later)

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those of the sources of which no measurement was used recently."""
        since_ns, used_ns = self._shell.window.newest_ns - HEARD_NS, self.state.used_ns
        return {name for name in sources if name in self.filter.devices and used_ns.get(name, since_ns - 1) < since_ns}

    def take_over_outputs(self, live: "ShipAttitudeCore") -> None:
        """Go on with the outputs where another estimator ends."""
        self._shell.continue_outputs(live._shell)

    @property
    def rates(self) -> Rates:
        """What the INS's rates are worth: only where they are measured, or not judged yet, they are used."""
        return self._guards.ins.rates

    @property
    def excess_noise(self) -> str:
        """Measured against stated noise of the INS's attitudes, in words; empty where it is no larger."""
        return self._guards.ins.excess_text

    # -- the model in the shell -----------------------------------------------------------------------------

    def _step(
        self, state: FilterState, measurement: Measurement, may_wait: bool
    ) -> tuple[FilterState, AttitudeDecision] | None:
        found = self.filter.step(state, measurement, self._track, self._watch, may_wait)
        if state.utc is None or found is None or not self.filter.devices[measurement.source].is_star:
            return found
        predicted = self.filter.predicted(state, measurement.time_ns)
        compared = with_utc_compared(state, predicted, self.filter.model, *found)
        if compared[0].utc is None:
            # UTC is right, or that cannot be told any more: the measurement is used.
            return self.filter.step(compared[0], measurement, self._track, self._watch, may_wait)
        return compared

    def _opened(self, state: FilterState, change: InsChange) -> FilterState:
        return self.filter.opened(state, change)

    def _note_used(self, decision: AttitudeDecision) -> None:
        """Keep what each source measures, and how often."""
        measurement = decision.measurement
        if decision.accepted:
            before = self._lately.get(measurement.source)
            since_s = np.inf if before is None else (measurement.time_ns - before.measurement.time_ns) / SECOND_NS
            if since_s > 0.0:
                self._lately[measurement.source] = RecentSource(measurement, since_s)

    def _forget_before(self, time_ns: int) -> None:
        """Forget what no measurement at or after a stamp is compared with."""
        asked_since_ns = self._asked_since_ns(time_ns)
        self._track.drop_before(asked_since_ns - self._stamp_reach_ns)
        if self._watch is not None:
            self._watch.surroundings.drop_before(time_ns)
        if self.vertical is not None:
            state_ns = self._shell.oldest_state.time_ns
            self.vertical.drop_before(time_ns, asked_since_ns if state_ns is None else min(asked_since_ns, state_ns))

    def _asked_since_ns(self, closed_ns: int) -> int:
        """The earliest moment that is still asked for; no measurement before ``closed_ns`` can change any more."""
        return closed_ns

    def _compare_anew(self, changed_after_ns: int | None, affects: Callable[[Measurement], bool]) -> None:
        """Have the measurements after a moment that something affects compared anew; None for no moment."""
        if changed_after_ns is not None:
            self._shell.rewind_where(
                lambda decision: decision.measurement.time_ns > changed_after_ns and affects(decision.measurement)
            )

    # -- outputs --------------------------------------------------------------------------------------------

    def _estimate_by_newest_ins(self, state: FilterState, time_ns: int) -> AttitudeEstimate:
        """The attitude at the stamp of the newest INS sample, by a state of the filter."""
        corrected = self._corrected_by(state)
        ins = self._track.newest_moved(self._moved_s(corrected))
        return self._doubted(corrected.estimate(time_ns, ins, self.config))

    def _corrected_by(self, state: FilterState) -> CorrectedIns:
        """INS attitudes corrected by a state, made once for all that rest on it."""
        if state is not self._corrected.state:
            self._corrected = self._corrected.by(state)
        return self._corrected

    def _moved_s(self, corrected: CorrectedIns) -> float:
        """By so much an INS sample is moved so that it is the attitude at its stamp, s."""
        return -(self.config.ins.time_offset_s + corrected.time_offset_s)

    def _doubted(self, estimate: AttitudeEstimate) -> AttitudeEstimate:
        """An estimate is DEGRADED where a source that it rests on contradicted itself not long ago."""
        doubt = self._doubt(estimate.time_ns)
        if not doubt:
            return estimate
        return replace(estimate, status=max(estimate.status, Status.DEGRADED), text=doubt)

    def _doubt(self, time_ns: int) -> str:
        """Which sources that an attitude now rests on contradicted themselves not long ago; empty for none."""
        if not self._shell.contradictions:
            return ""
        used_ns, devices = self.state.used_ns, self.filter.devices
        contradictory = [
            source
            for source, since_ns in self._shell.contradictions.at(time_ns).items()
            if source not in devices or used_ns.get(source, since_ns - 1) >= since_ns
        ]
        return self._shell.contradictions.text(contradictory)

    def _carry(self, outcome: AttitudeOutcome, waiting_ns: int) -> None:
        """With the INS gone, put out the attitude by the newest star measurement, once, while it is young."""
        if self._newest_star is None or not self._ins_silent(waiting_ns):
            return
        (measurement, arrival_ns), self._newest_star = self._newest_star, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return

        def by_star(_state: FilterState) -> AttitudeEstimate | None:
            untold = np.deg2rad(self.config.ins.untold_acceleration_deg_per_s2)
            attitude = attitude_alone(measurement, self._watch, float(untold))
            return None if attitude is None else estimate_from_star(
                self.filter, self.state, attitude, self.config.horizon
            )

        self._shell.put_out(outcome, measurement.time_ns, waiting_ns, by_star)

    def _ins_silent(self, waiting_ns: int) -> bool:
        """Whether the last INS sample that led on came too long ago; those refused or late lead nowhere."""
        return self._ins_arrival_ns is None or waiting_ns - self._ins_arrival_ns > self._silence_ns

    def _may_carry(self, source: str) -> bool:
        """Star sensors may carry the attitude alone, unless they were in conflict with the INS to the last."""
        in_conflict = self.state.refusals.get(source, 0) >= self.config.gate.conflict_after
        return self.filter.devices[source].is_star and not in_conflict


def _failed(measurement: Measurement, refusal: Refusal) -> AttitudeDecision:
    return AttitudeDecision(measurement, refusal.reason, text=refusal.text, ins_time_ns=measurement.time_ns)

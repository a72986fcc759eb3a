"""The shell of every estimator: which measurement is used when, which is refused, and in which order outputs go out.

An estimator is a :class:`Model` (how a state and a measurement become the next state) in an :class:`EstimatorShell`.
The shell knows nothing of what is measured. A measurement goes this way:

1. Older than ``lag_s`` behind the newest data: refused as LATE (:class:`LagWindow`). The core asks this first, and then
   its guards whether the measurement can be true at all; what they refuse does not reach the shell.
2. Of the same source and stamp as another one: refused as DUPLICATE, or where the bytes differ told as CONFLICT; the
   one whose bytes sort first is kept. One that comes after too many later ones of its source is refused as OVERFLOW.
3. It takes its place in the order of stamps (:class:`TimeOrderedLog`). What was applied after that place is applied
   again, and a decision that turns out otherwise is told again as revised. How much is applied again is bounded for
   each input and for each second; the rest waits.
4. It waits, and all after it, as long as the model misses data that may still come within ``lag_s``.
5. The model uses it or refuses it. Where the model raises, the measurement is refused as FAILED and the state stays.
6. ``lag_s`` later the window closes behind it: the decision is final.

Any order of arrival within the window therefore ends in the same state, to the last bit, as long as no source sends
more out of order than :data:`MOST_OVERTAKEN_PER_S`.

Two clocks are at work. Outputs are ordered by their stamps, the time of the data. Silence is measured in the time of
waiting, a clock that nobody sets and that the shell of the node gives with each input and tick: old stamps, or a
system clock that is put right, are no silence.
"""

import bisect
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_estimation.outcome import Estimate, Judged, Measurement, Outcome
from ship_estimation.refusals import Contradictions, Reason, Refusal, failure, same_stamp
from ship_geometry.sample_track import SampleTrack
from ship_geometry.time_scales import SECOND_NS

State = TypeVar("State")
Measured = TypeVar("Measured", bound=Measurement)
Jump = TypeVar("Jump")
Item = TypeVar("Item")
Verdict = TypeVar("Verdict")


class LagWindow:
    """The stamps that are still taken: from ``lag_s`` behind the newest data on.

    Args:
        lag_s: how late data may come.

    Attributes:
        newest_ns: latest stamp of all data.
        oldest_ns: data older than this come too late.
    """

    def __init__(self, lag_s: float) -> None:
        self._lag_s, self._lag_ns = lag_s, round(lag_s * SECOND_NS)
        self.newest_ns, self.oldest_ns = 0, -self._lag_ns

    def late(self, time_ns: int) -> Refusal | None:
        """The refusal of data that come too late."""
        if time_ns >= self.oldest_ns:
            return None
        late_s = (self.newest_ns - time_ns) / SECOND_NS
        return Refusal(Reason.LATE, f"{late_s:.3f} s behind the newest data: more than lag_s = {self._lag_s:g}")

    def move_to(self, time_ns: int) -> None:
        """Data of this stamp were taken."""
        self.newest_ns = max(self.newest_ns, time_ns)
        self.oldest_ns = self.newest_ns - self._lag_ns


_MOST_AHEAD_NS = SECOND_NS // 10
"""No stamp that is used is further ahead of its arrival, by half of it."""


def surely_in_time(
    times_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64], lag_s: float
) -> NDArray[np.bool_]:
    """Which data cannot come too late, whatever other data come before their turn, shape (N,).

    Args:
        times_ns: their stamps, shape (N,).
        arrivals_ns: when each comes, by the clock that judges stamps, shape (N,).
        lag_s: how late data may come.

    Example:
        >>> surely_in_time(np.zeros(2), np.array([1_000_000_000, 1_950_000_000]), lag_s=2.0)
        array([ True, False])
    """
    in_time: NDArray[np.bool_] = times_ns >= arrivals_ns + _MOST_AHEAD_NS - round(lag_s * SECOND_NS)
    return in_time


MOST_REPEATS_PER_S = 400
"""Measurements applied again in a second: ten in ordinary data, two to three hundred where every input of a ship comes
out of order by up to two seconds. A flood of late ones would make thousands, and hold up the output."""
MOST_REPEATS_AT_ONCE = 50
"""Of these for one input: the output that follows it waits no longer than they take."""
MOST_OVERTAKEN_PER_S = 200
"""Later measurements of its own source that those which come late may find here already, summed over a second. Star
exposures at 14 Hz in any order within two seconds make so many, and so do attitudes at 100 Hz late by up to 0.1 s."""


class _Allowance:
    """So many a second: after a second of rest all of them at once.

    Args:
        per_s: the number.
    """

    def __init__(self, per_s: int) -> None:
        self._cost_ns = SECOND_NS // per_s
        self._paid_until_ns = -SECOND_NS

    def covers(self, count: int, now_ns: int) -> bool:
        """Whether so many are left."""
        return self._since_ns(now_ns) + count * self._cost_ns <= now_ns

    def spend(self, count: int, now_ns: int) -> None:
        """Take so many of them, more than are left where need be."""
        self._paid_until_ns = self._since_ns(now_ns) + count * self._cost_ns

    def _since_ns(self, now_ns: int) -> int:
        """Up to when all is spent: a second ago at the earliest, and in a second at the latest."""
        return min(max(self._paid_until_ns, now_ns - SECOND_NS), now_ns + SECOND_NS)


Key = tuple[int, Any]
"""(time_ns, tie-breaker): the order of application."""


@dataclass
class _Entry(Generic[State, Item, Verdict]):
    key: Key
    measurement: Item
    decision: Verdict | None = None
    state_after: State | None = None


class TimeOrderedLog(Generic[State, Item, Verdict]):
    """A window of measurements over a base state, each with the state after it.

    One that arrives late takes its place, and everything after it is applied again from the state before it. One on
    which the step raises changes no state and holds up no other.

    Args:
        state: the state before any measurement.

    Attributes:
        state: after the last measurement applied by :meth:`apply`.
        waiting: number of measurements not applied yet.
        oldest_ns: time of the first measurement of the window; None where there is none.
    """

    def __init__(self, state: State) -> None:
        self._base = self.state = state
        self._keys: list[Key] = []
        self._entries: list[_Entry[State, Item, Verdict]] = []
        self.waiting = 0
        self.oldest_ns: int | None = None
        self._repeats = _Allowance(MOST_REPEATS_PER_S)

    @property
    def base(self) -> State:
        """The state before the first measurement of the window: none before it is asked for any more."""
        return self._base

    @property
    def is_behind(self) -> bool:
        """Whether the next measurement to apply was applied before, and waits only because of the bounds."""
        return self.waiting > 0 and self._entries[self._applied].decision is not None

    def not_applied(self) -> list[Item]:
        """The measurements that wait, in order."""
        return [entry.measurement for entry in self._entries[self._applied :]]

    def get(self, key: Key) -> Item | None:
        """The measurement of exactly this time and tie-breaker."""
        index = bisect.bisect_left(self._keys, key)
        found = index < len(self._keys) and self._keys[index] == key
        return self._entries[index].measurement if found else None

    def overtaken(self, key: Key) -> int:
        """How many measurements with the same tie-breaker and a later time are here already."""
        return sum(other[1] == key[1] for other in self._keys[bisect.bisect_right(self._keys, key) :])

    def insert(self, key: Key, measurement: Item) -> None:
        """Put a measurement in its place; one with the same key is replaced."""
        index = bisect.bisect_left(self._keys, key)
        if index < len(self._keys) and self._keys[index] == key:
            self._entries[index].measurement = measurement
        else:
            self._keys.insert(index, key)
            self._entries.insert(index, _Entry(key, measurement))
            self.oldest_ns = self._keys[0][0]
            self.waiting += 1
        self.waiting = max(self.waiting, len(self._entries) - index)

    def rewind_where(self, affected: Callable[[Verdict], bool]) -> None:
        """Apply again, at the next :meth:`apply`, from the first measurement whose decision is affected."""
        for index in range(self._applied):
            decision = self._entries[index].decision
            if decision is not None and affected(decision):
                self.waiting = len(self._entries) - index
                return

    def apply(
        self,
        step: Callable[[State, Item], tuple[State, Verdict] | None],
        failed: Callable[[Item, Exception], Verdict],
        window_ns: tuple[int, int] | None = None,
    ) -> list[tuple[Verdict, Verdict | None]]:
        """Apply what waits, in order, until ``step`` returns None because it needs data still to come.

        Args:
            step: state and decision after a measurement.
            failed: the decision about a measurement on which ``step`` raised; the state stays as it was before it.
            window_ns: the stamp before which no data can come that matter, and the time now. What was applied before
                is applied again :data:`MOST_REPEATS_AT_ONCE` times at most, and :data:`MOST_REPEATS_PER_S` times in a
                second. What is beyond that waits for the next call, or until no more data can come: the state is
                behind meanwhile, and ends the same. None: nothing waits.

        Returns:
            For each measurement applied: its decision and, where it had been applied before, the one it replaces.
        """
        decisions: list[tuple[Verdict, Verdict | None]] = []
        repeats = 0
        while self.waiting:
            index = self._applied
            entry, self.state = self._entries[index], self._state_before(index)
            again = entry.decision is not None
            if again and window_ns is not None and not self._may_repeat(entry.key, repeats, *window_ns):
                break
            result: tuple[State, Verdict] | None
            try:
                result = step(self.state, entry.measurement)
            except Exception as error:
                result = self.state, failed(entry.measurement, error)
            if result is None:
                break
            if again:
                repeats += 1
                if window_ns is not None:
                    self._repeats.spend(1, window_ns[1])
            previous = entry.decision
            self.state, entry.decision = result
            entry.state_after = self.state
            decisions.append((entry.decision, previous))
            self.waiting -= 1
        return decisions

    def forget_before(self, time_ns: int) -> list[State]:
        """Close the window at a time: applied measurements before it can no longer be revised.

        Returns:
            The states after these.
        """
        count = min(bisect.bisect_left(self._keys, (time_ns,)), self._applied)
        closed = self.states(count)
        if count:
            self._base = closed[-1]
            del self._keys[:count]
            del self._entries[:count]
            self.oldest_ns = self._keys[0][0] if self._keys else None
        return closed

    def states(self, count: int | None = None) -> list[State]:
        """The states after the first measurements of the window; None for all that are applied."""
        return [self._state_before(number + 1) for number in range(self._applied if count is None else count)]

    @property
    def _applied(self) -> int:
        """Number of measurements of the window that are applied: always its first ones."""
        return len(self._entries) - self.waiting

    def _may_repeat(self, key: Key, repeats: int, closed_ns: int, now_ns: int) -> bool:
        # What no data can reach any more is right once it is applied again, and is so never after.
        return key[0] < closed_ns or (repeats < MOST_REPEATS_AT_ONCE and self._repeats.covers(1, now_ns))

    def _state_before(self, index: int) -> State:
        if index == 0:
            return self._base
        state = self._entries[index - 1].state_after
        assert state is not None  # entries before the applied mark always carry their state
        return state


@dataclass(frozen=True, kw_only=True)
class Model(Generic[State, Measured, Judged, Jump]):
    """What an estimator is beside its shell; all functions leave the state that they are given as it is.

    Attributes:
        step: the state after a measurement, and the decision about it. The last argument says whether the measurement
            may wait; where it may, None says that data still to come belong to it.
        opened: the state after a jump of a source, which opens the state by as much.
        failed: the decision about a measurement on which ``step`` raised.
        until_ns: the stamp up to which samples matter to a decision: later ones cannot change it.
        forget_before: drops the data that no measurement at or after a stamp needs.
        decided: told of each decision, also of one that is made again.
        closed: takes the states after measurements whose decisions are final, in order.
    """

    step: Callable[[State, Measured, bool], tuple[State, Judged] | None]
    opened: Callable[[State, Jump], State]
    failed: Callable[[Measured, Refusal], Judged]
    until_ns: Callable[[Judged], int]
    forget_before: Callable[[int], None]
    decided: Callable[[Judged], None] | None = None
    closed: Callable[[Sequence[State]], None] | None = None


@dataclass(frozen=True)
class _Opening(Generic[Jump]):
    """A jump of a source at its place among the measurements, and why the state was not opened for it, if so."""

    time_ns: int
    jump: Jump
    failed: Refusal | None = None


class EstimatorShell(Generic[State, Measured, Judged, Jump, Estimate]):
    """One estimator's measurements in time order, and its outputs.

    Args:
        model: the estimator itself.
        state: before any measurement.
        lag_s: measurements up to this late are applied at their own time.
        reach_ns: so far before its own stamp data may matter to a measurement.

    Attributes:
        state: after the last measurement applied.
        window: the stamps that are still taken.
        contradictions: the sources that said different things of one moment.
    """

    def __init__(self, model: Model[State, Measured, Judged, Jump], state: State, lag_s: float, reach_ns: int) -> None:
        self._model = model
        self._lag_s, self._reach_ns = lag_s, reach_ns
        self.contradictions = Contradictions()
        self.reset(state, clock_jumped=True)

    def reset(self, state: State, clock_jumped: bool = False) -> None:
        """Forget all measurements. After a jump of the clock, outputs may start again at earlier times."""
        self.state = state
        self._jumped = False
        self.window = LagWindow(self._lag_s)
        self.contradictions.forget()
        self._overtaking: dict[str, _Allowance] = {}
        self._log: TimeOrderedLog[State, Measured | _Opening[Jump], Judged | _Opening[Jump]] = TimeOrderedLog(state)
        if clock_jumped:
            self._last_claim_ns: int | None = None
            self._silent_after_ns: int | None = None
            self._said_invalid_ns: int | None = None

    def step_time_base(self, state: State, step_ns: int) -> None:
        """Forget all measurements and go on from a state by clocks that have stepped; outputs go on in order."""
        self.reset(state)
        if self._last_claim_ns is not None:
            self._last_claim_ns += step_ns

    # -- inputs ---------------------------------------------------------------------------------------------

    def add(self, measurement: Measured, outcome: Outcome[Judged, Estimate]) -> bool:
        """Take a measurement that is not late; False where another one of its source and stamp is kept."""
        key = measurement.time_ns, measurement.source
        known, taken = self._log.get(key), True
        if known is not None and not isinstance(known, _Opening):
            taken, outcome.refusal = same_stamp(known, measurement)
            self.contradictions.note(measurement.source, measurement.time_ns, outcome.refusal)
        if taken and not self._may_overtake(key):
            bound = f"{MOST_OVERTAKEN_PER_S} such pairs a second are taken"
            text = f"too many come after later ones of their source: {bound}"
            taken, outcome.refusal = False, Refusal(Reason.OVERFLOW, text)
        if taken:
            self._log.insert(key, measurement)
            self._advance(measurement.time_ns, outcome)
        return taken

    def add_sample(
        self, source: str, track: SampleTrack[Any], sample: Any, outcome: Outcome[Judged, Estimate]
    ) -> bool:
        """Take a sample that is not late into a track that measurements are compared with; False as with :meth:`add`.

        What was compared with values of the track that change now is compared anew.
        """
        known, taken = track.get(sample.time_ns), True
        if known is not None:
            taken, outcome.refusal = same_stamp(known, sample)
            self.contradictions.note(source, sample.time_ns, outcome.refusal)
        if taken:
            changed_after_ns = track.insert(sample)
            if changed_after_ns is not None:
                self.data_changed(changed_after_ns)
            self._advance(sample.time_ns, outcome)
        return taken

    @property
    def is_idle(self) -> bool:
        """Whether nothing waits to be applied: new samples, behind all others, only go into their track."""
        return not self._log.waiting

    def move_to(self, time_ns: int) -> None:
        """Samples up to a stamp were taken, behind all others of their track, while nothing waits (:attr:`is_idle`)."""
        self.window.move_to(time_ns)
        self._close()

    def add_refused(self, source: str, track: SampleTrack[Any], sample: Any) -> None:
        """A sample is refused: where one of its stamp was taken and it is not late, the source contradicts itself."""
        known = track.get(sample.time_ns)
        if known is not None and self.window.late(sample.time_ns) is None:
            self.contradictions.note(source, sample.time_ns, same_stamp(known, sample)[1])

    def add_jump(self, time_ns: int, source: str, jump: Jump, changed_after_ns: int | None = None) -> None:
        """A source has jumped at a moment: the state after it is open by as much.

        Args:
            time_ns: the moment, also before what was applied already.
            source: that has jumped.
            jump: how far.
            changed_after_ns: stamp after which samples that were taken belong together otherwise; None where none do.
        """
        self._log.insert((time_ns, source), _Opening(time_ns, jump))
        self._jumped = True
        if changed_after_ns is not None:
            self.data_changed(changed_after_ns)

    def data_changed(self, after_ns: int) -> None:
        """Samples after a stamp have changed: at the next :meth:`apply`, compare anew what they matter to."""
        self.rewind_where(lambda decision: self._model.until_ns(decision) > after_ns)

    def rewind_where(self, affected: Callable[[Judged], bool]) -> None:
        """Apply again, at the next :meth:`apply`, from the first measurement whose decision is affected."""
        self._log.rewind_where(lambda verdict: not isinstance(verdict, _Opening) and affected(verdict))

    def tick(self, now_ns: int, outcome: Outcome[Judged, Estimate]) -> None:
        """Go on with what waits only because so much was applied again, where no data come that would do so."""
        if self.is_behind:
            self.apply(outcome, now_ns)

    @property
    def is_behind(self) -> bool:
        """Whether something is to be applied again, and waits only because of the bounds."""
        return self._log.is_behind

    def apply(self, outcome: Outcome[Judged, Estimate], now_ns: int | None = None) -> None:
        """Apply what can be applied now, and tell the decisions that are new or turn out otherwise.

        Args:
            outcome: takes the decisions.
            now_ns: the time now, for the bounds; None for the newest stamp.
        """
        if not self._log.waiting:
            return
        closed_ns = self.window.oldest_ns - self._reach_ns
        now_ns = self.window.newest_ns if now_ns is None else now_ns
        decisions = self._log.apply(self._step, self._failed, (closed_ns, now_ns))
        self.state = self._log.state
        for decision, previous in decisions:
            if isinstance(decision, _Opening):
                known = isinstance(previous, _Opening) and previous.failed is not None
                if decision.failed is not None and not known:
                    outcome.failures.append((decision.time_ns, decision.failed))
                continue
            if self._model.decided is not None:
                self._model.decided(decision)
            if previous is None:
                outcome.decisions.append(decision)
            elif not isinstance(previous, _Opening) and previous.accepted != decision.accepted:
                outcome.decisions.append(replace(decision, revised=True))

    def _may_overtake(self, key: Key) -> bool:
        """Whether a measurement may still take its place before later ones of its source."""
        overtaken = self._log.overtaken(key)
        if not overtaken:
            return True
        allowance, now_ns = self._overtaking.setdefault(key[1], _Allowance(MOST_OVERTAKEN_PER_S)), self.window.newest_ns
        if not allowance.covers(overtaken, now_ns):
            return False
        allowance.spend(overtaken, now_ns)
        return True

    def _advance(self, time_ns: int, outcome: Outcome[Judged, Estimate]) -> None:
        """Apply what can be applied now, then close the window."""
        self.window.move_to(time_ns)
        self.apply(outcome)
        self._close()

    def states_in_window(self) -> list[State]:
        """The states after the measurements whose decisions may still change, in order."""
        return self._log.states()

    @property
    def oldest_state(self) -> State:
        """The earliest state from which anything may still be carried on."""
        return self._log.base

    def _close(self) -> None:
        """Close the window: what is older than it can no longer be revised."""
        closed_ns = self.window.oldest_ns - self._reach_ns
        if self._log.oldest_ns is not None and self._log.oldest_ns < closed_ns:
            closed = self._log.forget_before(closed_ns)
            if self._model.closed is not None:
                self._model.closed(closed)
        self._model.forget_before(closed_ns)

    def _step(
        self, state: State, item: Measured | _Opening[Jump]
    ) -> tuple[State, Judged | _Opening[Jump]] | None:
        if isinstance(item, _Opening):
            return self._model.opened(state, item.jump), item
        return self._model.step(state, item, item.time_ns >= self.window.oldest_ns)

    def _failed(self, item: Measured | _Opening[Jump], error: Exception) -> Judged | _Opening[Jump]:
        why = failure(error)
        return replace(item, failed=why) if isinstance(item, _Opening) else self._model.failed(item, why)

    # -- outputs --------------------------------------------------------------------------------------------

    def follows(self, time_ns: int) -> bool:
        """Whether an output for a moment may still go out: it is later than all before."""
        return self._last_claim_ns is None or time_ns > self._last_claim_ns

    def put_out(
        self,
        outcome: Outcome[Judged, Estimate],
        time_ns: int,
        waiting_ns: int,
        estimate: Callable[[State], Estimate | None],
        patience_ns: int = SECOND_NS,
    ) -> None:
        """Put out the estimate of a moment that is later than all before, where there is one.

        An estimate that cannot be computed is told as a failure; the next one is tried all the same.

        Args:
            outcome: takes the estimate.
            time_ns: the moment.
            waiting_ns: the time of waiting.
            estimate: computes it from the state now; None where there is none.
            patience_ns: how long the next one may take before INVALID is said; never less than a second.
        """
        if not self.follows(time_ns):
            return
        try:
            found = estimate(self.state_now)
        except Exception as error:
            outcome.failures.append((time_ns, failure(error)))
            return
        if found is not None:
            outcome.estimates.append(found)
            self.was_put_out(time_ns, waiting_ns, patience_ns)

    def was_put_out(self, time_ns: int, waiting_ns: int, patience_ns: int = SECOND_NS) -> None:
        """An estimate of a moment went out, later than all before; arguments as in :meth:`put_out`."""
        self._last_claim_ns, self._said_invalid_ns = time_ns, None
        self._silent_after_ns = waiting_ns + max(patience_ns, SECOND_NS)

    def continue_outputs(self, before: "EstimatorShell[Any, Any, Any, Any, Any]") -> None:
        """Go on with the outputs where another shell ends: what this one put out itself was not published."""
        self._last_claim_ns, self._said_invalid_ns = before._last_claim_ns, before._said_invalid_ns
        self._silent_after_ns = before._silent_after_ns

    @property
    def state_now(self) -> State:
        """The state for outputs: jumps count at once, also where measurements of before them still wait."""
        if not (self._jumped and self._log.waiting):
            return self.state
        openings = [item for item in self._log.not_applied() if isinstance(item, _Opening)]
        return functools.reduce(lambda state, opening: self._model.opened(state, opening.jump), openings, self.state)

    def say_invalid(
        self, outcome: Outcome[Judged, Estimate], waiting_ns: int, nothing: Callable[[], Estimate]
    ) -> None:
        """Say, once a second, that there is no estimate, where none went out for too long whatever came in.

        Such an output carries the time of a tick. An INVALID output does not count for output order; an
        older valid estimate may follow.
        """
        if self._silent_after_ns is not None and waiting_ns <= self._silent_after_ns:
            return
        if self._said_invalid_ns is not None and waiting_ns - self._said_invalid_ns < SECOND_NS:
            return
        self._said_invalid_ns = waiting_ns
        outcome.estimates.append(nothing())

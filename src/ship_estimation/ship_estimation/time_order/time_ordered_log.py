"""Log of the uncommitted measurements in time order, each with the state after it, and rate limits of repetitions."""

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from ship_geometry.earth.time_scales import SECOND_NS

State = TypeVar("State")
Item = TypeVar("Item")
AnyDecision = TypeVar("AnyDecision")

MOST_REPEATS_PER_S = 400
"""Maximum number of measurements applied again in a second.

Ordinary data need ten repetitions in a second. Inputs of a ship that all arrive out of order by up to two seconds need
two to three hundred repetitions. A flood of data out of order would need thousands, and delay the outputs."""
MOST_REPEATS_AT_ONCE = 50
"""Maximum number of measurements applied again for one input, which limits the delay of the next output."""
MOST_OVERTAKEN_PER_S = 200
"""Maximum number of pairs in a second. A pair is an arriving measurement and a measurement of the same source in the
log with a later stamp. The number suffices for star exposures at 14 Hz in any order within two seconds, and for
attitudes at 100 Hz late by up to 0.1 s."""


class _RateLimit:
    """Rate limit with a burst of one second.

    Args:
        per_s: permitted number of events in a second.
    """

    def __init__(self, per_s: int) -> None:
        self._cost_ns = SECOND_NS // per_s
        self._paid_until_ns = -SECOND_NS

    def allows(self, count: int, now_ns: int) -> bool:
        """True if ``count`` more events are permitted."""
        return self._since_ns(now_ns) + count * self._cost_ns <= now_ns

    def spend(self, count: int, now_ns: int) -> None:
        """Use up ``count`` events, even if fewer events are permitted."""
        self._paid_until_ns = self._since_ns(now_ns) + count * self._cost_ns

    def _since_ns(self, now_ns: int) -> int:
        """Return the time up to which the limit is used up, bounded to one second before and after ``now_ns``."""
        return min(max(self._paid_until_ns, now_ns - SECOND_NS), now_ns + SECOND_NS)


Key = tuple[int, Any]
"""Key (time_ns, tie-breaker), which gives the order of application."""


@dataclass
class _Entry(Generic[State, Item, AnyDecision]):
    key: Key
    measurement: Item
    decision: AnyDecision | None = None
    state_after: State | None = None


class TimeOrderedLog(Generic[State, Item, AnyDecision]):
    """Committed state, and the uncommitted measurements in time order, each with the state after the measurement.

    A measurement out of order is inserted, and the later measurements become pending and are applied again. A
    measurement for which the step raises an exception changes no state and delays no other measurement.

    Args:
        state: the state before any measurement.

    Attributes:
        base: the committed state, before the first measurement of the window.
        state: state after the last measurement applied by :meth:`apply`.
        pending_count: number of measurements not applied yet.
        oldest_ns: time of the first measurement that is not committed; None without measurements.
    """

    def __init__(self, state: State) -> None:
        self.base = self.state = state
        self._keys: list[Key] = []
        self._entries: list[_Entry[State, Item, AnyDecision]] = []
        self.pending_count = 0
        self.oldest_ns: int | None = None
        self._repeats = _RateLimit(MOST_REPEATS_PER_S)
        self._overtaking_limits: dict[Any, _RateLimit] = {}

    @property
    def is_behind(self) -> bool:
        """True if the next measurement was applied before and is pending only because of the rate limits."""
        return self.pending_count > 0 and self._entries[self._applied_count].decision is not None

    def pending_measurements(self) -> list[Item]:
        """Return the pending measurements, in order."""
        return [entry.measurement for entry in self._entries[self._applied_count :]]

    def get(self, key: Key) -> Item | None:
        """Return the measurement with exactly this key, or None."""
        index = bisect.bisect_left(self._keys, key)
        found = index < len(self._keys) and self._keys[index] == key
        return self._entries[index].measurement if found else None

    def may_overtake(self, key: Key, now_ns: int) -> bool:
        """True if a measurement may be inserted before later ones of its source; the pairs then count for the limit.

        Args:
            key: key of the measurement; the tie-breaker is the source.
            now_ns: the time now, for the rate limit.
        """
        overtaken = sum(other[1] == key[1] for other in self._keys[bisect.bisect_right(self._keys, key) :])
        if not overtaken:
            return True
        limit = self._overtaking_limits.setdefault(key[1], _RateLimit(MOST_OVERTAKEN_PER_S))
        if not limit.allows(overtaken, now_ns):
            return False
        limit.spend(overtaken, now_ns)
        return True

    def insert(self, key: Key, measurement: Item) -> None:
        """Insert or replace the measurement with a key; this measurement and all later measurements become pending."""
        index = bisect.bisect_left(self._keys, key)
        if index < len(self._keys) and self._keys[index] == key:
            self._entries[index].measurement = measurement
        else:
            self._keys.insert(index, key)
            self._entries.insert(index, _Entry(key, measurement))
            self.oldest_ns = self._keys[0][0]
            self.pending_count += 1
        self.pending_count = max(self.pending_count, len(self._entries) - index)

    def rewind_to_first(self, affected: Callable[[AnyDecision], bool]) -> None:
        """Make the first measurement whose decision is affected, and all later measurements, pending again."""
        for index in range(self._applied_count):
            decision = self._entries[index].decision
            if decision is not None and affected(decision):
                self.pending_count = len(self._entries) - index
                return

    def apply(
        self,
        step: Callable[[State, Item], tuple[State, AnyDecision] | None],
        failure_decision: Callable[[Item, Exception], AnyDecision],
        window_ns: tuple[int, int] | None = None,
    ) -> list[tuple[AnyDecision, AnyDecision | None]]:
        """Apply pending measurements, in order, until ``step`` returns None because required data may still arrive.

        Args:
            step: function that returns state and decision after a measurement.
            failure_decision: function that returns the decision about a measurement for which ``step`` raised an
                exception; the state is kept.
            window_ns: stamp before which no relevant data can arrive, and present time; None for no limit. At most
                :data:`MOST_REPEATS_AT_ONCE` measurements are applied again, and :data:`MOST_REPEATS_PER_S` in a second.
                The other measurements stay pending until a later call. Measurements before the stamp are applied again
                without a limit. The limit does not change the final state.

        Returns:
            The decision about each applied measurement and the decision that it replaces, or None.
        """
        decisions: list[tuple[AnyDecision, AnyDecision | None]] = []
        repeats = 0
        while self.pending_count:
            index = self._applied_count
            entry, self.state = self._entries[index], self._state_before(index)
            again = entry.decision is not None
            if again and window_ns is not None and not self._may_repeat(entry.key, repeats, *window_ns):
                break
            result: tuple[State, AnyDecision] | None
            try:
                result = step(self.state, entry.measurement)
            except Exception as error:
                result = self.state, failure_decision(entry.measurement, error)
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
            self.pending_count -= 1
        return decisions

    def commit_before(self, time_ns: int) -> list[State]:
        """Commit the applied measurements before a time; these measurements can then no longer be revised.

        Returns:
            The state after each committed measurement.
        """
        count = min(bisect.bisect_left(self._keys, (time_ns,)), self._applied_count)
        closed = self.states(count)
        if count:
            self.base = closed[-1]
            del self._keys[:count]
            del self._entries[:count]
            self.oldest_ns = self._keys[0][0] if self._keys else None
        return closed

    def states(self, count: int | None = None) -> list[State]:
        """Return the states after the first ``count`` measurements of the window; None for all applied measurements."""
        return [self._state_before(number + 1) for number in range(self._applied_count if count is None else count)]

    @property
    def _applied_count(self) -> int:
        """Number of applied measurements, which are always the first measurements of the window."""
        return len(self._entries) - self.pending_count

    def _may_repeat(self, key: Key, repeats: int, closed_ns: int, now_ns: int) -> bool:
        # Before the closed time no data can arrive, so one more repetition is final there.
        return key[0] < closed_ns or (repeats < MOST_REPEATS_AT_ONCE and self._repeats.allows(1, now_ns))

    def _state_before(self, index: int) -> State:
        if index == 0:
            return self.base
        state = self._entries[index - 1].state_after
        assert state is not None  # applied entries always have their state
        return state

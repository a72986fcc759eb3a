"""What is kept in the order of its own stamps, whatever the order of arrival.

:class:`TimeOrderedLog` keeps, for a window of time, every measurement with the state after it. One that arrives late
takes its place, and everything after it is applied again from the state before it. Any order of arrival inside the
window therefore ends in the same state, to the last bit. One on which the step raises changes no state and holds up
no other. :class:`StampedValues` keeps values without a state.
"""

import bisect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from ship_estimation.refusals import Content, Refusal, same_stamp
from ship_geometry.time_scales import SECOND_NS

State = TypeVar("State")
Measurement = TypeVar("Measurement")
Decision = TypeVar("Decision")
Value = TypeVar("Value", bound=Content)

MOST_REPEATS_PER_S = 400
"""Measurements applied again in a second of data: ten in ordinary data, two hundred where every input of a ship comes
out of order by up to two seconds. A flood of late ones would make thousands, and hold up the output."""


Key = tuple[int, Any]
"""(time_ns, tie-breaker): the order of application."""


@dataclass
class _Entry(Generic[Measurement, State, Decision]):
    key: Key
    measurement: Measurement
    decision: Decision | None = None
    state_after: State | None = None


class TimeOrderedLog(Generic[State, Measurement, Decision]):
    """The window of measurements over a base state.

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
        self._entries: list[_Entry[Measurement, State, Decision]] = []
        self.waiting = 0
        self.oldest_ns: int | None = None
        self._repeats, self._repeats_since_ns = 0, 0

    def not_applied(self) -> list[Measurement]:
        """The measurements that wait, in order."""
        return [entry.measurement for entry in self._entries[self._applied :]]

    def get(self, key: Key) -> Measurement | None:
        """The measurement of exactly this time and tie-breaker."""
        index = bisect.bisect_left(self._keys, key)
        found = index < len(self._keys) and self._keys[index] == key
        return self._entries[index].measurement if found else None

    def insert(self, key: Key, measurement: Measurement) -> None:
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

    def rewind_where(self, affected: Callable[[Decision], bool]) -> None:
        """Apply again, at the next :meth:`apply`, from the first measurement whose decision is affected."""
        for index in range(self._applied):
            decision = self._entries[index].decision
            if decision is not None and affected(decision):
                self.waiting = len(self._entries) - index
                return

    def apply(
        self,
        step: Callable[[State, Measurement], tuple[State, Decision] | None],
        failed: Callable[[Measurement, Exception], Decision],
        window_ns: tuple[int, int] | None = None,
    ) -> list[tuple[Decision, Decision | None]]:
        """Apply what waits, in order, until ``step`` returns None because it needs data still to come.

        Args:
            step: state and decision after a measurement.
            failed: the decision about a measurement on which ``step`` raised; the state stays as it was before it.
            window_ns: the oldest and the newest stamp of the window. What was applied before is applied again at
                most :data:`MOST_REPEATS_PER_S` times in a second of data; beyond that it waits for the next one, or
                until it leaves the window: the state is behind meanwhile, and ends the same. None: nothing waits.

        Returns:
            For each measurement applied: its decision and, where it had been applied before, the one it replaces.
        """
        decisions: list[tuple[Decision, Decision | None]] = []
        while self.waiting:
            index = self._applied
            entry, self.state = self._entries[index], self._state_before(index)
            if window_ns is not None and entry.decision is not None and not self._may_repeat(entry.key, *window_ns):
                break
            result: tuple[State, Decision] | None
            try:
                result = step(self.state, entry.measurement)
            except Exception as error:
                result = self.state, failed(entry.measurement, error)
            if result is None:
                break
            previous = entry.decision
            self._repeats += previous is not None
            self.state, entry.decision = result
            entry.state_after = self.state
            decisions.append((entry.decision, previous))
            self.waiting -= 1
        return decisions

    def forget_before(self, time_ns: int) -> None:
        """Close the window at a time: applied measurements before it can no longer be revised."""
        count = min(bisect.bisect_left(self._keys, (time_ns,)), self._applied)
        if count:
            self._base = self._state_before(count)
            del self._keys[:count]
            del self._entries[:count]
            self.oldest_ns = self._keys[0][0] if self._keys else None

    @property
    def _applied(self) -> int:
        """Number of measurements of the window that are applied: always its first ones."""
        return len(self._entries) - self.waiting

    def _may_repeat(self, key: Key, oldest_ns: int, newest_ns: int) -> bool:
        if newest_ns - self._repeats_since_ns >= SECOND_NS:
            self._repeats, self._repeats_since_ns = 0, newest_ns
        # What leaves the window can only now be right; it does so once.
        return self._repeats < MOST_REPEATS_PER_S or key[0] < oldest_ns

    def _state_before(self, index: int) -> State:
        if index == 0:
            return self._base
        state = self._entries[index - 1].state_after
        assert state is not None  # entries before the applied mark always carry their state
        return state


class StampedValues(Generic[Value]):
    """A window of values; of two with the same stamp the one whose bytes sort first is kept.

    Attributes:
        times: stamps, increasing.
        values: of the same length.
    """

    def __init__(self) -> None:
        self.times: list[int] = []
        self.values: list[Value] = []

    def refusal(self, time_ns: int, value: Value) -> Refusal | None:
        """DUPLICATE or CONFLICT where there is a value of that stamp."""
        known = self._at(time_ns)
        return None if known is None else same_stamp(known, value)[1]

    def insert(self, time_ns: int, value: Value) -> int | None:
        """Put a value in its place; returns its index, None where another one of its stamp is kept."""
        index = bisect.bisect_left(self.times, time_ns)
        known = self._at(time_ns)
        if known is None:
            self.times.insert(index, time_ns)
            self.values.insert(index, value)
            return index
        if known.content() <= value.content():
            return None
        self.values[index] = value
        return index

    def last_before(self, time_ns: int) -> int:
        """Index of the last value at or before a moment; -1 where there is none."""
        return bisect.bisect_right(self.times, time_ns) - 1

    def drop_before(self, time_ns: int, keep: int = 1) -> None:
        """Forget old values, but keep the last ``keep`` at or before a moment and all after it."""
        count = bisect.bisect_right(self.times, time_ns) - keep
        if count > 0:
            del self.times[:count]
            del self.values[:count]

    def _at(self, time_ns: int) -> Value | None:
        index = bisect.bisect_left(self.times, time_ns)
        found = index < len(self.times) and self.times[index] == time_ns
        return self.values[index] if found else None

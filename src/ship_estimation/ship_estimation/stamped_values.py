"""Values kept in the order of their stamps, whatever the order of their arrival."""

import bisect
from typing import Generic, TypeVar

from ship_estimation.refusals import Content, Refusal, same_stamp

Value = TypeVar("Value", bound=Content)


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

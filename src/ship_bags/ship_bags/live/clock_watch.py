"""Tells steps of a clock — set by hand, by NTP after a long outage, or back with a bag — from its running."""

# A clock that is slewed (500 ppm at most) changes by less between two looks; a step below it disturbs no filter.
STEP_NS = 50_000_000
# Longer between the readings of the two clocks, and the comparison says nothing.
_LONGEST_READING_NS = 5_000_000


class ClockWatch:
    """Compares the system clock with the steady clock, which never steps."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def look(self, steady_before_ns: int, clock_ns: int, steady_after_ns: int) -> int | None:
        """Step of the clock since the last look, in nanoseconds; None where there was none.

        Args:
            steady_before_ns: steady clock read before the clock, ...
            clock_ns: the clock, ...
            steady_after_ns: ... and after it: a process that was put to sleep in between has not seen a step.
        """
        if steady_after_ns - steady_before_ns > _LONGEST_READING_NS:
            return None
        offset_ns = clock_ns - steady_before_ns
        step_ns = 0 if self._offset_ns is None else offset_ns - self._offset_ns
        self._offset_ns = offset_ns
        return step_ns if abs(step_ns) > STEP_NS else None

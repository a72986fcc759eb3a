"""Time of a suite: UTC by the stamps of its messages."""

from ship_bags.stamps import NS_PER_S

CLOCK_TOLERANCE_NS = NS_PER_S // 10
"""Maximum delay, behind the suite's time, of a stamp that confirms this time, ns.

The stamp is that of an output or InputHealth.
"""

CLOCK_TIMEOUT_NS = 5 * NS_PER_S
"""Time without a confirming stamp after which the suite's time is set again, ns."""


class SuiteTime:
    """The suite's time: stamp of the output or InputHealth with the least delay, plus the time since then.

    If the stamps of all these messages stay behind this time for some seconds, that stamp was wrong or the clock was
    set. The suite's time is then set again.

    Attributes:
        utc_offset_ns: suite's time minus the caller's time.
    """

    def __init__(self) -> None:
        self._newest_ns, self.utc_offset_ns, self._confirmed_ns = 0, 0, 0

    @property
    def is_known(self) -> bool:
        """True after the first stamp."""
        return self._newest_ns != 0

    def utc_ns(self, now_ns: int) -> int:
        """Return the suite's time at a time of the caller."""
        return now_ns + self.utc_offset_ns

    def update(self, stamp_ns: int, now_ns: int) -> None:
        """Update the suite's time by the stamp of a message that arrives now."""
        offset_ns = stamp_ns - now_ns
        if offset_ns > self.utc_offset_ns or not self._newest_ns or now_ns - self._confirmed_ns > CLOCK_TIMEOUT_NS:
            self.utc_offset_ns, self._confirmed_ns = offset_ns, now_ns
        elif offset_ns > self.utc_offset_ns - CLOCK_TOLERANCE_NS:
            self._confirmed_ns = now_ns
        self._newest_ns = max(self._newest_ns, stamp_ns)

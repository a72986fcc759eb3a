"""Overload detection: when a node is behind its inputs, and when it keeps up again.

The queue time of a message is the time from its arrival to its use. The queue time is measured by the running clock: a
steady clock or, with ``use_sim_time``, /clock, so that a bag played too fast is detected as well. After a short
standstill of the node, messages have waited long but are processed at once, so the node is not behind. A node is behind
if queue times stay long while the node is working, or if a queue time exceeds :data:`MAX_QUEUE_TIME_NS`.
"""

import enum
import os
from collections.abc import Callable, Mapping

from ship_node.health.overload import Overload
from ship_node.live.node_clock import TimeoutClock

LONG_QUEUE_TIME_NS = 1_000_000_000
"""Queue time that counts as long, ns.

The sum of this time and :data:`BEHIND_AFTER_NS` does not exceed the default ``lag_s``. So the next node
does not reject as late the outputs of a node that is not behind."""

BEHIND_AFTER_NS = 1_000_000_000
"""Working time, without standstills, for which queue times may stay long before the node is behind, ns."""

MAX_QUEUE_TIME_NS = 3_000_000_000
"""Queue time above which a node is behind at once, ns."""

SHORT_QUEUE_TIME_NS = 200_000_000
"""Maximum queue time in a node that keeps up, ns: twice the longest wait for an event.

If /clock runs faster than real time, queue times are divided by its rate before the comparison."""

RECOVERED_AFTER_NS = 1_000_000_000
"""Steady time with short queue times after which a node keeps up again, ns."""


class OverloadChange(enum.Enum):
    """Change of the overload state."""

    NONE = enum.auto()
    BEHIND = enum.auto()
    """The node is behind; its waiting messages must be dropped."""
    KEEPS_UP = enum.auto()


class Backlog:
    """Overload detector based on the queue time of a node's oldest message.

    Args:
        steady_ns: a steady clock, ns.

    Attributes:
        is_behind: True from the detection of an overload until the node keeps up again.
    """

    def __init__(self, steady_ns: Callable[[], int]) -> None:
        self._steady_ns = steady_ns
        self.is_behind = False
        self._last_long_ns = self._last_long_running_ns = 0
        self.restart()

    def restart(self) -> None:
        """Reset the working time, because the running clock went back."""
        self._running_ns = 0
        self._worked = TimeoutClock(lambda: self._running_ns)
        self._last_short_ns: int | None = None

    def evaluate(self, waited_ns: int, running_ns: int) -> OverloadChange:
        """Return the change of the overload state; BEHIND also if a node that is behind must drop messages again.

        Args:
            waited_ns: queue time of the oldest message; 0 if no message waits.
            running_ns: current time by the running clock.
        """
        self._running_ns = running_ns
        worked_ns = self._worked.now_ns(0)
        if waited_ns < LONG_QUEUE_TIME_NS or self._last_short_ns is None:
            self._last_short_ns = worked_ns
        if waited_ns > MAX_QUEUE_TIME_NS or worked_ns - self._last_short_ns > BEHIND_AFTER_NS:
            self._last_short_ns = worked_ns
            self._last_long_ns, self._last_long_running_ns = self._steady_ns(), running_ns
            self.is_behind = True
            return OverloadChange.BEHIND
        if not self.is_behind:
            return OverloadChange.NONE
        steady_ns = self._steady_ns()
        since_long_ns = steady_ns - self._last_long_ns
        # The queue time is divided by the rate of /clock since the last long queue time, at least 1; the comparison
        # needs no division.
        if waited_ns * since_long_ns > SHORT_QUEUE_TIME_NS * max(
            since_long_ns, running_ns - self._last_long_running_ns
        ):
            self._last_long_ns, self._last_long_running_ns, since_long_ns = steady_ns, running_ns, 0
        if since_long_ns < RECOVERED_AFTER_NS:
            return OverloadChange.NONE
        self.is_behind = False
        return OverloadChange.KEEPS_UP


def current_overload(behind_ns: int, cut: Mapping[str, int]) -> Overload:
    """Return the overload state of a node, with the current load of the computer."""
    return Overload(behind_ns * 1e-9, len(os.sched_getaffinity(0)), os.getloadavg()[0], dict(cut))

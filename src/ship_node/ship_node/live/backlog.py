"""When a node is behind its inputs, and when it keeps up again.

The waiting time of a message runs from its arrival to its use, in steady time; where /clock rules, in its time, so that
a bag that is played too fast is found as well. A node that stood still for a moment has messages that waited long, and
takes them in one go: it is not behind. It is behind where messages wait long although it works.
"""

import enum
import os
from collections.abc import Callable, Mapping

from ship_node.edge.overload import Overload
from ship_node.live.node_clock import WaitingClock

LONG_WAIT_NS = 1_000_000_000
"""Waiting time from which on a node is nearly behind, ns. With :data:`WORKED_NS` it stays within the default ``lag_s``:
what the node publishes is not late at the next one."""

WORKED_NS = 1_000_000_000
"""Time of work, without standstills, in which the waiting time of a node that is not behind falls below
:data:`LONG_WAIT_NS`, ns."""

LONGEST_WAIT_NS = 3_000_000_000
"""Waiting time from which on a node is behind at once, ns."""

SHORT_WAIT_NS = 200_000_000
"""Longest waiting time of a node that keeps up, ns: twice the longest wait for an event.
Where /clock is faster than real time, this is real time."""

KEPT_UP_NS = 1_000_000_000
"""Steady time with short waiting times after which a node keeps up again, ns."""


class Change(enum.Enum):
    """Result of judging the waiting time of the oldest message."""

    NONE = enum.auto()
    BEHIND = enum.auto()
    """All that waits is to be cut."""
    KEEPS_UP = enum.auto()


class Backlog:
    """Judges the waiting time of a node's oldest message.

    Args:
        steady_ns: a clock that never jumps.

    Attributes:
        is_behind: True from a cut until the node keeps up.
    """

    def __init__(self, steady_ns: Callable[[], int]) -> None:
        self._steady_ns = steady_ns
        self.is_behind = False
        self._last_long_ns = self._last_long_running_ns = 0
        self.restart()

    def restart(self) -> None:
        """Forget how long the node has worked: the clock of waiting times went back."""
        self._running_ns = 0
        self._worked = WaitingClock(lambda: self._running_ns)
        self._last_short_ns: int | None = None

    def judge(self, waited_ns: int, running_ns: int) -> Change:
        """Return what has changed.

        Args:
            waited_ns: waiting time of the oldest message; 0 where none waits.
            running_ns: time now, by the clock of waiting times.
        """
        self._running_ns = running_ns
        worked_ns = self._worked.now_ns(0)
        if waited_ns < LONG_WAIT_NS or self._last_short_ns is None:
            self._last_short_ns = worked_ns
        if waited_ns > LONGEST_WAIT_NS or worked_ns - self._last_short_ns > WORKED_NS:
            self._last_short_ns = worked_ns
            self._last_long_ns, self._last_long_running_ns = self._steady_ns(), running_ns
            self.is_behind = True
            return Change.BEHIND
        if not self.is_behind:
            return Change.NONE
        steady_ns = self._steady_ns()
        since_long_ns = steady_ns - self._last_long_ns
        # By the rate of /clock since the last long wait; a clock that is slow or stands makes no wait shorter.
        if waited_ns * since_long_ns > SHORT_WAIT_NS * max(since_long_ns, running_ns - self._last_long_running_ns):
            self._last_long_ns, self._last_long_running_ns, since_long_ns = steady_ns, running_ns, 0
        if since_long_ns < KEPT_UP_NS:
            return Change.NONE
        self.is_behind = False
        return Change.KEEPS_UP


def overload(behind_ns: int, cut: Mapping[str, int]) -> Overload:
    """Return how far a node is behind, with the load of the computer now."""
    return Overload(behind_ns * 1e-9, len(os.sched_getaffinity(0)), os.getloadavg()[0], dict(cut))

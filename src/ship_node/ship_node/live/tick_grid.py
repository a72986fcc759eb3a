"""The time of waiting of a live node, and the moments at which a node ticks: multiples of a period in that time."""

from collections.abc import Callable, Iterator

from ship_node.edge.adapter import TICK_PERIOD_NS


class WaitingClock:
    """The time in which a node was listening: what judges silence where no /clock rules.

    It goes with a clock that nobody sets, whatever becomes of the system's time. It begins at the node's time, so that
    the two are near one another in a black box.

    Args:
        steady_ns: a clock that never jumps.
    """

    LONGEST_STEP_NS = 2 * TICK_PERIOD_NS
    """A standstill of the node counts as no more: what came meanwhile lies unread, and that is no silence."""

    def __init__(self, steady_ns: Callable[[], int]) -> None:
        self._steady_ns = steady_ns
        self._last_ns = 0
        self._waiting_ns: int | None = None

    def now_ns(self, node_ns: int) -> int:
        """The time of waiting; ``node_ns`` is the node's time. A node at work asks at every tick."""
        last_ns, self._last_ns = self._last_ns, self._steady_ns()
        if self._waiting_ns is None:
            self._waiting_ns = node_ns
        else:
            self._waiting_ns += min(self._last_ns - last_ns, self.LONGEST_STEP_NS)
        return self._waiting_ns


class TickGrid:
    """Which ticks are due: every multiple of the period that time has reached, each once."""

    def __init__(self, period_ns: int = TICK_PERIOD_NS) -> None:
        self._period_ns = period_ns
        self._newest: int | None = None

    def due(self, now_ns: int) -> Iterator[int]:
        """The ticks up to and including ``now_ns`` since the last call, ns; the first call only starts the grid."""
        reached = now_ns // self._period_ns
        for number in range((reached if self._newest is None else self._newest) + 1, reached + 1):
            self._newest = number
            yield number * self._period_ns
        if self._newest is None:
            self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """The clock jumped to ``now_ns``: the grid starts there anew, nothing is made up for."""
        self._newest = now_ns // self._period_ns

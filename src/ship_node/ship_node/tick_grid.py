"""The moments at which a node ticks: the multiples of a period, the same live and in replay."""

from collections.abc import Iterator

from ship_node.adapter import TICK_PERIOD_NS


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

"""The time of a live node: by its clock, of waiting, and whether /clock still comes where it rules."""

from collections.abc import Callable

from rclpy.node import Node

from ship_node.edge.adapter import TICK_PERIOD_NS
from ship_node.edge.messages_out import DiagnosticStatus, Level
from ship_node.live.clock_queue import queue_clock
from ship_node.live.tick_grid import WaitingClock

DEAD_AFTER_NS = 2_000_000_000
"""/clock comes many times a second, from a paused `play` too: after so long a silence it is dead, ns."""

_START_NS = 5_000_000_000
"""The first /clock may take longer: who sends it is still to be found, ns."""


class NodeClock:
    """Both times that an adapter is given (:class:`ship_node.edge.adapter.Adapter`).

    Where /clock rules, the two are one as long as it comes. When it is dead, the node's time stands, and the time of
    waiting goes on by a steady clock, whole ticks at a time: what is then claimed no more is told as for any silence.

    Args:
        node: has its subscriptions still to come, so that /clock can be queued beside them.
        steady_ns: a clock that never jumps.
        on_event: called after each message of /clock.
    """

    def __init__(self, node: Node, steady_ns: Callable[[], int], on_event: Callable[[], None]) -> None:
        self._clock = node.get_clock()
        self._on_event = on_event
        self._waiting = WaitingClock(steady_ns)
        self._listening = WaitingClock(steady_ns)
        self._heard_ns, self._was_heard = self._listening.now_ns(0), False
        self._stood_still_before_ns = 0
        queue_clock(node, self._hear)

    def now_ns(self) -> int:
        """Time of the node; 0 while it waits for its first /clock."""
        return int(self._clock.now().nanoseconds)

    def times(self) -> tuple[int, int]:
        """The node's time and the time of waiting, ns; zeros while the node waits for its first /clock."""
        now_ns = self.now_ns()
        if not self.is_simulated():
            return now_ns, self._waiting.now_ns(now_ns)
        stood_still_ns = self._stood_still_ns()
        return (now_ns, now_ns + stood_still_ns) if now_ns else (0, 0)

    def start_anew(self) -> None:
        """The clock went back: the two times are one again."""
        self._stood_still_before_ns = 0

    def is_simulated(self) -> bool:
        """Whether the node follows /clock."""
        return bool(self._clock.ros_time_is_active)

    def is_dead(self) -> bool:
        """Whether /clock rules, came, and comes no more."""
        return self._was_heard and self._silence_ns() >= DEAD_AFTER_NS

    def status(self) -> DiagnosticStatus:
        """What there is to say about it."""
        if not self.is_simulated():
            return DiagnosticStatus("clock", Level.OK, "running")
        silence_ns = self._silence_ns()
        for_s = f"{silence_ns * 1e-9:.0f} s"
        if self.now_ns() == 0:
            level = Level.ERROR if silence_ns >= _START_NS else Level.OK
            return DiagnosticStatus("clock", level, f"use_sim_time is set, but no /clock came for {for_s}")
        if silence_ns >= DEAD_AFTER_NS:
            text = f"use_sim_time is set, and no /clock came for {for_s}: time stands"
            return DiagnosticStatus("clock", Level.ERROR, text)
        return DiagnosticStatus("clock", Level.OK, "running by /clock")

    def _silence_ns(self) -> int:
        """How long the node has listened since the last /clock."""
        return self._listening.now_ns(0) - self._heard_ns

    def _stood_still_ns(self) -> int:
        """For how long the time of waiting went on without the node's, whole ticks."""
        silence_ns = self._silence_ns()
        ticks = silence_ns // TICK_PERIOD_NS if silence_ns >= DEAD_AFTER_NS else 0
        return self._stood_still_before_ns + ticks * TICK_PERIOD_NS

    def _hear(self) -> None:
        if self._was_heard:
            self._stood_still_before_ns = self._stood_still_ns()
        self._was_heard = True
        self._heard_ns = self._listening.now_ns(0)
        self._on_event()

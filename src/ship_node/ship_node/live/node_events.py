"""What the middleware tells a live node, taken promptly and without letting it pile up."""

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from ship_node.edge.messages_out import DiagnosticStatus, Level
from ship_node.live.guard import Guard
from ship_node.live.tick_grid import WaitingClock

MOST_EVENTS = 1000
"""Events taken in one go: a flood must not stop the node's own work."""

LONGEST_BEHIND_NS = 1_000_000_000
"""Where an event waits for longer than that, all of them are dropped, ns."""

_PULSE_S = 0.2

_SHOWN_NS = 10_000_000_000


class NodeEvents:
    """The events executor of one node.

    It takes half the processor time of the single-threaded one, and hears of messages of all topics in the order in
    which they came. But it queues an event for each message, still there or not, without bound. So callbacks must be
    quick, and where more comes than even they can take, the queue is thrown away: the newest messages of each topic
    are still in the middleware and are told anew. A timer that waits in the queue like all the rest tells how far the
    node is behind.

    Args:
        context: of the node.
        guard: catches what callbacks raise.
        steady_ns: a clock that never jumps.
    """

    def __init__(self, context: Context, guard: Guard, steady_ns: Callable[[], int]) -> None:
        self._context = context
        self._guard = guard
        self._steady_ns = steady_ns
        self._event_came = False
        self._dropped_count = 0
        self._dropped_ns = 0
        # A standstill of the node is no sign of too many events.
        self._listening = WaitingClock(steady_ns)
        self._pulse_ns = self._listening.now_ns(0)

    def start(self, node: Node) -> None:
        """From now on call the node's callbacks."""
        self._node = node
        node.create_timer(_PULSE_S, self._pulse, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._listen()

    def _listen(self) -> None:
        self._pulse_ns = self._listening.now_ns(0)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Call no more."""
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def came(self) -> None:
        """A callback calls this: there may be more."""
        self._event_came = True

    def take(self, timeout_s: float) -> None:
        """Call back for what happened, until nothing is left; wait at most so long for the first."""
        for _ in range(MOST_EVENTS):
            self._event_came = False
            self._guard.call("executor", self._executor.spin_once, timeout_s)
            if not self._event_came:
                break
            timeout_s = 0.0
        if self._listening.now_ns(0) - self._pulse_ns > LONGEST_BEHIND_NS + round(_PULSE_S * 1e9):
            self._drop()

    def status(self) -> DiagnosticStatus:
        """Whether the node can take what comes."""
        if self._dropped_count == 0:
            return DiagnosticStatus("events", Level.OK, "taken as they come")
        recent = self._steady_ns() - self._dropped_ns <= _SHOWN_NS
        text = f"overflow: more came than this node can take; what waited was dropped {self._dropped_count} times"
        return DiagnosticStatus("events", Level.ERROR if recent else Level.WARN, text)

    def _drop(self) -> None:
        self._dropped_count += 1
        self._dropped_ns = self._steady_ns()
        self.close()
        self._listen()

    def _pulse(self) -> None:
        self.came()
        self._pulse_ns = self._listening.now_ns(0)

"""The time of a live node: by its clock, of waiting, its ticks, and whether /clock still comes where it rules.

The ticks are multiples of a period in the time of waiting. Nothing of ROS is read before a node follows /clock.
"""

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from ship_node.edge.adapter import TICK_PERIOD_NS
from ship_node.edge.messages_out import DiagnosticStatus, Level

if TYPE_CHECKING:
    from rclpy.node import Node

DEAD_AFTER_NS = 2_000_000_000
"""After so long a silence /clock is dead, ns: a player sends it many times a second, paused too."""

_START_NS = 5_000_000_000
"""The first /clock may take so long, ns: its publisher is still to be found."""

LEAST_STEP_NS = 100_000_000
"""Smallest step of the system's clock, from one look to the next, that counts, ns: no daemon slews so fast."""

_LONGEST_LOOK_NS = 10_000_000
"""Where reading both clocks took longer, they do not belong together, ns."""

CLOCK_DEPTH = 1000
"""Messages of /clock that may wait for the node: ten seconds of a bag's time at the usual 100 Hz."""


class NodeClock:
    """Both times that an adapter is given (:class:`ship_node.edge.adapter.Adapter`).

    Where /clock rules, the two are one as long as it comes. When it is dead, the node's time stands, and the time of
    waiting goes on by a steady clock, whole ticks at a time, so that this silence is judged as any other.

    Args:
        node: has its subscriptions still to come, so that /clock can be queued beside them.
        steady_ns: a clock that never jumps.
        on_event: called after each message of /clock.

    Attributes:
        stepped_ns: sum of the steps of the system's clock since the start, against the steady clock; /clock aside.
    """

    def __init__(self, node: "Node", steady_ns: Callable[[], int], on_event: Callable[[], None]) -> None:
        self._clock, self._steady_ns = node.get_clock(), steady_ns
        self.stepped_ns = 0
        self._ahead_ns: int | None = None
        self._on_event = on_event
        self._waiting = WaitingClock(steady_ns)
        self._listening = WaitingClock(steady_ns)
        self._heard_ns, self._was_heard = self._listening.now_ns(0), False
        self._stood_still_before_ns = 0
        queue_clock(node, self._hear)

    def now_ns(self) -> int:
        """Time of the node; 0 while it waits for its first /clock."""
        # Without /clock the node's clock is the system's, which rclpy asks in many steps.
        return int(self._clock.now().nanoseconds) if self.is_simulated() else time.time_ns()

    def times(self) -> tuple[int, int]:
        """The node's time and the time of waiting, ns; zeros while the node waits for its first /clock."""
        if not self.is_simulated():
            now_ns = self._system_ns()
            return now_ns, self._waiting.now_ns(now_ns)
        now_ns = self.now_ns()
        stood_still_ns = self._stood_still_ns()
        return (now_ns, now_ns + stood_still_ns) if now_ns else (0, 0)

    def running_ns(self) -> int:
        """Return the time by which messages wait for the node: steady time, or that of /clock where it rules."""
        return self.now_ns() if self.is_simulated() else self._steady_ns()

    def _system_ns(self) -> int:
        """The system's time; a step of it since the last look is added to :attr:`stepped_ns`."""
        before_ns, now_ns, after_ns = self._steady_ns(), time.time_ns(), self._steady_ns()
        if after_ns - before_ns <= _LONGEST_LOOK_NS:
            last_ns, self._ahead_ns = self._ahead_ns, now_ns - before_ns
            if last_ns is not None and abs(self._ahead_ns - last_ns) >= LEAST_STEP_NS:
                self.stepped_ns += self._ahead_ns - last_ns
        return now_ns

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
        """State of the clock."""
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
        """For how long the node has listened since the last /clock, ns."""
        return self._listening.now_ns(0) - self._heard_ns

    def _stood_still_ns(self) -> int:
        """For how long the time of waiting went on while the node's time stood, whole ticks, ns."""
        silence_ns = self._silence_ns()
        ticks = silence_ns // TICK_PERIOD_NS if silence_ns >= DEAD_AFTER_NS else 0
        return self._stood_still_before_ns + ticks * TICK_PERIOD_NS

    def _hear(self) -> None:
        if self._was_heard:
            self._stood_still_before_ns = self._stood_still_ns()
        self._was_heard = True
        self._heard_ns = self._listening.now_ns(0)
        self._on_event()


class WaitingClock:
    """The time in which a node was listening, by which silence is judged where no /clock rules.

    It runs with a steady clock, whatever happens to the system's time. It begins at the node's time, so that both are
    near one another in a black box.

    Args:
        steady_ns: a clock that never jumps.
    """

    LONGEST_STEP_NS = 2 * TICK_PERIOD_NS
    """A standstill of the node counts as this at most, ns: messages that came meanwhile wait, which is no silence."""

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
        """The clock jumped to ``now_ns``: the grid starts there anew, and the ticks between are left out."""
        self._newest = now_ns // self._period_ns


def queue_clock(node: "Node", heard: Callable[[], None] = lambda: None) -> None:
    """Keep every message of /clock until the node takes it; without ``use_sim_time`` there is nothing to do.

    rclpy keeps the newest only. In a node that is behind for a moment — a fast bag, a busy machine — time then runs
    ahead of the inputs that still wait: they look late, and their silence is reported while they lie in the queue.
    With an executor that handles messages in order of arrival, queued time is right for each of them.

    Args:
        node: whose /clock.
        heard: called after each message of it.
    """
    # There is no public way to this subscription, and rclpy allows no QoS overrides for it.
    time_source = node._time_source
    if time_source._clock_sub is None:
        return

    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock

    def take(message: Clock) -> None:
        time_source.clock_callback(message)
        heard()

    node.destroy_subscription(time_source._clock_sub)
    time_source._clock_sub = node.create_subscription(
        Clock,
        "/clock",
        take,
        QoSProfile(depth=CLOCK_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
    )

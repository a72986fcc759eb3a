"""Clocks of a live node: node time, timeout clock, ticks, and the state of /clock.

A tick is due at each multiple of the tick period, by the timeout clock. This module imports ROS only for a node that
uses /clock.
"""

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from ship_node.adapters.adapter import TICK_PERIOD_NS
from ship_node.messages.common_messages import DiagnosticStatus, Level

if TYPE_CHECKING:
    from rclpy.node import Node

CLOCK_TIMEOUT_NS = 2_000_000_000
"""Timeout of /clock, ns; a player publishes /clock many times a second, even while paused."""

_FIRST_CLOCK_TIMEOUT_NS = 5_000_000_000
"""Timeout of the first /clock, ns; it is longer, because the publisher must be discovered first."""

MIN_STEP_NS = 100_000_000
"""Smallest change of system time minus steady time between two readings that counts as a step, ns.

No daemon slews so fast.
"""

_MAX_READING_NS = 10_000_000
"""Maximum time between the two steady readings around a reading of the system clock, ns."""

CLOCK_DEPTH = 1000
"""Queue depth of /clock: ten seconds of bag time at the usual 100 Hz."""


class NodeClock:
    """Node time and timeout clock for an adapter (:class:`ship_node.adapters.adapter.Adapter`).

    With ``use_sim_time`` both times are equal until /clock times out. Then the node time is frozen, and the timeout
    clock continues by a steady clock in whole ticks, so that timeouts of the inputs still work. When /clock arrives
    again, the timeout clock stays ahead by the frozen time until :meth:`reset`.

    Args:
        node: node without subscriptions, so that /clock can be queued together with the later inputs.
        steady_ns: a steady clock, ns.
        on_event: called after each message of /clock.

    Attributes:
        stepped_ns: sum of the steps of the system's clock against the steady clock since the start; steps of /clock do
            not count.
        started_ns: time of the first /clock, or of the first /clock after it went back, ns; 0 without /clock. No queue
            time began before.
    """

    def __init__(self, node: "Node", steady_ns: Callable[[], int], on_event: Callable[[], None]) -> None:
        self._clock, self._steady_ns = node.get_clock(), steady_ns
        self.stepped_ns = self.started_ns = 0
        self._ahead_ns: int | None = None
        self._on_event = on_event
        self._timeout_clock = TimeoutClock(steady_ns)
        self._listening = TimeoutClock(steady_ns)
        self._last_clock_ns, self._has_clock = self._listening.now_ns(0), False
        self._frozen_before_ns = 0
        queue_clock(node, self._on_clock)

    def now_ns(self) -> int:
        """Return the node time, ns; 0 while the node waits for its first /clock."""
        # Without /clock the node uses the system clock, whose reading by rclpy is slow.
        return int(self._clock.now().nanoseconds) if self.is_simulated() else time.time_ns()

    def times(self) -> tuple[int, int]:
        """Return node time and timeout-clock time, ns; zeros while the node waits for its first /clock."""
        if not self.is_simulated():
            now_ns = self._system_ns()
            return now_ns, self._timeout_clock.now_ns(now_ns)
        now_ns = self.now_ns()
        frozen_ns = self._frozen_ns()
        return (now_ns, now_ns + frozen_ns) if now_ns else (0, 0)

    def running_ns(self) -> int:
        """Return the time by which queue times are measured: of a steady clock, or of /clock if the node uses it."""
        return self.now_ns() if self.is_simulated() else self._steady_ns()

    def _system_ns(self) -> int:
        """Return the system's time; add a step since the last reading to :attr:`stepped_ns`."""
        before_ns, now_ns, after_ns = self._steady_ns(), time.time_ns(), self._steady_ns()
        if after_ns - before_ns <= _MAX_READING_NS:
            last_ns, self._ahead_ns = self._ahead_ns, now_ns - before_ns
            if last_ns is not None and abs(self._ahead_ns - last_ns) >= MIN_STEP_NS:
                self.stepped_ns += self._ahead_ns - last_ns
        return now_ns

    def reset(self) -> None:
        """Make both times equal again, because the clock went back."""
        self._frozen_before_ns = 0
        self.started_ns = self.now_ns()

    def is_simulated(self) -> bool:
        """Return True if the node uses /clock."""
        return bool(self._clock.ros_time_is_active)

    def is_timed_out(self) -> bool:
        """Return True if /clock is used, has arrived and has timed out."""
        return self._has_clock and self._since_clock_ns() >= CLOCK_TIMEOUT_NS

    def status(self) -> DiagnosticStatus:
        """Return the status of the clock."""
        if not self.is_simulated():
            return DiagnosticStatus("clock", Level.OK, "running")
        since_clock_ns = self._since_clock_ns()
        for_s = f"{since_clock_ns * 1e-9:.0f} s"
        if self.now_ns() == 0:
            level = Level.ERROR if since_clock_ns >= _FIRST_CLOCK_TIMEOUT_NS else Level.OK
            return DiagnosticStatus("clock", level, f"use_sim_time is set, but no /clock for {for_s}")
        if since_clock_ns >= CLOCK_TIMEOUT_NS:
            text = f"no /clock for {for_s}: node time is frozen"
            return DiagnosticStatus("clock", Level.ERROR, text)
        return DiagnosticStatus("clock", Level.OK, "running with /clock")

    def _since_clock_ns(self) -> int:
        """Return the time without standstills since the last /clock, or since the start if none has arrived, ns."""
        return self._listening.now_ns(0) - self._last_clock_ns

    def _frozen_ns(self) -> int:
        """Return the time that the timeout clock ran while the node time was frozen, in whole ticks, ns."""
        since_clock_ns = self._since_clock_ns()
        ticks = since_clock_ns // TICK_PERIOD_NS if since_clock_ns >= CLOCK_TIMEOUT_NS else 0
        return self._frozen_before_ns + ticks * TICK_PERIOD_NS

    def _on_clock(self) -> None:
        if self._has_clock:
            self._frozen_before_ns = self._frozen_ns()
        else:
            self.started_ns = self.now_ns()
        self._has_clock = True
        self._last_clock_ns = self._listening.now_ns(0)
        self._on_event()


class TimeoutClock:
    """Timeout clock without ``use_sim_time``: steady time without standstills of the node.

    The clock starts at the node time, so that both times are similar in a black box, and is then independent of the
    system's time.

    Args:
        steady_ns: a steady clock, ns.
    """

    MAX_STEP_NS = 2 * TICK_PERIOD_NS
    """Maximum time counted for a standstill of the node, ns.

    Messages that arrive meanwhile are in the queue and must not seem missing.
    """

    def __init__(self, steady_ns: Callable[[], int]) -> None:
        self._steady_ns = steady_ns
        self._last_ns = 0
        self._waiting_ns: int | None = None

    def now_ns(self, node_ns: int) -> int:
        """Return the timeout-clock time, ns; a node that is not at a standstill calls this at least once per tick.

        Args:
            node_ns: the node time, at which the clock starts with the first call; later calls ignore it.
        """
        last_ns, self._last_ns = self._last_ns, self._steady_ns()
        if self._waiting_ns is None:
            self._waiting_ns = node_ns
        else:
            self._waiting_ns += min(self._last_ns - last_ns, self.MAX_STEP_NS)
        return self._waiting_ns


class TickGrid:
    """Grid of ticks: each multiple of the period is a tick, yielded once when the time has reached it."""

    def __init__(self, period_ns: int = TICK_PERIOD_NS) -> None:
        self._period_ns = period_ns
        self._newest: int | None = None

    def ticks_until(self, now_ns: int) -> Iterator[int]:
        """Yield the ticks up to and including ``now_ns`` since the last call, ns; the first call starts the grid."""
        reached = now_ns // self._period_ns
        for number in range((reached if self._newest is None else self._newest) + 1, reached + 1):
            self._newest = number
            yield number * self._period_ns
        if self._newest is None:
            self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """Restart the grid at ``now_ns`` after a jump of the clock; the ticks in between are left out."""
        self._newest = now_ns // self._period_ns


def queue_clock(node: "Node", on_clock: Callable[[], None] = lambda: None) -> None:
    """Queue every message of /clock until the node processes it; without ``use_sim_time`` do nothing.

    By default, rclpy keeps only the newest message of /clock. In a node that is behind for a moment (a fast bag, a busy
    computer), the node time is then ahead of the inputs that still wait. These inputs seem late, and their timeout is
    reported although they are in the queue. If /clock is queued, an executor that processes messages in order of
    arrival gives each input the right node time.

    Args:
        node: node whose /clock is queued.
        on_clock: called after each message of /clock.
    """
    # rclpy has no public access to this subscription, and no QoS overrides for it.
    time_source = node._time_source
    if time_source._clock_sub is None:
        return

    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock

    def take(message: Clock) -> None:
        time_source.clock_callback(message)
        on_clock()

    node.destroy_subscription(time_source._clock_sub)
    time_source._clock_sub = node.create_subscription(
        Clock,
        "/clock",
        take,
        QoSProfile(depth=CLOCK_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
    )

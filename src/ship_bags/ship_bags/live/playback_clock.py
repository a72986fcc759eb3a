"""Clock of a playback and its control: services of the playing node, and keys on a terminal.

The clock determines when the next event is due. The clock has a rate, and can be paused, stepped and stopped.
"""

import contextlib
import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator

from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from ship_bags.stamps import NS_PER_S

# Maximum duration of one wait, because a lock cannot wait for years. A tiny rate or a long gap may need such a wait.
_MAX_WAIT_S = 3600.0
# Maximum rate; a higher rate plays no faster, and its product with a time may overflow.
_MAX_RATE = 1e9
# Period of /clock while paused, for subscribers that start then.
_PAUSED_CLOCK_PERIOD_S = 0.1
_KEY_POLL_S = 0.2


class PlaybackClock:
    """Bag time running at a rate; other threads and signal handlers may pause, step, speed up and stop the clock.

    Args:
        rate: initial rate, seconds of bag time per second of steady time, positive.
        paused: True to start paused.

    Attributes:
        rate: seconds of bag time per second of steady time.
        is_paused: True if only steps are played now.
        is_stopped: True if the playback is to end.
    """

    def __init__(self, rate: float, paused: bool = False) -> None:
        self.rate = min(rate, _MAX_RATE)
        self.is_paused = paused
        self.is_stopped = False
        self._steps = 0
        # Bag time `_bag_ns` is due at steady time `_steady_ns`.
        self._bag_ns = 0
        self._steady_ns = 0
        # Reentrant (as Condition's own lock is): a signal handler may call stop() inside a wait.
        self._changed = threading.Condition()

    def change_rate(self, factor: float) -> None:
        """Multiply the rate by `factor`, from the current bag time on."""
        with self._changed:
            if not self.is_paused:
                self._bag_ns, self._steady_ns = self._bag_time_ns(), time.monotonic_ns()
            self.rate = min(self.rate * factor, _MAX_RATE)
            self._changed.notify_all()

    def start_at(self, bag_ns: int) -> None:
        """Set the current bag time to `bag_ns`."""
        with self._changed:
            self._bag_ns = bag_ns
            self._steady_ns = time.monotonic_ns()

    def pause(self) -> None:
        """Hold the bag time where it is, until :meth:`resume` or a step."""
        with self._changed:
            if not self.is_paused:
                self._bag_ns = self._bag_time_ns()
                self.is_paused = True
                self._changed.notify_all()

    def resume(self) -> None:
        """Continue from the start of the pause, or from the last step."""
        with self._changed:
            if self.is_paused:
                self._steady_ns = time.monotonic_ns()
                self._steps = 0
                self.is_paused = False
                self._changed.notify_all()

    def toggle(self) -> None:
        """Pause or resume."""
        with self._changed:
            if self.is_paused:
                self.resume()
            else:
                self.pause()

    def step(self) -> bool:
        """Play one more message while paused; return False, without effect, if not paused."""
        with self._changed:
            if self.is_paused:
                self._steps += 1
                self._changed.notify_all()
            return self.is_paused

    def stop(self) -> None:
        """End the current wait and all later waits."""
        with self._changed:
            self.is_stopped = True
            self._changed.notify_all()

    def wait_until(self, bag_ns: int, is_message: bool) -> bool:
        """Wait until bag time `bag_ns` is due: by the clock, or by a step, which ends with the next message.

        Returns:
            False if the playback was stopped.
        """
        with self._changed:
            while not self.is_stopped:
                if self.is_paused and self._steps > 0:
                    self._steps -= is_message
                    self._bag_ns = max(self._bag_ns, bag_ns)
                    return True
                if self.is_paused:
                    self._changed.wait()
                    continue
                remaining_s = (bag_ns - self._bag_time_ns()) / self.rate / NS_PER_S
                if remaining_s <= 0.0:
                    return True
                self._changed.wait(min(remaining_s, _MAX_WAIT_S))
        return False

    def behind_s(self, bag_ns: int) -> float:
        """Return the steady time since bag time `bag_ns` was reached, s; 0 while paused, and before that time."""
        with self._changed:
            return 0.0 if self.is_paused else max(0.0, (self._bag_time_ns() - bag_ns) / self.rate / NS_PER_S)

    def _bag_time_ns(self) -> int:
        """Return the current bag time, while not paused."""
        return self._bag_ns + int((time.monotonic_ns() - self._steady_ns) * self.rate)


def add_services(node: Node, clock: PlaybackClock) -> None:
    """Offer ``~/pause``, ``~/resume``, ``~/toggle_paused`` and ``~/play_next`` (std_srvs/Trigger)."""

    def offer(name: str, action: Callable[[], bool | None]) -> None:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            # Only play_next can be refused.
            response.success = action() is not False
            state = "paused" if clock.is_paused else "playing"
            response.message = state if response.success else f"{state}: pause first"
            return response

        node.create_service(Trigger, f"~/{name}", answer)

    offer("pause", clock.pause)
    offer("resume", clock.resume)
    offer("toggle_paused", clock.toggle)
    offer("play_next", clock.step)


@contextlib.contextmanager
def serve_in_thread(node: Node, clock: PlaybackClock, publish_clock: Callable[[], None]) -> Iterator[None]:
    """Answer the node's services in a thread, and publish the time while paused."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    node.create_timer(
        _PAUSED_CLOCK_PERIOD_S,
        lambda: publish_clock() if clock.is_paused else None,
        clock=Clock(clock_type=ClockType.STEADY_TIME),
    )

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()


@contextlib.contextmanager
def keyboard_control(clock: PlaybackClock) -> Iterator[None]:
    """Read keys of a terminal: space pauses and resumes, s steps, + and - double and halve the rate.

    Without a terminal, and in the background of a shell, no keys are read.
    """
    if not sys.stdin.isatty() or not _is_foreground(sys.stdin.fileno()):
        yield
        return
    terminal = sys.stdin.fileno()
    actions: dict[str, Callable[[], object]] = {
        " ": clock.toggle,
        "s": clock.step,
        "+": lambda: clock.change_rate(2.0),
        "-": lambda: clock.change_rate(0.5),
    }
    before = termios.tcgetattr(terminal)
    finished = threading.Event()

    def listen() -> None:
        while not finished.is_set():
            if select.select([terminal], [], [], _KEY_POLL_S)[0]:
                keys = os.read(terminal, 64)
                if not keys:
                    return
                for key in keys.decode(errors="replace"):
                    if key in actions:
                        actions[key]()

    thread = threading.Thread(target=listen, daemon=True)
    tty.setcbreak(terminal)
    thread.start()
    try:
        yield
    finally:
        finished.set()
        thread.join()
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _is_foreground(terminal: int) -> bool:
    """Return True if the process may change the terminal; a shell would stop a background job that does so."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        # The terminal does not control this process, so a change of the terminal stops no job.
        return True

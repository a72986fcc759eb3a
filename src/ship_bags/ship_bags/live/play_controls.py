"""Hands on a playback: the playing node's services, and keys on a terminal."""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator

from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from ship_bags.live.playback_clock import PlaybackClock

# While paused, the time is said again this often: a consumer that starts then needs it too.
_PAUSED_CLOCK_PERIOD_S = 0.1
_KEY_POLL_S = 0.2


def add_services(node: Node, clock: PlaybackClock) -> None:
    """Offer ``~/pause``, ``~/resume``, ``~/toggle_paused`` and ``~/play_next`` (std_srvs/Trigger)."""

    def offer(name: str, action: Callable[[], bool | None]) -> None:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            # play_next alone can be refused.
            response.success = action() is not False
            state = "paused" if clock.paused else "playing"
            response.message = state if response.success else f"{state}: pause first"
            return response

        node.create_service(Trigger, f"~/{name}", answer)

    offer("pause", clock.pause)
    offer("resume", clock.resume)
    offer("toggle_paused", clock.toggle)
    offer("play_next", clock.step)


@contextlib.contextmanager
def served(node: Node, clock: PlaybackClock, publish_clock: Callable[[], None]) -> Iterator[None]:
    """Answer the node's services in a thread of its own, and say the time while paused."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    node.create_timer(
        _PAUSED_CLOCK_PERIOD_S,
        lambda: publish_clock() if clock.paused else None,
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
def keyboard(clock: PlaybackClock) -> Iterator[None]:
    """Space pauses and goes on, s steps, + and - double and halve the rate, while a terminal listens to us."""
    if not sys.stdin.isatty() or not _is_ours(sys.stdin.fileno()):
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


def _is_ours(terminal: int) -> bool:
    """Whether a terminal may be touched: a shell's job in the background would be stopped for it."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        # It is not the one that controls this process, and stops nobody.
        return True

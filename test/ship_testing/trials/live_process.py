"""Executables run as processes, and an observer of their ROS graph.

A process logs to a file, is terminated at the end, and uses a DDS domain limited to this machine.
"""

import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

# DDS-RTPS: a domain's participant listens at 7410 + 250 * domain + 2 * participant for discovery. Beyond domain 101 the
# ports overlap with the ephemeral ports of Linux.
_FIRST_PORT = 7410
_PORTS_PER_DOMAIN = 250
_PARTICIPANTS = 120
_LAST_DOMAIN = 101
_DOMAIN_STEP = 37
_END_S = 15.0

_POLL_S = 0.02


def free_domain_id() -> int:
    """Return a ROS domain without any participant on this machine.

    Raises:
        OSError: all domains are in use.
    """
    # Parallel runs search in different orders, so that they do not collide.
    for step in range(_LAST_DOMAIN):
        domain = 1 + (os.getpid() + _DOMAIN_STEP * step) % _LAST_DOMAIN
        # All ports are tested, because the first participant may have left before the others.
        if all(_is_port_free(_FIRST_PORT + _PORTS_PER_DOMAIN * domain + 2 * number) for number in range(_PARTICIPANTS)):
            return domain
    raise OSError("no ROS domain is free on this machine: end other ROS programs")


def _is_port_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return False
    return True


def live_environment(domain_id: int, log_folder: Path) -> dict[str, str]:
    """Return this process's environment with a ROS domain limited to this machine and a folder for ROS's own logs."""
    own = {
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(log_folder),
        "PYTHONUNBUFFERED": "1",
    }
    return {name: value for name, value in os.environ.items() if name != "ROS_STATIC_PEERS"} | own


class LiveProcess:
    """A running executable; it is terminated at the end of its ``with`` statement, by force if necessary.

    Args:
        command: program and arguments.
        log_path: file for stdout and stderr of the process.
        environment: see :func:`live_environment`.
    """

    def __init__(self, command: Sequence[str], log_path: Path, environment: Mapping[str, str]) -> None:
        self.log_path = log_path
        with open(log_path, "wb") as log:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=dict(environment),
            )

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while the process runs, negative after a signal."""
        return self._process.poll()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def log_text(self) -> str:
        """Return the output of the process so far."""
        return self.log_path.read_text(encoding="utf-8", errors="replace")

    def wait(self, timeout_s: float) -> int:
        """Wait for the end of the process and return the exit code.

        Raises:
            subprocess.TimeoutExpired: the process still runs after `timeout_s`.
        """
        return self._process.wait(timeout_s)

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Send a signal, wait for the end and return the exit code.

        Raises:
            subprocess.TimeoutExpired: the process did not end.
        """
        if self._process.poll() is None:
            self._process.send_signal(how)
        return self._process.wait(_END_S)

    def __enter__(self) -> "LiveProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self.end()
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class GraphObserver:
    """A node that waits for publishers, subscribers and messages in a domain; use it in a ``with`` statement.

    The environment of this process must limit discovery to this machine, see :func:`live_environment`.
    """

    def __init__(self, domain_id: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node: Node = rclpy.create_node("observer", context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)

    def wait_for(
        self,
        publishers: Mapping[str, int] | None = None,
        subscribers: Mapping[str, int] | None = None,
        timeout_s: float = 15.0,
        unless: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Wait until topics have the given minimum numbers of publishers and subscribers.

        Return True if these numbers are reached, False on timeout or if ``unless`` ends the wait.

        Args:
            publishers: topic → minimum number of publishers.
            subscribers: topic → minimum number of subscribers.
            timeout_s: maximum steady time to wait.
            unless: function that ends the wait if it returns True, e.g. if the observed process has ended.
        """
        deadline_s = time.monotonic() + timeout_s
        while not unless() and time.monotonic() < deadline_s:
            found = all(self.node.count_publishers(topic) >= n for topic, n in (publishers or {}).items())
            if found and all(
                self.node.count_subscribers(topic) >= n for topic, n in (subscribers or {}).items()
            ):
                return True
            self.executor.spin_once(timeout_sec=_POLL_S)
        return False

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = 15.0) -> bool:
        """Process the node's callbacks until a condition holds; return False on timeout."""
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= deadline_s:
                return False
            self.executor.spin_once(timeout_sec=_POLL_S)
        return True

    def __enter__(self) -> "GraphObserver":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.executor.shutdown()
        # Destroying the node removes its DDS participant: two participants of one process can deadlock while a third
        # participant disappears.
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

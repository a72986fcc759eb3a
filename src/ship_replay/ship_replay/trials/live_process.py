"""Executables run as processes of their own: log in a file, an end that is waited for, a DDS domain of their own."""

import os
import signal
import socket
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

# DDS-RTPS: a domain's first participant listens at 7410 + 250 * domain for discovery. Beyond domain 101 the ports run
# into those that Linux gives to anybody.
_FIRST_PORT = 7410
_PORTS_PER_DOMAIN = 250
_LAST_DOMAIN = 101
_END_S = 15.0


def free_domain_id() -> int:
    """A ROS domain in which nobody on this machine takes part at the moment.

    Raises:
        OSError: all are taken.
    """
    # Two runs at the same time begin their search at different domains.
    for step in range(_LAST_DOMAIN):
        domain = 1 + (os.getpid() + step) % _LAST_DOMAIN
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", _FIRST_PORT + _PORTS_PER_DOMAIN * domain))
                return domain
            except OSError:
                continue
    raise OSError("no ROS domain is free on this machine: end other ROS programs")


def live_environment(domain_id: int, log_folder: Path) -> dict[str, str]:
    """This process's environment, with a ROS domain that stays on this machine and a folder for ROS's own logs."""
    own = {
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(log_folder),
        "PYTHONUNBUFFERED": "1",
    }
    return {name: value for name, value in os.environ.items() if name != "ROS_STATIC_PEERS"} | own


class LiveProcess:
    """One running executable; at the end of its ``with`` statement it is gone, by force if it must be.

    Args:
        command: program and arguments.
        log_path: file that takes its stdout and stderr.
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
        """Exit code; None while it runs, negative after a signal."""
        return self._process.poll()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def log(self) -> str:
        """What it has said so far."""
        return self.log_path.read_text(encoding="utf-8", errors="replace")

    def wait(self, timeout_s: float) -> int:
        """Exit code, once it has ended by itself.

        Raises:
            subprocess.TimeoutExpired: it still runs after `timeout_s`.
        """
        return self._process.wait(timeout_s)

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Send a signal and wait for the end; returns the exit code.

        Raises:
            subprocess.TimeoutExpired: it did not end.
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

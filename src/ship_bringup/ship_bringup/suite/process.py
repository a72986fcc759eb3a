"""One process of a suite: start in a separate session, reading of its lines, heartbeats, UDP ports, end.

Heartbeats: only time in which a process could have worked counts. Time does not count while the supervisor itself stood
still, as on a suspended computer, nor while the process waited for a processor on an overloaded computer.

Ports: those of a killed program are reserved, so that DDS connects its successor at once. A killed program does not
announce its end. For 20 s, the default lease of DDS, peers continue to send to the program's ports. A successor on
these ports receives the messages meant for the killed program, and is discovered later. Shared memory has the same
defect, but no ports that could be reserved (see :data:`UDP_ONLY`).

On other ports the successor is discovered as soon as each peer announces itself: every 0.5 s with the suite's profile
(:data:`ship_bags.live.ros_process.DDS_PROFILE`), every 3 s by default. The successor must wait for these announcements.
The peers answer the successor's own first announcement within 0.1 ms, before the successor listens, and do not answer
repetitions (observed with Fast DDS 2.14).
"""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from ship_bags.live.ros_process import HEARTBEAT_SOCKET

UDP_ONLY = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
"""Environment of a program that must be connected quickly after a kill, unless the user sets this variable."""

_LEASE_S = 20.0
_MARGIN_S = 5.0
_FIRST_EPHEMERAL = 32768

LONGEST_STEP_S = 1.0
"""Maximum time between two checks that counts, s; a longer time is a standstill of the supervisor itself."""

_LONGEST_LINE = 65536
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


class ReservedPorts:
    """UDP ports that no other process can take, each for the default lease of DDS plus 5 s."""

    def __init__(self) -> None:
        self._reserved: list[tuple[float, list[socket.socket]]] = []

    def reserve(self, ports: frozenset[int]) -> None:
        """Reserve the free ports among some ports, and release reserved ports whose time is over.

        A failure (for example no file descriptors left) is ignored: the successor is then discovered later.
        """
        now_s = time.monotonic()
        for until_s, sockets in self._reserved:
            if until_s <= now_s:
                _close(sockets)
        self._reserved = [(until_s, sockets) for until_s, sockets in self._reserved if until_s > now_s]
        taken = []
        for port in sorted(ports):
            with contextlib.suppress(OSError):
                own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                taken.append(own)
                own.bind(("", port))
        self._reserved.append((now_s + _LEASE_S + _MARGIN_S, taken))

    def close(self) -> None:
        """Release all ports."""
        for _, sockets in self._reserved:
            _close(sockets)
        self._reserved = []


def udp_ports_of(pid: int) -> frozenset[int]:
    """Return the UDP ports that a process has bound, without ephemeral ports; empty if the process has ended."""
    inodes = set()
    with contextlib.suppress(OSError):
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                inodes.add(os.readlink(link).removeprefix("socket:[").removesuffix("]"))
        rows = Path(f"/proc/{pid}/net/udp").read_text(encoding="ascii").splitlines()[1:]
        columns = [row.split() for row in rows]
        ports = {int(column[1].rpartition(":")[2], 16) for column in columns if column[9] in inodes}
        return frozenset(port for port in ports if port < _FIRST_EPHEMERAL)
    return frozenset()


def _close(sockets: list[socket.socket]) -> None:
    for each in sockets:
        each.close()


class HeartbeatAge:
    """Time since the last heartbeat of a process.

    Attributes:
        time_s: time since the last heartbeat, s.
        has_heartbeat: True if the process has sent a heartbeat since its start.
        is_reported: True if the time was reported as too long.
        is_killed: True if the process was killed because the time was too long.

    Args:
        pid: id of the process.
    """

    def __init__(self, pid: int) -> None:
        self._schedstat = Path(f"/proc/{pid}/schedstat")
        self._waited_s = self._processor_wait_s()
        self.has_heartbeat = self.is_reported = self.is_killed = False
        self.time_s = 0.0

    def reset(self) -> None:
        """Reset the time to 0, at a heartbeat."""
        self.time_s, self.has_heartbeat, self.is_reported = 0.0, True, False

    def add(self, step_s: float) -> None:
        """Add the time since the last check, at most 1 s, without the process's wait for a processor."""
        before_s, waited_s, waiting_s = self._waited_s, self._processor_wait_s(), 0.0
        if waited_s is not None:
            self._waited_s = waited_s
            waiting_s = 0.0 if before_s is None else max(0.0, waited_s - before_s)
        self.time_s += max(0.0, min(step_s, LONGEST_STEP_S) - waiting_s)

    def _processor_wait_s(self) -> float | None:
        """Return the time for which the main thread was ready but had no processor, s; None if it cannot be read."""
        with contextlib.suppress(OSError, IndexError, ValueError):
            return int(self._schedstat.read_text(encoding="ascii").split()[1]) * 1e-9
        return None


class Process:
    """A running process.

    Attributes:
        pid: id of the process.
        pidfd: file descriptor that becomes readable when the process has ended.
        start_s: steady time of the start.
        is_output_complete: True if the end of the output has been read.
        heartbeat_age: time since the last heartbeat.

    Args:
        command: program and arguments.
        heartbeats: file descriptor of the socket for its heartbeats.

    Raises:
        OSError: the process cannot be started; nothing remains of the attempt.
    """

    def __init__(self, command: Sequence[str], heartbeats: int) -> None:
        parent = os.getpid()

        def end_with_parent() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        own = {"PYTHONUNBUFFERED": "1", HEARTBEAT_SOCKET: str(heartbeats)}
        # A separate session: Ctrl-C on the terminal reaches only the supervisor, which ends all processes in order.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=UDP_ONLY | os.environ | own,
            start_new_session=True,
            pass_fds=(heartbeats,),
            preexec_fn=end_with_parent,  # noqa: PLW1509 - this process has no threads
        )
        self.pid = self._process.pid
        try:
            self.pidfd = os.pidfd_open(self.pid)
        except OSError:
            self.kill()
            self._process.wait()
            self.output.close()
            raise
        self.start_s = time.monotonic()
        self.is_output_complete = False
        self.heartbeat_age = HeartbeatAge(self.pid)
        self._rest = b""
        os.set_blocking(self.output.fileno(), False)

    @property
    def output(self) -> IO[bytes]:
        """Return the pipe with stdout and stderr of the process."""
        assert self._process.stdout is not None
        return self._process.stdout

    def read_lines(self) -> tuple[list[str], bool]:
        """Return the lines completed by the next 64 KiB of output at most, and True if there may be more to read.

        An incomplete line is returned if it is longer than 64 KiB, or at the end of the output.
        """
        try:
            data = os.read(self.output.fileno(), _LONGEST_LINE)
        except BlockingIOError:
            return [], False
        self.is_output_complete = not data
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LONGEST_LINE or (self._rest and not data):
            whole, self._rest = [*whole, self._rest], b""
        return [line.decode("utf-8", errors="replace").rstrip("\r") for line in whole], bool(data)

    def request_end(self) -> None:
        """Request the process to end in order (SIGINT)."""
        self._process.send_signal(signal.SIGINT)

    def kill(self) -> None:
        """Kill the process and all processes that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)

    def close(self) -> int:
        """Return the exit code of an ended or killed process, and release its resources."""
        code = self._process.wait()
        os.close(self.pidfd)
        self.output.close()
        return code

"""Heartbeats of the suite's processes: their receipt, and the time since the last heartbeat of each process.

Only time in which a process could have worked counts. Time does not count while the supervisor itself stood still, as
on a suspended computer, nor while the process waited for a processor on an overloaded computer.
"""

import contextlib
import socket
from pathlib import Path

LONGEST_STEP_S = 1.0
"""Maximum time between two checks that counts, s; a longer time is a standstill of the supervisor itself."""

_LONGEST_MESSAGE = 32


class HeartbeatSocket:
    """Socket that receives heartbeats."""

    def __init__(self) -> None:
        self.receiver, self._sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.receiver.setblocking(False)

    @property
    def sender_descriptor(self) -> int:
        """Return the file descriptor that the programs inherit."""
        return self._sender.fileno()

    def receive(self) -> set[int]:
        """Return the ids of the processes that have sent a heartbeat since the last call."""
        pids = set()
        with contextlib.suppress(OSError):
            while True:
                with contextlib.suppress(ValueError):
                    pids.add(int(self.receiver.recv(_LONGEST_MESSAGE)))
        return pids

    def close(self) -> None:
        """Close both ends of the socket."""
        self.receiver.close()
        self._sender.close()


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

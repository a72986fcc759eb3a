"""One process of a suite: start in a separate session, reading of its lines, end."""

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from typing import IO

from ship_bags.live.heartbeat import HEARTBEAT_SOCKET
from ship_bringup.suite.dds_ports import UDP_ONLY
from ship_bringup.suite.heartbeats import HeartbeatAge

_LONGEST_LINE = 65536
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


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

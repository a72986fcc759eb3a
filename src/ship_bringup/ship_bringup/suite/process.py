"""One process of a suite: start in a separate session, reading of its lines, begin of its work, end.

A process can be started before it is needed, as a reserve. A reserve process loads its libraries, which takes one
second or, on a busy machine, several seconds, and then waits for a line on stdin (:mod:`ship_node.live.start`).
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from ship_bags.live.heartbeat import HEARTBEAT_SOCKET
from ship_bringup.suite.dds_ports import UDP_ONLY
from ship_bringup.suite.heartbeats import HeartbeatAge
from ship_node.live.start import WAIT_VARIABLE

_LONGEST_LINE = 65536
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


class Process:
    """A running process.

    Attributes:
        pid: id of the process.
        pidfd: file descriptor that becomes readable when the process has ended.
        start_s: steady time of the start, or of :meth:`begin` for a waiting process.
        is_output_complete: True if the end of the output has been read.
        heartbeat_age: time since the last heartbeat.

    Args:
        command: program and arguments.
        heartbeats: file descriptor of the socket for its heartbeats.
        waits: True if the process loads its libraries and then waits for :meth:`begin`.

    Raises:
        OSError: the process cannot be started; nothing remains of the attempt.
    """

    def __init__(self, command: Sequence[str], heartbeats: int, waits: bool = False) -> None:
        parent = os.getpid()

        def end_with_parent() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        own = {"PYTHONUNBUFFERED": "1", HEARTBEAT_SOCKET: str(heartbeats)} | ({WAIT_VARIABLE: "1"} if waits else {})
        # A separate session: Ctrl-C on the terminal reaches only the supervisor, which ends all processes in order.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE if waits else subprocess.DEVNULL,
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
            self._close_pipes()
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

    @property
    def is_stopped(self) -> bool:
        """True if the process is stopped by a signal."""
        with contextlib.suppress(OSError, IndexError):
            # The name, in brackets before the state, may contain any character.
            state = Path(f"/proc/{self.pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
            return state in ("T", "t")
        return False

    def begin(self) -> None:
        """Start the work of a waiting process; no effect if the process has ended."""
        self.start_s = time.monotonic()
        self.heartbeat_age.reset(has_heartbeat=False)
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(b"\n")
                self._process.stdin.flush()

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
        self._close_pipes()
        return code

    def _close_pipes(self) -> None:
        self.output.close()
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()

"""The programs of a suite as processes of their own: started, their lines shown, started again, ended in order.

One thread waits for all of them: for lines, for their ends (by process descriptors), for signals and for the time of
the next start. The programs are told by the kernel to end when this process ends, however that happens.
"""

import contextlib
import ctypes
import os
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import FrameType
from typing import IO

from ship_bags.command_line import EXIT_DONE
from ship_bringup.suite.dds_ports import QUICK_TO_CONNECT, HeldPorts, ports_of
from ship_bringup.suite.restarts import Restarts, end_words, failure_of

_END_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_END_S = 10.0
"""A program that was asked to end has this long; then it is killed."""
_LONGEST_LINE = 65536
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)
_SUITE = "suite"


class Role(Enum):
    """What the end of a program means for the others."""

    NODE = "node"
    """The suite ends with the last of these."""
    WATCHER = "watcher"
    """It looks at the nodes; they do not need it."""
    PLAYER = "player"
    """It feeds the nodes, once: the suite ends with it, and it is not started again."""


@dataclass(frozen=True)
class Program:
    """One program of the suite: its name before its lines, its command line, and what its end means."""

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE


@dataclass
class _Kept:
    """A program with its process, if it runs, and the time of its next start, if it waits for one."""

    program: Program
    restarts: Restarts
    process: "subprocess.Popen[bytes] | None" = None
    pidfd: int = -1
    started_s: float = 0.0
    due_s: float | None = None
    rest: bytes = field(default=b"")
    ports: frozenset[int] = frozenset()

    @property
    def is_alive(self) -> bool:
        """Whether it runs or is to run again."""
        return self.process is not None or self.due_s is not None


class Keeper:
    """Runs programs until they have ended, or until a signal asks for the end.

    Args:
        programs: in the order of their start; they are ended in the opposite order.
        most_restarts: of one program in a row.
        write: takes each line, without its end.
    """

    def __init__(
        self, programs: Sequence[Program], most_restarts: int, write: Callable[[str], None] = print
    ) -> None:
        self._kept = [_Kept(program, Restarts(most_restarts)) for program in programs]
        self._write = write
        self._selector = selectors.DefaultSelector()
        self._ending = False
        self._kill_due_s: float | None = None
        self._failure = EXIT_DONE
        self._held_ports = HeldPorts()

    def run(self) -> int:
        """Start the programs and keep them; returns the exit code of the first that failed for good, or 0."""
        with self._signals():
            try:
                for kept in self._kept:
                    self._start(kept)
                while any(kept.is_alive for kept in self._kept):
                    self._wait()
                    self._start_due()
                    self._end_step_by_step()
            finally:
                self._kill_all()
                self._held_ports.close()
        return self._failure

    def _start(self, kept: _Kept) -> None:
        kept.due_s, kept.started_s, kept.rest = None, time.monotonic(), b""
        kept.ports = frozenset()
        parent = os.getpid()

        def end_with_parent() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        # In a session of its own: Ctrl-C on the terminal comes to this process alone, which ends the others in order.
        kept.process = subprocess.Popen(
            kept.program.command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=QUICK_TO_CONNECT | os.environ | {"PYTHONUNBUFFERED": "1"},
            start_new_session=True,
            preexec_fn=end_with_parent,  # noqa: PLW1509 - there are no threads here
        )
        os.set_blocking(self._pipe(kept).fileno(), False)
        kept.pidfd = os.pidfd_open(kept.process.pid)
        self._selector.register(self._pipe(kept), selectors.EVENT_READ, lambda: self._read(kept))
        self._selector.register(kept.pidfd, selectors.EVENT_READ, lambda: self._ended(kept))

    def _wait(self) -> None:
        """Wait for the next event or time, and handle it."""
        due = [kept.due_s for kept in self._kept if kept.due_s is not None]
        due += [] if self._kill_due_s is None else [self._kill_due_s]
        timeout_s = max(0.0, min(due) - time.monotonic()) if due else None
        for key, _ in self._selector.select(timeout_s):
            # One event of this round may have taken away the ground of the next.
            if key.fd in self._selector.get_map():
                key.data()

    def _read(self, kept: _Kept) -> bool:
        """Show the whole lines of what a program has written; returns whether there may be more to read."""
        pipe = self._pipe(kept)
        try:
            data = os.read(pipe.fileno(), _LONGEST_LINE)
        except BlockingIOError:
            return False
        *lines, kept.rest = (kept.rest + data).split(b"\n")
        if len(kept.rest) > _LONGEST_LINE or (kept.rest and not data):
            lines, kept.rest = [*lines, kept.rest], b""
        for line in lines:
            self._say(kept.program.name, line.decode("utf-8", errors="replace").rstrip("\r"))
        if not kept.ports and kept.process is not None:
            # Who has something to say has a node, which will have these ports until it ends.
            kept.ports = ports_of(kept.process.pid)
        if not data:
            self._selector.unregister(pipe)
        return bool(data)

    def _ended(self, kept: _Kept) -> None:
        """Take note of the end of a program: it is started again, or it is not."""
        assert kept.process is not None
        self._selector.unregister(kept.pidfd)
        os.close(kept.pidfd)
        code, pipe = kept.process.wait(), self._pipe(kept)
        while pipe in self._selector.get_map() and self._read(kept):
            pass
        if pipe in self._selector.get_map():
            # Something that the program has started holds the pipe still.
            self._selector.unregister(pipe)
        pipe.close()
        kept.process = None
        if self._ending:
            self._kill_due_s = None
        else:
            self._judge(kept, code, time.monotonic() - kept.started_s)

    def _judge(self, kept: _Kept, code: int, ran_s: float) -> None:
        name, role = kept.program.name, kept.program.role
        delay_s = None if role is Role.PLAYER else kept.restarts.delay_s(code, ran_s)
        how = f"{name} ended after {ran_s:.1f} s: {end_words(code)}"
        if delay_s is not None:
            when = "at once" if delay_s == 0.0 else f"in {delay_s:.0f} s"
            self._say(_SUITE, f"{how}; started again {when} ({kept.restarts.in_a_row} of {kept.restarts.most})")
            kept.due_s = time.monotonic() + delay_s
            self._held_ports.hold(kept.ports)
            return
        failure = failure_of(code)
        self._failure = self._failure or failure
        self._say(_SUITE, f"{how}; not started again" if failure else how)
        nodes_left = any(each.is_alive for each in self._kept if each.program.role is Role.NODE)
        if role is Role.PLAYER or not nodes_left:
            self._end()

    def _start_due(self) -> None:
        now_s = time.monotonic()
        for kept in self._kept:
            if kept.due_s is not None and kept.due_s <= now_s:
                self._start(kept)

    def _end(self) -> None:
        """Begin to end everything; what waited to be started is not."""
        self._ending, self._kill_due_s = True, None
        for kept in self._kept:
            kept.due_s = None

    def _end_step_by_step(self) -> None:
        """While the suite ends: ask the last program that runs to end; kill it where it does not."""
        running = [kept for kept in self._kept if kept.process is not None]
        if not self._ending or not running:
            return
        process = running[-1].process
        assert process is not None
        if self._kill_due_s is None:
            self._kill_due_s = time.monotonic() + _END_S
            process.send_signal(signal.SIGINT)
        elif time.monotonic() >= self._kill_due_s:
            self._say(_SUITE, f"{running[-1].program.name} does not end: killed")
            self._kill_due_s = time.monotonic() + _END_S
            _kill(process)

    def _kill_all(self) -> None:
        for kept in self._kept:
            if kept.process is not None:
                _kill(kept.process)
                kept.process.wait()

    def _say(self, name: str, line: str) -> None:
        try:
            self._write(f"[{name}] {line}")
        except OSError:
            # Nobody reads any more: the terminal, or the program behind a pipe, is gone.
            if not self._ending:
                self._end()

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """While it lasts, the first signal that asks for the end ends all in order, and the second at once."""
        waker, woken = socket.socketpair()
        for end in (waker, woken):
            end.setblocking(False)

        def asked(_number: int, _frame: FrameType | None) -> None:
            if self._ending:
                self._kill_all_now()
            else:
                self._end()

        before = {number: signal.signal(number, asked) for number in _END_SIGNALS}
        former = signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False)
        self._selector.register(woken, selectors.EVENT_READ, lambda: woken.recv(64))
        try:
            yield
        finally:
            signal.set_wakeup_fd(former)
            for number, handler in before.items():
                signal.signal(number, handler)
            self._selector.close()
            waker.close()
            woken.close()

    def _kill_all_now(self) -> None:
        for kept in self._kept:
            if kept.process is not None:
                _kill(kept.process)

    @staticmethod
    def _pipe(kept: _Kept) -> IO[bytes]:
        assert kept.process is not None
        assert kept.process.stdout is not None
        return kept.process.stdout


def say_line(line: str) -> None:
    """Write a line to stdout at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill a program and all that it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)

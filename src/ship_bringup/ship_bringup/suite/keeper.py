"""The programs of a suite as processes of their own: started, their lines shown, started again, ended in order.

One thread waits for all of them: for lines, for their ends (by process descriptors), for signals and for the time of
the next start. The programs are told by the kernel to end when this process ends, however that happens.
"""

import contextlib
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from types import FrameType

from ship_bags.command_line import EXIT_DONE
from ship_bringup.suite.dds_ports import HeldPorts, ports_of
from ship_bringup.suite.process import Process
from ship_bringup.suite.restarts import Restarts, end_words, failure_of

_END_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_END_S = 10.0
"""A program that was asked to end has this long; then it is killed."""
_RESERVE_AFTER_S = 5.0
"""A process in reserve is started so long after the program began, when the start of the others is over."""
_SUITE = "suite"


class Role(Enum):
    """What the end of a program means for the others."""

    NODE = "node"
    """The suite ends with the last of these."""
    WATCHER = "watcher"
    """It looks at the nodes; they do not need it."""
    FEEDER = "feeder"
    """It gives the nodes what instruments say; they live without it, if not for long."""
    PLAYER = "player"
    """It feeds the nodes, once: the suite ends with it, and it is not started again."""


_END_ORDER = (Role.WATCHER, Role.PLAYER, Role.FEEDER, Role.NODE)


@dataclass(frozen=True)
class Program:
    """One program of the suite.

    Attributes:
        name: stands before its lines.
        command: its command line.
        role: what its end means.
        has_reserve: whether a second process of it waits, with its libraries read, to be its successor.
    """

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE
    has_reserve: bool = False


@dataclass
class _Kept:
    """A program with its process, if it runs, the one in reserve, and the times at which they are to be started."""

    program: Program
    restarts: Restarts
    process: Process | None = None
    due_s: float | None = None
    reserve: Process | None = None
    reserve_due_s: float | None = None
    ports: frozenset[int] = frozenset()

    @property
    def is_alive(self) -> bool:
        """Whether it runs or is to run again."""
        return self.process is not None or self.due_s is not None

    @property
    def processes(self) -> list[Process]:
        """Those that there are."""
        return [process for process in (self.process, self.reserve) if process is not None]


class Keeper:
    """Runs programs until they have ended, or until a signal asks for the end.

    Args:
        programs: in the order of their start. They are ended in the opposite one, but first who watches, for whom the
            end of the others would be a fault, then who plays a bag or reads instruments, then the nodes.
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
        """Start a program, or let the process that waits in reserve begin."""
        kept.due_s, kept.ports = None, frozenset()
        kept.process, kept.reserve = kept.reserve, None
        if kept.process is None:
            kept.process = self._started(kept, waits=False)
        else:
            kept.process.begin()
        if kept.program.has_reserve:
            kept.reserve_due_s = kept.process.began_s + _RESERVE_AFTER_S

    def _started(self, kept: _Kept, waits: bool) -> Process:
        process = Process(kept.program.command, waits)
        self._selector.register(process.output, selectors.EVENT_READ, lambda: self._read(kept, process))
        self._selector.register(process.pidfd, selectors.EVENT_READ, lambda: self._ended(kept, process))
        return process

    def _wait(self) -> None:
        """Wait for the next event or time, and handle it."""
        due = [s for kept in self._kept for s in (kept.due_s, kept.reserve_due_s) if s is not None]
        due += [] if self._kill_due_s is None else [self._kill_due_s]
        timeout_s = max(0.0, min(due) - time.monotonic()) if due else None
        for key, _ in self._selector.select(timeout_s):
            # One event of this round may have taken away the ground of the next.
            if key.fd in self._selector.get_map():
                key.data()

    def _read(self, kept: _Kept, process: Process) -> bool:
        """Show the whole lines of what a program has written; returns whether there may be more to read."""
        lines, may_be_more = process.lines()
        for line in lines:
            self._say(kept.program.name, line)
        if lines and not kept.ports and process is kept.process:
            # Who has something to say has a node, which will have these ports until it ends.
            kept.ports = ports_of(process.pid)
        if process.has_said_all:
            self._selector.unregister(process.output)
        return may_be_more

    def _ended(self, kept: _Kept, process: Process) -> None:
        """Take note of the end of a process: its program is started again, or it is not."""
        while not process.has_said_all and self._read(kept, process):
            pass
        self._forget(process)
        code, ran_s = process.close(), time.monotonic() - process.began_s
        if process is kept.reserve:
            kept.reserve = None
            self._say(_SUITE, f"{kept.program.name} in reserve ended: {end_words(code)}")
            return
        kept.process = None
        if self._ending:
            self._kill_due_s = None
        else:
            self._judge(kept, code, ran_s)

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
        self._drop_reserve(kept)
        failure = failure_of(code)
        self._failure = self._failure or failure
        if failure:
            without = "; the suite goes on without it" if role in (Role.WATCHER, Role.FEEDER) else ""
            how += f"; not started again{without}"
        self._say(_SUITE, f"{how}; the suite ends with it" if role is Role.PLAYER else how)
        nodes_left = any(each.is_alive for each in self._kept if each.program.role is Role.NODE)
        if role is Role.PLAYER or not nodes_left:
            self._end()

    def _start_due(self) -> None:
        now_s = time.monotonic()
        for kept in self._kept:
            if kept.due_s is not None and kept.due_s <= now_s:
                self._start(kept)
            if kept.reserve_due_s is not None and kept.reserve_due_s <= now_s:
                kept.reserve_due_s = None
                kept.reserve = self._started(kept, waits=True)

    def _forget(self, process: Process) -> None:
        """Wait for a process no more; something that it has started may hold its output still."""
        self._selector.unregister(process.pidfd)
        if not process.has_said_all:
            self._selector.unregister(process.output)

    def _drop_reserve(self, kept: _Kept) -> None:
        """End the process in reserve, which holds nothing; none is started any more."""
        kept.reserve_due_s = None
        if kept.reserve is not None:
            self._forget(kept.reserve)
            kept.reserve.kill()
            kept.reserve.close()
            kept.reserve = None

    def _end(self) -> None:
        """Begin to end everything; what waited to be started is not."""
        self._ending, self._kill_due_s = True, None
        for kept in self._kept:
            kept.due_s = None
            self._drop_reserve(kept)

    def _end_step_by_step(self) -> None:
        """While the suite ends: ask the next program that runs to end; kill it where it does not."""
        running = [kept for kept in self._kept if kept.process is not None]
        if not self._ending or not running:
            return
        ending = min(reversed(running), key=lambda kept: _END_ORDER.index(kept.program.role))
        process = ending.process
        assert process is not None
        if self._kill_due_s is None:
            self._kill_due_s = time.monotonic() + _END_S
            process.ask_to_end()
        elif time.monotonic() >= self._kill_due_s:
            self._say(_SUITE, f"{ending.program.name} does not end: killed")
            self._kill_due_s = time.monotonic() + _END_S
            process.kill()

    def _kill_all(self) -> None:
        for process in [process for kept in self._kept for process in kept.processes]:
            process.kill()
            process.close()

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
        for process in [process for kept in self._kept for process in kept.processes]:
            process.kill()


def say_line(line: str) -> None:
    """Write a line to stdout at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()

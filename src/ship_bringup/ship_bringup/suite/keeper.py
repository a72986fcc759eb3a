"""Supervise the programs of a suite as processes of their own: start, show their lines, restart, end in order.

One thread waits for all of them: for lines, for their ends (by process descriptors), for their heartbeats, for signals
and for the time of the next start. The kernel ends the programs when this process ends, for any reason. Only a signal
or the end of a bag ends this process.
"""

import contextlib
import selectors
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import FrameType

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_DONE
from ship_bringup.suite.dds_ports import ReservedPorts, ports_of
from ship_bringup.suite.frozen_check import FROZEN_REPORT_S, FROZEN_RESTART_S, FrozenCheck
from ship_bringup.suite.kept_program import KeptProgram
from ship_bringup.suite.process import Process
from ship_bringup.suite.program import Program, Role
from ship_bringup.suite.restarts import LONGEST_DELAY_S, end_words, failure_of
from ship_estimation.refusals import failure

_END_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_END_S = 10.0
"""Timeout after a request to end; then the program is killed, s."""
_RESERVE_AFTER_S = 5.0
"""Delay of the reserve process after the start of its program, when the others have started, s."""
_SUITE = "suite"

_END_ORDER = (Role.WATCHER, Role.PLAYER, Role.FEEDER, Role.NODE)


class Keeper:
    """Runs programs until a signal, or until the end of a bag.

    Args:
        programs: in the order of their start. They are ended in the opposite order, but first those that monitor, for
            which the end of the others would be a fault, then those that play a bag or read instruments, then nodes.
        write: takes each line, without its end, and does not raise.
        frozen_report_s: time without a heartbeat after which a program is reported, s.
        frozen_restart_s: time without a heartbeat after which it is killed and started again, s.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        write: Callable[[str], None] = print,
        frozen_report_s: float = FROZEN_REPORT_S,
        frozen_restart_s: float = FROZEN_RESTART_S,
    ) -> None:
        self._kept = [KeptProgram(program, due_s=0.0) for program in programs]
        self._write = write
        self._selector = selectors.DefaultSelector()
        self._end_requested = self._ending = False
        self._kill_due_s: float | None = None
        self._failure = EXIT_DONE
        self._reserved_ports = ReservedPorts()
        self._frozen_check = FrozenCheck(frozen_report_s, frozen_restart_s, partial(self._log, _SUITE))

    def run(self) -> int:
        """Run the programs; return the exit code of the player or of the first program that was down at the end, or 0.

        If no node has run yet and all of them end with bad input, the suite ends.
        """
        heartbeats = self._frozen_check.heartbeats
        self._selector.register(
            heartbeats.receiver, selectors.EVENT_READ, lambda: self._frozen_check.receive(self._kept)
        )
        with self._signals():
            try:
                while any(kept.is_alive for kept in self._kept):
                    self._guarded_work()
            finally:
                self._kill_all()
                self._reserved_ports.close()
                heartbeats.close()
        return self._failure

    def _guarded_work(self) -> None:
        """Work and catch all exceptions: the end of this process would end all nodes."""
        try:
            self._work()
        except Exception as error:
            self._log(_SUITE, f"exception in the supervisor of the suite, which continues: {failure(error).text}")
            time.sleep(1.0)

    def _work(self) -> None:
        """Do what is due, and wait for the next event or time."""
        if self._end_requested and not self._ending:
            self._end()
        if self._ending:
            self._end_step_by_step()
        else:
            self._start_due()
            self._frozen_check.look(self._kept)
        self._wait()

    def _start(self, kept: KeptProgram) -> None:
        """Start a program, or its reserve process if there is one."""
        if kept.reserve is not None and kept.reserve.is_stopped:
            kept.reserve.kill()
            kept.reserve = None
        kept.due_s, kept.ports = None, frozenset()
        kept.process, kept.reserve = kept.reserve, None
        if kept.process is not None:
            kept.process.begin()
        else:
            try:
                kept.process = self._started(kept, waits=False)
            except Exception as problem:
                delay_s = max(1.0, kept.restarts.delay_s(ran_s=0.0))
                kept.due_s = time.monotonic() + delay_s
                text = f"{kept.program.name} cannot be started: {_reason(problem)}"
                self._log(_SUITE, f"{text}; tried again in {delay_s:.0f} s")
                return
        if kept.program.has_reserve:
            kept.reserve_due_s = kept.process.began_s + _RESERVE_AFTER_S

    def _started(self, kept: KeptProgram, waits: bool) -> Process:
        """Return a new process, whose events are waited for.

        Raises:
            OSError: it cannot be started, usually for lack of memory or file descriptors.
        """
        process = Process(kept.program.command, self._frozen_check.heartbeats.sender_descriptor, waits)
        try:
            self._selector.register(process.output, selectors.EVENT_READ, lambda: self._read(kept, process))
            self._selector.register(process.pidfd, selectors.EVENT_READ, lambda: self._ended(kept, process))
        except OSError:
            self._forget(process)
            process.kill()
            process.close()
            raise
        return process

    def _wait(self) -> None:
        """Wait for the next event or time, and handle it."""
        due = [s for kept in self._kept for s in (kept.due_s, kept.reserve_due_s) if s is not None]
        due += [] if self._kill_due_s is None else [self._kill_due_s]
        due += [] if self._ending else [self._frozen_check.due_s]
        timeout_s = max(0.0, min(due) - time.monotonic()) if due else None
        for key, _ in self._selector.select(timeout_s):
            # Handling one event may unregister the next one.
            if key.fd in self._selector.get_map():
                key.data()

    def _read(self, kept: KeptProgram, process: Process) -> bool:
        """Show the complete lines that a program has written; return True if there may be more to read."""
        lines, may_be_more = process.lines()
        for line in lines:
            self._log(kept.program.name, line)
        if lines and not kept.ports and process is kept.process:
            # A program that prints has created its node, which keeps these ports until it ends.
            kept.ports = ports_of(process.pid)
        if process.is_output_complete:
            self._selector.unregister(process.output)
        return may_be_more

    def _ended(self, kept: KeptProgram, process: Process) -> None:
        """Handle the end of a process: its program is started again unless the suite ends."""
        while not process.is_output_complete and self._read(kept, process):
            pass
        self._forget(process)
        code, ran_s = process.close(), time.monotonic() - process.began_s
        if process is kept.reserve:
            kept.reserve, kept.reserve_due_s = None, time.monotonic() + LONGEST_DELAY_S
            self._log(_SUITE, f"{kept.program.name} in reserve ended: {end_words(code)}")
        elif process is kept.process:
            kept.process = None
            if self._ending:
                self._kill_due_s = None
            else:
                self._handle_unrequested_end(kept, code, ran_s)

    def _handle_unrequested_end(self, kept: KeptProgram, code: int, ran_s: float) -> None:
        """Handle an end that the suite did not request."""
        how = f"{kept.program.name} ended after {ran_s:.1f} s: {end_words(code)}"
        if kept.program.role is Role.PLAYER:
            self._failure = failure_of(code)
            how += "; not started again" if self._failure else ""
            self._log(_SUITE, f"{how}; the suite ends with it")
            self._end()
            return
        kept.failure = failure_of(code)
        nodes = [each for each in self._kept if each.program.role is Role.NODE]
        if nodes and all(node.failure == EXIT_BAD_INPUT and not node.has_run for node in nodes):
            self._log(_SUITE, f"{how}; bad input at the start: the suite ends")
            self._end()
            return
        delay_s = kept.restarts.delay_s(ran_s)
        when = "at once" if delay_s == 0.0 else f"in {delay_s:.0f} s"
        self._log(_SUITE, f"{how}; started again {when} (restart {kept.restarts.in_a_row} in a row)")
        kept.due_s = time.monotonic() + delay_s
        self._reserved_ports.hold(kept.ports)

    def _start_due(self) -> None:
        now_s = time.monotonic()
        for kept in self._kept:
            if kept.due_s is not None and kept.due_s <= now_s:
                self._start(kept)
            if kept.reserve_due_s is not None and kept.reserve_due_s <= now_s:
                try:
                    kept.reserve_due_s = None
                    kept.reserve = self._started(kept, waits=True)
                except Exception as problem:
                    kept.reserve_due_s = now_s + LONGEST_DELAY_S
                    self._log(_SUITE, f"{kept.program.name} in reserve cannot be started: {_reason(problem)}")

    def _forget(self, process: Process) -> None:
        """Stop waiting for a process; a program that it started may keep its output open."""
        for descriptor in (process.pidfd, process.output.fileno()):
            if descriptor in self._selector.get_map():
                self._selector.unregister(descriptor)

    def _drop_reserve(self, kept: KeptProgram) -> None:
        """End the reserve process; no further one is started."""
        kept.reserve_due_s = None
        if kept.reserve is not None:
            self._forget(kept.reserve)
            kept.reserve.kill()
            kept.reserve.close()
            kept.reserve = None

    def _end(self) -> None:
        """Start to end all programs; pending starts are cancelled."""
        self._ending, self._kill_due_s = True, None
        for kept in self._kept:
            if kept.process is None or not kept.has_run:
                self._failure = self._failure or kept.failure
            kept.due_s = None
            self._drop_reserve(kept)

    def _end_step_by_step(self) -> None:
        """While the suite ends: request the next running program to end; kill it after a timeout."""
        running = [kept for kept in self._kept if kept.process is not None]
        if not running:
            return
        ending = min(reversed(running), key=lambda kept: _END_ORDER.index(kept.program.role))
        process = ending.process
        assert process is not None
        if self._kill_due_s is None:
            self._kill_due_s = time.monotonic() + _END_S
            process.request_end()
        elif time.monotonic() >= self._kill_due_s:
            self._log(_SUITE, f"{ending.program.name} does not end: killed")
            self._kill_due_s = time.monotonic() + _END_S
            process.kill()

    def _kill_all(self) -> None:
        for process in [process for kept in self._kept for process in kept.processes]:
            process.kill()
            process.close()

    def _log(self, name: str, line: str) -> None:
        self._write(f"[{name}] {line}")

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """Handle signals within the context: the first ends all programs in order, the second at once."""
        waker, woken = socket.socketpair()
        for end in (waker, woken):
            end.setblocking(False)

        def request_end(_number: int, _frame: FrameType | None) -> None:
            if self._end_requested:
                self._kill_all_now()
            self._end_requested = True

        before = {number: signal.signal(number, request_end) for number in _END_SIGNALS}
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


def _reason(problem: Exception) -> str:
    """Return why something failed, as text."""
    return (isinstance(problem, OSError) and problem.strerror) or failure(problem).text

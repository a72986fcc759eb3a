"""Supervise the programs of a suite as separate processes: start, show their lines, restart, end in order.

One thread waits for lines and heartbeats of the programs, for their ends (by process descriptors), for signals and for
the time of the next start. If this process ends, for any reason, the kernel ends the programs. This process ends
after a signal, at the end of a bag, or if all nodes refuse their input at the start.

A program without heartbeats is frozen: it is reported, and later killed.

The suite must continue if the reader of stdout has ended or does not read, or if the disk of stdout is full. While
stdout does not accept lines, they are written to a file of bounded size (:class:`SuiteLog`).
"""

import contextlib
import errno
import os
import select
import selectors
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import FrameType

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_DONE
from ship_bringup.suite.process import Process, ReservedPorts, udp_ports_of
from ship_bringup.suite.program import Program, Role, SupervisedProgram, end_text, exit_code_of
from ship_estimation.rejection_rules import failure_rejection

LARGEST_FILE_BYTES = 5_000_000
"""Maximum size of the file of a :class:`SuiteLog`, bytes; a larger file is renamed to ``NAME.log.1``."""

_WRITE_TIMEOUT_MS = 200

FROZEN_REPORT_S = 5.0
"""Time without a heartbeat after which a program is reported, s."""

FROZEN_RESTART_S = 15.0
"""Time without a heartbeat after which a program is killed and started again, s."""

CHECK_PERIOD_S = 0.5
"""Period at which the times without a heartbeat are checked, s."""

_LONGEST_MESSAGE = 32
"""Maximum length of a heartbeat, bytes."""

_MAX_START_S = 60.0
"""Minimum time limit for the first heartbeat, s, because a slow computer loads libraries for a while."""

_END_SIGNALS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_END_TIMEOUT_S = 10.0
"""Timeout after a request to end, s; the program is then killed."""
_SUITE = "suite"

_END_ORDER = (Role.WATCHER, Role.PLAYER, Role.FEEDER, Role.NODE)


class SuiteLog:
    """Writes lines; it neither raises nor blocks for longer than a fraction of a second.

    Args:
        path: path of the file for lines that stdout does not accept.
        descriptor: file descriptor of stdout; that of stderr for the log of warnings.
    """

    def __init__(self, path: Path, descriptor: int = 1) -> None:
        self._path, self._descriptor = path, descriptor
        self._missed_count = 0

    def write(self, line: str) -> None:
        """Write a line, given without a newline, to stdout or else to the file."""
        try:
            if self._missed_count:
                self._write_to_stdout(
                    f"[suite] {self._missed_count} lines that were not accepted here are in {self._path}"
                )
                self._missed_count = 0
            self._write_to_stdout(line)
        except OSError as problem:
            if not self._missed_count:
                reason = os.strerror(problem.errno or errno.EIO)
                self._append_to_file(f"[suite] lines continue here, because stdout does not accept them: {reason}")
            self._missed_count += 1
            self._append_to_file(line)

    def _write_to_stdout(self, line: str) -> None:
        """Write a line to stdout.

        Raises:
            OSError: stdout does not accept the line.
        """
        data = _bytes(line)
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        while data:
            # A pipe with room accepts PIPE_BUF bytes at once; writing more bytes could wait for the reader.
            if not poll.poll(0 if self._missed_count else _WRITE_TIMEOUT_MS):
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
            data = data[os.write(self._descriptor, data[: select.PIPE_BUF]) :]

    def _append_to_file(self, line: str) -> None:
        """Append a line to the file, which the logs of stdout and stderr may share; on failure the line is lost."""
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        with contextlib.suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self._path, flags, 0o644)
            try:
                os.write(file, _bytes(line))
                is_full = os.fstat(file).st_size > LARGEST_FILE_BYTES
            finally:
                os.close(file)
            if is_full:
                self._path.replace(f"{self._path}.1")


def log_path(namespace: str) -> Path:
    """Return the path of a suite's own log, in the folder of ROS's logs."""
    home = os.environ.get("ROS_HOME") or "~/.ros"
    folder = Path(os.environ.get("ROS_LOG_DIR") or f"{home}/log").expanduser()
    return folder / f"{'_'.join(['suite', *namespace.split('/')] if namespace else ['suite'])}.log"


def _bytes(line: str) -> bytes:
    return f"{line}\n".encode("utf-8", errors="replace")


class FrozenCheck:
    """Checks the heartbeats of programs.

    Attributes:
        receiver: socket that receives the heartbeats.
        sender: socket that the programs inherit, to send their heartbeats.

    Args:
        report_s: time since the last heartbeat after which a program is reported, s.
        restart_s: time without a heartbeat after which a program is killed, s; at least 60 s for the first heartbeat.
        log: function that logs a line.
    """

    def __init__(self, report_s: float, restart_s: float, log: Callable[[str], None]) -> None:
        self._report_s, self._restart_s, self._log = report_s, restart_s, log
        self.receiver, self.sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.receiver.setblocking(False)
        self._checked_s = time.monotonic()

    @property
    def due_s(self) -> float:
        """Return the steady time of the next check, s."""
        return self._checked_s + CHECK_PERIOD_S

    def receive(self, programs: Sequence[SupervisedProgram]) -> None:
        """Record the heartbeats that have arrived; each contains the id of its process."""
        pids = set()
        with contextlib.suppress(OSError):
            while True:
                with contextlib.suppress(ValueError):
                    pids.add(int(self.receiver.recv(_LONGEST_MESSAGE)))
        for entry in programs:
            if entry.process is None or entry.process.pid not in pids:
                continue
            heartbeat_age = entry.process.heartbeat_age
            if heartbeat_age.is_reported and not heartbeat_age.is_killed:
                self._log(f"{entry.program.name} works again after {heartbeat_age.time_s:.0f} s without a heartbeat")
            heartbeat_age.reset()
            entry.has_run = True

    def close(self) -> None:
        """Close both sockets."""
        self.receiver.close()
        self.sender.close()

    def check(self, programs: Sequence[SupervisedProgram]) -> None:
        """Report programs without a heartbeat, and kill those without one for long; the player is not checked."""
        now_s = time.monotonic()
        if now_s < self.due_s:
            return
        step_s, self._checked_s = now_s - self._checked_s, now_s
        for entry in programs:
            if entry.process is not None and entry.program.role is not Role.PLAYER:
                entry.process.heartbeat_age.add(step_s)
                self._check_process(entry.program.name, entry.process)

    def _check_process(self, name: str, process: Process) -> None:
        heartbeat_age = process.heartbeat_age
        limit_s = self._restart_s if heartbeat_age.has_heartbeat else max(_MAX_START_S, self._restart_s)
        if heartbeat_age.time_s >= limit_s and not heartbeat_age.is_killed:
            heartbeat_age.is_killed = True
            self._log(f"{name} sent no heartbeat for {heartbeat_age.time_s:.0f} s: killed")
            process.kill()
        elif heartbeat_age.has_heartbeat and heartbeat_age.time_s >= self._report_s and not heartbeat_age.is_reported:
            heartbeat_age.is_reported = True
            symptom = f"no heartbeat for {heartbeat_age.time_s:.0f} s, stopped or in a callback that does not return"
            left_s = max(0.0, self._restart_s - heartbeat_age.time_s)
            self._log(f"{name} is frozen: {symptom}; it is killed and started again in {left_s:.0f} s")


class Supervisor:
    """Runs programs until a signal, or until the end of a bag.

    Args:
        programs: programs in the order of their start. Programs are ended in the order watchers, player, feeders,
            nodes (:class:`Role`), because watchers would report the end of other programs as a fault. Programs of one
            role are ended in the opposite order of their start.
        write: function that writes a line, given without a newline, and raises no error.
        frozen_report_s: time without a heartbeat after which a program is reported, s.
        frozen_restart_s: time without a heartbeat after which a program is killed and started again, s.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        write: Callable[[str], None] = print,
        frozen_report_s: float = FROZEN_REPORT_S,
        frozen_restart_s: float = FROZEN_RESTART_S,
    ) -> None:
        self._programs = [SupervisedProgram(program, due_s=0.0) for program in programs]
        self._write = write
        self._selector = selectors.DefaultSelector()
        self._is_end_requested = self._is_ending = False
        self._requested: Process | None = None
        self._kill_due_s: float | None = None
        self._exit_code = EXIT_DONE
        self._reserved_ports = ReservedPorts()
        self._frozen_check = FrozenCheck(frozen_report_s, frozen_restart_s, partial(self._log, _SUITE))

    def run(self) -> int:
        """Run the programs; return the exit code of the suite.

        The exit code is that of the player, or of the first failed program that was down at the end or never sent a
        heartbeat, or 0. If no node has run yet and all nodes end with bad input, the suite ends.
        """
        receive_heartbeats = partial(self._frozen_check.receive, self._programs)
        self._selector.register(self._frozen_check.receiver, selectors.EVENT_READ, receive_heartbeats)
        with self._signals():
            try:
                while any(kept.is_alive for kept in self._programs):
                    self._work_safely()
            finally:
                for process in self._processes:
                    process.kill()
                    process.close()
                self._reserved_ports.close()
                self._frozen_check.close()
        return self._exit_code

    def _work_safely(self) -> None:
        """Work and catch all exceptions: the end of this process would end all nodes."""
        try:
            self._work()
        except Exception as error:
            self._log(
                _SUITE, f"exception in the supervisor of the suite, which continues: {failure_rejection(error).text}"
            )
            time.sleep(1.0)

    def _work(self) -> None:
        """Perform the actions that are due, and wait for the next event or time."""
        if self._is_end_requested and not self._is_ending:
            self._end()
        if self._is_ending:
            self._end_next()
        else:
            self._start_due()
            self._frozen_check.check(self._programs)
        self._wait()

    def _start(self, entry: SupervisedProgram) -> None:
        """Start a program; if that fails, schedule another attempt."""
        entry.due_s, entry.ports = None, frozenset()
        try:
            entry.process = self._start_process(entry)
        except Exception as problem:
            delay_s = max(1.0, entry.restarts.delay_s(worked_s=0.0))
            entry.due_s = time.monotonic() + delay_s
            reason = (isinstance(problem, OSError) and problem.strerror) or failure_rejection(problem).text
            self._log(_SUITE, f"{entry.program.name} cannot be started: {reason}; tried again in {delay_s:.0f} s")

    def _start_process(self, entry: SupervisedProgram) -> Process:
        """Return a new process whose events are registered.

        Raises:
            OSError: the process cannot be started, usually for lack of memory or file descriptors.
        """
        process = Process(entry.program.command, self._frozen_check.sender.fileno())
        try:
            self._selector.register(process.output, selectors.EVENT_READ, lambda: self._read(entry, process))
            self._selector.register(process.pidfd, selectors.EVENT_READ, lambda: self._handle_end(entry, process))
        except OSError:
            self._unregister(process)
            process.kill()
            process.close()
            raise
        return process

    def _wait(self) -> None:
        """Wait for the next event or time, and handle it."""
        due = [kept.due_s for kept in self._programs if kept.due_s is not None]
        due += [] if self._kill_due_s is None else [self._kill_due_s]
        due += [] if self._is_ending else [self._frozen_check.due_s]
        timeout_s = max(0.0, min(due) - time.monotonic()) if due else None
        for key, _ in self._selector.select(timeout_s):
            # Handling one event may unregister the next event.
            if key.fd in self._selector.get_map():
                key.data()

    def _read(self, entry: SupervisedProgram, process: Process) -> bool:
        """Show the complete lines that a program has written, and note its ports; return True if there may be more."""
        lines, may_be_more = process.read_lines()
        for line in lines:
            self._log(entry.program.name, line)
        if lines and not entry.ports:
            # A program that prints has created its node, which keeps its UDP ports until it ends.
            entry.ports = udp_ports_of(process.pid)
        if process.is_output_complete:
            self._selector.unregister(process.output)
        return may_be_more

    def _handle_end(self, entry: SupervisedProgram, process: Process) -> None:
        while not process.is_output_complete and self._read(entry, process):
            pass
        self._unregister(process)
        code, ran_s = process.close(), time.monotonic() - process.start_s
        entry.process = None
        if not self._is_ending:
            # A program that never sent a heartbeat has not worked.
            self._handle_unrequested_end(entry, code, ran_s, ran_s if process.heartbeat_age.has_heartbeat else 0.0)

    def _handle_unrequested_end(self, entry: SupervisedProgram, code: int, ran_s: float, worked_s: float) -> None:
        text = f"{entry.program.name} ended after {ran_s:.1f} s: {end_text(code)}"
        if entry.program.role is Role.PLAYER:
            self._exit_code = exit_code_of(code)
            text += "; not started again" if self._exit_code else ""
            self._log(_SUITE, f"{text}; the suite ends with it")
            self._end()
            return
        entry.failure = exit_code_of(code)
        nodes = [each for each in self._programs if each.program.role is Role.NODE]
        if nodes and all(node.failure == EXIT_BAD_INPUT and not node.has_run for node in nodes):
            self._log(_SUITE, f"{text}; bad input at the start: the suite ends")
            self._end()
            return
        delay_s = entry.restarts.delay_s(worked_s)
        when = "at once" if delay_s == 0.0 else f"in {delay_s:.0f} s"
        self._log(_SUITE, f"{text}; started again {when} (restart {entry.restarts.consecutive_count} in a row)")
        entry.due_s = time.monotonic() + delay_s
        self._reserved_ports.reserve(entry.ports)

    def _start_due(self) -> None:
        now_s = time.monotonic()
        for entry in self._programs:
            if entry.due_s is not None and entry.due_s <= now_s:
                self._start(entry)

    def _unregister(self, process: Process) -> None:
        """Stop waiting for a process; a program that the process has started may keep the output open."""
        for descriptor in (process.pidfd, process.output.fileno()):
            if descriptor in self._selector.get_map():
                self._selector.unregister(descriptor)

    def _end(self) -> None:
        """Begin to end all programs; pending starts are cancelled."""
        self._is_ending = True
        for entry in self._programs:
            if entry.process is None or not entry.has_run:
                self._exit_code = self._exit_code or entry.failure
            entry.due_s = None

    def _end_next(self) -> None:
        """While the suite ends: request the next running program to end; kill it after a timeout."""
        running = [kept for kept in self._programs if kept.process is not None]
        if not running:
            return
        ending = min(reversed(running), key=lambda kept: _END_ORDER.index(kept.program.role))
        process = ending.process
        assert process is not None
        if process is not self._requested:
            self._requested, self._kill_due_s = process, time.monotonic() + _END_TIMEOUT_S
            process.request_end()
        elif self._kill_due_s is not None and time.monotonic() >= self._kill_due_s:
            self._log(_SUITE, f"{ending.program.name} does not end: killed")
            self._kill_due_s = time.monotonic() + _END_TIMEOUT_S
            process.kill()

    @property
    def _processes(self) -> list[Process]:
        return [kept.process for kept in self._programs if kept.process is not None]

    def _log(self, name: str, line: str) -> None:
        self._write(f"[{name}] {line}")

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """Handle signals within the context: the first signal ends all programs in order, the second kills them."""
        wake_writer, wake_reader = socket.socketpair()
        for end in (wake_writer, wake_reader):
            end.setblocking(False)

        def request_end(_number: int, _frame: FrameType | None) -> None:
            if self._is_end_requested:
                for process in self._processes:
                    process.kill()
            self._is_end_requested = True

        before = {number: signal.signal(number, request_end) for number in _END_SIGNALS}
        former = signal.set_wakeup_fd(wake_writer.fileno(), warn_on_full_buffer=False)
        self._selector.register(wake_reader, selectors.EVENT_READ, lambda: wake_reader.recv(64))
        try:
            yield
        finally:
            signal.set_wakeup_fd(former)
            for number, handler in before.items():
                signal.signal(number, handler)
            self._selector.close()
            wake_writer.close()
            wake_reader.close()

"""Common parts of all commands of the suite: arguments, exit codes, interruption, progress.

Bad input or an OSError ends a command with one line on stderr and exit code 2, Ctrl-C with 130. If the reader of a
command's output is gone, as with ``head``, the command ends silently with 141.

Progress of long work is shown on stderr: percentage done and time left. On a terminal one line is rewritten and erased
at the end; work of less than two seconds shows nothing. Without a terminal a line is written every ten seconds.
"""

import argparse
import contextlib
import io
import os
import select
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import FrameType
from typing import Any, NoReturn, TypeVar

from ship_bags.errors import one_line
from ship_bags.topic_names import TopicNames, names_from_options, topic_names, use_names
from ship_geometry.input_error import InputError

LAUNCHER_VARIABLE = "SHIP_LAUNCHER"
"""Environment variable with the command that starts executables; the script ``ros2run`` sets it."""

EXIT_DONE = 0
EXIT_BOUND_NOT_MET = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_NO_READER = 141
"""Exit code that a shell gives for a program ended by SIGPIPE, such as cat or grep before ``head``."""

_MARGIN = 2
"""Number of columns at the right that argparse leaves free."""

_FIRST_SHOWN_S = 2.0
"""Time before which nothing is shown on a terminal, s."""

_MIN_REWRITE_PERIOD_S = 0.25
"""Minimum time between two updates of the line on a terminal, s."""

_LINE_PERIOD_S = 10.0
"""Minimum time between two lines without a terminal, s."""

_MIN_SHARE = 0.02
"""Minimum ratio of work done for an estimate of the time left."""

_ERASE = "\r\x1b[K"

_on_terminal: list["Progress"] = []
"""Progress objects whose line is on the terminal."""

Item = TypeVar("Item")


class CommandParser(argparse.ArgumentParser):
    """Argument parser with one-line errors, whose help begins with the whole command and ends with an example.

    Options must be written out: an abbreviation would change its meaning when an option with the same beginning is
    added.

    Args:
        prog: name of the command; error texts begin with this name.
        package: package of the executable; empty for a tool that is not an executable of the suite.
        example: arguments of an example; for a tool the whole command line.
        options: options of argparse.ArgumentParser.
    """

    def __init__(self, *, prog: str, package: str = "", example: str = "", **options: Any) -> None:
        super().__init__(prog=prog, allow_abbrev=False, **options)
        self._command = f"{launcher()} {package} {prog}" if package else prog
        self._example = f"{self._command} {example}" if package else example

    def format_help(self) -> str:
        """Return the help with the whole command and the example; long lines of both are not wrapped.

        Arguments that do not fit next to the command are below it.
        """
        usage, _, rest = super().format_help().partition("\n\n")
        arguments = [line.strip() for line in usage.removeprefix(f"usage: {self.prog} ").splitlines()]
        usage = " ".join(["usage:", self._command, *arguments])
        if len(usage) > shutil.get_terminal_size().columns - _MARGIN:
            usage = f"\n{' ' * len('usage: ')}".join([f"usage: {self._command}", *arguments])
        example = f"\nexample:\n  {self._example}\n" if self._example else ""
        return f"{usage}\n\n{rest}{example}"

    def print_help(self, file: Any = None) -> None:
        """Print the help; exit with :data:`EXIT_NO_READER` if the reader of stdout is gone."""
        if file is not None:
            super().print_help(file)
        elif code := print_text(self.format_help()):
            self.exit(code)

    def error(self, message: str) -> NoReturn:
        """Exit with one line about the wrong arguments."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {message} (see {self._command} --help)\n")


def launcher() -> str:
    """Return the command that starts executables: ``./ros2run`` if that script was the starter, else ``ros2 run``."""
    return os.environ.get(LAUNCHER_VARIABLE, "ros2 run")


def print_text(text: str) -> int:
    """Print a text to stdout; return the exit code of a program that does nothing else."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        if not _is_reader_gone():
            raise
        return EXIT_NO_READER
    return EXIT_DONE


def run_command(
    parser: CommandParser, command: Callable[[argparse.Namespace], int], arguments: Sequence[str] | None
) -> int:
    """Run a command and return its exit code; bad input, an OSError or an interruption becomes one line on stderr.

    Args:
        parser: parser of the command's arguments.
        command: does the work with the parsed arguments and returns the exit code.
        arguments: the command line without the program's name; None for the command line of the process.
    """
    parsed = parser.parse_args(arguments)
    code = EXIT_BAD_INPUT
    with _single_interrupt(), topic_names(names_from_options(parsed)):
        try:
            done = command(parsed)
            sys.stdout.flush()
            return done
        except InputError as problem:
            reason = str(problem)
        except OSError as problem:
            if isinstance(problem, BrokenPipeError) and _is_reader_gone():
                return EXIT_NO_READER
            reason = f"{problem.filename}: {problem.strerror}" if problem.filename else str(problem)
        except KeyboardInterrupt:
            reason, code = "interrupted", EXIT_INTERRUPTED
        for progress in tuple(_on_terminal):  # end() removes it
            progress.end()
        sys.stderr.write(f"{parser.prog}: {one_line(reason)}\n")
    return code


def start_worker_process(names: TopicNames | None = None) -> None:
    """Prepare a worker process of a command: Ctrl-C and progress are left to the command's own process.

    Everything that the worker writes to stderr is discarded.

    Args:
        names: the command's topic names, for the bags that this process reads.
    """
    use_names(names or TopicNames())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr = io.StringIO()


def _is_reader_gone() -> bool:
    """Return True if stdout is a pipe without reader; its remaining output is then discarded."""
    try:
        stdout = sys.stdout.fileno()
    except OSError:
        return False  # not a file, as in a test
    watch = select.poll()
    watch.register(stdout, 0)
    if not any(event & select.POLLERR for _, event in watch.poll(0)):
        return False
    # Python flushes stdout once more at the exit, which would raise an exception.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stdout)
    os.close(nowhere)
    return True


@contextlib.contextmanager
def _single_interrupt() -> Iterator[None]:
    """Let the first Ctrl-C end the work and ignore further ones, so that the short clean-up is completed."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Progress:
    """Progress of one task; as a context manager it erases the line at the end.

    Args:
        label: the task, e.g. the name of a bag.
        clock: returns the time of a steady clock, s.
    """

    def __init__(self, label: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._label, self._clock = label, clock
        self._stream: Any = sys.stderr
        self._is_terminal = self._stream.isatty()
        self._started_s = clock()
        self._next_s = self._started_s + (_FIRST_SHOWN_S if self._is_terminal else _LINE_PERIOD_S)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def show(self, share: float) -> None:
        """Show the ratio of work done, 0 to 1, if the next update is due."""
        now_s = self._clock()
        if now_s < self._next_s:
            return
        text = progress_text(self._label, share, now_s - self._started_s)
        if self._is_terminal:
            self._next_s = now_s + _MIN_REWRITE_PERIOD_S
            if self not in _on_terminal:
                _on_terminal.append(self)
            self._stream.write(_ERASE + text)
        else:
            self._next_s = now_s + _LINE_PERIOD_S
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Erase the line on a terminal."""
        if self in _on_terminal:
            _on_terminal.remove(self)
            self._stream.write(_ERASE)
            self._stream.flush()


def progress_text(label: str, share: float, elapsed_s: float) -> str:
    """Return a line of progress: "voyage.mcap: 42 %, 1 min 20 s left"."""
    share = min(max(share, 0.0), 1.0)
    if share < _MIN_SHARE:
        return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s)} so far"
    return f"{label}: {100.0 * share:.0f} %, {_length(elapsed_s * (1.0 - share) / share)} left"


def with_progress(
    items: Iterable[Item], label: str, start: float, end: float, place: Callable[[Item], float]
) -> Iterator[Item]:
    """Yield items in their order, and show the progress from start to end.

    Args:
        items: the items.
        label: the task.
        start: position of the beginning, e.g. a time in ns.
        end: position of the end.
        place: returns the position of an item.
    """
    length = max(end - start, 1)
    with Progress(label) as progress:
        for item in items:
            progress.show((place(item) - start) / length)
            yield item


def with_count(items: Iterable[Item], label: str, count: int) -> Iterator[Item]:
    """Yield items, and show how many of ``count`` are done."""
    with Progress(label) as progress:
        for number, item in enumerate(items):
            progress.show(number / max(count, 1))
            yield item


def _length(seconds: float) -> str:
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"

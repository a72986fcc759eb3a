"""The parts that all commands of the suite share: arguments, exit codes, interruption.

Bad input ends a command with one line on stderr and exit code 2, Ctrl-C with 130. Where the reader of its output has
left, as ``head`` does, it ends without a word. Progress is shown by :mod:`ship_bags.progress`.
"""

import argparse
import contextlib
import io
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any, NoReturn

from ship_bags.errors import one_line
from ship_bags.progress import erase_progress
from ship_bags.renamed_topics import TopicNames, names_of, topic_names, use_names
from ship_geometry.input_error import InputError

EXIT_DONE = 0
EXIT_BOUND_NOT_MET = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_NO_READER = 141
"""As a shell tells of a program that SIGPIPE ended, and so of cat or grep before ``head``."""


class CommandParser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, and whose help ends with an example.

    Options are written out: an abbreviation would mean something else once another option begins like it.

    Args:
        example: a whole command line, as it is typed; empty for a tool that is no executable of the suite.
        options: as of argparse.
    """

    def __init__(self, *, example: str = "", **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        self._example = example

    def format_help(self) -> str:
        """The help, and the example as it stands: long lines stay whole."""
        return super().format_help() + (f"\nexample:\n  {self._example}\n" if self._example else "")

    def print_help(self, file: Any = None) -> None:
        """Print the help; leave with :data:`EXIT_NO_READER` where the reader of stdout is gone."""
        if file is not None:
            super().print_help(file)
        elif code := print_text(self.format_help()):
            self.exit(code)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the arguments, in one line, and leave."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def print_text(text: str) -> int:
    """Print a text to stdout; return the exit code of a program that does nothing else."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        if not _nobody_reads():
            raise
        return EXIT_NO_READER
    return EXIT_DONE


def run_command(
    parser: CommandParser, command: Callable[[argparse.Namespace], int], arguments: Sequence[str] | None
) -> int:
    """Run a command; its bad input, or its interruption, becomes one line on stderr. Returns the exit code.

    Args:
        parser: parser of the command's arguments.
        command: does the work with the parsed arguments and returns the exit code.
        arguments: the command line without the program's name; None takes the process's own.
    """
    parsed = parser.parse_args(arguments)
    code = EXIT_BAD_INPUT
    with _one_interrupt(), topic_names(names_of(parsed)):
        try:
            done = command(parsed)
            sys.stdout.flush()
            return done
        except InputError as problem:
            reason = str(problem)
        except OSError as problem:
            if isinstance(problem, BrokenPipeError) and _nobody_reads():
                return EXIT_NO_READER
            reason = f"{problem.filename}: {problem.strerror}" if problem.filename else str(problem)
        except KeyboardInterrupt:
            reason, code = "interrupted", EXIT_INTERRUPTED
        erase_progress()
        sys.stderr.write(f"{parser.prog}: {one_line(reason)}\n")
    return code


def serve_a_command(names: TopicNames | None = None) -> None:
    """Begin a process that works for a command: Ctrl-C is the command's to answer, and progress is its own to show.

    Args:
        names: the command's names of topics, for the bags that this process reads.
    """
    use_names(names or TopicNames())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr = io.StringIO()


def _nobody_reads() -> bool:
    """Whether stdout is a pipe that nobody reads any more; what is still written to it is dropped then."""
    try:
        stdout = sys.stdout.fileno()
    except OSError:
        return False  # no file, but what a test captures
    watch = select.poll()
    watch.register(stdout, 0)
    if not any(event & select.POLLERR for _, event in watch.poll(0)):
        return False
    # Python flushes it once more at the exit, and would complain.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stdout)
    os.close(nowhere)
    return True


@contextlib.contextmanager
def _one_interrupt() -> Iterator[None]:
    """Let the first Ctrl-C end the work, and ignore further ones: the tidying up is short and must be finished."""
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

"""What every command of the suite does alike: one line on stderr and exit code 2 for bad input."""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from ship_estimation.parameters import ParameterError
from ship_node.errors import BadInput, one_line

EXIT_DONE = 0
EXIT_BOUND_NOT_MET = 1
EXIT_BAD_INPUT = 2


class CommandParser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the arguments, in one line, and leave."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def run_command(
    parser: CommandParser, command: Callable[[argparse.Namespace], int], arguments: Sequence[str] | None
) -> int:
    """Exit code of a command whose bad input becomes one line on stderr.

    Args:
        parser: parser of the command's arguments.
        command: does the work with the parsed arguments and returns the exit code.
        arguments: the command line without the program's name; None takes the process's own.
    """
    parsed = parser.parse_args(arguments)
    try:
        return command(parsed)
    except (BadInput, ParameterError) as problem:
        reason = str(problem)
    except OSError as problem:
        reason = f"{problem.filename}: {problem.strerror}" if problem.filename else str(problem)
    sys.stderr.write(f"{parser.prog}: {one_line(reason)}\n")
    return EXIT_BAD_INPUT

"""A program of a suite: its command and role, the delays between its starts, and the state of its supervision.

The role determines the consequence of the program's end for the other programs.
"""

import signal
from dataclasses import dataclass, field
from enum import Enum

from ship_bags.command_line import EXIT_DONE, EXIT_INTERRUPTED
from ship_bringup.suite.process import Process

STEADY_S = 60.0
"""Run time of a program that has sent a heartbeat, after which earlier ends are no longer counted, s."""

_LONGEST_DELAY_S = 30.0
"""Longest pause before a restart, s."""

_FIRST_DELAY_S = 1.0
_NORMAL_EXIT_CODES = (EXIT_DONE, EXIT_INTERRUPTED, -signal.SIGINT, -signal.SIGTERM)
_SIGNAL_BASE = 128


class Role(Enum):
    """Role of a program, which determines the consequence of its end for the other programs."""

    NODE = "node"
    """An estimator; in a suite without estimators, also ``nmea_in`` or ``nmea_out``."""
    WATCHER = "watcher"
    """A program that monitors the nodes or sends their outputs; the nodes do not need this program."""
    FEEDER = "feeder"
    """A program that publishes the instruments' data; the nodes run without it, but not for long."""
    PLAYER = "player"
    """A program that plays a bag into the nodes. The suite ends with this program, which is not started again.

    Only programs of this role send no heartbeats (:mod:`ship_bags.live.ros_process`).
    """


@dataclass(frozen=True)
class Program:
    """One program of the suite.

    Attributes:
        name: name of the program, prefix of its lines.
        command: command line.
        role: role of the program.
    """

    name: str
    command: tuple[str, ...]
    role: Role = Role.NODE


@dataclass
class Restarts:
    """Restarts of one program, unlimited: the first at once, then with delays that double up to 30 s.

    Attributes:
        consecutive_count: number of ends in a row; after a run of at least :data:`STEADY_S`, with
            heartbeats, a new row begins.
    """

    consecutive_count: int = field(default=0, init=False)

    def delay_s(self, worked_s: float) -> float:
        """Count an end of the program; return the delay before its next start, s.

        Args:
            worked_s: run time of the program, s; 0 if it never sent a heartbeat.
        """
        self.consecutive_count = 1 if worked_s >= STEADY_S else self.consecutive_count + 1
        if self.consecutive_count == 1:
            return 0.0
        # The exponent is limited, because a program may end ten thousand times.
        return min(_FIRST_DELAY_S * 2.0 ** min(self.consecutive_count - 2, 10), _LONGEST_DELAY_S)


def exit_code_of(code: int) -> int:
    """Return the suite's exit code from a program's.

    The result is 0 after a normal end (SIGINT and SIGTERM included), 128 + n after another signal n, else the same.
    """
    if code in _NORMAL_EXIT_CODES:
        return EXIT_DONE
    return code if code > 0 else _SIGNAL_BASE - code


def end_text(code: int) -> str:
    """Return a text about the end of a program with an exit code."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code}, {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


@dataclass
class SupervisedProgram:
    """A program, its process if it runs, and the time of its next start.

    Attributes:
        program: the program.
        due_s: steady time of the next start, s; None if the program runs or is not started any more.
        restarts: delays between starts of the program.
        process: the process.
        ports: UDP ports of the process.
        failure: exit code of the suite that follows from the last end of the program.
        has_run: True if the program has ever sent a heartbeat.
    """

    program: Program
    due_s: float | None
    restarts: Restarts = field(default_factory=Restarts)
    process: Process | None = None
    ports: frozenset[int] = frozenset()
    failure: int = EXIT_DONE
    has_run: bool = False

    @property
    def is_alive(self) -> bool:
        """True if the program runs or will run again."""
        return self.process is not None or self.due_s is not None

"""Delay before a program of the suite that has ended is started again."""

import signal
from dataclasses import dataclass, field

from ship_bags.command_line import EXIT_DONE, EXIT_INTERRUPTED

STEADY_S = 60.0
"""Run time after which earlier ends are no longer counted, s."""

_LONGEST_DELAY_S = 30.0
"""Longest pause before a restart, s."""

_FIRST_DELAY_S = 1.0
_NORMAL_EXIT_CODES = (EXIT_DONE, EXIT_INTERRUPTED, -signal.SIGINT, -signal.SIGTERM)
_SIGNAL_BASE = 128


@dataclass
class Restarts:
    """Restarts of one program, unlimited: the first at once, then with delays that double up to 30 s.

    Attributes:
        consecutive_count: number of ends in a row; after a run of at least :data:`STEADY_S` a new row begins.
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

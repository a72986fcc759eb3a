"""When a program of the suite that has ended is started again."""

import signal
from dataclasses import dataclass, field

from ship_bags.command_line import EXIT_DONE, EXIT_INTERRUPTED

STEADY_S = 60.0
"""A program that ran so long was well: what happened before does not count against it any more, s."""

LONGEST_DELAY_S = 30.0
"""Longest pause before a restart, s."""

_FIRST_DELAY_S = 1.0
_ENDED_BY_WISH = (EXIT_DONE, EXIT_INTERRUPTED, -signal.SIGINT, -signal.SIGTERM)
_SIGNAL_BASE = 128


@dataclass
class Restarts:
    """The restarts of one program: the first at once, each further one after twice the time, up to 30 s, for ever.

    Attributes:
        in_a_row: ends so far; a run of :data:`STEADY_S` ends the row.
    """

    in_a_row: int = field(default=0, init=False)

    def delay_s(self, ran_s: float) -> float:
        """Return the pause before the next start, s.

        Args:
            ran_s: time for which the program ran.
        """
        self.in_a_row = 1 if ran_s >= STEADY_S else self.in_a_row + 1
        if self.in_a_row == 1:
            return 0.0
        # The exponent stays small: a program may end ten thousand times.
        return min(_FIRST_DELAY_S * 2.0 ** min(self.in_a_row - 2, 10), LONGEST_DELAY_S)


def failure_of(code: int) -> int:
    """What the end of a program means for the suite's exit code: 0 where it ended by wish, 128 + n after signal n."""
    if code in _ENDED_BY_WISH:
        return EXIT_DONE
    return code if code > 0 else _SIGNAL_BASE - code


def end_words(code: int) -> str:
    """How a program ended, for people."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code}, {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"

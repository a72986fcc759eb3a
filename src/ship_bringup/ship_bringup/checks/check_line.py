"""Results of the checks before a voyage as rows of a table, and the exit code that follows from them."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE
from ship_bags.errors import one_line
from ship_estimation.parameters.schema import aligned_lines

MAX_ROWS = 12
"""Maximum number of rows shown for one check; further rows are counted."""


class Result(Enum):
    """Result of a row, from good to bad."""

    OK = "OK"
    NOT_CHECKED = "not checked"
    WARN = "WARN"
    FAIL = "FAIL"


_ORDER = (Result.FAIL, Result.WARN, Result.NOT_CHECKED, Result.OK)


@dataclass(frozen=True)
class CheckLine:
    """One row of the table of checks.

    Attributes:
        check: name of the check.
        result: result of the check.
        finding: what was found.
        advice: what to do; empty if there is nothing to do.
    """

    check: str
    result: Result
    finding: str
    advice: str = ""


def table(lines: Sequence[CheckLine]) -> list[str]:
    """Return the rows as lines of text; the advice is on a line below the finding."""
    shown = aligned_lines(
        [("check", "result", "found"), *((x.check, x.result.value, one_line(x.finding)) for x in lines)]
    )
    indent = shown[0].index("found")
    text = shown[:1]
    for row, line in zip(shown[1:], lines, strict=True):
        text.append(row)
        if line.advice:
            text.append(f"{'':{indent}}-> {one_line(line.advice)}")
    return text


def summary_text(lines: Sequence[CheckLine]) -> str:
    """Return the last line: ready or not ready, and the numbers of failed, warning and unchecked rows."""
    counts = Counter(line.result for line in lines)
    parts = [
        f"{counts[result]} {name}{'s' if result is Result.WARN and counts[result] > 1 else ''}"
        for result, name in ((Result.FAIL, "failed"), (Result.WARN, "warning"), (Result.NOT_CHECKED, "not checked"))
        if counts[result]
    ]
    return f"{'NOT READY' if counts[Result.FAIL] else 'READY'}: {', '.join(parts) or 'all checks passed'}"


def worst_first(checks: Iterable[Iterable[CheckLine]]) -> list[CheckLine]:
    """Return the rows of all checks: failures, warnings, unchecked and good rows, each in the order of the checks."""
    lines = [line for check in checks for line in limit_rows(check)]
    return sorted(lines, key=lambda line: _ORDER.index(line.result))


def format_number(value: float) -> str:
    """Return a number rounded to three significant digits, or to an integer from 1000 on, never with an exponent.

    Example:
        >>> format_number(0.00150123), format_number(4.0), format_number(1623.4)
        ('0.0015', '4', '1623')
    """
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    text = f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def limit_rows(lines: Iterable[CheckLine]) -> list[CheckLine]:
    """Return the worst rows of one check, without duplicates, and a row with the number of further rows."""
    ordered = sorted(dict.fromkeys(lines), key=lambda line: _ORDER.index(line.result))
    if len(ordered) <= MAX_ROWS:
        return ordered
    rest = ordered[MAX_ROWS - 1 :]
    return [*ordered[: MAX_ROWS - 1], CheckLine(rest[0].check, rest[0].result, f"and {len(rest)} more")]


def exit_code(lines: Iterable[CheckLine]) -> int:
    """Return 0 if no check failed, else 1."""
    return EXIT_BOUND_NOT_MET if any(line.result is Result.FAIL for line in lines) else EXIT_DONE

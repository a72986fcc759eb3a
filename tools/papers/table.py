"""Rows and tables of docs/reproduction.md."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One value that a paper prints.

    Attributes:
        what: the value, and where the paper prints it.
        printed: the value as printed in the paper.
        ours: the value as computed here.
        why: reason of the difference; empty if the values agree.
    """

    what: str
    printed: str
    ours: str
    why: str = ""


def rows_table(rows: Iterable[Row]) -> str:
    """Return a Markdown table with printed value, computed value and reason of the difference."""
    cells = ((row.what, row.printed, row.ours, row.why or "agrees") for row in rows)
    return table(("", "printed", "ours", "why different"), cells)


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    names = list(header)
    lines = [f"| {' | '.join(cells)} |\n" for cells in (names, *rows)]
    return "".join([lines[0], "|---" * len(names) + "|\n", *lines[1:]])

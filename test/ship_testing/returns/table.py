"""Table of the return matrix, one row per kind of fault or set of cells, and a line for each cell that failed."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from ship_testing.trials.results_file import Result, ResultsFile

HEAD = (
    "fault",
    "cells",
    "returned",
    "slowest return: attitude, s",
    "stars, s",
    "pointing, s",
    "VALID beyond the level",
)
_COLUMNS = ("ship/attitude", "star/joint/solution", "theodolite/pointing")

Row = tuple[str, ...]


def results_file(path: Path, fresh: bool = False) -> ResultsFile:
    """Return the results of cells in a file.

    Raises:
        BadInput: a line before the last is not a result of a cell.
    """
    return ResultsFile(path, _key, fresh)


def _key(result: Result) -> tuple[int, str]:
    if not result["exception"]:
        result["returns_s"], result["worst_over_level"]
    return result["voyage"], result["cell"]


def exceeds_level(result: Result) -> bool:
    """True if an output was VALID with an error beyond its protection level, while the fault was detectable."""
    return _has_error_beyond_level(result) and not result["unseen"]


def _has_error_beyond_level(result: Result) -> bool:
    return bool(result.get("worst_over_level", 0.0) > 1.0)


def failed_results(results: Sequence[Result]) -> list[Result]:
    """Return the results in which an output did not return or was VALID beyond its level, or the software failed."""
    return [one for one in results if not one["returned"] or exceeds_level(one) or one.get("failures")]


def rows(results: Sequence[Result]) -> list[Row]:
    """Return the rows of the table: one per row name of the cells, and one for all."""
    by_row: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        by_row[result["row"]].append(result)
    found = [_row(name, group) for name, group in by_row.items()]
    return [*found, _row("all", results)] if found else []


def _row(name: str, group: Sequence[Result]) -> Row:
    slowest = []
    for topic in _COLUMNS:
        times_s = [one["returns_s"][topic] for one in group if one["returned"] and topic in one["returns_s"]]
        slowest.append(f"{max(times_s):.1f}" if times_s else "-")
    returned, beyond = sum(one["returned"] for one in group), sum(map(exceeds_level, group))
    return name, str(len(group)), str(returned), *slowest, str(beyond)


def unseen_lines(results: Sequence[Result]) -> list[str]:
    """Return a line for each class of undetectable faults: its cells, and how many were VALID beyond a level."""
    by_class: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        if result["unseen"]:
            by_class[result["unseen"]].append(result)
    return [
        f"{name}: {len(group)} cells, {sum(_has_error_beyond_level(one) for one in group)} VALID beyond the level"
        for name, group in sorted(by_class.items())
    ]


def failure_lines(result: Result) -> list[str]:
    """Return lines for people on a cell that failed."""
    name = f"cell {result['voyage']}, {result['cell']}"
    if result["exception"]:
        return [f"{name}: {result['exception'].strip().splitlines()[-1]}"]
    worst = f"{result['worst_over_level']:g} of the level at {result['worst_at_s']:g} s"
    excluded = ", ".join(result["excluded"]) or "none"
    line = (
        f"{name}: returned {result['returned']}, {result['returns_s']}, worst {worst}, "
        f"{result['failures']} failures of the software; excluded at the end: {excluded}"
    )
    return [line, *(f"    {source}: {text}" for source, text in result["texts"].items())]

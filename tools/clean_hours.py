"""Hours without faults: false exclusions, degradations, availability, errors beyond levels, NEES and RMS.

Each voyage is saved as a line of a results file when complete; a run that was killed continues there.
Exits with 1 if a voyage raised an exception or a bound is not met. The ship's INS has 20 Hz; in one voyage of ten it
has the rate of the scenario.
"""

import argparse
import math
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_estimation.innovations.gates import mean_nees_band
from ship_estimation.integrity.protection_levels import TESTS_PER_H
from ship_testing.trials.clean_hours import (
    ALERT_LIMIT_ARCSEC,
    SETTLED_S,
    THEODOLITE,
    by_kind,
    clean_voyages,
    run_clean_voyage,
)
from ship_testing.trials.results_file import Result, ResultsFile, run_and_record

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ROOT / "bags" / "scenarios"
_LENGTH_S = 1800.0
_MOST_EXCLUSIONS_PER_H = 0.02
_LEAST_AVAILABILITY = 0.995
_HEAD = (
    "voyages", "hours", "exclusions", "degradations", "limit", "available", "worst level", "worst/level",
    "beyond level", "beyond 5σ", "RMS: three angles", "NEES", "band", "speed",
)  # fmt: skip


def main() -> int:
    """Run the voyages and print the table."""
    parser = CommandParser(prog="clean_hours", description=__doc__.splitlines()[0], epilog=__doc__.splitlines()[2])
    parser.add_argument("--hours", type=float, default=100.0, help="total length of all voyages, h (100)")
    parser.add_argument("--length-s", type=float, default=_LENGTH_S, help="length of a voyage, s (1800)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "clean_hours", help="folder of the results")
    parser.add_argument("--fresh", action="store_true", help="delete existing results first")
    parser.add_argument("--table", action="store_true", help="print only the table of existing results")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    results = ResultsFile(
        options.out / "clean_hours.jsonl", lambda one: (one["voyage"], one["length_s"]), options.fresh
    )
    if not options.table:
        _make(options, results)
    return _report(results.results())


def _make(options: argparse.Namespace, results: ResultsFile) -> None:
    wanted = clean_voyages(math.ceil(options.hours * 3600.0 / options.length_s))
    wanted = [voyage for voyage in wanted if not results.contains((voyage.number, options.length_s))]

    def submit(pool: Executor) -> list[Future[Result]]:
        return [pool.submit(run_clean_voyage, voyage, SCENARIOS, options.length_s) for voyage in wanted]

    run_and_record(results, options.processes, submit)


def _report(results: list[Result]) -> int:
    console = Console(width=190)
    console.print(
        f"Independent tests: a separation (K_fa, K_md; K_0 of the level) {TESTS_PER_H} an hour for each hypothesis and "
        "angle; running means over N measurements 18 000/N an hour for each source. Outputs are evaluated once "
        f"a second; availability, degradations and RMS from {SETTLED_S:.0f} s. "
        "INS at 20 Hz, one voyage in ten at 100 Hz.",
        soft_wrap=True,
    )
    table, sound = Table(), True
    for column in ("kind", *_HEAD):
        table.add_column(column, justify="left" if column == "kind" else "right")
    for kind, found in by_kind([one for one in results if not one["exception"]]):
        row, met = _row(kind, found)
        table.add_row(kind, *row)
        sound = sound and met
    console.print(table)
    raised = [one for one in results if one["exception"]]
    for one in raised:
        console.print(f"voyage {one['voyage']}: {one['exception'].strip().splitlines()[-1]}", highlight=False)
    complete = [one for one in results if not one["exception"]]
    for one in complete:
        for what in ("exclusions", "degradations"):
            for since_s, text in one[what]:
                console.print(
                    f"  voyage {one['voyage']} ({one['kind']}), {since_s:.0f} s: {what}: {text}", soft_wrap=True
                )
    hours = sum(one["length_s"] for one in complete) / 3600.0
    exclusions = sum(len(one["exclusions"]) for one in complete)
    few = exclusions <= max(_MOST_EXCLUSIONS_PER_H * hours, 0.0)
    console.print(
        f"{len(results)} voyages, {hours:.1f} h: {exclusions} false exclusions (at most 2 in 100 h), "
        f"{len(raised)} with exceptions: {'all bounds met' if sound and few and not raised else 'NOT MET'}"
    )
    return EXIT_DONE if sound and few and not raised else EXIT_BOUND_NOT_MET


def _row(kind: str, found: list[Result]) -> tuple[list[str], bool]:
    """Return the row of one kind of voyage, and True if the bounds of this kind are met."""
    hours, settled = sum(one["length_s"] for one in found) / 3600.0, sum(one["settled"] for one in found)
    total = {name: sum(one[name] for one in found) for name in ("available", "beyond_level", "beyond_sigmas")}
    rms = np.sqrt(np.sum([one["squares"] for one in found], axis=0) / max(settled, 1))
    nees, (low, high) = float(np.mean([one["nees"] for one in found])), mean_nees_band(len(found), 3)
    available = total["available"] / settled if settled else float("nan")
    met = not total["beyond_level"] and not total["beyond_sigmas"]
    if kind != THEODOLITE:
        # Axis errors are constant over a theodolite session, so its NEES and availability have no bounds.
        met = met and low <= nees <= high and available >= _LEAST_AVAILABILITY
    limited = kind in ALERT_LIMIT_ARCSEC
    return [
        str(len(found)),
        f"{hours:.1f}",
        str(sum(len(one["exclusions"]) for one in found)),
        str(sum(len(one["degradations"]) for one in found)),
        f"{ALERT_LIMIT_ARCSEC[kind]:.0f}″" if limited else "-",
        f"{available:.3%}" if limited else "-",
        f"{max(one['worst_level'] for one in found):.1f}″",
        f"{max(one['worst_over_level'] for one in found):.2f}",
        str(total["beyond_level"]),
        str(total["beyond_sigmas"]),
        ", ".join(f"{value:.2f}″" for value in rms),
        f"{nees:.2f}",
        f"{low:.2f} to {high:.2f}",
        f"{hours * 3600.0 / max(sum(one['cpu_s'] for one in found), 0.01):.0f} x",
    ], met


if __name__ == "__main__":
    sys.exit(main())

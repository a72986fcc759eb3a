"""Voyages with faults, drawn by seed: is each reported, is the right source named, is any wrong output VALID?

Each voyage is saved as a line of a results file when complete; a run that was killed continues there. Prints each
bound of the voyages, and exits with 1 if a bound is not met.
"""

import argparse
import sys
from collections.abc import Iterable
from concurrent.futures import Executor, Future
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_testing.trials.fault_results import PAIR_HEAD, THREAT_HEAD, Row, pair_rows, results_file, threat_rows, totals
from ship_testing.trials.fault_voyage import Voyage, make_bag, replay_fault_free, run_voyage, voyages
from ship_testing.trials.one_fault import one_fault_lines
from ship_testing.trials.results_file import Result, ResultsFile, run_and_record
from ship_testing.trials.threats import OVERLAPPING, SINGLE

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ROOT / "bags" / "scenarios"
LENGTHS_S = {"demo": 120.0, "theodolite": 120.0, "paper_stars": 150.0, "everything": 120.0}
"""Scenario → duration of its voyages, s; a shorter scenario is not extended."""


def main() -> int:
    """Run the voyages and print the tables."""
    first, _, *others = __doc__.splitlines()
    parser = CommandParser(prog="faults", description=first, epilog=" ".join(others))
    parser.add_argument("--voyages", type=int, default=1000, help="number of voyages (1000)")
    parser.add_argument("--mode", choices=(SINGLE, OVERLAPPING, "both"), default="both", help="of the faults (both)")
    parser.add_argument("--bags", nargs="*", default=list(LENGTHS_S), choices=list(LENGTHS_S), help="scenarios (all)")
    parser.add_argument("--bag-seeds", type=int, default=2, help="seeds of each scenario (2)")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "faults", help="folder of bags and results")
    parser.add_argument("--fresh", action="store_true", help="delete existing results first")
    parser.add_argument("--table", action="store_true", help="print only the tables of existing results")
    parser.add_argument(
        "--one", metavar="FAULT", help="one fault on the first of --bags, in words: "
        "'topic: ins/imu, kind: bias, start_s: 20, up_arcsec: 30'"
    )  # fmt: skip
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    paths = {
        (name, seed): options.out / "bags" / f"{name}_{LENGTHS_S[name]:.0f}s_{seed}.mcap"
        for seed in range(1, options.bag_seeds + 1)
        for name in options.bags
    }
    if options.one is not None:
        (name, seed), path = next(iter(paths.items()))
        _bag(name, seed, path)
        print("\n".join(one_fault_lines(path, options.one)))
        return EXIT_DONE
    modes = (SINGLE, OVERLAPPING) if options.mode == "both" else (options.mode,)
    results = results_file(options.out / f"{options.mode}.jsonl", options.fresh)
    if not options.table:
        for (name, seed), path in paths.items():
            _bag(name, seed, path)
        wanted = voyages(list(paths.values()), options.voyages, modes)
        _make([voyage for voyage in wanted if not results.contains(voyage.key)], results, options.processes)
    return _report(results.results())


def _bag(name: str, seed: int, path: Path) -> None:
    make_bag(SCENARIOS / f"{name}.yaml", LENGTHS_S[name], seed, path)


def _make(wanted: list[Voyage], results: ResultsFile, processes: int) -> None:
    """Run voyages. Voyages without faults are first, because the other voyages are compared with them."""

    def submit(pool: Executor) -> list[Future[Result]]:
        bags = sorted({voyage.bag for voyage in wanted})
        clean = dict(zip(bags, pool.map(replay_fault_free, bags), strict=True))
        return [pool.submit(run_voyage, voyage, clean[voyage.bag]) for voyage in wanted]

    run_and_record(results, processes, submit)


def _report(results: list[Result]) -> int:
    console = Console(width=170)
    for head, rows in ((THREAT_HEAD, threat_rows(results)), (PAIR_HEAD, pair_rows(results))):
        if rows:
            console.print(_table(head, rows))
    found = totals(results)
    for line in found.lines:
        console.print(line, soft_wrap=True, highlight=False)
    return EXIT_DONE if found.all_met else EXIT_BOUND_NOT_MET


def _table(head: Row, rows: Iterable[Row]) -> Table:
    table = Table()
    for column in head:
        table.add_column(column, justify="left" if column in ("threat", "pair") else "right")
    for row in rows:
        table.add_row(*row)
    return table


if __name__ == "__main__":
    sys.exit(main())

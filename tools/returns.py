"""The return matrix: after every fault of every input the outputs become VALID again, within their bounds.

Each cell is saved as a line of a results file when complete; an interrupted run continues there. Prints the table and a
few lines for each cell that failed, and exits with 1 if a cell failed. --table writes the table into the page.
"""

import argparse
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_testing.trials.results_file import Result, run_and_record

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT / "test") not in sys.path:
    sys.path.insert(0, str(ROOT / "test"))

# The matrix is in the tests, which are no package.
from ship_testing.returns.cells import all_cells, sample_cells  # noqa: E402
from ship_testing.returns.run_cell import run_cell  # noqa: E402
from ship_testing.returns.table import HEAD, failed_results, failure_lines, results_file, rows, unseen_lines  # noqa: E402
from ship_testing.returns.voyages import VOYAGES, load_voyage, make_bag  # noqa: E402

PAGE = ROOT / "docs" / "explanation" / "recovery.md"
BEGIN, END = "<!-- returns: python tools/returns.py --table -->", "<!-- end of returns -->"


def main(arguments: list[str] | None = None) -> int:
    """Run the cells and print the table."""
    first, _, *others = __doc__.splitlines()
    parser = CommandParser(
        prog="returns", description=first, epilog=" ".join(others), example="python tools/returns.py --cells 50"
    )
    parser.add_argument("--cells", type=int, default=0, help="number of cells, a seeded sample (all)")
    parser.add_argument("--only", default="", help="cells whose name contains this text")
    parser.add_argument("--processes", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "returns", help="folder of bags and results")
    parser.add_argument("--fresh", action="store_true", help="delete existing results first")
    parser.add_argument(
        "--table", action="store_true", help="run nothing; write the table of all results into the page"
    )
    return run_command(parser, _run, arguments)


def _run(options: argparse.Namespace) -> int:
    results = results_file(options.out / "returns.jsonl", options.fresh)
    if options.table:
        write_table(PAGE, results.results())
        return EXIT_DONE
    paths = {name: make_bag(name, options.out / "bags") for name in VOYAGES}
    cells = all_cells({name: load_voyage(path) for name, path in paths.items()})
    cells = [cell for cell in sample_cells(cells, options.cells or len(cells)) if options.only in cell.name]

    def submit(pool: Executor) -> list[Future[Result]]:
        return [pool.submit(run_cell, cell, paths[cell.voyage]) for cell in cells if not results.contains(cell.key)]

    run_and_record(results, options.processes, submit)
    keys = {cell.key for cell in cells}
    return _report([result for result in results.results() if (result["voyage"], result["cell"]) in keys])


def _report(results: list[Result]) -> int:
    console = Console(width=150)
    table = Table()
    for column in HEAD:
        table.add_column(column, justify="left" if column == HEAD[0] else "right")
    for row in rows(results):
        table.add_row(*row)
    console.print(table)
    for line in unseen_lines(results):
        console.print(f"not detectable: {line}", highlight=False)
    bad = failed_results(results)
    for result in bad:
        console.print("\n".join(failure_lines(result)), soft_wrap=True, highlight=False, markup=False)
    return EXIT_BOUND_NOT_MET if bad else EXIT_DONE


def write_table(page: Path, results: list[Result]) -> None:
    """Write the table of results between the marks of a page."""
    lines = [HEAD, ("---", *["---:"] * (len(HEAD) - 1)), *rows(results)]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    unseen = "\n".join(f"- {line}" for line in unseen_lines(results))
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(
        f"{before}{BEGIN}\n\n{table}\n\nNot detectable from the data:\n\n{unseen}\n\n{END}{after}", encoding="utf-8"
    )


if __name__ == "__main__":
    sys.exit(main())

"""``campaign``: bags or scenarios under parameter sets and seeds, run in parallel, with one table and one page."""

import argparse
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command, with_count
from ship_bags.errors import BadInput
from ship_bags.output_files import write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_node.pages.console_tables import table_console
from ship_studies.campaign.items import (
    PAGE,
    TABLE,
    Item,
    ItemResult,
    Result,
    ResultFolder,
    campaign_items,
    csv_table,
    parse_seeds,
    run_item,
)
from ship_studies.campaign.workers import run_in_cluster, run_in_processes

_MAX_FAILURES_PRINTED = 10

Maker = Callable[[list[Item]], Iterator[tuple[Item, Result]]]
"""Function that runs items and yields each item with its result, in any order."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="campaign",
        example="bags/demo.mcap --config examples/two_sensors.yaml --out out/campaign",
        epilog="exit code: 0 all items completed; 1 an item failed, its line in the table contains the error; 2 bad "
        "input or usage; 130 interrupted: completed results are kept",
        description="Run many items: each bag, and each scenario with each seed, under each parameter set. A scenario "
        "is simulated; each bag is replayed through the suite's nodes, and the outputs are compared with the truth. "
        f"FOLDER contains a result for each item, {TABLE} with all quantities of evaluate --json [arcsec, deg, s, "
        f"m] and counts of statuses and rejections, and {PAGE} with the errors of each parameter set. A second run "
        "computes missing results only: a result is identified by the contents of bag or scenario and parameter set, "
        "the seed, and the code. The results do not depend on the number of workers.",
    )
    parser.add_argument("sources", type=Path, nargs="+", metavar="SOURCE", help="scenario (.yaml), or bag with truth")
    parser.add_argument(
        "--config", type=Path, nargs="+", default=[], metavar="FILE",
        help="parameter sets: suite files (default: the one attached to the bag, or made from the scenario)",
    )  # fmt: skip
    parser.add_argument("--seeds", type=_seeds, metavar="LIST", help="scenario seeds: 1-200, or 1,5,7-9 (default: 1)")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder of results, table and page")
    parser.add_argument("--skip", type=float, default=0.0, metavar="S", help="exclude the first S seconds (default: 0)")
    add_bag_name_options(parser, "of the ship's topics in the bags")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=_workers, metavar="N", help="parallel processes (default: one per processor)")
    where.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="run the items on this Dask cluster; its workers need the suite, and the files at the same paths",
    )
    return parser


def _seeds(text: str) -> list[int]:
    try:
        return parse_seeds(text)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from problem


def _workers(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number, 1 or more")
    return int(text)


def _run(options: argparse.Namespace) -> int:
    seeds = options.seeds or [1]
    items = campaign_items(options.sources, options.config, seeds, options.skip, options.namespace, options.remap)
    if options.seeds is not None and all(item.seed is None for item in items):
        raise BadInput("--seeds needs scenarios (.yaml), but there is none")
    if not options.skip >= 0.0:
        raise BadInput(f"--skip {options.skip:g}: expected 0 s or more")
    folder = ResultFolder(options.out)
    results = _run_missing_items(items, folder, _maker(options))
    # The import of the page libraries is slow, so the arguments are checked first.
    from ship_studies.campaign.page import page

    for name, text in ((TABLE, csv_table(results)), (PAGE, page(results))):
        write_atomically(folder.folder / name, text)
    return _print_summary(results, folder.folder)


def _maker(options: argparse.Namespace) -> Maker:
    if options.scheduler is not None:
        return functools.partial(run_in_cluster, run_item, address=options.scheduler)
    return functools.partial(run_in_processes, run_item, workers=options.workers or len(os.sched_getaffinity(0)))


def _run_missing_items(items: Sequence[Item], folder: ResultFolder, maker: Maker) -> list[ItemResult]:
    """Return every item with its result; missing items are run with progress on stderr, and saved unless they fail."""
    known = ((item.key, folder.result(item)) for item in items)
    found = {key: result for key, result in known if result is not None}
    missing = {item.key: item for item in items if item.key not in found}
    print(f"{len(items)} items: {len(found)} results exist, {len(missing)} to run", flush=True)
    if missing:
        for item, result in with_count(maker(list(missing.values())), "campaign", len(missing)):
            folder.save(item, result)
            found[item.key] = result
    return [(item, found[item.key]) for item in items]


def _print_summary(results: Sequence[ItemResult], folder: Path) -> int:
    from ship_studies.campaign.page import pooled_table, pools_by_parameters

    pooled = pools_by_parameters(results)
    if any(pool.errors for pool in pooled):
        table_console().print(pooled_table(pooled))
    failures = [(item, result["error"]) for item, result in results if result["error"] is not None]
    for item, error in failures[:_MAX_FAILURES_PRINTED]:
        print(f"failed: {item.name}: {error}")
    if len(failures) > _MAX_FAILURES_PRINTED:
        print(f"failed: {len(failures) - _MAX_FAILURES_PRINTED} more")
    print(f"campaign: {folder / TABLE}, {folder / PAGE}")
    return EXIT_BOUND_NOT_MET if failures else EXIT_DONE

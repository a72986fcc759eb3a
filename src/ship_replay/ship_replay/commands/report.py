"""``report``: a recording told in one HTML file."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import add_force, check_file, write_whole
from ship_bags.renamed_topics import add_bag_names
from ship_watch.limits import Limits, read_limits


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def add_page_options(parser: argparse.ArgumentParser, bags: str, page_name: str) -> None:
    """The options of a page: truth, file, limits of the ship, namespace.

    Args:
        parser: gets them.
        bags: which bags may be without truth, for the help.
        page_name: name of the page where none is given, for the help.
    """
    parser.add_argument("--truth", type=Path, metavar="TRUTH.mcap", help=f"bag with truth, where {bags} has none")
    parser.add_argument("--out", type=Path, metavar="FILE.html", help=f"file to write (default: {page_name})")
    parser.add_argument(
        "--limits", type=Path, metavar="FILE",
        help="limits of the ship as YAML (default: heading 6, tilt 4, pointing 12 arcsec)",
    )
    add_bag_names(parser, "of the ship's topics in the bags")
    add_force(parser)


def limits_of(options: argparse.Namespace) -> Limits:
    """The limits that were named; the defaults where none were."""
    return Limits() if options.limits is None else read_limits(options.limits)


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="report",
        example="./ros2run ship_replay report out.mcap --truth bags/demo.mcap --out night.html",
        epilog="exit code: 0 written; 2 bad input or usage, with one line that says which; 130 interrupted",
        description="Tell a recording in one HTML file that needs no network and prints: how long each angle was SAFE, "
        "CAUTION and UNSAFE, what failed when, errors [arcsec] or innovations inside their σ, budget, alignment, "
        "alerts, refusals, configuration.",
    )
    parser.add_argument("bag", type=Path, metavar="OUT.mcap", help="bag with the nodes' outputs, or rosbag2 folder")
    add_page_options(parser, "OUT.mcap", "OUT.html")
    return parser


def _run(options: argparse.Namespace) -> int:
    path = options.out or Path(f"{options.bag.stem}.html")
    check_file(path, options.force)
    limits = limits_of(options)
    # Loading the figures' libraries takes longer than to find out that an argument is wrong.
    from ship_replay.report.page import page
    from ship_replay.report.told import read_told

    told = read_told(options.bag, options.truth, limits, options.namespace)
    write_whole(path, page(told))
    for problem in told.night.problems:
        print(f"warning: {problem}")
    print(f"report: {path}")
    return EXIT_DONE

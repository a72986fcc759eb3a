"""``compare``: two recordings side by side in one HTML file."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import check_file, write_whole
from ship_replay.commands.report import add_page_options, limits_of


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="compare",
        example="./ros2run ship_replay compare again.mcap calmer.mcap --truth bags/demo.mcap --out compared.html",
        epilog="exit code: 0 written; 2 bad input or usage, with one line that says which; 130 interrupted",
        description="Put two recordings, of two runs or of two configurations, side by side in one HTML file that "
        "needs no network and prints: which was SAFE for longer, whose errors [arcsec] are smaller, B minus A of the "
        "outputs at equal stamps, budgets, alignments, what only one of them refused, alerted or was configured with.",
    )
    parser.add_argument("a", type=Path, metavar="A.mcap", help="bag with the nodes' outputs, or rosbag2 folder")
    parser.add_argument("b", type=Path, metavar="B.mcap", help="the other one")
    add_page_options(parser, "A.mcap or B.mcap", "A_B.html")
    return parser


def _run(options: argparse.Namespace) -> int:
    path = options.out or Path(f"{options.a.stem}_{options.b.stem}.html")
    check_file(path, options.force)
    limits = limits_of(options)
    # Loading the figures' libraries takes longer than to find out that an argument is wrong.
    from ship_replay.report.pair import read_pair
    from ship_replay.report.pair_page import pair_page

    pair = read_pair(options.a, options.b, options.truth, limits, options.namespace)
    write_whole(path, pair_page(pair))
    for letter, told in zip("AB", (pair.a, pair.b), strict=True):
        for problem in told.night.problems:
            print(f"warning: {letter}: {problem}")
    print(f"compare: {path}")
    return EXIT_DONE

"""``compare``: two recordings side by side in one HTML file."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import check_file, write_atomically
from ship_replay.commands.report import add_page_options, limits_of


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="compare",
        example="again.mcap calmer.mcap --truth bags/demo.mcap --out compared.html",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Show two recordings, of two runs or of two configurations, side by side in one HTML file that "
        "needs no network and is printable: SAFE shares, errors [arcsec], B minus A of the outputs at equal stamps, "
        "budgets, alignments, and rejections, alerts and parameters that differ.",
    )
    parser.add_argument("a", type=Path, metavar="A.mcap", help="bag with the nodes' outputs, or rosbag2 folder")
    parser.add_argument("b", type=Path, metavar="B.mcap", help="the second bag")
    add_page_options(parser, "A.mcap or B.mcap", "A_B.html")
    return parser


def _run(options: argparse.Namespace) -> int:
    path = options.out or Path(f"{options.a.stem}_{options.b.stem}.html")
    check_file(path, options.force)
    limits = limits_of(options)
    # The import of the figure libraries is slow, so the arguments are checked first.
    from ship_replay.comparison.pair import read_pair
    from ship_replay.comparison.pair_page import pair_page

    pair = read_pair(options.a, options.b, options.truth, limits, options.namespace)
    write_atomically(path, pair_page(pair))
    for letter, report_data in zip("AB", (pair.a, pair.b), strict=True):
        for problem in report_data.recording.problems:
            print(f"warning: {letter}: {problem}")
    print(f"compare: {path}")
    return EXIT_DONE

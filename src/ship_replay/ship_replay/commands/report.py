"""``report``: a recording in one HTML file; for a folder of bags, a page with a row for each session."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.output_files import add_force_option, check_file, check_folder, write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_watch.safety.limits import Limits, read_limits


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def add_page_options(parser: argparse.ArgumentParser, bags: str, page_name: str) -> None:
    """Add the options of a page: truth, output file, limits of the ship, names in the bags, overwriting.

    Args:
        parser: parser to which the options are added.
        bags: names of the bags that may be without truth, for the help.
        page_name: default name of the page, for the help.
    """
    parser.add_argument("--truth", type=Path, metavar="TRUTH.mcap", help=f"bag with truth, if {bags} has none")
    parser.add_argument("--out", type=Path, metavar="FILE.html", help=f"file to write (default: {page_name})")
    parser.add_argument(
        "--limits", type=Path, metavar="FILE",
        help="limits of the ship as YAML (default: heading 6, tilt 4, pointing 12 arcsec)",
    )
    add_bag_name_options(parser, "of the ship's topics in the bags")
    add_force_option(parser)


def limits_of(options: argparse.Namespace) -> Limits:
    """Return the limits in the file given by the options; the default limits without a file."""
    return Limits() if options.limits is None else read_limits(options.limits)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="report",
        example="out.mcap --truth bags/demo.mcap --out night.html",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Summarise a recording in one HTML file that needs no network and is printable: SAFE, CAUTION and "
        "UNSAFE shares of each angle, outages, errors [arcsec] or innovations with their σ, budget, alignment, "
        "alerts, rejections, configuration. For a folder of bags: a page with one row for each session and its "
        "difference to the previous session, and the report of each in FILE_reports/.",
    )
    parser.add_argument(
        "bag", type=Path, metavar="OUT.mcap", help="bag with the nodes' outputs, rosbag2 folder, or folder of bags"
    )
    add_page_options(parser, "OUT.mcap", "OUT.html")
    return parser


def _run(options: argparse.Namespace) -> int:
    path = options.out or Path(f"{options.bag.resolve().stem}.html")
    check_file(path, options.force)
    limits = limits_of(options)
    # The import of the figure libraries is slow, so the arguments are checked first.
    from ship_replay.report.folder import bags_in

    if bags := bags_in(options.bag):
        return _report_folder(options, bags, path, limits)
    from ship_replay.report.page import page
    from ship_replay.report.recording import read_report_data

    report_data = read_report_data(options.bag, options.truth, limits, options.namespace)
    write_atomically(path, page(report_data))
    for problem in report_data.recording.problems:
        print(f"warning: {problem}")
    print(f"report: {path}")
    return EXIT_DONE


def _report_folder(options: argparse.Namespace, bags: Sequence[Path], path: Path, limits: Limits) -> int:
    """Write the report of each bag of a folder, and the page with a row for each bag."""
    from ship_replay.report.folder import SessionRow, index_page, session_reports
    from ship_replay.report.recording import read_report_data

    if options.truth is not None:
        raise BadInput("--truth is for one bag: the bags of a folder have their own truth or none", file=options.bag)
    folder = path.with_name(f"{path.stem}_reports")
    check_folder(folder, [SessionRow(bag.name).file for bag in bags], options.force)
    folder.mkdir(exist_ok=True)
    rows = []
    reports = session_reports(
        bags, lambda bag: read_report_data(bag, None, limits, options.namespace),
        lambda name, text: write_atomically(folder / name, text),
    )
    for number, row in enumerate(reports, 1):
        print(f"{number} of {len(bags)}: {row.name}: {row.error or folder / row.file}", flush=True)
        rows.append(row)
    write_atomically(path, index_page(options.bag, rows, folder.name))
    print(f"report: {path}")
    return EXIT_DONE

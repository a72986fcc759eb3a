"""``export``: topics of a bag → tables."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import one_line
from ship_bags.export.export import FORMATS, ExportRequest, export
from ship_bags.output_files import add_force_option
from ship_bags.stamps import END_OF_TIME_NS, ns_from_utc_text
from ship_bags.topic_names import add_remap_option

_DESCRIPTION = """\
Writes topics of a bag as tables, one file each, e.g. ship.attitude.csv for ship/attitude. Numbers equal those of the
messages to the last bit. The name of a column ends with its unit, if known (heading_rad, sigma_m, covariance_rad2_0).
An array of variable length becomes a table of its own with a row per element, e.g. star.fore.observations-stars.csv;
message_index is the number of its message. log_time_ns and stamp_ns are nanoseconds since 1970 of UTC as POSIX time.
NetCDF files and docs/how-to/export.md give the meaning of numbers in columns like status.
"""
_EPILOG = "exit code: 0 written; 2 bad input or usage, or the disk failed, in one line; 130 interrupted"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="export",
        example="bags/demo.mcap --topics ins/imu gnss/fix --format netcdf --out tables",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="bag to read: .mcap file or rosbag2 folder")
    add_remap_option(parser)
    parser.add_argument(
        "--out",
        type=_out,
        required=True,
        metavar="OUT",
        help="folder to write into, made if it is missing; for one topic also a file .csv, .parquet or .nc; other "
        "suffixes are refused unless a folder of that name exists",
    )
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these topics, named as in the bag (all)"
    )
    parser.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="csv; parquet, which needs the package pyarrow; netcdf: NetCDF-3 after the CF conventions (by the name of "
        "OUT, else csv)",
    )
    parser.add_argument(
        "--from",
        dest="since",
        type=_time_ns,
        default=0,
        metavar="UTC",
        help="leave out messages logged before, e.g. 2026-06-01T20:00:30.5Z, and topics that have no others (the start "
        "of the bag)",
    )
    parser.add_argument(
        "--to",
        dest="until",
        type=_time_ns,
        default=END_OF_TIME_NS,
        metavar="UTC",
        help="leave out messages logged then and later, and topics that have no others (the end of the bag)",
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    order = ExportRequest(
        options.bag, options.out, tuple(options.topics), options.format, options.since, options.until, options.force
    )
    row_counts, problems = export(order)
    for line in problems:
        print(f"export: {one_line(line)}", file=sys.stderr)
    for path, rows in row_counts.items():
        print(f"export: {path}: {rows} rows")
    return EXIT_DONE


def _out(text: str) -> Path:
    # An empty path, from a variable that is not set, would mean the current folder.
    if not text.strip():
        raise argparse.ArgumentTypeError("it is empty: name a folder, or a file .csv, .parquet or .nc")
    return Path(text)


def _time_ns(text: str) -> int:
    try:
        return ns_from_utc_text(text)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from problem


if __name__ == "__main__":
    raise SystemExit(main())

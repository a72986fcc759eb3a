"""``stanford``: errors against protection levels over one or more runs, as a figure, a table and JSON."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file, write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_node.pages.console_tables import console_table, table_console
from ship_replay.evaluation.stanford import Epochs, Region, read_epochs
from ship_replay.evaluation.statistics import json_text
from ship_replay.evaluation.tables import value_text
from ship_watch.orientations import POINTING, SHIP_ATTITUDE

_LIMITED = {"alert_limit": SHIP_ATTITUDE, "pointing_alert_limit": POINTING}


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="stanford",
        example="out1.mcap out2.mcap --figure stanford.png --alert-limit 30 30 30",
        epilog="exit code: 0 all errors were within their protection levels; 1 one or more were above; "
        "2 bad input or usage; 130 interrupted",
        description="Errors against protection levels (a Stanford diagram) of the ship's attitude and of the pointing, "
        "over all bags together. An epoch is an output whose truth is known; the level is the last published one. "
        "An output that is DEGRADED or INVALID, or whose level is missing or above the alert limit, is unavailable.",
    )
    parser.add_argument(
        "bags", type=Path, nargs="+", metavar="OUT.mcap", help="bags with outputs, levels and truth, or rosbag2 folders"
    )
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the diagram (.png, .pdf, .svg)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all counts (flat, units in the names)")
    parser.add_argument(
        "--alert-limit",
        type=float,
        nargs=3,
        metavar=("HEADING", "PITCH", "ROLL"),
        help="alert limits of the ship's attitude [arcsec] (default: those in the bags)",
    )
    parser.add_argument(
        "--pointing-alert-limit",
        type=float,
        nargs=3,
        metavar=("AZ_COS_EL", "ELEVATION", "ROTATION"),
        help="alert limits of the pointing [arcsec] (default: those in the bags)",
    )
    add_bag_name_options(parser, "of the ship's topics in the bags")
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    for path in filter(None, (options.figure, options.json)):
        check_file(path, options.force)
    found = read_epochs(options.bags, options.namespace, _limits(options), with_bag_progress)
    table_console().print(stanford_table(found))
    if options.json is not None:
        values = {f"{part.orientation.label}.{name}": v for part in found for name, v in part.statistics().items()}
        write_atomically(options.json, json_text(values))
    if options.figure is not None:
        _draw(found, len(options.bags), options.figure)
    all_counts = [counts for part in found for counts in part.counts().values()]
    misleading_count = sum(counts[Region.MISLEADING] + counts[Region.HAZARDOUS] for counts in all_counts)
    return EXIT_BOUND_NOT_MET if misleading_count else EXIT_DONE


def _limits(options: argparse.Namespace) -> dict[str, Sequence[float]]:
    """Return label of an orientation → alert limits given on the command line, arcsec."""
    limits = {}
    for name, orientation in _LIMITED.items():
        given = getattr(options, name)
        if given is None:
            continue
        if not all(0.0 < value < math.inf for value in given):
            text = f"--{name.replace('_', '-')}: alert limits must be above 0 arcsec and finite, got {given}"
            raise BadInput(text, parameters=(name,), value=given)
        limits[orientation.label] = given
    return limits


def stanford_table(found: Sequence[Epochs]) -> Table:
    """Return the epochs of each angle by region, with availability, median level and the largest error/level."""
    groups = []
    for part in found:
        values = part.statistics()
        groups.append([
            [
                part.orientation.label if number == 0 else "",
                channel,
                *(str(counts[region]) for region in Region),
                f"{100.0 * values[f'{channel}.availability']:.2f} %",
                value_text(values[f"{channel}.median_level_arcsec"]),
                value_text(values[f"{channel}.worst_error_over_level"]),
            ]
            for number, (channel, counts) in enumerate(part.counts().items())
        ])
    shown = [*(region.label for region in Region), "available", "median level [arcsec]", "worst error/level"]
    columns = ["output", "angle", *(f">{column}" for column in shown)]
    return console_table("Epochs by error and protection level", columns, groups)


def _draw(found: Sequence[Epochs], bag_count: int, path: Path) -> None:
    # Importing the figure libraries is slow.
    from ship_node.pages.figure_files import save_figure
    from ship_replay.evaluation.stanford_figure import stanford_figure

    title = f"Error against protection level, {bag_count} voyage{'s' if bag_count > 1 else ''}"
    save_figure(stanford_figure(found, title), path)

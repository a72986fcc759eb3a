"""``axis_sightings``: table of sightings for ``fit_axes``, from a bag with lights."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file
from ship_bags.renamed_topics import add_bag_name_options
from ship_studies.axis_fit.recorded_sightings import axis_sightings


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="axis_sightings",
        example="bags/theodolite.mcap --out sightings.csv",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Write the sightings of a bag as a table for fit_axes. Each exposure with two lights or more that "
        "the node optical_axis used is one row: encoder angles [deg], true direction of the main axis on deck minus "
        "these [deg], time [s], and the effect of one sigma of each correlated error (deformation, ship, baselines, "
        "levers, refraction) [arcsec].",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="SIGHTINGS.csv", help="table to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    add_bag_name_options(parser)
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out.suffix.lower() != ".csv":
        raise BadInput("fit_axes reads .csv: use this extension", file=options.out)
    check_file(options.out, options.force)
    sightings = axis_sightings(options.bag, options.config, options.namespace, progress=with_bag_progress)
    sightings.write(options.out)
    count, written = len(sightings.rows), len(sightings.selected_stamps)
    spread = "" if written == count else f" ({written} of them written, evenly spread: the most that fit_axes reads)"
    sys.stdout.write(f"{options.out}: {count} sightings{spread}, {sightings.unused_count} exposures not used\n")
    return EXIT_DONE

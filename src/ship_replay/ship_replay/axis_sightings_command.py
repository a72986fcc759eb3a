"""``axis_sightings``: from a bag with lights to the table of sightings that ``fit_axes`` reads."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_replay.axis_sightings import axis_sightings
from ship_replay.command_line import EXIT_DONE, CommandParser, run_command
from ship_replay.errors import BadInput
from ship_replay.progress import watched


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="axis_sightings",
        epilog="exit code: 0 written; 2 bad input or usage, with one line that says which",
        description="Write the sightings of a bag as a table for fit_axes: of every exposure of two lights or more "
        "that the node optical_axis used, the encoder angles and the true direction of the main axis in the deck minus "
        "them [deg]. The deck's own deformation is in the offsets.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="SIGHTINGS.csv", help="table to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    parser.add_argument("--namespace", default="", help="namespace of the ship's topics in the bag")
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out.suffix.lower() != ".csv":
        raise BadInput(f"{options.out}: fit_axes reads .csv: give the table such a name")
    sightings = axis_sightings(options.bag, options.config, options.namespace, watch=watched)
    sightings.write(options.out)
    sys.stdout.write(f"{options.out}: {len(sightings.rows)} sightings, {sightings.unused} exposures not used\n")
    return EXIT_DONE

"""``smooth``: smoothed attitudes and pointings of a bag, each from all measurements before and after its stamp."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file
from ship_bags.topic_names import add_bag_name_options
from ship_replay.offline.smooth import smooth


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="smooth",
        example="bags/demo.mcap --out smoothed.mcap",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Write ship/attitude_smoothed: the attitude of ship_attitude at each stamp of the INS from all "
        "measurements of the bag, later ones included (Rauch, Tung and Striebel), with its covariance; and "
        "theodolite/pointing_smoothed: the pointing of optical_axis at each encoder reading likewise, with "
        "the smoothed attitude of the ship. The status is that of ship/attitude or theodolite/pointing, and worse "
        "where lights contradict the smoothed attitude. Times of an unresolved fault are not smoothed. "
        "Topics truth/* are copied, so that evaluate can compute the errors.",
    )
    parser.add_argument("bag", type=Path, metavar="IN.mcap", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.mcap", help="bag to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    add_bag_name_options(parser)
    parser.add_argument(
        "--arrival",
        choices=("log", "stamps"),
        default="log",
        help="arrival time of a message: its log time (default), or its stamp, for a bag whose recorder stalled",
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    by_stamps = options.arrival == "stamps"
    summary = smooth(options.bag, options.out, options.config, options.namespace, with_bag_progress, by_stamps)
    for smoothed in summary.outputs:
        print(f"{options.out}: {smoothed.count} messages on {smoothed.topic}")
        sigmas_arcsec = smoothed.median_sigmas_arcsec
        if sigmas_arcsec is not None:
            both = zip(smoothed.angles, *sigmas_arcsec.tolist(), strict=True)
            sigmas = ", ".join(f"{angle} {at_once:.2f} -> {again:.2f}" for angle, at_once, again in both)
            print(f"median sigma in real time -> smoothed [arcsec]: {sigmas}")
    for problem in summary.problems:
        print(f"warning: {problem}")
    return EXIT_DONE

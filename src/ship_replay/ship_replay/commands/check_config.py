"""``check_config``: missing or wrong parameters of a suite configuration, and its contradictions to a bag."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_BAD_INPUT, EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.errors import one_line
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.topic_names import add_bag_name_options
from ship_replay.offline.replay import ADAPTERS
from ship_replay.preflight.check_bag import check_bag, check_rates
from ship_replay.preflight.check_config import BagCheck, Findings, check_file
from ship_replay.preflight.check_installation import check_installation, check_telescope
from ship_replay.preflight.check_trial import check_trial

_CHECKS = (check_bag, check_installation, check_telescope, check_rates)
"""Checks, in the order in which their findings are printed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="check_config",
        example="examples/two_sensors.yaml bags/demo.mcap",
        epilog="exit code: 0 no errors, possibly warnings; 1 more than half of an input would not be used; "
        "2 errors found, or bad usage",
        description="Check a suite configuration (ROS 2 parameter file; units are in the parameter names), "
        "with the sections of nmea_in and nmea_out, "
        "and, with a bag, whether it fits: topics, types, frame_ids, rates; installation angles of star sensors and "
        "references, by their attitudes against ins/imu; of cameras that give single stars, on the deck and on the "
        "theodolite, the focal length by the angles between stars, mirrored axes, pixels counted from 1 (on the deck), "
        "magnitudes of another band; the telescope's focal length; inputs that a node would reject; sigmas that the "
        "innovations contradict by a factor of 1.5 or more; the estimated processor load of each node. Exit code 2 if "
        "there are errors, 1 if more than half of an input would not be used, 0 if there are only warnings or none "
        "at all.",
    )
    parser.add_argument("config", type=Path, metavar="FILE", help="suite configuration")
    parser.add_argument(
        "bag", type=Path, nargs="?", metavar="BAG", help=".mcap file or rosbag2 folder to check against"
    )
    add_bag_name_options(parser, "of the ship's nodes, and of its topics in the bag")
    return parser


def _run(options: argparse.Namespace) -> int:
    findings = Findings()
    nodes = check_file(options.config, ADAPTERS, findings, options.namespace)
    if options.bag is not None and not nodes and not findings.errors:
        findings.warnings.append(f"{options.config}: no section for an estimator: the bag is not checked")
    if options.bag is not None and nodes:
        with read_bag(options.bag) as bag:
            check = BagCheck(options.config, nodes, bag, options.namespace, findings)
            for check_part in _CHECKS:
                check_part(check)
            if not findings.errors:
                # With known errors, the trial would only report their effects.
                check_trial(check)
    for line in findings.errors:
        print(f"error: {one_line(line)}", file=sys.stderr)
    for line in findings.unused_inputs:
        print(f"not used: {one_line(line)}", file=sys.stderr)
    for line in findings.warnings:
        print(f"warning: {one_line(line)}")
    if not (findings.errors or findings.unused_inputs):
        for line in findings.notes:
            print(line)
        print(f"{options.config}: good" + (f" for {options.bag}" if options.bag is not None else ""))
        return EXIT_DONE
    found = {"errors": findings.errors, "inputs not used": findings.unused_inputs, "warnings": findings.warnings}
    counts = ", ".join(f"{kind}: {len(lines)}" for kind, lines in found.items() if lines or kind != "inputs not used")
    print(f"check_config: {options.config}: {counts}", file=sys.stderr)
    return EXIT_BAD_INPUT if findings.errors else EXIT_BOUND_NOT_MET

"""``calibrate_installation``: installation angles for ``ship_attitude`` from a session in harbour or at sea."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file, check_folder, write_atomically
from ship_bags.renamed_topics import add_bag_name_options
from ship_node.pages.console_tables import table_console
from ship_studies.installation.result import InstallationCalibration, calibrate
from ship_studies.installation.session import run_session
from ship_studies.installation.tables import json_text, print_calibration


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="calibrate_installation",
        example="harbour.mcap --out alignment.yaml --report report",
        epilog="exit code: 0 written; 2 bad input or usage, with a one-line reason; 130 interrupted",
        description="Find the installation angles of all star sensors from a session in harbour or at sea: a bag with "
        "ins/imu, the sensors' topics and, if there is one, reference/<name>/imu of known installation. Writes the "
        "file that ship_attitude reads by its parameter alignment_file, and lists the combinations of angles that were "
        "not observable. Angles in degrees, corrections and sigmas (1 sigma) in arcseconds.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument("--out", type=Path, required=True, metavar="ALIGNMENT.yaml", help="alignment file to write")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    parser.add_argument(
        "--prior-sigma",
        type=_arcsec,
        metavar="ARCSEC",
        help="prior standard deviation of every installation, about each axis of its sensor [arcsec] (default: the "
        "configured installation_sigma_..._arcsec)",
    )
    add_bag_name_options(parser)
    parser.add_argument("--report", type=Path, metavar="DIR", help="folder for installation.json and installation.png")
    add_force_option(parser)
    return parser


def _arcsec(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    # Beyond a few degrees the small-angle approximation fails and the filter's covariance is too small.
    if not 0.001 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a sigma: expected 0.001 to 3600 arcsec")
    return value


def _run(options: argparse.Namespace) -> int:
    if options.out.resolve() == options.bag.resolve():
        raise BadInput("the output would overwrite the input", file=options.out)
    check_file(options.out, options.force)
    if options.report is not None:
        check_folder(options.report, ("installation.json", "installation.png"), options.force)
    session = run_session(
        options.bag, options.config, options.prior_sigma, options.namespace, progress=with_bag_progress
    )
    calibration = calibrate(session)
    ALIGNMENT_FILE.save(options.out, calibration.prior)
    print_calibration(calibration, table_console())
    for warning in calibration.warnings:
        sys.stdout.write(f"warning: {warning}\n")
    sys.stdout.write(f"alignment: {options.out}\n")
    if options.report is not None:
        _report(calibration, options.report)
    return EXIT_DONE


def _report(calibration: InstallationCalibration, folder: Path) -> None:
    from ship_node.pages.figure_files import write_figures
    from ship_studies.installation.figure import calibration_figures

    folder.mkdir(parents=True, exist_ok=True)
    values = folder / "installation.json"
    write_atomically(values, json_text(calibration))
    (figure,) = write_figures(calibration_figures(calibration), folder).values()
    sys.stdout.write(f"report: {figure}, {values}\n")

"""``calibrate_installation``: installation angles for ``ship_attitude`` from a session in harbour or at sea.

The result is printed as tables and sentences, or written as JSON.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file, check_folder, write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_node.pages.console_tables import console_table, table_console
from ship_studies.installation.result import InstallationCalibration, JointRotation, calibrate
from ship_studies.installation.session import run_session

_JOINT_ROTATION_TEXTS = {
    "bow": "rotated together in roll (about the deck's bow axis)",
    "up": "rotated together in azimuth (about the deck's up axis)",
    "starboard": "rotated together in pitch (about the deck's starboard axis)",
}
_SENSOR_AXES = "boresight", "up axis", "right axis"
_MIN_ROTATION_SHARE = 0.3
"""Minimum ratio of a component of a rotation to the largest component for the component to be named."""

_TILT_REMEDY = "turn the ship by 180 deg or more, or add a reference of known installation"
_AZIMUTH_REMEDY = (
    "add a reference of known heading, or record longer in a swell that rolls the ship by degrees; turning the ship in "
    "calm water does not help: the INS's heading error turns with it"
)
_RELATIVE_REMEDY = "record longer, or observe more stars"


def print_calibration(calibration: InstallationCalibration, console: Console) -> None:
    """Print the result of a session."""
    session = calibration.session
    counts = ", ".join(f"{source} {count.used_count} messages" for source, count in session.counts.items())
    console.print(f"{session.name}: {session.duration_s:.0f} s; used: {counts}", highlight=False)
    console.print(_angle_table(calibration))
    console.print(_combination_table(calibration))
    for line in statements(calibration):
        console.print(line, highlight=False, markup=False)


def json_text(calibration: InstallationCalibration) -> str:
    """Return the result as JSON; an undefined value is null.

    Angles are in degrees, corrections and sigmas in arcseconds, the covariance in rad².
    """
    session = calibration.session
    document = {
        "bag": session.name,
        "duration_s": session.duration_s,
        "used": {source: count.used_count for source, count in session.counts.items()},
        "not_used_or_noted": {source: count.reasons for source, count in session.counts.items()},
        "angles": {
            f"star.{angle.sensor}.{angle.angle}": {
                "configured_deg": _wrapped_deg(angle.configured),
                "installed_deg": _wrapped_deg(angle.installed),
                "correction_arcsec": angle.correction_arcsec,
                "sigma_before_arcsec": _number(angle.sigma_before / ARCSEC),
                "sigma_arcsec": _number(angle.sigma / ARCSEC),
                "observed": angle.observability or None,
                "open_in": list(angle.unresolved_in),
            }
            for angle in calibration.angles
        },
        "combinations": {
            label: {
                "what": combination_text(combination, calibration.sensors),
                "sigma_before_arcsec": combination.sigma_before / ARCSEC,
                "sigma_arcsec": combination.sigma / ARCSEC,
                "observed": combination.observability,
                "turn_forward_up_right_arcsec": dict(
                    zip(calibration.sensors, (combination.rotation_s / ARCSEC).tolist(), strict=True)
                ),
                "variance_shares": dict(zip(calibration.sources, combination.shares.tolist(), strict=True)),
            }
            for label, combination in calibration.combinations.items()
        },
        "statements": statements(calibration),
        "warnings": calibration.warnings,
        "covariance_rad2": [[_number(value) for value in row] for row in calibration.covariance.tolist()],
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _angle_table(calibration: InstallationCalibration) -> Table:
    rows = [
        [
            angle.sensor if number % 3 == 0 else "",
            angle.angle,
            f"{_wrapped_deg(angle.configured):.5f}",
            f"{_wrapped_deg(angle.installed):.5f}",
            f"{angle.correction_arcsec:+.2f}",
            _text(angle.sigma_before / ARCSEC),
            _text(angle.sigma / ARCSEC),
            angle.observability or "-",
            " ".join(angle.unresolved_in),
        ]
        for number, angle in enumerate(calibration.angles)
    ]
    numbers = ">configured [deg]", ">installed [deg]", ">correction [″]", ">σ before [″]", ">σ [″]"
    columns = ["sensor", "angle", *numbers, "observed", "unobserved in"]
    return console_table("Installation angles, 1σ", columns, [rows[at : at + 3] for at in range(0, len(rows), 3)])


def _combination_table(calibration: InstallationCalibration) -> Table:
    rows = [
        [
            label,
            combination_text(combination, calibration.sensors),
            _text(combination.sigma_before / ARCSEC),
            _text(combination.sigma / ARCSEC),
            combination.observability,
            largest_error_text(calibration, combination),
        ]
        for label, combination in calibration.combinations.items()
    ]
    title = "Combinations, 1σ; before: from the configuration and one observation at constant heading"
    columns = "", "combination", ">before [″]", ">after [″]", "observed", "largest remaining error"
    return console_table(title, columns, [rows])


def _wrapped_deg(angle: float) -> float:
    """Return an angle in degrees from -180 to 180."""
    return math.degrees(float(wrap_pi(angle)))


def _number(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _text(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def combination_text(combination: JointRotation, sensors: tuple[str, ...]) -> str:
    """Return a description of a combination."""
    if combination.axis is not None:
        subject = sensors[0] if len(sensors) == 1 else "all sensors"
        return f"{subject} {_JOINT_ROTATION_TEXTS[combination.axis]}"
    run_arcsec = combination.rotation_s / ARCSEC
    parts = []
    for number in np.argsort(-np.abs(run_arcsec.ravel())).tolist():
        sensor, axis = divmod(number, 3)
        value = run_arcsec[sensor, axis]
        if abs(value) > _MIN_ROTATION_SHARE * np.max(np.abs(run_arcsec)):
            parts.append(f"{sensors[sensor]} about its {_SENSOR_AXES[axis]} {value:+.2f}″")
    return f"relative rotation: {', '.join(parts)}"


def remedy(combination: JointRotation) -> str:
    """Return the advice for observing a combination."""
    if combination.axis is None:
        return _RELATIVE_REMEDY
    return _AZIMUTH_REMEDY if combination.axis == "up" else _TILT_REMEDY


def largest_error_text(calibration: InstallationCalibration, combination: JointRotation) -> str:
    """Return the source of error with the largest share in the remaining variance."""
    largest = int(np.argmax(combination.shares))
    return f"{calibration.sources[largest].replace('_', ' ')} {combination.shares[largest]:.0%}"


def statements(calibration: InstallationCalibration) -> list[str]:
    """Return one line for each combination that was not well observed; a single line if all were well observed."""
    lines = []
    for label, combination in calibration.combinations.items():
        if combination.observability != "yes":
            how = "not observed" if combination.observability == "no" else "partly observed"
            lines.append(
                f"({label}) {how}, {combination.sigma / ARCSEC:.2f}″ of {combination.sigma_before / ARCSEC:.2f}″: "
                f"{combination_text(combination, calibration.sensors)}; {remedy(combination)}"
            )
    return lines or ["all combinations of the installation angles were observed"]


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

"""``fit_axes``: axis errors of a theodolite from sightings of known directions; writes figures, tables, calibration."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.output_files import add_force_option, check_folder, write_atomically
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.study_files import write_tables
from ship_studies.axis_fit.diagnostics import table_warnings
from ship_studies.axis_fit.report import MEANINGS, fit_tables, summary, yaml_text
from ship_studies.axis_fit.robust_fit import AxisFit, fit
from ship_studies.axis_fit.sighting_file import COLUMNS, GROUP_COLUMNS, LABEL_COLUMN, TIME_COLUMN, read_sightings
from ship_studies.axis_fit.sightings import MAX_SIGHTINGS, Sightings
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.optical_axis.calibration import SAVED_NAMES, CalibrationPrior

_MAX_SCATTER = np.deg2rad(1.0)
"""Maximum scatter of the sightings about their fit, rad; a larger scatter shows other units or other content."""

CALIBRATION = "calibration.yaml"
OUTPUT_NAMES = (
    *("axes.yaml", "axes.csv", "correlation.csv", "residuals.csv"),
    *("residuals.png", "over_angles.png", "sky.png", "terms.png"),
    CALIBRATION,
)
"""Names of all files written."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    columns = "\n".join(f"  {name:26}{doc}" for name, doc in COLUMNS.items())
    terms = "\n".join(f"  {name:10}{meaning}" for name, meaning in MEANINGS.items())
    parser = CommandParser(
        package="ship_studies",
        prog="fit_axes",
        example="sightings.csv --out fit --flexure",
        description="Axis errors [arcsec, 1 sigma] of a theodolite from sightings of known directions.",
        epilog=f"columns of the table, all in degrees:\n{columns}\n  {LABEL_COLUMN:26}number or name, optional\n"
        f"  {TIME_COLUMN:26}time of the sighting, UTC as POSIX time [s], optional\n"
        "errors common to several sightings, as columns, optional:\n"
        "  slow_right_arcsec:NAME:T, slow_up_arcsec:NAME:T   effect of one sigma of the error NAME on a sighting;\n"
        f"{'':28}T is its correlation time [s], inf if it is constant; axis_sightings writes them\n"
        f"  {', '.join(GROUP_COLUMNS):26}  rotation error of the base of this sigma, each axis, for a group\n"
        "A YAML file holds the same names in a list under 'sightings'.\n\n"
        f"terms:\n{terms}\n\n"
        "written: axes.yaml, axes.csv, correlation.csv, residuals.csv, figures as PNG, and calibration.yaml, which\n"
        "optical_axis takes as its calibration_file\n"
        "exit code: 0 written; 2 bad input or usage; 130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sightings", type=Path, metavar="SIGHTINGS", help="table of sightings, .csv or .yaml [deg]")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder, created if absent")
    parser.add_argument(
        "--fix",
        type=_fixed_term,
        action="append",
        default=[],
        metavar="TERM[=ARCSEC]",
        help="fix a term at a value [arcsec, default 0]; may be repeated",
    )
    parser.add_argument(
        "--serial", default="", help="serial number of the theodolite, as optical_axis is configured (default: none)"
    )
    parser.add_argument("--flexure", action="store_true", help="fit the bending of the tube too")
    add_force_option(parser)
    return parser


def _fixed_term(text: str) -> tuple[str, float]:
    """Return name and value (rad) of a fixed term."""
    name, _, value = text.partition("=")
    if name not in NAMES:
        raise argparse.ArgumentTypeError(f"'{name}' is not a term: expected one of {', '.join(NAMES)}")
    try:
        arcsec = float(value) if "=" in text else 0.0
    except ValueError:
        arcsec = math.nan
    if not math.isfinite(arcsec):
        raise argparse.ArgumentTypeError(f"'{value}' is not a value of '{name}': expected a finite number of arcsec")
    return name, arcsec * ARCSEC


def _run(options: argparse.Namespace) -> int:
    fixed = dict(options.fix)
    if not options.flexure:
        fixed.setdefault("flexure", 0.0)
    elif "flexure" in fixed:
        raise BadInput("--flexure and --fix flexure contradict each other: give one of them")
    check_folder(options.out, OUTPUT_NAMES, options.force)
    sightings = read_sightings(options.sightings)
    result = _fit_sightings(options.sightings, sightings, fixed)
    warnings = table_warnings(sightings, fixed)
    write_tables(options.out, fit_tables(result, sightings))
    write_atomically(options.out / "axes.yaml", yaml_text(result, sightings, warnings))
    saved = _calibration(result, sightings, warnings, options)
    # Imported here, because loading the figures' library takes longer than the fit.
    from ship_node.pages.figure_files import write_figures
    from ship_studies.axis_fit.figures import fit_figures

    write_figures(fit_figures(result, sightings), options.out)
    sys.stdout.write(f"{summary(result, sightings, warnings)}\n{saved}\nwritten: {options.out}\n")
    return EXIT_DONE


def _calibration(result: AxisFit, sightings: Sightings, table_warnings: list[str], options: argparse.Namespace) -> str:
    """Write the calibration for ``optical_axis`` if the sigmas are known and there is no warning; return a text."""
    path = options.out / CALIBRATION
    if table_warnings or not result.sigmas_known:
        # A calibration of an earlier table must not be mistaken for a calibration of this table.
        path.unlink(missing_ok=True)
        why = "of the warnings about the table" if table_warnings else "no sigma is known"
        return f"not written: calibration.yaml, because {why}"
    CALIBRATION_FILE.save(path, _calibration_prior(result, sightings.time_s, options.serial))
    dated = "" if sightings.time_s is not None else f", treated as old: without {TIME_COLUMN} its age is unknown"
    return f"calibration.yaml: for the parameter calibration_file of optical_axis, serial '{options.serial}'{dated}"


def _fit_sightings(path: Path, sightings: Sightings, fixed: dict[str, float]) -> AxisFit:
    """Return the fit of the sightings.

    Raises:
        BadInput: every term is fixed, or the sightings are too few, too many or inconsistent.
    """
    terms = len(NAMES) - len(fixed)
    if terms == 0:
        raise BadInput("every term is fixed: no term to fit")
    if len(sightings.labels) < terms:
        raise BadInput(f"{len(sightings.labels)} sightings for {terms} terms: expected at least {terms}", file=path)
    fading = any(not math.isinf(error.time_s) for error in sightings.correlated_errors)
    if fading and len(sightings.labels) > MAX_SIGHTINGS:
        raise BadInput(
            f"{len(sightings.labels)} sightings with errors correlated in time: expected at most "
            f"{MAX_SIGHTINGS}; use a subset",
            file=path,
        )
    result = fit(sightings, fixed)
    if not result.scale <= _MAX_SCATTER:
        raise BadInput(
            f"the sightings scatter by {np.rad2deg(result.scale):.1f} deg about any axis errors: expected offsets "
            "[deg] of one theodolite, true direction minus encoder",
            file=path,
        )
    return result


def _calibration_prior(fit: AxisFit, time_s: FloatArray | None, serial: str) -> CalibrationPrior:
    """Return the calibration from which ``optical_axis`` starts, from a fit with known sigmas.

    Fixed terms, the focal length and the parallelism have no variance in the calibration, so they stay as configured.

    Args:
        fit: fit of the sightings.
        time_s: times of the sightings, UTC as POSIX time, shape (n,); None if unknown. The calibration then has the
            year 1970 and counts as old.
        serial: serial number of the theodolite.
    """
    values, covariance = np.zeros(len(SAVED_NAMES)), np.zeros((len(SAVED_NAMES), len(SAVED_NAMES)))
    values[: len(NAMES)] = fit.errors.vector()
    rows = [SAVED_NAMES.index(name) for name in fit.fitted]
    covariance[np.ix_(rows, rows)] = fit.covariance
    time_ns = 0 if time_s is None else round(float(np.max(time_s)) * 1e9)
    return CalibrationPrior(time_ns, serial, "", values, covariance)

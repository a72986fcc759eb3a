"""``fit_axes``: axis errors of a theodolite from sightings of known directions; writes figures, tables, calibration.

The results are printed as text, and written as YAML for programs and as CSV for further evaluation.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.output_files import add_force_option, check_folder, write_atomically
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.study_files import Table, write_tables
from ship_studies.axis_fit.diagnostics import (
    condition_number,
    correlated_pairs,
    near_dependencies,
    table_warnings,
    unobservable,
)
from ship_studies.axis_fit.robust_fit import OUTLIER_AT, AxisFit, fit, rms, sizes
from ship_studies.axis_fit.sightings import (
    COLUMNS,
    GROUP_COLUMNS,
    LABEL_COLUMN,
    MAX_SIGHTINGS,
    TIME_COLUMN,
    Sightings,
    azimuth_and_elevation,
    coverage,
    read_sightings,
)
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.optical_axis.calibration import SAVED_NAMES, CalibrationPrior

MEANINGS = {
    "g": "zero point of the azimuth encoder",
    "h": "zero point of the elevation encoder",
    "c": "collimation",
    "I": "tilt of the horizontal axis",
    "beta_x": "tilt of the vertical axis, towards azimuth 0",
    "beta_y": "tilt of the vertical axis, towards azimuth 90",
    "flexure": "bending of the tube, times cos E",
}

FORMAT = "theodolite axis errors"
VERSION = 1
CALIBRATION = "calibration.yaml"
OUTPUT_NAMES = (
    *("axes.yaml", "axes.csv", "correlation.csv", "residuals.csv"),
    *("residuals.png", "over_angles.png", "sky.png", "terms.png"),
    CALIBRATION,
)
"""Names of all files written."""

_RESIDUALS = ("before", "after", "left_out")
_WIDE_GAP = np.pi / 2.0
"""Gap in azimuth above which the tilt of the vertical axis is poorly determined, rad."""

_MAX_SCATTER = np.deg2rad(1.0)
"""Maximum scatter of the sightings about their fit, rad; a larger scatter shows other units or other content."""


def summary(fit: AxisFit, sightings: Sightings, table_warnings: list[str]) -> str:
    """Return the result as text for the terminal, without a line break at the end."""
    lines = [
        *_coverage(sightings),
        _first_row(sightings),
        *(f"repeated, counted once: observation {repeated}" for repeated in sightings.repeated),
        *(f"warning: {text}" for text in table_warnings),
        "",
        *_terms(fit),
        "",
        *_residuals(fit),
        *_outliers(fit, sightings),
        *_observability_lines(fit),
    ]
    return "\n".join(lines)


def _coverage(sightings: Sightings) -> Iterator[str]:
    found = coverage(sightings)
    low_deg, high_deg = np.rad2deg(found.elevations)
    start_deg, end_deg = np.rad2deg(found.azimuth_gap)
    width_deg = np.rad2deg(found.azimuth_gap_width)
    yield (
        f"{found.count} sightings, {found.plunged} of them plunged; elevations {low_deg:.1f} to {high_deg:.1f} deg; "
        f"widest gap in azimuth {width_deg:.0f} deg ({start_deg:.0f} to {end_deg:.0f})"
        + (": sightings there would help" if found.azimuth_gap_width > _WIDE_GAP else "")
    )


def _first_row(sightings: Sightings) -> str:
    azimuth_deg, elevation_deg = (np.rad2deg(angle[0]) for angle in azimuth_and_elevation(sightings.direction_d))
    return (
        f"read: at {np.rad2deg(sightings.azimuth[0]):.5f}, {np.rad2deg(sightings.elevation[0]):.5f} deg by encoder, "
        f"observation {sightings.labels[0]} has the true direction {azimuth_deg:.5f}, {elevation_deg:.5f} deg. If both "
        "offsets have the wrong sign, all axis errors have the wrong sign too; no sighting can show this"
    )


def _terms(fit: AxisFit) -> Iterator[str]:
    yield f"{'term':8}  {'value':>9} {'sigma':>9}   [arcsec]"
    sigmas = _sigmas_arcsec(fit)
    for name, value in zip(NAMES, fit.errors.vector() / ARCSEC, strict=True):
        known = f"{sigmas.get(name, 0.0):9.2f}" if fit.sigmas_known else f"{'unknown':>9}"
        sigma = known if name in sigmas else f"{'fixed':>9}"
        # The sum with zero turns a rounded -0.0 into 0.0.
        yield f"{name:8}  {round(float(value), 2) + 0.0:9.2f} {sigma}   {MEANINGS[name]}"
    if not fit.sigmas_known:
        yield (
            f"no sigma: the residuals of neighbouring sightings are correlated ({fit.neighbour_correlation:.2f}), so "
            "they have common errors that the table does not state: columns slow_right_arcsec:NAME:T, "
            "slow_up_arcsec:NAME:T, or group, group_sigma_arcsec"
        )
    elif not np.any(fit.shared):
        yield "sigma: the sightings count as independent; the table states no common error"


def _residuals(fit: AxisFit) -> Iterator[str]:
    yield f"{'residuals':26}{'RMS':>8} {'median':>8}   [arcsec, angle on the sky]"
    for words, residuals in (
        ("without a model", fit.before),
        ("part due to common errors", fit.shared),
        ("with the fitted terms", fit.residuals),
        ("each left out of its fit", fit.leave_one_out),
    ):
        if words == "part due to common errors" and not np.any(residuals):
            continue
        yield f"{words:26}{rms(residuals) / ARCSEC:8.2f} {float(np.median(sizes(residuals))) / ARCSEC:8.2f}"
    if not np.all(fit.outliers):
        yield f"{'without the outliers':26}{rms(fit.residuals[~fit.outliers]) / ARCSEC:8.2f}"


def _outliers(fit: AxisFit, sightings: Sightings) -> Iterator[str]:
    yield f"sigma of one component of a sighting (robust): {fit.scale / ARCSEC:.2f} arcsec"
    numbers = np.flatnonzero(fit.outliers)
    off = sizes(fit.residuals)
    for number in numbers[np.argsort(-off[numbers])]:
        yield (
            f"outlier: observation {sightings.labels[number]}, off by {off[number] / ARCSEC:.1f} arcsec "
            f"({off[number] / fit.scale:.1f} sigma, bound {OUTLIER_AT:g}); weight {fit.weights[number]:.2f}"
        )


def _observability_lines(fit: AxisFit) -> Iterator[str]:
    yield f"condition number: {condition_number(fit):.3g}"
    for first, second, correlation in correlated_pairs(fit):
        yield f"correlated: {first} and {second}, {correlation:+.3f}"
    for combination in near_dependencies(fit):
        pairs = zip(combination.names, combination.changes, strict=True)
        runs = ", ".join(f"{name} {change / ARCSEC:+.3g}" for name, change in pairs)
        yield (
            f"poorly separated: {', '.join(combination.names)}: {runs} arcsec together (1 sigma) change these "
            f"sightings by only {combination.effect / ARCSEC:.2g} arcsec"
        )
    found = unobservable(fit)
    if found is not None:
        several = f"{found.count} combinations" if found.count > 1 else "one combination"
        what = f"{several} of {', '.join(found.names)}" if len(found.names) > 1 else found.names[0]
        yield f"not observable: {what}; kept near 0. Fix terms, or add sightings where their effects differ"


def fit_tables(fit: AxisFit, sightings: Sightings) -> dict[str, Table]:
    """Return header and rows of each CSV table."""
    names = [f"{residual}_{side}_arcsec" for residual in _RESIDUALS for side in ("right", "up")]
    directions = ("observation", "true_azimuth_deg", "true_elevation_deg")
    correlation = ((name, *row) for name, row in zip(fit.fitted, fit.correlation, strict=True))
    return {
        "axes.csv": (("term", "value_arcsec", "sigma_arcsec", "fitted"), _term_rows(fit)),
        "correlation.csv": (("term", *fit.fitted), correlation),
        "residuals.csv": ((*directions, *names, "after_arcsec", "weight", "outlier"), _residual_rows(fit, sightings)),
    }


def yaml_text(fit: AxisFit, sightings: Sightings, table_warnings: list[str]) -> str:
    """Return the fit as YAML.

    Args:
        fit: the fit.
        sightings: sightings of the fit.
        table_warnings: warnings about the table that was read.
    """
    values = fit.errors.vector() / ARCSEC
    open_combinations = unobservable(fit)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "values_arcsec": {name: float(value) for name, value in zip(NAMES, values, strict=True)},
        # A sigma from a wrong assumption would be worse than a missing sigma.
        "sigma_arcsec": _sigmas_arcsec(fit) if fit.sigmas_known else None,
        "covariance_of": list(fit.fitted),
        "covariance_rad2": fit.covariance.tolist() if fit.sigmas_known else None,
        "neighbours_correlation": fit.neighbour_correlation,
        "rms_of_shared_errors_arcsec": rms(fit.shared) / ARCSEC,
        "warnings": table_warnings,
        "repeated": list(sightings.repeated),
        "unobservable": list(open_combinations.names) if open_combinations else [],
        "nearly_dependent": [list(combination.names) for combination in near_dependencies(fit)],
        "condition_number": condition_number(fit),
        "sighting_count": len(sightings.labels),
        "outliers": [label for label, outlier in zip(sightings.labels, fit.outliers, strict=True) if outlier],
        "rms_before_arcsec": rms(fit.before) / ARCSEC,
        "rms_after_arcsec": rms(fit.residuals) / ARCSEC,
        "rms_left_out_arcsec": rms(fit.leave_one_out) / ARCSEC,
    }
    return yaml.safe_dump(document, sort_keys=False, width=110, default_flow_style=None)


def _term_rows(fit: AxisFit) -> Iterator[tuple[Any, ...]]:
    sigmas = _sigmas_arcsec(fit) if fit.sigmas_known else {}
    for name, value in zip(NAMES, fit.errors.vector() / ARCSEC, strict=True):
        yield name, value, sigmas.get(name, ""), "yes" if name in fit.fitted else "no"


def _sigmas_arcsec(fit: AxisFit) -> dict[str, float]:
    return dict(zip(fit.fitted, (fit.sigmas / ARCSEC).tolist(), strict=True))


def _residual_rows(fit: AxisFit, sightings: Sightings) -> Iterator[tuple[Any, ...]]:
    azimuth, elevation = np.rad2deg(azimuth_and_elevation(sightings.direction_d))
    residuals = np.concatenate([fit.before, fit.residuals, fit.leave_one_out], axis=1) / ARCSEC
    size = sizes(fit.residuals) / ARCSEC
    for number, label in enumerate(sightings.labels):
        outlier = "yes" if fit.outliers[number] else "no"
        yield label, azimuth[number], elevation[number], *residuals[number], size[number], fit.weights[number], outlier


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

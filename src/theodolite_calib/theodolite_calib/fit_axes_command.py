"""``fit_axes``: axis errors of a theodolite from sightings of known directions, with figures and tables."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ship_geometry.rotations import ARCSEC
from ship_node.command_line import EXIT_DONE, CommandParser, run_command
from ship_node.errors import BadInput
from theodolite_calib.axes import NAMES
from theodolite_calib.axis_fit.robust_fit import AxisFit, fit
from theodolite_calib.axis_fit.sighting_file import COLUMNS, LABEL_COLUMN, read_sightings
from theodolite_calib.axis_fit.sightings import Sightings
from theodolite_calib.axis_fit.tables import write_tables
from theodolite_calib.axis_fit.words import MEANINGS, summary

# Sightings that scatter more than this about their own fit (rad) are no sightings, or in other units.
_MOST_SCATTER = np.deg2rad(1.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    columns = "\n".join(f"  {name:26}{doc}" for name, doc in COLUMNS.items())
    terms = "\n".join(f"  {name:10}{meaning}" for name, meaning in MEANINGS.items())
    parser = CommandParser(
        prog="fit_axes",
        description="Axis errors [arcsec, 1 sigma] of a theodolite from sightings of known directions.",
        epilog=f"columns of the table, all in degrees:\n{columns}\n  {LABEL_COLUMN:26}number or name, optional\n"
        "A YAML file holds the same names in a list under 'sightings'.\n\n"
        f"terms:\n{terms}\n\n"
        "written: axes.yaml, axes.csv, correlation.csv, residuals.csv and figures as PNG\n"
        "exit code: 0 written; 2 bad input or usage",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sightings", type=Path, metavar="SIGHTINGS", help="table of sightings, .csv or .yaml [deg]")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into, made if absent")
    parser.add_argument(
        "--fix",
        type=_fixed,
        action="append",
        default=[],
        metavar="TERM[=ARCSEC]",
        help="do not fit a term, hold it at a value [arcsec, default 0]; may be repeated",
    )
    parser.add_argument("--flexure", action="store_true", help="fit the bending of the tube too")
    return parser


def _fixed(text: str) -> tuple[str, float]:
    """Name and value (rad) of a term that is held."""
    name, _, value = text.partition("=")
    if name not in NAMES:
        raise argparse.ArgumentTypeError(f"'{name}' is no term: expected one of {', '.join(NAMES)}")
    try:
        arcsec = float(value) if "=" in text else 0.0
    except ValueError:
        arcsec = math.nan
    if not math.isfinite(arcsec):
        raise argparse.ArgumentTypeError(f"'{value}' is no value of '{name}': expected a finite number of arcsec")
    return name, arcsec * ARCSEC


def _run(options: argparse.Namespace) -> int:
    fixed = dict(options.fix)
    if not options.flexure:
        fixed.setdefault("flexure", 0.0)
    elif "flexure" in fixed:
        raise BadInput("--flexure and --fix flexure contradict each other: give one of them")
    sightings = read_sightings(options.sightings)
    result = _fitted(options.sightings, sightings, fixed)
    options.out.mkdir(parents=True, exist_ok=True)
    write_tables(result, sightings, options.out)
    # Loading the figures' library takes longer than the fit: bad input is told before.
    from theodolite_calib.axis_fit.figures import draw_figures

    draw_figures(result, sightings, options.out)
    sys.stdout.write(f"{summary(result, sightings)}\nwritten: {options.out}\n")
    return EXIT_DONE


def _fitted(path: Path, sightings: Sightings, fixed: dict[str, float]) -> AxisFit:
    """The fit.

    Raises:
        BadInput: there is nothing to fit, there are too few sightings, or they fit nothing.
    """
    terms = len(NAMES) - len(fixed)
    if terms == 0:
        raise BadInput("every term is fixed: nothing is left to fit")
    if len(sightings.labels) < terms:
        raise BadInput(f"{path}: {len(sightings.labels)} sightings for {terms} terms: expected at least {terms}")
    result = fit(sightings, fixed)
    if not result.scale <= _MOST_SCATTER:
        raise BadInput(
            f"{path}: the sightings scatter by {np.rad2deg(result.scale):.1f} deg about any axis errors: expected "
            "offsets [deg] of one theodolite, true direction minus encoder"
        )
    return result

"""A calibration as tables on a terminal, and as JSON."""

import json
import math
from typing import Any

from rich.console import Console
from rich.table import Table

from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_replay.calibration.result import Calibration
from ship_replay.calibration.words import combination_words, limit_words, statements


def print_calibration(calibration: Calibration, console: Console) -> None:
    """Print what a session says."""
    session = calibration.session
    counts = ", ".join(f"{source} {count.used} messages" for source, count in session.counts.items())
    console.print(f"{session.name}: {session.duration_s:.0f} s; used: {counts}", highlight=False)
    console.print(_angle_table(calibration))
    console.print(_combination_table(calibration))
    for line in statements(calibration):
        console.print(line, highlight=False, markup=False)


def json_text(calibration: Calibration) -> str:
    """All of it: angles in degrees, corrections and sigmas in arcseconds, covariance in rad²; null where undefined."""
    session = calibration.session
    document = {
        "bag": session.name,
        "duration_s": session.duration_s,
        "used": {source: count.used for source, count in session.counts.items()},
        "not_used_or_noted": {source: count.reasons for source, count in session.counts.items()},
        "angles": {
            f"star.{angle.sensor}.{angle.angle}": {
                "configured_deg": _shown_deg(angle.configured),
                "installed_deg": _shown_deg(angle.installed),
                "correction_arcsec": angle.correction_arcsec,
                "sigma_before_arcsec": _number(angle.sigma_before / ARCSEC),
                "sigma_arcsec": _number(angle.sigma / ARCSEC),
                "observed": angle.observed or None,
                "open_in": list(angle.open_in),
            }
            for angle in calibration.angles
        },
        "combinations": {
            label: {
                "what": combination_words(combination, calibration.sensors),
                "sigma_before_arcsec": combination.sigma_before / ARCSEC,
                "sigma_arcsec": combination.sigma / ARCSEC,
                "observed": combination.observed,
                "turn_forward_up_right_arcsec": dict(
                    zip(calibration.sensors, (combination.run_s / ARCSEC).tolist(), strict=True)
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


def _angle_table(calibration: Calibration) -> Table:
    table = Table(title="Installation angles, 1σ")
    for column in ("sensor", "angle"):
        table.add_column(column)
    for column in ("configured [deg]", "installed [deg]", "correction [″]", "σ before [″]", "σ [″]"):
        table.add_column(column, justify="right")
    for column in ("observed", "open in"):
        table.add_column(column)
    for number, angle in enumerate(calibration.angles):
        table.add_row(
            angle.sensor if number % 3 == 0 else "",
            angle.angle,
            f"{_shown_deg(angle.configured):.5f}",
            f"{_shown_deg(angle.installed):.5f}",
            f"{angle.correction_arcsec:+.2f}",
            _text(angle.sigma_before / ARCSEC),
            _text(angle.sigma / ARCSEC),
            angle.observed or "-",
            " ".join(angle.open_in),
            end_section=number % 3 == 2,
        )
    return table


def _combination_table(calibration: Calibration) -> Table:
    table = Table(title="Combinations, 1σ; before: by the configuration and one look at constant heading")
    table.add_column("")
    table.add_column("combination")
    for column in ("before [″]", "after [″]"):
        table.add_column(column, justify="right")
    table.add_column("observed")
    table.add_column("what is left comes from")
    for label, combination in calibration.combinations.items():
        table.add_row(
            label,
            combination_words(combination, calibration.sensors),
            _text(combination.sigma_before / ARCSEC),
            _text(combination.sigma / ARCSEC),
            combination.observed,
            limit_words(calibration, combination),
        )
    return table


def _shown_deg(angle: float) -> float:
    """From -180 deg to 180 deg."""
    return math.degrees(float(wrap_pi(angle)))


def _number(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _text(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"

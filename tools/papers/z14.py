"""[Z14]: rows, tables and figures about the error model of a star sensor's installation."""

from collections.abc import Iterator

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_studies.layout.installation_model import SWEEPS, InstallationConvention, ship_rotation
from tools.papers.table import Row, rows_table, table
from tools.papers.z14_conclusions import ABEAM, AHEAD_ASTERN, CONCLUSIONS, HEADING, PITCH, curve_arcsec, of_star_roll
from tools.papers.z14_factors import (
    ANGLES,
    FACTORS,
    SUBSCRIPTS,
    exact_jacobian,
    jacobian_of_factors,
    largest_difference,
    random_attitudes,
)

PAPER, PHYSICAL = InstallationConvention.PAPER, InstallationConvention.PHYSICAL
EXACT = 1e-12
"""Limit below which differences are rounding errors."""
ATTITUDES = 1000
_GREATEST_PITCH = np.deg2rad(85.0)


def section(folder: str) -> str:
    """Return the section of the page about this paper; ``folder`` is the path of its figures."""
    pictures = "".join(
        f"![Figure {sweep.number}: errors over {sweep.symbol}]({folder}/z14_figure_{sweep.number}.png)\n\n"
        for sweep in SWEEPS
    )
    readings = ("", "conclusion", "the paper's reading", "physical reading", "where it does not hold")
    conclusions, factors = (
        table(readings, _conclusions()),
        table(("", "factor", "exact", "largest difference", ""), _factors()),
    )
    return f"""## [Z14]: error model of a star sensor's installation

R(A0, E0, γ0) has two readings ([errata](explanation/errata.md)). In *the paper's reading*, that of its factors and
figures, it rotates from deck to sensor. In *the physical reading*, that of its equation (4) and of the suite, it
rotates from sensor to deck. Angles that are not varied: As 235°, Es 45°, γs 90°, E0 35°, γ0 0.

{rows_table(_printed_section())}
### Its fifteen conclusions

Each conclusion is tested with the exact model in both readings by a function in
[`z14_conclusions.py`](../tools/papers/z14_conclusions.py). The tests compare absolute values of the errors.

{conclusions}
All hold in the paper's reading: its text agrees with its figures. {_count_holding(PHYSICAL)} of {len(CONCLUSIONS)} hold
physically.

### Its six figures

Each figure shows the physical reading above and the paper's reading below. [`layout_study`](how-to/mount_a_sensor.md)
draws the figures for any operating point.

{pictures}### Its factors (8)–(38)

Largest difference between each printed factor and its exact value at {ATTITUDES} random attitudes. The exact value is
that of the suite's Jacobian in the paper's reading. N and D are the elements of R whose quotient is the tangent of the
heading (K) and of the roll (θ). S is the sine of the pitch.

{factors}
{_factors_in_words()}

The Jacobian from the printed factors by (5)–(7) equals the suite's {_largest_joint_difference(PAPER)} in the paper's
reading. In the physical reading a derivative differs by up to {_largest_joint_difference(PHYSICAL)}.
"""


def _printed_section() -> Iterator[Row]:
    turn_deg = np.arange(0.0, 360.0, 0.1)
    paper, physical = (of_star_roll(reading, A0=turn_deg) for reading in (PAPER, PHYSICAL))
    azimuth_deg = turn_deg[int(np.argmax(paper[:1800, HEADING]))]
    yield Row(
        "largest error of the ship's attitude for Δγs = 100″, over A0",
        "112″",
        f"{paper[:, HEADING].max():.2f}″ of heading at A0 = {azimuth_deg:.0f}°; "
        f"physically {physical[:, HEADING].max():.2f}″",
        "the paper's figures do not transpose the installation matrix",
    )
    abeam = curve_arcsec(3, ABEAM[0], PAPER)
    yield Row(
        "largest error over E0, figure 3",
        "112″ at most",
        f"{abeam[:, HEADING].max():.2f}″ of heading at E0 = {int(np.argmax(abeam[:, HEADING]))}°, A0 = 90°",
        "112″ is the error at E0 = 35°",
    )
    ahead = curve_arcsec(3, AHEAD_ASTERN[0], PAPER)
    yield Row(
        "errors of heading and pitch for a sensor pointing ahead, figure 3",
        "grow with E0",
        f"0 to {ahead[-1, HEADING]:.2f}″, 0 to {ahead[-1, PITCH]:.2f}″",
    )


def _conclusions() -> Iterator[tuple[str, ...]]:
    for conclusion in CONCLUSIONS:
        held = [conclusion.holds(reading) for reading in (PAPER, PHYSICAL)]
        cells = ("holds" if each else "**does not**" for each in held)
        yield conclusion.place, conclusion.words, *cells, conclusion.remark


def _count_holding(reading: InstallationConvention) -> int:
    return sum(conclusion.holds(reading) for conclusion in CONCLUSIONS)


def _factors() -> Iterator[tuple[str, ...]]:
    angles = random_attitudes(ATTITUDES)
    for factor in FACTORS:
        difference = largest_difference(factor, angles)
        shown = "–" if np.isnan(difference) else f"{difference:.2f}" if difference > EXACT else "none"
        yield f"({factor.number})", factor.symbol, factor.meaning, shown, factor.remark


def _factors_in_words() -> str:
    differences = [largest_difference(factor, random_attitudes(ATTITUDES)) for factor in FACTORS]
    lost = sum(factor.printed is None for factor in FACTORS)
    wrong = [f"({f.number})" for f, each in zip(FACTORS, differences, strict=True) if each > EXACT]
    completed = sum(factor.remark == SUBSCRIPTS for factor in FACTORS)
    right = len(FACTORS) - lost - len(wrong)
    return (
        f"Of {len(FACTORS)} factors {right} are exact in the paper's reading. In {completed} of them the scan lacks "
        f"subscripts, which are restored by the\npattern of the others. {', '.join(wrong)} is misprinted. {lost} are "
        "missing in the scan, at least from their second terms on."
    )


def _largest_joint_difference(reading: InstallationConvention) -> str:
    """Return as text the largest difference of the printed factors' Jacobian from the exact one, pitch below 85°."""
    angles = upright_attitudes(reading)
    difference = float(np.max(np.abs(jacobian_of_factors(angles) - exact_jacobian(angles, reading))))
    return f"{difference:.0f}" if difference > EXACT else "except for rounding"


def upright_attitudes(reading: InstallationConvention) -> FloatArray:
    """Return random attitudes with a ship's pitch below 85° in a reading and in the paper's reading, shape (n, 6)."""
    angles = random_attitudes(ATTITUDES)
    pitches = [_pitch(angles, each) for each in (reading, PAPER)]
    upright: FloatArray = angles[np.max(np.abs(pitches), axis=0) < _GREATEST_PITCH]
    assert upright.shape[-1] == len(ANGLES)
    return upright


def _pitch(angles: FloatArray, reading: InstallationConvention) -> FloatArray:
    return np.arcsin(np.clip(ship_rotation(angles[:, :3], angles[:, 3:], reading)[:, 1, 0], -1.0, 1.0))

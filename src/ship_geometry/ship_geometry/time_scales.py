"""Time scales: POSIX UTC in integer nanoseconds to TAI, TT and two-part Julian dates for ERFA.

Leap seconds come from the table in `astropy-iers-data`. POSIX time has no number for a leap second: 23:59:60 has the
number of the 00:00:00 after it, and is taken for that.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path
from typing import Any

import astropy_iers_data
import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray

TimeNs = int | NDArray[np.int64]
"""Nanoseconds of POSIX UTC: one moment or an array of them."""

JulianDate = tuple[Any, Any]
"""A Julian date in two parts, whole (at midnight) and fraction, whose sum is the date: floats or float arrays."""

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
TT_MINUS_TAI_S = 32.184
UNIX_EPOCH_MJD = 40_587
_UNIX_EPOCH_JD = 2_440_587.5

_EXPIRY = re.compile(r"File expires on (\d{1,2} \w+ \d{4})")


@dataclass(frozen=True)
class LeapSeconds:
    """TAI − UTC since 1972.

    Attributes:
        starts_ns: the moments at which a value begins to hold, increasing, shape (n,).
        tai_minus_utc_s: the values, shape (n,).
        known_until_ns: up to here no other leap second is possible: the expiry of the table.
    """

    starts_ns: NDArray[np.int64]
    tai_minus_utc_s: FloatArray
    known_until_ns: int

    def at(self, time_ns: TimeNs) -> FloatArray:
        """TAI − UTC in seconds; before 1972 the first value, after the expiry of the table the last one."""
        index = np.searchsorted(self.starts_ns, time_ns, side="right") - 1
        return self.tai_minus_utc_s[np.maximum(index, 0)]


@lru_cache(maxsize=1)
def leap_seconds() -> LeapSeconds:
    """The table of the installed `astropy-iers-data`, read once.

    Example:
        >>> print(leap_seconds().at(1_404_906_607_800_000_000))  # in 2014, seconds
        35.0
    """
    return read_leap_seconds(Path(astropy_iers_data.IERS_LEAP_SECOND_FILE))


def read_leap_seconds(path: Path) -> LeapSeconds:
    """Read a file in the form of the IERS's Leap_Second.dat.

    Raises:
        ValueError: names the file and what is missing in it.

    Example:
        >>> table = read_leap_seconds(Path(astropy_iers_data.IERS_LEAP_SECOND_FILE))
        >>> print(table.tai_minus_utc_s[:3])  # seconds, from 1972 on
        [10. 11. 12.]
    """
    text = path.read_text(encoding="ascii")
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    expiry = _EXPIRY.search(text)
    if expiry is None or not rows or any(len(row) != 5 for row in rows):
        raise ValueError(f"{path}: not a table of leap seconds: 'MJD day month year TAI-UTC' and an expiry expected")
    mjd = np.array([float(row[0]) for row in rows])
    expires = datetime.strptime(expiry.group(1), "%d %B %Y").replace(tzinfo=timezone.utc)
    return LeapSeconds(
        starts_ns=(mjd.astype(np.int64) - UNIX_EPOCH_MJD) * DAY_NS,
        tai_minus_utc_s=np.array([float(row[4]) for row in rows]),
        known_until_ns=int(expires.timestamp()) * SECOND_NS,
    )


def julian_date(time_ns: TimeNs, offset_s: FloatArray | float = 0.0) -> JulianDate:
    """Two-part Julian date of a moment plus an offset.

    With the offset (scale − UTC) it is the date in that time scale. Day and rest are split while the nanoseconds are
    integers, because a Julian date in one double is good to 40 µs only, which is 0.6 mas of Earth rotation.

    Args:
        time_ns: moment, or moments.
        offset_s: added to it, s.

    Example:
        >>> whole, fraction = julian_date(1_404_906_607_800_000_000)  # 2014-07-09 11:50:07.8 UTC
        >>> print(whole, round(fraction, 9))
        2456847.5 0.493145833
    """
    days, rest_ns = divmod(time_ns, DAY_NS)
    return _UNIX_EPOCH_JD + days, (rest_ns / SECOND_NS + offset_s) / 86_400.0


def tt_julian_date(time_ns: TimeNs) -> JulianDate:
    """Terrestrial Time of a moment as a two-part Julian date.

    Example:
        >>> utc, tt = julian_date(1_404_906_607_800_000_000), tt_julian_date(1_404_906_607_800_000_000)
        >>> print(round((tt[1] - utc[1]) * 86_400.0, 6))  # 35 leap seconds and 32.184 s
        67.184
    """
    return julian_date(time_ns, leap_seconds().at(time_ns) + TT_MINUS_TAI_S)


def utc_text(time_ns: int) -> str:
    """A moment for messages to people: ``2014-07-09 11:50:07 UTC``.

    Example:
        >>> utc_text(1_404_906_607_800_000_000)
        '2014-07-09 11:50:07 UTC'
    """
    return datetime.fromtimestamp(time_ns // SECOND_NS, tz=timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")

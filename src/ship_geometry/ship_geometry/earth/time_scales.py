"""Time scales: conversion of POSIX UTC in integer nanoseconds to TAI, TT and two-part Julian dates for ERFA.

Leap seconds are from the table in `astropy-iers-data`. POSIX time cannot represent a leap second: 23:59:60 has the
same number as the following 00:00:00.
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
"""Nanoseconds of POSIX UTC: one time or an array."""

JulianDate = tuple[Any, Any]
"""Julian date as the sum of two floats or float arrays: the date at midnight, and the fraction of the day."""

StampArray = NDArray[np.int64]
"""Stamps, ns."""

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
TT_MINUS_TAI_S = 32.184
UNIX_EPOCH_MJD = 40_587
_UNIX_EPOCH_JD = 2_440_587.5

NEVER_NS = -(2**62)
"""Stamp before any other stamp: of an event that has not occurred, or since all time."""

_EXPIRY = re.compile(r"File expires on (\d{1,2} \w+ \d{4})")


@dataclass(frozen=True)
class LeapSeconds:
    """TAI − UTC since 1972.

    Attributes:
        starts_ns: times from which each value is valid, in ascending order, shape (n,).
        tai_minus_utc_s: values of TAI − UTC, shape (n,).
        known_until_ns: expiry of the table; before this time the table has all leap seconds.
    """

    starts_ns: NDArray[np.int64]
    tai_minus_utc_s: FloatArray
    known_until_ns: int

    def at(self, time_ns: TimeNs) -> FloatArray:
        """Return TAI − UTC, s; before 1972 the first value, after the expiry of the table the last value."""
        index = np.searchsorted(self.starts_ns, time_ns, side="right") - 1
        return self.tai_minus_utc_s[np.maximum(index, 0)]


@lru_cache(maxsize=1)
def leap_seconds() -> LeapSeconds:
    """Return the table of the installed `astropy-iers-data`, which is read once.

    Example:
        >>> print(leap_seconds().at(1_404_906_607_800_000_000))  # in 2014, seconds
        35.0
    """
    return read_leap_seconds(Path(astropy_iers_data.IERS_LEAP_SECOND_FILE))


def read_leap_seconds(path: Path) -> LeapSeconds:
    """Read a file in the format of the IERS's Leap_Second.dat.

    Raises:
        ValueError: the format is wrong.

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
    """Return the two-part Julian date of a time plus an offset.

    With the offset S − UTC the result is the date in the time scale S. Day and fraction are split in integer
    nanoseconds, because a Julian date in one double has a resolution of 40 µs, which is 0.6 mas of Earth rotation.

    Args:
        time_ns: time, or array of times.
        offset_s: offset to add, s.

    Example:
        >>> whole, fraction = julian_date(1_404_906_607_800_000_000)  # 2014-07-09 11:50:07.8 UTC
        >>> print(whole, round(fraction, 9))
        2456847.5 0.493145833
    """
    days, rest_ns = divmod(time_ns, DAY_NS)
    return _UNIX_EPOCH_JD + days, (rest_ns / SECOND_NS + offset_s) / 86_400.0


def tt_julian_date(time_ns: TimeNs) -> JulianDate:
    """Return Terrestrial Time as a two-part Julian date.

    Example:
        >>> utc, tt = julian_date(1_404_906_607_800_000_000), tt_julian_date(1_404_906_607_800_000_000)
        >>> print(round((tt[1] - utc[1]) * 86_400.0, 6))  # 35 leap seconds and 32.184 s
        67.184
    """
    return julian_date(time_ns, leap_seconds().at(time_ns) + TT_MINUS_TAI_S)


def utc_text(time_ns: int) -> str:
    """Return a time as text for users: ``2014-07-09 11:50:07 UTC``.

    Example:
        >>> utc_text(1_404_906_607_800_000_000)
        '2014-07-09 11:50:07 UTC'
    """
    return datetime.fromtimestamp(time_ns // SECOND_NS, tz=timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")

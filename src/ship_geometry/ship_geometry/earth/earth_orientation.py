"""Earth orientation parameters (EOP): UT1 − UTC and polar motion from the IERS's finals2000A, with their errors.

A UT1 error of one second rotates the sky by 15″. The table of `astropy-iers-data` has measured values up to
its date of issue and predictions for a year after this date. A time outside the table, or after the expiry of the
table of leap seconds, raises an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import astropy_iers_data
import numpy as np

from ship_geometry.earth.time_scales import DAY_NS, UNIX_EPOCH_MJD, LeapSeconds, TimeNs, leap_seconds, utc_text
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.text_tables import numbers, read_lines

# Columns (first, last; counted from 1) of finals2000A, from its ReadMe. Values of Bulletin B (_b) replace the values
# of Bulletin A.
_RECORD_LENGTH = 188
_UT1_FLAG = 58
_MEASURED, _PREDICTED = b"IP"
_COLUMNS = {
    "mjd": (8, 15),
    "pole_x": (19, 27),
    "pole_x_sigma": (28, 36),
    "pole_y": (38, 46),
    "pole_y_sigma": (47, 55),
    "ut1": (59, 68),
    "ut1_sigma": (69, 78),
    "pole_x_b": (135, 144),
    "pole_y_b": (145, 154),
    "ut1_b": (155, 165),
}

# Error of UT1 between the daily values: linear interpolation of UT1 − TAI (18 µs), tides within the day (30 µs), and
# the difference between Bulletins A and B (30 µs since 2000, six times the stated error of A). The root sum square is
# 0.7 mas.
_UT1_FLOOR_S = 50e-6
# Error of the pole between the daily values: linear interpolation (0.04 mas) and tides within the day (0.5 mas).
_POLE_FLOOR = 0.5e-3 * ARCSEC


class OutsideEarthOrientation(ValueError):
    """Error for a time that the table does not cover; the text states the time, the table and what to do."""


@dataclass(frozen=True)
class EarthOrientation:
    """Orientation of the Earth at one or several times; all arrays have the shape of the times.

    Attributes:
        ut1_minus_utc_s: UT1 − UTC.
        ut1_sigma_s: standard deviation of UT1 − UTC.
        pole_x: polar motion, rad.
        pole_y: polar motion, rad.
        pole_sigma: standard deviation of each coordinate of the pole, rad.
    """

    ut1_minus_utc_s: FloatArray
    ut1_sigma_s: FloatArray
    pole_x: FloatArray
    pole_y: FloatArray
    pole_sigma: FloatArray


def prediction_sigma_s(days_ahead: FloatArray | float) -> FloatArray:
    """Return the standard deviation of a predicted UT1 − UTC, s: 5 ms · (days ahead / 30)^1.2.

    The formula is fitted to the errors of six past issues of the table; it is two to four times the value in the table.

    Example:
        A month ahead the Earth's rotation is known to 5 ms, which is 0.075″:

        >>> print(prediction_sigma_s(30.0))
        0.005
    """
    return 5e-3 * (np.asarray(days_ahead, dtype=float) / 30.0) ** 1.2


@dataclass(frozen=True)
class EarthOrientationTable:
    """Daily values at 0h UTC, arrays of shape (n,).

    Attributes:
        source: name of the file, for messages.
        mjd: modified Julian date of each day; the days have no gap.
        ut1_minus_tai_s: UT1 − TAI; it has no leap seconds, so it can be interpolated.
        ut1_sigma_s: standard deviation of UT1 in the file.
        pole_x: polar motion, rad.
        pole_y: polar motion, rad.
        pole_sigma: standard deviation of each coordinate of the pole in the file, rad.
        measured_until_mjd: last day with a measured value.
        leap_seconds: table of TAI − UTC.

    Example:
        >>> table = earth_orientation_table()
        >>> table.unavailable_text(0).partition(":")[0]  # 1970: before the table begins
        'no Earth orientation for 1970-01-01 00'
    """

    source: str
    mjd: FloatArray
    ut1_minus_tai_s: FloatArray
    ut1_sigma_s: FloatArray
    pole_x: FloatArray
    pole_y: FloatArray
    pole_sigma: FloatArray
    measured_until_mjd: float
    leap_seconds: LeapSeconds

    @property
    def first_ns(self) -> int:
        """Time at which the table begins."""
        return _ns_from_mjd(self.mjd[0])

    @property
    def last_ns(self) -> int:
        """End of the predictions, or expiry of the table of leap seconds, whichever is earlier."""
        return min(_ns_from_mjd(self.mjd[-1]), self.leap_seconds.known_until_ns)

    def unavailable_text(self, time_ns: TimeNs) -> str | None:
        """Return the reason why the table has no value for one of the times; None if it covers all times."""
        times = np.asarray(time_ns, dtype=np.int64)
        outside = times[(times < self.first_ns) | (times > self.last_ns)]
        if not outside.size:
            return None
        moment = utc_text(int(outside.flat[0]))
        return (
            f"no Earth orientation for {moment}: {self.source} covers {utc_text(self.first_ns)} to "
            f"{utc_text(self.last_ns)}; install a newer astropy-iers-data, or correct the clock"
        )

    def at(self, time_ns: TimeNs) -> EarthOrientation:
        """Return the orientation of the Earth at one or several times.

        Raises:
            OutsideEarthOrientation: a time is outside the table.
        """
        reason = self.unavailable_text(time_ns)
        if reason is not None:
            raise OutsideEarthOrientation(reason)
        mjd = UNIX_EPOCH_MJD + np.asarray(time_ns, dtype=np.int64) / DAY_NS
        days_predicted = np.maximum(mjd - self.measured_until_mjd, 0.0)
        # A measured value has the error in the file. A prediction adds its error to the error of the last measurement.
        own_sigma_s = np.interp(np.minimum(mjd, self.measured_until_mjd), self.mjd, self.ut1_sigma_s)
        variance_s2 = own_sigma_s**2 + _UT1_FLOOR_S**2 + prediction_sigma_s(days_predicted) ** 2
        return EarthOrientation(
            ut1_minus_utc_s=np.interp(mjd, self.mjd, self.ut1_minus_tai_s) + self.leap_seconds.at(time_ns),
            ut1_sigma_s=np.sqrt(variance_s2),
            pole_x=np.interp(mjd, self.mjd, self.pole_x),
            pole_y=np.interp(mjd, self.mjd, self.pole_y),
            pole_sigma=np.hypot(np.interp(mjd, self.mjd, self.pole_sigma), _POLE_FLOOR),
        )


@lru_cache(maxsize=1)
def earth_orientation_table() -> EarthOrientationTable:
    """Return the table of the installed `astropy-iers-data`, which is read once.

    Example:
        >>> orientation = earth_orientation_table().at(1_404_906_607_800_000_000)  # 2014-07-09 11:50:07.8 UTC
        >>> print(f"UT1 - UTC = {orientation.ut1_minus_utc_s:.4f} s")
        UT1 - UTC = -0.3055 s
    """
    return read_finals2000a(Path(astropy_iers_data.IERS_A_FILE), leap_seconds())


def read_finals2000a(path: Path, leaps: LeapSeconds) -> EarthOrientationTable:
    """Read a file in the IERS format finals2000A.all; values of Bulletin B replace the values of Bulletin A.

    Raises:
        ValueError: the format is wrong, or values are missing; the text names the file.

    Example:
        >>> table = read_finals2000a(Path(astropy_iers_data.IERS_A_FILE), leap_seconds())
        >>> print(utc_text(table.first_ns))
        1973-01-02 00:00:00 UTC
    """
    try:
        lines = read_lines(path, _RECORD_LENGTH)
        flag = lines[:, _UT1_FLAG - 1]
        has_ut1 = (flag == _MEASURED) | (flag == _PREDICTED)
        measured = flag[has_ut1] == _MEASURED
        read = dict(zip(_COLUMNS, numbers(lines[has_ut1], *_COLUMNS.values()), strict=True))
        mjd = read["mjd"]
        since_1970_ns = (mjd.astype(np.int64) - UNIX_EPOCH_MJD) * DAY_NS
        table = EarthOrientationTable(
            source=path.name,
            mjd=mjd,
            ut1_minus_tai_s=_final_or_rapid(read["ut1_b"], read["ut1"]) - leaps.at(since_1970_ns),
            ut1_sigma_s=read["ut1_sigma"],
            pole_x=_final_or_rapid(read["pole_x_b"], read["pole_x"]) * ARCSEC,
            pole_y=_final_or_rapid(read["pole_y_b"], read["pole_y"]) * ARCSEC,
            pole_sigma=np.maximum(read["pole_x_sigma"], read["pole_y_sigma"]) * ARCSEC,
            measured_until_mjd=float(mjd[measured][-1]),
            leap_seconds=leaps,
        )
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: not in the format finals2000A.all: {error}") from error
    values = table.ut1_minus_tai_s, table.ut1_sigma_s, table.pole_x, table.pole_y, table.pole_sigma
    if not np.all(np.isfinite(values)) or not np.all(np.diff(table.mjd) == 1.0):
        raise ValueError(f"{path}: days or values are missing: download the file again")
    return table


def _final_or_rapid(final: FloatArray, rapid: FloatArray) -> FloatArray:
    """Return the final values of Bulletin B, or the rapid values of Bulletin A where no final value exists."""
    return np.where(np.isnan(final), rapid, final)


def _ns_from_mjd(mjd: float) -> int:
    return (int(mjd) - UNIX_EPOCH_MJD) * DAY_NS

"""A table of the deflection of the vertical along a track: what it says of a place."""

import math

import numpy as np

from ship_attitude_star.vertical.config import GravityConfig
from ship_geometry.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.rotations import ARCSEC, FloatArray


class DeflectionTable:
    """Deflections at the rows of a track, and on the straight lines between successive rows.

    Args:
        config: the rows, and how far the table reaches.
    """

    def __init__(self, config: GravityConfig) -> None:
        self._latitude = np.deg2rad(config.table_latitude_deg)
        self._longitude = np.deg2rad(config.table_longitude_deg)
        self._deflection = ARCSEC * np.column_stack([config.table_xi_arcsec, config.table_eta_arcsec])
        self._reach_m = config.table_reach_m

    def at(self, place: GeodeticPosition) -> FloatArray | None:
        """The deflection (xi, eta) at a place, rad, shape (2,); None where the table does not reach.

        The ship is put on the nearest point of the track. Between two rows the deflection changes evenly.
        """
        starts_m, ways_m = self._lines_from(place)
        lengths_m = np.hypot(*ways_m.T)
        bridged = lengths_m <= self._reach_m
        # Where on each line the foot of the perpendicular lies, or the end next to it.
        along = -np.sum(starts_m * ways_m, axis=1) / np.maximum(lengths_m, 1e-3) ** 2
        share = np.clip(along, 0.0, 1.0)
        away_m = np.hypot(*(starts_m + share[:, None] * ways_m).T)
        away_m[~bridged] = np.inf
        line = int(np.argmin(away_m))
        if not away_m[line] <= self._reach_m:
            return None
        start, end = self._deflection[line], self._deflection[line + 1]
        deflection: FloatArray = (1.0 - share[line]) * start + share[line] * end
        return deflection

    def away_m(self, place: GeodeticPosition) -> float:
        """How far the nearest row of the table is from a place, m."""
        starts_m, ways_m = self._lines_from(place)
        return float(np.hypot(*np.vstack([starts_m, starts_m[-1:] + ways_m[-1:]]).T).min())

    def _lines_from(self, place: GeodeticPosition) -> tuple[FloatArray, FloatArray]:
        """Start of each line as seen from a place, and the way to its end, (North, East), m, shapes (k - 1, 2).

        They are those of the plane that touches the ellipsoid at the place: at 100 km it is 0.1 % off.
        """
        radius_north_m, radius_east_m = horizon_radii_m(place)
        east = np.remainder(self._longitude - place.longitude + math.pi, 2.0 * math.pi) - math.pi
        rows_m = np.column_stack(
            [
                (self._latitude - place.latitude) * radius_north_m,
                east * np.cos(place.latitude) * radius_east_m,
            ]
        )
        return rows_m[:-1], np.diff(rows_m, axis=0)

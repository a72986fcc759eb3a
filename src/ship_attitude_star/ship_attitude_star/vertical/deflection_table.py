"""Table of the deflection of the vertical along a track."""

import math

import numpy as np

from ship_attitude_star.vertical.config import GravityConfig
from ship_geometry.earth.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.rotations import ARCSEC, FloatArray


class DeflectionTable:
    """Deflections near the straight segments between successive rows of a table.

    Segments longer than the reach of the table are not used.

    Args:
        config: rows and reach of the table.
    """

    def __init__(self, config: GravityConfig) -> None:
        self._latitude = np.deg2rad(config.table_latitude_deg)
        self._longitude = np.deg2rad(config.table_longitude_deg)
        self._deflection = ARCSEC * np.column_stack([config.table_xi_arcsec, config.table_eta_arcsec])
        self._reach_m = config.table_reach_m

    def at(self, place: GeodeticPosition) -> FloatArray | None:
        """Return the deflection (xi, eta) at a position, rad, shape (2,); None beyond the reach of the table.

        The deflection is that of the nearest point on the segments, interpolated linearly between two rows.
        """
        starts_m, ways_m = self._segments_from(place)
        lengths_m = np.hypot(*ways_m.T)
        bridged = lengths_m <= self._reach_m
        # Fraction of each segment at the foot of the perpendicular, or at the end next to the foot.
        along = -np.sum(starts_m * ways_m, axis=1) / np.maximum(lengths_m, 1e-3) ** 2
        fraction = np.clip(along, 0.0, 1.0)
        distances_m = np.hypot(*(starts_m + fraction[:, None] * ways_m).T)
        distances_m[~bridged] = np.inf
        line = int(np.argmin(distances_m))
        if not distances_m[line] <= self._reach_m:
            return None
        start, end = self._deflection[line], self._deflection[line + 1]
        deflection: FloatArray = (1.0 - fraction[line]) * start + fraction[line] * end
        return deflection

    def distance_m(self, place: GeodeticPosition) -> float:
        """Return the distance from a position to the nearest row of the table, m."""
        starts_m, ways_m = self._segments_from(place)
        return float(np.hypot(*np.vstack([starts_m, starts_m[-1:] + ways_m[-1:]]).T).min())

    def _segments_from(self, place: GeodeticPosition) -> tuple[FloatArray, FloatArray]:
        """Return start and extent of each segment relative to a position, (North, East), m, shapes (k - 1, 2).

        The vectors are in the tangent plane of the ellipsoid at the position; their error at 100 km is 0.1 %.
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

"""Deflection of the vertical: parameters of its source, uncertainty and correlation length; table along a track."""

import math
from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters.fields import arcsec, parameter
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.earth.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.rotations import ARCSEC, FloatArray

NONE, UNKNOWN, CONSTANT, TABLE, TOPIC = "none", "unknown", "constant", "table", "topic"

_TABLE_COLUMNS = ("table_latitude_deg", "table_longitude_deg", "table_xi_arcsec", "table_eta_arcsec")


def _component_arcsec(doc: str) -> float:
    found: float = parameter(0.0, doc=doc, unit="arcsec", minimum=-300.0, maximum=300.0)
    return found


def _column(doc: str, unit: str, most: float) -> tuple[float, ...]:
    found: tuple[float, ...] = parameter((), doc=doc, unit=unit, minimum=-most, maximum=most)
    return found


@dataclass(frozen=True, kw_only=True)
class GravityConfig:
    """Parameters of the deflection of the vertical, which is part of the tilt of an INS levelled by gravity.

    The deflection is the direction of the astronomical zenith relative to the geodetic zenith, with the components xi
    northward and eta eastward.
    """

    deflection: str = parameter(
        NONE,
        doc="source of the deflection; unknown: estimated by the filter; none: part of the correlated INS error; with "
        "ins.model schuler, none is as unknown, but not published",
        choices=(NONE, UNKNOWN, CONSTANT, TABLE, TOPIC),
    )
    xi_arcsec: float = _component_arcsec("the constant deflection, northward")
    eta_arcsec: float = _component_arcsec("the constant deflection, eastward")
    table_latitude_deg: tuple[float, ...] = _column("latitudes of the table's rows, along the track", "deg", 90.0)
    table_longitude_deg: tuple[float, ...] = _column("longitudes of the table's rows", "deg", 360.0)
    table_xi_arcsec: tuple[float, ...] = _column("deflections of the table's rows, northward", "arcsec", 300.0)
    table_eta_arcsec: tuple[float, ...] = _column("deflections of the table's rows, eastward", "arcsec", 300.0)
    table_reach_m: float = parameter(
        10_000.0,
        doc="the table is used up to this distance from its track; rows further apart are not interpolated",
        unit="m",
        minimum=1.0,
        maximum=1e6,
    )
    sigma_arcsec: float = arcsec(2.0, doc="error of a known deflection (constant, table, topic), each component")
    unknown_sigma_arcsec: float = arcsec(
        20.0, doc="standard deviation of an unknown deflection in the sea area, each component (vertical.md); 0: none"
    )
    correlation_length_m: float = parameter(
        30_000.0,
        doc="correlation length over ground of sigma_arcsec and unknown_sigma_arcsec",
        unit="m",
        minimum=100.0,
        maximum=1e6,
    )
    max_age_s: float = parameter(
        600.0, doc="maximum age of a message on gravity/deflection", unit="s", minimum=1.0, maximum=1e6
    )

    @property
    def is_modelled(self) -> bool:
        """True if the deflection is a state separate from the INS error."""
        return self.deflection != NONE

    def __post_init__(self) -> None:
        """Check parameters that depend on each other.

        Raises:
            ParameterError: the columns of the table differ in length or contain a value that is not finite, a table has
                fewer than two rows, or unknown_sigma_arcsec is 0 although the deflection is a state.
        """
        rows = len(self.table_latitude_deg)
        for name in _TABLE_COLUMNS:
            column = getattr(self, name)
            if len(column) != rows:
                text = f"parameter 'gravity.{name}' has {len(column)} values, table_latitude_deg has {rows}"
                raise ParameterError(f"{text}: give one of each for every row", f"gravity.{name}")
            if not all(math.isfinite(value) for value in column):
                raise ParameterError(f"parameter 'gravity.{name}' has a value that is not finite", f"gravity.{name}")
        if self.deflection == TABLE and rows < 2:
            text = f"parameter 'gravity.table_latitude_deg' has {rows} rows, and gravity.deflection is 'table'"
            raise ParameterError(f"{text}: give two rows or more", "gravity.table_latitude_deg")
        if self.is_modelled and not self.unknown_sigma_arcsec > 0.0:
            name = "gravity.unknown_sigma_arcsec"
            raise ParameterError(f"parameter '{name}' must be more than 0 if the deflection is a state", name)


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

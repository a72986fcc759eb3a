"""Positions on the WGS 84 ellipsoid, their horizons, and the rotation of the horizon with the distance travelled.

ECEF is the Earth-fixed frame of WGS 84 (x to Greenwich on the equator, z to the north pole). The horizon's Up is the
ellipsoid normal. The vertical of a level instrument differs from the normal by the deflection of the vertical.
All functions except :func:`normal_gravity` accept arrays of positions.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_geometry.late_libraries import erfa
from ship_geometry.rotations import FloatArray

_WGS84_A_M, _WGS84_E2 = 6_378_137.0, 6.694379990141e-3
"""Semi-major axis and squared first eccentricity of WGS 84 (NIMA TR8350.2)."""

EARTH_RATE_RAD_PER_S = 7.292115e-5
"""Earth rotation rate relative to the stars, rad/s (WGS 84)."""

_GRAVITY_AT_EQUATOR, _SOMIGLIANA = 9.7803253359, 1.931852652458e-3
"""Normal gravity at the equator, m/s², and the constant of Somigliana's formula (WGS 84)."""


@dataclass(frozen=True)
class GeodeticPosition:
    """A position on WGS 84.

    Attributes:
        latitude: geodetic latitude, north positive, rad, shape (...).
        longitude: longitude, east positive, rad, shape (...).
        height_m: height above the ellipsoid (not above sea level), shape (...).
    """

    latitude: FloatArray | float
    longitude: FloatArray | float
    height_m: FloatArray | float


def ecef_from_geodetic(position: GeodeticPosition) -> FloatArray:
    """Return Earth-fixed coordinates, m, shape (..., 3).

    Example:
        >>> position = GeodeticPosition(latitude=0.0, longitude=np.deg2rad(90.0), height_m=100.0)
        >>> print(ecef_from_geodetic(position).round(3))
        [      0. 6378237.       0.]
    """
    ecef_m: FloatArray = erfa.gd2gc(erfa.WGS84, position.longitude, position.latitude, position.height_m)
    return ecef_m


def geodetic_from_ecef(ecef_m: FloatArray) -> GeodeticPosition:
    """Return the position of Earth-fixed coordinates (m), shape (..., 3); longitude in [-pi, pi].

    Example:
        >>> position = geodetic_from_ecef(np.array([6_378_137.0, 0.0, 0.0]))
        >>> print(position.latitude, position.longitude, round(float(position.height_m), 6))
        0.0 0.0 0.0
    """
    longitude, latitude, height_m = erfa.gc2gd(erfa.WGS84, ecef_m)
    return GeodeticPosition(latitude, longitude, height_m)


def rotation_horizon_from_ecef(latitude: FloatArray | float, longitude: FloatArray | float) -> FloatArray:
    """Return the rotation "horizon (North, Up, East) from ECEF" at a place (rad), shape (..., 3, 3).

    Example:
        At 45° north on the meridian of Greenwich the celestial pole (z) is 45° above the North point:

        >>> pole_n = rotation_horizon_from_ecef(np.deg2rad(45.0), 0.0) @ [0.0, 0.0, 1.0]
        >>> print(pole_n.round(4))  # North, Up, East
        [0.7071 0.7071 0.    ]
    """
    single = isinstance(latitude, float) and isinstance(longitude, float)
    # A live node calls this function for single places, for which arrays would take several times as long.
    sine, cosine = (math.sin, math.cos) if single else (np.sin, np.cos)
    sin_lat, cos_lat, sin_lon, cos_lon = sine(latitude), cosine(latitude), sine(longitude), cosine(longitude)
    north = -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat
    up = cos_lat * cos_lon, cos_lat * sin_lon, sin_lat
    east = -sin_lon, cos_lon, 0.0
    if single:
        return np.array([north, up, east])
    elements = np.broadcast_arrays(*north, *up, *east)
    return np.stack(elements, axis=-1).reshape(*elements[0].shape, 3, 3)


def normal_gravity(latitude: float) -> float:
    """Return gravity on the ellipsoid, m/s² (Somigliana's formula, WGS 84: NGA.STND.0036, 4.1).

    Example:
        >>> print(f"{normal_gravity(0.0):.4f} {normal_gravity(0.5 * math.pi):.4f}")
        9.7803 9.8322
    """
    square = math.sin(latitude) ** 2
    return _GRAVITY_AT_EQUATOR * (1.0 + _SOMIGLIANA * square) / math.sqrt(1.0 - _WGS84_E2 * square)


def horizon_radii_m(position: GeodeticPosition) -> tuple[FloatArray, FloatArray]:
    """Return the radii of curvature in the meridian and in the prime vertical, each plus the height, m.

    A displacement to the north by the first radius, or to the east by the second, rotates the horizon by one radian.

    Example:
        One arcminute to the north and to the east at the equator:

        >>> north_m, east_m = horizon_radii_m(GeodeticPosition(latitude=0.0, longitude=0.0, height_m=0.0))
        >>> print(f"{north_m * np.pi / 180.0 / 60.0:.1f} m, {east_m * np.pi / 180.0 / 60.0:.1f} m")
        1842.9 m, 1855.3 m
    """
    sine = np.sin(position.latitude)
    root = 1.0 - _WGS84_E2 * sine * sine
    north_m = _WGS84_A_M * (1.0 - _WGS84_E2) / (root * np.sqrt(root)) + position.height_m
    return north_m, _WGS84_A_M / np.sqrt(root) + position.height_m

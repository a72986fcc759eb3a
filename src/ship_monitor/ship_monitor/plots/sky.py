"""Directions in the sky over the ship, and their positions on a round map with North up.

Azimuth on the map is clockwise from North, as on a chart: East is to the right. The zenith is the centre and the
horizon the rim; the radius is linear in elevation.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import erfa
import numpy as np

from ship_geometry.earth.earth_orientation import OutsideEarthOrientation, earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.earth.star_directions import RefreshedSky
from ship_geometry.earth.time_scales import tt_julian_date
from ship_geometry.frames import rotation_from_angles
from ship_watch.history.history import ParameterEstimate
from ship_watch.suite_state import AngleState

_AU_M = 149_597_870_700.0


@lru_cache(maxsize=1)
def _rotating_sky() -> RefreshedSky:
    return RefreshedSky(earth_orientation_table())


def map_position(azimuth: float, elevation: float) -> tuple[float, float]:
    """Return the position on the map, East and North, with the horizon at radius 1; larger radii are below the horizon.

    Args:
        azimuth: azimuth from North to East, rad.
        elevation: elevation, rad.

    Example:
        >>> east, north = map_position(np.deg2rad(90.0), np.deg2rad(45.0))
        >>> print(round(east, 3), round(north, 3))
        0.5 0.0
    """
    radius = 1.0 - elevation / (0.5 * math.pi)
    return radius * math.sin(azimuth), radius * math.cos(azimuth)


def boresight(name: str, alignment: Sequence[ParameterEstimate], angles: Sequence[AngleState]) -> tuple[float, float]:
    """Return azimuth and elevation of a star sensor's boresight, rad, from its installation and the attitude.

    The map uses this direction for sensors that publish attitudes without stars. The result is NaN if an angle is
    unknown.

    Args:
        name: name of the source, "star.<id>".
        alignment: states with the installation angles.
        angles: angles with heading, pitch and roll.
    """
    installed = {state.name: state.value for state in alignment}
    values = {angle.name: angle.value for angle in angles}
    azimuth, elevation = (installed.get(f"{name}.{angle}", math.nan) for angle in ("azimuth", "elevation"))
    deck = [values.get(angle, math.nan) for angle in ("heading", "pitch", "roll")]
    if not np.isfinite([azimuth, elevation, *deck]).all():
        return math.nan, math.nan
    # The installation's azimuth is from the bow to starboard, like an azimuth on a level deck that heads North.
    forward_d = rotation_from_angles(np.asarray(azimuth), np.asarray(elevation), np.asarray(0.0))[:, 0]
    north, up, east = rotation_from_angles(*map(np.asarray, deck)) @ forward_d
    return math.atan2(east, north) % (2.0 * math.pi), math.atan2(up, math.hypot(north, east))


def moon_direction(utc_ns: int, latitude: float, longitude: float) -> tuple[float, float] | None:
    """Return azimuth and elevation of the Moon, rad, without refraction, for an observer at sea level.

    The series of Meeus (ERFA ``moon98``) is accurate to about 10″. The parallax due to the ship's position, up to a
    degree, is included.

    Args:
        utc_ns: UTC as POSIX time, ns.
        latitude: geodetic latitude, rad.
        longitude: longitude, rad.

    Returns:
        Azimuth and elevation; None if the Earth's orientation is unknown for that time.
    """
    place = GeodeticPosition(latitude, longitude, height_m=0.0)
    try:
        rotation_nc = _rotating_sky().rotation_horizon_from_icrs(utc_ns, place)
    except OutsideEarthOrientation:
        return None
    moon_c_m = _AU_M * erfa.moon98(*tt_julian_date(utc_ns))["p"]
    ship_n_m = rotation_horizon_from_ecef(latitude, longitude) @ ecef_from_geodetic(place)
    north, up, east = rotation_nc @ moon_c_m - ship_n_m
    return math.atan2(east, north) % (2.0 * math.pi), math.atan2(up, np.hypot(north, east))

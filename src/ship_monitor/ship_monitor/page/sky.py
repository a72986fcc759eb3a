"""Where things stand in the sky over the ship, and where that is on a round map with North up.

The map shows the sky as a chart shows the sea: azimuth clockwise from North, so that East is to the right; the zenith
is in the middle, the horizon its rim, elevation even in between.
"""

import math
from functools import lru_cache

import erfa
import numpy as np

from ship_geometry.earth_orientation import OutsideEarthOrientation, earth_orientation_table
from ship_geometry.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.star_directions import RefreshedSky
from ship_geometry.time_scales import tt_julian_date

_AU_M = 149_597_870_700.0


@lru_cache(maxsize=1)
def _rotating_sky() -> RefreshedSky:
    return RefreshedSky(earth_orientation_table())


def on_map(azimuth: float, elevation: float) -> tuple[float, float]:
    """Place on the map, East and North, the horizon at 1; beyond it what is below the horizon.

    Example:
        >>> east, north = on_map(np.deg2rad(90.0), np.deg2rad(45.0))
        >>> print(round(east, 3), round(north, 3))
        0.5 0.0
    """
    radius = 1.0 - elevation / (0.5 * math.pi)
    return radius * math.sin(azimuth), radius * math.cos(azimuth)


def moon_direction(utc_ns: int, latitude: float, longitude: float) -> tuple[float, float] | None:
    """Azimuth and elevation of the Moon from a place at sea, rad, without refraction.

    The series of Meeus, as ERFA has them, is good to some 10″. The Moon is so near that the ship's place on the Earth
    matters by up to a degree.

    Args:
        utc_ns: UTC as POSIX time.
        latitude: geodetic, rad.
        longitude: rad.

    Returns:
        None where the orientation of the Earth is not known for that time.
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

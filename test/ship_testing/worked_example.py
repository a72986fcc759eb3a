"""[P15]'s worked example: beta Lyrae from a ship at 32° N, 120° E, and the reduction with steps omitted."""

from dataclasses import replace

import erfa
import numpy as np

from ship_geometry.air.refraction import Weather, elevation_of
from ship_geometry.earth.earth_orientation import EarthOrientation, earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import Observer, StarPositions, stars_from_epoch
from ship_geometry.earth.time_scales import julian_date, tt_julian_date
from ship_geometry.rotations import ARCSEC, FloatArray

TABLE = earth_orientation_table()
TIME_NS = 1_404_906_607_800_000_000  # 2014-07-09 11:50:07.8 UTC
SHIP = Observer(GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), 0.0))
WEATHER = Weather(pressure_hpa=1008.3, temperature_c=28.2)
MAS = 1e-3 * ARCSEC
# HIP 92420 in hip2.dat, epoch 1991.25: position, proper motion (right ascension with cos δ), parallax.
STAR = stars_from_epoch(
    StarPositions(4.9309037606, 0.5822885787, 1.90 * MAS / np.cos(0.5822885787), -3.53 * MAS, 0.00339),
    1991.25,
)
ORIENTATION = TABLE.at(TIME_NS)
UT1_TAKEN_AS_UTC = replace(ORIENTATION, ut1_minus_utc_s=np.float64(0.0))


def angles_deg(direction_n: FloatArray) -> FloatArray:
    """Return azimuth and elevation of a direction."""
    return np.rad2deg([np.arctan2(direction_n[2], direction_n[0]), elevation_of(direction_n)])


def shift_arcsec(first_n: FloatArray, second_n: FloatArray) -> FloatArray:
    """Return the second direction minus the first: azimuth times cos E, and elevation."""
    (azimuth, elevation), (azimuth_2, elevation_2) = angles_deg(first_n), angles_deg(second_n)
    return 3600.0 * np.array([(azimuth_2 - azimuth) * np.cos(np.deg2rad(elevation)), elevation_2 - elevation])


def without_aberration(orientation: EarthOrientation, diurnal: bool) -> FloatArray:
    """Return the star's direction without annual aberration, and without diurnal aberration if ``diurnal`` is False."""
    tt, site = tt_julian_date(TIME_NS), SHIP.position
    sky = erfa.apci13(*tt)[0].copy()
    sky["v"], sky["bm1"] = 0.0, 1.0
    ground = erfa.apio(
        erfa.sp00(*tt),
        erfa.era00(*julian_date(TIME_NS, orientation.ut1_minus_utc_s)),
        site.longitude,
        site.latitude,
        site.height_m,
        orientation.pole_x,
        orientation.pole_y,
        0.0,
        0.0,
    ).copy()
    if not diurnal:
        ground["diurab"] = 0.0
    place = (STAR.right_ascension, STAR.declination, STAR.pm_right_ascension, STAR.pm_declination)
    azimuth, zenith_distance, *_ = erfa.atioq(*erfa.atciq(*place, STAR.parallax_arcsec, 0.0, sky), ground)
    sine = np.sin(zenith_distance)
    return np.array([np.cos(azimuth) * sine, np.cos(zenith_distance), np.sin(azimuth) * sine])

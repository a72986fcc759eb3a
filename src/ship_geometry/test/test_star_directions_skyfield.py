"""Star directions against Skyfield with the JPL ephemeris de421; Skyfield shares no code with ERFA."""

from pathlib import Path

import erfa
import numpy as np
import pytest
import skyfield_data
from skyfield.api import Loader, Star, wgs84

from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import Observer, StarPositions, directions
from ship_geometry.earth.time_scales import TT_MINUS_TAI_S, tt_julian_date
from ship_geometry.rotations import ARCSEC, angle_between

TABLE = earth_orientation_table()
YEAR_1995_NS, YEAR_2025_NS = 788_918_400_000_000_000, 1_735_689_600_000_000_000


@pytest.fixture(scope="module")
def loader():
    return Loader(Path(skyfield_data.__file__).parent / "data", verbose=False)


@pytest.fixture(scope="module")
def earth(loader):
    ephemeris = loader("de421.bsp")
    yield ephemeris["earth"]
    ephemeris.close()


def by_skyfield(loader, earth, stars, time_ns, site, orientation):
    """Return directions (North, Up, East), for the suite's UT1 and polar motion."""
    tt = tt_julian_date(time_ns)
    delta_t_s = TT_MINUS_TAI_S + TABLE.leap_seconds.at(time_ns) - orientation.ut1_minus_utc_s
    timescale = loader.timescale(delta_t=float(delta_t_s))
    pole_arcsec = [np.array([value / ARCSEC]) for value in (orientation.pole_x, orientation.pole_y)]
    timescale.polar_motion_table = (np.array([tt[0] + tt[1]]), *pole_arcsec)
    star = Star(
        ra_hours=np.rad2deg(stars.right_ascension) / 15.0,
        dec_degrees=np.rad2deg(stars.declination),
        ra_mas_per_year=stars.pm_right_ascension * np.cos(stars.declination) / ARCSEC * 1e3,
        dec_mas_per_year=stars.pm_declination / ARCSEC * 1e3,
        parallax_mas=stars.parallax_arcsec * 1e3,
    )
    place = wgs84.latlon(np.rad2deg(site.latitude), np.rad2deg(site.longitude), elevation_m=site.height_m)
    elevation, azimuth, _ = (earth + place).at(timescale.tt_jd(*tt)).observe(star).apparent().altaz()
    e, a = elevation.radians, azimuth.radians
    return np.stack([np.cos(a) * np.cos(e), np.sin(e), np.sin(a) * np.cos(e)], axis=-1)


@pytest.mark.parametrize("seed", range(8))
def test_skyfield_sees_the_same_stars(loader, earth, seed):
    rng = np.random.default_rng(seed)
    declination = np.arcsin(rng.uniform(-1.0, 1.0, 200))
    stars = StarPositions(
        right_ascension=rng.uniform(0.0, 2.0 * np.pi, 200),
        declination=declination,
        pm_right_ascension=rng.normal(0.0, 0.1, 200) * ARCSEC / np.cos(declination),
        pm_declination=rng.normal(0.0, 0.1, 200) * ARCSEC,
        parallax_arcsec=rng.uniform(0.0, 0.1, 200),
    )
    time_ns = int(rng.integers(YEAR_1995_NS, YEAR_2025_NS))
    site = GeodeticPosition(float(rng.uniform(-1.4, 1.4)), float(rng.uniform(-np.pi, np.pi)), 20.0)
    orientation = TABLE.at(time_ns)
    ours = directions(stars, time_ns, Observer(site), orientation)
    theirs = by_skyfield(loader, earth, stars, time_ns, site, orientation)
    heliocentric, _ = erfa.epv00(*tt_julian_date(time_ns))
    away = angle_between(erfa.s2c(stars.right_ascension, stars.declination), -heliocentric["p"]) > np.deg2rad(5.0)
    # 0.4 mas of the difference is the deflection by the Earth's mass, which only Skyfield includes.
    assert np.max(angle_between(ours, theirs)[away]) < 1e-3 * ARCSEC
    assert np.count_nonzero(away & (ours[:, 1] > 0.0)) > 50

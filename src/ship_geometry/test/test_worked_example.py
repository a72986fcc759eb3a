"""[P15]'s worked example, step by step with the numbers of models.md §2: beta Lyrae from a ship at 32° N, 120° E."""

from dataclasses import replace

import erfa
import numpy as np
import pytest

from ship_geometry.earth_orientation import earth_orientation_table
from ship_geometry.geodetic import GeodeticPosition
from ship_geometry.refraction import Weather, elevation_of, lifted, refraction
from ship_geometry.rotations import ARCSEC
from ship_geometry.star_directions import Observer, RefreshedSky, StarPositions, directions, stars_from_epoch
from ship_geometry.time_scales import julian_date, tt_julian_date

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


def angles_deg(direction_n):
    return np.rad2deg([np.arctan2(direction_n[2], direction_n[0]), elevation_of(direction_n)])


def shift_arcsec(first_n, second_n):
    """From the first direction to the second: azimuth times cos E, and elevation."""
    (azimuth, elevation), (azimuth_2, elevation_2) = angles_deg(first_n), angles_deg(second_n)
    return 3600.0 * np.array([(azimuth_2 - azimuth) * np.cos(np.deg2rad(elevation)), elevation_2 - elevation])


def without_aberration(orientation, diurnal):
    """The chain with the annual aberration left out, and the diurnal one too unless it is asked for."""
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


def test_the_papers_own_result_lacks_aberration_and_ut1():
    # [P15] prints A 71.9528°, E 42.2207°; within 0.01" cos E and 2.8" (models.md §2).
    azimuth_deg, elevation_deg = angles_deg(without_aberration(UT1_TAKEN_AS_UTC, diurnal=False))
    assert (azimuth_deg - 71.9528) * 3600.0 == pytest.approx(0.0, abs=0.02)
    assert (elevation_deg - 42.2207) * 3600.0 == pytest.approx(-2.8, abs=0.05)
    printed = [0.229426, 0.671988, 0.704128]
    assert without_aberration(UT1_TAKEN_AS_UTC, diurnal=False) == pytest.approx(printed, abs=1.5e-5)


def test_annual_aberration():
    with_it = directions(STAR, TIME_NS, SHIP, UT1_TAKEN_AS_UTC)
    shift = shift_arcsec(without_aberration(UT1_TAKEN_AS_UTC, diurnal=True), with_it)
    assert shift == pytest.approx([-7.7, -18.6], abs=0.05)


def test_true_ut1():
    first, second = (directions(STAR, TIME_NS, SHIP, o) for o in (UT1_TAKEN_AS_UTC, ORIENTATION))
    assert shift_arcsec(first, second) == pytest.approx([-1.0, -3.7], abs=0.05)
    assert ORIENTATION.ut1_minus_utc_s == pytest.approx(-0.3055, abs=5e-5)


@pytest.mark.parametrize(
    "direction_n",
    [directions(STAR, TIME_NS, SHIP, ORIENTATION), RefreshedSky(TABLE).directions(STAR, TIME_NS, SHIP)],
    ids=["exact", "refreshed"],
)
def test_final_direction_without_refraction(direction_n):
    assert angles_deg(direction_n) == pytest.approx([71.949575, 42.213678], abs=5e-7)


def test_refraction_raises_it():
    direction_n = directions(STAR, TIME_NS, SHIP, ORIENTATION)
    for model, angle_arcsec in (("almanac", 59.344), ("erfa", 59.74)):
        angle = refraction(model, elevation_of(direction_n), WEATHER).angle
        # The figures are for E = 42.2207°, 25" higher: 0.014" more refraction here.
        assert angle / ARCSEC == pytest.approx(angle_arcsec + 0.014, abs=0.005)
        assert shift_arcsec(direction_n, lifted(direction_n, angle)) == pytest.approx([0.0, angle / ARCSEC], abs=1e-6)

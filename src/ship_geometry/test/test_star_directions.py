"""Star directions against ERFA's atco13, and the effect of each pitfall of models.md §2."""

from dataclasses import replace
from datetime import datetime, timezone

import erfa
import numpy as np
import pytest

from ship_geometry.earth.earth_orientation import OutsideEarthOrientation, earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import (
    REFRESH_PERIOD_NS,
    Observer,
    RefreshedSky,
    StarPositions,
    directions,
    fixed_stars,
    stars_from_epoch,
)
from ship_geometry.earth.time_scales import DAY_NS, SECOND_NS, tt_julian_date
from ship_geometry.rotations import ARCSEC, angle_between

MAS = 1e-3 * ARCSEC
TABLE = earth_orientation_table()
TIME_NS = int(datetime(2024, 3, 10, 21, 4, 5, tzinfo=timezone.utc).timestamp()) * SECOND_NS + 678_900_000


def random_sky(seed, count):
    """Return stars with motions and parallaxes, times from 1992 to 2026, and sites: one of each per row."""
    rng = np.random.default_rng(seed)
    declination = np.arcsin(rng.uniform(-1.0, 1.0, count))
    stars = StarPositions(
        right_ascension=rng.uniform(0.0, 2.0 * np.pi, count),
        declination=declination,
        pm_right_ascension=rng.normal(0.0, 0.1, count) * ARCSEC / np.cos(declination),
        pm_declination=rng.normal(0.0, 0.1, count) * ARCSEC,
        parallax_arcsec=rng.uniform(0.0, 0.1, count),
    )
    first, last = (int(datetime(year, 1, 1, tzinfo=timezone.utc).timestamp()) for year in (1992, 2026))
    times_ns = rng.integers(first * SECOND_NS, last * SECOND_NS, count)
    position = GeodeticPosition(
        latitude=np.arcsin(rng.uniform(-1.0, 1.0, count)),
        longitude=rng.uniform(-np.pi, np.pi, count),
        height_m=rng.uniform(-50.0, 100.0, count),
    )
    return stars, times_ns, Observer(position)


def by_atco13(stars, times_ns, observer, orientation):
    """Return the directions by ERFA's atco13, from UTC; without air (pressure zero)."""
    days, rest_ns = np.divmod(times_ns, DAY_NS)
    minutes, within_ns = np.divmod(rest_ns, 60 * SECOND_NS)
    # From calendar dates, because ERFA stretches the day of a leap second.
    utc = erfa.dtf2d("UTC", *erfa.jd2cal(2_440_587.5 + days, 0.0)[:3], *np.divmod(minutes, 60), within_ns / SECOND_NS)
    azimuth, zenith_distance, *_ = erfa.atco13(
        stars.right_ascension,
        stars.declination,
        stars.pm_right_ascension,
        stars.pm_declination,
        stars.parallax_arcsec,
        0.0,
        *utc,
        orientation.ut1_minus_utc_s,
        observer.position.longitude,
        observer.position.latitude,
        observer.position.height_m,
        orientation.pole_x,
        orientation.pole_y,
        0.0,
        0.0,
        0.0,
        0.55,
    )
    sine = np.sin(zenith_distance)
    return np.stack([np.cos(azimuth) * sine, np.cos(zenith_distance), np.sin(azimuth) * sine], axis=-1)


def row(observer, index):
    position = observer.position
    return Observer(GeodeticPosition(position.latitude[index], position.longitude[index], position.height_m[index]))


def test_exact_directions_are_those_of_atco13():
    stars, times_ns, observer = random_sky(4, 1000)
    orientation = TABLE.at(times_ns)
    ours = directions(stars, times_ns, observer, orientation)
    assert np.linalg.norm(ours, axis=-1) == pytest.approx(np.ones(1000), abs=1e-15)
    difference = angle_between(ours, by_atco13(stars, times_ns, observer, orientation))
    assert np.max(difference) < 0.1 * MAS


def test_refreshed_directions_are_those_of_atco13_away_from_the_sun():
    stars, times_ns, observer = random_sky(5, 1000)
    sky = RefreshedSky(TABLE)
    ours = np.array([sky.directions(stars[i], int(t), row(observer, i)) for i, t in enumerate(times_ns)])
    theirs = by_atco13(stars, times_ns, observer, TABLE.at(times_ns))
    sun = -erfa.epv00(*tt_julian_date(times_ns))[0]["p"]
    away = angle_between(erfa.s2c(stars.right_ascension, stars.declination), sun) > np.deg2rad(5.0)
    assert np.count_nonzero(away) > 950
    assert np.max(angle_between(ours, theirs)[away]) < 0.1 * MAS


def test_refreshed_directions_keep_up_with_time_and_ship():
    # Twelve seconds at 20 Hz over a refresh, at 15 m/s to the north-east.
    stars, _, _ = random_sky(6, 8)
    sky = RefreshedSky(TABLE)
    for step in range(0, 240, 7):
        time_ns = TIME_NS + step * SECOND_NS // 20
        moved = step * 0.05 * 15.0 / 6.4e6
        ship = Observer(GeodeticPosition(0.6 + moved, 2.0 + moved, 20.0), np.array([15.0, 0.0, 15.0]))
        exact = directions(stars, time_ns, ship, TABLE.at(time_ns))
        assert np.max(angle_between(sky.directions(stars, time_ns, ship), exact)) < 0.1 * MAS


def test_result_does_not_depend_on_earlier_calls():
    stars, _, _ = random_sky(7, 5)
    ship = Observer(GeodeticPosition(0.5, 1.0, 0.0))
    times_ns = [TIME_NS + k * REFRESH_PERIOD_NS // 3 for k in range(40)]
    forward, backward = RefreshedSky(TABLE), RefreshedSky(TABLE)
    in_order = [forward.directions(stars, t, ship) for t in times_ns]
    reversed_order = [backward.directions(stars, t, ship) for t in times_ns[::-1]][::-1]
    assert np.array_equal(in_order, reversed_order)


def test_a_ship_that_moves_150_m_moves_the_sky():
    # models.md §2: a result of apco13 that only aper13 refreshes omits the motion. Further north the horizon is rotated
    # about East.
    star, north_m = fixed_stars(1.0, 0.5), 150.0
    sky = RefreshedSky(TABLE)
    turn = north_m / 6.37e6
    here, there = (
        sky.directions(star, TIME_NS, Observer(GeodeticPosition(latitude, 2.0, 0.0))) for latitude in (0.6, 0.6 + turn)
    )
    assert angle_between(here, there) == pytest.approx(turn * np.hypot(here[0], here[1]), rel=1e-3)
    assert angle_between(here, there) > 3.0 * ARCSEC


def test_one_second_of_ut1_is_fifteen_arcseconds():
    orientation = TABLE.at(TIME_NS)
    later = replace(orientation, ut1_minus_utc_s=orientation.ut1_minus_utc_s + 1.0)
    star, ship = fixed_stars(1.0, 0.0), Observer(GeodeticPosition(0.6, 2.0, 0.0))
    turn = angle_between(directions(star, TIME_NS, ship, orientation), directions(star, TIME_NS, ship, later))
    assert turn / ARCSEC == pytest.approx(15.041, abs=0.002)


def test_own_velocity_is_10_mas_at_15_metres_per_second():
    # Aberration: a star at a right angle to the velocity moves by v/c along the velocity; a star ahead does not move.
    stars, _, _ = random_sky(8, 50)
    still = Observer(GeodeticPosition(0.6, 2.0, 0.0))
    under_way = replace(still, velocity_n_m_per_s=np.array([9.0, 0.0, 12.0]))
    orientation, heading_n = TABLE.at(TIME_NS), np.array([0.6, 0.0, 0.8])
    before, after = (directions(stars, TIME_NS, ship, orientation) for ship in (still, under_way))
    sine = np.sqrt(1.0 - (before @ heading_n) ** 2)
    assert angle_between(before, after) == pytest.approx(sine * 15.0 / 299_792_458.0, abs=1e-6 * ARCSEC)
    assert np.max(angle_between(before, after)) / MAS == pytest.approx(10.3, abs=0.1)
    assert np.all((after - before) @ heading_n > 0.0)
    refreshed = RefreshedSky(TABLE).directions(stars, TIME_NS, under_way)
    assert np.max(angle_between(refreshed, after)) < 0.1 * MAS


def test_many_times_against_many_stars():
    stars, times_ns, _ = random_sky(9, 6)
    ship = Observer(GeodeticPosition(0.6, 2.0, 0.0))
    grid = directions(stars, times_ns[:4, None], ship, TABLE.at(times_ns[:4, None]))
    assert grid.shape == (4, 6, 3)
    alone = directions(stars[2], int(times_ns[1]), ship, TABLE.at(int(times_ns[1])))
    assert grid[1, 2] == pytest.approx(alone, abs=1e-15)


def test_position_is_brought_from_1991_to_2000_along_a_great_circle():
    # Groombridge 1830 (HIP 57939), 7.06"/year; hip2.dat: position, parallax and motion (with cos δ) at 1991.25.
    alpha, delta = 3.1107451467, 0.6585617448
    motion = np.array([4003.98, -5813.62]) * MAS
    at_epoch = StarPositions(alpha, delta, motion[0] / np.cos(delta), motion[1], 0.10999)
    at_2000 = stars_from_epoch(at_epoch, 1991.25)
    start, end = erfa.s2c(alpha, delta), erfa.s2c(at_2000.right_ascension, at_2000.declination)
    north = np.array([-np.sin(delta) * np.cos(alpha), -np.sin(delta) * np.sin(alpha), np.cos(delta)])
    east = np.array([-np.sin(alpha), np.cos(alpha), 0.0])
    straight = start + 8.75 * (motion[0] * east + motion[1] * north)
    assert angle_between(end, straight) < 1e-4 * MAS
    # The error is 62" if the epoch is ignored, and 7" if the tabulated motion is taken for dα/dt.
    assert angle_between(end, start) / ARCSEC == pytest.approx(61.77, abs=0.05)
    wrong = stars_from_epoch(replace(at_epoch, pm_right_ascension=motion[0]), 1991.25)
    assert angle_between(erfa.s2c(wrong.right_ascension, wrong.declination), end) / ARCSEC > 5.0


def test_proper_motion_and_parallax_reach_the_direction():
    # Proper motion and parallax are the part that atciqz omits.
    orientation, ship = TABLE.at(TIME_NS), Observer(GeodeticPosition(0.6, 2.0, 0.0))
    still = fixed_stars(1.0, 0.5)
    moving = replace(still, pm_declination=np.array(0.1 * ARCSEC))
    near = replace(still, parallax_arcsec=np.array(0.7))
    places = [directions(star, TIME_NS, ship, orientation) for star in (still, moving, near)]
    assert angle_between(places[0], places[1]) / ARCSEC == pytest.approx(0.1 * 24.19, abs=1e-3)
    earth = erfa.epv00(*tt_julian_date(TIME_NS))[1]["p"]
    across = np.linalg.norm(np.cross(earth, erfa.s2c(1.0, 0.5)))
    assert angle_between(places[0], places[2]) / ARCSEC == pytest.approx(0.7 * across, abs=1e-3)


def test_negative_parallax_is_none():
    star = replace(fixed_stars(np.array([1.0, 1.0]), np.array([0.5, 0.5])), parallax_arcsec=np.array([-0.002, 0.0]))
    found = stars_from_epoch(star, 1991.25)
    assert found.parallax_arcsec.tolist() == [0.0, 0.0]
    assert found.right_ascension[0] == found.right_ascension[1]


def test_refreshed_sky_raises_beyond_the_table():
    star, ship = fixed_stars(1.0, 0.5), Observer(GeodeticPosition(0.6, 2.0, 0.0))
    with pytest.raises(OutsideEarthOrientation, match="newer astropy-iers-data"):
        RefreshedSky(TABLE).directions(star, TABLE.last_ns + DAY_NS, ship)
    assert RefreshedSky(TABLE).orientation(TIME_NS).ut1_sigma_s < 1e-4

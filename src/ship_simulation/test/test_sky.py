"""The sky over the simulated ship: comparison with independent algorithms, and the drawn errors."""

import dataclasses
from pathlib import Path

import erfa
import numpy as np
import pytest
import skyfield_data
from skyfield.api import Loader, wgs84

from ship_geometry.air.refraction import elevation_of
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import Observer, directions, fixed_stars
from ship_geometry.earth.time_scales import SECOND_NS, julian_date, tt_julian_date
from ship_geometry.rotations import ARCSEC, angle_between, log_rotation
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import start_time_ns
from ship_simulation.ship.ship_track import ShipTrack
from ship_simulation.stars.sky import draw_sky, position_of_date
from ship_testing.consistency import sigma_ratio_band
from ship_testing.horizon_vectors import vector_between
from ship_testing.paper_stars import paper_stars, with_position

MAS = 1e-3 * ARCSEC
START_NS = start_time_ns("2014-07-09T11:50:07.8Z")


def draw(seed, **changes):
    scenario = paper_stars(**changes)
    return draw_sky(scenario, ShipTrack(scenario.position, START_NS), seed)


def observer_of(sky):
    return Observer(sky.track.position_at(np.array(START_NS)))


def assert_sigma(values, sigma):
    """Check that the RMS of independent values matches a sigma, within the chi² band of 99.9 %."""
    low, high = sigma_ratio_band(np.size(values))
    assert low < np.sqrt(np.mean(np.square(values))) / sigma < high


def by_atco13(sky, rows, time_ns):
    """Return observed directions (N, U, E) by ERFA's single function for all effects, its refraction included."""
    stars, orientation, place = sky.positions[rows], sky.orientation(time_ns), sky.track.position_at(time_ns)
    azimuth, zenith_distance, *_ = erfa.atco13(
        stars.right_ascension,
        stars.declination,
        stars.pm_right_ascension,
        stars.pm_declination,
        stars.parallax_arcsec,
        0.0,
        *julian_date(time_ns),
        orientation.ut1_minus_utc_s,
        place.longitude,
        place.latitude,
        place.height_m,
        orientation.pole_x,
        orientation.pole_y,
        sky.weather.pressure_hpa,
        sky.weather.temperature_c,
        sky.weather.relative_humidity,
        0.55,
    )
    sine = np.sin(zenith_distance)
    return np.stack([np.cos(azimuth) * sine, np.cos(zenith_distance), np.sin(azimuth) * sine], axis=-1)


def test_directions_with_air_are_those_of_atco13():
    # UT1 and the air are drawn far from their known values: the sky must use the drawn ones.
    weather = dataclasses.replace(paper_stars().weather, pressure_sigma_hpa=30.0, temperature_sigma_k=10.0)
    sky = draw(1, earth_rotation_sigma_s=1.0, weather=weather)
    assert abs(sky.ut1_error_s) > 0.1
    rows = sky.catalogue.rows_brighter_than(4.0)
    time_ns = np.array([START_NS, START_NS + 3600 * SECOND_NS])
    ours = sky.directions(sky.positions[rows], time_ns[:, None])
    for stamp_ns, direction_n in zip(time_ns, ours, strict=True):
        high = elevation_of(direction_n) > np.deg2rad(15.0)
        assert np.count_nonzero(high) > 100
        difference = angle_between(direction_n[high], by_atco13(sky, rows[high], stamp_ns))
        # atco13 evaluates the refraction from ERFA's two constants by another formula: 0.03 mas at 15°.
        assert np.max(difference) < 0.1 * MAS


def test_a_moving_ship_has_its_position_and_aberration():
    scenario = with_position(paper_stars(), speed_m_per_s=15.0, course_deg=60.0)
    sky = draw_sky(scenario, ShipTrack(scenario.position, START_NS), seed=1)
    rows = sky.catalogue.rows_brighter_than(4.0)
    later_ns = START_NS + 600 * SECOND_NS
    ours = sky.directions(sky.positions[rows], np.array(later_ns))
    high = elevation_of(ours) > np.deg2rad(15.0)
    ours, at_rest = ours[high], by_atco13(sky, rows[high], later_ns)
    # Aberration by the ship: 15 m/s against 299 792 458 m/s, towards 60°.
    velocity = 15.0 / 299_792_458.0 * np.array([0.5, 0.0, np.sqrt(0.75)])
    towards = velocity - at_rest * (at_rest @ velocity)[:, None]
    np.testing.assert_allclose(ours - at_rest, towards, rtol=0.0, atol=0.2 * MAS)
    # The position moves with the velocity: 9 km in ten minutes, by the chord on the ellipsoid.
    start, end = (sky.track.position_at(np.array(time_ns)) for time_ns in (START_NS, later_ns))
    way_m = vector_between(start, end)
    assert way_m[[0, 2]] == pytest.approx([4500.0, 4500.0 * np.sqrt(3.0)], rel=1e-3)


def test_the_almanacs_refraction_is_another():
    weather = dataclasses.replace(paper_stars().weather, refraction_model="almanac")
    erfas, almanacs = draw(1), draw(1, weather=weather)
    rows = erfas.catalogue.rows_brighter_than(2.0)
    ours, theirs = (sky.directions(sky.positions[rows], np.array(START_NS)) for sky in (erfas, almanacs))
    elevation = elevation_of(ours)
    # models.md §2: the two models differ by 0.4″ at 42°; the almanac gives none below 14°, ERFA none below 5°.
    middle = (elevation > np.deg2rad(30.0)) & (elevation < np.deg2rad(60.0))
    difference = angle_between(ours, theirs)[middle] / ARCSEC
    assert np.all((difference > 0.1) & (difference < 1.0))
    assert np.isnan(theirs[:, 0]).sum() > np.isnan(ours[:, 0]).sum() > 0


def test_the_horizon_rotation_equals_that_of_erfas_cirs_chain():
    """ERFA's ICRS → CIRS → observed, without aberration and deflection, must equal ``rotation_horizon_from_icrs``."""
    sky = draw(2)
    time_ns = np.array(START_NS + 1234 * SECOND_NS)
    place, orientation = sky.track.position_at(time_ns), sky.orientation(time_ns)
    stars = fixed_stars(*np.random.default_rng(1).uniform([0.0, -1.5], [6.2, 1.5], (50, 2)).T)
    astrom = erfa.apco(
        *tt_julian_date(time_ns),
        # The Earth at rest, far from the Sun: only the axes remain.
        np.zeros((), dtype=erfa.dt_pv),
        np.array([1e12, 0.0, 0.0]),
        *erfa.xys06a(*tt_julian_date(time_ns)),
        erfa.era00(*julian_date(time_ns, orientation.ut1_minus_utc_s)),
        place.longitude,
        place.latitude,
        place.height_m,
        orientation.pole_x,
        orientation.pole_y,
        erfa.sp00(*tt_julian_date(time_ns)),
        0.0,
        0.0,
    )
    astrom["v"], astrom["bm1"], astrom["diurab"] = 0.0, 1.0, 0.0
    cirs = erfa.atciqz(stars.right_ascension, stars.declination, astrom)
    azimuth, zenith_distance, *_ = erfa.atioq(*cirs, astrom)
    sine = np.sin(zenith_distance)
    expected = np.stack([np.cos(azimuth) * sine, np.cos(zenith_distance), np.sin(azimuth) * sine], axis=-1)
    ours = erfa.s2c(stars.right_ascension, stars.declination) @ sky.rotation_horizon_from_icrs(time_ns).T
    assert np.max(angle_between(ours, expected)) < 0.01 * MAS


def test_the_refraction_rotation_is_about_the_horizontal():
    sky = draw(1)
    rows = sky.catalogue.rows_brighter_than(3.0)
    stars = sky.positions[rows]
    seen = sky.directions(stars, np.array(START_NS))
    without_air = directions(stars, np.array(START_NS), observer_of(sky), sky.orientation(np.array(START_NS)))
    visible = np.isfinite(seen[:, 0])
    lifted = (sky.refraction_rotation(seen[visible]) @ without_air[visible][..., None])[..., 0]
    assert np.max(angle_between(lifted, seen[visible])) < 0.01 * MAS
    # The rotation axis is horizontal and perpendicular to the line of sight.
    turns_n = log_rotation(sky.refraction_rotation(seen[visible]))
    np.testing.assert_allclose(turns_n[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(turns_n * seen[visible], axis=1), 0.0, atol=1e-12)
    assert np.isnan(sky.refraction_rotation(np.array([1.0, 0.01, 0.0]))).all()


def test_the_sun_is_where_skyfield_sees_it():
    sky = draw(1)
    loader = Loader(Path(skyfield_data.__file__).parent / "data", verbose=False)
    ephemeris, timescale = loader("de421.bsp"), loader.timescale(builtin=True)
    place = wgs84.latlon(31.945213, 120.293086, elevation_m=20.0)
    hours = np.arange(0.0, 24.0, 0.7)
    time_ns = START_NS + np.rint(hours * 3600 * SECOND_NS).astype(np.int64)
    times = timescale.tt_jd(*tt_julian_date(time_ns))
    elevation, _, _ = (ephemeris["earth"] + place).at(times).observe(ephemeris["sun"]).apparent().altaz()
    # Aberration (20″) and parallax (9″) of the Sun are neglected, and the interpolation between minutes is linear.
    np.testing.assert_allclose(np.rad2deg(sky.sun_elevation(time_ns)), elevation.degrees, rtol=0.0, atol=0.02)
    ephemeris.close()


def test_the_date_of_the_reference_case_is_night():
    elevation_deg = np.rad2deg(draw(1).sun_elevation(START_NS + np.array([0, 600 * SECOND_NS])))
    assert elevation_deg[0] < -8.0
    assert elevation_deg[1] < elevation_deg[0]


@pytest.mark.statistics
def test_errors_common_to_all_stars_have_their_sigmas():
    weather = dataclasses.replace(paper_stars().weather, pressure_sigma_hpa=2.0, temperature_sigma_k=3.0)
    skies = [draw(seed, weather=weather, earth_rotation_sigma_s=0.01) for seed in range(300)]
    assert_sigma([sky.weather.pressure_hpa - 1008.3 for sky in skies], 2.0)
    assert_sigma([sky.weather.temperature_c - 28.2 for sky in skies], 3.0)
    assert_sigma([sky.ut1_error_s for sky in skies], 0.01)
    assert all(sky.weather.relative_humidity == 0.5 for sky in skies)


def test_without_a_sigma_ut1_has_the_error_of_its_table():
    tabulated = earth_orientation_table().at(START_NS)
    skies = [draw(seed) for seed in range(100)]
    assert_sigma([sky.ut1_error_s for sky in skies], float(tabulated.ut1_sigma_s))
    true = skies[0].orientation(np.array(START_NS))
    assert true.ut1_minus_utc_s - tabulated.ut1_minus_utc_s == pytest.approx(skies[0].ut1_error_s, abs=1e-15)


def test_star_positions_have_the_errors_of_the_catalogue():
    sky = draw(3)
    known, true = sky.catalogue.at_j2000, sky.positions
    # Independent of the implementation: 2014.52 is 23.27 years after 1991.25.
    sigma = np.hypot(sky.catalogue.position_sigma, 23.27 * sky.catalogue.pm_sigma)
    east = (true.right_ascension - known.right_ascension) * np.cos(known.declination)
    assert_sigma(east / sigma, 1.0)
    assert_sigma((true.declination - known.declination) / sigma, 1.0)
    assert abs(np.mean(east / sigma * (true.declination - known.declination) / sigma)) < 3.3 / np.sqrt(len(sigma))


def test_a_position_of_date_needs_no_proper_motion():
    sky = draw(1)
    # Arcturus has moved by 33″ since 2000; Polaris is near the pole.
    rows = sky.catalogue.rows([69673, 11767])
    known = sky.catalogue.at_j2000[rows]
    of_date = position_of_date(known, START_NS)
    args = (np.array(START_NS), observer_of(sky), sky.orientation(np.array(START_NS)))
    np.testing.assert_array_less(angle_between(directions(of_date, *args), directions(known, *args)), 0.01 * MAS)
    moved = angle_between(
        erfa.s2c(known.right_ascension, known.declination), erfa.s2c(of_date.right_ascension, of_date.declination)
    )
    assert moved[0] / ARCSEC == pytest.approx(14.52 * 2.279, abs=0.2)


def test_fixes_have_a_white_and_a_correlated_error_and_state_them():
    scenario = with_position(
        paper_stars(duration_s=3600.0), sigma_m=2.0, slow_sigma_m=10.0, slow_time_s=1.0, speed_m_per_s=10.0
    )
    fixes = simulate(dataclasses.replace(scenario, star_sensors={}), seed=1).fixes
    true = ShipTrack(scenario.position, START_NS).position_at(fixes.time_ns)
    stated = GeodeticPosition(np.deg2rad(fixes.latitude_deg), np.deg2rad(fixes.longitude_deg), fixes.height_m)
    error_m = vector_between(true, stated)
    sigma_m = np.sqrt(2.0**2 + 10.0**2)
    np.testing.assert_allclose(fixes.covariance_m2, sigma_m**2 * np.eye(3))
    for axis in range(3):
        # Only every fifth fix: after five correlation times 0.7 % of the correlated error remains.
        assert_sigma(error_m[::5, axis], sigma_m)
        # From fix to fix, exp(-1) of the correlated part remains.
        neighbours = np.mean(error_m[1:, axis] * error_m[:-1, axis]) / 10.0**2
        assert neighbours == pytest.approx(np.exp(-1.0), abs=0.1)
    without_slow = with_position(dataclasses.replace(scenario, star_sensors={}), slow_sigma_m=0.0)
    assert_sigma(simulate(without_slow, seed=1).fixes.height_m - 20.0, 2.0)

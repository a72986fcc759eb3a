"""Vertical along the track: tables, messages, distance over ground; in any order of arrival."""

import itertools

import numpy as np
import pytest

from ship_attitude_star.vertical.deflection import DeflectionTable, GravityConfig
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_stars.attitude_samples import DeflectionReading, PositionFix
from ship_stars.sky.config import SkyConfig

START_NS = 1_700_000_000 * SECOND_NS
M_PER_DEG_OF_LATITUDE = 110_574.0
"""At the equator, WGS 84."""

TABLE = {
    "deflection": "table",
    "table_latitude_deg": (0.0, 0.1, 0.2),
    "table_longitude_deg": (179.95, -179.95, -179.95),
    "table_xi_arcsec": (0.0, 10.0, 30.0),
    "table_eta_arcsec": (-4.0, -4.0, 0.0),
    "table_reach_m": 20_000.0,
}


def at(latitude_deg: float, longitude_deg: float) -> GeodeticPosition:
    return GeodeticPosition(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), 0.0)


def fix(since_s: float, north_m: float, longitude_deg: float = 0.0) -> PositionFix:
    place = at(north_m / M_PER_DEG_OF_LATITUDE, longitude_deg)
    return PositionFix(ns(since_s), place, np.diag([4.0, 4.0, 4.0]))


def ns(since_s: float) -> int:
    return START_NS + round(since_s * SECOND_NS)


def deflection_reading(since_s: float, xi_arcsec: float) -> DeflectionReading:
    return DeflectionReading(ns(since_s), ARCSEC * np.array([xi_arcsec, 0.0]), ARCSEC**2 * np.eye(2))


def track_after(seconds: int, speed: float, **config) -> VerticalTrack:
    track = VerticalTrack(GravityConfig(**config), SkyConfig())
    for second in range(seconds + 1):
        track.at(ns(second))
        track.insert(fix(second, speed * second))
    return track


def test_table_is_linear_between_rows_across_the_date_line() -> None:
    table = DeflectionTable(GravityConfig(**TABLE))
    np.testing.assert_allclose(table.at(at(0.05, 180.0)) / ARCSEC, [5.0, -4.0], atol=0.01)
    np.testing.assert_allclose(table.at(at(0.15, -179.95)) / ARCSEC, [20.0, -2.0], atol=0.01)
    # Off the track of the table the nearest point of the track is used, beyond its end the last row.
    np.testing.assert_allclose(table.at(at(0.15, -179.85)) / ARCSEC, [20.0, -2.0], atol=0.05)
    np.testing.assert_allclose(table.at(at(0.3, -179.95)) / ARCSEC, [30.0, 0.0], atol=1e-9)


def test_table_is_not_used_beyond_its_reach_and_in_its_gaps() -> None:
    table = DeflectionTable(GravityConfig(**TABLE))
    assert table.at(at(0.2, -179.75)) is None
    gap = GravityConfig(**{**TABLE, "table_reach_m": 5000.0})
    assert DeflectionTable(gap).at(at(0.05, 180.0)) is None


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"table_xi_arcsec": (0.0, 1.0)}, "gravity.table_xi_arcsec"),
        ({"table_eta_arcsec": (0.0, 1.0, float("nan"))}, "gravity.table_eta_arcsec"),
        (dict.fromkeys((name for name in TABLE if isinstance(TABLE[name], tuple)), ()), "two rows or more"),
        ({"unknown_sigma_arcsec": 0.0}, "gravity.unknown_sigma_arcsec"),
    ],
)
def test_configuration_that_cannot_be_used_is_named(change: dict, named: str) -> None:
    with pytest.raises(ParameterError, match=named):
        GravityConfig(**{**TABLE, **change})


def test_rotation_raises_the_gravity_zenith_to_the_north_and_to_the_east() -> None:
    # models.md, section 8: gravity's zenith is Up + xi North + eta East.
    track = track_after(10, 5.0, deflection="constant", xi_arcsec=6.0, eta_arcsec=-8.0)
    here = track.at(ns(10))
    zenith_n = exp_rotation(here.deflection_jacobian @ here.given_deflection) @ [0.0, 1.0, 0.0]
    np.testing.assert_allclose(zenith_n / ARCSEC, [6.0, 1.0 / ARCSEC, -8.0], atol=1e-3)


def test_distance_run_excludes_the_noise_of_fixes() -> None:
    track = track_after(600, 10.0, deflection="unknown")
    way_m = track.at(ns(600)).distance_run_m - track.at(ns(0)).distance_run_m
    assert way_m == pytest.approx(6000.0, abs=120.0)

    generator = np.random.default_rng(3)
    moored = VerticalTrack(GravityConfig(deflection="unknown"), SkyConfig())
    for second in range(600):
        moored.insert(fix(second, 3.0 * generator.standard_normal()))
        moored.at(ns(second))
    assert moored.at(ns(600)).distance_run_m == moored.at(ns(0)).distance_run_m


def test_without_fixes_the_distance_is_extrapolated_and_the_table_is_not_used() -> None:
    table = {**TABLE, "table_longitude_deg": (0.0, 0.0, 0.0)}
    track = track_after(300, 10.0, **table)
    assert track.at(ns(300)).given_deflection is not None
    assert track.missing_data_text(ns(300)) == ""
    before_m = track.at(ns(300)).distance_run_m
    later = track.at(ns(600))
    assert later.given_deflection is None
    # A fix is used for fix_max_age_s; after that the last speed counts.
    assert later.distance_run_m - before_m == pytest.approx(3000.0, abs=200.0)
    assert "no position fix" in track.missing_data_text(ns(600))
    # A fix so far away is accepted after 25 s.
    for second in range(600, 670):
        track.insert(fix(second, 60_000.0))
    assert "nearest is 38 km away" in track.missing_data_text(ns(669))


def test_a_message_is_used_until_its_maximum_age() -> None:
    track = VerticalTrack(GravityConfig(deflection="topic", max_age_s=60.0), SkyConfig())
    assert track.at(ns(0)).given_deflection is None
    track.insert(deflection_reading(10.0, 3.0))
    np.testing.assert_allclose(track.at(ns(20)).given_deflection / ARCSEC, [3.0, 0.0])
    np.testing.assert_allclose(track.at(ns(20)).covariance, ARCSEC**2 * np.eye(2))
    assert track.at(ns(80)).given_deflection is None
    assert "max_age_s = 60" in track.missing_data_text(ns(80))
    assert track.rejection(deflection_reading(10.0, 3.0)).reason is Reason.DUPLICATE
    assert track.rejection(deflection_reading(10.0, 4.0)).reason is Reason.CONFLICT


def test_order_of_arrival_does_not_matter() -> None:
    fixes = [fix(second, 20.0 * second) for second in range(0, 6, 2)]
    inputs = [*fixes, deflection_reading(3.0, 1.0), deflection_reading(3.0, 2.0), deflection_reading(5.0, 5.0)]
    ends = set()
    for order in itertools.permutations(inputs):
        track = VerticalTrack(GravityConfig(deflection="topic"), SkyConfig())
        for number, one in enumerate(order):
            track.insert(one)
            if number == 3:
                track.at(ns(6.0))
        answers = [track.at(ns(second)) for second in range(8)]
        ends.add(str([(one.distance_run_m, one.latitude, one.given_deflection) for one in answers]))
    assert len(ends) == 1


def test_discarded_data_change_no_later_result() -> None:
    kept, dropping = (VerticalTrack(GravityConfig(deflection="unknown"), SkyConfig()) for _ in range(2))
    for second in range(1000):
        for track in (kept, dropping):
            track.insert(fix(second, 12.0 * second))
        dropping.at(ns(second))
        dropping.drop_before(ns(second - 3.0), ns(second - 3.0))
    assert len(dropping._grid) < 10
    way_m = [track.at(ns(999.0)).distance_run_m - track.at(ns(997.0)).distance_run_m for track in (kept, dropping)]
    assert way_m[0] == way_m[1]

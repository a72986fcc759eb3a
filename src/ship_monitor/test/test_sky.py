"""Positions on the sky map, and the Moon against an eclipse and against another method of ERFA."""

import erfa
import numpy as np
import pytest

from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.time_scales import julian_date, tt_julian_date
from ship_monitor.plots.sky_panel import map_position, moon_direction

ECLIPSE_NS = 1_503_339_931_800_000_000
"""Time of the greatest eclipse of 2017-08-21, 18:25:31.8 UTC."""

ECLIPSE_PLACE = np.deg2rad([36.0 + 58.0 / 60.0, -(87.0 + 40.3 / 60.0)])
"""Place of the greatest eclipse, in Kentucky: NASA/TP-2015 and the eclipse bulletin of F. Espenak."""


@pytest.mark.parametrize(
    ("azimuth_deg", "elevation_deg", "place"),
    [
        (0.0, 0.0, (0.0, 1.0)),
        (90.0, 0.0, (1.0, 0.0)),
        (180.0, 60.0, (0.0, -1.0 / 3.0)),
        (270.0, 45.0, (-0.5, 0.0)),
        (123.0, 90.0, (0.0, 0.0)),
        (90.0, -9.0, (1.1, 0.0)),
    ],
)
def test_map_positions(azimuth_deg, elevation_deg, place) -> None:
    assert map_position(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)) == pytest.approx(place, abs=1e-12)


def test_moon_covered_the_sun_in_the_eclipse_of_2017() -> None:
    # The bulletin gives the Sun at this place: azimuth 197.9°, altitude 63.9°. The axis of the shadow passes the
    # Earth's centre at 0.4367 Earth radii. Seen from this place, the centres of Sun and Moon coincide within a minute
    # of arc.
    direction = moon_direction(ECLIPSE_NS, *ECLIPSE_PLACE)
    assert direction is not None
    azimuth_deg, elevation_deg = np.rad2deg(direction)
    assert azimuth_deg == pytest.approx(197.9, abs=0.15)
    assert elevation_deg == pytest.approx(63.9, abs=0.1)


@pytest.mark.parametrize("day", range(0, 30, 3))
def test_moon_equals_the_equinox_based_direction_of_erfa(day: int) -> None:
    time_ns = 1_404_906_607_800_000_000 + day * 86_400_000_000_000
    latitude, longitude = np.deg2rad(31.945), np.deg2rad(120.293)
    orientation = earth_orientation_table().at(time_ns)
    matrix = erfa.c2t06a(
        *tt_julian_date(time_ns),
        *julian_date(time_ns, orientation.ut1_minus_utc_s),
        orientation.pole_x,
        orientation.pole_y,
    )
    moon_m = erfa.DAU * matrix @ erfa.moon98(*tt_julian_date(time_ns))["p"] - erfa.gd2gc(1, longitude, latitude, 0.0)
    hour_angle, declination = (
        -np.arctan2(moon_m[1], moon_m[0]) + longitude,
        np.arctan2(moon_m[2], np.hypot(*moon_m[:2])),
    )
    azimuth, elevation = erfa.hd2ae(hour_angle, declination, latitude)
    found = moon_direction(time_ns, latitude, longitude)
    assert found is not None
    assert found[0] == pytest.approx(azimuth, abs=1e-8)
    assert found[1] == pytest.approx(elevation, abs=1e-8)


def test_no_moon_without_earth_orientation() -> None:
    assert moon_direction(0, 0.5, 2.0) is None

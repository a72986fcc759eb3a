"""Positions on WGS 84 against the worked examples of IOGP 373-7-2 (EPSG Guidance Note 7, part 2)."""

import numpy as np
import pytest

from ship_geometry.earth.geodetic import (
    GeodeticPosition,
    ecef_from_geodetic,
    geodetic_from_ecef,
    horizon_radii_m,
    rotation_horizon_from_ecef,
)
from ship_testing.horizon_vectors import vector_between

# NIMA TR8350.2, third edition, table 3.1 and 3.3: a, b.
WGS84_SEMI_MAJOR_M = 6378137.0
WGS84_SEMI_MINOR_M = 6356752.3142

# EPSG method 9602, "Geographic/geocentric conversions": 53°48'33.820"N 2°07'46.380"E, 73.0 m.
EPSG_POINT = GeodeticPosition(np.deg2rad(53 + 48 / 60 + 33.820 / 3600), np.deg2rad(2 + 7 / 60 + 46.380 / 3600), 73.0)
EPSG_POINT_ECEF_M = [3771793.968, 140253.342, 5124304.349]
# EPSG method 9836, "Geocentric/topocentric conversions": origin 55°N 5°E, 200 m.
EPSG_ORIGIN = GeodeticPosition(np.deg2rad(55.0), np.deg2rad(5.0), 200.0)
EPSG_ORIGIN_ECEF_M = [3652755.3058, 319574.6799, 5201547.3536]
EPSG_EAST_NORTH_UP_M = [-189013.869, -128642.040, -4220.171]


def test_ecef_of_the_epsg_examples() -> None:
    np.testing.assert_allclose(ecef_from_geodetic(EPSG_POINT), EPSG_POINT_ECEF_M, rtol=0, atol=6e-4)
    np.testing.assert_allclose(ecef_from_geodetic(EPSG_ORIGIN), EPSG_ORIGIN_ECEF_M, rtol=0, atol=6e-5)


def test_geodetic_of_the_epsg_example() -> None:
    position = geodetic_from_ecef(np.array(EPSG_POINT_ECEF_M))
    # A millimetre of ECEF is 1.6e-10 rad.
    assert position.latitude == pytest.approx(EPSG_POINT.latitude, abs=2e-10)
    assert position.longitude == pytest.approx(EPSG_POINT.longitude, abs=2e-10)
    assert position.height_m == pytest.approx(73.0, abs=1e-3)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "ecef_m"),
    [
        (0.0, 0.0, [WGS84_SEMI_MAJOR_M, 0.0, 0.0]),
        (0.0, 90.0, [0.0, WGS84_SEMI_MAJOR_M, 0.0]),
        (0.0, 180.0, [-WGS84_SEMI_MAJOR_M, 0.0, 0.0]),
        (90.0, 0.0, [0.0, 0.0, WGS84_SEMI_MINOR_M]),
        (-90.0, 0.0, [0.0, 0.0, -WGS84_SEMI_MINOR_M]),
    ],
)
def test_axes_of_the_ellipsoid(latitude_deg: float, longitude_deg: float, ecef_m: list[float]) -> None:
    position = GeodeticPosition(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), 0.0)
    np.testing.assert_allclose(ecef_from_geodetic(position), ecef_m, rtol=0, atol=1e-4)
    back = geodetic_from_ecef(np.array(ecef_m))
    assert back.latitude == pytest.approx(position.latitude, abs=1e-10)
    assert back.height_m == pytest.approx(0.0, abs=1e-4)


def test_positions_there_and_back() -> None:
    rng = np.random.default_rng(1)
    latitude, longitude = rng.uniform(-np.pi / 2, np.pi / 2, 1000), rng.uniform(-np.pi, np.pi, 1000)
    height_m = rng.uniform(-100.0, 9000.0, 1000)
    back = geodetic_from_ecef(ecef_from_geodetic(GeodeticPosition(latitude, longitude, height_m)))
    np.testing.assert_allclose(back.latitude, latitude, rtol=0, atol=1e-14)
    np.testing.assert_allclose(back.longitude, longitude, rtol=0, atol=1e-14)
    np.testing.assert_allclose(back.height_m, height_m, rtol=0, atol=1e-8)


def test_vector_of_the_epsg_example_is_in_north_up_east() -> None:
    east_m, north_m, up_m = EPSG_EAST_NORTH_UP_M
    np.testing.assert_allclose(vector_between(EPSG_ORIGIN, EPSG_POINT), [north_m, up_m, east_m], rtol=0, atol=2e-3)


def test_horizon_axes_are_the_directions_of_growing_latitude_height_longitude() -> None:
    """Finite differences of the position instead of the formula of the matrix."""
    for latitude, longitude in np.random.default_rng(2).uniform([-1.5, -3.1], [1.5, 3.1], (100, 2)):
        rotation = rotation_horizon_from_ecef(latitude, longitude)
        assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-14)
        for axis, change in enumerate([(1e-6, 0.0, 0.0), (0.0, 0.0, 10.0), (0.0, 1e-6, 0.0)]):
            forth = ecef_from_geodetic(GeodeticPosition(latitude + change[0], longitude + change[1], change[2]))
            back = ecef_from_geodetic(GeodeticPosition(latitude - change[0], longitude - change[1], -change[2]))
            direction = (forth - back) / np.linalg.norm(forth - back)
            np.testing.assert_allclose(rotation[axis], direction, rtol=0, atol=1e-8)


def test_arrays_of_positions_and_the_way_up() -> None:
    latitude, longitude = np.deg2rad([[10.0, -60.0]]), np.deg2rad([[5.0], [179.0]])
    start = GeodeticPosition(*np.broadcast_arrays(latitude, longitude, 0.0))
    end = GeodeticPosition(*np.broadcast_arrays(latitude, longitude, 31.0))
    vectors_m = vector_between(start, end)
    assert vectors_m.shape == (2, 2, 3)
    np.testing.assert_allclose(vectors_m, np.broadcast_to([0.0, 31.0, 0.0], (2, 2, 3)), rtol=0, atol=2e-9)


def test_ship_at_the_date_line_sees_a_neighbour_east() -> None:
    start = GeodeticPosition(0.0, np.deg2rad(179.9999), 0.0)
    end = GeodeticPosition(0.0, np.deg2rad(-179.9999), 0.0)
    north_m, up_m, east_m = vector_between(start, end)
    assert east_m == pytest.approx(np.deg2rad(0.0002) * WGS84_SEMI_MAJOR_M, rel=1e-9)
    assert north_m == pytest.approx(0.0, abs=1e-8)
    assert up_m == pytest.approx(-(east_m**2) / (2 * WGS84_SEMI_MAJOR_M), abs=1e-8)


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 31.9, 89.0])
def test_radii_of_the_horizon_are_metres_per_radian_on_the_ellipsoid(latitude_deg: float) -> None:
    position = GeodeticPosition(np.deg2rad(latitude_deg), 0.3, 500.0)
    step = 1e-5
    north_m = vector_between(position, GeodeticPosition(position.latitude + step, 0.3, 500.0))[0] / step
    # A rotation by the step about the North axis changes the longitude by step / cos φ.
    east = GeodeticPosition(position.latitude, 0.3 + step / np.cos(position.latitude), 500.0)
    east_m = vector_between(position, east)[2] / step
    np.testing.assert_allclose(horizon_radii_m(position), [north_m, east_m], rtol=1e-7)

"""The sky at a time: rejections, and shared errors compared with a sky that has these errors."""

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_geometry.earth.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.rotations import ARCSEC
from ship_stars.attitude_samples import AirReading, PositionFix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.sky_model import SHARED_TERMS, LocalSky, SkyModel, load_sky_model
from ship_testing.star_sky import POSITION, TIME_NS

PRESSURE_SIGMA_HPA = 5.0
NORTH_SIGMA_M, EAST_SIGMA_M = 300.0, 500.0


def sky_model_with_inputs(position: GeodeticPosition = POSITION, pressure_hpa: float = 1000.0) -> SkyModel:
    sky_model = load_sky_model(SkyConfig(temperature_sigma_k=0.0))
    sky_model.surroundings.insert(PositionFix(TIME_NS, position, np.diag([NORTH_SIGMA_M**2, 0.0, EAST_SIGMA_M**2])))
    sky_model.surroundings.insert(AirReading("pressure", TIME_NS, pressure_hpa, PRESSURE_SIGMA_HPA))
    return sky_model


def local_sky(*args, **kwargs) -> LocalSky:
    return sky_model_with_inputs(*args, **kwargs).sky_at(TIME_NS)


@pytest.fixture(scope="module")
def stars():
    """Stars brighter than 3 mag and above 20°; below 20°, refraction varies too much."""
    sky_model = sky_model_with_inputs()
    rows = sky_model.catalogue.rows_brighter_than(3.0)
    elevation = sky_model.sky_at(TIME_NS).apparent_stars(sky_model.catalogue.at_j2000[rows]).elevation
    return sky_model.catalogue.at_j2000[rows[elevation > np.deg2rad(20.0)]]


def test_without_position_or_earth_orientation_the_sky_is_rejected_with_a_reason() -> None:
    sky_model = load_sky_model(SkyConfig())
    assert sky_model.sky_at(TIME_NS).reason is Reason.NO_FIX
    assert (
        sky_model_with_inputs().sky_at(TIME_NS + 40 * 365 * 86_400 * 1_000_000_000).reason
        is Reason.NO_EARTH_ORIENTATION
    )
    sky_model = sky_model_with_inputs()
    sky_model.reset()
    assert sky_model.sky_at(TIME_NS).reason is Reason.NO_FIX


def test_repeated_fixes_and_readings_are_rejected() -> None:
    sky_model = sky_model_with_inputs()
    for given in (
        PositionFix(TIME_NS, POSITION, np.diag([NORTH_SIGMA_M**2, 0.0, EAST_SIGMA_M**2])),
        AirReading("pressure", TIME_NS, 1000.0, PRESSURE_SIGMA_HPA),
    ):
        assert sky_model.surroundings.rejection(given).reason is Reason.DUPLICATE
        assert sky_model.surroundings.insert(given) is None


def test_a_sigma_of_refraction_equals_other_air(stars) -> None:
    here = local_sky().apparent_stars(stars)
    thicker = local_sky(pressure_hpa=1000.0 + PRESSURE_SIGMA_HPA).apparent_stars(stars)
    lifted = here.shared_n[..., SHARED_TERMS.index("refraction")]
    # The sigma also contains the error of the refraction model, hence the tolerance.
    np.testing.assert_allclose(lifted, thicker.direction_n - here.direction_n, atol=0.05 * ARCSEC)
    assert np.max(np.linalg.norm(lifted, axis=-1)) > 0.5 * ARCSEC


@pytest.mark.parametrize(("column", "north", "east"), [(2, 1.0, 0.0), (3, 0.0, 1.0)])
def test_a_sigma_of_position_equals_another_position(stars, column: int, north: float, east: float) -> None:
    assert SHARED_TERMS[column] == "ship_position"
    radius_north_m, radius_east_m = horizon_radii_m(POSITION)
    there = GeodeticPosition(
        POSITION.latitude + north * NORTH_SIGMA_M / radius_north_m,
        POSITION.longitude + east * EAST_SIGMA_M / (radius_east_m * np.cos(POSITION.latitude)),
        POSITION.height_m,
    )
    here = local_sky().apparent_stars(stars)
    moved = local_sky(there).apparent_stars(stars)
    np.testing.assert_allclose(here.shared_n[..., column], moved.direction_n - here.direction_n, atol=0.05 * ARCSEC)


def test_unmeasured_quantities_of_the_air_are_named() -> None:
    assert sky_model_with_inputs().surroundings.unmeasured_quantities(TIME_NS) == ["temperature", "humidity"]


def test_results_are_cached_until_an_input_changes_them() -> None:
    sky_model = sky_model_with_inputs()
    stars = sky_model.catalogue.at_j2000[:3]
    first = sky_model.sky_at(TIME_NS)
    assert sky_model.sky_at(TIME_NS) is first
    assert first.apparent_stars(stars) is first.apparent_stars(stars)
    with pytest.raises(ValueError, match="read-only"):
        first.apparent_stars(stars).direction_n[0, 0] = 0.0
    # Air with a later stamp changes nothing now, air with an earlier stamp does.
    sky_model.surroundings.insert(AirReading("temperature", TIME_NS + 1, 20.0))
    assert sky_model.sky_at(TIME_NS) is first
    sky_model.surroundings.insert(AirReading("temperature", TIME_NS - 1, 20.0))
    assert sky_model.sky_at(TIME_NS).air.weather.temperature_c == 20.0
    assert first.air.weather.temperature_c != 20.0

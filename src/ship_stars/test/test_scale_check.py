"""Focal length check by the angles between stars: rejected and accepted cases."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.star_attitude.exposure_solver import solve_exposure
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.field_scale import check_focal_length
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.errors import OpticsErrors
from ship_stars.sky.sky_model import SkyModel
from ship_testing.star_sky import ROTATION_ND, configuration, exposure_of, sky_at_anchor, without_identity

CAMERA = StarCamera(0.05, 5.5e-6, 1023.5, 1023.5)
OPTICS = OpticsErrors(CAMERA, 2e-4, 1.0, 0.01)
STARS = 10
TEXT = re.compile(
    r"focal length (\d+\.\d+) mm fits the angles between (\d+) stars, configured 50.000 mm, sigma 0.010 mm"
)


@pytest.fixture(scope="module")
def sky_model() -> SkyModel:
    return sky_at_anchor(configuration())


def exposure(sky_model: SkyModel, scale: float, rng: np.random.Generator, count: int = STARS) -> StarExposure:
    """Return stars with noise of 3″ by a camera whose true focal length is longer by the ratio ``scale``."""
    seen = exposure_of(sky_model, "fore", count, rng)
    true = replace(CAMERA, focal_length_m=CAMERA.focal_length_m * (1.0 + scale))
    return replace(seen, directions_s=CAMERA.directions(true.pixels(seen.directions_s)), optics=OPTICS)


def prior(rng: np.random.Generator, sigma: float) -> StarPrior:
    rotation_ns = ROTATION_ND @ rotation_from_angles(0.0, np.deg2rad(45.0), 0.0)
    return StarPrior(exp_rotation(sigma * rng.standard_normal(3)) @ rotation_ns, sigma**2 * np.eye(3))


@pytest.mark.parametrize("scale", [-3e-3, 3e-3])
@pytest.mark.parametrize("named", [True, False])
def test_a_wrong_focal_length_is_named_with_the_value_that_fits(sky_model, scale, named):
    for seed in range(10):
        rng = np.random.default_rng([1, seed])
        seen = exposure(sky_model, scale, rng)
        seen = seen if named else without_identity(seen)
        _, solved = solve_exposure(seen, (), prior(rng, 30.0 * ARCSEC), sky_model)
        rejection = solved.solution.rejection
        assert rejection is not None
        assert rejection.reason is Reason.MISIDENTIFIED
        found = TEXT.match(rejection.text)
        assert found, rejection.text
        # Ten stars with noise of 3″ in a field of 14° give a sigma of 0.01 % at worst; the limit is four times as
        # large.
        assert float(found[1]) == pytest.approx(50.0 * (1.0 + scale), abs=0.02)


def test_named_stars_need_no_attitude_for_it(sky_model):
    rng = np.random.default_rng(2)
    rejection = check_focal_length(exposure(sky_model, 3e-3, rng), sky_model, None, used_count=0)
    assert rejection is not None
    assert TEXT.match(rejection.text)


@pytest.mark.parametrize("scale", [0.0, 2e-4, -4e-4])
@pytest.mark.parametrize("false_count", [0, 3])
def test_a_focal_length_within_its_error_is_not_named(sky_model, scale, false_count):
    for seed in range(10):
        rng = np.random.default_rng([3, seed])
        seen = exposure(sky_model, scale, rng)
        directions_s = seen.directions_s.copy()
        directions_s[:false_count] = exp_rotation(0.02 * rng.standard_normal((false_count, 3))) @ directions_s[0]
        seen = replace(seen, directions_s=directions_s)
        for used_count in (0, STARS - false_count):
            assert check_focal_length(seen, sky_model, prior(rng, 30.0 * ARCSEC), used_count) is None


def test_two_stars_are_too_few(sky_model):
    rng = np.random.default_rng(4)
    assert check_focal_length(exposure(sky_model, 3e-3, rng, 2), sky_model, prior(rng, 30.0 * ARCSEC), 0) is None

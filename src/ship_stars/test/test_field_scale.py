"""Focal length and principal point from angles between stars, compared with scipy and with chi-square bands."""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.rotations import ARCSEC
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars
from ship_stars.attitude_from_stars.field_scale import estimate_optics, field_information
from ship_stars.camera.camera import Distortion, StarCamera
from ship_stars.camera.errors import FIELD_MODES, SOURCE_FIELD, SpatialErrors

# 50 mm, 5.5 µm pixels: 22.7" each; 2048 pixels see 12.9°.
PLAIN = StarCamera(0.05, 5.5e-6, 1023.5, 1023.5)
BENT = replace(PLAIN, distortion=Distortion(k1=-0.12, k2=0.03, p1=2e-4, p2=-3e-4))
SIGMA_PX = 0.13
CAMERAS = pytest.mark.parametrize("camera", [PLAIN, BENT], ids=["plain", "bent"])


def true_camera(camera, scale=0.0, u_px=0.0, v_px=0.0):
    return replace(
        camera,
        focal_length_m=camera.focal_length_m * (1.0 + scale),
        principal_u_px=camera.principal_u_px + u_px,
        principal_v_px=camera.principal_v_px + v_px,
    )


def draw_field(rng, camera, true, stars=10, sigma_px=SIGMA_PX, shift_px=None):
    """Return stars seen by ``true`` and converted to directions by ``camera``; ``shift_px`` gives added errors."""
    rotation_ns = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    pixels = rng.uniform(0.0, 2047.0, (stars, 2))
    seen = pixels + sigma_px * rng.standard_normal(pixels.shape)
    if shift_px is not None:
        seen = seen + shift_px(pixels)
    measured_s, sigma = camera.measured_directions(seen, np.full(stars, max(sigma_px, 1e-4)))
    return MatchedStars(
        measured_b=measured_s,
        reference_n=true.directions(pixels) @ rotation_ns.T,
        sigma=sigma,
        position_sigma=np.zeros(stars),
        shared_n=np.zeros((stars, 3, 0)),
        sensor=np.zeros(stars, dtype=np.intp),
        mounting_b=np.empty((0, 3, 3)),
    )


def estimate(camera, fields, **options):
    return estimate_optics(reduce(add, [field_information(camera, field) for field in fields]), **options)


@CAMERAS
def test_stars_without_noise_give_the_true_optics(camera):
    rng, true = np.random.default_rng(1), true_camera(camera, 5e-4, 0.7, -0.4)
    found = estimate(camera, [draw_field(rng, camera, true, sigma_px=0.0) for _ in range(20)])
    # The correction is linear: the remainder is of second order.
    assert found.scale == pytest.approx(5e-4, abs=1e-6)
    assert found.principal_px == pytest.approx([0.7, -0.4], abs=0.02)


@CAMERAS
def test_the_estimate_equals_scipys_least_squares_over_attitudes_and_optics(camera):
    rng, true = np.random.default_rng(2), true_camera(camera, 3e-4)
    fields = [draw_field(rng, camera, true, stars=8) for _ in range(3)]

    def residuals(unknowns):
        scale, u_px, v_px = unknowns[:3] * [1e-4, 1.0, 1.0]
        tried, left = true_camera(camera, scale, u_px, v_px), []
        for number, field in enumerate(fields):
            turn_n = unknowns[3 + 3 * number : 6 + 3 * number] * ARCSEC
            measured_s = tried.directions(camera.pixels(field.measured_b))
            attitude_n = Rotation.from_rotvec(turn_n) * Rotation.align_vectors(field.reference_n, field.measured_b)[0]
            left.append((field.reference_n - attitude_n.apply(measured_s)) / field.sigma[:, None])
        return np.concatenate(left).ravel()

    by_scipy = least_squares(residuals, np.zeros(3 + 3 * len(fields)), x_scale=10.0, xtol=1e-12, ftol=1e-14)
    found = estimate(camera, fields)
    sigma = np.sqrt(np.diagonal(found.covariance))
    off = np.array([found.scale, *found.principal_px]) - by_scipy.x[:3] * [1e-4, 1.0, 1.0]
    np.testing.assert_allclose(off / sigma, 0.0, atol=0.02)
    assert found.chi_square == pytest.approx(2.0 * by_scipy.cost, rel=1e-3)
    covariance = np.linalg.inv(by_scipy.jac.T @ by_scipy.jac)[:3, :3] * np.outer([1e-4, 1, 1], [1e-4, 1, 1])
    # scipy linearises at the solution, some pixels off the configured principal point. This changes derivatives by 1 %.
    unit = np.outer(sigma, sigma)
    np.testing.assert_allclose(found.covariance / unit, covariance / unit, atol=0.03)
    assert found.degrees == 3 * (2 * 8 - 3) - 3


@pytest.mark.statistics
@CAMERAS
@pytest.mark.parametrize("prior", [False, True])
def test_errors_are_as_large_as_the_covariance_states(camera, prior):
    """NEES of 400 cameras with five fields each; bands of 99.9 % by chi-square."""
    prior_sigma = (2e-4, 1.0, 1.0) if prior else (np.inf, np.inf, np.inf)
    squares, chi_square, degrees = [], 0.0, 0
    for seed in range(400):
        rng = np.random.default_rng([36, seed])
        optics = np.array([2e-4, 1.0, 1.0]) * rng.standard_normal(3)
        fields = [draw_field(rng, camera, true_camera(camera, *optics)) for _ in range(5)]
        found = estimate(camera, fields, prior_sigma=prior_sigma)
        error = np.array([found.scale, *found.principal_px]) - optics
        squares.append(error @ np.linalg.solve(found.covariance, error))
        chi_square, degrees = chi_square + found.chi_square, degrees + found.degrees
    low, high = mean_nees_band(len(squares), 3)
    assert low < np.mean(squares) < high
    assert chi2.ppf(0.0005, degrees) < chi_square < chi2.ppf(0.9995, degrees)


def test_five_fields_of_ten_stars_show_a_twentieth_of_a_percent_beyond_five_sigma():
    rng = np.random.default_rng(4)
    found = estimate(PLAIN, [draw_field(rng, PLAIN, true_camera(PLAIN, 5e-4)) for _ in range(5)])
    # Expected sigma: 0.13 px / (836 px RMS distance from the middle × √(5 × 9)) = 2.3e-5.
    assert found.scale_sigma < 3e-5
    assert abs(found.scale - 5e-4) < 3.3 * found.scale_sigma
    # A shift of the principal point is nearly a rotation: 50 stars do not determine it to a pixel.
    assert found.principal_sigma_px.min() > 1.0


def test_a_wrong_identity_is_left_out_by_the_members():
    rng, members = np.random.default_rng(5), np.arange(10) != 3
    fields = [draw_field(rng, PLAIN, PLAIN) for _ in range(5)]
    for field in fields:
        field.reference_n[3] = field.reference_n[4]
    found = estimate_optics(reduce(add, [field_information(PLAIN, field, members) for field in fields]))
    assert abs(found.scale) < 3.3 * found.scale_sigma
    assert found.degrees == 5 * (2 * 9 - 3) - 3


def test_a_smooth_error_of_the_detector_widens_the_sigma():
    """The field map's linear part equals a focal length error: the map's prior sigma limits the accuracy."""
    rng = np.random.default_rng(6)
    fields = [draw_field(rng, PLAIN, PLAIN) for _ in range(40)]
    errors = SpatialErrors(PLAIN, 0.3, 0.0)
    sources = (SOURCE_FIELD,) * FIELD_MODES
    with_map = [
        replace(field, field_b=errors.field_modes(field.measured_b), field_sources=sources) for field in fields
    ]
    without, found = estimate(PLAIN, fields), estimate(PLAIN, with_map)
    assert with_map[0].field_b.shape[-1] == FIELD_MODES
    # 0.3 px RMS over the detector, of which the larger part is linear; 591 px is the RMS of u and of v.
    assert 0.3 * 0.3 / 591.0 < found.scale_sigma < 0.3 / 591.0
    assert without.scale_sigma < 0.1 * found.scale_sigma


def test_too_few_stars_determine_nothing():
    rng = np.random.default_rng(7)
    assert field_information(PLAIN, draw_field(rng, PLAIN, PLAIN, stars=1)) is None
    pair = field_information(PLAIN, draw_field(rng, PLAIN, PLAIN, stars=2))
    assert estimate_optics(pair) is None
    # One angle determines the focal length if the principal point is known.
    held = estimate_optics(pair, (np.inf, 0.0, 0.0))
    assert abs(held.scale) < 3.3 * held.scale_sigma
    assert held.principal_px.tolist() == [0.0, 0.0]
    assert held.degrees == 0

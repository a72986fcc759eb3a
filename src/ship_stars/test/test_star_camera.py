from dataclasses import replace

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC, angle_between
from ship_stars.camera.camera import Distortion, StarCamera, equivalent_sigma, tangent_basis

# 50 mm, 5 µm pixels: 20.6" each; 2048 pixels see 11.7°.
PLAIN = StarCamera(0.05, 5e-6, 1023.5, 1011.25)
BENT = StarCamera(0.05, 5e-6, 1023.5, 1011.25, Distortion(k1=-0.12, k2=0.03, p1=2e-4, p2=-3e-4, k3=0.01))
# A field of 70°, so that no approximation for small angles passes.
WIDE = StarCamera(0.008, 5.5e-6, 1000.0, 1000.0, Distortion(k1=-0.08, k2=0.01, p1=1e-3, p2=-2e-3))
CAMERAS = pytest.mark.parametrize("camera", [PLAIN, BENT, WIDE], ids=["plain", "bent", "wide"])


def pixels_all_over(count=500):
    return np.random.default_rng(3).uniform(0.0, 2047.0, (count, 2))


def test_axes_of_the_models_page():
    # W ∝ [f, -(v - v0) D, (u - u0) D]: the principal point is forward, u increases to the right, v downwards.
    assert PLAIN.directions(np.array([1023.5, 1011.25])) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    right = PLAIN.directions(np.array([1123.5, 1011.25]))
    assert right == pytest.approx(np.array([0.05, 0.0, 100 * 5e-6]) / np.hypot(0.05, 5e-4), abs=1e-15)
    down = PLAIN.directions(np.array([1023.5, 1111.25]))
    assert down == pytest.approx(np.array([0.05, -100 * 5e-6, 0.0]) / np.hypot(0.05, 5e-4), abs=1e-15)


@CAMERAS
def test_pixels_and_directions_are_inverse(camera):
    pixels = pixels_all_over()
    directions = camera.directions(pixels)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(np.ones(len(pixels)), abs=1e-14)
    assert camera.pixels(directions) == pytest.approx(pixels, abs=1e-9)
    assert camera.directions(pixels[7]) == pytest.approx(directions[7], abs=1e-15)


def test_distortion_by_the_formula():
    # By hand at x = 0.3, y = -0.2: r² = 0.13.
    k1, k2, p1, p2, k3 = 0.1, -0.05, 0.01, 0.02, 0.3
    radial = 1.0 + 0.1 * 0.13 - 0.05 * 0.0169 + 0.3 * 0.002197
    x = 0.3 * radial + 2 * 0.01 * -0.06 + 0.02 * (0.13 + 0.18)
    y = -0.2 * radial + 0.01 * (0.13 + 0.08) + 2 * 0.02 * -0.06
    assert Distortion(k1, k2, p1, p2, k3).distort(np.array([0.3, -0.2])) == pytest.approx([x, y], abs=1e-15)


def test_jacobian_of_the_distortion_equals_finite_differences():
    distortion = Distortion(0.1, -0.05, 0.01, 0.02, 0.3)
    points = np.random.default_rng(4).uniform(-0.5, 0.5, (50, 2))
    step = 1e-6
    for column, change in enumerate(np.eye(2) * step):
        difference = (distortion.distort(points + change) - distortion.distort(points - change)) / (2.0 * step)
        assert distortion.jacobian(points)[..., column] == pytest.approx(difference, abs=1e-9)


def test_barrel_distortion_brings_stars_inwards():
    # Detects a wrong sign: with k1 < 0 the lens images a star nearer to the middle.
    corner = np.array([2000.0, 2000.0])
    straight, bent = StarCamera(0.05, 5e-6, 1000.0, 1000.0), StarCamera(0.05, 5e-6, 1000.0, 1000.0, Distortion(-0.1))
    boresight = np.array([1.0, 0.0, 0.0])
    assert angle_between(bent.directions(corner), boresight) > angle_between(straight.directions(corner), boresight)


@CAMERAS
def test_direction_covariance_equals_finite_differences(camera):
    pixels, sigma_px, step = pixels_all_over(60), np.linspace(0.05, 0.3, 60), 1e-3
    basis = tangent_basis(camera.directions(pixels))
    slopes = [
        (camera.directions(pixels + change) - camera.directions(pixels - change)) / (2.0 * step)
        for change in np.eye(2) * step
    ]
    components = np.stack([np.einsum("kij,kj->ki", basis, slope) for slope in slopes], axis=-1)
    expected = components @ np.swapaxes(components, -1, -2) * (sigma_px**2)[:, None, None]
    covariance = camera.direction_covariance(pixels, sigma_px)
    assert covariance / ARCSEC**2 == pytest.approx(expected / ARCSEC**2, rel=1e-6, abs=1e-6)


@CAMERAS
def test_slopes_by_the_optics_equal_finite_differences(camera):
    pixels, step = pixels_all_over(60), 1e-5

    def directions(number, change):
        focal_length_m = camera.focal_length_m * np.exp(change * (number == 0))
        u_px, v_px = camera.principal_u_px + change * (number == 1), camera.principal_v_px + change * (number == 2)
        distortion = camera.distortion or Distortion()
        distortion = replace(distortion, k1=distortion.k1 + change * (number == 3))
        changed = StarCamera(focal_length_m, camera.pixel_pitch_m, u_px, v_px, distortion)
        return changed.directions(pixels)

    expected = [(directions(number, step) - directions(number, -step)) / (2.0 * step) for number in range(4)]
    np.testing.assert_allclose(
        camera.optics_jacobian(camera.directions(pixels)), np.stack(expected, axis=-1), atol=2e-10, rtol=1e-6
    )


def test_a_tenth_of_a_pixel_at_the_boresight_is_two_arcseconds():
    covariance = PLAIN.direction_covariance(np.array([1023.5, 1011.25]), 0.1)
    assert covariance == pytest.approx((0.1 * 5e-6 / 0.05) ** 2 * np.eye(2), rel=1e-12)
    assert equivalent_sigma(covariance) / ARCSEC == pytest.approx(2.06, abs=0.005)


def test_tangent_basis_is_up_and_right_across_the_direction():
    directions = WIDE.directions(pixels_all_over())
    basis = tangent_basis(directions)
    assert np.einsum("kij,klj->kil", basis, basis) == pytest.approx(np.broadcast_to(np.eye(2), (500, 2, 2)), abs=1e-14)
    assert np.einsum("kij,kj->ki", basis, directions) == pytest.approx(np.zeros((500, 2)), abs=1e-15)
    assert np.all(basis[:, 0, 1] > 0.7)
    assert np.all(basis[:, 1, 2] > 0.7)


def test_points_without_direction_or_pixel_are_nan():
    pixels = np.array([[np.nan, 10.0], [100.0, 100.0], [10.0, np.inf]])
    for camera in (PLAIN, BENT):
        assert np.isnan(camera.directions(pixels)).any(axis=-1).tolist() == [True, False, True]
    behind = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.isnan(PLAIN.pixels(behind)).any(axis=-1).tolist() == [True, True, False]
    # k1 = -10 folds at r = 0.18 focal lengths, 0.12 on the detector: 1200 pixels. Beyond there is no image.
    folding = StarCamera(0.05, 5e-6, 0.0, 0.0, Distortion(k1=-10.0))
    assert np.isnan(folding.directions(np.array([[1100.0, 0.0], [1300.0, 0.0]]))).any(axis=-1).tolist() == [False, True]


@CAMERAS
def test_a_measured_centroid_has_its_direction_and_its_sigma(camera):
    pixels, sigma_px = np.array([[1023.5, 1011.25], [200.0, 1800.0], [np.nan, 3.0], [500.0, 500.0]]), np.full(4, 0.1)
    sigma_px[3] = np.nan
    directions_s, sigma = camera.measured_directions(pixels, sigma_px)
    np.testing.assert_array_equal(directions_s, camera.directions(pixels))
    np.testing.assert_array_equal(sigma, equivalent_sigma(camera.direction_covariance(pixels, sigma_px)))
    assert np.isnan(sigma).tolist() == [False, False, True, True]

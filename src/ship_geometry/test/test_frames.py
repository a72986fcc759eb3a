"""Angles, matrices and covariances of a device frame against the matrices printed in models.md §1, scipy and draws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.frames import (
    SINGULAR_ELEVATION,
    angle_covariance,
    angle_errors_from_rotation_vector,
    angles_from_rotation,
    rotation_from_angles,
    rotation_vector_covariance,
    rotation_vector_from_angle_errors,
)
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation, wrap_pi


def attitudes(count: int, seed: int, elevation_to_deg: float = 89.0) -> np.ndarray:
    """Return azimuth, elevation (up to ± ``elevation_to_deg``) and roll, rad, shape (count, 3)."""
    rng = np.random.default_rng(seed)
    limit = np.sin(np.deg2rad(elevation_to_deg))
    azimuth, roll = rng.uniform(0, 2 * np.pi, count), rng.uniform(-np.pi, np.pi, count)
    return np.stack([azimuth, np.arcsin(rng.uniform(-limit, limit, count)), roll], axis=-1)


def by_the_matrices_of_models(azimuth: float, elevation: float, roll: float) -> np.ndarray:
    """Return Ry(A) Rz(-E) Rx(-roll) with the three matrices of models.md §1."""

    def rx(q: float) -> np.ndarray:
        return np.array([[1, 0, 0], [0, np.cos(q), np.sin(q)], [0, -np.sin(q), np.cos(q)]])

    def ry(q: float) -> np.ndarray:
        return np.array([[np.cos(q), 0, -np.sin(q)], [0, 1, 0], [np.sin(q), 0, np.cos(q)]])

    def rz(q: float) -> np.ndarray:
        return np.array([[np.cos(q), np.sin(q), 0], [-np.sin(q), np.cos(q), 0], [0, 0, 1]])

    return ry(azimuth) @ rz(-elevation) @ rx(-roll)


def test_rotation_is_the_product_of_the_printed_matrices_and_scipys() -> None:
    angles = attitudes(200, 1, 90.0)
    rotations = rotation_from_angles(*angles.T)
    expected = np.stack([by_the_matrices_of_models(*a) for a in angles])
    np.testing.assert_allclose(rotations, expected, rtol=0, atol=1e-15)
    turns = Rotation.from_euler("YZX", angles * [-1.0, 1.0, 1.0]).as_matrix()
    np.testing.assert_allclose(rotations, turns, rtol=0, atol=1e-15)


def test_what_the_angles_mean_aboard() -> None:
    """Level and heading East: bow East, starboard South. Then bow up, then starboard down, each by 10°."""
    level = rotation_from_angles(np.pi / 2, 0.0, 0.0)
    bow, up, starboard = level.T
    np.testing.assert_allclose([bow, up, starboard], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)
    bow_up = rotation_from_angles(np.pi / 2, np.deg2rad(10.0), 0.0)
    assert bow_up[1, 0] == pytest.approx(np.sin(np.deg2rad(10.0)))
    starboard_down = rotation_from_angles(np.pi / 2, 0.0, np.deg2rad(10.0))
    assert starboard_down[1, 2] == pytest.approx(-np.sin(np.deg2rad(10.0)))


def test_angles_come_back() -> None:
    angles = attitudes(2000, 2)
    back = angles_from_rotation(rotation_from_angles(*angles.T))
    np.testing.assert_allclose(wrap_pi(back - angles), 0.0, atol=1e-13)
    assert np.all((back[:, 0] >= 0) & (back[:, 0] < 2 * np.pi))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("short_of_zenith", [0.0, 1e-16, 1e-12, 1e-9, 1e-6, 1e-3])
def test_zenith_and_nadir_give_the_rotation_back(side: float, short_of_zenith: float) -> None:
    azimuth, roll = np.meshgrid(np.deg2rad(np.arange(0, 360, 15)), np.deg2rad(np.arange(-180, 180, 15)))
    rotation = rotation_from_angles(azimuth, side * (np.pi / 2 - short_of_zenith), roll)
    angles = angles_from_rotation(rotation)
    assert np.all(np.isfinite(angles))
    np.testing.assert_allclose(angles[..., 1], side * (np.pi / 2 - short_of_zenith), rtol=0, atol=2e-15)
    np.testing.assert_allclose(rotation_from_angles(*np.moveaxis(angles, -1, 0)), rotation, rtol=0, atol=1e-15)


def test_rotations_at_the_zenith_exactly_have_angles() -> None:
    """Matrices with exact zeros, where each arctangent alone would be 0/0."""
    for quarter in range(4):
        c, s = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarter]
        rotation = np.array([[0.0, -c, -s], [1.0, 0.0, 0.0], [0.0, -s, c]])
        back = rotation_from_angles(*angles_from_rotation(rotation))
        np.testing.assert_allclose(back, rotation, rtol=0, atol=1e-15)


def test_one_attitude_and_an_array_of_them_agree() -> None:
    zenith = np.array(
        [[1.0, side * (np.pi / 2 - short), 2.0] for side in (-1, 1) for short in (0.0, 1e-12, 1e-3, 2e-3)]
    )
    angles = np.concatenate([attitudes(50, 9, 90.0), zenith]).reshape(-1, 2, 3)
    rotations = rotation_from_angles(*np.moveaxis(angles, -1, 0))
    back = angles_from_rotation(rotations)
    forth_b = rotation_vector_from_angle_errors(angles[..., 0], angles[..., 1])
    inverse_b = angle_errors_from_rotation_vector(angles[..., 0], angles[..., 1])
    for index in np.ndindex(angles.shape[:2]):
        azimuth, elevation, roll = angles[index]
        np.testing.assert_allclose(rotation_from_angles(azimuth, elevation, roll), rotations[index], rtol=0, atol=1e-15)
        np.testing.assert_allclose(angles_from_rotation(rotations[index]), back[index], rtol=0, atol=1e-15)
        one_b = rotation_vector_from_angle_errors(azimuth, elevation)
        np.testing.assert_allclose(one_b, forth_b[index], rtol=0, atol=1e-15)
        one_inverse = angle_errors_from_rotation_vector(azimuth, elevation)
        np.testing.assert_allclose(one_inverse, inverse_b[index], rtol=1e-14, atol=1e-15)


def test_b_is_the_derivative_of_the_rotation_by_its_angles() -> None:
    """Central differences over the whole sphere, the zenith included: B is regular there, its inverse is not."""
    step = 1e-5
    zenith = np.array([[a, e, r] for a in (0.0, 1.0, 4.0) for e in (-np.pi / 2, np.pi / 2) for r in (0.0, 2.0)])
    for angles in np.concatenate([attitudes(300, 3, 90.0), zenith]):
        matrix = rotation_vector_from_angle_errors(angles[0], angles[1])
        for index in range(3):
            change = step * np.eye(3)[index]
            forth, back = by_the_matrices_of_models(*(angles + change)), by_the_matrices_of_models(*(angles - change))
            derivative = Rotation.from_matrix(forth @ back.T).as_rotvec() / (2 * step)
            np.testing.assert_allclose(matrix[:, index], derivative, rtol=0, atol=1e-9)


def test_inverse_of_b_is_the_derivative_of_the_angles_by_the_rotation_vector() -> None:
    step = 1e-6
    for angles in attitudes(300, 4, 85.0):
        matrix = angle_errors_from_rotation_vector(angles[0], angles[1])
        rotation = rotation_from_angles(*angles)
        for index in range(3):
            turn = Rotation.from_rotvec(step * np.eye(3)[index]).as_matrix()
            forth, back = angles_from_rotation(turn @ rotation), angles_from_rotation(turn.T @ rotation)
            np.testing.assert_allclose(matrix[:, index], wrap_pi(forth - back) / (2 * step), rtol=0, atol=2e-8)


def test_b_and_its_inverse_undo_one_another() -> None:
    azimuth, elevation, _ = attitudes(500, 5, 89.89).T
    product = angle_errors_from_rotation_vector(azimuth, elevation) @ rotation_vector_from_angle_errors(
        azimuth, elevation
    )
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("azimuth_deg", "expected_arcsec"), [(0.0, (35.01, 49.75, 61.64)), (90.0, (141.42, 0.0, 100.0))]
)
def test_installation_case_of_models_section_3(azimuth_deg: float, expected_arcsec: tuple[float, ...]) -> None:
    """Star sensor at As 235°, Es 45°, roll 90°, installed at E0 35°, with 100″ about its boresight (models.md §3)."""
    star = np.deg2rad([235.0, 45.0, 90.0])
    rotation_ns = rotation_from_angles(*star)
    rotation_ds = rotation_from_angles(np.deg2rad(azimuth_deg), np.deg2rad(35.0), 0.0)
    ship = angles_from_rotation(rotation_ns @ rotation_ds.T)
    delta = rotation_vector_from_angle_errors(star[0], star[1]) @ [0.0, 0.0, 100.0]
    ship_errors_arcsec = angle_errors_from_rotation_vector(ship[0], ship[1]) @ delta
    np.testing.assert_allclose(np.abs(ship_errors_arcsec), expected_arcsec, atol=0.005)


COVARIANCE_N = np.array([[100.0, 30.0, -8.0], [30.0, 400.0, 20.0], [-8.0, 20.0, 25.0]]) * ARCSEC**2
DRAWS = 200_000
# Standard error of a sample covariance from this number of draws, relative to the variances, times five.
FIVE_STANDARD_ERRORS = 5 * (2 / DRAWS) ** 0.5


@pytest.mark.parametrize(
    "angles_deg", [(34.4, 1.8, -4.0), (235.0, 45.0, 90.0), (120.0, -70.0, 10.0), (300.0, 85.0, -150.0)]
)
def test_angle_covariance_is_that_of_drawn_attitudes(angles_deg: tuple[float, float, float]) -> None:
    angles = np.deg2rad(angles_deg)
    rng = np.random.default_rng(6)
    deltas = rng.multivariate_normal(np.zeros(3), COVARIANCE_N, DRAWS)
    drawn = Rotation.from_rotvec(deltas).as_matrix() @ rotation_from_angles(*angles)
    errors = wrap_pi(angles_from_rotation(drawn) - angles)
    predicted = angle_covariance(COVARIANCE_N, angles[0], angles[1])
    sigma = np.sqrt(np.diagonal(predicted))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(np.cov(errors.T) / scale, predicted / scale, rtol=0, atol=FIVE_STANDARD_ERRORS)


@pytest.mark.parametrize("angles_deg", [(34.4, 1.8, -4.0), (120.0, -70.0, 10.0), (50.0, 90.0, 30.0)])
def test_rotation_vector_covariance_is_that_of_drawn_angles(angles_deg: tuple[float, float, float]) -> None:
    angles = np.deg2rad(angles_deg)
    covariance = np.diag([400.0, 25.0, 100.0]) * ARCSEC**2 + 15.0 * ARCSEC**2
    drawn = angles + np.random.default_rng(7).multivariate_normal(np.zeros(3), covariance, DRAWS)
    deltas = log_rotation(rotation_from_angles(*drawn.T) @ rotation_from_angles(*angles).T)
    predicted = rotation_vector_covariance(covariance, angles[0], angles[1])
    sigma = np.sqrt(np.diagonal(predicted).max())
    np.testing.assert_allclose(np.cov(deltas.T) / sigma**2, predicted / sigma**2, rtol=0, atol=FIVE_STANDARD_ERRORS)


def test_covariance_transport_there_and_back() -> None:
    azimuth, elevation, _ = attitudes(100, 8, 80.0).T
    there = angle_covariance(COVARIANCE_N, azimuth, elevation)
    back = rotation_vector_covariance(there, azimuth, elevation)
    np.testing.assert_allclose(back, np.broadcast_to(COVARIANCE_N, back.shape), rtol=0, atol=1e-11 * COVARIANCE_N.max())


@pytest.mark.parametrize("elevation", [np.pi / 2, -np.pi / 2, SINGULAR_ELEVATION + 1e-9, -SINGULAR_ELEVATION - 1e-9])
def test_angle_covariance_is_nan_at_the_zenith_and_the_rotation_vectors_is_not(elevation: float) -> None:
    assert np.all(np.isnan(angle_covariance(COVARIANCE_N, 1.0, elevation)))
    assert np.all(np.isnan(angle_errors_from_rotation_vector(1.0, elevation)))
    regular = rotation_vector_covariance(np.diag([400.0, 25.0, 100.0]) * ARCSEC**2, 1.0, elevation)
    assert np.all(np.isfinite(regular))
    assert np.linalg.eigvalsh(regular)[0] > -1e-12 * regular.max()


def test_just_below_the_singular_elevation_the_covariance_is_finite_and_only_those_beyond_are_nan() -> None:
    elevation = np.array([0.0, SINGULAR_ELEVATION - 1e-9, SINGULAR_ELEVATION + 1e-9])
    covariance = angle_covariance(COVARIANCE_N, np.full(3, 2.0), elevation)
    assert np.isfinite(covariance).all(axis=(1, 2)).tolist() == [True, True, False]


def test_error_of_an_attitude_is_applied_in_the_parent_frame() -> None:
    """R_true = exp(delta) R_estimate: an error about Up is a heading error of the opposite sign, exactly."""
    rotation = rotation_from_angles(*np.deg2rad([34.0, 5.0, -7.0]))
    turned = angles_from_rotation(exp_rotation(np.array([0.0, 60.0 * ARCSEC, 0.0])) @ rotation)
    expected = np.deg2rad([34.0, 5.0, -7.0]) - [60.0 * ARCSEC, 0.0, 0.0]
    np.testing.assert_allclose(turned, expected, rtol=0, atol=1e-15)

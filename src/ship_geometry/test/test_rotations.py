"""Rotation vectors and matrices, against scipy's Rotation and finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.rotations import (
    ARCSEC,
    angle_between,
    exp_rotation,
    left_jacobian,
    log_rotation,
    skew,
    wrap_pi,
    wrap_two_pi,
)

# Both sides of every switch of formula: the series below 1e-4 rad, the half-turn form beyond cos = -0.9.
ANGLES = [0.0, 1e-15, 1e-9, 5e-5, 0.99e-4, 1.01e-4, 1e-3, 0.3, 1.5, 2.6, 2.69, 2.7, 3.0, np.pi - 1e-3]
NEAR_HALF_TURN = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-15]


def directions(count: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    vectors[:3] = np.eye(3)
    vectors[3:6] = -np.eye(3)
    vectors[6] = [1.0, 1e-9, -1e-9]
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_scipys_matrix(angle: float) -> None:
    vectors = angle * directions(40, 1)
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(exp_rotation(vectors), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_is_scipys_rotation_vector(angle: float) -> None:
    vectors = angle * directions(40, 2)
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(log_rotation(matrices), vectors, rtol=0, atol=2e-15)


@pytest.mark.parametrize("angle", [1e-15, 1e-12, 1e-9, 1e-6, 1e-4])
def test_tiny_rotations_keep_their_relative_precision(angle: float) -> None:
    vectors = angle * directions(40, 3)
    back = log_rotation(exp_rotation(vectors))
    np.testing.assert_allclose(np.linalg.norm(back - vectors, axis=1) / angle, 0.0, atol=1e-15)


@pytest.mark.parametrize("short_of_half_turn", NEAR_HALF_TURN)
def test_log_near_half_a_turn(short_of_half_turn: float) -> None:
    vectors = (np.pi - short_of_half_turn) * directions(60, 4)
    back = log_rotation(exp_rotation(vectors))
    # The matrix itself is rounded at 1e-16; closer than this to half a turn, the sign of the axis is lost.
    if short_of_half_turn < 1e-14:
        back *= np.sign(np.sum(back * vectors, axis=1, keepdims=True))
    np.testing.assert_allclose(back, vectors, rtol=0, atol=4e-15)


def test_exact_half_turns_give_one_of_the_two_axes() -> None:
    for axis in directions(60, 5):
        matrix = 2.0 * np.outer(axis, axis) - np.eye(3)
        vector = log_rotation(matrix)
        assert np.linalg.norm(vector) == pytest.approx(np.pi, abs=1e-15)
        np.testing.assert_allclose(np.linalg.norm(np.cross(vector, axis)), 0.0, atol=1e-14)
        np.testing.assert_allclose(exp_rotation(vector), matrix, atol=2e-15)


@pytest.mark.parametrize("angle", [*ANGLES, np.pi - 1e-9, np.pi])
def test_one_vector_and_an_array_of_vectors_agree(angle: float) -> None:
    vectors = angle * directions(12, 6).reshape(3, 4, 3)
    matrices, jacobians, logs = exp_rotation(vectors), left_jacobian(vectors), log_rotation(exp_rotation(vectors))
    assert matrices.shape == jacobians.shape == (3, 4, 3, 3)
    for index in np.ndindex(3, 4):
        np.testing.assert_allclose(exp_rotation(vectors[index]), matrices[index], rtol=0, atol=1e-15)
        np.testing.assert_allclose(left_jacobian(vectors[index]), jacobians[index], rtol=0, atol=1e-15)
        np.testing.assert_allclose(log_rotation(matrices[index]), logs[index], rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 0.02, 0.3, 1.5, 3.0, 3.14159])
def test_left_jacobian_is_the_derivative_of_exp(angle: float) -> None:
    step = 1e-5
    for vector in angle * directions(15, 7):
        derivative = np.empty((3, 3))
        for axis in range(3):
            change = step * np.eye(3)[axis]
            forth, back = Rotation.from_rotvec(vector + change), Rotation.from_rotvec(vector - change)
            derivative[:, axis] = (forth * back.inv()).as_rotvec() / (2.0 * step)
        np.testing.assert_allclose(left_jacobian(vector), derivative, rtol=0, atol=1e-10)
        right = np.linalg.inv(exp_rotation(vector)) @ derivative
        np.testing.assert_allclose(left_jacobian(vector).T, right, rtol=0, atol=1e-10)


def test_skew_is_the_cross_product() -> None:
    rng = np.random.default_rng(8)
    v, w = rng.standard_normal((2, 5, 4, 3))
    np.testing.assert_allclose((skew(v) @ w[..., None])[..., 0], np.cross(v, w), atol=1e-15)


TURN = 2.0 * np.pi


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(0.0, 0.0), (3.0, 3.0), (-3.0, -3.0), (np.pi, -np.pi), (-np.pi, -np.pi), (4.0, 4.0 - TURN), (-4.0, TURN - 4.0)],
)
def test_wrap_pi(angle: float, expected: float) -> None:
    assert wrap_pi(angle) == pytest.approx(expected, abs=1e-15)
    assert wrap_pi(angle + 5 * TURN) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.0, 0.0), (6.0, 6.0), (TURN, 0.0), (-1.0, TURN - 1.0), (7.0, 7.0 - TURN), (-1e-20, 0.0)]
)
def test_wrap_two_pi(angle: float, expected: float) -> None:
    assert wrap_two_pi(angle) == pytest.approx(expected, abs=1e-15)


def test_wrapped_angles_stay_inside_their_half_open_interval() -> None:
    edges = np.concatenate([k * np.pi * (1 + np.arange(-40, 41) * 2.0**-53) for k in range(-7, 8)])
    edges = np.concatenate([edges, [np.nextafter(-np.pi, -4.0), np.nextafter(np.pi, 0.0), -5e-324, 5e-324]])
    for values in (edges, np.random.default_rng(9).uniform(-1e4, 1e4, 20000)):
        assert np.all((wrap_pi(values) >= -np.pi) & (wrap_pi(values) < np.pi))
        assert np.all((wrap_two_pi(values) >= 0.0) & (wrap_two_pi(values) < TURN))
        np.testing.assert_allclose(np.exp(1j * wrap_pi(values)), np.exp(1j * values), atol=4e-12)
        np.testing.assert_allclose(np.exp(1j * wrap_two_pi(values)), np.exp(1j * values), atol=4e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.01 * ARCSEC, 1e-4, 1.0, np.pi / 2, 3.0, np.pi - 1e-9, np.pi])
def test_angle_between_by_construction(angle: float) -> None:
    axes = directions(30, 10)
    first = np.cross(axes, axes[::-1] + np.array([0.1, 0.2, 0.3]))
    second = Rotation.from_rotvec(angle * axes).apply(first)
    # Lengths have no effect. Rounding of the vectors themselves changes the angle by 1e-16 rad.
    np.testing.assert_allclose(angle_between(3.0 * first, 1e-3 * second), angle, rtol=0, atol=1e-15)


def test_angle_between_opposite_vectors_is_half_a_turn() -> None:
    vectors = directions(30, 11)
    np.testing.assert_array_equal(angle_between(vectors, -vectors), np.pi)


def test_arcsecond() -> None:
    assert pytest.approx(4.848137e-6, rel=1e-7) == ARCSEC  # models.md §1

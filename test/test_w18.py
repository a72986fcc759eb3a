"""Equations (3), (5), (14), (15), (18)-(20) and (23) of [W18], as printed, compared with exact rotations.

The paper's axes are East, North, Up and right, forward, up; those of the suite North, Up, East and forward, up, right.
"""

import numpy as np
import pytest

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray, wrap_pi
from ship_testing.paper_method import triad

PAPER_FROM_SUITE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
ROUNDING = 1e-13


def random_angles(count: int = 2000) -> FloatArray:
    """Return azimuths in all quadrants, elevations in ±85° and image rotations in all quadrants, rad, shape (3, count).
    """
    limits = np.deg2rad([180.0, 85.0, 180.0])
    return np.random.default_rng(18).uniform(-limits[:, None], limits[:, None], (3, count))


def matrix(rows: list[list[FloatArray | float]]) -> FloatArray:
    """Return the matrices of elements that are arrays or numbers, shape (..., 3, 3)."""
    elements = np.broadcast_arrays(*(element for row in rows for element in row))
    return np.stack(elements, axis=-1).reshape(*elements[0].shape, 3, 3)


def about_up(angle: FloatArray) -> FloatArray:
    """Return the factor of azimuth, heading or yaw in (1), (3), (5) and (14)."""
    c, s = np.cos(angle), np.sin(angle)
    return matrix([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def about_right(angle: FloatArray) -> FloatArray:
    """Return the factor of E in (1) and (14), of the angle called roll in (3) and (5)."""
    c, s = np.cos(angle), np.sin(angle)
    return matrix([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_forward(angle: FloatArray) -> FloatArray:
    """Return the factor of ω in (14), of the angle called pitch in (3) and (5)."""
    c, s = np.cos(angle), np.sin(angle)
    return matrix([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def exact(azimuth: FloatArray, elevation: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return K of (14) by the suite's rotation, in the paper's axes, shape (..., 3, 3)."""
    return PAPER_FROM_SUITE @ rotation_from_angles(azimuth, elevation, rotation) @ PAPER_FROM_SUITE.T


def printed_k(azimuth: FloatArray, elevation: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return K as multiplied out in (14) and (15)."""
    c_a, c_e, c_w = np.cos([azimuth, elevation, rotation])
    s_a, s_e, s_w = np.sin([azimuth, elevation, rotation])
    return matrix(
        [
            [c_a * c_w, s_a * c_e, c_a * s_w - s_a * s_e * c_w],
            [c_a * s_e * s_w, c_a * c_e, -c_a * s_e * c_w],
            [-c_e * s_w, s_e, c_e * c_w],
        ]
    )


def test_the_factors_of_14_are_the_one_rotation_of_the_suite() -> None:
    azimuth, elevation, rotation = random_angles()
    product = about_up(azimuth) @ about_right(elevation) @ about_forward(rotation)
    np.testing.assert_allclose(product, exact(azimuth, elevation, rotation), atol=ROUNDING)


def test_14_and_15_lack_three_terms_and_no_other() -> None:
    azimuth, elevation, rotation = random_angles()
    lacking = exact(azimuth, elevation, rotation) - printed_k(azimuth, elevation, rotation)
    expected = np.zeros_like(lacking)
    expected[:, 0, 0] = np.sin(azimuth) * np.sin(elevation) * np.sin(rotation)
    expected[:, 1, 0] = -np.sin(azimuth) * np.cos(rotation)
    expected[:, 1, 2] = -np.sin(azimuth) * np.sin(rotation)
    np.testing.assert_allclose(lacking, expected, atol=ROUNDING)
    # The missing terms vanish at azimuths 0 and 180°; over all angles they reach nearly 1.
    assert np.max(np.abs(expected), axis=0)[[0, 1, 1], [0, 0, 2]] == pytest.approx([0.98, 1.0, 1.0], abs=0.02)


def test_23_finds_neither_azimuth_nor_image_rotation_beyond_their_quadrants() -> None:
    azimuth, elevation, rotation = random_angles()
    k = exact(azimuth, elevation, rotation)
    k_12, k_22, k_31, k_32, k_33 = k[:, 0, 1], k[:, 1, 1], k[:, 2, 0], k[:, 2, 1], k[:, 2, 2]
    np.testing.assert_allclose(k_31, -np.cos(elevation) * np.sin(rotation), atol=ROUNDING)
    np.testing.assert_allclose(k_33, np.cos(elevation) * np.cos(rotation), atol=ROUNDING)
    # In place of (23):
    found = np.stack([np.arctan2(k_12, k_22), np.arcsin(k_32), np.arctan2(-k_31, k_33)])
    np.testing.assert_allclose(wrap_pi(found - [azimuth, elevation, rotation]), 0.0, atol=1e-11)
    # As printed:
    with np.errstate(invalid="ignore"):
        first, second = (np.arcsin(np.clip(each / np.cos(elevation), -1.0, 1.0)) for each in (k_12, k_22))
        printed_rotation = np.arccos(k_31 / np.sin(elevation))
    assert np.array_equal(error_size(first, azimuth) < 1e-6, np.abs(azimuth) < 0.5 * np.pi)
    # The second form gives 90° minus the size of the azimuth, which equals the azimuth only at 45°.
    np.testing.assert_allclose(second, 0.5 * np.pi - np.abs(azimuth), atol=1e-6)
    assert np.mean(error_size(second, azimuth) < np.deg2rad(1.0)) < 0.01
    assert np.mean(error_size(printed_rotation, rotation) < np.deg2rad(1.0)) < 0.01
    # For an upright image (rotation 0) the printed formula gives 90°.
    upright = exact(np.array([0.5]), np.array([0.5]), np.array([0.0]))[0]
    assert np.arccos(upright[2, 0] / np.sin(0.5)) == pytest.approx(0.5 * np.pi)


def error_size(found: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the size of an error, rad; infinite if there is no result."""
    return np.nan_to_num(np.abs(wrap_pi(found - angle)), nan=np.inf)


def test_18_needs_a_third_vector_for_20_to_be_an_attitude() -> None:
    rng = np.random.default_rng(20)
    first_t, second_t = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    k = exact(*random_angles(1))[0]
    r, s = (
        [one, np.cross(one, other) / np.linalg.norm(np.cross(one, other))]
        for one, other in ((first_t, second_t), (k @ first_t, k @ second_t))
    )
    two = sum(np.outer(s_i, r_i) for s_i, r_i in zip(s, r, strict=True))
    assert np.linalg.matrix_rank(two) == 2
    three = two + np.outer(np.cross(*s), np.cross(*r))
    np.testing.assert_allclose(three, k, atol=ROUNDING)
    np.testing.assert_allclose(three, triad(k @ first_t, k @ second_t, first_t, second_t), atol=ROUNDING)


def test_3_and_5_are_rotations_with_pitch_and_roll_exchanged_and_in_reverse_order() -> None:
    heading, pitch, roll = random_angles()
    printed = about_right(roll) @ about_forward(pitch) @ about_up(heading)
    # The printed product is a rotation: its rows are orthonormal, and its determinant is 1.
    squares = printed @ np.swapaxes(printed, -1, -2)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.det(printed), 1.0, atol=ROUNDING)
    corrected = about_up(heading) @ about_right(pitch) @ about_forward(roll)
    np.testing.assert_allclose(corrected, exact(heading, pitch, roll), atol=ROUNDING)
    zero = np.zeros_like(pitch)
    np.testing.assert_allclose(exact(zero, pitch, zero), about_right(pitch), atol=ROUNDING)
    np.testing.assert_allclose(exact(zero, zero, roll), about_forward(roll), atol=ROUNDING)

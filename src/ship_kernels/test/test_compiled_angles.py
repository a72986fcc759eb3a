"""Compiled conversions of attitudes against scipy, against arrays in plain numpy where these exist, and back.

"Equal" allows a difference of 1e-13, in radians or without a unit; covariances are of unit size.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.frames import (
    ENU_FROM_HORIZON,
    FLU_FROM_DEVICE,
    SINGULAR_ELEVATION,
    angle_covariance,
    angle_errors_from_rotation_vector,
    angles_from_rotation,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
)
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_kernels import compiled_rotations

RNG_SEED = 8


def rotations(count: int = 200) -> FloatArray:
    """Rotations of all sizes about all axes, the unit matrix and half turns, where quaternion components vanish."""
    rng = np.random.default_rng(RNG_SEED)
    half_turns = np.pi * np.eye(3)
    return exp_rotation(np.concatenate([np.zeros((1, 3)), half_turns, rng.uniform(-3.0, 3.0, (count, 3))]))


def equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_rotations_by_angles_are_those_of_scipy_and_lead_back() -> None:
    angles = np.random.default_rng(RNG_SEED).uniform([0.0, -1.5, -3.0], [6.28, 1.5, 3.0], (200, 3))
    found = compiled_rotations.rotations(angles)
    equal(found, Rotation.from_euler("YZX", angles * [-1.0, 1.0, 1.0]).as_matrix())
    equal(compiled_rotations.angles(found), angles)
    for rotation, (azimuth, elevation, roll) in zip(found, angles, strict=True):
        np.testing.assert_array_equal(rotation_from_angles(azimuth, elevation, roll), rotation)


def test_angles_of_rotations_of_all_sizes_lead_back() -> None:
    equal(compiled_rotations.rotations(compiled_rotations.angles(rotations())), rotations())


def test_an_azimuth_is_below_a_full_turn_and_zero_has_no_sign() -> None:
    for azimuth in (0.0, -0.0, -1e-300, -1e-17):
        found = compiled_rotations.angles(rotation_from_angles(azimuth, 0.0, 0.0)[None])[0, 0]
        assert 0.0 <= found < 2.0 * np.pi
        assert not np.signbit(found)


def test_covariances_of_angles_are_those_of_arrays_and_nan_at_the_zenith() -> None:
    rng = np.random.default_rng(RNG_SEED)
    roots = rng.standard_normal((204, 3, 3))
    covariances, angles = roots @ roots.swapaxes(1, 2), angles_from_rotation(rotations())
    angles[:, 1] *= 0.9
    angles[7, 1] = 0.5 * np.pi
    found = compiled_rotations.angle_covariances(covariances, angles, SINGULAR_ELEVATION)
    expected = angle_covariance(covariances, angles[:, 0], angles[:, 1])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [number == 7 for number in range(204)]
    by_arrays = angle_errors_from_rotation_vector(angles[:, 0], angles[:, 1])
    for number, (azimuth, elevation, _) in enumerate(angles):
        one = angle_errors_from_rotation_vector(azimuth, elevation)
        np.testing.assert_allclose(one, by_arrays[number], rtol=1e-13, atol=1e-13)


def test_quaternions_are_those_of_arrays_and_lead_back() -> None:
    found = np.array([quaternion_from_rotation(rotation) for rotation in rotations()])
    equal(found, quaternion_from_rotation(rotations()))
    equal(np.array([rotation_from_quaternion(2.5 * quaternion) for quaternion in found]), rotations())
    equal(rotation_from_quaternion(found), rotations())
    # scipy's quaternions are x, y, z, w too; the axes are those of ROS on both sides.
    by_scipy = Rotation.from_quat(found).as_matrix()
    equal(rotation_from_quaternion(found), ENU_FROM_HORIZON.T @ by_scipy @ FLU_FROM_DEVICE)


def test_attitude_does_not_depend_on_the_block() -> None:
    covariances = rotations() @ rotations().swapaxes(1, 2)
    angles = compiled_rotations.angles(rotations())
    calls = [
        (compiled_rotations.angles, (rotations(),), ()),
        (compiled_rotations.rotations, (angles,), ()),
        (compiled_rotations.quaternions, (rotations(),), ()),
        (compiled_rotations.rotations_of, (compiled_rotations.quaternions(rotations()),), ()),
        (compiled_rotations.angle_covariances, (covariances, angles), (SINGULAR_ELEVATION,)),
    ]
    for function, arrays, numbers in calls:
        together = function(*arrays, *numbers)
        for number in range(len(together)):
            alone = function(*(values[number : number + 1] for values in arrays), *numbers)
            np.testing.assert_array_equal(alone[0], together[number])


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The compiled loops do not check bounds, so the functions check shapes."""
    calls = [
        lambda: compiled_rotations.angles(np.zeros((2, 2, 3))),
        lambda: compiled_rotations.rotations(np.zeros((2, 4))),
        lambda: compiled_rotations.quaternions(np.zeros((2, 3, 2))),
        lambda: compiled_rotations.rotations_of(np.zeros((2, 3))),
        lambda: compiled_rotations.angle_covariances(np.zeros((2, 3, 3)), np.zeros((3, 3)), 1.5),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="do not fit together"):
            call()

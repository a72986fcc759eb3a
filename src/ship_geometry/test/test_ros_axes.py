"""ROS axes: quaternions built by scipy from yaw, pitch, roll; eight headings, bow up, starboard down."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_geometry.frames import (
    ENU_FROM_HORIZON,
    FLU_FROM_DEVICE,
    device_vector_from_ros,
    enu_covariance,
    flu_from_device_vector,
    horizon_covariance,
    mounting_quaternion,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
)

HEADINGS_DEG = [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]
PITCH_ROLL_DEG = [(0.0, 0.0), (8.0, 0.0), (0.0, 12.0), (8.0, 12.0), (-8.0, -12.0)]

each_attitude = pytest.mark.parametrize(
    ("heading_deg", "pitch_deg", "roll_deg"), [(k, *pr) for k in HEADINGS_DEG for pr in PITCH_ROLL_DEG]
)


def ros_quaternion(heading_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """REP-103: yaw from East to North is 90° - heading, pitch is positive bow down, roll starboard down."""
    return Rotation.from_euler("ZYX", [90.0 - heading_deg, -pitch_deg, roll_deg], degrees=True).as_quat(canonical=True)


@each_attitude
def test_enu_flu(heading_deg: float, pitch_deg: float, roll_deg: float) -> None:
    quaternion = ros_quaternion(heading_deg, pitch_deg, roll_deg)
    rotation = rotation_from_angles(*np.deg2rad([heading_deg, pitch_deg, roll_deg]))
    np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, rtol=0, atol=1e-15)
    published = quaternion_from_rotation(rotation)
    assert abs(published @ quaternion) == pytest.approx(1.0, abs=1e-15)
    assert published[3] >= 0.0


@each_attitude
def test_ned_frd(heading_deg: float, pitch_deg: float, roll_deg: float) -> None:
    """Aerospace order: yaw is the heading, pitch bow up, roll starboard down."""
    quaternion = Rotation.from_euler("ZYX", [heading_deg, pitch_deg, roll_deg], degrees=True).as_quat()
    rotation = rotation_from_angles(*np.deg2rad([heading_deg, pitch_deg, roll_deg]))
    np.testing.assert_allclose(rotation_from_quaternion(quaternion, "ned_frd"), rotation, rtol=0, atol=1e-15)


@each_attitude
def test_directions_seen_from_ashore(heading_deg: float, pitch_deg: float, roll_deg: float) -> None:
    """The directions of bow and mast in ROS axes equal those by the deck matrix."""
    bow_enu, left_enu, up_enu = Rotation.from_quat(ros_quaternion(heading_deg, pitch_deg, roll_deg)).as_matrix().T
    bow, up, starboard = rotation_from_quaternion(ros_quaternion(heading_deg, pitch_deg, roll_deg)).T
    for neu, enu in ((bow, bow_enu), (up, up_enu), (starboard, -left_enu)):
        np.testing.assert_allclose(neu, [enu[1], enu[2], enu[0]], atol=1e-15)
    assert np.sign(round(bow[1], 9)) == np.sign(pitch_deg)
    assert np.sign(round(-starboard[1], 9)) == np.sign(roll_deg)


def test_bow_north_level_is_a_quarter_turn_about_up() -> None:
    """The known case: yaw 90°, quaternion (0, 0, sqrt 1/2, sqrt 1/2)."""
    np.testing.assert_allclose(quaternion_from_rotation(np.eye(3)), [0.0, 0.0, 0.5**0.5, 0.5**0.5], atol=1e-15)


def test_quaternions_of_all_attitudes_there_and_back() -> None:
    rotations = Rotation.random(500, random_state=1).as_matrix().reshape(50, 10, 3, 3)
    quaternions = quaternion_from_rotation(rotations)
    assert quaternions.shape == (50, 10, 4)
    assert np.all(quaternions[..., 3] >= 0.0)
    turned = (ENU_FROM_HORIZON @ rotations @ FLU_FROM_DEVICE.T).reshape(-1, 3, 3)
    of_scipy = Rotation.from_matrix(turned).as_quat(canonical=True).reshape(50, 10, 4)
    np.testing.assert_allclose(quaternions, of_scipy, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rotation_from_quaternion(quaternions), rotations, rtol=0, atol=2e-15)
    # One at a time, as in a live node. All four cases of the formula occur: each component is the largest in some
    # attitude.
    assert set(np.argmax(np.abs(quaternions), axis=-1).ravel()) == {0, 1, 2, 3}
    for index in np.ndindex(50, 10):
        one = quaternion_from_rotation(rotations[index])
        np.testing.assert_allclose(one, quaternions[index], rtol=0, atol=2e-15)
        np.testing.assert_allclose(rotation_from_quaternion(one), rotations[index], rtol=0, atol=2e-15)


def test_sign_and_length_of_a_quaternion_do_not_matter() -> None:
    quaternion = ros_quaternion(225.0, 8.0, 12.0)
    expected = rotation_from_quaternion(quaternion)
    for scale in (-1.0, 1.009, 3.0):
        np.testing.assert_allclose(rotation_from_quaternion(scale * quaternion), expected, rtol=0, atol=1e-15)


def test_vectors_keep_their_direction() -> None:
    """A turn to starboard is clockwise from above: negative about up in ROS and in the suite."""
    np.testing.assert_array_equal(device_vector_from_ros([1.0, 2.0, 3.0]), [1.0, 3.0, -2.0])
    np.testing.assert_array_equal(device_vector_from_ros([1.0, 2.0, 3.0], "ned_frd"), [1.0, -3.0, 2.0])
    vectors = np.random.default_rng(2).standard_normal((4, 5, 3))
    np.testing.assert_array_equal(device_vector_from_ros(flu_from_device_vector(vectors)), vectors)


def test_rate_and_quaternion_belong_together() -> None:
    """A rotation by a FLU rate in ROS axes equals one by the converted rate in the suite's axes."""
    rate_flu = np.array([0.02, -0.01, 0.03])
    quaternion = Rotation.from_quat(ros_quaternion(135.0, 8.0, -12.0))
    later = (quaternion * Rotation.from_rotvec(rate_flu)).as_quat()
    turned = Rotation.from_rotvec(device_vector_from_ros(rate_flu)).as_matrix()
    expected = rotation_from_quaternion(quaternion.as_quat()) @ turned
    np.testing.assert_allclose(rotation_from_quaternion(later), expected, rtol=0, atol=1e-15)


def test_covariance_of_named_axes() -> None:
    names = np.array([["NN", "NU", "NE"], ["UN", "UU", "UE"], ["EN", "EU", "EE"]])
    root = np.random.default_rng(3).standard_normal((3, 3))
    covariance_n = root @ root.T
    by_name = {name: covariance_n[i, j] for (i, j), name in np.ndenumerate(names)}
    expected = [[by_name[a + b] for b in "ENU"] for a in "ENU"]
    np.testing.assert_allclose(enu_covariance(covariance_n), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(horizon_covariance(enu_covariance(covariance_n)), covariance_n, rtol=0, atol=1e-15)


def test_unknown_convention_is_named() -> None:
    with pytest.raises(ValueError, match=r"'nwu'.*'enu_flu' or 'ned_frd'"):
        rotation_from_quaternion([0.0, 0.0, 0.0, 1.0], "nwu")


@each_attitude
def test_a_device_on_the_deck_is_turned_in_the_axes_of_ros(heading_deg, pitch_deg, roll_deg) -> None:
    """Both frames are forward, left, up: an azimuth is negative about up, and an elevation is negative about left."""
    rotation_dv = rotation_from_angles(*np.deg2rad([heading_deg, pitch_deg, roll_deg]))
    expected = Rotation.from_euler("ZYX", [-heading_deg, -pitch_deg, roll_deg], degrees=True).as_quat(canonical=True)
    found = mounting_quaternion(rotation_dv)
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-15
    assert found[3] >= 0.0


def test_horizon_from_deck_and_deck_from_device_make_horizon_from_device() -> None:
    rotation_nd = rotation_from_angles(*np.deg2rad([310.0, 4.0, -7.0]))
    rotation_dv = rotation_from_angles(*np.deg2rad([95.0, 40.0, 3.0]))
    chain = Rotation.from_quat(quaternion_from_rotation(rotation_nd)) * Rotation.from_quat(
        mounting_quaternion(rotation_dv)
    )
    whole = Rotation.from_quat(quaternion_from_rotation(rotation_nd @ rotation_dv))
    assert (chain.inv() * whole).magnitude() < 1e-15

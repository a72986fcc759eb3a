"""Conversion between the axes of ROS and of the suite, for quaternions, rotation matrices, vectors and covariances.

ROS (REP-103) uses the parent axes East, North, Up and the device axes forward, left, up. The suite uses North, Up, East
and forward, up, right. The axes differ by fixed permutations with signs. ROS yaw = 90° - heading, ROS pitch = -pitch,
ROS roll = roll. "ENU <- FLU" is a rotation that transforms FLU vectors into ENU vectors. Quaternions are ordered x, y,
z, w. No other module converts axes.
"""

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_rotations

ENU_FROM_HORIZON = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation "(East, North, Up) from (North, Up, East)"."""

FLU_FROM_DEVICE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation "(forward, left, up) from (forward, up, right)"."""

NED_FROM_HORIZON = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation "(North, East, Down) from (North, Up, East)"."""

FRD_FROM_DEVICE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation "(forward, right, down) from (forward, up, right)"."""


def rotation_from_quaternion(quaternion: FloatArray, convention: str = "enu_flu") -> FloatArray:
    """Return the rotation "horizon from device", shape (..., 3, 3), of quaternions x, y, z, w of any norm above zero.

    Args:
        quaternion: ENU <- FLU, or NED <- FRD if ``convention`` is ``"ned_frd"``; shape (..., 4).
        convention: ``"enu_flu"`` (REP-103) or ``"ned_frd"``.

    Example:
        With the identity quaternion of ROS the bow points East, because yaw 0° is heading 90°.

        >>> rotation_nd = rotation_from_quaternion([0.0, 0.0, 0.0, 1.0])
        >>> print(rotation_nd[:, 0])  # North, Up, East
        [0. 0. 1.]
    """
    parent, device = _axes(convention)
    quaternion = np.asarray(quaternion, dtype=float)
    matrix = compiled_rotations.rotations_of(quaternion.reshape(-1, 4)).reshape(*quaternion.shape[:-1], 3, 3)
    rotation: FloatArray = parent.T @ matrix @ device
    return rotation


def celestial_rotation_from_quaternion(quaternion: FloatArray) -> FloatArray:
    """Return the rotation "ICRS from device (forward, up, right)", shape (3, 3), of one quaternion ICRS <- FLU.

    Example:
        >>> rotation_cs = celestial_rotation_from_quaternion([0.0, 0.0, 0.0, 1.0])
        >>> print(rotation_cs[:, 1])  # the sensor's up is the celestial north pole
        [0. 0. 1.]
    """
    rotation_cs: FloatArray = _matrix_of_one(np.asarray(quaternion, dtype=float)) @ FLU_FROM_DEVICE
    return rotation_cs


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w (w >= 0), ENU <- FLU, shape (..., 4), of rotations "horizon from device".

    Example:
        A level ship heading North has ROS yaw 90°; the quaternion has sine and cosine of 45° in z and w.

        >>> print(quaternion_from_rotation(np.eye(3)).round(4))  # x, y, z, w
        [0.     0.     0.7071 0.7071]
    """
    rotation = np.asarray(rotation, dtype=float)
    matrix = ENU_FROM_HORIZON @ rotation @ FLU_FROM_DEVICE.T
    if matrix.ndim == 2:
        return _quaternion_of_one(matrix)
    return _quaternion_from_matrix(matrix)


def mounting_quaternion(rotation_dv: FloatArray) -> FloatArray:
    """Return the quaternion x, y, z, w (w >= 0), FLU <- FLU, shape (4,), of a rotation "deck from device", (3, 3).

    Example:
        A sensor whose boresight points to starboard, 90° to the right of the bow, has ROS yaw -90° in the deck:

        >>> from ship_geometry.frames import rotation_from_angles
        >>> print(mounting_quaternion(rotation_from_angles(np.deg2rad(90.0), 0.0, 0.0)).round(4) + 0.0)  # x, y, z, w
        [ 0.      0.     -0.7071  0.7071]
    """
    return _quaternion_of_one(FLU_FROM_DEVICE @ np.asarray(rotation_dv, dtype=float) @ FLU_FROM_DEVICE.T)


def device_vector_from_ros(vector: FloatArray, convention: str = "enu_flu") -> FloatArray:
    """Return vectors (forward, up, right), shape (..., 3), from vectors (forward, left, up) or (forward, right, down).

    Example:
        >>> print(device_vector_from_ros([1.0, 2.0, 3.0]))  # 2 to the left and 3 up
        [ 1.  3. -2.]
    """
    return np.asarray(vector, dtype=float) @ _axes(convention)[1]


def flu_from_device_vector(vector: FloatArray) -> FloatArray:
    """Return vectors (forward, left, up), shape (..., 3), from vectors (forward, up, right).

    Example:
        >>> print(flu_from_device_vector([1.0, 3.0, -2.0]))  # 3 up and 2 to the left
        [1. 2. 3.]
    """
    vector_flu: FloatArray = np.asarray(vector, dtype=float) @ FLU_FROM_DEVICE.T
    return vector_flu


def enu_covariance(covariance_n: FloatArray) -> FloatArray:
    """Return a covariance about (East, North, Up), shape (..., 3, 3), from a covariance about (North, Up, East).

    Example:
        >>> print(np.diagonal(enu_covariance(np.diag([1.0, 2.0, 3.0]))))  # from North, Up, East
        [3. 1. 2.]
    """
    covariance_enu: FloatArray = ENU_FROM_HORIZON @ covariance_n @ ENU_FROM_HORIZON.T
    return covariance_enu


def horizon_covariance(covariance_enu: FloatArray) -> FloatArray:
    """Return a covariance about (North, Up, East), shape (..., 3, 3), from a covariance about (East, North, Up).

    Example:
        >>> print(np.diagonal(horizon_covariance(np.diag([3.0, 1.0, 2.0]))))  # from East, North, Up
        [1. 2. 3.]
    """
    covariance_n: FloatArray = ENU_FROM_HORIZON.T @ covariance_enu @ ENU_FROM_HORIZON
    return covariance_n


def _axes(convention: str) -> tuple[FloatArray, FloatArray]:
    if convention == "enu_flu":
        return ENU_FROM_HORIZON, FLU_FROM_DEVICE
    if convention == "ned_frd":
        return NED_FROM_HORIZON, FRD_FROM_DEVICE
    raise ValueError(f"axes convention {convention!r} is unknown: expected 'enu_flu' or 'ned_frd'")


def _quaternion_of_one(matrix: FloatArray) -> FloatArray:
    quaternion: FloatArray = compiled_rotations.quaternions(matrix[None])[0]
    return quaternion


def _quaternion_from_matrix(matrix: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w (w >= 0) of matrices, each computed from the quaternion's largest component."""
    diagonal = np.einsum("...ii->...i", matrix)
    trace = diagonal.sum(axis=-1, keepdims=True)
    # Four times the products of all pairs of components of the quaternion.
    products = np.empty((*matrix.shape[:-2], 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., i, i] = 1.0 - trace[..., 0] + 2.0 * diagonal[..., i]
        products[..., i, j] = products[..., j, i] = matrix[..., j, i] + matrix[..., i, j]
        products[..., i, 3] = products[..., 3, i] = matrix[..., k, j] - matrix[..., j, k]
    products[..., 3, 3] = 1.0 + trace[..., 0]
    largest = np.argmax(np.concatenate([diagonal, trace], axis=-1), axis=-1)
    quaternion = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion /= np.sqrt(np.sum(quaternion**2, axis=-1, keepdims=True))
    quaternion *= np.copysign(1.0, quaternion[..., 3:])
    return quaternion


def _matrix_of_one(quaternion: FloatArray) -> FloatArray:
    matrix: FloatArray = compiled_rotations.rotations_of(quaternion[None])[0]
    return matrix

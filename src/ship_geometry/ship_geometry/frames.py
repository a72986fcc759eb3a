"""Orientation of a device frame in its parent frame, and conversion between the axes of the suite and of ROS.

The suite uses the parent axes North, Up, East and the device axes forward, up, right. The angles of an orientation are
azimuth (clockwise seen from above, from the parent's forward axis), elevation (up positive) and roll (right side down
positive). All functions of angles accept leading dimensions. Formulas: [Z14] (1)-(3), [P15] (17)-(19),
docs/explanation/frames.md.

ROS (REP-103) uses the parent axes East, North, Up and the device axes forward, left, up. The axes differ by fixed
permutations with signs. ROS yaw = 90° - heading, ROS pitch = -pitch, ROS roll = roll. "ENU <- FLU" is a rotation that
transforms FLU vectors into ENU vectors. Quaternions are ordered x, y, z, w. No other module converts axes.
"""

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_rotations

SINGULAR_ELEVATION = np.deg2rad(89.9)
"""Magnitude of the elevation beyond which the covariance of the angles is NaN, rad.

Azimuth and roll cannot be separated there."""

ENU_FROM_HORIZON = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation "(East, North, Up) from (North, Up, East)"."""

FLU_FROM_DEVICE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation "(forward, left, up) from (forward, up, right)"."""

NED_FROM_HORIZON = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation "(North, East, Down) from (North, Up, East)"."""

FRD_FROM_DEVICE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation "(forward, right, down) from (forward, up, right)"."""


def rotation_from_angles(
    azimuth: float | FloatArray, elevation: float | FloatArray, roll: float | FloatArray
) -> FloatArray:
    """Return the rotation "parent from device", shape (..., 3, 3): Ry(A) Rz(-E) Rx(-roll), multiplied out.

    Example:
        A ship heading East with her bow 5° up: the bow's direction (North, Up, East) is the first column.

        >>> rotation_nd = rotation_from_angles(*np.deg2rad([90.0, 5.0, 0.0]))
        >>> print(rotation_nd[:, 0].round(4))
        [0.     0.0872 0.9962]
    """
    if isinstance(azimuth, float) and isinstance(elevation, float) and isinstance(roll, float):
        of_one: FloatArray = compiled_rotations.rotations(np.array([[azimuth, elevation, roll]]))[0]
        return of_one
    angles = np.stack(np.broadcast_arrays(azimuth, elevation, roll), axis=-1).astype(float, copy=False)
    of_all: FloatArray = compiled_rotations.rotations(angles.reshape(-1, 3)).reshape(*angles.shape, 3)
    return of_all


def angles_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return azimuth in [0, 2 pi), elevation in [-pi/2, pi/2] and roll in [-pi, pi] (rad), shape (..., 3).

    At the zenith and the nadir only the sum, or the difference, of azimuth and roll is defined. The returned angles are
    one solution; :func:`rotation_from_angles` returns the same rotation from them.

    Example:
        >>> rotation_nd = rotation_from_angles(*np.deg2rad([359.0, 5.0, -3.0]))
        >>> print(np.rad2deg(angles_from_rotation(rotation_nd)).round(6))  # heading, pitch, roll
        [359.   5.  -3.]
    """
    angles: FloatArray = compiled_rotations.angles(rotation.reshape(-1, 3, 3)).reshape(rotation.shape[:-1])
    return angles


def rotation_vector_from_angle_errors(azimuth: float | FloatArray, elevation: float | FloatArray) -> FloatArray:
    """Return the matrix B, shape (..., 3, 3), with ``delta = B @ [dA, dE, droll]``; delta is in the parent frame.

    Example:
        An azimuth error of one degree is a rotation by -1° about Up, at any elevation:

        >>> matrix = rotation_vector_from_angle_errors(np.deg2rad(30.0), np.deg2rad(60.0))
        >>> print(matrix @ [1.0, 0.0, 0.0])
        [ 0. -1.  0.]
    """
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, float), np.asarray(elevation, float))
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    matrix = np.zeros((*ca.shape, 3, 3))
    matrix[..., 1, 0] = -1.0
    matrix[..., 0, 1] = -sa
    matrix[..., 2, 1] = ca
    matrix[..., 0, 2] = ca * ce
    matrix[..., 1, 2] = se
    matrix[..., 2, 2] = sa * ce
    return matrix


def angle_errors_from_rotation_vector(azimuth: FloatArray | float, elevation: FloatArray | float) -> FloatArray:
    """Return the inverse of the matrix B of :func:`rotation_vector_from_angle_errors`, shape (..., 3, 3).

    The result is NaN beyond :data:`SINGULAR_ELEVATION`.

    Example:
        A sensor looks North at 60° elevation. A tilt by 20″ about North changes its azimuth by 35″ (20″ tan 60°):

        >>> matrix = angle_errors_from_rotation_vector(0.0, np.deg2rad(60.0))
        >>> print((matrix @ [20.0, 0.0, 0.0]).round(1))  # azimuth, elevation, roll, in arcseconds
        [34.6  0.  40. ]
    """
    if isinstance(azimuth, float) and isinstance(elevation, float):
        errors: FloatArray = compiled_rotations.angle_errors(azimuth, elevation, SINGULAR_ELEVATION)
        return errors
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, float), np.asarray(elevation, float))
    ca, sa = np.cos(azimuth), np.sin(azimuth)
    regular = np.abs(elevation) <= SINGULAR_ELEVATION
    ce = np.where(regular, np.cos(elevation), np.nan)
    tangent = np.sin(elevation) / ce
    matrix = np.zeros((*ca.shape, 3, 3))
    matrix[..., 0, 0] = ca * tangent
    matrix[..., 0, 1] = -1.0
    matrix[..., 0, 2] = sa * tangent
    matrix[..., 1, 0] = -sa
    matrix[..., 1, 2] = ca
    matrix[..., 2, 0] = ca / ce
    matrix[..., 2, 2] = sa / ce
    return np.where(regular[..., None, None], matrix, np.nan)


def angle_covariance(covariance_parent: FloatArray, azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return the covariance of (azimuth, elevation, roll), rad², from the covariance of the rotation vector.

    The rotation vector is in the parent frame. The result is NaN beyond :data:`SINGULAR_ELEVATION`.

    Example:
        At 45° elevation, an attitude with a sigma of 3″ about each axis has a sigma of √2 · 3″ in azimuth and roll:

        >>> covariance = angle_covariance(9.0 * np.eye(3), 0.0, np.deg2rad(45.0))  # arcsec²
        >>> print(np.sqrt(np.diagonal(covariance)).round(2))
        [4.24 3.   4.24]
    """
    transport = angle_errors_from_rotation_vector(azimuth, elevation)
    return transport @ covariance_parent @ np.swapaxes(transport, -1, -2)


def rotation_vector_covariance(
    covariance_angles: FloatArray, azimuth: float | FloatArray, elevation: float | FloatArray
) -> FloatArray:
    """Return the covariance of the rotation vector in the parent frame, rad², from a covariance of the angles.

    The order of the angles is azimuth, elevation, roll.

    Example:
        A level ship heading North has sigmas of 72″ in heading and of 10″ in pitch and roll. The sigmas of the rotation
        vector about (North, Up, East) are:

        >>> covariance_n = rotation_vector_covariance(np.diag([72.0, 10.0, 10.0]) ** 2, 0.0, 0.0)  # arcsec²
        >>> print(np.sqrt(np.diagonal(covariance_n)).round(1))
        [10. 72. 10.]
    """
    transport = rotation_vector_from_angle_errors(azimuth, elevation)
    return transport @ covariance_angles @ np.swapaxes(transport, -1, -2)


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
    (matrix,) = compiled_rotations.rotations_of(np.asarray(quaternion, dtype=float)[None])
    rotation_cs: FloatArray = matrix @ FLU_FROM_DEVICE
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

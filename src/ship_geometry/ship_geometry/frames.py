"""Orientation of a device frame (forward, up, right) in its parent frame: angles, rotation matrix and covariances.

The angles are azimuth (clockwise seen from above, from the parent's forward axis), elevation (up positive) and roll
(right side down positive). All functions accept leading dimensions. Formulas: [Z14] (1)-(3), [P15] (17)-(19),
docs/explanation/frames.md.
"""

import numpy as np

from ship_geometry.rotations import FloatArray, wrap_two_pi
from ship_kernels import compiled_rotations

SINGULAR_ELEVATION = np.deg2rad(89.9)
"""Magnitude of the elevation beyond which the covariance of the angles is NaN, rad.

Azimuth and roll cannot be separated there."""


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
    ca, sa = np.cos(azimuth), np.sin(azimuth)
    ce, se = np.cos(elevation), np.sin(elevation)
    cr, sr = np.cos(roll), np.sin(roll)
    rotation = np.empty((*np.broadcast(ca, ce, cr).shape, 3, 3))
    rotation[..., 0, 0] = ca * ce
    rotation[..., 0, 1] = -ca * se * cr - sa * sr
    rotation[..., 0, 2] = ca * se * sr - sa * cr
    rotation[..., 1, 0] = se
    rotation[..., 1, 1] = ce * cr
    rotation[..., 1, 2] = -ce * sr
    rotation[..., 2, 0] = sa * ce
    rotation[..., 2, 1] = -sa * se * cr + ca * sr
    rotation[..., 2, 2] = sa * se * sr + ca * cr
    return rotation


def angles_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return azimuth in [0, 2 pi), elevation in [-pi/2, pi/2] and roll in [-pi, pi] (rad), shape (..., 3).

    At the zenith and the nadir only the sum, or the difference, of azimuth and roll is defined. The returned angles are
    one solution; :func:`rotation_from_angles` returns the same rotation from them.

    Example:
        >>> rotation_nd = rotation_from_angles(*np.deg2rad([359.0, 5.0, -3.0]))
        >>> print(np.rad2deg(angles_from_rotation(rotation_nd)).round(6))  # heading, pitch, roll
        [359.   5.  -3.]
    """
    if rotation.ndim == 2:
        angles: FloatArray = compiled_rotations.angles(rotation[None])[0]
        return angles
    azimuth = wrap_two_pi(np.arctan2(rotation[..., 2, 0], rotation[..., 0, 0]))
    # atan2 keeps full precision near the zenith, where an arcsine would not.
    horizontal = np.hypot(rotation[..., 0, 0], rotation[..., 2, 0])
    elevation = np.arctan2(rotation[..., 1, 0], horizontal)
    # Roll is computed from the azimuth. The usual atan2(-R23, R22) fails at the zenith, where both elements vanish.
    ca, sa = np.cos(azimuth), np.sin(azimuth)
    sine = ca * rotation[..., 2, 1] - sa * rotation[..., 0, 1]
    cosine = ca * rotation[..., 2, 2] - sa * rotation[..., 0, 2]
    return np.stack([azimuth, elevation, np.arctan2(sine, cosine)], axis=-1)


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

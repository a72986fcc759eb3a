"""Rotation vectors and rotation matrices: exponential, its left Jacobian, and logarithm.

All functions accept any number of leading dimensions: a rotation vector has shape (..., 3), a matrix (..., 3, 3). A
single vector or matrix is converted by :mod:`ship_kernels.compiled_rotations`. Formulas: Sola, Deray, Atchuthan, "A
micro Lie theory" (2018), section on SO(3).
"""

import math

import numpy as np

from ship_kernels import FloatArray as FloatArray
from ship_kernels import compiled_rotations

ARCSEC = np.pi / (180.0 * 3600.0)
"""One arcsecond in radians."""

# [v x] is linear in v. Each row has the nine elements of [v x], row by row, for one unit vector v.
_SKEW = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)

# Angle (rad) below which the series are exact to the last bit of a double.
_SMALL_ANGLE = 1e-4


def wrap_pi(angle: FloatArray | float) -> FloatArray:
    """Return an angle (rad) wrapped to [-pi, pi).

    Example:
        >>> print(np.rad2deg(wrap_pi(np.deg2rad([190.0, -190.0, 180.0]))).round(6))
        [-170.  170. -180.]
    """
    wrapped = (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi
    # The remainder of an angle just below -pi is rounded up to 2 pi.
    return np.where(wrapped == np.pi, -np.pi, wrapped)[()]


def wrap_two_pi(angle: FloatArray | float) -> FloatArray:
    """Return an angle (rad) wrapped to [0, 2 pi).

    Example:
        >>> print(np.rad2deg(wrap_two_pi(np.deg2rad([-10.0, 370.0]))).round(6))
        [350.  10.]
    """
    wrapped = np.asarray(angle, dtype=float) % (2.0 * np.pi)
    # The remainder of a tiny negative angle is rounded up to 2 pi.
    return np.where(wrapped == 2.0 * np.pi, 0.0, wrapped)[()]


def skew(vector: FloatArray) -> FloatArray:
    """Return the matrix [v x] with ``skew(v) @ w == cross(v, w)``, shape (..., 3, 3).

    Example:
        >>> north, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
        >>> print(skew(north) @ up)  # North × Up = East
        [0. 0. 1.]
    """
    vector = np.asarray(vector, dtype=float)
    matrix: FloatArray = (vector @ _SKEW).reshape(*vector.shape, 3)
    return matrix


def _sinc_coefficients(angle_squared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sin t / t, (1 - cos t) / t² and (t - sin t) / t³ for a given t²."""
    small = angle_squared < _SMALL_ANGLE**2
    t2 = np.where(small, 1.0, angle_squared)
    t = np.sqrt(t2)
    sin_t = np.sin(t)
    half_sine = np.sin(0.5 * t)
    first = np.where(small, 1.0 - angle_squared / 6.0, sin_t / t)
    second = np.where(small, 0.5 - angle_squared / 24.0, 2.0 * half_sine * half_sine / t2)
    third = np.where(small, 1.0 / 6.0 - angle_squared / 120.0, (t - sin_t) / (t2 * t))
    return first, second, third


def _polynomial(vector: FloatArray, linear: FloatArray, quadratic: FloatArray) -> FloatArray:
    """Return identity + linear [v x] + quadratic [v x]²."""
    matrix = skew(vector)
    return np.eye(3) + linear[..., None, None] * matrix + quadratic[..., None, None] * (matrix @ matrix)


def exp_rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector (rad), shape (..., 3, 3).

    Example:
        A rotation by 30° about Up turns North towards West; positive rotations are counter-clockwise from above:

        >>> up, north = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        >>> print((exp_rotation(np.deg2rad(30.0) * up) @ north).round(3))
        [ 0.866  0.    -0.5  ]
    """
    vector = np.asarray(vector, dtype=float)
    if vector.ndim == 1:
        rotation: FloatArray = compiled_rotations.exponential(vector)
        return rotation
    firsts, seconds, _ = _sinc_coefficients(np.sum(vector * vector, axis=-1))
    return _polynomial(vector, firsts, seconds)


def left_jacobian(vector: FloatArray) -> FloatArray:
    """Return J with ``exp(v + dv) = exp(J dv) exp(v)`` to first order in dv, shape (..., 3, 3).

    The transpose of J is the right Jacobian J_r, with ``exp(v + dv) = exp(v) exp(J_r dv)``.

    Example:
        >>> vector, change = np.array([0.3, -0.2, 0.5]), 1e-6 * np.array([1.0, 2.0, -1.0])
        >>> stepped = exp_rotation(left_jacobian(vector) @ change) @ exp_rotation(vector)
        >>> print(bool(np.allclose(stepped, exp_rotation(vector + change), rtol=0.0, atol=1e-11)))
        True
    """
    vector = np.asarray(vector, dtype=float)
    if vector.ndim == 1:
        jacobian: FloatArray = compiled_rotations.jacobian(vector)
        return jacobian
    _, seconds, thirds = _sinc_coefficients(np.sum(vector * vector, axis=-1))
    return _polynomial(vector, seconds, thirds)


def log_rotation(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector (rad, norm at most pi) of a rotation matrix, shape (..., 3).

    The result is accurate for all angles. The vector is computed from the antisymmetric part of the matrix; near half a
    turn the axis is computed from the symmetric part.

    Example:
        >>> vector = np.deg2rad([10.0, -20.0, 30.0])
        >>> print(np.rad2deg(log_rotation(exp_rotation(vector))).round(6))
        [ 10. -20.  30.]
    """
    rotation = np.asarray(rotation, dtype=float)
    if rotation.ndim == 2:
        vector: FloatArray = compiled_rotations.logarithm(rotation)
        return vector
    twice_sine = np.empty(rotation.shape[:-1])
    twice_sine[..., 0] = rotation[..., 2, 1] - rotation[..., 1, 2]
    twice_sine[..., 1] = rotation[..., 0, 2] - rotation[..., 2, 0]
    twice_sine[..., 2] = rotation[..., 1, 0] - rotation[..., 0, 1]
    sine = 0.5 * np.sqrt(np.sum(twice_sine * twice_sine, axis=-1))
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < _SMALL_ANGLE
    scale = np.where(small, 1.0 + sine * sine / 6.0, angle / np.where(small, 1.0, sine))
    vector = 0.5 * scale[..., None] * twice_sine
    near_half_turn = cosine < -0.9
    if np.any(near_half_turn):
        vector = np.where(near_half_turn[..., None], _log_near_half_turn(rotation, twice_sine, angle), vector)
    return vector


def _log_near_half_turn(rotation: FloatArray, twice_sine: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the rotation vector for an angle t near pi; its axis n follows from the symmetric part of the matrix R.

    R + R^T = 2 cos t I + 2 (1 - cos t) n n^T
    """
    symmetric = 0.5 * (rotation + np.swapaxes(rotation, -1, -2))
    outer = symmetric - np.cos(angle)[..., None, None] * np.eye(3)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    norm = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = axis / np.where(norm == 0.0, 1.0, norm)
    sign = np.where(np.sum(axis * twice_sine, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return angle[..., None] * sign * axis


def vector_length(vector: FloatArray) -> float:
    """Return the length of a vector of a few components, five times as fast as the norm of an array.

    Example:
        >>> vector_length(np.array([3.0, 4.0, 0.0]))
        5.0
    """
    return math.hypot(*vector.tolist())


def angle_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angle (rad) between vectors of shape (..., 3), accurate for small angles.

    The formula is Kahan's ``2 atan2(|a/|a| - b/|b||, |a/|a| + b/|b||)``; an arccosine would have errors of arcseconds.

    Example:
        >>> star, neighbour = np.array([1.0, 0.0, 0.0]), np.array([1.0, 3.0 * ARCSEC, 0.0])
        >>> print(f"{angle_between(star, neighbour) / ARCSEC:.6f} arcsec")
        3.000000 arcsec
    """
    a = first / np.linalg.norm(first, axis=-1, keepdims=True)
    b = second / np.linalg.norm(second, axis=-1, keepdims=True)
    angle: FloatArray = 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return angle

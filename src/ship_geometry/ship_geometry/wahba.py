"""Wahba's problem: the rotation between two frames from directions known in both, with its covariance.

The rotation R minimises  ½ Σ σᵢ⁻² |vᵢ − R uᵢ|²,  where vᵢ are reference directions (n) and uᵢ measured directions (d).
R is computed by the singular value decomposition of B = Σ σᵢ⁻² vᵢ uᵢᵀ (Markley 1988). If each direction has one error
σᵢ in both axes across the line of sight, R is the maximum-likelihood attitude with covariance (Σ σᵢ⁻² (I − vᵢ vᵢᵀ))⁻¹.

All functions accept leading dimensions: many attitudes at once, with the same number of directions each.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_geometry.late_libraries import lapack
from ship_geometry.rotations import FloatArray

WORST_SIGMA = np.deg2rad(1.0)
"""Maximum standard deviation about the worst axis, rad; beyond this maximum an attitude counts as not solved.

The covariance is valid for small errors only."""

_IDENTITY = np.eye(3)

_DIAGONAL_OF_3_BY_3 = slice(None, None, 4)
"""Slice for the diagonal of a flattened matrix (3, 3)."""


@dataclass(frozen=True)
class WahbaSolution:
    """Rotations with their covariance; the leading dimensions are equal to those of the input.

    Attributes:
        rotation_nd: rotation "n from d", shape (..., 3, 3); NaN if not solved.
        covariance_n: covariance of the rotation vector δ in n, ``R_true = exp(δ) R``, rad², shape (..., 3, 3); NaN
            if not solved.
        information_n: information matrix Σ σ⁻² (I − v vᵀ), rad⁻², shape (..., 3, 3), also if not solved.
        solved: True if the standard deviation about every axis is below :data:`WORST_SIGMA`, shape (...). One
            direction, or nearly parallel directions, do not determine the rotation about their line.
    """

    rotation_nd: FloatArray
    covariance_n: FloatArray
    information_n: FloatArray
    solved: NDArray[np.bool_] | np.bool_


def solve(reference_n: FloatArray, measured_d: FloatArray, sigma: FloatArray | float) -> WahbaSolution:
    """Return the rotation that best transforms the measured directions into the reference directions.

    Args:
        reference_n: reference directions, unit vectors, shape (..., k, 3).
        measured_d: measured directions, unit vectors, shape (..., k, 3).
        sigma: standard deviation of each direction across the line of sight, rad per axis, shape (..., k), or one
            value for all directions. A direction with infinite sigma is not used.

    Raises:
        numpy.linalg.LinAlgError: a direction is not finite, or a sigma is zero or NaN.

    Example:
        Two stars at right angles, each with a sigma of 3″; the deck is rotated by 90° against the horizon:

        >>> reference_n = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> rotation_nd = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

        >>> solution = solve(reference_n, reference_n @ rotation_nd, np.deg2rad(3.0 / 3600.0))
        >>> print(np.allclose(solution.rotation_nd, rotation_nd, atol=1e-15))
        True

        >>> print((np.rad2deg(np.sqrt(np.diagonal(solution.covariance_n))) * 3600.0).round(2))  # arcseconds
        [3.   3.   2.12]
    """
    if reference_n.ndim == 2:
        weight = 1.0 / np.square(sigma)
        return _solve_one(reference_n, measured_d, weight if weight.ndim else np.full(len(reference_n), weight))
    weight = np.asarray(sigma, dtype=float) ** -2.0
    weighted = np.swapaxes(weight[..., None] * reference_n, -1, -2)
    outer = weighted @ reference_n
    # The trace of Σ w v vᵀ is Σ w.
    information_n = np.einsum("...ii", outer)[..., None, None] * _IDENTITY - outer

    left, singular, right = np.linalg.svd(weighted @ measured_d)
    rotation_nd = left @ right
    # If the best orthogonal matrix is a reflection (determinant -1), reversing the axis of the smallest singular value
    # gives the best rotation.
    handedness = np.copysign(1.0, np.linalg.det(rotation_nd))
    if np.any(handedness < 0.0):
        left[..., :, 2] *= handedness[..., None]
        rotation_nd = left @ right
    # The information about the worst axis vanishes for parallel directions. It also vanishes for directions so
    # inconsistent that two rotations fit equally well, which information_n does not show.
    worst_information = singular[..., 1] + handedness * singular[..., 2]
    solved = worst_information > WORST_SIGMA**-2.0
    if np.all(solved):
        return WahbaSolution(rotation_nd, np.linalg.inv(information_n), information_n, solved)
    undetermined = ~solved[..., None, None]
    covariance_n = np.linalg.inv(np.where(undetermined, _IDENTITY, information_n))
    return WahbaSolution(
        rotation_nd=np.where(undetermined, np.nan, rotation_nd),
        covariance_n=np.where(undetermined, np.nan, covariance_n),
        information_n=information_n,
        solved=solved,
    )


def _solve_one(reference_n: FloatArray, measured_d: FloatArray, weight: FloatArray) -> WahbaSolution:
    """Return :func:`solve` for one attitude, several times faster; a live node solves single attitudes."""
    weighted = (weight[:, None] * reference_n).T
    information_n = weighted @ -reference_n
    # The trace of Σ w v vᵀ is Σ w.
    information_n.ravel()[_DIAGONAL_OF_3_BY_3] -= information_n.trace()
    left, singular, right, failed = lapack.dgesdd(weighted @ measured_d)
    if failed:
        raise np.linalg.LinAlgError("SVD did not converge: a direction is not finite, or a sigma is zero or NaN")
    rotation_nd = left @ right
    (a, b, c), (d, e, f), (g, h, i) = rotation_nd.tolist()
    handedness = math.copysign(1.0, a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
    if handedness < 0.0:
        left[:, 2] *= handedness
        rotation_nd = left @ right
    if singular[1] + handedness * singular[2] > WORST_SIGMA**-2.0:
        return WahbaSolution(rotation_nd, _inverse(information_n), information_n, np.True_)
    unknown = np.full((3, 3), np.nan)
    return WahbaSolution(unknown, unknown, information_n, np.False_)


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse of one symmetric positive definite matrix, shape (3, 3)."""
    lower, failed = lapack.dpotrf(information, lower=1)
    if failed:
        raise np.linalg.LinAlgError("information is not positive definite")
    inverse: FloatArray = lapack.dpotri(lower, lower=1)[0]
    # dpotri fills the lower triangle only.
    inverse[0, 1], inverse[0, 2], inverse[1, 2] = inverse[1, 0], inverse[2, 0], inverse[2, 1]
    return inverse

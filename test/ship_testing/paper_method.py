"""Method of [W18] for the telescope's attitude from two lights, for comparison with the method of ``theodolite_calib``.
"""

import numpy as np

from ship_geometry.rotations import FloatArray


def triad(first_n: FloatArray, second_n: FloatArray, first_t: FloatArray, second_t: FloatArray) -> FloatArray:
    """Return "n from t", shape (..., 3, 3), in which the first of two directions is exact."""
    return _orthonormal(first_n, second_n) @ np.swapaxes(_orthonormal(first_t, second_t), -1, -2)


def mean_of_two_triads(direction_n: FloatArray, direction_t: FloatArray) -> FloatArray:
    """Return the mean of two TRIADs, each exact for another light, orthogonalised once: [W18] (14)-(22).

    Equation (22) is used as corrected in models.md §5: K* = ½ K (3 I - Kᵀ K).

    Args:
        direction_n: lines of sight of two lights, unit vectors, shape (..., 2, 3).
        direction_t: the same in the telescope frame, by the nominal focal length, shape (..., 2, 3).
    """
    (first_n, second_n), (first_t, second_t) = np.moveaxis(direction_n, -2, 0), np.moveaxis(direction_t, -2, 0)
    mean = 0.5 * (triad(first_n, second_n, first_t, second_t) + triad(second_n, first_n, second_t, first_t))
    return 0.5 * mean @ (3.0 * np.eye(3) - np.swapaxes(mean, -1, -2) @ mean)


def angles(rotation_nt: FloatArray) -> FloatArray:
    """Return azimuth, elevation, image rotation, rad, shape (..., 3), by [W18] (23) with atan2, models.md §5."""
    return np.stack(
        [
            np.arctan2(rotation_nt[..., 2, 0], rotation_nt[..., 0, 0]),
            np.arcsin(rotation_nt[..., 1, 0]),
            np.arctan2(-rotation_nt[..., 1, 2], rotation_nt[..., 1, 1]),
        ],
        axis=-1,
    )


def _orthonormal(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return as columns the first direction, the unit normal to both directions, and first direction × normal."""
    normal = np.cross(first, second)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([first, normal, np.cross(first, normal)], axis=-1)

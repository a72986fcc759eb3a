"""[W18]'s method for the telescope's attitude from two lights: what the default method is compared with."""

import numpy as np

from ship_geometry.rotations import FloatArray


def triad(first_n: FloatArray, second_n: FloatArray, first_t: FloatArray, second_t: FloatArray) -> FloatArray:
    """Rotation "n from t", shape (..., 3, 3), that holds the first of two directions exactly."""
    return _orthonormal(first_n, second_n) @ np.swapaxes(_orthonormal(first_t, second_t), -1, -2)


def mean_of_two_triads(direction_n: FloatArray, direction_t: FloatArray) -> FloatArray:
    """[W18] (14)-(22): mean of the TRIADs that hold the one light and the other, made orthogonal by one step.

    (22) as it must read: K* = ½ K (3 I - Kᵀ K), models.md §5.

    Args:
        direction_n: lines of sight of two lights, unit vectors, shape (..., 2, 3).
        direction_t: the same in the telescope frame, by the nominal focal length, shape (..., 2, 3).
    """
    (first_n, second_n), (first_t, second_t) = np.moveaxis(direction_n, -2, 0), np.moveaxis(direction_t, -2, 0)
    mean = 0.5 * (triad(first_n, second_n, first_t, second_t) + triad(second_n, first_n, second_t, first_t))
    return 0.5 * mean @ (3.0 * np.eye(3) - np.swapaxes(mean, -1, -2) @ mean)


def angles(rotation_nt: FloatArray) -> FloatArray:
    """[W18] (23) with atan2, models.md §5: azimuth, elevation, image rotation, rad, shape (..., 3)."""
    return np.stack(
        [
            np.arctan2(rotation_nt[..., 2, 0], rotation_nt[..., 0, 0]),
            np.arcsin(rotation_nt[..., 1, 0]),
            np.arctan2(-rotation_nt[..., 1, 2], rotation_nt[..., 1, 1]),
        ],
        axis=-1,
    )


def _orthonormal(first: FloatArray, second: FloatArray) -> FloatArray:
    """Columns: the first direction, the normal of both, and what completes them."""
    normal = np.cross(first, second)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([first, normal, np.cross(first, normal)], axis=-1)

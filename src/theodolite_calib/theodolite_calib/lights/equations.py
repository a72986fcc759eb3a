"""The equations of one image: residuals of the points with their Jacobians and joint covariance at a trial attitude.

The image is as good as linear in all but the attitude, so the focal length and the errors of the lines of sight are
integrated out exactly: with their priors they are part of the covariance of the residuals,

    S = σ² I  +  F Σ_w Fᵀ  +  σ_f² p_f p_fᵀ          detection, joint errors of the directions, focal length

A prior attitude is one more measurement, of three components.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, left_jacobian, log_rotation
from theodolite_calib.lights.image import Camera
from theodolite_calib.lights.light_points import Image, predict_points
from theodolite_calib.lights.line_of_sight import block_diagonal


@dataclass(frozen=True)
class AttitudePrior:
    """What is known of the telescope's attitude without the lights.

    Its errors count as independent of those of the lines of sight: the ship's attitude is in both, but with a lever of
    10 m at 2 km it enters these 200 times less.

    Attributes:
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        parts_n: covariance of its rotation vector in n by source, rad², shape (..., 3, 3) each.
    """

    rotation_nt: FloatArray
    parts_n: Mapping[str, FloatArray]

    @property
    def covariance_n(self) -> FloatArray:
        """Their sum, rad², shape (..., 3, 3)."""
        return total(self.parts_n)


@dataclass(frozen=True)
class Equations:
    """residual = jacobian @ δ + noise: first the points (2 N rows), then the prior attitude (3 rows) if there is one.

    Attributes:
        residual: shape (..., m).
        jacobian: H by the attitude, shape (..., m, 3).
        by_directions: of the points' rows by all directions, shape (..., 2 N, 3 N).
        by_focal_length: of the points' rows, shape (..., 2 N).
        inverse: S⁻¹, shape (..., m, m).
        weighted_jacobian: Hᵀ S⁻¹, shape (..., 3, m).
    """

    residual: FloatArray
    jacobian: FloatArray
    by_directions: FloatArray
    by_focal_length: FloatArray
    inverse: FloatArray
    weighted_jacobian: FloatArray


def total(parts: Mapping[str, FloatArray]) -> FloatArray:
    """Covariance of an error budget."""
    return np.sum(np.stack(np.broadcast_arrays(*parts.values())), axis=0)


def linearised(
    image: Image,
    camera: Camera,
    direction_n: FloatArray,
    line_covariance: FloatArray,
    rotation_nt: FloatArray,
    prior: AttitudePrior | None,
) -> Equations:
    """The equations at a trial attitude.

    Args:
        image: N lights on the detector.
        camera: geometry of the telescope.
        direction_n: where the same lights are seen, unit vectors, shape (..., N, 3).
        line_covariance: joint covariance of these directions, rad², shape (..., 3 N, 3 N).
        rotation_nt: the trial, shape (..., 3, 3).
        prior: attitude known beforehand.
    """
    predicted = predict_points(camera, rotation_nt, direction_n)
    rows = 2 * direction_n.shape[-2]
    leading = predicted.point_m.shape[:-2]
    residual = (image.point_m - predicted.point_m).reshape(*leading, rows)
    jacobian = predicted.by_attitude_n.reshape(*leading, rows, 3)
    by_directions = block_diagonal(predicted.by_direction_n)
    by_focal_length = predicted.by_focal_length.reshape(*leading, rows)
    of_focal_length = np.asarray(camera.focal_length_sigma_m, dtype=float)[..., None] * by_focal_length
    covariance = by_directions @ line_covariance @ np.swapaxes(by_directions, -1, -2)
    covariance = covariance + of_focal_length[..., :, None] * of_focal_length[..., None, :]
    covariance = covariance + image.covariance_m2
    inverse = np.asarray(np.linalg.inv(covariance), dtype=float)
    if prior is not None:
        # log(exp(δ) R R_priorᵀ) = d + J⁻¹ δ is an error drawn from the prior's covariance.
        departure = log_rotation(rotation_nt @ np.swapaxes(prior.rotation_nt, -1, -2))
        residual = np.concatenate([residual, -departure], axis=-1)
        jacobian = np.concatenate([jacobian, np.linalg.inv(left_jacobian(departure))], axis=-2)
        inverse = _joined(inverse, np.asarray(np.linalg.inv(prior.covariance_n), dtype=float))
    weighted_jacobian = np.swapaxes(jacobian, -1, -2) @ inverse
    return Equations(residual, jacobian, by_directions, by_focal_length, inverse, weighted_jacobian)


def _joined(first: FloatArray, second: FloatArray) -> FloatArray:
    """Block diagonal of two matrices of different size."""
    m, n = first.shape[-1], second.shape[-1]
    matrix = np.zeros((*first.shape[:-2], m + n, m + n))
    matrix[..., :m, :m] = first
    matrix[..., m:, m:] = second
    return matrix

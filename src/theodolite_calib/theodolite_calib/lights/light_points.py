"""What the image of known lights says of the telescope's attitude: predicted points with their Jacobians.

With R the attitude "horizon from telescope", R_true = exp(δ) R, a light seen along w (n) is at Rᵀ w in the telescope;
δ moves it there by Rᵀ (w × δ).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, skew
from theodolite_calib.lights.image import Camera
from theodolite_calib.lights.line_of_sight import block_diagonal


@dataclass(frozen=True)
class Image:
    """Lights found on the detector at the middle of an exposure.

    Attributes:
        point_m: (x right, z up), shape (..., N, 2).
        sigma_m: standard deviation of x and of z, each above zero, shape (..., N).
        smear_m2: what the motion during the exposure adds to their covariance, shape (..., N, 2, 2); None where it adds
            nothing.
    """

    point_m: FloatArray
    sigma_m: FloatArray
    smear_m2: FloatArray | None = None

    @property
    def covariance_m2(self) -> FloatArray:
        """Covariance of all points as detected, shape (..., 2 N, 2 N)."""
        variance = np.repeat(np.asarray(self.sigma_m, dtype=float) ** 2, 2, axis=-1)
        covariance: FloatArray = variance[..., None] * np.eye(variance.shape[-1])
        return covariance if self.smear_m2 is None else covariance + block_diagonal(self.smear_m2)

    def chosen(self, rows: Sequence[int]) -> "Image":
        """The same lights, some of them or in another order."""
        chosen = list(rows)
        smear_m2 = None if self.smear_m2 is None else self.smear_m2[chosen]
        return Image(self.point_m[chosen], np.asarray(self.sigma_m)[chosen], smear_m2)


@dataclass(frozen=True)
class PredictedPoints:
    """Where lights should be found on the detector; NaN behind the telescope.

    Attributes:
        point_m: shape (..., N, 2).
        by_attitude_n: by the rotation vector of the telescope's attitude in n, m/rad, shape (..., N, 2, 3).
        by_direction_n: by the unit direction of the light in n, m/rad, shape (..., N, 2, 3).
        by_focal_length: m/m, shape (..., N, 2).
    """

    point_m: FloatArray
    by_attitude_n: FloatArray
    by_direction_n: FloatArray
    by_focal_length: FloatArray


def predict_points(camera: Camera, rotation_nt: FloatArray, direction_n: FloatArray) -> PredictedPoints:
    """Detector points of lights seen along ``direction_n`` by a telescope of the attitude ``rotation_nt``.

    Args:
        camera: its geometry.
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        direction_n: unit vectors, shape (..., N, 3).
    """
    direction_t = direction_n @ rotation_nt
    by_direction_n = camera.point_by_direction(direction_t) @ np.swapaxes(rotation_nt, -1, -2)[..., None, :, :]
    return PredictedPoints(
        point_m=camera.points(direction_t),
        by_attitude_n=by_direction_n @ skew(direction_n),
        by_direction_n=by_direction_n,
        by_focal_length=camera.point_by_focal_length(direction_t),
    )

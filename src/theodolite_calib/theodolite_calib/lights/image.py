"""The calibration telescope's camera: detector point ↔ direction in the telescope frame t (forward, up, right).

A detector point is (x, z) in metres along the telescope's right and up axes. The image is inverted, [W18] (12)(13):
a light to the right of and above the axis has x < 0 and z < 0, so with the principal point (x0, z0)

    V ∝ [f, -(z - z0), -(x - x0)]

Points have shape (..., N, 2) and directions (..., N, 3) for N lights of one exposure.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class Camera:
    """Geometry of the telescope's camera.

    Attributes:
        focal_length_m: shape (...), one for each exposure.
        focal_length_sigma_m: its standard deviation, shape (...); zero where it is held.
        principal_point_m: detector point (x0, z0) of the telescope's axis, shape (..., 1, 2) or (2,). It has no error
            of its own: it is what defines the axis, whose angles to the main axis have theirs.
    """

    focal_length_m: FloatArray | float
    focal_length_sigma_m: FloatArray | float
    principal_point_m: FloatArray

    def directions(self, point_m: FloatArray) -> FloatArray:
        """Unit vectors in the telescope frame, shape (..., N, 3), of detector points."""
        ray = self._rays(point_m)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    def points(self, direction_t: FloatArray) -> FloatArray:
        """Detector points, shape (..., N, 2), of directions of any length; NaN behind the telescope."""
        forward = _in_front(direction_t)
        scale = -_per_light(self.focal_length_m) / forward
        return self.principal_point_m + scale[..., None] * direction_t[..., [2, 1]]

    def point_by_direction(self, direction_t: FloatArray) -> FloatArray:
        """Change of the detector point (m) with the vector ``direction_t``, shape (..., N, 2, 3); NaN behind."""
        forward = _in_front(direction_t)
        per_focal_length = -_per_light(self.focal_length_m) / forward
        jacobian = np.zeros((*per_focal_length.shape, 2, 3))
        jacobian[..., 0, 2] = per_focal_length
        jacobian[..., 1, 1] = per_focal_length
        jacobian[..., 0, 0] = -per_focal_length * direction_t[..., 2] / forward
        jacobian[..., 1, 0] = -per_focal_length * direction_t[..., 1] / forward
        return jacobian

    def point_by_focal_length(self, direction_t: FloatArray) -> FloatArray:
        """Change of the detector point with the focal length, m/m, shape (..., N, 2); with the principal point: 1."""
        return -direction_t[..., [2, 1]] / _in_front(direction_t)[..., None]

    def direction_by_point(self, point_m: FloatArray) -> FloatArray:
        """Change of the direction with the detector point, rad/m, shape (..., N, 3, 2).

        By the principal point it is the same with the other sign.
        """
        across = self._across(point_m)
        return -across[..., [2, 1]]

    def direction_by_focal_length(self, point_m: FloatArray) -> FloatArray:
        """Change of the direction with the focal length, rad/m, shape (..., N, 3)."""
        return self._across(point_m)[..., 0]

    def direction_covariance(self, point_m: FloatArray, sigma_m: FloatArray | float) -> FloatArray:
        """Covariance of directions in the telescope frame, rad², shape (..., N, 3, 3): zero along the direction.

        Args:
            point_m: detector points, shape (..., N, 2).
            sigma_m: their standard deviation in x and in z, shape (..., N).
        """
        jacobian = self.direction_by_point(point_m) * np.asarray(sigma_m, dtype=float)[..., None, None]
        return jacobian @ np.swapaxes(jacobian, -1, -2)

    def _rays(self, point_m: FloatArray) -> FloatArray:
        offset = np.asarray(point_m, dtype=float) - self.principal_point_m
        focal_length_m = np.broadcast_to(_per_light(self.focal_length_m), offset.shape[:-1])
        return np.stack([focal_length_m, -offset[..., 1], -offset[..., 0]], axis=-1)

    def _across(self, point_m: FloatArray) -> FloatArray:
        """Change of the unit vector with the ray that it comes from, 1/m, shape (..., N, 3, 3)."""
        return unit_vector_jacobian(self._rays(point_m))


def unit_vector_jacobian(vector: FloatArray) -> FloatArray:
    """Change of v / |v| with v, (I - u uᵀ) / |v| with u = v / |v|, shape (..., 3, 3)."""
    length = np.linalg.norm(vector, axis=-1)[..., None, None]
    unit = vector[..., None] / length
    return (np.eye(3) - unit * np.swapaxes(unit, -1, -2)) / length


def _per_light(value: FloatArray | float) -> FloatArray:
    """A quantity of the exposure, shape (...), beside quantities of its lights, shape (..., N)."""
    return np.asarray(value, dtype=float)[..., None]


def _in_front(direction_t: FloatArray) -> FloatArray:
    forward = direction_t[..., 0]
    return np.where(forward > 0.0, forward, np.nan)

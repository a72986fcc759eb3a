"""Image of beacons on the detector of the calibration telescope: camera, detected and predicted points, streaks.

The camera relates a detector point to a direction in the telescope frame t (forward, up, right). A point is (x, z) in
metres along the telescope's right and up axes. The image is inverted, [W18] (12)(13): a light to the right of and above
the axis has x < 0 and z < 0. With the principal point (x0, z0) the direction is

    V ∝ [f, -(z - z0), -(x - x0)]

Points have shape (..., N, 2) and directions (..., N, 3) for N beacons of one exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.exposure_mean import Nodes
from ship_kernels import compiled_pointing


@dataclass(frozen=True)
class Camera:
    """Geometry of the telescope's camera.

    Attributes:
        focal_length_m: focal length for each exposure, shape (...).
        focal_length_sigma_m: standard deviation of the focal length, shape (...); zero if it is fixed.
        principal_point_m: detector point (x0, z0) of the telescope's axis, shape (..., 1, 2) or (2,). The point has no
            error, because it defines the telescope's axis; the angles from this axis to the main axis have errors.
    """

    focal_length_m: FloatArray | float
    focal_length_sigma_m: FloatArray | float
    principal_point_m: FloatArray

    def directions(self, point_m: FloatArray) -> FloatArray:
        """Return the directions of detector points, unit vectors in the telescope frame, shape (..., N, 3)."""
        ray = self._rays(point_m)
        direction_t: FloatArray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        return direction_t

    def points(self, direction_t: FloatArray) -> FloatArray:
        """Return the detector points of vectors of any length, shape (..., N, 2); NaN behind the telescope."""
        forward = direction_t[..., 0]
        scale = -_per_beacon(self.focal_length_m) / np.where(forward > 0.0, forward, np.nan)
        return self.principal_point_m + scale[..., None] * direction_t[..., [2, 1]]

    def direction_by_point(self, point_m: FloatArray) -> FloatArray:
        """Return the derivative of the direction with respect to the detector point, rad/m, shape (..., N, 3, 2).

        The derivative with respect to the principal point has the opposite sign.
        """
        across = self._direction_by_ray(point_m)
        return -across[..., [2, 1]]

    def direction_by_focal_length(self, point_m: FloatArray) -> FloatArray:
        """Return the derivative of the direction with respect to the focal length, rad/m, shape (..., N, 3)."""
        return self._direction_by_ray(point_m)[..., 0]

    def direction_covariance(self, point_m: FloatArray, sigma_m: FloatArray | float) -> FloatArray:
        """Return the covariance of directions in the telescope frame, zero along each direction, rad², (..., N, 3, 3).

        Args:
            point_m: detector points, shape (..., N, 2).
            sigma_m: standard deviation of the points in x and in z, shape (..., N).
        """
        jacobian = self.direction_by_point(point_m) * np.asarray(sigma_m, dtype=float)[..., None, None]
        covariance: FloatArray = jacobian @ np.swapaxes(jacobian, -1, -2)
        return covariance

    def _rays(self, point_m: FloatArray) -> FloatArray:
        offset = np.asarray(point_m, dtype=float) - self.principal_point_m
        focal_length_m = np.broadcast_to(_per_beacon(self.focal_length_m), offset.shape[:-1])
        return np.stack([focal_length_m, -offset[..., 1], -offset[..., 0]], axis=-1)

    def _direction_by_ray(self, point_m: FloatArray) -> FloatArray:
        """Return the derivative of the unit vector with respect to its ray, 1/m, shape (..., N, 3, 3)."""
        return unit_vector_jacobian(self._rays(point_m))


@dataclass(frozen=True)
class Image:
    """Beacons detected on the detector at the middle of an exposure.

    Attributes:
        point_m: detector points (x right, z up), shape (..., N, 2).
        sigma_m: standard deviation of x and of z, above zero, shape (..., N).
        smear_m2: covariance added by the motion during the exposure, m², shape (..., N, 2, 2); None if not known.
    """

    point_m: FloatArray
    sigma_m: FloatArray
    smear_m2: FloatArray | None = None

    @property
    def covariance_m2(self) -> FloatArray:
        """Joint covariance of all points, m², shape (..., 2 N, 2 N)."""
        variance = np.repeat(np.asarray(self.sigma_m, dtype=float) ** 2, 2, axis=-1)
        covariance: FloatArray = variance[..., None] * np.eye(variance.shape[-1])
        return covariance if self.smear_m2 is None else covariance + block_diagonal(self.smear_m2)

    def select(self, rows: Sequence[int]) -> "Image":
        """Return the image with some of its beacons, or with all beacons in another order."""
        chosen = list(rows)
        smear_m2 = None if self.smear_m2 is None else self.smear_m2[chosen]
        return Image(self.point_m[chosen], np.asarray(self.sigma_m)[chosen], smear_m2)


@dataclass(frozen=True)
class PredictedPoints:
    """Predicted detector points of beacons; NaN behind the telescope.

    Attributes:
        point_m: predicted points (x right, z up), shape (..., N, 2).
        by_attitude_n: derivative with respect to the telescope's rotation vector in n, m/rad, shape (..., N, 2, 3).
        by_direction_n: derivative with respect to the beacon's unit direction in n, m/rad, shape (..., N, 2, 3).
        by_focal_length: derivative with respect to the focal length, m/m, shape (..., N, 2).
    """

    point_m: FloatArray
    by_attitude_n: FloatArray
    by_direction_n: FloatArray
    by_focal_length: FloatArray


def predict_points(camera: Camera, rotation_nt: FloatArray, direction_n: FloatArray) -> PredictedPoints:
    """Return the detector points of beacons for an attitude of the telescope.

    R is the attitude "horizon from telescope", and R_true = exp(δ) R. A beacon in the direction w in n has the
    direction Rᵀ w in the telescope, which δ changes by Rᵀ (w × δ).

    Args:
        camera: geometry of the telescope.
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        direction_n: unit vectors to the beacons, shape (..., N, 3).

    Example:
        A light to the right of and above the axis, for a focal length of 0.1 m:

        >>> camera = Camera(focal_length_m=0.1, focal_length_sigma_m=0.0, principal_point_m=np.zeros(2))
        >>> unit_n = np.array([[1.0, 0.1, 0.2]]) / np.sqrt(1.05)
        >>> print(predict_points(camera, np.eye(3), unit_n).point_m)
        [[-0.02 -0.01]]
    """
    leading, count = direction_n.shape[:-2], direction_n.shape[-2]
    principal_point_m = np.asarray(camera.principal_point_m, dtype=float)
    found = compiled_pointing.image_points(
        flatten_exposures(direction_n, leading, (count, 3)),
        flatten_exposures(rotation_nt, leading, (3, 3)),
        flatten_exposures(camera.focal_length_m, leading, ()),
        flatten_exposures(
            principal_point_m if principal_point_m.ndim == 1 else principal_point_m[..., 0, :], leading, (2,)
        ),
    )
    return PredictedPoints(*(of_all.reshape(*leading, *of_all.shape[1:]) for of_all in found))


def flatten_exposures(values: FloatArray | float, leading: tuple[int, ...], item_shape: tuple[int, ...]) -> FloatArray:
    """Flatten the leading axes of all exposures to one axis; values common to all exposures are repeated.

    Args:
        values: array of shape (..., *item_shape), whose leading axes broadcast to ``leading``.
        leading: shape of the exposures; empty for one exposure.
        item_shape: shape of the values of one exposure.

    Example:
        >>> flatten_exposures(0.1, (2,), ()).tolist()
        [0.1, 0.1]
    """
    array: FloatArray = np.asarray(values, dtype=float)
    whole = (*leading, *item_shape)
    return (array if array.shape == whole else np.broadcast_to(array, whole)).reshape(-1, *item_shape)


@dataclass(frozen=True)
class BeaconStreaks:
    """N detected beacons, and the motion of telescope and beacons over the exposure.

    A detected point is the mean of the beacon's path over the detector. The path is computed from encoders, ship and
    baselines; it gives the difference between the mean and the point at the middle of the exposure. The variance of the
    light along a streak of length L is s² + L²/12, with s the spread of a light at rest. The variance of the point
    along the streak grows by the same factor, to σ² (1 + L²/(12 s²)) (docs/explanation/theodolite.md).

    Attributes:
        image: detected image.
        camera: geometry of the telescope.
        psf_sigma_m: spread s of the image of a light at rest, each axis.
        nodes: m times over the exposure, with weights.
        rotation_nt: horizon from telescope at the nodes, shape (m, 3, 3).
        middle_nt: horizon from telescope at the middle, shape (3, 3).
        path_n: vectors from the telescope to the beacons at the middle, m, shape (N, 3).
        displacement_n: vectors to the beacons at the nodes minus ``path_n``, m, shape (m, N, 3).
    """

    image: Image
    camera: Camera
    psf_sigma_m: float
    nodes: Nodes
    rotation_nt: FloatArray
    middle_nt: FloatArray
    path_n: FloatArray
    displacement_n: FloatArray

    def image_at_middle(self) -> Image:
        """Return the points at the middle of the exposure, with the errors added by their streaks."""
        image, distance_m = self.image, np.linalg.norm(self.path_n, axis=-1, keepdims=True)
        # The direction at the middle is taken from the detected point, and the motion from the vectors to the beacons.
        seen_n = distance_m * (self.camera.directions(image.point_m) @ self.middle_nt.T)
        path_m = self.camera.points((seen_n + self.displacement_n) @ self.rotation_nt)
        offset_m = self.nodes.mean(path_m) - image.point_m
        smear_m2 = self.nodes.covariance(path_m) * ((image.sigma_m / self.psf_sigma_m) ** 2)[:, None, None]
        return Image(image.point_m - offset_m, image.sigma_m, smear_m2)

    def select(self, rows: list[int], image_rows: list[int]) -> "BeaconStreaks":
        """Return some beacons, possibly with exchanged points; beacon ``rows[i]`` gets the point ``image_rows[i]``."""
        return replace(
            self,
            image=self.image.select(image_rows),
            path_n=self.path_n[rows],
            displacement_n=self.displacement_n[:, rows],
        )


def unit_vector_jacobian(vector: FloatArray) -> FloatArray:
    """Return the derivative of u = v / |v| with respect to v, (I - u uᵀ) / |v|, shape (..., 3, 3).

    Example:
        >>> unit_vector_jacobian(np.array([2.0, 0.0, 0.0])).diagonal().tolist()
        [0.0, 0.5, 0.5]
    """
    length = np.linalg.norm(vector, axis=-1)[..., None, None]
    unit = vector[..., None] / length
    jacobian: FloatArray = (np.eye(3) - unit * np.swapaxes(unit, -1, -2)) / length
    return jacobian


def block_diagonal(blocks: FloatArray) -> FloatArray:
    """Return the matrix (..., N a, N b) with the blocks (..., N, a, b) along its diagonal.

    Example:
        >>> print(block_diagonal(np.array([[[1.0, 2.0]], [[3.0, 4.0]]])))
        [[1. 2. 0. 0.]
         [0. 0. 3. 4.]]
    """
    count, rows, columns = blocks.shape[-3:]
    matrix = np.zeros((*blocks.shape[:-3], count * rows, count * columns))
    for i in range(count):
        matrix[..., i * rows : (i + 1) * rows, i * columns : (i + 1) * columns] = blocks[..., i, :, :]
    return matrix


def _per_beacon(value: FloatArray | float) -> FloatArray:
    """Return a quantity of each exposure, shape (...), with an additional axis for the beacons, shape (..., 1)."""
    return np.asarray(value, dtype=float)[..., None]

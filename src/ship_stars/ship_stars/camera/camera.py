"""Camera model of a star sensor: conversion between pixels and directions in the sensor frame, with errors.

The sensor frame is (forward, up, right). Pixels are (u, v): u increases to the right and v down, as seen looking out of
the sensor. Both coordinates start at 0 and are integers at the centres of the pixels.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

_NEWTON_STEPS = 20
# Largest last Newton step of a converged point, in focal lengths; it corresponds to 2e-9″.
_CONVERGED = 1e-14


@dataclass(frozen=True)
class Distortion:
    """Brown–Conrady distortion of points (x right, y down), in focal lengths from the principal point.

    The distorted point is the sum of two terms. The radial term is the ideal point times 1 + k1 r² + k2 r⁴ + k3 r⁶. The
    tangential term is (2 p1 x y + p2 (r² + 2 x²), p1 (r² + 2 y²) + 2 p2 x y).
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def distort(self, ideal: FloatArray) -> FloatArray:
        """Return the distorted points, shape (..., 2), of ideal points of the same shape."""
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
                y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
            ],
            axis=-1,
        )

    def jacobian(self, ideal: FloatArray) -> FloatArray:
        """Return the derivative of the distorted point with respect to the ideal point, shape (..., 2, 2)."""
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        # Derivative of the radial factor with respect to r², times two.
        slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3))
        mixed = slope * x * y + 2.0 * (self.p1 * x + self.p2 * y)
        matrix = np.empty((*x.shape, 2, 2))
        matrix[..., 0, 0] = radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        matrix[..., 0, 1] = mixed
        matrix[..., 1, 0] = mixed
        matrix[..., 1, 1] = radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        return matrix

    def undistort(self, distorted: FloatArray) -> FloatArray:
        """Return the ideal points of distorted points, shape (..., 2); NaN where Newton's method does not converge."""
        ideal = np.array(distorted, dtype=float)
        for _ in range(_NEWTON_STEPS):
            step = _solve_symmetric(self.jacobian(ideal), distorted - self.distort(ideal))
            ideal += step
            if not np.any(np.abs(step) > _CONVERGED):
                return ideal
        return np.where(np.all(np.abs(step) <= _CONVERGED, axis=-1, keepdims=True), ideal, np.nan)


def _solve_symmetric(matrix: FloatArray, right_side: FloatArray) -> FloatArray:
    """Solve symmetric 2 x 2 equations; NaN if the determinant is not positive: there the model is not invertible."""
    determinant = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] ** 2
    x, y = right_side[..., 0], right_side[..., 1]
    cofactors = np.stack(
        [matrix[..., 1, 1] * x - matrix[..., 0, 1] * y, matrix[..., 0, 0] * y - matrix[..., 0, 1] * x], axis=-1
    )
    return cofactors / np.where(determinant > 0.0, determinant, np.nan)[..., None]


@dataclass(frozen=True)
class StarCamera:
    """Geometry of one sensor's camera.

    Attributes:
        focal_length_m: focal length of the lens.
        pixel_pitch_m: distance between pixel centres.
        principal_u_px: column of the boresight.
        principal_v_px: row of the boresight.
        distortion: distortion of the lens; None for a lens without distortion.
    """

    focal_length_m: float
    pixel_pitch_m: float
    principal_u_px: float
    principal_v_px: float
    distortion: Distortion | None = None

    def directions(self, pixels: FloatArray) -> FloatArray:
        """Return unit vectors (forward, up, right), shape (..., 3), of pixels (u, v), shape (..., 2).

        A pixel that is not finite gives NaN.
        """
        return _unit_vectors(self._undistorted_points(pixels))

    def pixels(self, directions_s: FloatArray) -> FloatArray:
        """Return pixels (u, v), shape (..., 2), of directions (forward, up, right), shape (..., 3).

        A direction 90° or more from the boresight gives NaN.
        """
        forward = np.where(directions_s[..., 0] > 0.0, directions_s[..., 0], np.nan)
        point = np.stack([directions_s[..., 2] / forward, -directions_s[..., 1] / forward], axis=-1)
        if self.distortion is not None:
            point = self.distortion.distort(point)
        return self._principal_px + point / self._pixel_size

    def measured_directions(self, pixels: FloatArray, sigma_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the directions of centroids, with their standard deviations.

        A pixel that is not finite gives a NaN direction and sigma. A sigma that is not finite gives a sigma that is not
        finite.

        Args:
            pixels: centroids (u, v), shape (k, 2).
            sigma_px: standard deviation of each centroid in u and in v, shape (k,).

        Returns:
            Unit vectors (forward, up, right), shape (k, 3), and the standard deviation of each per axis
            (:func:`equivalent_sigma`), rad, shape (k,).
        """
        ideal = self._undistorted_points(pixels)
        return _unit_vectors(ideal), equivalent_sigma(self._covariance(ideal, sigma_px))

    def direction_covariance(self, pixels: FloatArray, sigma_px: FloatArray | float) -> FloatArray:
        """Return the covariance of directions of centroids, rad², shape (..., 2, 2), along :func:`tangent_basis`.

        Args:
            pixels: centroids (u, v), shape (..., 2).
            sigma_px: standard deviation of each centroid in u and in v, shape (...).
        """
        return self._covariance(self._undistorted_points(pixels), sigma_px)

    def optics_jacobian(self, directions_s: FloatArray) -> FloatArray:
        """Return the derivatives of the directions of given pixels with respect to the parameters of the optics.

        Args:
            directions_s: measured directions, unit vectors (forward, up, right), shape (..., 3).

        Returns:
            Derivatives, shape (..., 3, 4). The columns are for the logarithm of the focal length (rad),
            ``principal_u_px`` and ``principal_v_px`` (rad per pixel), and k1 of the distortion (rad).
        """
        forward = directions_s[..., 0]
        ideal = np.stack([directions_s[..., 2] / forward, -directions_s[..., 1] / forward], axis=-1)
        by_optics = np.zeros((*ideal.shape, 4))
        by_optics[..., 0] = -ideal
        by_optics[..., 0, 1] = by_optics[..., 1, 2] = -self._pixel_size
        by_optics[..., 3] = -ideal * np.sum(ideal**2, axis=-1, keepdims=True)
        if self.distortion is not None:
            by_optics[..., 0] = -self.distortion.distort(ideal)
            by_optics = np.linalg.solve(self.distortion.jacobian(ideal), by_optics)
        x, y = ideal[..., 0], ideal[..., 1]
        by_ideal = np.empty((*x.shape, 3, 2))
        by_ideal[..., 0, 0], by_ideal[..., 0, 1] = -x, -y
        by_ideal[..., 1, 0], by_ideal[..., 1, 1] = x * y, -(1.0 + x * x)
        by_ideal[..., 2, 0], by_ideal[..., 2, 1] = 1.0 + y * y, -x * y
        slopes: FloatArray = (forward**3)[..., None, None] * by_ideal @ by_optics
        return slopes

    def _covariance(self, ideal: FloatArray, sigma_px: FloatArray | float) -> FloatArray:
        """Return :meth:`direction_covariance` for ideal points in focal lengths."""
        x, y = ideal[..., 0], ideal[..., 1]
        length2 = 1.0 + x * x + y * y
        across2 = 1.0 + x * x
        # Derivative of the direction's components (up, right) with respect to x and y.
        slope = np.zeros((*x.shape, 2, 2))
        slope[..., 0, 0] = x * y / (np.sqrt(across2) * length2)
        slope[..., 0, 1] = -np.sqrt(across2) / length2
        slope[..., 1, 0] = 1.0 / np.sqrt(across2 * length2)
        if self.distortion is not None:
            slope = slope @ np.linalg.inv(self.distortion.jacobian(ideal))
        slope *= (self._pixel_size * np.asarray(sigma_px))[..., None, None]
        return slope @ np.swapaxes(slope, -1, -2)

    @property
    def _pixel_size(self) -> float:
        """Size of a pixel in focal lengths."""
        return self.pixel_pitch_m / self.focal_length_m

    @property
    def _principal_px(self) -> FloatArray:
        return np.array([self.principal_u_px, self.principal_v_px])

    def _undistorted_points(self, pixels: FloatArray) -> FloatArray:
        """Return the ideal points of pixels, x right and y down in focal lengths, shape (..., 2)."""
        point = (np.where(np.isfinite(pixels), pixels, np.nan) - self._principal_px) * self._pixel_size
        return point if self.distortion is None else self.distortion.undistort(point)


def tangent_basis(directions_s: FloatArray) -> FloatArray:
    """Return two unit vectors, up and right, perpendicular to each direction (forward, up, right), shape (..., 2, 3).

    The vectors are NaN for a direction along the sensor's up axis, 90° from the boresight.
    """
    basis = np.zeros((*directions_s.shape[:-1], 2, 3))
    forward, up, right = directions_s[..., 0], directions_s[..., 1], directions_s[..., 2]
    level = np.hypot(forward, right)
    basis[..., 0, 0] = -up * forward / level
    basis[..., 0, 1] = level
    basis[..., 0, 2] = -up * right / level
    basis[..., 1, 0] = -right / level
    basis[..., 1, 2] = forward / level
    return basis


def equivalent_sigma(covariance: FloatArray) -> FloatArray:
    """Return the square root of the mean variance, rad per axis, shape (...), of a covariance of shape (..., 2, 2).

    Wahba's problem has one sigma per direction. The ratio of the radial to the tangential sigma is the cosine of the
    angle from the boresight, a difference of 3 % at 14°.
    """
    sigma: FloatArray = np.sqrt(0.5 * (covariance[..., 0, 0] + covariance[..., 1, 1]))
    return sigma


def _unit_vectors(point: FloatArray) -> FloatArray:
    """Return unit vectors (forward, up, right), shape (..., 3), of ideal points (x right, y down) in focal lengths."""
    x, y = point[..., 0], point[..., 1]
    inverse_length = 1.0 / np.sqrt(1.0 + x * x + y * y)
    direction = np.empty((*x.shape, 3))
    direction[..., 0] = inverse_length
    direction[..., 1] = -y * inverse_length
    direction[..., 2] = x * inverse_length
    return direction

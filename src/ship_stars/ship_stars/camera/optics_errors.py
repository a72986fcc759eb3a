"""Errors of a camera's optics parameters: focal length, principal point, leading radial distortion.

The errors are constant and common to all exposures of the camera. Each error displaces the measured directions in a
pattern over the field. The centroid of a star at (x, y), in focal lengths from the principal point, moves as follows:

* A focal length that is longer by the relative error e moves the centroid by e (x, y).
* An error of the principal point moves all centroids by this error.
* An error of k1 moves the centroid by this error times (x² + y²) (x, y).

An error of the principal point is nearly a rotation of the camera. The mounting is calibrated with stars of the same
camera and the same parameters, so it already contains this rotation. Only the remainder is an error: if the principal
point is wrong by ε pixels in u, the remainder displaces a star by -ε (x², x y) pixels. An error in v acts likewise.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_stars.camera.camera import StarCamera

SOURCE_OPTICS = "optics"
"""Name of the error source in budgets."""

OPTICS_MODES = 4
"""Number of optics errors: focal length, principal point in u and in v, k1."""

SURVEYED_FOCAL_SIGMA = 2e-4
"""Relative standard deviation of a surveyed focal length."""


@dataclass(frozen=True)
class OpticsErrors:
    """Errors of one camera's optics parameters.

    Attributes:
        camera: configured geometry of the camera.
        focal_sigma: relative standard deviation of the focal length.
        principal_sigma_px: standard deviation of the principal point, each axis.
        distortion_sigma: standard deviation of k1.
    """

    camera: StarCamera
    focal_sigma: float
    principal_sigma_px: float
    distortion_sigma: float

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of focal length (relative), principal u and v (px), and k1, shape (OPTICS_MODES,)."""
        return np.array([self.focal_sigma, self.principal_sigma_px, self.principal_sigma_px, self.distortion_sigma])

    def modes(self, directions_s: FloatArray) -> FloatArray:
        """Return displacements of measured directions by one sigma of each error, in the sensor frame, rad.

        Args:
            directions_s: measured directions, unit vectors, shape (k, 3).

        Returns:
            Displacements, shape (k, 3, OPTICS_MODES).
        """
        displacement_s: FloatArray = -self.sigmas * self.camera.optics_jacobian(directions_s)
        # Add the rotations about up and right that cancel the displacement at the boresight. u is right, v is down.
        turn = self.principal_sigma_px * self.camera.pixel_pitch_m / self.camera.focal_length_m
        forward, up, right = directions_s.T
        displacement_s[:, 0, 1] += turn * right
        displacement_s[:, 2, 1] -= turn * forward
        displacement_s[:, 0, 2] -= turn * up
        displacement_s[:, 1, 2] += turn * forward
        return displacement_s

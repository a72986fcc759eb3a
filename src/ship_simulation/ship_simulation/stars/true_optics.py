"""The true optics of a camera, which differ from the optics given to the suite by errors of the stated sigmas.

The mounting is calibrated through the camera: a star in the nominal boresight direction is imaged on the nominal
principal point. A camera whose true principal point differs is therefore rotated.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.scenario import Detector
from ship_stars.camera.camera import Distortion, StarCamera

_SURVEYED_FOCAL_SIGMA = 2e-4
"""Relative standard deviation of a focal length whose sigma is not given, as documented at the parameter."""


@dataclass(frozen=True)
class TrueOptics:
    """The true optics of a camera.

    Attributes:
        camera: camera with the true parameters.
        rotation_cs: frame of the true optical axis from the frame of the sensor, shape (3, 3).
    """

    camera: StarCamera
    rotation_cs: FloatArray

    def pixels(self, directions_s: FloatArray) -> FloatArray:
        """Return pixels (u, v) of directions in the sensor frame, shape (..., 3) → (..., 2)."""
        return self.camera.pixels(directions_s @ self.rotation_cs.T)


def draw_optics(rng: np.random.Generator, detector: Detector, name: str) -> TrueOptics:
    """Draw the true optics of a camera around the configured optics.

    Args:
        rng: random generator of the optics of this camera.
        detector: configured camera and detector, with the sigmas.
        name: name of the camera, for an error message.
    """
    configured = detector.camera(name)
    focal, principal_u, principal_v, k1 = rng.standard_normal(4)
    focal *= detector.focal_length_sigma_m / configured.focal_length_m or _SURVEYED_FOCAL_SIGMA
    distortion = configured.distortion or Distortion()
    true = StarCamera(
        configured.focal_length_m * (1.0 + focal),
        configured.pixel_pitch_m,
        configured.principal_u_px + detector.principal_sigma_px * principal_u,
        configured.principal_v_px + detector.principal_sigma_px * principal_v,
        replace(distortion, k1=distortion.k1 + detector.distortion_sigma * k1),
    )
    # Forward axis of the sensor in the true camera's frame, and two axes across it.
    forward_c = true.directions(np.array([configured.principal_u_px, configured.principal_v_px]))
    right_c = np.cross(forward_c, [0.0, 1.0, 0.0])
    right_c /= np.linalg.norm(right_c)
    return TrueOptics(true, np.stack([forward_c, np.cross(right_c, forward_c), right_c], axis=-1))

"""Direction of a target in the horizon from its image on the main detector, and its position if a range is given.

The frame v of the detector is the main frame m rotated about the main axis by ρ. A target with its image at (x, z) on
the detector appears in the direction

    u = rotation_nm · R(0, 0, ρ) · V,   V ∝ [f, -(z - z0), -(x - x0)]

rotation_nm includes the image rotation ω of the main axis ([W18] (24); docs/explanation/theodolite.md). u includes
refraction, which is corrected only for a position from a range. All vectors are in n, the horizon (North, Up, East).
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import SINGULAR_ELEVATION, rotation_from_angles
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import FloatArray, skew


@dataclass(frozen=True)
class MainDetector:
    """Geometry of the detector in the main tube.

    Attributes:
        focal_length_m: focal length of the main tube.
        principal_point_m: detector point (x0, z0) of the main axis, shape (2,).
        focal_length_sigma_m: standard deviation of the focal length.
        principal_sigma_m: standard deviation of each coordinate of the principal point.
        rotation_sigma: standard deviation of the rotation of the detector, rad.
    """

    focal_length_m: float
    principal_point_m: FloatArray
    focal_length_sigma_m: float = 0.0
    principal_sigma_m: float = 0.0
    rotation_sigma: float = 0.0

    @property
    def camera(self) -> Camera:
        """Detector and main tube as a :class:`Camera`."""
        return Camera(self.focal_length_m, self.focal_length_sigma_m, self.principal_point_m)


@dataclass(frozen=True)
class ObservedDirection:
    """Observed direction of a target.

    Attributes:
        direction_n: unit vector, shape (3,).
        by_turn_n: derivative with respect to a rotation vector of the main frame in n, rad per rad, shape (3, 3).
        image_covariance_n: covariance of the direction error due to image point, focal length, principal point and
            detector rotation, rad², shape (3, 3).
    """

    direction_n: FloatArray
    by_turn_n: FloatArray
    image_covariance_n: FloatArray

    def covariance_n(self, pointing_n: FloatArray) -> FloatArray:
        """Return the covariance of the total error, rad².

        Args:
            pointing_n: covariance of the rotation vector of the main frame, rad², shape (3, 3).
        """
        covariance: FloatArray = self.by_turn_n @ pointing_n @ self.by_turn_n.T + self.image_covariance_n
        return covariance


def rotation_main_from_detector(detector_rotation: float) -> FloatArray:
    """Return R(0, 0, ρ), main frame from detector, shape (3, 3)."""
    return rotation_from_angles(0.0, 0.0, float(detector_rotation))


def observed_direction(
    detector: MainDetector, point_m: FloatArray, sigma_m: float, detector_rotation: float, rotation_nm: FloatArray
) -> ObservedDirection:
    """Return the direction of a target from its image.

    Args:
        detector: geometry of the detector.
        point_m: image point (x, z), shape (2,).
        sigma_m: standard deviation of each coordinate of the image point.
        detector_rotation: rotation ρ of the detector about the main axis, rad.
        rotation_nm: horizon from main frame, shape (3, 3).
    """
    camera, point = detector.camera, np.asarray(point_m, dtype=float)[None]
    rotation_nv = rotation_nm @ rotation_main_from_detector(detector_rotation)
    direction_n = rotation_nv @ camera.directions(point)[0]
    by_point_n = rotation_nv @ camera.direction_by_point(point)[0]
    by_focal_length_n = rotation_nv @ camera.direction_by_focal_length(point)[0]
    by_rotation_n = np.cross(rotation_nm[:, 0], direction_n)
    image_covariance_n = (
        (sigma_m**2 + detector.principal_sigma_m**2) * by_point_n @ by_point_n.T
        + detector.focal_length_sigma_m**2 * np.outer(by_focal_length_n, by_focal_length_n)
        + detector.rotation_sigma**2 * np.outer(by_rotation_n, by_rotation_n)
    )
    return ObservedDirection(direction_n, -skew(direction_n), image_covariance_n)


def direction_angles(direction_n: FloatArray, covariance_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in [0, 2 pi) and elevation, shape (2,), of a unit vector, and their covariance, rad², (2, 2).

    The covariance is NaN within 0.1° of the zenith and the nadir.
    """
    north, up, east = direction_n.tolist()
    horizontal = np.hypot(north, east)
    angles = np.array([np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, horizontal)])
    if not abs(angles[1]) <= SINGULAR_ELEVATION:
        return angles, np.full((2, 2), np.nan)
    by_direction = np.array([
        [-east / horizontal**2, 0.0, north / horizontal**2],
        [-up * north / horizontal, horizontal, -up * east / horizontal],
    ])  # fmt: skip
    return angles, by_direction @ covariance_n @ by_direction.T


@dataclass(frozen=True)
class RangedPosition:
    """Position of a target from its direction and a range.

    Attributes:
        path_n: vector from the theodolite's centre to the target, m, shape (3,).
        by_direction_n: derivative with respect to the direction, m/rad, shape (3, 3).
        by_range_n: derivative with respect to the range, m/m, shape (3,).
        by_coefficient_n: derivative with respect to the coefficient k of terrestrial refraction, m, shape (3,).
    """

    path_n: FloatArray
    by_direction_n: FloatArray
    by_range_n: FloatArray
    by_coefficient_n: FloatArray


def ranged_position(direction_n: FloatArray, range_m: float, coefficient: float) -> RangedPosition:
    """Return the position of a target from its observed direction, corrected for refraction, and its range.

    Refraction raises the direction by the angle k · (horizontal distance) / (2 R).

    Args:
        direction_n: observed direction, unit vector, shape (3,).
        range_m: distance of the target.
        coefficient: coefficient k of terrestrial refraction.
    """
    north, up, east = direction_n.tolist()
    horizontal = float(np.hypot(north, east))
    if horizontal == 0.0:
        return RangedPosition(range_m * direction_n, range_m * np.eye(3), direction_n, np.zeros(3))
    # The observed direction is lowered in its vertical plane.
    upward_n = np.array([-up * north / horizontal, horizontal, -up * east / horizontal])
    raised = coefficient * range_m * horizontal / (2.0 * EARTH_RADIUS_M)
    lowered_n = np.cos(raised) * direction_n - np.sin(raised) * upward_n
    return RangedPosition(
        path_n=range_m * lowered_n,
        by_direction_n=range_m * np.eye(3),
        by_range_n=lowered_n - raised * upward_n,
        by_coefficient_n=-(range_m**2) * horizontal / (2.0 * EARTH_RADIUS_M) * upward_n,
    )

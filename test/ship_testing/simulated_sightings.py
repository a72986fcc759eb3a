"""Epochs of [W18]'s configuration (models.md §5), simulated without the code under test.

Two lights at 2 km are at (3°, 2°) and (-2°, -3°), azimuth · cos E and elevation, from the telescope's axis.

Each epoch of :func:`paper_epochs` has four kinds of random error. Their default standard deviations are 2.7 cm for each
axis of each baseline, 2" for the refraction of each light, 0.1 mm for the focal length of 100 mm, and 0.65 µm for each
image coordinate.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import Camera, Image
from ship_geometry.mount.line_of_sight import BeaconPoses, LeverArm, LinesOfSight, Ship, Survey, lines_of_sight
from ship_geometry.rotations import ARCSEC, FloatArray

DISTANCE_M = 2000.0
FOCAL_LENGTH_M = 0.1
FOCAL_LENGTH_SIGMA_M = 1e-4
DETECTION_M = 0.65e-6
BASELINE_M = 0.027
REFRACTION = 2.0 * ARCSEC
EARTH_RADIUS_M = 6_371_000.0
FOUR_BEACONS_DEG = np.array([[3.0, 2.0], [-2.0, -3.0], [-3.0, 1.5], [0.5, -1.0]])
BEACONS_DEG = FOUR_BEACONS_DEG[:2]
NONE = np.zeros(3)

SURVEY = Survey(
    theodolite_lever=LeverArm(np.array([12.0, 3.0, -2.0]), NONE),
    principal_point=LeverArm(np.array([0.4, 0.3, 0.0]), NONE),
    beacon_lever=LeverArm(np.array([0.1, -0.3, 0.05]), NONE),
    rtk_base_sigma_m=NONE,
    rtk_bias_sigma_m=NONE,
    refraction_coefficient=0.13,
    refraction_sigma=0.0,
    refraction_beacon_sigma=0.0,
)
CAMERA = Camera(FOCAL_LENGTH_M, FOCAL_LENGTH_SIGMA_M, np.array([2e-4, -3e-4]))


@dataclass(frozen=True)
class Truth:
    """True geometry.

    Attributes:
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        direction_n: directions of the lights, without refraction, unit vectors, shape (..., N, 3).
        distance_m: shape (N,) or (..., N).
    """

    rotation_nt: FloatArray
    direction_n: FloatArray
    distance_m: FloatArray


@dataclass(frozen=True)
class Epochs:
    """Measurements and their truth; ``focal_length_m`` is the true focal length, shape (...)."""

    truth: Truth
    focal_length_m: FloatArray
    image: Image
    camera: Camera
    beacons: BeaconPoses
    ship: Ship
    survey: Survey

    def lines(self) -> LinesOfSight:
        return lines_of_sight(self.beacons, self.ship, self.survey)


def truth_of(
    azimuth_deg: FloatArray | float,
    elevation_deg: FloatArray | float,
    rotation_deg: FloatArray | float,
    beacons_deg: FloatArray = BEACONS_DEG,
) -> Truth:
    """Return the geometry of a telescope with these angles; the lights around its axis do not rotate with the image."""
    azimuth, elevation, rotation = map(np.deg2rad, np.broadcast_arrays(azimuth_deg, elevation_deg, rotation_deg))
    right, up = np.tan(np.deg2rad(beacons_deg)).T
    around = np.stack([np.ones_like(up), up, right], axis=-1)
    around /= np.linalg.norm(around, axis=-1, keepdims=True)
    upright = rotation_from_angles(azimuth, elevation, np.zeros_like(azimuth))
    return Truth(
        rotation_nt=rotation_from_angles(azimuth, elevation, rotation),
        direction_n=around @ np.swapaxes(upright, -1, -2),
        distance_m=np.full(len(beacons_deg), DISTANCE_M),
    )


def raise_elevation(direction_n: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Return directions rotated upwards in their vertical plane."""
    elevation = np.arcsin(direction_n[..., 1]) + angle
    azimuth = np.arctan2(direction_n[..., 2], direction_n[..., 0])
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)], axis=-1
    )


def refraction_per_coefficient(truth: Truth) -> FloatArray:
    """Return refraction (rad) of a coefficient of one: horizontal distance / (2 Earth radii), shape (..., N)."""
    return truth.distance_m * np.hypot(truth.direction_n[..., 0], truth.direction_n[..., 2]) / (2.0 * EARTH_RADIUS_M)


def error_free_epochs(truth: Truth, survey: Survey = SURVEY, camera: Camera = CAMERA, seed: int = 0) -> Epochs:
    """Return measurements without errors, for a ship and drones at random attitudes."""
    rng = np.random.default_rng(seed)
    leading, count = truth.rotation_nt.shape[:-2], truth.direction_n.shape[-2]
    rotation_nd, rotation_nb = _random_attitudes(rng, leading), _random_attitudes(rng, (*leading, count))
    # The main frame is assumed to coincide with the telescope's frame; only the vector to N' uses the main frame.
    rotation_dm = np.swapaxes(rotation_nd, -1, -2) @ truth.rotation_nt
    lens_n = rotation_nd @ survey.theodolite_lever.vector_m + truth.rotation_nt @ survey.principal_point.vector_m
    baseline_n = (
        truth.distance_m[..., None] * truth.direction_n
        + lens_n[..., None, :]
        - (rotation_nb @ survey.beacon_lever.vector_m[..., None])[..., 0]
    )
    lights = BeaconPoses(baseline_n, np.zeros((3, 3)), rotation_nb, np.zeros((3, 3)))
    seen_n = raise_elevation(truth.direction_n, survey.refraction_coefficient * refraction_per_coefficient(truth))
    focal_length_m = np.full(leading, camera.focal_length_m)
    point_m = project(camera, focal_length_m, seen_n @ truth.rotation_nt)
    image = Image(point_m, np.full((*leading, count), DETECTION_M))
    ship = Ship(rotation_nd, np.zeros((3, 3)), rotation_dm)
    return Epochs(truth, focal_length_m, image, camera, lights, ship, survey)


def project(camera: Camera, focal_length_m: FloatArray, direction_t: FloatArray) -> FloatArray:
    """Return the inverted image, [W18] (12)."""
    x = -focal_length_m[..., None] * direction_t[..., 2] / direction_t[..., 0]
    z = -focal_length_m[..., None] * direction_t[..., 1] / direction_t[..., 0]
    return np.stack([x, z], axis=-1) + camera.principal_point_m


def paper_epochs(
    truth: Truth,
    seed: int,
    common_refraction: bool = False,
    baseline_sigma_m: float = BASELINE_M,
    unsurveyed_lens_m: FloatArray = NONE,
    focal_length_sigma_m: float = FOCAL_LENGTH_SIGMA_M,
) -> Epochs:
    """Return epochs with the paper's errors, drawn for each epoch.

    Args:
        truth: true geometry with one leading dimension, the epochs.
        seed: of the errors.
        common_refraction: True to draw one refraction error for both lights, 2" at the elevation of the telescope at
            the first epoch.
        baseline_sigma_m: standard deviation of each axis of each baseline.
        unsurveyed_lens_m: true vector to N' minus its vector in the survey of the epochs, main frame.
        focal_length_sigma_m: standard deviation of the focal length, drawn at each epoch.
    """
    true_lens = replace(SURVEY.principal_point, vector_m=SURVEY.principal_point.vector_m + unsurveyed_lens_m)
    epochs = replace(error_free_epochs(truth, replace(SURVEY, principal_point=true_lens), seed=seed), survey=SURVEY)
    rng = np.random.default_rng(seed)
    leading, count = truth.rotation_nt.shape[:-2], truth.direction_n.shape[-2]
    scale = refraction_per_coefficient(truth)
    if common_refraction:
        axis_n = truth.rotation_nt[0, :, 0]
        sigma = REFRACTION / (DISTANCE_M * np.hypot(axis_n[0], axis_n[2]) / (2.0 * EARTH_RADIUS_M))
        coefficient = 0.13 + sigma * rng.standard_normal((*leading, 1))
        survey = replace(epochs.survey, refraction_sigma=sigma)
    else:
        light_sigma = REFRACTION / scale
        coefficient = 0.13 + light_sigma * rng.standard_normal((*leading, count))
        survey = replace(epochs.survey, refraction_beacon_sigma=light_sigma)
    focal_length_m = FOCAL_LENGTH_M + focal_length_sigma_m * rng.standard_normal(leading)
    seen_n = raise_elevation(truth.direction_n, coefficient * scale)
    point_m = project(epochs.camera, focal_length_m, seen_n @ truth.rotation_nt)
    point_m += DETECTION_M * rng.standard_normal(point_m.shape)
    lights = replace(
        epochs.beacons,
        baseline_n=epochs.beacons.baseline_n + baseline_sigma_m * rng.standard_normal((*leading, count, 3)),
        baseline_covariance_n=np.broadcast_to(baseline_sigma_m**2 * np.eye(3), (*leading, count, 3, 3)),
    )
    image = replace(epochs.image, point_m=point_m)
    return replace(epochs, focal_length_m=focal_length_m, image=image, beacons=lights, survey=survey)


def _random_attitudes(rng: np.random.Generator, leading: tuple[int, ...]) -> FloatArray:
    """Return attitudes with all headings, moderate pitch and roll, shape (..., 3, 3)."""
    heading, pitch, roll = np.moveaxis(rng.uniform([0.0, -0.1, -0.2], [6.2, 0.1, 0.2], (*leading, 3)), -1, 0)
    return rotation_from_angles(heading, pitch, roll)

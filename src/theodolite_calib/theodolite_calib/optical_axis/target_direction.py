"""Direction of a target in the horizon from its image on the main detector, and its position if a range is given.

The frame v of the detector is the main frame m rotated about the main axis by ρ. A target with its image at (x, z) on
the detector appears in the direction

    u = rotation_nm · R(0, 0, ρ) · V,   V ∝ [f, -(z - z0), -(x - x0)]

rotation_nm includes the image rotation ω of the main axis ([W18] (24); docs/explanation/theodolite.md). u includes
refraction, which is corrected only for a position from a range. All vectors are in n, the horizon (North, Up, East).
"""

from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters.theodolite_devices import MainDetectorOptics
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AXES, SHIP, axis_geometry
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.optical_axis.output import PendingPointing
from theodolite_calib.samples.samples import PointingEstimate, TargetEstimate, TargetSample


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


def observed_direction(
    detector: MainDetectorOptics, point_m: FloatArray, sigma_m: float, detector_rotation: float, rotation_nm: FloatArray
) -> ObservedDirection:
    """Return the direction of a target from its image.

    Args:
        detector: optics of the main tube and its detector.
        point_m: image point (x, z), shape (2,).
        sigma_m: standard deviation of each coordinate of the image point.
        detector_rotation: rotation ρ of the detector about the main axis, rad.
        rotation_nm: horizon from main frame, shape (3, 3).
    """
    camera, point = _camera(detector), np.asarray(point_m, dtype=float)[None]
    rotation_nv = rotation_nm @ rotation_from_angles(0.0, 0.0, detector_rotation)
    direction_n = rotation_nv @ camera.directions(point)[0]
    by_point_n = rotation_nv @ camera.direction_by_point(point)[0]
    by_focal_length_n = rotation_nv @ camera.direction_by_focal_length(point)[0]
    by_rotation_n = np.cross(rotation_nm[:, 0], direction_n)
    image_covariance_n = (
        (sigma_m**2 + detector.principal_sigma_m**2) * by_point_n @ by_point_n.T
        + detector.focal_length_sigma_m**2 * np.outer(by_focal_length_n, by_focal_length_n)
        + (detector.rotation_sigma_arcsec * ARCSEC) ** 2 * np.outer(by_rotation_n, by_rotation_n)
    )
    return ObservedDirection(direction_n, -skew(direction_n), image_covariance_n)


def _camera(detector: MainDetectorOptics) -> Camera:
    return Camera(detector.focal_length_m, detector.focal_length_sigma_m, detector.principal_point_m)


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


class TargetOutput:
    """Computes directions of targets from the pointing at the middle of their exposure.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._config, self._filter, self._detector = config, filter_, config.main_detector

    def image_path_m(self, sample: TargetSample, rotations_nm: FloatArray, middle_nm: FloatArray) -> FloatArray:
        """Return the path over the detector, m, of a target whose direction in n is constant, shape (m, 2).

        If the target's direction rotates at a constant rate instead, the mean of the path changes only by terms of
        second order, the products of this rotation and the mount's rotation.

        Args:
            sample: image of the target.
            rotations_nm: horizon from main frame at m times, shape (m, 3, 3).
            middle_nm: horizon from main frame at the middle, when the target is at its image point, shape (3, 3).
        """
        camera = _camera(self._detector)
        rotation_mv = rotation_from_angles(0.0, 0.0, sample.detector_rotation)
        seen_n = middle_nm @ rotation_mv @ camera.directions(sample.point_m[None])[0]
        return camera.points(seen_n @ (rotations_nm @ rotation_mv))

    def estimate(
        self,
        sample: TargetSample,
        point_m: FloatArray,
        pending: PendingPointing,
        pointing: PointingEstimate,
        status: Status,
        text: str,
    ) -> TargetEstimate:
        """Return the direction of a target.

        Args:
            sample: image of the target.
            point_m: detector point at the middle of the exposure, shape (2,).
            pending: inputs of the pointing at that time.
            pointing: pointing at that time.
            status: status of the direction.
            text: reason if the status is not VALID.
        """
        seen = observed_direction(
            self._detector, point_m, sample.sigma_m, sample.detector_rotation, pointing.rotation_nm
        )
        covariance_n = seen.by_turn_n @ pointing.covariance_n @ seen.by_turn_n.T + seen.image_covariance_n
        position = self._position(sample, pending, pointing, seen) if sample.has_range else ()
        return TargetEstimate(sample.time_ns, sample.target_id, status, text, seen.direction_n, covariance_n, *position)

    def _position(
        self, sample: TargetSample, pending: PendingPointing, pointing: PointingEstimate, seen: ObservedDirection
    ) -> tuple[FloatArray, FloatArray]:
        """Return the position of a target relative to the ship's antenna, m, and its covariance, m².

        Errors of ship, lever and air are states of the filter, so their joint covariance is used.
        """
        model, ship = self._filter.model, pending.ship
        state = self._filter.propagate(pointing.state, sample.time_ns, ship.correlated_covariance_n)
        errors = self._filter.sightings.geometry_errors(state.mean)
        geometry = axis_geometry(errors, ship.rotation_nd, ship.rate_d, *pending.sample.vector.tolist())
        lever_m, coefficient = self._config.lever.vector_m, self._config.air.coefficient
        if "lever" in model.slices:
            lever_m = lever_m + state.mean[model.slices["lever"]]
        if "refraction" in model.slices:
            coefficient += float(state.mean[model.slices["refraction"]][0])
        lever_n = geometry.rotation_nd @ lever_m
        place = ranged_position(seen.direction_n, sample.range_m, coefficient)

        by_turn_n, lever_by_turn_n = place.by_direction_n @ seen.by_turn_n, -skew(lever_n)
        axis_indices = axis_state_indices(model)
        by_state_n = np.zeros((3, model.size))
        by_state_n[:, axis_indices] = by_turn_n @ pointing.by_error_n
        # The ship's error and time offset rotate the lever; deformation and axis errors do not.
        ship_columns = np.r_[SHIP, AXES.stop : len(axis_indices)]
        by_state_n[:, axis_indices[ship_columns]] += lever_by_turn_n @ pointing.by_error_n[:, ship_columns]
        if "lever" in model.slices:
            by_state_n[:, model.slices["lever"]] = geometry.rotation_nd
        if "refraction" in model.slices:
            by_state_n[:, model.slices["refraction"]] = place.by_coefficient_n[:, None]

        # Covariance of the pointing minus the states' part: noise of encoders and ship, unconfirmed steps, separations.
        of_states_n = pointing.by_error_n @ state.covariance[np.ix_(axis_indices, axis_indices)] @ pointing.by_error_n.T
        other_n = pointing.covariance_n - of_states_n
        by_ship_noise_n = by_turn_n + lever_by_turn_n
        covariance_n = (
            by_state_n @ state.covariance @ by_state_n.T
            + by_turn_n @ other_n @ by_turn_n.T
            + ship.noise * (by_ship_noise_n @ by_ship_noise_n.T - by_turn_n @ by_turn_n.T)
            + place.by_direction_n @ seen.image_covariance_n @ place.by_direction_n.T
            + sample.range_sigma_m**2 * np.outer(place.by_range_n, place.by_range_n)
            + self._config.air.light_sigma**2 * np.outer(place.by_coefficient_n, place.by_coefficient_n)
        )
        return lever_n + place.path_n, 0.5 * (covariance_n + covariance_n.T)

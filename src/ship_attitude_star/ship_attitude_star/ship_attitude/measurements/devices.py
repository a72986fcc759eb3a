"""Devices of all kinds of measurement: attitudes relative to the horizon, single stars, and baselines between antennas.

The base class, and the parts of a new kind of sensor, are in
:mod:`ship_attitude_star.ship_attitude.measurements.device`. Single stars are compared one by one
(:mod:`ship_stars.attitude_from_stars.residuals`). A baseline between two antennas aboard is a direction of the ship in
the horizon, measured by RTK.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.ship_attitude.measurements.device import (
    SOURCE_INTERPOLATION,
    ComparedMeasurement,
    Device,
    InsMatch,
    LinearisationPoint,
)
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.plausibility.stuck_check import StuckValue, largest_sigma
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian
from ship_geometry.tracks.attitude_track import InterpolatedAttitude
from ship_geometry.tracks.exposure_mean import exposure_motion
from ship_kernels import compiled_rotations
from ship_stars.attitude_from_stars.exposure import StarExposure, reduce_to_mid_exposure, visible_stars
from ship_stars.attitude_from_stars.residuals import PredictedSensor, star_residuals
from ship_stars.attitude_from_stars.solution import initial_attitude
from ship_stars.attitude_samples import (
    ATTITUDE_COMPONENTS,
    SHARED_BY_GRAVITY,
    SHARED_BY_MESSAGES,
    SHARED_BY_SKY,
    AttitudeMeasurement,
    InertialAttitude,
    SolvedAttitude,
)
from ship_stars.camera.config import camera_state_indices
from ship_stars.sky.sky_model import sky_slice
from ship_stars.sky.tracker_attitude import to_horizon_attitude

_HALF_TURN_RAD = math.radians(177.0)
"""Rotation angle above which noise of up to 1° per attitude may decide the sense of the rotation vector, rad."""
_TIE_BREAK_RAD = 0.01
"""Value added to each component of both candidate errors, rad.

Of two opposite errors, the one with the negative component sum then counts as smaller.
"""

_IDENTITY = np.eye(3)
_IDENTITY.flags.writeable = False

_SHARED_STATES = {SHARED_BY_MESSAGES: "sky.common", SHARED_BY_GRAVITY: "gravity.deflection"}
"""States of the errors that several attitude measurements share, by :attr:`AttitudeMeasurement.shared_by`."""

BASELINE = "baseline"
"""Source name of the baseline."""

BASELINE_COMPONENTS = ("baseline up", "baseline right")
"""Components of the residual of a baseline: measured minus predicted direction, in the up and right axes, rad."""

_UP_RIGHT_BY_ROTATION = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Jacobian of the forward axis's direction (up, right) with respect to a rotation of the device (forward, up, right).
"""

_UP_RIGHT_BY_ROTATION.flags.writeable = False

_LENGTH_SIGMAS = 5.0
"""Maximum error of a baseline length, in standard deviations."""


class AttitudeDevice(Device):
    """A device that measures its attitude relative to the horizon."""

    def linearise(self, measurement: AttitudeMeasurement, at: LinearisationPoint) -> ComparedMeasurement:
        """See :class:`Device`; the residual is the rotation vector from predicted to measured attitude, device frame.

        The residual is log(R_predicted^T R_measured), rad, shape (3,).
        """
        residual, jacobian = _residual(measurement, at)
        index, noise = at.model.source_indices, measurement.noise_v
        between, interpolation = index[SOURCE_INTERPOLATION], at.predicted.interpolation_v
        return ComparedMeasurement(
            LinearMeasurement(residual, jacobian, {index[self.noise_sources[0]]: noise, between: interpolation}),
            rotation_jacobian=_IDENTITY,
            components=ATTITUDE_COMPONENTS,
            rotation_nv=measurement.rotation_nv,
            predicted_nv=at.predicted.rotation_nv,
            attitude_noise_v=noise,
        )

    def information(self, measurement: AttitudeMeasurement | InertialAttitude) -> FloatArray:
        """See :class:`Device`; a variance of zero counts as no information."""
        noise_v = measurement.noise_v if isinstance(measurement, AttitudeMeasurement) else measurement.noise_s
        inverse = np.asarray(np.linalg.pinv(noise_v, hermitian=True), dtype=np.float64)
        information: FloatArray = 0.5 * (inverse + inverse.T)
        return information


class TrackerDevice(AttitudeDevice):
    """A star sensor that solves its attitude."""

    is_star = True

    def convert(
        self, measurement: Measurement, match: InsMatch
    ) -> tuple[Measurement, InterpolatedAttitude] | Rejection:
        """See :class:`Device`; an attitude that depends on the sky model is converted to the horizon."""
        if not isinstance(measurement, InertialAttitude | SolvedAttitude):
            return measurement, match.ins
        assert match.sky_model is not None
        attitude = to_horizon_attitude(measurement, match.sky_model)
        return attitude if isinstance(attitude, Rejection) else (attitude, match.ins)


class ReferenceDevice(AttitudeDevice):
    """Another attitude system, which is levelled by gravity as the INS is."""

    angles = (("roll", 2), ("pitch", 1), ("heading", 0))
    are_angles_signed = True

    def convert(self, measurement: AttitudeMeasurement, match: InsMatch) -> tuple[Measurement, InterpolatedAttitude]:
        """See :class:`Device`; the deflection of the vertical is an error shared with the INS."""
        if match.vertical is not None:
            by_deflection = match.vertical.at(measurement.time_ns).deflection_jacobian
            measurement = replace(measurement, shared_n=by_deflection, shared_by=SHARED_BY_GRAVITY)
        return measurement, match.ins


def _residual(measurement: AttitudeMeasurement, at: LinearisationPoint) -> tuple[FloatArray, FloatArray]:
    """Return measured minus predicted attitude, rad, shape (3,), and the Jacobian of the prediction, shape (3, n)."""
    slices, (rotation_nv, jacobian_v, _) = at.model.slices, at.predicted
    if measurement.shared_n is not None:
        by_sky = measurement.shared_by == SHARED_BY_SKY
        rows = sky_slice(slices) if by_sky else slices[_SHARED_STATES[measurement.shared_by]]
        rotation = -measurement.shared_n @ at.mean[rows]
        rotation_nv = exp_rotation(rotation) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(rotation) @ measurement.shared_n
    residual = compiled_rotations.turn_between(rotation_nv, measurement.rotation_nv)
    if math.hypot(*residual.tolist()) > _HALF_TURN_RAD:
        slow = slices["ins.attitude"]
        residual = _smaller_ins_error_residual(residual, at.mean[slow], jacobian_v[:, slow])
    return residual, jacobian_v


def _smaller_ins_error_residual(residual: FloatArray, error_n: FloatArray, by_error_v: FloatArray) -> FloatArray:
    """Return a residual of about 180° in the sense that leads to the smaller INS error.

    At 180° noise decides the sense of the logarithm. With the wrong sense, the estimated INS error would be 360° after
    a heading jump by 180° and back. At 360° the left Jacobian is singular. If the predicted error is about zero, both
    errors are equally large; then the residual that leads to the error with the negative component sum is returned.

    Args:
        residual: rotation vector in the device frame, rad, shape (3,).
        error_n: predicted attitude error of the INS, rotation vector in the horizon frame, rad, shape (3,).
        by_error_v: Jacobian of the predicted device attitude with respect to ``error_n``, shape (3, 3).
    """
    size = math.hypot(*residual.tolist())
    other = (1.0 - 2.0 * math.pi / size) * residual
    leads_to = [error_n + np.linalg.solve(by_error_v, one) + _TIE_BREAK_RAD for one in (residual, other)]
    return residual if leads_to[0] @ leads_to[0] <= leads_to[1] @ leads_to[1] else other


class StarCameraDevice(Device):
    """A star sensor that sends single stars."""

    is_star = True

    def convert(
        self, measurement: StarExposure, match: InsMatch
    ) -> tuple[StarExposure, InterpolatedAttitude] | Rejection:
        """See :class:`Device`; an exposure is reduced to its middle, and compared with the mean attitude over it.

        The rate between two INS samples would contain their noise divided by their interval. The filter would take
        this noise for a motion across the streaks, where stars are accurate. The clock offset would then seem well
        observed, and its sigma would become too small. Therefore rate and errors of the mean attitude are used.
        """
        if measurement.length is None:
            return measurement, match.ins
        motion = exposure_motion(match.track, match.ins_time_ns, measurement.length.nodes)
        if motion is None:
            return measurement.length.coverage_rejection
        rate_d, gain, covariance_d = motion.rate, motion.noise_gain, motion.error_covariance
        ins = replace(match.ins, rate_d=rate_d, noise_gain=gain, error_covariance_d=covariance_d)
        return reduce_to_mid_exposure(measurement, motion.in_device_frame(self.rotation_dv0).turns), ins

    def initial_attitude(self, measurement: StarExposure, at: LinearisationPoint) -> FloatArray | None:
        """See :class:`Device`; None without visible stars."""
        assert at.sky_model is not None
        prior = at.predicted.prior(at.covariance)
        visible = visible_stars(measurement, at.sky_model, prior)
        if isinstance(visible, Rejection) or not len(visible[1]):
            return None
        return initial_attitude(visible[1], prior)

    def linearise(self, measurement: StarExposure, at: LinearisationPoint) -> ComparedMeasurement | Rejection:
        """See :class:`Device`; the residual of each star used is measured minus predicted direction, up and right."""
        assert at.sky_model is not None
        rotation_nv, model = at.predicted.rotation_nv, at.model
        stars = star_residuals(
            measurement,
            PredictedSensor(rotation_nv, at.predicted.jacobian_v, at.mean),
            (at.expected or at.predicted).prior(at.covariance),
            at.sky_model,
            sky_slice(model.slices),
            None if at.expected is None else rotation_nv,
            camera_state_indices(model.slices, self.name),
        )
        if isinstance(stars, Rejection):
            return stars
        interpolation = stars.rotation_jacobian @ at.predicted.interpolation_v @ stars.rotation_jacobian.T
        noise_by_source = {model.source_indices[source]: part for source, part in stars.noise.items()}
        noise_by_source[model.source_indices[SOURCE_INTERPOLATION]] = interpolation
        return ComparedMeasurement(
            linear=LinearMeasurement(stars.residual, stars.jacobian, noise_by_source),
            rotation_jacobian=stars.rotation_jacobian,
            components=stars.components,
            rotation_nv=rotation_nv if stars.rotation_ns is None else stars.rotation_ns,
            predicted_nv=rotation_nv,
            rejected_stars=stars.rejected,
        )

    def information(self, measurement: StarExposure) -> FloatArray:
        """See :class:`Device`."""
        directions, weight = measurement.directions_s, measurement.sigma**-2.0
        of_all = np.einsum("k,kij->ij", weight, np.eye(3) - directions[:, :, None] * directions[:, None, :])
        information: FloatArray = 0.5 * (of_all + of_all.T)
        return information


@dataclass(frozen=True)
class BaselineMeasurement:
    """One RTK solution for the vector from the base antenna to the rover antenna, both aboard.

    Attributes:
        time_ns: stamp of the solution.
        vector_n: vector (North, Up, East), m, shape (3,).
        noise_n: noise covariance, m², shape (3, 3); the noise of different solutions is independent.
        covariance_known: False if the message has no covariance, so that the configured sigma is used.
    """

    time_ns: int
    vector_n: FloatArray
    noise_n: FloatArray
    covariance_known: bool = True
    source = BASELINE
    reach_ns = 0  # a baseline is valid at its stamp

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.vector_n.tobytes() + self.noise_n.tobytes()

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant while the ship rotates."""
        return StuckValue(self.direction_n, largest_sigma(self.noise_n) / self.length_m, "baseline is constant")

    @property
    def direction_n(self) -> FloatArray:
        """Unit vector from the base antenna to the rover antenna, (North, Up, East), shape (3,)."""
        direction_n: FloatArray = self.vector_n / self.length_m
        return direction_n

    @property
    def length_m(self) -> float:
        """Measured length of the baseline, m."""
        return float(np.linalg.norm(self.vector_n))


@dataclass(frozen=True, kw_only=True)
class BaselineDevice(Device):
    """The baseline as a device with a forward axis along the baseline.

    Attributes:
        length_m: configured length, m.
        length_sigma_m: standard deviation of the correlated error of a measured length, m.
    """

    angles = (("azimuth", 0), ("elevation", 1))

    length_m: float
    length_sigma_m: float

    def linearise(self, measurement: BaselineMeasurement, at: LinearisationPoint) -> ComparedMeasurement | Rejection:
        """See :class:`Device`; the residual is measured minus predicted direction, up and right in the baseline frame.

        The residual has two components, rad, as for a single star.
        """
        measured_m, noise_n, direction_n = measurement.length_m, measurement.noise_n, measurement.direction_n
        sigma_m = math.sqrt(float(direction_n @ noise_n @ direction_n) + self.length_sigma_m**2)
        # NaN is rejected.
        if not abs(measured_m - self.length_m) <= _LENGTH_SIGMAS * sigma_m:
            text = f"baseline length {measured_m:.3f} m, expected {self.length_m:.3f} m (sigma {sigma_m:.3f} m)"
            return Rejection(Reason.GATE, f"{text}: wrong RTK solution, or wrong parameters of ship_baseline")
        to_device = at.predicted.rotation_nv.T
        direction_v = to_device @ direction_n
        if not direction_v[0] > 0.0:
            text = "the baseline points in the opposite direction: are base and rover exchanged?"
            return Rejection(Reason.GATE, text)
        noise_v = to_device @ noise_n @ to_device.T / self.length_m**2
        rotation_v = np.array([0.0, -direction_v[2], direction_v[1]]) / direction_v[0]
        index, interpolation_v = at.model.source_indices, at.predicted.interpolation_v
        noise_by_source = {
            index[self.noise_sources[0]]: noise_v[1:, 1:],
            index[SOURCE_INTERPOLATION]: _UP_RIGHT_BY_ROTATION @ interpolation_v @ _UP_RIGHT_BY_ROTATION.T,
        }
        return ComparedMeasurement(
            linear=LinearMeasurement(
                _UP_RIGHT_BY_ROTATION @ rotation_v, _UP_RIGHT_BY_ROTATION @ at.predicted.jacobian_v, noise_by_source
            ),
            rotation_jacobian=_UP_RIGHT_BY_ROTATION,
            components=BASELINE_COMPONENTS,
            rotation_nv=at.predicted.rotation_nv @ exp_rotation(rotation_v),
            predicted_nv=at.predicted.rotation_nv,
        )

    def information(self, measurement: BaselineMeasurement) -> FloatArray:
        """See :class:`Device`."""
        variance = float(np.trace(measurement.noise_n)) / 3.0 / measurement.length_m**2
        return np.diag([0.0, 1.0, 1.0]) / variance

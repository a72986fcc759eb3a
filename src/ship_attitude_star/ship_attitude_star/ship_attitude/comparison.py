"""A measurement of any kind against the predicted attitude of its device: residual, Jacobian, noise."""

from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import ATTITUDE_COMPONENTS, AttitudeMeasurement
from ship_attitude_star.ship_attitude.model import PredictedAttitude, sky_rows
from ship_attitude_star.ship_attitude.star_update import attitude_by_stars, star_residuals
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure
from ship_estimation.kalman import StateModel
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Refusal
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation


@dataclass(frozen=True)
class Compared:
    """A measurement against its prediction.

    Attributes:
        residual: measured minus predicted, rad, shape (m,).
        jacobian: of the residual per state, shape (m, n).
        noise: covariance of the white noise, rad², shape (m, m).
        interpolation: the same of the INS's attitude between its samples.
        components: names of the residuals.
        rotation_nv: horizon from device as measured, shape (3, 3); as predicted where single stars agree with that.
        left_out: stars that had no part in it, by name.
    """

    residual: FloatArray
    jacobian: FloatArray
    noise: FloatArray
    interpolation: FloatArray
    components: tuple[str, ...]
    rotation_nv: FloatArray
    left_out: tuple[tuple[str, Refusal], ...] = ()

    @property
    def attitude_noise_n(self) -> FloatArray:
        """Noise of a measured attitude, rotation vector in the horizon frame, rad², (3, 3); zero for single stars."""
        if self.components != ATTITUDE_COMPONENTS:
            return np.zeros((3, 3))
        noise_n: FloatArray = self.rotation_nv @ self.noise @ self.rotation_nv.T
        return noise_n


def compare(
    measurement: Measurement,
    predicted: PredictedAttitude,
    model: StateModel,
    mean: FloatArray,
    covariance: FloatArray,
    watch: SkyWatch | None,
) -> Compared | Refusal:
    """Compare a measurement with the attitude predicted for its device.

    Args:
        measurement: an attitude in the horizon, or single stars.
        predicted: attitude of the device at the moment of the measurement.
        model: what the states are.
        mean: of the state, shape (n,).
        covariance: of the state, shape (n, n).
        watch: the sky; None where no sensor needs it.

    Returns:
        The refusal where it cannot be compared.
    """
    if isinstance(measurement, AttitudeMeasurement):
        return _compare_attitude(measurement, predicted, model, mean)
    assert watch is not None
    assert isinstance(measurement, StarExposure)
    stars = star_residuals(measurement, predicted, covariance, watch, model, mean)
    if isinstance(stars, Refusal):
        return stars
    rotation_ns = predicted.rotation_nv if stars.rotation_ns is None else stars.rotation_ns
    return Compared(
        residual=stars.residual,
        jacobian=stars.jacobian,
        noise=stars.noise,
        interpolation=stars.by_turn @ predicted.interpolation_v @ stars.by_turn.T,
        components=stars.components,
        rotation_nv=rotation_ns,
        left_out=stars.refused,
    )


def _compare_attitude(
    attitude: AttitudeMeasurement, predicted: PredictedAttitude, model: StateModel, mean: FloatArray
) -> Compared:
    residual, jacobian = attitude_measurement(predicted, attitude, model, mean)
    return Compared(
        residual=residual,
        jacobian=jacobian,
        noise=attitude.noise_v,
        interpolation=predicted.interpolation_v,
        components=ATTITUDE_COMPONENTS,
        rotation_nv=attitude.rotation_nv,
    )


def attitude_alone(
    measurement: Measurement, watch: SkyWatch | None, untold_acceleration: float
) -> AttitudeMeasurement | None:
    """The attitude of a star sensor by one measurement and nothing else; None where it does not give one.

    Args:
        measurement: of the sensor.
        watch: the sky; None where no sensor needs it.
        untold_acceleration: angular acceleration of the deck that nothing tells, sigma of each axis, rad/s².
    """
    if isinstance(measurement, AttitudeMeasurement):
        return measurement
    assert watch is not None
    if isinstance(measurement, InertialAttitude):
        attitude = in_horizon(measurement, watch)
        if isinstance(attitude, Refusal):
            return None
        assert attitude.shared_n is not None
        common_n = attitude.common_n + attitude.shared_n @ attitude.shared_n.T
        return replace(attitude, common_n=common_n, shared_n=None)
    assert isinstance(measurement, StarExposure)
    by_stars = attitude_by_stars(measurement, watch, untold_acceleration)
    return None if isinstance(by_stars, Refusal) else by_stars


def attitude_measurement(
    predicted: PredictedAttitude, measurement: AttitudeMeasurement, model: StateModel, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Measured minus predicted attitude, rotation vector in the device frame, rad, (3,), and its Jacobian, (3, n)."""
    rotation_nv, jacobian_v = predicted.rotation_nv, predicted.jacobian_v
    if measurement.shared_n is not None:
        rows = sky_rows(model)
        turn = -measurement.shared_n @ mean[rows]
        rotation_nv = exp_rotation(turn) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(turn) @ measurement.shared_n
    return log_rotation(rotation_nv.T @ measurement.rotation_nv), jacobian_v

"""The predicted attitude of a device, and a measurement of any kind against it: residual, Jacobian, noise."""

from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import ATTITUDE_COMPONENTS, AttitudeMeasurement
from ship_attitude_star.ship_attitude.model import SOURCE_INTERPOLATION, Device, PredictedAttitude, sky_rows
from ship_attitude_star.ship_attitude.star_update import attitude_by_stars, star_residuals
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure
from ship_estimation.kalman import LinearMeasurement, StateModel
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Refusal
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation


@dataclass(frozen=True)
class Compared:
    """A measurement against its prediction.

    Attributes:
        linear: residual, rad, shape (m,), its Jacobian per state and its noise by source.
        components: names of the residuals.
        rotation_nv: horizon from device as measured, shape (3, 3); as predicted where single stars agree with that.
        predicted_nv: the same as predicted, shape (3, 3).
        attitude_noise_n: noise of a measured attitude, rotation vector in the horizon frame, rad², shape (3, 3); zero
            for single stars.
        left_out: stars that had no part in it, by name.
    """

    linear: LinearMeasurement
    components: tuple[str, ...]
    rotation_nv: FloatArray
    predicted_nv: FloatArray
    attitude_noise_n: FloatArray
    left_out: tuple[tuple[str, Refusal], ...] = ()


def predict_attitude(
    device: Device, model: StateModel, mean: FloatArray, ins: InterpolatedAttitude
) -> PredictedAttitude:
    """The attitude of a device at the moment of an (interpolated) INS attitude.

    The chain is multiplied from the device outwards; an error of a factor exp(v) is a small rotation
    J_left(v) dv in the frame on its left, which everything multiplied so far brings into the device frame.
    """
    noise_scale = float(np.sqrt(ins.noise_gain))
    names = [f"{device.name}.{part}" for part in ("slow", "installation", "flexure", "common")]
    scales = {name: 1.0 for name in names if name in model.slices} | {"ins.noise": noise_scale, "ins.attitude": 1.0}
    factors: dict[str, tuple[FloatArray, FloatArray]] = {}
    for name, scale in scales.items():
        vector = scale * mean[model.slices[name]]
        factors[name] = exp_rotation(vector), left_jacobian(vector)
    jacobian = np.zeros((3, model.size))

    def turned(name: str, rotation: FloatArray) -> FloatArray:
        """Multiply ``rotation`` from the left by exp(state ``name``), where there is such a state."""
        if name not in factors:
            return rotation
        factor, by_vector = factors[name]
        rotation = factor @ rotation
        jacobian[:, model.slices[name]] = scales[name] * rotation.T @ by_vector
        return rotation

    rotation_dv = turned(f"{device.name}.slow", np.eye(3))
    rotation_dv = device.rotation_dv0 @ turned(f"{device.name}.installation", rotation_dv)
    rotation_dv = turned(f"{device.name}.flexure", rotation_dv)
    rate_v = rotation_dv.T @ ins.rate_d
    for name, sign in device.ins_time_states:
        jacobian[:, model.slices[name]] = sign * rate_v[:, None]
    rotation_nv = turned("ins.noise", ins.rotation_nd @ rotation_dv)
    rotation_nv = turned("ins.attitude", rotation_nv)
    rotation_nv = turned(f"{device.name}.common", rotation_nv)
    interpolation_v = rotation_dv.T @ ins.error_covariance_d @ rotation_dv
    return PredictedAttitude(rotation_nv, jacobian, interpolation_v)


def compare(
    measurement: Measurement,
    device: Device,
    predicted: PredictedAttitude,
    model: StateModel,
    mean: FloatArray,
    parts: FloatArray,
    watch: SkyWatch | None,
) -> Compared | Refusal:
    """Compare a measurement with the attitude predicted for its device.

    Args:
        measurement: an attitude in the horizon, or single stars.
        device: that measured.
        predicted: attitude of the device at the moment of the measurement.
        model: what the states are.
        mean: of the state, shape (n,).
        parts: covariance of the state by source, shape (n_sources, n, n).
        watch: the sky; None where no sensor needs it.

    Returns:
        The refusal where it cannot be compared.
    """
    index, between = model.sources.index, model.sources.index(SOURCE_INTERPOLATION)
    if isinstance(measurement, AttitudeMeasurement):
        residual, jacobian = _attitude_residual(measurement, predicted, model, mean)
        noise, interpolation = measurement.noise_v, predicted.interpolation_v
        return Compared(
            linear=LinearMeasurement(residual, jacobian, {index(device.noise_source): noise, between: interpolation}),
            components=ATTITUDE_COMPONENTS,
            rotation_nv=measurement.rotation_nv,
            predicted_nv=predicted.rotation_nv,
            attitude_noise_n=measurement.rotation_nv @ noise @ measurement.rotation_nv.T,
        )
    assert watch is not None
    assert isinstance(measurement, StarExposure)
    stars = star_residuals(measurement, predicted, parts.sum(axis=0), watch, model, mean)
    if isinstance(stars, Refusal):
        return stars
    interpolation = stars.by_turn @ predicted.interpolation_v @ stars.by_turn.T
    noise_by_source = {index(device.noise_source): stars.noise, between: interpolation}
    return Compared(
        linear=LinearMeasurement(stars.residual, stars.jacobian, noise_by_source),
        components=stars.components,
        rotation_nv=predicted.rotation_nv if stars.rotation_ns is None else stars.rotation_ns,
        predicted_nv=predicted.rotation_nv,
        attitude_noise_n=np.zeros((3, 3)),
        left_out=stars.refused,
    )


def _attitude_residual(
    measurement: AttitudeMeasurement, predicted: PredictedAttitude, model: StateModel, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Measured minus predicted attitude and its Jacobian per state.

    The residual is log(R_predicted^T R_measured), a rotation vector in the device frame, rad, shape (3,); the Jacobian
    has the shape (3, n).
    """
    rotation_nv, jacobian_v = predicted.rotation_nv, predicted.jacobian_v
    if measurement.shared_n is not None:
        rows = sky_rows(model)
        turn = -measurement.shared_n @ mean[rows]
        rotation_nv = exp_rotation(turn) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(turn) @ measurement.shared_n
    return log_rotation(rotation_nv.T @ measurement.rotation_nv), jacobian_v


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

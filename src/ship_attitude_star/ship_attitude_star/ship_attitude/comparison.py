"""Predicted attitude of a device, and residual, Jacobian and noise of a measurement compared with this attitude.

Single stars are compared one by one (:mod:`ship_stars.solution.residuals`).
"""

import math
from typing import NamedTuple

import numpy as np

from ship_attitude_star.samples.baseline import BASELINE_COMPONENTS, BaselineMeasurement
from ship_attitude_star.ship_attitude.model import SOURCE_INTERPOLATION, Device, ShipStateModel
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.rejections import Reason, Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian
from ship_geometry.tracks.attitude_track import InterpolatedAttitude
from ship_kernels import compiled_rotations
from ship_stars.camera.camera_states import camera_state_indices
from ship_stars.samples.attitude_samples import ATTITUDE_COMPONENTS, AttitudeMeasurement
from ship_stars.sky.sky_model import SkyModel
from ship_stars.solution.exposure import StarExposure
from ship_stars.solution.residuals import star_residuals
from ship_stars.solution.selection import StarPrior

_UP_RIGHT_BY_ROTATION = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Jacobian of the forward axis's direction (up, right) with respect to a rotation of the device (forward, up, right).
"""
_UP_RIGHT_BY_ROTATION.flags.writeable = False

_LENGTH_SIGMAS = 5.0
"""Maximum error of a baseline length, in standard deviations."""

_HALF_TURN_RAD = math.radians(177.0)
"""Rotation angle above which noise of up to 1° per attitude may decide the sense of the rotation vector, rad."""
_TIE_BREAK_RAD = 0.01
"""Value added to each component of both candidate errors, rad.

Of two opposite errors, the one with the negative component sum then counts as smaller.
"""

_IDENTITY = np.eye(3)
_IDENTITY.flags.writeable = False


class PredictedAttitude(NamedTuple):
    """Attitude of a device predicted from the state.

    Attributes:
        rotation_nv: horizon from device, shape (3, 3).
        jacobian_v: Jacobian of the rotation vector in the device frame with respect to the state, shape (3, n).
        interpolation_v: covariance of the interpolation error of the INS attitude, rotation vector in the device
            frame, rad², shape (3, 3).
    """

    rotation_nv: FloatArray
    jacobian_v: FloatArray
    interpolation_v: FloatArray

    def prior(self, covariance: FloatArray) -> StarPrior:
        """Return the prior for the selection of stars, from the covariance of the state, shape (n, n)."""
        prior_v = self.jacobian_v @ covariance @ self.jacobian_v.T + self.interpolation_v
        return StarPrior(self.rotation_nv, self.rotation_nv @ prior_v @ self.rotation_nv.T)


class ComparedMeasurement(NamedTuple):
    """A measurement compared with its prediction.

    Attributes:
        linear: residual, rad, shape (m,), with its Jacobian with respect to the state and its noise by source.
        rotation_jacobian: Jacobian of the residual with respect to a rotation vector in the device frame, shape (m, 3).
        components: names of the residual components.
        rotation_nv: measured attitude, horizon from device, shape (3, 3); the predicted attitude if the single stars
            are consistent with it.
        predicted_nv: predicted attitude, horizon from device, shape (3, 3).
        attitude_noise_v: noise of a measured attitude, rotation vector in the device frame, rad², shape (3, 3); zero
            for single stars and baselines.
        rejected_stars: rejected stars by name.
    """

    linear: LinearMeasurement
    rotation_jacobian: FloatArray
    components: tuple[str, ...]
    rotation_nv: FloatArray
    predicted_nv: FloatArray
    attitude_noise_v: FloatArray
    rejected_stars: tuple[tuple[str, Rejection], ...] = ()

    @property
    def attitude_noise_n(self) -> FloatArray:
        """Noise of a measured attitude in the horizon frame, rad², shape (3, 3)."""
        noise_n: FloatArray = self.rotation_nv @ self.attitude_noise_v @ self.rotation_nv.T
        return noise_n


def predict_attitude(
    device: Device, model: ShipStateModel, mean: FloatArray, ins: InterpolatedAttitude
) -> PredictedAttitude:
    """Predict the attitude of a device from an (interpolated) INS attitude.

    The rotations are multiplied from the device outwards. An error dv of a factor exp(v) is a small rotation J_left(v)
    dv in the frame to the left of the factor. The transpose of the product of this factor and all factors to its right
    rotates J_left(v) dv into the device frame.
    """
    chain = model.rotation_chains[device.name]
    result = compiled_rotations.composed_attitude(
        mean,
        chain.links,
        chain.fixed,
        chain.hull_link,
        chain.noise_link,
        math.sqrt(ins.noise_gain),
        chain.clock_states,
        chain.clock_signs,
        ins.rotation_nd,
        ins.rate_d,
        ins.error_covariance_d,
    )
    return PredictedAttitude(*result)


def compare(
    measurement: Measurement,
    device: Device,
    predicted: PredictedAttitude,
    model: ShipStateModel,
    mean: FloatArray,
    covariance: FloatArray,
    sky_model: SkyModel | None,
    expected: PredictedAttitude | None = None,
) -> ComparedMeasurement | Rejection:
    """Compare a measurement with the attitude predicted for its device.

    Args:
        measurement: an attitude relative to the horizon, a baseline, or single stars.
        device: device that measured.
        predicted: attitude of the device at the time of the measurement.
        model: state vector.
        mean: mean of the state, shape (n,).
        covariance: covariance of the state, shape (n, n).
        sky_model: sky model; None if no sensor needs it.
        expected: attitude of the device at the predicted mean, if ``mean`` is another linearisation point; stars are
            selected with this attitude.

    Returns:
        The comparison, or the rejection of a measurement that cannot be compared.
    """
    index, between = model.source_indices, model.source_indices[SOURCE_INTERPOLATION]
    if isinstance(measurement, AttitudeMeasurement):
        residual, jacobian = _attitude_residual(measurement, predicted, model, mean)
        noise, interpolation = measurement.noise_v, predicted.interpolation_v
        return ComparedMeasurement(
            linear=LinearMeasurement(residual, jacobian, {index[device.noise_source]: noise, between: interpolation}),
            rotation_jacobian=_IDENTITY,
            components=ATTITUDE_COMPONENTS,
            rotation_nv=measurement.rotation_nv,
            predicted_nv=predicted.rotation_nv,
            attitude_noise_v=noise,
        )
    if isinstance(measurement, BaselineMeasurement):
        return _compare_baseline(measurement, device, predicted, model)
    assert sky_model is not None
    assert isinstance(measurement, StarExposure)
    stars = star_residuals(
        measurement,
        predicted.rotation_nv,
        predicted.jacobian_v,
        (expected or predicted).prior(covariance),
        sky_model,
        model.sky_slice,
        mean,
        None if expected is None else predicted.rotation_nv,
        camera_state_indices(model.slices, device.name),
    )
    if isinstance(stars, Rejection):
        return stars
    interpolation = stars.rotation_jacobian @ predicted.interpolation_v @ stars.rotation_jacobian.T
    noise_by_source = {index[source]: part for source, part in stars.noise.items()}
    noise_by_source[between] = interpolation
    return ComparedMeasurement(
        linear=LinearMeasurement(stars.residual, stars.jacobian, noise_by_source),
        rotation_jacobian=stars.rotation_jacobian,
        components=stars.components,
        rotation_nv=predicted.rotation_nv if stars.rotation_ns is None else stars.rotation_ns,
        predicted_nv=predicted.rotation_nv,
        attitude_noise_v=np.zeros((3, 3)),
        rejected_stars=stars.rejected,
    )


def _compare_baseline(
    measurement: BaselineMeasurement, device: Device, predicted: PredictedAttitude, model: ShipStateModel
) -> ComparedMeasurement | Rejection:
    """Compare a measured baseline with its predicted direction and its configured length.

    The residual is measured minus predicted direction, up and right in the baseline frame, rad. The residual has two
    components, as for a single star.
    """
    length_m, measured_m, noise_n = device.length_m, measurement.length_m, measurement.noise_n
    direction_n = measurement.direction_n
    sigma_m = math.sqrt(float(direction_n @ noise_n @ direction_n) + device.length_sigma_m**2)
    # NaN is rejected.
    if not abs(measured_m - length_m) <= _LENGTH_SIGMAS * sigma_m:
        text = f"baseline length {measured_m:.3f} m, expected {length_m:.3f} m (sigma {sigma_m:.3f} m)"
        return Rejection(Reason.GATE, f"{text}: wrong RTK solution, or wrong parameters of ship_baseline")
    to_device = predicted.rotation_nv.T
    direction_v = to_device @ direction_n
    if not direction_v[0] > 0.0:
        return Rejection(Reason.GATE, "the baseline points in the opposite direction: are base and rover exchanged?")
    noise_v = to_device @ noise_n @ to_device.T / length_m**2
    rotation_v = np.array([0.0, -direction_v[2], direction_v[1]]) / direction_v[0]
    return ComparedMeasurement(
        linear=LinearMeasurement(
            _UP_RIGHT_BY_ROTATION @ rotation_v,
            _UP_RIGHT_BY_ROTATION @ predicted.jacobian_v,
            {
                model.source_indices[device.noise_source]: noise_v[1:, 1:],
                model.source_indices[SOURCE_INTERPOLATION]: _UP_RIGHT_BY_ROTATION
                @ predicted.interpolation_v
                @ _UP_RIGHT_BY_ROTATION.T,
            },
        ),
        rotation_jacobian=_UP_RIGHT_BY_ROTATION,
        components=BASELINE_COMPONENTS,
        rotation_nv=predicted.rotation_nv @ exp_rotation(rotation_v),
        predicted_nv=predicted.rotation_nv,
        attitude_noise_v=np.zeros((3, 3)),
    )


def _attitude_residual(
    measurement: AttitudeMeasurement, predicted: PredictedAttitude, model: ShipStateModel, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return measured minus predicted attitude, and the Jacobian of the predicted attitude with respect to the state.

    Returns:
        The residual log(R_predicted^T R_measured), rotation vector in the device frame, rad, shape (3,), and the
        Jacobian, shape (3, n).
    """
    rotation_nv, jacobian_v = predicted.rotation_nv, predicted.jacobian_v
    if measurement.shared_n is not None:
        rows = model.shared_slices[measurement.shared_by]
        rotation = -measurement.shared_n @ mean[rows]
        rotation_nv = exp_rotation(rotation) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(rotation) @ measurement.shared_n
    residual = compiled_rotations.turn_between(rotation_nv, measurement.rotation_nv)
    if math.hypot(*residual.tolist()) > _HALF_TURN_RAD:
        slow = model.slices["ins.attitude"]
        residual = _smaller_ins_error_residual(residual, mean[slow], jacobian_v[:, slow])
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

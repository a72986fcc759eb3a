"""The measured attitude of a device against the one predicted from the INS, with its Jacobian (models.md §4).

With R_i the INS attitude at the device's moment, all errors explained in :mod:`ship_attitude_star.ship_attitude.model`:

    R_measured = exp(-z) exp(c) exp(a) exp(w) R_i exp(f) R0 exp(m) exp(s) exp(noise)        horizon from device

with c a star sensor's common error, f flexure, m installation error, s the slow error of a reference; z is the turn of
the sky that all sensors share, a sum over its causes.

The residual is log(R_predicted^T R_measured), a rotation vector in the device frame.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.ship_attitude.model import Device, sky_rows
from ship_estimation.state import StateModel
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation


@dataclass(frozen=True)
class PredictedAttitude:
    """A device's attitude as the state predicts it.

    Attributes:
        rotation_nv: horizon from device, shape (3, 3).
        jacobian_v: rotation vector in the device frame per state error, shape (3, n).
        interpolation_v: covariance of the error of the INS's attitude between its samples, rotation vector in the
            device frame, rad², shape (3, 3).
    """

    rotation_nv: FloatArray
    jacobian_v: FloatArray
    interpolation_v: FloatArray


def ins_time_of(device: Device, model: StateModel, mean: FloatArray, time_ns: int) -> int:
    """Stamp (ns) of the INS for the attitude that a device stamped ``time_ns``."""
    shift_s = device.ins_time_s
    for name, sign in device.ins_time_states:
        shift_s += sign * mean[model.slices[name]][0]
    return time_ns + round(shift_s * 1e9)


def predict_attitude(
    device: Device, model: StateModel, mean: FloatArray, ins: InterpolatedAttitude
) -> PredictedAttitude:
    """The attitude of a device at the moment of an (interpolated) INS attitude.

    The chain is multiplied from the device outwards; an error of a factor exp(v) is a small rotation
    J_left(v) dv in the frame on its left, which everything multiplied so far brings into the device frame.
    """
    jacobian = np.zeros((3, model.size))

    def turned(name: str, rotation: FloatArray, scale: float = 1.0) -> FloatArray:
        """Multiply ``rotation`` from the left by exp(state ``name``), where there is such a state."""
        if name not in model.slices:
            return rotation
        vector = scale * mean[model.slices[name]]
        rotation = exp_rotation(vector) @ rotation
        jacobian[:, model.slices[name]] = scale * rotation.T @ left_jacobian(vector)
        return rotation

    rotation_dv = turned(f"{device.name}.slow", np.eye(3))
    rotation_dv = device.rotation_dv0 @ turned(f"{device.name}.installation", rotation_dv)
    rotation_dv = turned(f"{device.name}.flexure", rotation_dv)
    rate_v = rotation_dv.T @ ins.rate_d
    for name, sign in device.ins_time_states:
        jacobian[:, model.slices[name]] = sign * rate_v[:, None]
    rotation_nv = turned("ins.noise", ins.rotation_nd @ rotation_dv, float(np.sqrt(ins.noise_gain)))
    rotation_nv = turned("ins.attitude", rotation_nv)
    rotation_nv = turned(f"{device.name}.common", rotation_nv)
    interpolation_v = rotation_dv.T @ ins.error_covariance_d @ rotation_dv
    return PredictedAttitude(rotation_nv, jacobian, interpolation_v)


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

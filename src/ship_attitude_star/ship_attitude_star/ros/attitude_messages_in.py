"""From messages to the core's structs: axes, units and checks. Reads attributes only, so any message class will do."""

from typing import Any

import numpy as np

from ship_attitude_star.measurements.inertial_attitude import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.ship_attitude.config import ReferenceConfig, StarSensorConfig
from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance
from ship_geometry.ros_axes import (
    FLU_FROM_DEVICE,
    celestial_rotation_from_quaternion,
    horizon_covariance,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.edge.imu_messages_in import imu_rotation
from ship_node.edge.message_checks import (
    Refused,
    covariance_3x3,
    device_id,
    finite_numbers,
    frame,
    stamp_ns,
    unit_quaternion,
)

_STAR_INVALID = 3
_COVARIANCE_TOLERANCE = 1e-6
_LARGEST_VARIANCE = (2.0 * np.pi) ** 2


def star_measurement(message: Any, sensor_id: str, config: StarSensorConfig, receive_ns: int) -> AttitudeMeasurement:
    """``star/<sensor>/horizon_attitude`` or ``.../solution`` → the sensor's attitude in the horizon.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    frame(message.header.frame_id, config.frame_id)
    if message.status == _STAR_INVALID:
        raise Refused("too_few_stars", "the sensor itself says INVALID")
    finite_numbers("azimuth, elevation, roll", message.azimuth, message.elevation, message.roll)
    _radians(message)
    rotation_ns = rotation_from_angles(message.azimuth, message.elevation, message.roll)
    total_n = _total_covariance(message)
    if total_n is None:
        noise_s = _configured_noise(config)
        return AttitudeMeasurement(f"star.{sensor_id}", time_ns, rotation_ns, noise_s, covariance_known=False)
    noise_enu = _angular_covariance(message.noise_covariance, "noise_covariance")
    noise_n = total_n if noise_enu is None else horizon_covariance(noise_enu)
    return AttitudeMeasurement(
        f"star.{sensor_id}",
        time_ns,
        rotation_ns,
        rotation_ns.T @ noise_n @ rotation_ns,
        _common_covariance(total_n, noise_n),
    )


def inertial_attitude(message: Any, sensor_id: str, config: StarSensorConfig, receive_ns: int) -> InertialAttitude:
    """``star/<sensor>/inertial_attitude`` → the sensor's attitude against the ICRS.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    device_id("sensor_id", message.sensor_id, sensor_id)
    frame(message.header.frame_id, config.frame_id)
    rotation_cs = celestial_rotation_from_quaternion(unit_quaternion(message.orientation, "orientation"))
    covariance_flu = _angular_covariance(message.covariance, "covariance")
    if covariance_flu is None:
        noise_s = _configured_noise(config)
        return InertialAttitude(f"star.{sensor_id}", time_ns, rotation_cs, noise_s, False, config.inertial.field)
    noise_s = FLU_FROM_DEVICE.T @ covariance_flu @ FLU_FROM_DEVICE
    return InertialAttitude(f"star.{sensor_id}", time_ns, rotation_cs, noise_s, field=config.inertial.field)


def reference_measurement(message: Any, name: str, config: ReferenceConfig, receive_ns: int) -> AttitudeMeasurement:
    """``reference/<name>/imu`` → the attitude of another system; its covariance is white.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    frame(message.header.frame_id, config.frame_id)
    rotation_nr = imu_rotation(message, config.convention)
    covariance_enu = _angular_covariance(message.orientation_covariance, "orientation_covariance")
    if covariance_enu is None:
        sigma = [config.sigma_roll_arcsec, config.sigma_heading_arcsec, config.sigma_pitch_arcsec]
        noise_r = np.diag((np.array(sigma) * ARCSEC) ** 2)
    else:
        noise_r = rotation_nr.T @ horizon_covariance(covariance_enu) @ rotation_nr
    known = covariance_enu is not None
    return AttitudeMeasurement(f"reference.{name}", time_ns, rotation_nr, noise_r, covariance_known=known)


def _configured_noise(config: StarSensorConfig) -> FloatArray:
    """Covariance of an attitude whose message gives none, in the sensor frame."""
    sigma = [config.sigma_forward_arcsec, config.sigma_up_arcsec, config.sigma_right_arcsec]
    noise_s: FloatArray = np.diag((np.array(sigma) * ARCSEC) ** 2)
    return noise_s


def _radians(message: Any) -> None:
    """Angles in degrees give themselves away where they exceed what radians can be."""
    if abs(message.elevation) > np.pi / 2 + 1e-9 or max(abs(message.azimuth), abs(message.roll)) > 2 * np.pi + 1e-9:
        raise Refused(
            "units",
            f"azimuth {message.azimuth:.6g}, elevation {message.elevation:.6g}, roll {message.roll:.6g} "
            "cannot be radians: degrees?",
        )


def _angular_covariance(values: Any, what: str) -> FloatArray | None:
    """A covariance (rad²) that is used as noise; None where it is unknown."""
    covariance = covariance_3x3(values, what)
    if covariance is not None and covariance.diagonal().max() > _LARGEST_VARIANCE:
        largest = covariance.diagonal().max()
        raise Refused("bad_covariance", f"{what}: a variance of {largest:.3g} rad² is a sigma of more than a full turn")
    return covariance


def _total_covariance(message: Any) -> FloatArray | None:
    """Total covariance of the rotation vector in the horizon frame; None where the message gives none."""
    rotation_enu = _angular_covariance(message.rotation_covariance, "rotation_covariance")
    if rotation_enu is not None:
        return horizon_covariance(rotation_enu)
    angles = _angular_covariance(message.covariance, "covariance")
    if angles is None:
        return None
    return rotation_vector_covariance(angles, message.azimuth, message.elevation)


def _common_covariance(total_n: FloatArray, noise_n: FloatArray) -> FloatArray:
    """What successive solutions share: total minus noise, which must not be negative."""
    values, vectors = np.linalg.eigh(total_n - noise_n)
    limit = _COVARIANCE_TOLERANCE * float(np.trace(total_n))
    if values[0] < -limit:
        raise Refused("bad_covariance", "noise_covariance is larger than the total covariance")
    kept = np.where(values > limit, values, 0.0)
    common: FloatArray = (vectors * kept) @ vectors.T
    return common

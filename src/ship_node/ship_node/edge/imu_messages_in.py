"""From sensor_msgs/Imu to attitudes: axes, units and checks, for every node that hears an INS or the like."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_estimation.ins_config import InsInputConfig
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.frames import rotation_from_angles
from ship_geometry.ros_axes import device_vector_from_ros, rotation_from_quaternion
from ship_geometry.rotations import FloatArray
from ship_node.edge.message_checks import Refused, covariance_3x3, finite_vector, frame, stamp_ns, unit_quaternion

_LARGEST_RATE = 100.0
"""No ship turns like this, rad/s; far above what degrees per second would give, which are found by their ratio."""


@dataclass(frozen=True)
class InsMessage:
    """A message of the INS as the core takes it.

    Attributes:
        value: attitude and rate of the deck.
        covariance_known: False where the message gives no covariance.
    """

    value: AttitudeSample
    covariance_known: bool


def ins_sample(message: Any, config: InsInputConfig, receive_ns: int) -> InsMessage:
    """``ins/imu`` → attitude and rate of the deck.

    Its covariance is the INS's total error, not white noise: it is checked and otherwise left alone.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    frame(message.header.frame_id, config.frame_id)
    rotation_ni = imu_rotation(message, config.convention)
    covariance = covariance_3x3(message.orientation_covariance, "orientation_covariance")
    rotation_di = rotation_from_angles(
        *np.deg2rad([config.installation_heading_deg, config.installation_pitch_deg, config.installation_roll_deg])
    )
    rate_d = None
    if message.angular_velocity_covariance[0] != -1.0:
        rate_d = rotation_di @ device_vector_from_ros(ship_rate(message.angular_velocity), config.convention)
    return InsMessage(AttitudeSample(time_ns, rotation_ni @ rotation_di.T, rate_d), covariance is not None)


def ship_rate(angular_velocity: Any) -> FloatArray:
    """The numbers of an angular velocity (rad/s), in the axes of the message, shape (3,).

    Raises:
        Refused: ``non_finite``, or ``units`` where no ship turns so fast.
    """
    rate_ros = finite_vector(angular_velocity, "angular_velocity")
    if np.max(np.abs(rate_ros)) > _LARGEST_RATE:
        raise Refused("units", f"angular_velocity {rate_ros.tolist()} cannot be a ship's in rad/s")
    return rate_ros


def imu_rotation(message: Any, convention: str) -> FloatArray:
    """Orientation of a sensor_msgs/Imu as a rotation "horizon from device", shape (3, 3).

    Raises:
        Refused: ``non_finite`` or ``bad_quaternion``.
    """
    return rotation_from_quaternion(unit_quaternion(message.orientation, "orientation"), convention)

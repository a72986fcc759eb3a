"""Readers of the INS's messages (sensor_msgs/Imu), for one message and for a batch."""

from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_estimation.parameters.ins import InsInputConfig
from ship_geometry.ros_axes import device_vector_from_ros, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, SampleBlock
from ship_node.messages.batch import ReadBatch, StampArray
from ship_node.messages.column_checks import imu_quaternions, ship_rates, stamps
from ship_node.messages.field_checks import (
    NOT_GIVEN,
    MessageRejected,
    ReadMessage,
    check_frame,
    covariance_3x3,
    imu_quaternion,
    ship_rate,
    stamp_ns,
)

SIGMA_MISMATCH_RATIO = 1.5
"""Ratio of the sigma stated by an INS to the configured sigma, above which the stated sigma is reported."""


def sigma_mismatch_text(covariance: FloatArray, config: InsInputConfig) -> str:
    """Return a text about sigmas that the INS states too large for the configuration; empty if there are none.

    Args:
        covariance: orientation covariance in the INS's messages, rad², shape (3, 3); the third axis is vertical.
        config: configuration of the INS.
    """
    stated_arcsec = np.sqrt(covariance.diagonal()) / ARCSEC
    pairs = (
        ("tilt", float(max(stated_arcsec[:2])), config.tilt_sigma_arcsec),
        ("heading", float(stated_arcsec[2]), config.heading_sigma_arcsec),
    )
    return "; ".join(
        f"ins/imu states a sigma of {stated:.0f} arcsec in {name}, ins.{name}_sigma_arcsec is {configured:g}"
        for name, stated, configured in pairs
        if stated > SIGMA_MISMATCH_RATIO * np.hypot(configured, config.white_sigma_arcsec)
    )


def ins_sample(message: Any, config: InsInputConfig, receive_ns: int) -> ReadMessage[AttitudeSample]:
    """Convert an ``ins/imu`` message to attitude and angular rate of the deck.

    The covariance in the message describes the INS's total error, not white noise, so it is only checked.

    Raises:
        MessageRejected: the message fails a check.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, config.frame_id)
    quaternion = imu_quaternion(message, config.accept_unset_covariance)
    covariance = covariance_3x3(message.orientation_covariance, "orientation_covariance")
    (rotation_nd,) = _rotations_nd(quaternion[None], config)
    rate_d = None
    if message.angular_velocity_covariance[0] != NOT_GIVEN:
        (rate_d,) = _rates_d(ship_rate(message.angular_velocity)[None], config)
    return ReadMessage(AttitudeSample(time_ns, rotation_nd, rate_d), covariance is not None)


def ins_batch(messages: CdrRows, receive_ns: StampArray, config: InsInputConfig) -> ReadBatch:
    """Return the leading messages of a batch that :func:`ins_sample` accepts.

    These messages all have angular rates and the same covariance. Each sample equals the result of :func:`ins_sample`
    bit for bit.

    Args:
        messages: messages of ``ins/imu``.
        receive_ns: receive time of each message by the node's clock, shape (N,).
        config: configuration of the INS.
    """
    first, numbers = messages.message(0), messages.numbers
    try:
        check_frame(first.header.frame_id, config.frame_id)
        covariance = covariance_3x3(first.orientation_covariance, "orientation_covariance")
    except MessageRejected:
        # The first message is rejected by ins_sample, with its reason.
        numbers, covariance = numbers[:0], None
    times_ns, timely = stamps(numbers, receive_ns)
    quaternions, of_norm_1 = imu_quaternions(numbers, config.accept_unset_covariance)
    rates_ros, of_ship = ship_rates(numbers)
    covariances = numbers["orientation_covariance"].view(np.int64)
    same_covariance = (covariances == covariances[:1]).all(axis=1)
    rate_given = numbers["angular_velocity_covariance"][:, 0] != NOT_GIVEN
    valid = timely & of_norm_1 & of_ship & same_covariance & rate_given
    count = len(valid) if valid.all() else int(np.argmin(valid))
    rotations_nd = _rotations_nd(quaternions[:count], config)
    samples = SampleBlock(times_ns[:count], rotations_nd, _rates_d(rates_ros[:count], config))
    return ReadBatch(samples, covariance is not None)


def _rotations_nd(quaternions: FloatArray, config: InsInputConfig) -> FloatArray:
    """Convert quaternions of the INS, shape (N, 4), to rotations deck → horizon, shape (N, 3, 3)."""
    rotations: FloatArray = rotation_from_quaternion(quaternions, config.convention) @ config.rotation_di.T
    return rotations


def _rates_d(rates_ros: FloatArray, config: InsInputConfig) -> FloatArray:
    """Convert angular rates from the axes of the message to the deck frame, rad/s, shape (N, 3)."""
    rates: FloatArray = (config.rotation_di @ device_vector_from_ros(rates_ros, config.convention)[..., None])[..., 0]
    return rates

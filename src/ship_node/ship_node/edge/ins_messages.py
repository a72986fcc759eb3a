"""The messages of an INS, sensor_msgs/Imu, which every node hears: one of them, and the many of a block."""

from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_estimation.ins import InsInputConfig
from ship_geometry.attitude_track import AttitudeSample, SampleBlock
from ship_geometry.ros_axes import device_vector_from_ros, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.edge.blocks import ReadBlock, StampArray
from ship_node.edge.columns_in import imu_quaternions, ship_rates, stamps
from ship_node.edge.messages_in import (
    NOT_GIVEN,
    ReadMessage,
    Refused,
    covariance_3x3,
    frame,
    imu_quaternion,
    ship_rate,
    stamp_ns,
)

CONTRADICTED_FACTOR = 1.5
"""Ratio of a sigma that an INS states to the configured one from which on it is reported."""


def contradicted_sigmas(covariance: FloatArray, config: InsInputConfig) -> str:
    """Return the sigmas that an INS states of itself and that are larger than the configured ones; empty if none is.

    Args:
        covariance: of the orientation in its messages, rad², shape (3, 3); the third axis is vertical.
        config: of the INS.
    """
    stated_arcsec = np.sqrt(covariance.diagonal()) / ARCSEC
    pairs = (
        ("tilt", float(max(stated_arcsec[:2])), config.tilt_sigma_arcsec),
        ("heading", float(stated_arcsec[2]), config.heading_sigma_arcsec),
    )
    return "; ".join(
        f"ins/imu states a sigma of {stated:.0f} arcsec in {name}, ins.{name}_sigma_arcsec is {configured:g}"
        for name, stated, configured in pairs
        if stated > CONTRADICTED_FACTOR * np.hypot(configured, config.white_sigma_arcsec)
    )


def ins_sample(message: Any, config: InsInputConfig, receive_ns: int) -> ReadMessage[AttitudeSample]:
    """``ins/imu`` → attitude and rate of the deck.

    Its covariance is the INS's total error, not white noise: it is checked and otherwise left alone.

    Raises:
        Refused: with the reason.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    frame(message.header.frame_id, config.frame_id)
    quaternion = imu_quaternion(message, config.accept_unset_covariance)
    covariance = covariance_3x3(message.orientation_covariance, "orientation_covariance")
    (rotation_nd,) = _rotations_nd(quaternion[None], config)
    rate_d = None
    if message.angular_velocity_covariance[0] != NOT_GIVEN:
        (rate_d,) = _rates_d(ship_rate(message.angular_velocity)[None], config)
    return ReadMessage(AttitudeSample(time_ns, rotation_nd, rate_d), covariance is not None)


def ins_block(messages: CdrRows, receive_ns: StampArray, config: InsInputConfig) -> ReadBlock:
    """The messages of a block that :func:`ins_sample` takes, with rates and the same covariance in all: a SampleBlock.

    Each sample is, to the last bit, what :func:`ins_sample` makes of its message.

    Args:
        messages: of ``ins/imu``.
        receive_ns: when each came by the node's clock, shape (N,).
        config: of the INS.
    """
    first, numbers = messages.message(0), messages.numbers
    try:
        frame(first.header.frame_id, config.frame_id)
        covariance = covariance_3x3(first.orientation_covariance, "orientation_covariance")
    except Refused:
        # The first one will be refused by itself.
        numbers, covariance = numbers[:0], None
    times_ns, timely = stamps(numbers, receive_ns)
    quaternions, of_norm_1 = imu_quaternions(numbers, config.accept_unset_covariance)
    rates_ros, of_ship = ship_rates(numbers)
    covariances = numbers["orientation_covariance"].view(np.int64)
    same_covariance = (covariances == covariances[:1]).all(axis=1)
    rate_given = numbers["angular_velocity_covariance"][:, 0] != NOT_GIVEN
    good = timely & of_norm_1 & of_ship & same_covariance & rate_given
    count = len(good) if good.all() else int(np.argmin(good))
    rotations_nd = _rotations_nd(quaternions[:count], config)
    samples = SampleBlock(times_ns[:count], rotations_nd, _rates_d(rates_ros[:count], config))
    return ReadBlock(samples, covariance is not None)


def _rotations_nd(quaternions: FloatArray, config: InsInputConfig) -> FloatArray:
    """Horizon from deck, shape (N, 3, 3), of orientations of the INS as quaternions, shape (N, 4)."""
    rotations: FloatArray = rotation_from_quaternion(quaternions, config.convention) @ config.rotation_di.T
    return rotations


def _rates_d(rates_ros: FloatArray, config: InsInputConfig) -> FloatArray:
    """Rates in the deck frame, of rates in the axes of the message, rad/s, shape (N, 3)."""
    rates: FloatArray = (config.rotation_di @ device_vector_from_ros(rates_ros, config.convention)[..., None])[..., 0]
    return rates

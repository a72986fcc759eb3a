"""Readers of the sensor messages that both estimators use: INS (sensor_msgs/Imu) and ship_msgs/RtkBaseline.

The messages of the INS are read one by one or as a block.
"""

from typing import Any, Protocol

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_estimation.parameters.ship_devices import InsInputConfig
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.frames import ENU_FROM_HORIZON, device_vector_from_ros, horizon_covariance, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, SampleBlock
from ship_node.messages.field_checks import (
    NOT_GIVEN,
    MessageRejected,
    ReadMessage,
    check_device_id,
    check_frame,
    covariance_3x3,
    finite_vector,
    imu_quaternion,
    imu_quaternions,
    ship_rate,
    ship_rates,
    stamp_ns,
    stamps,
)
from ship_node.messages.inputs_outputs import ReadBlock

SIGMA_MISMATCH_RATIO = 1.5
"""Ratio of the sigma stated by an INS to the configured sigma, above which the stated sigma is reported."""

_NO_RATES = np.empty((0, 3))
_FIXES = ("NONE", "SINGLE", "DGNSS", "FLOAT", "FIXED")
_MAX_LENGTH_M = 1e5


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
    rate_given = message.angular_velocity_covariance[0] != NOT_GIVEN
    rates_ros = ship_rate(message.angular_velocity)[None] if rate_given else _NO_RATES
    rotations_nd, rates_d = _of_deck(quaternion[None], rates_ros, config)
    sample = AttitudeSample(time_ns, rotations_nd[0], rates_d[0] if rate_given else None)
    return ReadMessage(sample, covariance is not None)


def ins_block(messages: CdrRows, receive_ns: StampArray, config: InsInputConfig) -> ReadBlock:
    """Return the leading messages of a block that :func:`ins_sample` accepts.

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
    samples = SampleBlock(times_ns[:count], *_of_deck(quaternions[:count], rates_ros[:count], config))
    return ReadBlock(samples, covariance is not None)


def _of_deck(
    quaternions: FloatArray, rates_ros: FloatArray, config: InsInputConfig
) -> tuple[FloatArray, FloatArray]:
    """Return rotations deck → horizon, shape (N, 3, 3), and angular rates in the deck frame, rad/s, shape (M, 3).

    Args:
        quaternions: attitudes of the INS, x, y, z, w, shape (N, 4).
        rates_ros: angular rates in the axes of the message, rad/s, shape (M, 3).
        config: configuration of the INS.
    """
    rotations: FloatArray = rotation_from_quaternion(quaternions, config.convention) @ config.rotation_di.T
    rates: FloatArray = (config.rotation_di @ device_vector_from_ros(rates_ros, config.convention)[..., None])[..., 0]
    return rotations, rates


class Antennas(Protocol):
    """Expected frame and antennas of a baseline; an empty text accepts any value."""

    @property
    def frame_id(self) -> str:
        """Frame: the horizon at the base antenna."""

    @property
    def base_id(self) -> str:
        """Antenna at which the vector starts."""

    @property
    def rover_id(self) -> str:
        """Antenna at which the vector ends."""


def baseline_stamp_ns(message: Any, antennas: Antennas, receive_ns: int) -> int:
    """Return the stamp of a baseline message, ns, after a check of its frame and antennas.

    Raises:
        MessageRejected: the frame or an antenna is not the expected one, or the stamp is invalid.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    check_frame(message.header.frame_id, antennas.frame_id)
    for name, given, expected in (
        ("base_id", message.base_id, antennas.base_id),
        ("rover_id", message.rover_id, antennas.rover_id),
    ):
        if expected:
            check_device_id(name, given, expected)
    return time_ns


def fix_rejection(message: Any, least_fix: str) -> Rejection | None:
    """Return the rejection of a baseline whose fix is below ``least_fix`` ("float", "fixed") or unknown; else None."""
    if _FIXES.index(least_fix.upper()) <= message.fix < len(_FIXES):
        return None
    fix = _FIXES[message.fix] if message.fix < len(_FIXES) else message.fix
    return Rejection(Reason.NOT_FIXED, f"baseline is {fix}: expected {least_fix.upper()}")


def baseline_vector(message: Any) -> tuple[FloatArray, FloatArray | None]:
    """Return the vector (North, Up, East), m, shape (3,), and its covariance, m², shape (3, 3), or None if not given.

    Raises:
        MessageRejected: a value is not finite or too large, or the covariance is invalid.
    """
    vector_n = ENU_FROM_HORIZON.T @ finite_vector(message.enu, "enu")
    if np.max(np.abs(vector_n)) > _MAX_LENGTH_M:
        raise MessageRejected(Reason.UNITS, f"baseline N, U, E {vector_n.tolist()}: expected metres, 100 km at most")
    covariance_enu = covariance_3x3(message.covariance)
    if covariance_enu is None:
        return vector_n, None
    if np.max(np.diagonal(covariance_enu)) > _MAX_LENGTH_M**2:
        raise MessageRejected(Reason.BAD_COVARIANCE, "a sigma of more than 100 km")
    return vector_n, horizon_covariance(covariance_enu)

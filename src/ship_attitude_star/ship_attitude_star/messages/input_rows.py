"""Readers of blocks of messages: conversion of all regular messages of a block at once.

The results are bit-identical to the results of :mod:`ship_attitude_star.messages.input_messages`. None stands for a
message that the readers of that module must read separately.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_attitude_star.messages.input_messages import MAX_ANGLE, MAX_ELEVATION, STAR_INVALID, attitude_from_numbers
from ship_attitude_star.ship_attitude.devices import StarSensorConfig
from ship_bags.cdr_template import CdrRows
from ship_geometry.ros_axes import horizon_covariance
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_rotations
from ship_node.messages.batch import StampArray
from ship_node.messages.column_checks import ReadRows, angular_covariances, read_valid, stamps
from ship_node.messages.field_checks import MessageRejected, ReadMessage


def star_attitudes(messages: CdrRows, receive_ns: StampArray, sensor_id: str, config: StarSensorConfig) -> ReadRows:
    """Read ``star/<sensor>/horizon_attitude`` or ``.../solution`` with both covariances of the rotation vector.

    See :func:`ship_attitude_star.messages.input_messages.star_measurement`.
    """
    numbers = messages.numbers
    times_ns, timely = stamps(numbers, receive_ns)
    angles = np.stack([numbers["azimuth"], numbers["elevation"], numbers["roll"]], axis=1)
    totals_enu, total_known = angular_covariances(numbers["rotation_covariance"])
    noises_enu, noise_known = angular_covariances(numbers["noise_covariance"])
    good = timely & total_known & noise_known & (numbers["status"] != STAR_INVALID)
    good &= (np.abs(angles) <= [MAX_ANGLE, MAX_ELEVATION, MAX_ANGLE]).all(axis=1)

    def attitude(
        time_ns: int, rotation_ns: FloatArray, total_n: FloatArray, noise_n: FloatArray
    ) -> ReadMessage[Any] | None:
        try:
            return attitude_from_numbers(
                f"star.{sensor_id}", time_ns, rotation_ns, total_n, noise_n, config.shared_error
            )
        except MessageRejected:
            return None

    def attitudes() -> Iterator[ReadMessage[Any] | None]:
        rotations_ns = compiled_rotations.rotations(angles[good])
        covariances_n = horizon_covariance(totals_enu[good]), horizon_covariance(noises_enu[good])
        return map(attitude, times_ns[good].tolist(), rotations_ns, *covariances_n)

    return read_valid(messages, config.frame_id, good, attitudes)

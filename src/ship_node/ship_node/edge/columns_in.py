"""What the messages of a block must hold before any of it reaches a filter, checked over arrays.

Each check says of every message whether :mod:`ship_node.edge.messages_in` lets it pass in the usual way; what it gives
of those that pass is, to the last bit, what is given there. The others are read one by one, and may be used all the
same. Every comparison is written so that NaN is no good.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_bags.stamps import NS_PER_S, stamps_of_rows
from ship_geometry.rotations import FloatArray
from ship_node.edge.blocks import StampArray
from ship_node.edge.messages_in import (
    CLEAR_DETERMINANT,
    COVARIANCE_TOLERANCE,
    FUTURE_TOLERANCE_NS,
    LARGEST_RATE,
    LARGEST_VARIANCE,
    LEAST_QUATERNION_NORM,
    NOT_GIVEN,
    QUATERNION_NORM_TOLERANCE,
    ReadMessage,
)

_ABOVE, _BELOW = [1, 2, 5], [3, 6, 7]
"""The elements beside the diagonal of a matrix of nine numbers."""

Good = NDArray[np.bool_]
"""Of each message whether it passes, shape (N,)."""

ReadRows = list[ReadMessage[Any] | None]
"""What was read of each message; None where it is to be read by itself."""


def read_of_good(
    messages: CdrRows, frame_id: str, good: Good, read: Callable[[], Iterator[ReadMessage[Any] | None]]
) -> ReadRows:
    """What was read of those messages that are good; none of another frame is, and all have the same one.

    Args:
        messages: the messages.
        frame_id: that they must have; empty for any.
        good: which of them are.
        read: reads these.
    """
    if frame_id and messages.message(0).header.frame_id != frame_id:
        return [None] * len(good)
    readings = read()
    return [next(readings) if passed else None for passed in good.tolist()]


def columns(numbers: np.ndarray, field: str, names: str) -> FloatArray:
    """The numbers of a vector in all messages, shape (N, n)."""
    return np.stack([numbers[f"{field}.{name}"] for name in names], axis=1)


def stamps(numbers: np.ndarray, receive_ns: StampArray) -> tuple[StampArray, Good]:
    """The stamps, ns, shape (N,)."""
    times_ns, good = stamps_of_rows(numbers), numbers["header.stamp.nanosec"] < NS_PER_S
    return times_ns, good & (times_ns > 0) & (times_ns <= receive_ns[: len(numbers)] + FUTURE_TOLERANCE_NS)


def unit_quaternions(numbers: np.ndarray, field: str = "orientation") -> tuple[FloatArray, Good]:
    """Quaternions x, y, z, w with norm 1, shape (N, 4)."""
    quaternions = columns(numbers, field, "xyzw")
    x, y, z, w = quaternions.T
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        norms = np.sqrt(x * x + y * y + z * z + w * w)
        unit: FloatArray = quaternions / norms[:, None]
    good: Good = (norms >= LEAST_QUATERNION_NORM) & (np.abs(norms - 1.0) <= QUATERNION_NORM_TOLERANCE)
    return unit, good


def imu_quaternions(numbers: np.ndarray, accept_unset_covariance: bool) -> tuple[FloatArray, Good]:
    """Orientations of sensor_msgs/Imu, x, y, z, w with norm 1, shape (N, 4)."""
    quaternions, good = unit_quaternions(numbers)
    given: Good = numbers["orientation_covariance"][:, 0] != NOT_GIVEN
    return quaternions, good & (given | accept_unset_covariance)


def ship_rates(numbers: np.ndarray) -> tuple[FloatArray, Good]:
    """Angular velocities, rad/s, in the axes of the messages, shape (N, 3)."""
    rates_ros = columns(numbers, "angular_velocity", "xyz")
    good: Good = np.abs(rates_ros).max(axis=1) <= LARGEST_RATE
    return rates_ros, good


def covariances_3x3(values: FloatArray) -> tuple[FloatArray, Good]:
    """Covariances given as nine numbers each, shape (N, 9), symmetric, shape (N, 3, 3).

    Those that are unknown do not pass, and neither do those that are positive definite by rounding at most.
    """
    above, below = values[:, _ABOVE], values[:, _BELOW]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        sigma = np.sqrt(values[:, ::4])
        limits = sigma[:, [0, 0, 1]] * sigma[:, [1, 2, 2]]
        beside = 0.5 * above + 0.5 * below
        a, b, c = (beside / limits).T
        determinant = 1.0 + 2.0 * a * b * c - a * a - b * b - c * c
        alike = np.abs(above - below) <= COVARIANCE_TOLERANCE * limits
    good = np.isfinite(values).all(axis=1) & (limits > 0.0).all(axis=1) & alike.all(axis=1)
    good &= (np.abs(a) < 1.0) & (determinant > CLEAR_DETERMINANT)
    symmetric = values.copy()
    symmetric[:, _ABOVE] = symmetric[:, _BELOW] = beside
    return symmetric.reshape(-1, 3, 3), good


def angular_covariances(values: FloatArray) -> tuple[FloatArray, Good]:
    """The same of angles or of rotation vectors, rad²."""
    covariances, good = covariances_3x3(values)
    return covariances, good & (values[:, ::4] <= LARGEST_VARIANCE).all(axis=1)

"""Checks of the messages of a batch before any of them reaches a filter, as array operations.

Each check returns, for every message, True only if :mod:`ship_node.messages.field_checks` accepts the message without
remark. The values of these messages are bit for bit the values that :mod:`ship_node.messages.field_checks` returns. The
other messages are read one by one and may still be used. A message with NaN in a checked value is not valid, because
NaN is within no limit.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_bags.stamps import NS_PER_S, stamps_of_rows
from ship_geometry.rotations import FloatArray
from ship_node.messages.batch import StampArray
from ship_node.messages.field_checks import (
    COVARIANCE_TOLERANCE,
    FUTURE_TOLERANCE_NS,
    MAX_RATE,
    MAX_VARIANCE,
    MIN_DEFINITE_DETERMINANT,
    MIN_QUATERNION_NORM,
    NOT_GIVEN,
    QUATERNION_NORM_TOLERANCE,
    ReadMessage,
)

_ABOVE, _BELOW = [1, 2, 5], [3, 6, 7]
"""Indices of the off-diagonal elements of a 3x3 matrix given as nine numbers."""

Valid = NDArray[np.bool_]
"""True for each message that passes, shape (N,)."""

ReadRows = list[ReadMessage[Any] | None]
"""Result of reading each message; None if the message must be read alone."""


def read_valid(
    messages: CdrRows, frame_id: str, valid: Valid, read: Callable[[], Iterator[ReadMessage[Any] | None]]
) -> ReadRows:
    """Return the results of reading valid messages; None for other messages, and for all if the frame is wrong.

    Args:
        messages: the messages, which all have the same frame.
        frame_id: expected frame; empty for any.
        valid: True for each valid message, shape (N,).
        read: yields the results of reading the valid messages.
    """
    if frame_id and messages.message(0).header.frame_id != frame_id:
        return [None] * len(valid)
    readings = read()
    return [next(readings) if passed else None for passed in valid.tolist()]


def columns(numbers: np.ndarray, field: str, names: str) -> FloatArray:
    """Return the components of a vector field of all messages, shape (N, n)."""
    return np.stack([numbers[f"{field}.{name}"] for name in names], axis=1)


def stamps(numbers: np.ndarray, receive_ns: StampArray) -> tuple[StampArray, Valid]:
    """Return the stamps, ns, shape (N,), and their validity."""
    times_ns, valid = stamps_of_rows(numbers), numbers["header.stamp.nanosec"] < NS_PER_S
    return times_ns, valid & (times_ns > 0) & (times_ns <= receive_ns[: len(numbers)] + FUTURE_TOLERANCE_NS)


def unit_quaternions(numbers: np.ndarray, field: str = "orientation") -> tuple[FloatArray, Valid]:
    """Return quaternions x, y, z, w with norm 1, shape (N, 4), and their validity."""
    quaternions = columns(numbers, field, "xyzw")
    x, y, z, w = quaternions.T
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        norms = np.sqrt(x * x + y * y + z * z + w * w)
        unit: FloatArray = quaternions / norms[:, None]
    valid: Valid = (norms >= MIN_QUATERNION_NORM) & (np.abs(norms - 1.0) <= QUATERNION_NORM_TOLERANCE)
    return unit, valid


def imu_quaternions(numbers: np.ndarray, accept_unset_covariance: bool) -> tuple[FloatArray, Valid]:
    """Return the orientations of sensor_msgs/Imu, x, y, z, w with norm 1, shape (N, 4), and their validity."""
    quaternions, valid = unit_quaternions(numbers)
    given: Valid = numbers["orientation_covariance"][:, 0] != NOT_GIVEN
    return quaternions, valid & (given | accept_unset_covariance)


def ship_rates(numbers: np.ndarray) -> tuple[FloatArray, Valid]:
    """Return the angular velocities in the axes of the messages, rad/s, shape (N, 3), and their validity."""
    rates_ros = columns(numbers, "angular_velocity", "xyz")
    valid: Valid = np.abs(rates_ros).max(axis=1) <= MAX_RATE
    return rates_ros, valid


def covariances_3x3(values: FloatArray) -> tuple[FloatArray, Valid]:
    """Convert rows of nine numbers, shape (N, 9), to symmetric covariances, shape (N, 3, 3), and their validity.

    Unknown covariances and covariances that are positive definite only within rounding are not valid.
    """
    above, below = values[:, _ABOVE], values[:, _BELOW]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        sigma = np.sqrt(values[:, ::4])
        limits = sigma[:, [0, 0, 1]] * sigma[:, [1, 2, 2]]
        off_diagonal = 0.5 * above + 0.5 * below
        a, b, c = (off_diagonal / limits).T
        determinant = 1.0 + 2.0 * a * b * c - a * a - b * b - c * c
        symmetric_enough = np.abs(above - below) <= COVARIANCE_TOLERANCE * limits
    valid = np.isfinite(values).all(axis=1) & (limits > 0.0).all(axis=1) & symmetric_enough.all(axis=1)
    valid &= (np.abs(a) < 1.0) & (determinant > MIN_DEFINITE_DETERMINANT)
    symmetric = values.copy()
    symmetric[:, _ABOVE] = symmetric[:, _BELOW] = off_diagonal
    return symmetric.reshape(-1, 3, 3), valid


def angular_covariances(values: FloatArray) -> tuple[FloatArray, Valid]:
    """Return :func:`covariances_3x3` of angles or rotation vectors, rad²; a too large variance is not valid."""
    covariances, valid = covariances_3x3(values)
    return covariances, valid & (values[:, ::4] <= MAX_VARIANCE).all(axis=1)

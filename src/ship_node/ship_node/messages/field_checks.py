"""Checks of the fields of messages before any of them reaches a filter: of one message, and of a block as arrays.

The packages' readers are built from these checks. A failed check of one message raises :class:`MessageRejected`. Values
are returned in the form that cores use.

Each check of a block returns, for every message, True only if the check of one message accepts the message without
remark; the values are then the same, bit for bit. The other messages are read one by one and may still be used. A
message with NaN in a checked value is not valid, because NaN is within no limit.
"""

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_bags.stamps import NS_PER_S, duration_text, stamps_of_rows
from ship_estimation.rejection_rules import Reason, Rejection, shorten
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.frames import rotation_from_quaternion
from ship_geometry.rotations import FloatArray

FUTURE_TOLERANCE_NS = 50_000_000
"""Maximum time by which a stamp may be ahead of the node's clock, ns."""

Value = TypeVar("Value")

MIN_QUATERNION_NORM = 1e-6
QUATERNION_NORM_TOLERANCE = 1e-2
COVARIANCE_TOLERANCE = 1e-6
MIN_DEFINITE_DETERMINANT = 1e-9
"""Determinant of a correlation matrix above which the matrix is positive definite beyond rounding."""
NOT_GIVEN = -1.0
"""First element of a covariance in sensor_msgs/Imu if the message does not give the quantity."""
_LONGEST_ID = 64
MAX_VARIANCE = (2.0 * math.pi) ** 2
"""Largest accepted variance of an angle, rad²: a sigma of one full turn."""

MAX_RATE = 100.0
"""Largest accepted component of a ship's angular rate, rad/s.

A ship's rates in degrees per second are below this limit; a check of the ratio to the expected rates detects them."""

_ABOVE, _BELOW = [1, 2, 5], [3, 6, 7]
"""Indices of the off-diagonal elements of a 3x3 matrix given as nine numbers."""

Valid = NDArray[np.bool_]
"""True for each message that passes, shape (N,)."""


@dataclass(frozen=True)
class ReadMessage(Generic[Value]):
    """Result of reading a message.

    Attributes:
        value: the input of the core, with its stamp ``time_ns``.
        covariance_known: False if the message gives no covariance; the configured sigma is used then.
        rejected_parts: rejected parts of the message (stars, lights), by name, with the reasons.
        is_empty: True if the device works but detected nothing, so that there is nothing to compare.
        is_degraded: True if the device states that its value is not good enough for a VALID output.
    """

    value: Value
    covariance_known: bool = True
    rejected_parts: tuple[tuple[str, Rejection], ...] = ()
    is_empty: bool = False
    is_degraded: bool = False


class MessageRejected(Exception):
    """A message is rejected.

    Attributes:
        rejection: the reason, and its text with numbers for the user.
    """

    def __init__(self, reason: Reason, text: str) -> None:
        self.rejection = Rejection(reason, text)
        super().__init__(f"{reason.word}: {self.rejection.text}")


def quoted_id(name: str) -> str:
    """Return a name from a message in quotes, shortened for use in a text."""
    return f"'{shorten(name, _LONGEST_ID)}'"


def stamp_ns(header: Any, receive_ns: int) -> int:
    """Return the stamp of a header, ns.

    Raises:
        MessageRejected: BAD_STAMP if the stamp is zero or negative, or if its nanoseconds are 1e9 or more; FUTURE if
            the stamp is more than 50 ms ahead of ``receive_ns``.
    """
    if header.stamp.nanosec >= NS_PER_S:
        raise MessageRejected(
            Reason.BAD_STAMP, f"header.stamp.nanosec is {header.stamp.nanosec}: expected less than a second"
        )
    ns = int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)
    if ns <= 0:
        raise MessageRejected(Reason.BAD_STAMP, f"header.stamp is {ns} ns: expected POSIX time")
    if ns > receive_ns + FUTURE_TOLERANCE_NS:
        ahead = duration_text(ns - receive_ns)
        raise MessageRejected(Reason.FUTURE, f"stamp is {ahead} ahead of the node's clock: check both clocks")
    return ns


def check_frame(frame_id: str, expected: str) -> None:
    """Reject a message with another frame_id; an empty ``expected`` accepts any frame.

    Raises:
        MessageRejected: FRAME.
    """
    if expected and frame_id != expected:
        raise MessageRejected(Reason.FRAME, f"frame_id is {quoted_id(frame_id)}: expected '{expected}'")


def check_device_id(field: str, given: str, expected: str) -> None:
    """Reject a message whose device is not the expected one.

    Raises:
        MessageRejected: UNKNOWN_SENSOR.
    """
    if given != expected:
        raise MessageRejected(Reason.UNKNOWN_SENSOR, f"{field} is {quoted_id(given)}: expected '{expected}'")


def check_finite(field: str, *values: float) -> None:
    """Reject NaN and infinity.

    Raises:
        MessageRejected: NON_FINITE.
    """
    for value in values:
        if not math.isfinite(value):
            raise MessageRejected(Reason.NON_FINITE, f"{field} holds {value}")


def exposure_length_s(exposure_s: float, longest_s: float) -> float:
    """Return the length of an exposure, s; 0 if it is not given (NaN or 0).

    Raises:
        MessageRejected: NON_FINITE if the length is infinite; UNITS if it is negative or above ``longest_s``.
    """
    if math.isnan(exposure_s):
        return 0.0
    check_finite("exposure_s", exposure_s)
    if not 0.0 <= exposure_s <= longest_s:
        raise MessageRejected(Reason.UNITS, f"exposure_s is {exposure_s:.6g}: expected seconds, {longest_s:g} at most")
    return float(exposure_s)


def finite_vector(vector: Any, field: str) -> FloatArray:
    """Return x, y, z of a message as an array, shape (3,).

    Raises:
        MessageRejected: NON_FINITE.
    """
    check_finite(field, vector.x, vector.y, vector.z)
    return np.array([vector.x, vector.y, vector.z])


def unit_quaternion(quaternion: Any, field: str = "orientation") -> FloatArray:
    """Return x, y, z, w of a quaternion message, normalised to 1, shape (4,).

    Raises:
        MessageRejected: NON_FINITE, or BAD_QUATERNION if the norm differs from 1 by more than 1e-2.
    """
    numbers = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    check_finite(field, *numbers)
    norm = math.sqrt(sum(number * number for number in numbers))
    if norm < MIN_QUATERNION_NORM:
        raise MessageRejected(Reason.BAD_QUATERNION, f"norm of {field} is {norm:.3g}: no orientation is given")
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        # hypot avoids the overflow of squares.
        raise MessageRejected(Reason.BAD_QUATERNION, f"norm of {field} is {math.hypot(*numbers):.6g}: expected 1")
    return np.array(numbers) / norm


def optional_sigma(sigma: float, largest: float) -> float | None:
    """Return a standard deviation; None if it is not given (NaN or 0).

    Raises:
        MessageRejected: NON_FINITE if ``sigma`` is infinite; BAD_COVARIANCE if it is negative or above ``largest``.
    """
    if math.isnan(sigma) or sigma == 0.0:
        return None
    if math.isinf(sigma):
        raise MessageRejected(Reason.NON_FINITE, "sigma holds infinity")
    if not 0.0 < sigma <= largest:
        raise MessageRejected(
            Reason.BAD_COVARIANCE, f"sigma is {sigma:.6g}: expected a positive number up to {largest:.3g}"
        )
    return float(sigma)


def covariance_3x3(values: Sequence[float], field: str = "covariance") -> FloatArray | None:
    """Return the symmetric covariance of nine numbers, shape (3, 3); None if the covariance is unknown.

    A covariance is unknown if all numbers are zero or the first is −1 (sensor_msgs/Imu); the configured sigma is used
    then. Asymmetry and negative eigenvalues due to rounding are removed.

    Raises:
        MessageRejected: NON_FINITE; or BAD_COVARIANCE if a variance is negative, or if the matrix is not symmetric or
            not positive semidefinite beyond rounding.
    """
    try:
        return _covariance_of_bytes(np.array(values, dtype=np.float64).tobytes())
    except MessageRejected as problem:
        raise MessageRejected(problem.rejection.reason, f"{field} {problem.rejection.text}") from None


def angular_covariance(values: Sequence[float], field: str) -> FloatArray | None:
    """Return a covariance (rad²) of angles or of a rotation vector, shape (3, 3); None if it is unknown.

    Raises:
        MessageRejected: as :func:`covariance_3x3`, and BAD_COVARIANCE if a sigma exceeds one full turn.
    """
    covariance = covariance_3x3(values, field)
    if covariance is not None:
        largest = max(covariance.diagonal().tolist())
        if not largest <= MAX_VARIANCE:
            text = f"{field}: a variance of {largest:.3g} rad² is a sigma of more than a full turn"
            raise MessageRejected(Reason.BAD_COVARIANCE, text)
    return covariance


@lru_cache(maxsize=64)
def _covariance_of_bytes(content: bytes) -> FloatArray | None:
    """Return :func:`covariance_3x3` of nine doubles; the rejection text does not name the field.

    Results are cached: an INS repeats one covariance a hundred times a second, and a star sensor whose errors are all
    independent gives its covariance twice per message.
    """
    numbers = struct.unpack("9d", content)
    if numbers[0] == NOT_GIVEN or not any(numbers):
        return None
    if not all(map(math.isfinite, numbers)):
        raise MessageRejected(Reason.NON_FINITE, "holds NaN or infinity")
    variances = numbers[::4]
    if min(variances) < 0.0:
        raise MessageRejected(Reason.BAD_COVARIANCE, f"holds a negative variance: {min(variances):.6g}")
    # The limits are relative to the sigmas, so that axes with small and large sigmas are checked equally.
    first, second, third = map(math.sqrt, variances)
    limits = first * second, first * third, second * third
    above, below = (numbers[1], numbers[2], numbers[5]), (numbers[3], numbers[6], numbers[7])
    asymmetry = [abs(one - other) for one, other in zip(above, below, strict=True)]
    if not all(differs <= COVARIANCE_TOLERANCE * limit for differs, limit in zip(asymmetry, limits, strict=True)):
        raise MessageRejected(Reason.BAD_COVARIANCE, f"is not symmetric: elements differ by {max(asymmetry):.3g}")
    xy, xz, yz = off_diagonal = [0.5 * one + 0.5 * other for one, other in zip(above, below, strict=True)]
    if not all(
        abs(one) <= limit * (1.0 + COVARIANCE_TOLERANCE) for one, limit in zip(off_diagonal, limits, strict=True)
    ):
        raise MessageRejected(Reason.BAD_COVARIANCE, "is not positive semidefinite: a correlation exceeds 1")
    symmetric = np.array([[variances[0], xy, xz], [xy, variances[1], yz], [xz, yz, variances[2]]])
    if not _is_clearly_definite(off_diagonal, limits):
        symmetric = _with_nonnegative_variances(symmetric, np.array([first, second, third]))
    symmetric.flags.writeable = False
    return symmetric


def _is_clearly_definite(off_diagonal: Sequence[float], limits: Sequence[float]) -> bool:
    """True if a correlation matrix is positive definite beyond rounding.

    The product of the three eigenvalues is the determinant. The sum of the eigenvalues is three, so the product of two
    is at most 9/4. The smallest eigenvalue therefore exceeds a third of the determinant.

    Args:
        off_diagonal: covariances of axes 1 and 2, 1 and 3, 2 and 3.
        limits: products of the sigmas of the same axes.
    """
    if not min(limits) > 0.0:
        return False
    a, b, c = [one / limit for one, limit in zip(off_diagonal, limits, strict=True)]
    return abs(a) < 1.0 and 1.0 + 2.0 * a * b * c - a * a - b * b - c * c > MIN_DEFINITE_DETERMINANT


def _with_nonnegative_variances(symmetric: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return a covariance, shape (3, 3), with negative eigenvalues of its correlation matrix set to zero.

    Raises:
        MessageRejected: BAD_COVARIANCE if an eigenvalue is negative beyond rounding.
    """
    limit = np.outer(sigma, sigma)
    correlation = symmetric / np.where(limit > 0.0, limit, 1.0)
    eigenvalues, vectors = np.linalg.eigh(correlation)
    if eigenvalues[0] < -COVARIANCE_TOLERANCE:
        text = f"is not positive semidefinite: eigenvalue {eigenvalues[0]:.3g} of correlations"
        raise MessageRejected(Reason.BAD_COVARIANCE, text)
    if eigenvalues[0] < 0.0:
        # Rounding errors are accepted, but no filter may receive a negative variance.
        correlation = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T
        symmetric = 0.5 * limit * (correlation + correlation.T)
    return symmetric


def ship_rate(angular_velocity: Any) -> FloatArray:
    """Return an angular velocity in the axes of the message, rad/s, shape (3,).

    Raises:
        MessageRejected: NON_FINITE, or UNITS if a component exceeds :data:`MAX_RATE`.
    """
    rate_ros = finite_vector(angular_velocity, "angular_velocity")
    if np.max(np.abs(rate_ros)) > MAX_RATE:
        raise MessageRejected(Reason.UNITS, f"angular_velocity {rate_ros.tolist()}: too large for a ship in rad/s")
    return rate_ros


def imu_quaternion(message: Any, accept_unset_covariance: bool) -> FloatArray:
    """Return the orientation of a sensor_msgs/Imu, x, y, z, w with norm 1, shape (4,).

    Args:
        message: the message.
        accept_unset_covariance: True to use an orientation whose covariance begins with -1.

    Raises:
        MessageRejected: NOT_GIVEN if the covariance begins with -1 and ``accept_unset_covariance`` is False; NON_FINITE
            or BAD_QUATERNION as in :func:`unit_quaternion`.
    """
    if message.orientation_covariance[0] == NOT_GIVEN and not accept_unset_covariance:
        text = "orientation_covariance[0] is -1: no orientation is given (sensor_msgs/Imu)"
        raise MessageRejected(
            Reason.NOT_GIVEN, f"{text}; if the driver gives one nevertheless, set accept_unset_covariance"
        )
    return unit_quaternion(message.orientation)


def imu_rotation(message: Any, convention: str, accept_unset_covariance: bool) -> FloatArray:
    """Return :func:`imu_quaternion` as a rotation "horizon from device", shape (3, 3).

    Raises:
        MessageRejected: NOT_GIVEN, NON_FINITE or BAD_QUATERNION.
    """
    return rotation_from_quaternion(imu_quaternion(message, accept_unset_covariance), convention)


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

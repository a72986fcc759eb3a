"""Reader of ship_msgs/RtkBaseline: vector between two antennas, covariance, kind of solution."""

from typing import Any, Protocol

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.ros_axes import ENU_FROM_HORIZON, horizon_covariance
from ship_geometry.rotations import FloatArray
from ship_node.messages.field_checks import (
    MessageRejected,
    check_device_id,
    check_frame,
    covariance_3x3,
    finite_vector,
    stamp_ns,
)

_FIXES = ("NONE", "SINGLE", "DGNSS", "FLOAT", "FIXED")
_MAX_LENGTH_M = 1e5


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

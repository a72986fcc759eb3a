"""Conversion of ship_msgs/TargetDirection to a direction sample, for the node ``triangulation`` and for bags."""

import math
from typing import Any

import numpy as np

from ship_estimation.parameters.frame_names import FRAME_NAMES
from ship_estimation.rejection_rules import Reason, shorten
from ship_estimation.time_order.outcome import Status
from ship_geometry.ros_axes import ENU_FROM_HORIZON, horizon_covariance
from ship_node.messages.field_checks import (
    MessageRejected,
    ReadMessage,
    angular_covariance,
    check_frame,
    finite_vector,
    stamp_ns,
)
from theodolite_calib.messages.input_messages import LONGEST_TARGET_ID
from theodolite_calib.triangulation.common_times import DirectionSample

_NORM_TOLERANCE = 1e-3
_LEAST_SHARE = 1e-9
"""Ratio of the smaller to the larger variance across a direction up to which the covariance counts as singular."""


def direction(
    message: Any, station: str, receive_ns: int, horizon: str = FRAME_NAMES.horizon
) -> ReadMessage[DirectionSample]:
    """Read a direction, or an INVALID report of the theodolite.

    Args:
        message: TargetDirection.
        station: name of the theodolite.
        receive_ns: arrival time of the message.
        horizon: required frame_id.

    Raises:
        MessageRejected: the message cannot be used.
    """
    time_ns = stamp_ns(message.header, receive_ns)
    # A position from several theodolites is rejected here, because its frame is not the horizon.
    check_frame(message.header.frame_id, horizon)
    if message.status not in list(Status):
        expected = ", ".join(status.name for status in Status)
        raise MessageRejected(Reason.UNITS, f"status {message.status} is unknown: expected one of {expected}")
    status, vector, covariance_n = Status(message.status), np.full(3, np.nan), np.full((3, 3), np.nan)
    if status is not Status.INVALID:
        direction_enu = finite_vector(message.direction, "direction")
        norm = math.hypot(*direction_enu.tolist())
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise MessageRejected(Reason.UNITS, f"norm of direction is {norm:.6g}: expected 1")
        covariance_enu = angular_covariance(message.direction_covariance, "direction_covariance")
        if covariance_enu is None:
            raise MessageRejected(Reason.BAD_COVARIANCE, "direction_covariance is not given: required for the position")
        vector, covariance_n = ENU_FROM_HORIZON.T @ direction_enu / norm, horizon_covariance(covariance_enu)
        across = np.linalg.svd(vector[None])[2][1:]
        least, greatest = np.linalg.eigvalsh(across @ covariance_n @ across.T).tolist()
        if not least > _LEAST_SHARE * greatest:
            raise MessageRejected(Reason.BAD_COVARIANCE, "direction_covariance is singular across the direction")
    return ReadMessage(
        DirectionSample(
            time_ns=time_ns,
            vector=vector,
            source=f"station.{station}",
            target_id=shorten(message.target_id, LONGEST_TARGET_ID),
            covariance_n=covariance_n,
            status=status,
        )
    )

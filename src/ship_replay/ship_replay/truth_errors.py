"""Fills the errors of ``ship/error_arcsec`` where a bag knows the truth: an estimator never sees it."""

from collections import deque
from typing import Any

import numpy as np

from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.ros_axes import device_vector_from_ros
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_node.stamps import ns_from_stamp

ATTITUDE_TOPIC = "ship/attitude"
ERROR_TOPIC = "ship/error_arcsec"
TRUTH_TOPIC = "truth/attitude"

_TRUTH_GAP_NS = 1_000_000_000
_PATIENCE_NS = 2_000_000_000
"""Truth that comes later than this after an attitude is not waited for."""


def truth_sample(message: Any) -> AttitudeSample:
    """The attitude and rate of a ShipAttitude message; the rate is None where it is not finite."""
    rate = device_vector_from_ros([message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z])
    return AttitudeSample(
        time_ns=ns_from_stamp(message.header.stamp),
        rotation_nd=rotation_from_angles(message.heading, message.pitch, message.roll),
        rate_d=rate if np.all(np.isfinite(rate)) else None,
    )


class TruthErrors:
    """Holds each error message back until the truth at its stamp is known, then fills it in.

    Messages come in order of log time; what :meth:`filled` gives back keeps its own log time.
    """

    def __init__(self) -> None:
        self._truth = AttitudeTrack(_TRUTH_GAP_NS)
        self._attitudes: dict[int, FloatArray] = {}
        self._waiting: deque[tuple[int, Any]] = deque()

    def add_truth(self, message: Any) -> None:
        """A ShipAttitude of the truth."""
        self._truth.insert(truth_sample(message))

    def add_attitude(self, message: Any) -> None:
        """A ShipAttitude as published."""
        angles = np.array([message.heading, message.pitch, message.roll])
        self._attitudes[ns_from_stamp(message.header.stamp)] = angles

    def add_error(self, message: Any, log_time_ns: int) -> None:
        """An AttitudeErrorArcsec as published, without errors."""
        self._waiting.append((log_time_ns, message))

    def filled(self, now_ns: int | None) -> list[tuple[int, Any]]:
        """(log time, message) of those that are ready at ``now_ns``; None: nothing more will come."""
        ready: list[tuple[int, Any]] = []
        while self._waiting:
            log_time_ns, message = self._waiting[0]
            stamp_ns = ns_from_stamp(message.header.stamp)
            truth = self._truth.at(stamp_ns)
            if truth is None and now_ns is not None and now_ns - log_time_ns < _PATIENCE_NS:
                break
            attitude = self._attitudes.get(stamp_ns)
            if truth is not None and attitude is not None:
                true_angles = angles_from_rotation(truth.rotation_nd)
                errors_arcsec = wrap_pi(attitude - true_angles) / ARCSEC
                message.error_heading, message.error_pitch, message.error_roll = map(float, errors_arcsec)
            ready.append((log_time_ns, message))
            self._waiting.popleft()
            self._forget(stamp_ns)
        return ready

    def _forget(self, stamp_ns: int) -> None:
        self._truth.drop_before(stamp_ns)
        self._attitudes = {time: value for time, value in self._attitudes.items() if time >= stamp_ns}

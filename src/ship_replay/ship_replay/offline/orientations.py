"""The orientations that the suite publishes and a simulated bag knows the truth of, and their errors against it.

A replay fills the errors into ``ship/error_arcsec`` and its like; an estimator never sees the truth.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import ns_from_stamp
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.ros_axes import device_vector_from_ros
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi

_TRUTH_GAP_NS = 1_000_000_000
_PATIENCE_NS = 2_000_000_000
"""Truth that comes later than this after an attitude is not waited for."""


@dataclass(frozen=True)
class Orientation:
    """A quantity with three angles in the horizon frame: where it is published, where its truth and its errors are.

    Attributes:
        label: name of the published one in an evaluation.
        topic: where it is published.
        truth_topic: where a simulated bag has the truth, messages of the same type.
        error_topic: where the errors go.
        angles: fields of the three angles: azimuth, elevation, roll, whatever they are called.
        channels: names of the three errors.
        on_sky: whether the first error, times the cosine of the elevation, is to be an angle on the sky.
    """

    label: str
    topic: str
    truth_topic: str
    error_topic: str
    angles: tuple[str, str, str]
    channels: tuple[str, str, str]
    on_sky: bool

    def angles_of(self, message: Any) -> FloatArray:
        """The three angles of a message, rad, shape (3,)."""
        return np.array([getattr(message, name) for name in self.angles])

    def sample(self, message: Any) -> AttitudeSample:
        """The orientation of a message, with its rate where that is given and finite."""
        rate_d = None
        if hasattr(message, "angular_velocity"):
            rate = message.angular_velocity
            rate_d = device_vector_from_ros([rate.x, rate.y, rate.z])
        return AttitudeSample(
            time_ns=ns_from_stamp(message.header.stamp),
            rotation_nd=rotation_from_angles(*self.angles_of(message)),
            rate_d=rate_d if rate_d is not None and np.all(np.isfinite(rate_d)) else None,
        )

    def scale(self, angles: FloatArray) -> FloatArray:
        """The factors that turn errors of angles into errors of the channels, shape (..., 3)."""
        scale = np.ones_like(angles)
        if self.on_sky:
            scale[..., 0] = np.cos(angles[..., 1])
        return scale

    def errors_arcsec(self, angles: FloatArray, truth_nd: FloatArray) -> FloatArray:
        """Estimate minus truth of each channel, shape (..., 3)."""
        errors = wrap_pi(angles - angles_from_rotation(truth_nd))
        return self.scale(angles) * errors / ARCSEC


SHIP_ATTITUDE = Orientation(
    label="fused",
    topic="ship/attitude",
    truth_topic="truth/attitude",
    error_topic="ship/error_arcsec",
    angles=("heading", "pitch", "roll"),
    channels=("heading", "pitch", "roll"),
    on_sky=False,
)

POINTING = Orientation(
    label="pointing",
    topic="theodolite/pointing",
    truth_topic="truth/pointing",
    error_topic="theodolite/error_arcsec",
    angles=("azimuth", "elevation", "image_rotation"),
    channels=("azimuth_cos_elevation", "elevation", "image_rotation"),
    on_sky=True,
)

ORIENTATIONS = (SHIP_ATTITUDE, POINTING)


class TruthErrors:
    """Holds each error message back until the truth at its stamp is known, then fills it in.

    Messages come in order of log time; what :meth:`filled` gives back keeps its own log time.
    """

    def __init__(self, orientation: Orientation) -> None:
        self.orientation = orientation
        self._truth = AttitudeTrack(_TRUTH_GAP_NS)
        self._attitudes: dict[int, FloatArray] = {}
        self._waiting: deque[tuple[int, Any]] = deque()

    def add_truth(self, message: Any) -> None:
        """A message of the truth."""
        self._truth.insert(self.orientation.sample(message))

    def add_attitude(self, message: Any) -> None:
        """A message of the orientation as published."""
        self._attitudes[ns_from_stamp(message.header.stamp)] = self.orientation.angles_of(message)

    def add_error(self, message: Any, log_time_ns: int) -> None:
        """A message of errors as published, without errors."""
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
                errors_arcsec = self.orientation.errors_arcsec(attitude, truth.rotation_nd)
                for channel, error in zip(self.orientation.channels, errors_arcsec.tolist(), strict=True):
                    setattr(message, f"error_{channel}", error)
            ready.append((log_time_ns, message))
            self._waiting.popleft()
            self._forget(stamp_ns)
        return ready

    def _forget(self, stamp_ns: int) -> None:
        self._truth.drop_before(stamp_ns)
        self._attitudes = {time: value for time, value in self._attitudes.items() if time >= stamp_ns}

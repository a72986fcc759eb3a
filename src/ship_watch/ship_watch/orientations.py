"""The orientations that a suite publishes and a simulated bag knows the truth of, and their errors against it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_bags.stamps import ns_from_stamp, stamps_of_rows
from ship_geometry import compiled_angles
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.ros_axes import device_vector_from_ros
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi

_RATE = "angular_velocity"


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

    def angles_of_rows(self, numbers: np.ndarray) -> FloatArray:
        """The same of messages that are rows (:class:`ship_bags.cdr_template.CdrRows`), shape (N, 3)."""
        return np.stack([numbers[name] for name in self.angles], axis=1)

    def sample(self, message: Any) -> AttitudeSample | None:
        """The orientation of a message, with its rate where that is given and finite; None without finite angles."""
        angles = self.angles_of(message)
        if not np.all(np.isfinite(angles)):
            return None
        rate_d = None
        if hasattr(message, _RATE):
            rate = getattr(message, _RATE)
            rate_d = device_vector_from_ros(np.array([rate.x, rate.y, rate.z]))
        return AttitudeSample(
            time_ns=ns_from_stamp(message.header.stamp),
            rotation_nd=rotation_from_angles(*angles),
            rate_d=rate_d if rate_d is not None and np.all(np.isfinite(rate_d)) else None,
        )

    def samples(self, messages: CdrRows) -> list[AttitudeSample | None]:
        """The same of messages that are rows, to the last bit."""
        numbers = messages.numbers
        angles, times_ns = self.angles_of_rows(numbers), stamps_of_rows(numbers).tolist()
        rates_d: Sequence[FloatArray | None] = [None] * len(times_ns)
        if hasattr(messages.message(0), _RATE):
            measured_d = device_vector_from_ros(np.stack([numbers[f"{_RATE}.{axis}"] for axis in "xyz"], axis=1))
            rates_d = [rate_d if known else None for rate_d, known in zip(measured_d, _finite(measured_d), strict=True)]
        samples = map(AttitudeSample, times_ns, compiled_angles.rotations(angles), rates_d)
        return [sample if known else None for sample, known in zip(samples, _finite(angles), strict=True)]

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


def _finite(rows: FloatArray) -> list[bool]:
    """Of each row whether all its numbers are finite."""
    finite: list[bool] = np.logical_and.reduce(np.isfinite(rows), axis=1).tolist()
    return finite


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


def channel_name(channel: str) -> str:
    """A channel for people: "heading", "azimuth · cos E"."""
    return channel.replace("_cos_elevation", " · cos E").replace("_", " ")

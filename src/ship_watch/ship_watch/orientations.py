"""Orientations that a suite publishes, with their truth in simulated bags and their errors against this truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_bags.stamps import ns_from_stamp, stamps_of_rows
from ship_geometry.frames import angles_from_rotation, device_vector_from_ros, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_kernels import compiled_rotations

_RATE = "angular_velocity"


@dataclass(frozen=True)
class Orientation:
    """An orientation with three angles in the horizon frame, and the topics of its values, truth and errors.

    Attributes:
        label: name of the published orientation in an evaluation.
        topic: topic of the orientation.
        truth_topic: topic of the truth in a simulated bag, with messages of the same type.
        error_topic: topic of the errors.
        angles: message fields of the three angles, in the order azimuth, elevation, roll.
        channels: names of the three errors.
        on_sky: True if the first error is multiplied by the cosine of the elevation (angle on the sky).
    """

    label: str
    topic: str
    truth_topic: str
    error_topic: str
    angles: tuple[str, str, str]
    channels: tuple[str, str, str]
    on_sky: bool

    def angles_of(self, message: Any) -> FloatArray:
        """Return the three angles of a message, rad, shape (3,)."""
        return np.array([getattr(message, name) for name in self.angles])

    def angles_of_rows(self, numbers: np.ndarray) -> FloatArray:
        """Return the angles of messages as rows (:class:`ship_bags.cdr_template.CdrRows`), rad, shape (N, 3)."""
        return np.stack([numbers[name] for name in self.angles], axis=1)

    def sample(self, message: Any) -> AttitudeSample | None:
        """Return the orientation of a message, and its angular rate if finite; None if an angle is not finite."""
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
        """Return the orientations of messages given as rows, identical to the results of :meth:`sample`."""
        numbers = messages.numbers
        angles, times_ns = self.angles_of_rows(numbers), stamps_of_rows(numbers).tolist()
        rates_d: Sequence[FloatArray | None] = [None] * len(times_ns)
        if hasattr(messages.message(0), _RATE):
            measured_d = device_vector_from_ros(np.stack([numbers[f"{_RATE}.{axis}"] for axis in "xyz"], axis=1))
            rates_d = [
                rate_d if known else None for rate_d, known in zip(measured_d, _is_row_finite(measured_d), strict=True)
            ]
        samples = map(AttitudeSample, times_ns, compiled_rotations.rotations(angles), rates_d)
        return [sample if known else None for sample, known in zip(samples, _is_row_finite(angles), strict=True)]

    def scale(self, angles: FloatArray) -> FloatArray:
        """Return the factors from errors of the angles to errors of the channels, shape (..., 3)."""
        scale = np.ones_like(angles)
        if self.on_sky:
            scale[..., 0] = np.cos(angles[..., 1])
        return scale

    def errors_arcsec(self, angles: FloatArray, truth_nd: FloatArray) -> FloatArray:
        """Return estimate minus truth of each channel, arcsec, shape (..., 3).

        Args:
            angles: estimated angles, rad, shape (..., 3).
            truth_nd: true rotations from device to horizon frame, shape (..., 3, 3).
        """
        errors = wrap_pi(angles - angles_from_rotation(truth_nd))
        return self.scale(angles) * errors / ARCSEC


def _is_row_finite(rows: FloatArray) -> list[bool]:
    """Return True for each row whose numbers are all finite, else False."""
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
    """Return the name of a channel for people: "heading", "azimuth · cos E"."""
    return channel.replace("_cos_elevation", " · cos E").replace("_", " ")

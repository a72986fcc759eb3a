"""Sightings of known directions, and how far an axis model misses them."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, angle_between, wrap_pi
from theodolite_calib.axis_fit.slow_errors import SharedError, slow_map
from theodolite_calib.chain.axes import AxisErrors, direction_change, encoder_angles, main_axis, main_axis_rotation


@dataclass(frozen=True)
class Sightings:
    """What the encoders said while the optical axis looked in known directions.

    Attributes:
        labels: one a sighting, as its user numbers them.
        azimuth: of the encoder, rad, shape (n,).
        elevation: of the encoder, beyond the zenith where the telescope is plunged, rad, shape (n,).
        direction_d: where the optical axis truly looked, unit vectors in the base's frame, shape (n, 3).
        time_s: moment of each, UTC as POSIX time or from any other start, shape (n,); None where nothing says it.
        slow_errors: errors of the directions that several sightings share.
        repeated: labels of rows that gave a sighting again; each counts once.
    """

    labels: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    direction_d: FloatArray
    time_s: FloatArray | None = None
    slow_errors: tuple[SharedError, ...] = ()
    repeated: tuple[str, ...] = ()

    def slow_map(self) -> FloatArray:
        """What independent errors of variance 1 move the sightings by, shape (n, 2, q), rad."""
        return slow_map(self.slow_errors, self.time_s, len(self.labels))

    def offsets(self) -> tuple[FloatArray, FloatArray]:
        """True azimuth and elevation minus the encoders', on the face that they were taken on, shape (n,) each, rad."""
        plain, over = (encoder_angles(AxisErrors(), self.direction_d, plunged=plunged) for plunged in (False, True))
        is_over = np.cos(self.elevation) < 0.0
        azimuth, elevation = (np.where(is_over, *pair) for pair in zip(over, plain, strict=True))
        return wrap_pi(azimuth - self.azimuth), wrap_pi(elevation - self.elevation)

    def residuals(self, errors: AxisErrors) -> FloatArray:
        """True direction minus the model's, as angles to the right and up on the sky, shape (n, 2), rad."""
        model_d = main_axis_rotation(errors, self.azimuth, self.elevation)[..., 0]
        return _on_the_sky(self.direction_d, model_d)

    def linearized(self, errors: AxisErrors) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, 2), and the model's change to the right and up per axis error, shape (n, 2, 7)."""
        axis = main_axis(errors, self.azimuth, self.elevation)
        model_d = axis.rotation_dm[..., 0]
        change = right_and_up(self.direction_d) @ direction_change(model_d, axis.by_error)
        return _on_the_sky(self.direction_d, model_d), change


def directions(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Unit vectors (bow, up, starboard) of azimuth and elevation, shape (..., 3)."""
    return main_axis_rotation(AxisErrors(), azimuth, elevation)[..., 0]


def _on_the_sky(true_d: FloatArray, model_d: FloatArray) -> FloatArray:
    """Angle from the model's to the true direction, resolved to the right and up."""
    sines = -(right_and_up(true_d) @ model_d[..., None])[..., 0]
    sine = np.linalg.norm(sines, axis=-1)
    angle = angle_between(true_d, model_d)
    return sines * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)[..., None]


def right_and_up(direction_d: FloatArray) -> FloatArray:
    """Unit vectors to the right (horizontal) and up, across a direction, shape (..., 2, 3)."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0])
    zero = np.zeros_like(azimuth)
    right = np.stack([-np.sin(azimuth), zero, np.cos(azimuth)], axis=-1)
    return np.stack([right, np.cross(right, direction_d)], axis=-2)

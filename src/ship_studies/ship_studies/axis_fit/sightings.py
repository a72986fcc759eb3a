"""Sightings of known directions: residuals of an axis model, common errors, and coverage of the sky.

A common error is a Gauss-Markov process in time, or a constant if its correlation time is infinite. One sigma of the
error shifts the direction of a sighting by the stated effect, so that two sightings have the covariance

    sum over the errors of  effect_i effect_jᵀ exp(-|t_i - t_j| / T)

:meth:`Sightings.correlated_map` is a root of this covariance. Each column of the root belongs to a further unknown of
the fit, with the prior variance 1.
"""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ship_geometry.mount.axes import (
    AxisErrors,
    direction_change,
    encoder_angles,
    main_axis,
    main_axis_rotation,
)
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, wrap_pi

MAX_SIGHTINGS = 1000
"""Maximum number of sightings with errors correlated in time, whose joint covariance is decomposed as a whole."""

_MIN_EFFECT_RAD = 0.1 * ARCSEC
"""Maximum joint effect of the columns that the map omits, rad RMS.

So small an effect cannot be separated from the sightings' own errors.
"""


@dataclass(frozen=True)
class SharedError:
    """Error common to several sightings.

    Attributes:
        name: name of the error.
        time_s: correlation time, s; infinite for a constant.
        effect: effect of one sigma on each sighting, to the right and up, shape (n, 2), rad.
    """

    name: str
    time_s: float
    effect: FloatArray


def correlated_map(errors: tuple[SharedError, ...], time_s: FloatArray | None, count: int) -> FloatArray:
    """Return the effects of independent errors of variance 1 on the sightings, shape (count, 2, q), rad.

    Args:
        errors: common errors of the sightings.
        time_s: times of the sightings, s, shape (count,); needed only for errors correlated in time.
        count: number of sightings.
    """
    columns = [error.effect.reshape(2 * count, 1) for error in errors if np.isinf(error.time_s)]
    time_correlated = sorted((error for error in errors if not np.isinf(error.time_s)), key=lambda error: error.time_s)
    if time_correlated:
        assert time_s is not None
        columns.append(_root(_covariance(time_correlated, time_s)))
    return np.hstack([np.zeros((2 * count, 0)), *columns]).reshape(count, 2, -1)


def _covariance(time_correlated: list[SharedError], time_s: FloatArray) -> FloatArray:
    """Return the covariance of the sightings due to time-correlated errors, right and up in turn, (2 n, 2 n), rad²."""
    interval_s = np.abs(np.subtract.outer(time_s, time_s))
    covariance = np.zeros((2 * len(time_s), 2 * len(time_s)))
    for correlation_s, errors in groupby(time_correlated, key=lambda error: error.time_s):
        effects = np.stack([error.effect.ravel() for error in errors], axis=-1)
        # An error with a correlation time of zero is white: independent at each time.
        correlation = np.exp(-interval_s / correlation_s) if correlation_s > 0.0 else (interval_s == 0.0).astype(float)
        covariance += (effects @ effects.T) * np.repeat(np.repeat(correlation, 2, axis=0), 2, axis=1)
    return covariance


def _root(covariance: FloatArray) -> FloatArray:
    """Return a root of the covariance, without negligible columns, shape (2 n, q)."""
    values, vectors = np.linalg.eigh(covariance)
    # Eigenvalues are in ascending order. The first eigenvalues, with a negligible joint effect, are omitted.
    is_significant = np.cumsum(np.maximum(values, 0.0)) > _MIN_EFFECT_RAD**2 * len(values)
    root: FloatArray = vectors[:, is_significant] * np.sqrt(values[is_significant])
    return root


@dataclass(frozen=True)
class Sightings:
    """Encoder readings for known directions of the optical axis.

    Attributes:
        labels: label of each sighting from the table; the row number if the table has no labels.
        azimuth: reading of the azimuth encoder, rad, shape (n,).
        elevation: reading of the elevation encoder, beyond the zenith if the telescope is plunged, rad, shape (n,).
        direction_d: true direction of the optical axis, unit vectors in the base's frame, shape (n, 3).
        time_s: time of each sighting, s, UTC as POSIX time or from any other start, shape (n,); None if unknown.
        correlated_errors: errors that are common to several sightings.
        repeated: for each row that repeats a sighting and is not used, its label and that of the first: ``5 (as 3)``.
    """

    labels: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    direction_d: FloatArray
    time_s: FloatArray | None = None
    correlated_errors: tuple[SharedError, ...] = ()
    repeated: tuple[str, ...] = ()

    def correlated_map(self) -> FloatArray:
        """Return the effects of independent errors of variance 1 on the sightings, shape (n, 2, q), rad."""
        return correlated_map(self.correlated_errors, self.time_s, len(self.labels))

    def offsets(self) -> tuple[FloatArray, FloatArray]:
        """Return true direction minus reading in azimuth and elevation, on the face of the reading, (n,), rad."""
        plain, over = (encoder_angles(AxisErrors(), self.direction_d, plunged=plunged) for plunged in (False, True))
        is_over = np.cos(self.elevation) < 0.0
        azimuth, elevation = (np.where(is_over, *pair) for pair in zip(over, plain, strict=True))
        return wrap_pi(azimuth - self.azimuth), wrap_pi(elevation - self.elevation)

    def residuals(self, errors: AxisErrors) -> FloatArray:
        """Return true minus modelled direction, as angles to the right and up on the sky, shape (n, 2), rad."""
        model_d = main_axis_rotation(errors, self.azimuth, self.elevation)[..., 0]
        return _sky_angles(self.direction_d, model_d)

    def linearise(self, errors: AxisErrors) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n, 2), and the derivative of the modelled direction per axis error, shape (n, 2, 7)."""
        axis = main_axis(errors, self.azimuth, self.elevation)
        model_d = axis.rotation_dm[..., 0]
        change = right_and_up(self.direction_d) @ direction_change(model_d, axis.by_error)
        return _sky_angles(self.direction_d, model_d), change


def directions(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return unit vectors (bow, up, starboard) from azimuth and elevation, shape (..., 3)."""
    return main_axis_rotation(AxisErrors(), azimuth, elevation)[..., 0]


def _sky_angles(true_d: FloatArray, model_d: FloatArray) -> FloatArray:
    """Return the angle from the modelled to the true direction, resolved to the right and up."""
    sines = -(right_and_up(true_d) @ model_d[..., None])[..., 0]
    sine = np.linalg.norm(sines, axis=-1)
    angle = angle_between(true_d, model_d)
    return sines * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)[..., None]


def right_and_up(direction_d: FloatArray) -> FloatArray:
    """Return unit vectors to the right (horizontal) and up, perpendicular to a direction, shape (..., 2, 3)."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0])
    zero = np.zeros_like(azimuth)
    right = np.stack([-np.sin(azimuth), zero, np.cos(azimuth)], axis=-1)
    return np.stack([right, np.cross(right, direction_d)], axis=-2)


@dataclass(frozen=True)
class Coverage:
    """Coverage of the sky by the sightings.

    Attributes:
        count: number of sightings.
        plunged: number of sightings with the telescope beyond the zenith.
        elevations: least and greatest true elevation, rad.
        azimuth_gap: widest range of azimuth without a sighting, (from, to) clockwise, rad.
    """

    count: int
    plunged: int
    elevations: tuple[float, float]
    azimuth_gap: tuple[float, float]

    @property
    def azimuth_gap_width(self) -> float:
        """Width of the gap, in (0, 2 pi], rad; the full circle if all sightings have one azimuth."""
        width = (self.azimuth_gap[1] - self.azimuth_gap[0]) % (2.0 * np.pi)
        return width if width > 0.0 else 2.0 * np.pi


def coverage(sightings: Sightings) -> Coverage:
    """Return the coverage of the sky by one or more sightings."""
    azimuth, elevation = azimuth_and_elevation(sightings.direction_d)
    ordered = np.sort(azimuth)
    following = np.roll(ordered, -1)
    widest = int(np.argmax((following - ordered) % (2.0 * np.pi)))
    return Coverage(
        count=len(sightings.labels),
        plunged=int(np.sum(np.cos(sightings.elevation) < 0.0)),
        elevations=(float(elevation.min()), float(elevation.max())),
        azimuth_gap=(float(ordered[widest]), float(following[widest])),
    )


def azimuth_and_elevation(direction_d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in [0, 2 pi) and elevation of unit vectors, shape (n,), rad."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0]) % (2.0 * np.pi)
    return azimuth, np.arctan2(direction_d[..., 1], np.hypot(direction_d[..., 0], direction_d[..., 2]))

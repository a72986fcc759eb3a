"""Vectors between samples, such as baselines and encoder angles: cubics whose slopes are differences of neighbours."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ship_geometry.interpolation_error import as_covariance, by_polynomial
from ship_geometry.rotations import FloatArray
from ship_geometry.sample_track import SampleTrack, hermite_weights


@dataclass(frozen=True)
class VectorSample:
    """One vector of a track.

    Attributes:
        time_ns: time in the source's own stamps.
        vector: shape (k,).
    """

    time_ns: int
    vector: FloatArray

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated sample, and an order for conflicting ones."""
        return self.vector.tobytes()


@dataclass(frozen=True)
class InterpolatedVector:
    """The vector at a moment of the track.

    Attributes:
        vector: shape (k,). A periodic component may differ from its principal value by whole periods.
        noise_gain: variance of the result per variance of the samples' independent noise.
        errors: estimates of the interpolation's own error, for
            :func:`ship_geometry.interpolation_error.as_covariance`, shape (k,) each.
    """

    vector: FloatArray
    noise_gain: float
    errors: tuple[FloatArray, ...] = ()

    @property
    def error_covariance(self) -> FloatArray:
        """Covariance of the interpolation's own error, shape (k, k)."""
        return as_covariance(self.errors) if self.errors else np.zeros((self.vector.size, self.vector.size))


Sample = TypeVar("Sample", bound=VectorSample)


class VectorTrack(SampleTrack[Sample]):
    """Vectors of one source.

    Args:
        max_gap_ns: neighbours further apart than this are not joined.
        period: after which all components repeat: 2 pi for angles, infinite for lengths.

    Example:
        An azimuth that passes north, between 359° and 1°:

        >>> track = VectorTrack(max_gap_ns=10**9, period=2.0 * np.pi)
        >>> _ = track.insert(VectorSample(0, np.deg2rad([359.0])))
        >>> _ = track.insert(VectorSample(10**9, np.deg2rad([361.0 - 360.0])))
        >>> print(np.rad2deg(track.at(5 * 10**8).vector).round(6))
        [360.]
    """

    def __init__(self, max_gap_ns: int, period: float = np.inf) -> None:
        super().__init__(max_gap_ns)
        self._period = period

    def at(self, time_ns: int) -> InterpolatedVector | None:
        """The vector at a moment; None outside the track or in a gap."""
        interval = self._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        first = self._samples[left].vector
        if fraction == 0.0:
            return InterpolatedVector(first, 1.0)
        _, slope0, value1, slope1 = hermite_weights(fraction)
        change = slope0 * self._slope(left, left) + value1 * self._change(left, left + 1)
        change += slope1 * self._slope(left + 1, left)
        around = self._around(left)
        values = np.array([self._change(left, index) for index in around])
        errors = by_polynomial(self._fractions(around, left), values, fraction, change)
        return InterpolatedVector(first + change, self._noise_gain(left, fraction), errors)

    def _slope(self, index: int, left: int) -> FloatArray:
        """Rate of change at a sample, over the time of the interval that begins at ``left``."""
        before, after = self._neighbours(index)
        return self._change(before, after) * (self._seconds(left, left + 1) / self._seconds(before, after))

    def _change(self, first: int, second: int) -> FloatArray:
        """Change from one sample to another, summed over the steps between them, each step the short way round."""
        if second < first:
            return -self._change(second, first)
        change = np.zeros_like(self._samples[first].vector)
        for index in range(first, second):
            step = self._samples[index + 1].vector - self._samples[index].vector
            change += step if self._period == np.inf else step - self._period * np.round(step / self._period)
        return change

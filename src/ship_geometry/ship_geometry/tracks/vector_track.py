"""Vectors of one source between its samples, such as baselines and encoder angles, by cubic interpolation.

The slopes of the cubic are differences of neighbouring samples.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.interpolation_error import ANY_DIRECTION, MOST_SAMPLES, NEXT_TERM_SHARE
from ship_geometry.tracks.sample_track import SampleTrack, hermite_weights
from ship_kernels import compiled_tracks


@dataclass(frozen=True)
class VectorSample:
    """One vector of a track.

    Attributes:
        time_ns: time in the source's own stamps.
        vector: components of the vector, shape (k,).
    """

    time_ns: int
    vector: FloatArray

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated sample and to sort conflicting samples."""
        return self.vector.tobytes()


@dataclass(frozen=True)
class InterpolatedVector:
    """The vector at a time of the track.

    Attributes:
        vector: interpolated vector, shape (k,). A periodic component is not reduced to one period.
        noise_gain: variance of the vector, divided by the variance of the samples' independent noise.
        error_covariance: covariance of the interpolation error, estimated from neighbouring samples, shape (k, k).
    """

    vector: FloatArray
    noise_gain: float
    error_covariance: FloatArray


Sample = TypeVar("Sample", bound=VectorSample)


class VectorTrack(SampleTrack[Sample]):
    """Vectors of one source.

    Args:
        max_gap_ns: maximum interval between two samples for interpolation.
        period: period of all components: 2 pi for angles, infinite for lengths.

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
        """Return the vector at a time; None outside the track, in a gap or across a cut."""
        interval = self._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        if fraction == 0.0:
            vector = self._samples[left].vector
            return InterpolatedVector(vector, 1.0, np.zeros((vector.size, vector.size)))
        first = left
        while first > max(left - 2, 0) and self._are_joined(first - 1):
            first -= 1
        last = left + 2 if left + 2 < len(self._samples) and self._are_joined(left + 1) else left + 1
        around = slice(first, last + 1)
        found = compiled_tracks.interpolate_vector(
            np.array(self._times[around]),
            np.array([sample.vector for sample in self._samples[around]]),
            left - first,
            time_ns,
            self._period,
            *hermite_weights(fraction),
            NEXT_TERM_SHARE if last + 1 - first == MOST_SAMPLES else 1.0,
            ANY_DIRECTION,
        )
        return InterpolatedVector(*found)

    def _change(self, first: int, second: int) -> FloatArray:
        """Return the change from one sample to another; whole periods are removed from each step between neighbours."""
        if second < first:
            return -self._change(second, first)
        change = np.zeros_like(self._samples[first].vector)
        for index in range(first, second):
            step = self._samples[index + 1].vector - self._samples[index].vector
            change += step if self._period == np.inf else step - self._period * np.round(step / self._period)
        return change

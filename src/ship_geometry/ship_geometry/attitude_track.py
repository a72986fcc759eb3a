"""Attitude between samples: a time-ordered track, cubic interpolation, and what it does to the samples' noise.

Between two samples the rotation vector relative to the earlier one is a cubic with the right attitude and the
right rate at both ends. The rates are measured where the source gives them; otherwise they come from the
neighbouring samples. docs/interpolation.md states the error for a rolling ship.
"""

import bisect
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class AttitudeSample:
    """One attitude of a track.

    Attributes:
        time_ns: time in the source's own stamps.
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,); None where the source measures none.
    """

    time_ns: int
    rotation_nd: FloatArray
    rate_d: FloatArray | None = None

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated sample, and an order for conflicting ones."""
        return self.rotation_nd.tobytes() + (b"" if self.rate_d is None else self.rate_d.tobytes())


@dataclass(frozen=True)
class InterpolatedAttitude:
    """The attitude at a moment of the track.

    Attributes:
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        noise_gain: variance of the result per variance of the samples' independent noise.
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    noise_gain: float


def hermite_weights(fraction: float) -> tuple[float, float, float, float]:
    """Weights of value 0, slope 0, value 1, slope 1 of a cubic on [0, 1] at ``fraction``."""
    s = fraction
    return (1 - s) ** 2 * (1 + 2 * s), s * (1 - s) ** 2, s * s * (3 - 2 * s), s * s * (s - 1)


class AttitudeTrack:
    """Samples of one source in order of their stamps, whatever their order of arrival.

    Args:
        max_gap_ns: neighbours further apart than this are not joined.
    """

    def __init__(self, max_gap_ns: int) -> None:
        self._max_gap_ns = max_gap_ns
        self._times: list[int] = []
        self._samples: list[AttitudeSample] = []

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def newest(self) -> AttitudeSample | None:
        """The sample with the latest stamp."""
        return self._samples[-1] if self._samples else None

    def get(self, time_ns: int) -> AttitudeSample | None:
        """The sample stamped exactly ``time_ns``."""
        index = bisect.bisect_left(self._times, time_ns)
        found = index < len(self._times) and self._times[index] == time_ns
        return self._samples[index] if found else None

    def insert(self, sample: AttitudeSample) -> int | None:
        """Put a sample in its place; one with the same stamp is replaced.

        Returns:
            The stamp after which interpolated attitudes may have changed; None where the sample is the newest
            and so none that :meth:`covers` held for can have.
        """
        if not self._times or sample.time_ns > self._times[-1]:
            self._times.append(sample.time_ns)
            self._samples.append(sample)
            return None
        index = bisect.bisect_left(self._times, sample.time_ns)
        if self._times[index] == sample.time_ns:
            self._samples[index] = sample
        else:
            self._times.insert(index, sample.time_ns)
            self._samples.insert(index, sample)
        # Differenced rates reach one sample beyond the interval itself; near the start, the first sample's own
        # rate, or its being there at all, is new.
        return self._times[index - 2] if index >= 2 else self._times[0] - 1

    def drop_before(self, time_ns: int) -> None:
        """Forget what is not needed to interpolate at or after ``time_ns``."""
        # Two samples before the moment: the start of its interval and that one's neighbour.
        keep_from = bisect.bisect_right(self._times, time_ns) - 2
        if keep_from > 0:
            del self._times[:keep_from]
            del self._samples[:keep_from]

    def covers(self, time_ns: int) -> bool:
        """True once later samples can no longer change the attitude at a moment, arriving in order."""
        right = bisect.bisect_left(self._times, time_ns)
        if right == len(self._times):
            return False
        # A differenced rate at the right sample needs that one's neighbour.
        return self._samples[right].rate_d is not None or right + 1 < len(self._times)

    def at(self, time_ns: int) -> InterpolatedAttitude | None:
        """The attitude at a moment; None outside the track or in a gap."""
        if not self._times or not self._times[0] <= time_ns <= self._times[-1]:
            return None
        right = bisect.bisect_left(self._times, time_ns)
        if self._times[right] == time_ns:
            return InterpolatedAttitude(self._samples[right].rotation_nd, self.rate(right), 1.0)
        left = right - 1
        interval_ns = self._times[right] - self._times[left]
        if interval_ns > self._max_gap_ns:
            return None
        interval_s = interval_ns / _SECOND_NS
        fraction = (time_ns - self._times[left]) / interval_ns
        return self._between(left, interval_s, fraction)

    def newest_moved(self, ahead_s: float) -> InterpolatedAttitude:
        """The attitude ``ahead_s`` (small, either sign) from the newest sample, by its rate and rate of change.

        Used to move a sample by a clock offset: one sample gives one attitude, whatever the sign of the offset.
        """
        index = len(self._samples) - 1
        sample, rate = self._samples[index], self.rate(index)
        acceleration = self._acceleration(index, rate)
        vector = ahead_s * rate + 0.5 * ahead_s * ahead_s * acceleration
        gain = 1.0
        if sample.rate_d is None and index > 0 and self._joined(index - 1):
            part = ahead_s * _SECOND_NS / (self._times[index] - self._times[index - 1])
            gain = (1.0 + part) ** 2 + part**2
        return InterpolatedAttitude(
            sample.rotation_nd @ exp_rotation(vector), rate + ahead_s * acceleration, gain
        )

    def rate(self, index: int) -> FloatArray:
        """Angular velocity in the deck frame at sample ``index``: measured, or by differences; rad/s."""
        sample = self._samples[index]
        if sample.rate_d is not None:
            return sample.rate_d
        before, after = self._neighbours(index)
        if before == after:
            return np.zeros(3)
        turn = log_rotation(self._samples[before].rotation_nd.T @ self._samples[after].rotation_nd)
        return turn * (_SECOND_NS / (self._times[after] - self._times[before]))

    def _acceleration(self, index: int, rate: FloatArray) -> FloatArray:
        """Rate of change of a measured rate, rad/s²; zero where rates are differences of noisy attitudes."""
        if index == 0 or not self._joined(index - 1):
            return np.zeros(3)
        earlier = self._samples[index - 1].rate_d
        if earlier is None or self._samples[index].rate_d is None:
            return np.zeros(3)
        return (rate - earlier) * (_SECOND_NS / (self._times[index] - self._times[index - 1]))

    def _neighbours(self, index: int) -> tuple[int, int]:
        """The samples whose difference gives the rate at sample ``index``: itself where there is no other."""
        before = index - 1 if index > 0 and self._joined(index - 1) else index
        after = index + 1 if index + 1 < len(self._samples) and self._joined(index) else index
        return before, after

    def _joined(self, left: int) -> bool:
        return self._times[left + 1] - self._times[left] <= self._max_gap_ns

    def _between(self, left: int, interval_s: float, fraction: float) -> InterpolatedAttitude:
        first, second = self._samples[left], self._samples[left + 1]
        turn = log_rotation(first.rotation_nd.T @ second.rotation_nd)
        start_slope = self.rate(left) * interval_s
        # d(rotation vector)/dt = J_right^-1 rate, and J_right = J_left^T.
        end_slope = np.linalg.solve(left_jacobian(turn).T, self.rate(left + 1) * interval_s)
        _, slope0, value1, slope1 = hermite_weights(fraction)
        vector = slope0 * start_slope + value1 * turn + slope1 * end_slope
        s = fraction
        derivative = (
            (1 - s) * (1 - 3 * s) * start_slope + 6 * s * (1 - s) * turn + s * (3 * s - 2) * end_slope
        )
        rate = left_jacobian(vector).T @ derivative / interval_s
        gain = self._noise_gain(left, fraction)
        return InterpolatedAttitude(first.rotation_nd @ exp_rotation(vector), rate, gain)

    def _noise_gain(self, left: int, fraction: float) -> float:
        """Sum of the squared weights of the samples' attitudes; measured rates are taken as free of noise."""
        value0, slope0, value1, slope1 = hermite_weights(fraction)
        weights = {left: value0, left + 1: value1}
        interval_ns = self._times[left + 1] - self._times[left]
        for index, slope in ((left, slope0), (left + 1, slope1)):
            if self._samples[index].rate_d is None:
                before, after = self._neighbours(index)
                share = slope * interval_ns / (self._times[after] - self._times[before])
                weights[before] = weights.get(before, 0.0) - share
                weights[after] = weights.get(after, 0.0) + share
        return sum(weight * weight for weight in weights.values())

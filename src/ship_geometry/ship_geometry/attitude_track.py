"""Attitude between samples: a time-ordered track, cubic interpolation, and what it does to the samples' noise.

Between two samples the rotation vector relative to the earlier one is a cubic with the right attitude and the
right rate at both ends. The rates are measured where the source gives them; otherwise they come from the
neighbouring samples. docs/interpolation.md states the error for a rolling ship.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation
from ship_geometry.sample_track import SECOND_NS, SampleTrack, hermite_weights


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


class AttitudeTrack(SampleTrack[AttitudeSample]):
    """Attitudes of one source."""

    def at(self, time_ns: int) -> InterpolatedAttitude | None:
        """The attitude at a moment; None outside the track or in a gap."""
        interval = self._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        if fraction == 0.0:
            return InterpolatedAttitude(self._samples[left].rotation_nd, self.rate(left), 1.0)
        return self._between(left, fraction)

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
            part = ahead_s * SECOND_NS / (self._times[index] - self._times[index - 1])
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
        return turn * (SECOND_NS / (self._times[after] - self._times[before]))

    def _acceleration(self, index: int, rate: FloatArray) -> FloatArray:
        """Rate of change of a measured rate, rad/s²; zero where rates are differences of noisy attitudes."""
        if index == 0 or not self._joined(index - 1):
            return np.zeros(3)
        earlier = self._samples[index - 1].rate_d
        if earlier is None or self._samples[index].rate_d is None:
            return np.zeros(3)
        return (rate - earlier) * (SECOND_NS / (self._times[index] - self._times[index - 1]))

    def _has_rate(self, index: int) -> bool:
        return self._samples[index].rate_d is not None

    def _between(self, left: int, fraction: float) -> InterpolatedAttitude:
        interval_s = self._seconds(left, left + 1)
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

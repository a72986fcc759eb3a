"""Attitudes of one source between its samples, by cubic interpolation, with the noise of the samples.

Between two samples the rotation vector relative to the earlier sample is a cubic with the attitudes and the rates of
both samples. If the source measures no rates, mean rates between neighbouring samples are used.
docs/explanation/interpolation.md states the interpolation error for a rolling ship.
"""

import bisect
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.interpolation_error import (
    ANY_DIRECTION,
    LARGEST_VARIANCE,
    NEXT_TERM_SHARE,
    as_covariance,
    polynomial_errors,
    propagate_by_differences,
)
from ship_geometry.tracks.sample_track import RECENT_COUNT, SampleTrack
from ship_kernels import compiled_rotations

_SPACING_NS = 100_000_000
"""Spacing, ns, of the samples from which the motion is estimated without rates; with closer ones noise dominates."""

_ERROR_BOUNDS = ANY_DIRECTION, LARGEST_VARIANCE
"""Last two arguments of the compiled functions: ``any_direction`` and ``largest``."""

MAX_RATES = 4
"""Maximum number of measured rates from which the angular acceleration and its change are computed."""


@dataclass(frozen=True)
class AttitudeSample:
    """One attitude of a track.

    Attributes:
        time_ns: time in the source's own stamps.
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,); None if the source measures none.
    """

    time_ns: int
    rotation_nd: FloatArray
    rate_d: FloatArray | None = None

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated sample and to sort conflicting samples."""
        return self.rotation_nd.tobytes() + (b"" if self.rate_d is None else self.rate_d.tobytes())


class SampleBlock(NamedTuple):
    """Successive samples of one source, each with a measured rate; see :class:`AttitudeSample`.

    Attributes:
        times_ns: stamps in ascending order, shape (N,).
        rotations_nd: attitudes, shape (N, 3, 3).
        rates_d: measured rates, rad/s, shape (N, 3).
    """

    times_ns: NDArray[np.int64]
    rotations_nd: FloatArray
    rates_d: FloatArray

    def samples(self) -> list[AttitudeSample]:
        """Return the samples as a list."""
        return list(map(AttitudeSample, self.times_ns.tolist(), self.rotations_nd, self.rates_d))

    def sample(self, number: int) -> AttitudeSample:
        """Return one sample."""
        return AttitudeSample(int(self.times_ns[number]), self.rotations_nd[number], self.rates_d[number])

    def subset(self, which: slice) -> "SampleBlock":
        """Return a slice of the samples."""
        return SampleBlock(self.times_ns[which], self.rotations_nd[which], self.rates_d[which])


class ExtraNoise(NamedTuple):
    """Independent noise of a source's samples in excess of the stated noise, from a stamp on.

    Attributes:
        from_ns: first stamp of the samples with this noise.
        white_rad2: variance of each attitude about each axis, rad².
        jitter_s2: variance of each stamp, s²; it acts along the rotation.
        clock_sigma_s: standard deviation of the change of the stamps' mean delay, s.
    """

    from_ns: int
    white_rad2: float
    jitter_s2: float
    clock_sigma_s: float = 0.0

    @property
    def time_ns(self) -> int:
        """The stamp after which attitudes have this noise: one nanosecond before ``from_ns``."""
        return self.from_ns - 1

    def covariances_d(self, rates_d: FloatArray) -> FloatArray:
        """Return the covariance of N attitudes, rotation vector in the deck frame, rad², shape (N, 3, 3).

        Args:
            rates_d: angular velocities at the N attitudes, rad/s, shape (N, 3).

        Example:
            >>> extra = ExtraNoise(0, white_rad2=4.0, jitter_s2=2.0)
            >>> print(extra.covariances_d(np.array([[1.0, 0.0, 0.0]])).tolist())
            [[[6.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]]]
        """
        along: FloatArray = self.jitter_s2 * rates_d[:, :, None] * rates_d[:, None, :]
        return along + self.white_rad2 * np.eye(3)


class PropagatedBlock(NamedTuple):
    """Attitudes of a block, each propagated by a short time.

    Attributes:
        rotation_nd: as in :class:`InterpolatedAttitude`, shape (N, 3, 3).
        rate_d: likewise, shape (N, 3).
        noise_gain: likewise, shape (N,).
        error_covariance_d: likewise, shape (N, 3, 3).
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    noise_gain: FloatArray
    error_covariance_d: FloatArray

    def with_noise(self, extra: ExtraNoise | None) -> "PropagatedBlock":
        """Return the block with extra noise added to its covariances."""
        if extra is None:
            return self
        return self._replace(error_covariance_d=self.error_covariance_d + extra.covariances_d(self.rate_d))

    def subset(self, which: slice) -> "PropagatedBlock":
        """Return a slice of the attitudes."""
        return PropagatedBlock(*(values[which] for values in self))


@dataclass(frozen=True)
class InterpolatedAttitude:
    """The attitude at a time of the track.

    Attributes:
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        noise_gain: variance of the attitude, divided by the variance of the samples' independent noise.
        error_covariance_d: covariance of the interpolation error and of the samples' extra noise, rotation vector in
            the deck frame, rad², shape (3, 3). The interpolation error is estimated from the neighbouring samples.
        sample: last sample at or before the time; None for a propagated attitude.
        next_sample: sample after the time; None if the attitude is not interpolated.
        errors_d: estimates of the interpolation error, rotation vectors in the deck frame, rad, shape (3,) each; empty
            at a sample and after a propagation. :func:`ship_geometry.tracks.interpolation_error.joint_covariance`
            computes from them the correlation of the errors at two times.
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    noise_gain: float
    error_covariance_d: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    sample: AttitudeSample | None = None
    next_sample: AttitudeSample | None = None
    errors_d: tuple[FloatArray, ...] = ()

    @property
    def error_covariance_n(self) -> FloatArray:
        """``error_covariance_d`` transformed to the axes of the horizon, rad², shape (3, 3)."""
        covariance_n: FloatArray = self.rotation_nd @ self.error_covariance_d @ self.rotation_nd.T
        return covariance_n

    def chord_nd(self, time_ns: int) -> FloatArray:
        """Return the attitude by rotation at a constant rate between the two samples (slerp, as tf2), shape (3, 3).

        The result is ``rotation_nd`` if the attitude is not interpolated.

        Args:
            time_ns: time of this attitude.
        """
        first, second = self.sample, self.next_sample
        if first is None or second is None:
            return self.rotation_nd
        fraction = (time_ns - first.time_ns) / (second.time_ns - first.time_ns)
        turn = log_rotation(first.rotation_nd.T @ second.rotation_nd)
        chord_nd: FloatArray = first.rotation_nd @ exp_rotation(fraction * turn)
        return chord_nd


class AttitudeTrack(SampleTrack[AttitudeSample]):
    """Attitudes of one source, interpolated by a cubic of the rotation vector.

    Example:
        A ship turns by 10° in one second. Its attitude is interpolated halfway between two samples:

        >>> from ship_geometry.frames import angles_from_rotation, rotation_from_angles
        >>> rate_d = np.deg2rad([0.0, -10.0, 0.0])  # clockwise seen from above is negative about up
        >>> track = AttitudeTrack(max_gap_ns=SECOND_NS)
        >>> for second, heading_deg in ((0, 40.0), (1, 50.0)):
        ...     rotation_nd = rotation_from_angles(np.deg2rad(heading_deg), 0.0, 0.0)
        ...     _ = track.insert(AttitudeSample(second * SECOND_NS, rotation_nd, rate_d))
        >>> found = track.at(SECOND_NS // 2)
        >>> print(np.rad2deg(angles_from_rotation(found.rotation_nd)).round(6) + 0.0, round(found.noise_gain, 6))
        [45.  0.  0.] 0.5
    """

    def __init__(self, max_gap_ns: int) -> None:
        super().__init__(max_gap_ns)
        self._extra: list[ExtraNoise] = []

    def add_noise(self, extra: ExtraNoise) -> int:
        """Set the extra noise of the samples from a stamp on; return the stamp after which attitudes have changed.

        Extra noise set before from this stamp, or from a later stamp, is replaced.
        """
        kept = [one for one in self._extra if one.from_ns < extra.from_ns]
        # Only the last entry before the first sample of the track still applies.
        past = [one for one in kept if self._times and one.from_ns <= self._times[0]]
        self._extra = [*kept[max(len(past) - 1, 0) :], extra]
        return extra.time_ns

    def extra_noise(self, time_ns: int) -> ExtraNoise | None:
        """Return the extra noise of the samples at a stamp; None if there is none."""
        return next((one for one in reversed(self._extra) if one.from_ns <= time_ns), None)

    def at(self, time_ns: int) -> InterpolatedAttitude | None:
        """Return the attitude at a time; None outside the track, in a gap or across a cut."""
        interval = self._interval(time_ns)
        if interval is None:
            return None
        left, fraction = interval
        first = self._samples[left]
        second = first if fraction == 0.0 else self._samples[left + 1]
        if second is first:
            found = InterpolatedAttitude(first.rotation_nd, self.rate(left), 1.0, sample=first)
        elif first.rate_d is None or second.rate_d is None:
            found = self._interpolate_without_rates(left, fraction)
        else:
            interval_s = (second.time_ns - first.time_ns) / SECOND_NS
            # The error of the cubic is estimated from its difference to the sample before the interval.
            before, at_before = first, 0.0
            if left > 0 and self._are_joined(left - 1):
                before = self._samples[left - 1]
                at_before = (before.time_ns - first.time_ns) / SECOND_NS / interval_s
            rotation_nd, rate_d, gain, errors_d, covariance_d = compiled_rotations.interpolate_attitude(
                first.rotation_nd,
                second.rotation_nd,
                before.rotation_nd,
                first.rate_d,
                second.rate_d,
                interval_s,
                fraction,
                at_before,
                NEXT_TERM_SHARE,
                *_ERROR_BOUNDS,
            )
            found = InterpolatedAttitude(rotation_nd, rate_d, gain, covariance_d, first, second, tuple(errors_d))
        return self._with_noise(found, time_ns) if self._extra else found

    def propagate_newest(self, ahead_s: float) -> InterpolatedAttitude:
        """Return the newest attitude, propagated over a short time by its rate and angular acceleration.

        The short time is the clock offset of the source, of either sign. Interpolation would have to wait for the next
        sample if the offset is positive.

        Args:
            ahead_s: time after the newest sample, s; negative for a time before the sample.
        """
        index = len(self._samples) - 1
        has_rate = self._samples[index].rate_d is not None
        moved = (self._propagate_by_rates if has_rate else self._propagate_by_differences)(index, ahead_s)
        return self._with_noise(moved, self._times[index]) if self._extra else moved

    def _with_noise(self, found: InterpolatedAttitude, time_ns: int) -> InterpolatedAttitude:
        """Return an attitude with the extra noise of the samples added to its covariance."""
        extra = self.extra_noise(time_ns)
        if extra is None:
            return found
        (noise_d,) = found.noise_gain * extra.covariances_d(found.rate_d[None])
        return replace(found, error_covariance_d=found.error_covariance_d + noise_d)

    def recent_block(self) -> SampleBlock | None:
        """Return the last MAX_RATES - 1 samples, by whose rates later samples are propagated.

        The result is None for fewer samples, and if these have a gap, a jump or no measured rate.
        """
        rates_d = self._recent_rates(len(self._samples) - 1)[: MAX_RATES - 1]
        # Rates from before and after a jump do not give an acceleration.
        if len(rates_d) < MAX_RATES - 1 or (self._cuts_ns and max(self._cuts_ns) >= self._times[-1]):
            return None
        rotations_nd = np.array([sample.rotation_nd for sample in self._samples[1 - MAX_RATES :]])
        return SampleBlock(np.array(self._times[1 - MAX_RATES :]), rotations_nd, np.array(rates_d[::-1]))

    def drop_rates(self, after_ns: int) -> int | None:
        """Drop the wrong measured rates of all samples after a stamp.

        Returns:
            The stamp after which interpolated values may have changed; None if no sample after ``after_ns`` has a rate.
        """
        start = bisect.bisect_right(self._times, after_ns)
        if all(sample.rate_d is None for sample in self._samples[start:]):
            return None
        self._samples[start:] = [replace(sample, rate_d=None) for sample in self._samples[start:]]
        return self._times[start - 1] if start > 0 else self._times[0] - 1

    def rate(self, index: int) -> FloatArray:
        """Return the rate at sample ``index``, deck frame, rad/s.

        Without a measured rate the result is the mean rate between the neighbours; zero if there is no neighbour.
        """
        sample = self._samples[index]
        if sample.rate_d is not None:
            return sample.rate_d
        before, after = self._neighbours(index)
        if before == after:
            return np.zeros(3)
        return self._turn(before, after) * (SECOND_NS / (self._times[after] - self._times[before]))

    def _propagate_by_rates(self, index: int, ahead_s: float) -> InterpolatedAttitude:
        """Propagate the newest sample by its measured rate and, if usable, the change since the sample before.

        The difference of two rates gives the acceleration half a step before the newest sample. The error of the
        propagation therefore contains the change of the acceleration in this half step too.
        """
        rotation_nd, rates = self._samples[index].rotation_nd, self._recent_rates(index)
        if len(rates) == 1:
            return InterpolatedAttitude(rotation_nd @ exp_rotation(ahead_s * rates[0]), rates[0], 1.0)
        times = self._times
        steps_s = [(times[k] - times[k - 1]) / SECOND_NS for k in range(index, index - len(rates) + 1, -1)]
        of_one = rotation_nd[None], np.array([rates]), np.array([steps_s]), np.array([ahead_s])
        (moved_nd,), (rate_d,), (error_d,) = compiled_rotations.propagate_by_rates(*of_one, *_ERROR_BOUNDS)
        return InterpolatedAttitude(moved_nd, rate_d, 1.0, error_d)

    def _recent_rates(self, index: int) -> list[FloatArray]:
        """Return up to four measured rates, rad/s, newest first, without a gap, jump or missing rate between them."""
        recent: list[FloatArray] = []
        for sample in reversed(self._samples[self._joined_from(index, MAX_RATES) : index + 1]):
            if sample.rate_d is None:
                break
            recent.append(sample.rate_d)
        return recent

    def _propagate_by_differences(self, index: int, ahead_s: float) -> InterpolatedAttitude:
        """Propagate the newest sample without measured rates, by a parabola through the last three motion samples.

        With two samples the rate is constant; with one sample the attitude is unchanged.
        """
        sample = self._samples[index]
        recent = self._motion_samples(index)
        if len(recent) == 1:
            return InterpolatedAttitude(sample.rotation_nd, np.zeros(3), 1.0)
        rotations = np.array([self._samples[other].rotation_nd for other in recent])
        turns = log_rotation(sample.rotation_nd.T @ rotations)
        nodes_s = np.array([self._seconds(index, other) for other in recent])
        return InterpolatedAttitude(*propagate_by_differences(sample.rotation_nd, turns, nodes_s, ahead_s))

    def _motion_samples(self, index: int) -> list[int]:
        """Return the indices of the samples from which the motion of the newest sample is estimated, newest first.

        These samples are the newest, its predecessor, and earlier samples, each at least 0.1 s before the next one.
        """
        recent = [index]
        oldest = self._recent_from()
        if index == 0 or not self._are_joined(index - 1):
            return recent
        recent.append(index - 1)
        while len(recent) < RECENT_COUNT:
            last = recent[-1]
            found = bisect.bisect_right(self._times, self._times[last] - _SPACING_NS) - 1
            if found < oldest or self._times[last] - self._times[found] > max(self.max_gap_ns, 2 * _SPACING_NS):
                break
            if self._is_cut_between(self._times[found], self._times[last]):
                break
            recent.append(found)
        return recent

    def _has_rate(self, index: int) -> bool:
        return self._samples[index].rate_d is not None

    def _interpolate_without_rates(self, left: int, fraction: float) -> InterpolatedAttitude:
        """Interpolate between two samples; the rates and the error of the cubic are from the neighbouring samples."""
        first, second = self._samples[left], self._samples[left + 1]
        turn, interval_s = self._turn(left, left + 1), self._seconds(left, left + 1)
        rotation_nd, rate_d, vector = compiled_rotations.cubic(
            first.rotation_nd, turn, self.rate(left), self.rate(left + 1), interval_s, fraction
        )
        around = self._indices_around(left)
        values = np.array([self._turn(left, index) for index in around])
        errors = polynomial_errors(self._fractions(around, left), values, fraction, vector)
        covariance_d, gain = as_covariance(errors, LARGEST_VARIANCE), self._noise_gain(left, fraction)
        return InterpolatedAttitude(rotation_nd, rate_d, gain, covariance_d, first, second, errors)

    def _turn(self, first: int, second: int) -> FloatArray:
        """Return the rotation vector from one sample to another, rad, shape (3,)."""
        turn: FloatArray = compiled_rotations.turn_between(
            self._samples[first].rotation_nd, self._samples[second].rotation_nd
        )
        return turn


def propagate_block(before: SampleBlock, block: SampleBlock, ahead_s: FloatArray) -> PropagatedBlock:
    """Propagate the samples of a block, each as if it were the newest (:meth:`AttitudeTrack.propagate_newest`).

    Args:
        before: the samples before the block, without a gap (:meth:`AttitudeTrack.recent_block`).
        block: N or more samples without a gap; the first N are propagated.
        ahead_s: time after each sample, s, negative for a time before the sample, shape (N,).

    Example:
        A ship turns at 0.1 rad/s. The last of four samples, ten seconds apart, is propagated by one second:

        >>> times_ns, rate_d = 10 * SECOND_NS * np.arange(4), np.array([0.0, -0.1, 0.0])
        >>> rotations_nd, rates_d = exp_rotation(np.outer(times_ns / SECOND_NS, rate_d)), np.tile(rate_d, (4, 1))
        >>> block = SampleBlock(times_ns, rotations_nd, rates_d)

        >>> propagated = propagate_block(block.subset(slice(3)), block.subset(slice(3, 4)), np.array([1.0]))
        >>> print(log_rotation(rotations_nd[3].T @ propagated.rotation_nd[0]).round(6) + 0.0)
        [ 0.  -0.1  0. ]
    """
    count = len(ahead_s)
    steps_s = np.diff(np.concatenate([before.times_ns, block.times_ns[:count]])) / SECOND_NS
    rates_d = np.concatenate([before.rates_d, block.rates_d[:count]])
    # Indices of the rates for each sample, newest first.
    recent = np.arange(MAX_RATES - 1, MAX_RATES - 1 + count)[:, None] - np.arange(MAX_RATES)
    moved_nd, rate_d, error_d = compiled_rotations.propagate_by_rates(
        block.rotations_nd[:count], rates_d[recent], steps_s[recent[:, :-1] - 1], ahead_s, *_ERROR_BOUNDS
    )
    return PropagatedBlock(moved_nd, rate_d, np.ones(count), error_d)

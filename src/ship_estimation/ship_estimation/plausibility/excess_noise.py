"""Excess attitude noise of an INS, measured against its own rates.

Each attitude is compared with the previous attitude propagated by the rates. Their difference d contains the noise of
both samples. The mean of d_k²/2 - d_k d_{k-1} over neighbouring steps k, per axis, is twice the noise variance of one
attitude; the noise of the rates cancels. Noise about the axis of rotation alone is jitter of the stamps. Noise about
all axes is noise of the attitude itself, for example due to coarse resolution. At rest jitter has no effect and is not
reported.

A small excess shows in the samples that pass the step check. A large excess makes samples fail this check. All samples,
including rejected samples, are collected at the start and after a failed check or a detected step, each time for two
seconds. The median difference of these samples distinguishes noise from a step. Samples are also collected during an
excess, so that changes and the end of the excess are detected within seconds.
"""

import math
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.plausibility.integrated_rates import IntegratedAttitude
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, ExtraNoise

_LONG_NS, _MEMORY_NS, _SHORT_NS = 30 * SECOND_NS, 10 * SECOND_NS, 2 * SECOND_NS
"""Averaging times for the detection of a small excess, for the noise during an excess, and for the detection of a large
excess or of the end of an excess."""
_SETTLED_NS = _MEMORY_NS - SECOND_NS
"""Minimum duration of the data of a mean over the averaging time ``_MEMORY_NS``."""
_LEAST_RATIO2 = 1.25**2
"""Smallest ratio of measured to stated variance that is reported."""
_ESTIMATED, _SIGMAS = 1.25, 6.0
"""Relative standard deviation of a variance estimated from N steps, times sqrt(N), and least reported excess in these
standard deviations."""
_MEDIAN_RATIO, _START_RATIO = 2.0, 4.0
"""Ratio of the median difference to the usual difference from which rejected samples indicate noise and not a step. The
second value applies at the start, when the usual difference is unknown and the rates may be noisy."""
_LARGER, _OTHER, _MORE_STEPS = 1.5, 1.25, 3
"""Ratios of standard deviations from which a new estimate replaces the present estimate: the first for a larger
estimate over the short time, the second for a larger or smaller estimate over the long time. Unless the data last
``_SETTLED_NS``, the estimate over the long time also needs a number of steps: the third value times the number of steps
of the present estimate."""
_OVER_SHORT, _OVER_LONG, _WOULD_SHOW = 1.5, 1.2, 1.4
"""Ratios of measured to stated noise below which an excess ends, over the short time and over the long time. The ratio
of the present estimate must be at least twice the first value for the short time, or the third value for the long time.
"""
_FIRST_NS, _EVERY_NS, _LEAST_STEPS = SECOND_NS // 2, SECOND_NS // 4, 10
"""Delay of the first evaluation of collected samples, period of further evaluations, and least number of steps."""
_MEDIAN_OF_DIFFERENCE = 1.538 * math.sqrt(2.0)
"""Median length of the difference of two samples with unit noise about each of three axes."""
_FARTHEST = (8.0, 5.0)
"""Outlier limits of the differences, standard deviations, in the first and second pass."""
_ALONG_TURN = 2.0
"""Ratio of the variance along the axis of rotation to the variance across it, above which the noise is jitter."""
_DELAY_SIGMAS = 2.0
"""Bound of the mean delay of randomly late stamps, in their standard deviations; a uniform delay from zero has 1.7."""


class NoiseSums(NamedTuple):
    """Sums of the noise in steps from sample to sample.

    Attributes:
        first_ns: stamp of the first sample.
        last_ns: stamp of the last sample.
        steps: number of steps in the sum, which are short and follow a short step.
        variance_sum: sum over the steps of the noise variance of an attitude about each axis, rad².
    """

    first_ns: int
    last_ns: int
    steps: int
    variance_sum: float


class MeasuredNoise(NamedTuple):
    """Measured noise of the attitudes.

    Attributes:
        first_ns: stamp of the first sample with this noise.
        white_rad2: variance about each axis, independent of the rotation.
        jitter_s2: variance of the stamps, s².
        rate2: mean square of the angular rate in the evaluated steps, (rad/s)².
        steps: number of evaluated steps.
    """

    first_ns: int
    white_rad2: float
    jitter_s2: float
    rate2: float
    steps: int

    def sigma_rad(self, rate2: float | None = None) -> float:
        """Return the standard deviation of an attitude about its worst axis at ``rate2`` (default: measured), rad."""
        return math.sqrt(self.white_rad2 + self.jitter_s2 * (self.rate2 if rate2 is None else rate2))

    def text(self, stated_rad: float) -> str:
        """Return a text with the measured and the stated standard deviation.

        >>> MeasuredNoise(0, 0.0, 1.6e-5, 3e-4, 40).text(ARCSEC)
        'stamps jitter by 4.0 ms (1 sigma): attitude noise is 14.3″ at this rate of turn, stated 1.0″'

        >>> MeasuredNoise(0, (12.0 * ARCSEC) ** 2, 0.0, 1e-3, 40).text(ARCSEC)
        'attitude noise is 12.0″ (1 sigma), stated 1.0″: coarse digits?'
        """
        sigma, stated = self.sigma_rad() / ARCSEC, stated_rad / ARCSEC
        if not self.jitter_s2:
            return f"attitude noise is {sigma:.1f}″ (1 sigma), stated {stated:.1f}″: coarse digits?"
        jitter = f"stamps jitter by {1e3 * math.sqrt(self.jitter_s2):.1f} ms (1 sigma)"
        return f"{jitter}: attitude noise is {sigma:.1f}″ at this rate of turn, stated {stated:.1f}″"


def noise_sums(times_ns: NDArray[np.int64], differences: FloatArray, longest_ns: float) -> NoiseSums:
    """Return the noise sums of steps from sample to sample.

    Args:
        times_ns: stamps of the samples, shape (n + 1,).
        differences: each attitude minus the previous attitude propagated by the rates, rad, shape (n, 3).
        longest_ns: maximum duration of a step; the integration error of the rates dominates in longer steps.

    Example:
        Noise of a tenth of a milliradian about each axis:

        >>> noise = np.random.default_rng(1).normal(0.0, 1e-4, (4001, 3))
        >>> sums = noise_sums(np.arange(4001), np.diff(noise, axis=0), longest_ns=2.0)
        >>> print(f"{math.sqrt(sums.variance_sum / sums.steps):.1e}")
        1.0e-04
    """
    is_short = np.diff(times_ns) <= longest_ns
    both = is_short[1:] & is_short[:-1]
    before, after = differences[:-1][both], differences[1:][both]
    squares, products = np.vdot(after, after), np.vdot(after, before)
    return NoiseSums(int(times_ns[0]), int(times_ns[-1]), len(after), float(0.5 * squares - products) / 6.0)


class ExcessNoise:
    """Detector of attitude noise above the stated noise.

    Args:
        stated_rad: stated noise of an attitude about each axis.

    Attributes:
        found: measured noise during an excess; None without an excess.

    >>> excess, noise = ExcessNoise(1e-5), np.random.default_rng(1).normal(0.0, 3e-5, (201, 3))
    >>> extra = excess.add(noise_sums(10_000_000 * np.arange(201), np.diff(noise, axis=0), longest_ns=2e7))
    >>> print(f"{excess.found.sigma_rad():.0e} {math.sqrt(extra.white_rad2):.1e}")
    3e-05 2.6e-05
    """

    def __init__(self, stated_rad: float) -> None:
        self.found: MeasuredNoise | None = None
        self._stated_rad = stated_rad
        self._sums: deque[NoiseSums] = deque()
        self._collected: deque[tuple[AttitudeSample, IntegratedAttitude]] = deque()
        self._last_failure_ns: int | None = None
        self._due_ns = 0
        self._usual_rad = self._fastest2 = 0.0

    def reconfigure(self, stated_rad: float) -> ExtraNoise | None:
        """Set another stated noise; return the changed excess, zero if the excess ends.

        None is returned if there is no excess, or if the stated noise is the same as before.
        """
        changed, self._stated_rad = stated_rad != self._stated_rad, stated_rad
        found = self.found
        if found is None or not changed:
            return None
        newest_ns = self._collected[-1][0].time_ns if self._collected else found.first_ns
        if found.sigma_rad(self._fastest2) ** 2 >= _LEAST_RATIO2 * stated_rad**2:
            return self._start_excess(found._replace(first_ns=newest_ns), self._fastest2)
        return self._end_excess(found, newest_ns)

    def reset(self) -> None:
        """Drop all samples, for example because the rates have changed or are not measured; :attr:`found` stays."""
        self._sums.clear()
        self._collected.clear()
        self._last_failure_ns = None

    @property
    def is_collecting(self) -> bool:
        """True while samples are collected: at the start, after a failed step check or a step, and during an excess."""
        return self._last_failure_ns is not None or self.found is not None

    def start_collecting(self, time_ns: int, usual_rad: float) -> None:
        """Start to collect samples: at the first sample, after a failed step check, or after a detected step.

        Args:
            time_ns: stamp of the sample that is the first, failed the check, or revealed the step.
            usual_rad: root mean square of the earlier differences.
        """
        if self._last_failure_ns is None:
            self._usual_rad = usual_rad
        self._last_failure_ns = time_ns

    @property
    def sigma_rad(self) -> float:
        """Noise about the worst axis at the fastest rotation of the excess, at least the stated noise, rad."""
        if self.found is None:
            return self._stated_rad
        return max(self._stated_rad, self.found.sigma_rad(self._fastest2))

    def add(self, sums: NoiseSums) -> ExtraNoise | None:
        """Add noise of samples that passed the step check; return a newly detected excess.

        The noise is ignored during an excess.
        """
        if self.found is not None:
            return None
        while self._sums and self._sums[0].first_ns < sums.last_ns - _LONG_NS:
            self._sums.popleft()
        self._sums.append(sums)
        for over_ns in (_SHORT_NS, _LONG_NS):
            recent = [one for one in self._sums if one.first_ns >= sums.last_ns - over_ns] or [sums]
            count = max(sum(one.steps for one in recent), 1)
            variance = sum(one.variance_sum for one in recent) / count
            least_ratio2 = max(_LEAST_RATIO2, 1.0 + _SIGMAS * _ESTIMATED / math.sqrt(count))
            if variance >= least_ratio2 * self._stated_rad**2:  # NaN does not exceed
                return self._start_excess(MeasuredNoise(recent[0].first_ns, variance, 0.0, 0.0, count))
        return None

    def observe(
        self, sample: AttitudeSample, integrated: IntegratedAttitude, rates_proven: bool = True
    ) -> ExtraNoise | None:
        """Collect a sample; return a newly detected or changed excess, or an excess of zero at the end of an excess.

        Args:
            sample: sample with a rate.
            integrated: attitude by integrated rates at the stamp of the sample.
            rates_proven: True if the rates are confirmed; no excess is reported with unconfirmed rates.
        """
        time_ns, collected = sample.time_ns, self._collected
        if self._last_failure_ns is not None and time_ns - self._last_failure_ns > _SHORT_NS:
            self._last_failure_ns = None
        if not self.is_collecting or (collected and collected[-1][1].run != integrated.run):
            collected.clear()
        if not self.is_collecting:
            return None
        if not collected:
            self._due_ns = time_ns + _FIRST_NS
        collected.append((sample, integrated))
        since_ns = time_ns - (_SHORT_NS if self.found is None else _MEMORY_NS)
        while len(collected) > _LEAST_STEPS + 1 and collected[0][0].time_ns < since_ns:
            collected.popleft()
        if not rates_proven or time_ns < self._due_ns or len(collected) <= _LEAST_STEPS:
            return None
        self._due_ns = time_ns + _EVERY_NS
        steps = _Steps.from_samples(collected)
        return self._initial_excess(steps) if self.found is None else self._changed_excess(self.found, steps)

    def _initial_excess(self, steps: "_Steps") -> ExtraNoise | None:
        """Return the excess of the collected samples; None if median difference or measured noise is within a limit."""
        usual_sigma_rad = max(self._stated_rad, self._usual_rad / math.sqrt(6.0), steps.error_rad)
        ratio = _MEDIAN_RATIO if self._usual_rad else _START_RATIO
        if not steps.median_sigma_rad >= ratio * usual_sigma_rad:
            return None
        measured = steps.measured_noise()
        return (
            self._start_excess(measured, steps.fastest2) if measured.sigma_rad() >= ratio * self._stated_rad else None
        )

    def _changed_excess(self, found: MeasuredNoise, steps: "_Steps") -> ExtraNoise | None:
        """Return the excess if it has changed or ended; None otherwise."""
        if steps.fastest2 > _OTHER**2 * self._fastest2:
            self._fastest2 = steps.fastest2
        recent = steps.since(int(steps.times_ns[-1]) - _SHORT_NS)
        over_short, over_long = recent.measured_noise(), steps.measured_noise()
        stated_rad, was_rad = self._stated_rad, found.sigma_rad(over_short.rate2)
        if over_short.sigma_rad() > _LARGER * max(was_rad, stated_rad):
            return self._start_excess(over_short, self._fastest2)
        if over_short.sigma_rad() <= _OVER_SHORT * stated_rad and was_rad >= 2.0 * _OVER_SHORT * stated_rad:
            return self._end_excess(found, int(steps.times_ns[-1]))
        if len(steps.times_ns) < _MORE_STEPS * found.steps and steps.times_ns[-1] - steps.times_ns[0] < _SETTLED_NS:
            return None
        was_rad = found.sigma_rad(over_long.rate2)
        if over_long.sigma_rad() <= _OVER_LONG * stated_rad and was_rad >= _WOULD_SHOW * stated_rad:
            return self._end_excess(found, int(steps.times_ns[-1]))
        is_other = not was_rad / _OTHER <= over_long.sigma_rad() <= _OTHER * was_rad
        is_of_other_kind = bool(over_long.jitter_s2) is not bool(found.jitter_s2)
        if was_rad >= _WOULD_SHOW * stated_rad and (is_other or is_of_other_kind):
            return self._start_excess(over_long, self._fastest2)
        return None

    def _start_excess(self, measured: MeasuredNoise, fastest2: float = 0.0) -> ExtraNoise:
        before, self.found, self._fastest2 = self.found, measured, fastest2
        self._sums.clear()
        # The covariance includes one standard deviation of the estimated variance.
        more = 1.0 + _ESTIMATED / math.sqrt(measured.steps)
        white_rad2 = max(more * measured.white_rad2 - self._stated_rad**2, 0.0)
        jitter_s2 = max(measured.jitter_s2, 0.0 if before is None else before.jitter_s2)
        clock_sigma_s = _DELAY_SIGMAS * math.sqrt(jitter_s2)
        return ExtraNoise(measured.first_ns, white_rad2, more * measured.jitter_s2, clock_sigma_s)

    def _end_excess(self, found: MeasuredNoise, time_ns: int) -> ExtraNoise:
        """End the excess; return an excess of zero from a stamp on. The true end differs by a second or two."""
        self.found = None
        self.reset()
        return ExtraNoise(time_ns, 0.0, 0.0, _DELAY_SIGMAS * math.sqrt(found.jitter_s2))


class _Steps(NamedTuple):
    """Steps from sample to sample.

    Attributes:
        times_ns: stamp at the end of each step, shape (n,).
        differences: attitudes minus previous attitudes propagated by the rates, horizon frame, rad, shape (n, 3).
        rates: angular rates, horizon frame, rad/s, shape (n, 3).
        error_rad: root mean square change of the integration error between steps, rad; smaller noise is not observable.
    """

    times_ns: NDArray[np.int64]
    differences: FloatArray
    rates: FloatArray
    error_rad: float

    @classmethod
    def from_samples(cls, collected: Collection[tuple[AttitudeSample, IntegratedAttitude]]) -> "_Steps":
        """Return the steps between samples with rates and integrated attitudes."""
        times_ns = np.array([sample.time_ns for sample, _ in collected])
        rotation_nd = np.array([sample.rotation_nd for sample, _ in collected])
        rates_d = np.array([sample.rate_d for sample, _ in collected])
        by_rates = np.array([integrated.rotation for _, integrated in collected])
        missed_rad = np.array([integrated.error_rad for _, integrated in collected])
        carried_nd = rotation_nd[:-1] @ by_rates[:-1].swapaxes(-1, -2) @ by_rates[1:]
        differences = log_rotation(rotation_nd[1:] @ carried_nd.swapaxes(-1, -2))
        missed = float(np.sqrt(np.mean(np.diff(missed_rad, n=2) ** 2)))
        return cls(times_ns[1:], differences, (rotation_nd[1:] @ rates_d[1:, :, None])[..., 0], missed)

    def since(self, since_ns: int) -> "_Steps":
        """Return the steps that end at or after a stamp, at least the last :data:`_LEAST_STEPS`."""
        first = min(int(np.searchsorted(self.times_ns, since_ns)), len(self.times_ns) - _LEAST_STEPS)
        return _Steps(self.times_ns[first:], self.differences[first:], self.rates[first:], self.error_rad)

    @property
    def fastest2(self) -> float:
        """Largest squared angular rate, (rad/s)²."""
        return float(np.max(np.sum(self.rates**2, axis=1)))

    @property
    def median_sigma_rad(self) -> float:
        """Noise of an attitude, each axis, from the median difference, rad."""
        return float(np.median(np.linalg.norm(self.differences, axis=1))) / _MEDIAN_OF_DIFFERENCE

    def measured_noise(self) -> MeasuredNoise:
        """Return the measured noise; differences that are outliers at their angular rate are left out."""
        differences, rate2 = self.differences, np.sum(self.rates**2, axis=1)
        axes = self.rates / np.sqrt(np.where(rate2 > 0.0, rate2, 1.0))[:, None]
        sizes = np.linalg.norm(differences, axis=1)
        along, along_before = np.sum(differences[1:] * axes[1:], axis=1), np.sum(differences[:-1] * axes[1:], axis=1)
        of_axis = 0.25 * along**2 - 0.5 * along * along_before
        of_all = 0.25 * sizes[1:] ** 2 - 0.5 * np.sum(differences[1:] * differences[:-1], axis=1)
        white_rad2, jitter_s2, rate2_after, count = self.median_sigma_rad**2, 0.0, rate2[1:], 1
        for farthest in _FARTHEST:
            near = sizes <= farthest * np.sqrt(2.0 * (white_rad2 + jitter_s2 * rate2))
            both = near[1:] & near[:-1]
            count = max(int(np.count_nonzero(both)), 1)
            white_rad2, jitter_s2 = max(float(np.sum(of_all[both])) / (3.0 * count), 0.0), 0.0
            across_rad2 = max(float(np.sum((of_all - of_axis)[both])) / (2.0 * count), 0.0)
            along_rad2 = float(np.sum(of_axis[both])) / count
            if along_rad2 > _ALONG_TURN * across_rad2:
                weights = rate2_after[both]
                jitter_s2 = float(weights @ (of_axis[both] - across_rad2)) / float(weights @ weights)
                white_rad2 = across_rad2
            if not jitter_s2 > 0.0:
                jitter_s2 = 0.0
        return MeasuredNoise(int(self.times_ns[0]), white_rad2, jitter_s2, float(np.mean(rate2)), count)

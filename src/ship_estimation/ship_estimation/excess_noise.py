"""Attitude noise of an INS beyond what is stated, measured against its own rates.

The attitude of a sample differs from the attitude before it, carried on by the rates, by the noise of both samples.
Such differences d of neighbouring steps give the noise variance of one attitude: the mean of d_k²/2 - d_k d_{k-1},
per axis, is twice that variance, and the noise of the rates cancels. Noise along the axis of turn alone is jitter of
the stamps; noise about all axes is that of the attitude itself, as coarse digits make it. At rest jitter does not show,
and nothing is reported.

A small excess shows in the samples that pass the step check. A large excess makes samples fail it: from the first such
sample on, and at the start, all samples are collected, rejected ones included, until the median difference tells noise
from a step. While there is an excess, samples are collected on, so that a change and the end of it are seen in seconds.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.integrated_rates import Integrated
from ship_geometry.attitude_track import AttitudeSample, ExtraNoise
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_geometry.time_scales import SECOND_NS

_LONG_NS, _MEMORY_NS, _SHORT_NS = 30 * SECOND_NS, 10 * SECOND_NS, 2 * SECOND_NS
"""A small excess is looked for in means over up to the first; once found, noise is averaged over up to the second; a
large excess, and its end, show within the third."""
_SETTLED_NS = _MEMORY_NS - SECOND_NS
"""Length of a mean over the second of these, at least."""
_LEAST_RATIO2 = 1.25**2
"""Smallest ratio of measured to stated variance that is reported."""
_ESTIMATED, _SIGMAS = 1.25, 6.0
"""Standard deviation of a variance estimated from N steps, times sqrt(N), as a share of it; the excess that is reported
is so many of them."""
_MEDIAN_RATIO, _START_RATIO = 2.0, 4.0
"""Ratio of the median difference to the usual one from which on rejected samples show noise and not a step; at the
start it is not known what is usual, and the rates may be noisy."""
_LARGER, _OTHER, _MORE_STEPS = 1.5, 1.25, 3
"""Ratio of standard deviations from which on a new estimate over the short time, or the long, replaces that in use; the
long one by that many times as many steps."""
_OVER_SHORT, _OVER_LONG, _WOULD_SHOW = 1.5, 1.2, 1.4
"""An excess is over where the noise has fallen below so many times the stated, over the short time or the long, and the
excess would show by twice the first, or by the third."""
_FIRST_NS, _EVERY_NS, _LEAST_STEPS = SECOND_NS // 2, SECOND_NS // 4, 10
"""Collected samples are evaluated after the first time, with so many steps at least, and then every so often."""
_MEDIAN_OF_DIFFERENCE = 1.538 * math.sqrt(2.0)
"""Median length of the difference of two samples with unit noise about each of three axes."""
_FARTHEST = (8.0, 5.0)
"""Differences beyond so many of their standard deviations are steps; first and second pass."""
_ALONG_TURN = 2.0
"""Noise is jitter where the variance along the axis of turn is so many times that across."""
_DELAY_SIGMAS = 2.0
"""Stamps that are late at random are late on average by up to so many standard deviations: 1.7 if uniform from zero."""


class NoiseSums(NamedTuple):
    """Noise that steps from sample to sample show.

    Attributes:
        first_ns: stamp of the first sample.
        last_ns: stamp of the last sample.
        steps: number of steps.
        variance_sum: sum of the noise variances that they show, each axis, rad².
    """

    first_ns: int
    last_ns: int
    steps: int
    variance_sum: float


class MeasuredNoise(NamedTuple):
    """Noise of the attitudes as measured.

    Attributes:
        first_ns: stamp of the first sample that shows it.
        white_rad2: variance about each axis that does not depend on the turn.
        jitter_s2: variance of the stamps.
        rate2: mean square of the rate of turn meanwhile, (rad/s)².
        steps: number of steps that show it.
    """

    first_ns: int
    white_rad2: float
    jitter_s2: float
    rate2: float
    steps: int

    def sigma_rad(self, rate2: float | None = None) -> float:
        """Standard deviation of an attitude about its worst axis, at the rate of turn meanwhile or at another one."""
        return math.sqrt(self.white_rad2 + self.jitter_s2 * (self.rate2 if rate2 is None else rate2))

    def text(self, stated_rad: float) -> str:
        """Measured against stated standard deviation, in words.

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
    """Return the noise that steps show.

    Args:
        times_ns: stamps of the samples, shape (n + 1,).
        differences: of each sample's attitude from that before it carried on by the rates, rad, shape (n, 3).
        longest_ns: in longer steps what the integration of the rates misses is no noise; they are left out.

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
    """Finds attitude noise beyond what is stated.

    Args:
        stated_rad: noise of an attitude, each axis.

    Attributes:
        found: noise that is in excess now; None where none is.

    >>> excess, noise = ExcessNoise(1e-5), np.random.default_rng(1).normal(0.0, 3e-5, (201, 3))
    >>> extra = excess.add(noise_sums(10_000_000 * np.arange(201), np.diff(noise, axis=0), longest_ns=2e7))
    >>> print(f"{excess.found.sigma_rad():.0e} {math.sqrt(extra.white_rad2):.1e}")
    3e-05 2.6e-05
    """

    def __init__(self, stated_rad: float) -> None:
        self.found: MeasuredNoise | None = None
        self._stated_rad = stated_rad
        self._sums: deque[NoiseSums] = deque()
        self._collected: deque[tuple[AttitudeSample, Integrated]] = deque()
        self._suspected_ns: int | None = None
        self._due_ns = 0
        self._usual_rad = self._fastest2 = 0.0

    def reconfigure(self, stated_rad: float) -> ExtraNoise | None:
        """Go on with another stated noise; return the excess over that, where there was one over the stated before."""
        changed, self._stated_rad = stated_rad != self._stated_rad, stated_rad
        found = self.found
        if found is None or not changed:
            return None
        newest_ns = self._collected[-1][0].time_ns if self._collected else found.first_ns
        if found.sigma_rad(self._fastest2) ** 2 >= _LEAST_RATIO2 * stated_rad**2:
            return self._use(found._replace(first_ns=newest_ns), self._fastest2)
        return self._end(found, newest_ns)

    def forget(self) -> None:
        """Forget what was measured: the rates have changed, or are not measured."""
        self._sums.clear()
        self._collected.clear()
        self._suspected_ns = None

    @property
    def collects(self) -> bool:
        """True while samples are collected: some failed the step check, or there is an excess."""
        return self._suspected_ns is not None or self.found is not None

    def suspect(self, time_ns: int, usual_rad: float) -> None:
        """Collect samples from now on: one failed the step check, or means of some showed a step.

        Args:
            time_ns: its stamp.
            usual_rad: root mean square of the differences met before.
        """
        if self._suspected_ns is None:
            self._usual_rad = usual_rad
        self._suspected_ns = time_ns

    @property
    def sigma_rad(self) -> float:
        """Noise of an attitude about its worst axis at the fastest turn since the excess began; stated without one."""
        if self.found is None:
            return self._stated_rad
        return max(self._stated_rad, self.found.sigma_rad(self._fastest2))

    def add(self, sums: NoiseSums) -> ExtraNoise | None:
        """Take noise of samples that passed the step check; return the excess where it is a new one."""
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
            if variance >= least_ratio2 * self._stated_rad**2:  # NaN is not
                return self._use(MeasuredNoise(recent[0].first_ns, variance, 0.0, 0.0, count))
        return None

    def observe(self, sample: AttitudeSample, integrated: Integrated, rates_proven: bool = True) -> ExtraNoise | None:
        """Collect a sample; return the excess where it is a new one.

        Args:
            sample: the sample, with a rate.
            integrated: attitude by the rates alone at its stamp.
            rates_proven: whether the rates are known to be right; before that there is no excess.
        """
        time_ns, collected = sample.time_ns, self._collected
        if self._suspected_ns is not None and time_ns - self._suspected_ns > _SHORT_NS:
            self._suspected_ns = None
        if not self.collects or (collected and collected[-1][1].run != integrated.run):
            collected.clear()
        if not self.collects:
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
        steps = self._steps()
        return self._first(steps) if self.found is None else self._changed(self.found, steps)

    def _first(self, steps: "_Steps") -> ExtraNoise | None:
        """Return the excess of the samples collected; None where their median difference is no larger than usual."""
        usual_sigma_rad = max(self._stated_rad, self._usual_rad / math.sqrt(6.0), steps.missed_rad)
        ratio = _MEDIAN_RATIO if self._usual_rad else _START_RATIO
        if not steps.median_sigma_rad >= ratio * usual_sigma_rad:
            return None
        measured = steps.measured()
        return self._use(measured, steps.fastest2) if measured.sigma_rad() >= ratio * self._stated_rad else None

    def _changed(self, found: MeasuredNoise, steps: "_Steps") -> ExtraNoise | None:
        """Return the excess where it has changed, or is over; None otherwise, or where it does not show."""
        if steps.fastest2 > _OTHER**2 * self._fastest2:
            self._fastest2 = steps.fastest2
        recent = steps.since(int(steps.times_ns[-1]) - _SHORT_NS)
        over_short, over_long = recent.measured(), steps.measured()
        stated_rad, was_rad = self._stated_rad, found.sigma_rad(over_short.rate2)
        if over_short.sigma_rad() > _LARGER * max(was_rad, stated_rad):
            return self._use(over_short, self._fastest2)
        if over_short.sigma_rad() <= _OVER_SHORT * stated_rad and was_rad >= 2.0 * _OVER_SHORT * stated_rad:
            return self._end(found, int(steps.times_ns[-1]))
        if len(steps.times_ns) < _MORE_STEPS * found.steps and steps.times_ns[-1] - steps.times_ns[0] < _SETTLED_NS:
            return None
        was_rad = found.sigma_rad(over_long.rate2)
        if over_long.sigma_rad() <= _OVER_LONG * stated_rad and was_rad >= _WOULD_SHOW * stated_rad:
            return self._end(found, int(steps.times_ns[-1]))
        is_other = not was_rad / _OTHER <= over_long.sigma_rad() <= _OTHER * was_rad
        is_of_other_kind = bool(over_long.jitter_s2) is not bool(found.jitter_s2)
        if was_rad >= _WOULD_SHOW * stated_rad and (is_other or is_of_other_kind):
            return self._use(over_long, self._fastest2)
        return None

    def _steps(self) -> "_Steps":
        samples = [sample for sample, _ in self._collected]
        return _Steps.between(
            np.array([sample.time_ns for sample in samples]),
            np.array([sample.rotation_nd for sample in samples]),
            np.array([integrated.rotation for _, integrated in self._collected]),
            np.array([sample.rate_d for sample in samples]),
            np.array([integrated.missed_rad for _, integrated in self._collected]),
        )

    def _use(self, measured: MeasuredNoise, fastest2: float = 0.0) -> ExtraNoise:
        before, self.found, self._fastest2 = self.found, measured, fastest2
        self._sums.clear()
        # A variance is known to a standard deviation of its own; the covariance counts with that.
        more = 1.0 + _ESTIMATED / math.sqrt(measured.steps)
        white_rad2 = max(more * measured.white_rad2 - self._stated_rad**2, 0.0)
        jitter_s2 = max(measured.jitter_s2, 0.0 if before is None else before.jitter_s2)
        clock_sigma_s = _DELAY_SIGMAS * math.sqrt(jitter_s2)
        return ExtraNoise(measured.first_ns, white_rad2, more * measured.jitter_s2, clock_sigma_s)

    def _end(self, found: MeasuredNoise, time_ns: int) -> ExtraNoise:
        """Return that there is no excess from a stamp on; when it ended before that is known to a second or two."""
        self.found = None
        self.forget()
        return ExtraNoise(time_ns, 0.0, 0.0, _DELAY_SIGMAS * math.sqrt(found.jitter_s2))


class _Steps(NamedTuple):
    """Steps from sample to sample.

    Attributes:
        times_ns: stamps of the samples that they lead to, shape (n,).
        differences: of their attitudes from those before, carried on by the rates, horizon frame, rad, shape (n, 3).
        rates: of turn, horizon frame, rad/s, shape (n, 3).
        missed_rad: how much more the integration of the rates may miss in a step than in the one before, root mean
            square: steps of unequal length hide noise.
    """

    times_ns: NDArray[np.int64]
    differences: FloatArray
    rates: FloatArray
    missed_rad: float

    @classmethod
    def between(
        cls,
        times_ns: NDArray[np.int64],
        rotation_nd: FloatArray,
        by_rates: FloatArray,
        rates_d: FloatArray,
        missed_rad: FloatArray,
    ) -> "_Steps":
        """The steps between samples, by their attitudes, those by the rates alone, the rates and what these miss."""
        carried_nd = rotation_nd[:-1] @ by_rates[:-1].swapaxes(-1, -2) @ by_rates[1:]
        differences = log_rotation(rotation_nd[1:] @ carried_nd.swapaxes(-1, -2))
        missed = float(np.sqrt(np.mean(np.diff(missed_rad, n=2) ** 2)))
        return cls(times_ns[1:], differences, (rotation_nd[1:] @ rates_d[1:, :, None])[..., 0], missed)

    def since(self, since_ns: int) -> "_Steps":
        """Those to samples from a stamp on, or the last ones where these are few."""
        first = min(int(np.searchsorted(self.times_ns, since_ns)), len(self.times_ns) - _LEAST_STEPS)
        return _Steps(self.times_ns[first:], self.differences[first:], self.rates[first:], self.missed_rad)

    @property
    def fastest2(self) -> float:
        """Largest square of the rate of turn, (rad/s)²."""
        return float(np.max(np.sum(self.rates**2, axis=1)))

    @property
    def median_sigma_rad(self) -> float:
        """Noise of an attitude, each axis, by the median difference."""
        return float(np.median(np.linalg.norm(self.differences, axis=1))) / _MEDIAN_OF_DIFFERENCE

    def measured(self) -> MeasuredNoise:
        """Return the noise, without steps that are far larger than most at their rate of turn."""
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

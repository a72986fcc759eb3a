"""Detection of steps of an INS attitude against its integrated rates.

Attitude and integrated rates of a healthy INS differ by a slowly drifting rotation. This rotation contains gyroscope
bias, integration error and, if the rates contain the Earth rate, the Earth rate. Over a second the rotation follows a
straight line. A step of the attitude leaves the line. A large step shows at the first sample. A smaller step shows in
the mean of several samples against the line before the step.
"""

import math
from typing import NamedTuple

import numpy as np

from ship_estimation.plausibility.excess_noise import NoiseSums, noise_sums
from ship_estimation.plausibility.integrated_rates import IntegratedAttitude, IntegratedRun
from ship_estimation.plausibility.line_steps import Period, StepPlan, doubling_counts, locate_step, step_plan
from ship_estimation.plausibility.predictions import PredictionMatch
from ship_estimation.plausibility.stuck_check import ROUNDING_SPREAD
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import FloatArray, exp_rotation, vector_length
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_kernels import compiled_checks, compiled_rotations

_BEFORE_S, _AFTER_S = (0.5, 0.25, 0.125), 0.2
"""Lengths of the line before the step, s (shorter for noisier rates), and maximum length after the step, s."""
_LEAST_BEFORE, _LONGEST_PERIOD_NS = 16, SECOND_NS // 5
"""Least number of samples before the step, and maximum period. Below 5 Hz wave motion hides small steps."""
_MISSING, _IRREGULAR = 1.8, 0.35
"""Interval, in periods, above which a sample is missing; standard deviation of the intervals, as a share of their mean,
above which stamps are irregular. One lost message in ten gives a share of 0.27. Stamps at 20 Hz that are late by 0 to
12 ms give a share of 0.1."""
_GAP = 8
"""Maximum gap that a line spans, periods."""
_SIGMAS = 7.3
"""Threshold of a step, sigmas. Noise of three axes exceeds the threshold once in 6e10 times
(explanation/input_checks.md)."""
_LAG_S = 0.0025
"""Maximum lag of the rates behind the attitude, s."""
_LEARN_HZ = 25.0
"""Rate at which the statistics of apparent steps are updated, 1/s."""
_FAR_RAD = 1e-3
"""Size up to which rotation vectors add like vectors, to a hundredth of an arcsecond."""
_ROOM = 4
"""Length of the sample buffer, in lengths of the line."""


class DetectedStep(NamedTuple):
    """A step of the attitude, detected by means before and after it.

    Attributes:
        first_ns: stamp of the first sample that may be after the step.
        last_ns: stamp of the first sample that is certainly after the step.
        step_n: rotation vector of the step in the horizon frame, rad, shape (3,).
        sigma_rad: standard deviation of the step about each axis.
    """

    first_ns: int
    last_ns: int
    step_n: FloatArray
    sigma_rad: float


class LineStatistics(NamedTuple):
    """Statistics of the errors of the samples on a line.

    Attributes:
        drift_n: drift of the attitude against the rates, horizon frame, rad/s, shape (3,).
        seconds: time over which the drift is measured, from the middle of the oldest part of the buffer to the middle
            of the newest part, s.
        turning: magnitude of the mean angular velocity of the deck over the buffer, rad/s.
        typical_rad: root mean square difference of a sample from its prediction by the previous sample.
    """

    drift_n: FloatArray
    seconds: float
    turning: float
    typical_rad: float


class LineUpdate(NamedTuple):
    """Results of accepting samples.

    Attributes:
        step: step of the attitude before the last sample; None without a step.
        noise: noise sums of the samples on the line; None without new sums.
        statistics: statistics of the samples on the line; None without new statistics.
    """

    step: DetectedStep | None = None
    noise: NoiseSums | None = None
    statistics: LineStatistics | None = None


class InsStepDetector:
    """Detector of steps of one INS attitude against its integrated rates.

    The period of the samples is estimated, and also the size of the apparent steps that sample errors cause. This size
    is the eighth root of the mean eighth power, so that rare large errors dominate, for example those due to rounding.

    Args:
        white_rad: noise of an attitude about each axis.
        rate_sigma_rad_per_s: noise of a rate about each axis.

    >>> watch, turned = InsStepDetector(5e-6, 0.0), np.random.default_rng(1).normal(0.0, 5e-6, (1500, 3))
    >>> turned[1400:] += [0.0, 3e-5, 0.0]
    >>> for n, vector in enumerate(turned):
    ...     sample = AttitudeSample(n * 10_000_000, exp_rotation(vector), np.zeros(3))
    ...     fits = watch.check(sample, IntegratedAttitude(np.eye(3), 0, 0.0), first_rad=1e-4, coarseness_rad=0.0)
    ...     update = watch.accept()
    ...     if update is not None and update.step is not None:
    ...         break
    >>> found = update.step
    >>> found.first_ns // 10_000_000, 1400 <= n < 1420, (found.step_n * 1e5).round() + 0.0
    (1400, True, array([0., 3., 0.]))
    """

    def __init__(self, white_rad: float, rate_sigma_rad_per_s: float) -> None:
        self._period = Period()
        self._white_rad, self._rate_sigma = white_rad, rate_sigma_rad_per_s
        self._rows, self._rates, self._times = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        self._full: StepPlan | None = None
        self._learn_every = self._learns = self._since_learnt = 0
        self._high = np.zeros(0)
        self._first_rad = math.inf
        self._coarseness_rad = self._error_rad = self._last_step_error_rad = self._apparent_step_rad = 0.0
        self._run, self._last_ns = -1, 0
        self._to_line: FloatArray | None = None
        self.restart()

    def reconfigure(self, white_rad: float, rate_sigma_rad_per_s: float) -> None:
        """Set the noise of attitudes and rates; a change restarts the line and its statistics."""
        if (white_rad, rate_sigma_rad_per_s) != (self._white_rad, self._rate_sigma):
            self._white_rad, self._rate_sigma = white_rad, rate_sigma_rad_per_s
            if self._period.ns:
                self._make_plan()

    def reset_statistics(self) -> None:
        """Reset the statistics of the samples and start a new line, because the rates or the noise have changed."""
        self._learns = 0
        self._high[:] = 0.0
        self.restart()

    def restart(self) -> None:
        """Start a new line with the next sample, for example after a step of the attitude or a gap."""
        self._end = self._newest = 0
        self._to_line = None
        self._plan: StepPlan | None = None
        self._is_ready = False
        self._pending: FloatArray | None = None
        self._sizes = np.zeros(0)

    @property
    def smallest_rad(self) -> float:
        """Smallest detectable step, rad; infinite if no step is detectable."""
        return math.inf if self._plan is None else float(self._bounds[-1])

    @property
    def least_rad(self) -> float:
        """Lower bound of the smallest detectable step of the present line, rad; infinite without a line."""
        return math.inf if self._plan is None else float(self._least_rad[-1])

    @property
    def is_ready(self) -> bool:
        """True if samples are checked against a line of full length."""
        return self._plan is not None and self._plan is self._full and self._is_ready

    def check(
        self,
        sample: AttitudeSample,
        integrated: IntegratedAttitude,
        first_rad: float,
        coarseness_rad: float,
    ) -> bool | None:
        """Return True if a sample is on the line of the accepted samples, False if not or for NaN, None if unknown.

        A sample also counts as on the line if the step was before it; then :meth:`accept` returns the step.

        Args:
            sample: sample with a rate, later than all accepted samples.
            integrated: attitude by integrated rates at the stamp of the sample.
            first_rad: bound of the distance of a good sample from the line, used until the statistics are known.
            coarseness_rad: resolution of the attitude; zero if every value is new.
        """
        self._pending, time_ns = None, sample.time_ns
        if self._full is None:
            if 0 < self._period.update(time_ns) <= _LONGEST_PERIOD_NS:
                self._make_plan()
            return None
        if integrated.run != self._run or time_ns - self._last_ns > _GAP * self._period.ns:
            self.restart()
            self._run, self._error_rad = integrated.run, integrated.error_rad
        if self._to_line is None:
            self._to_line = integrated.rotation.dot(sample.rotation_nd.T)
        missed_rad = integrated.error_rad - self._error_rad
        # A constant integration error per step is a slope of the line. A change of this error is an apparent step.
        feigned_rad = abs(missed_rad - self._last_step_error_rad)
        self._error_rad, self._last_step_error_rad = integrated.error_rad, missed_rad
        self._now_ns = time_ns
        self._first_rad, self._coarseness_rad = first_rad, coarseness_rad
        self._newest, self._rates[self._end] = self._end, sample.rate_d
        (row,) = compiled_rotations.differences(sample.rotation_nd[None], integrated.rotation[None], self._to_line)
        self._rows[self._end] = self._pending = row
        plan = self._plan
        if plan is None:
            return None
        if feigned_rad > self._apparent_step_rad:
            self._apparent_step_rad = 1.5 * feigned_rad
            self._set_bounds(plan)
        rows = self._rows[self._end + 1 - plan.length : self._end + 1]
        self._sizes = compiled_checks.step_sizes(self._scaled, rows)
        if not self._is_ready:
            return None
        # If several samples show a step better than this sample alone, the step was before this sample.
        own, *others = self._sizes.tolist()
        return bool(own <= 1.0 or max(others, default=0.0) > own)

    def match(self) -> PredictionMatch:
        """Return the match of the last checked sample with the line."""
        assert self._plan is not None
        step = self._plan.weights[0].dot(self._rows[self._end + 1 - self._plan.length : self._end + 1])
        return PredictionMatch(step, float(self._bounds[0]), bool(self._sizes[0] <= 1.0))

    def accept(self) -> LineUpdate | None:
        """Accept the last checked sample; return what it shows, usually None; a step starts a new line."""
        if self._pending is None:
            return None
        self._times[self._end] = self._last_ns = self._now_ns
        self._end, self._pending = self._end + 1, None
        plan = self._plan
        if (
            plan is not None
            and len(self._sizes)
            and not max(self._sizes.tolist()) <= 1.0
            and not self._is_explained_by_lag(plan)
        ):
            update = LineUpdate(self._detected_step())
            self.restart()
            return update
        self._since_learnt += 1
        learnt = self._learn() if self._since_learnt >= self._learn_every else None
        return self._shift() if self._end == len(self._rows) else learnt

    def accept_block(
        self,
        times_ns: StampArray,
        rotations_nd: FloatArray,
        rates_d: FloatArray,
        integrated: IntegratedRun,
        first_rad: float,
        coarseness_rad: float,
    ) -> tuple[int, LineUpdate | None]:
        """Accept the leading samples of a block that are on the line; return their number, and what they show.

        The result is the same as with :meth:`check` and :meth:`accept` for each sample. A first sample that is not
        accepted may be off the line or may start a new line; check it by these methods.

        Args:
            times_ns: stamps in ascending order, later than all accepted samples, shape (N,).
            rotations_nd: attitudes, shape (N, 3, 3).
            rates_d: angular velocities, rad/s, shape (N, 3).
            integrated: the attitudes by integrated rates.
            first_rad: as in :meth:`check`.
            coarseness_rad: as in :meth:`check`.
        """
        plan, end = self._plan, self._end
        if plan is None or self._to_line is None or not self.is_ready or integrated.run != self._run:
            return 0, None
        self._first_rad, self._coarseness_rad = first_rad, coarseness_rad
        some = slice(min(len(times_ns), len(self._rows) - end))
        count, sizes, *learnt = compiled_checks.accepted_on_line(
            times_ns[some],
            compiled_rotations.differences(rotations_nd[some], integrated.rotations[some], self._to_line),
            integrated.error_rad[some],
            end,
            self._last_ns,
            _GAP * self._period.ns,
            self._error_rad,
            self._last_step_error_rad,
            self._apparent_step_rad,
            plan.weights,
            self._least_rad,
            self._shares,
            ROUNDING_SPREAD * coarseness_rad,
            first_rad,
            self._learn_every,
            self._since_learnt,
            self._learns,
            self._rows,
            self._high,
            self._bounds,
            self._scaled,
        )
        if count == 0:
            return 0, None
        self._last_step_error_rad, self._apparent_step_rad, self._since_learnt, self._learns = learnt
        self._sizes, self._error_rad = sizes, float(integrated.error_rad[count - 1])
        self._rates[end : end + count], self._times[end : end + count] = rates_d[:count], times_ns[:count]
        self._end, self._newest, self._pending = end + count, end + count - 1, None
        self._last_ns = self._now_ns = int(times_ns[count - 1])
        return int(count), self._shift() if self._end == len(self._rows) else None

    def _is_explained_by_lag(self, plan: StepPlan) -> bool:
        """True if a small lag of the rates explains the apparent step, as at the start of a rotation."""
        steps = plan.weights.dot(self._rates[self._newest + 1 - plan.length : self._newest + 1])
        feigned_rad = _LAG_S * np.sqrt(np.sum(steps * steps, axis=1))
        return bool(np.all(np.sqrt(self._sizes) * self._bounds <= self._bounds + feigned_rad))

    # -- statistics -----------------------------------------------------------------------------------------

    def _make_plan(self) -> None:
        """Choose the length of the line by the period of the samples and their noise, and reset the statistics."""
        per_s = SECOND_NS / self._period.ns
        after = max(round(_AFTER_S * per_s), 1)
        lengths = {max(round(seconds * per_s), _LEAST_BEFORE) + after for seconds in _BEFORE_S}
        plans = [step_plan(length, doubling_counts(after)) for length in sorted(lengths)]
        self._full = min(plans, key=lambda plan: float(np.sum(self._sigmas(plan))))
        self._rows, self._rates = np.zeros((2, _ROOM * self._full.length, 3))
        self._times = np.zeros(len(self._rows), dtype=np.int64)
        self._learn_every = max(round(per_s / _LEARN_HZ), 1)
        self._high = np.zeros(len(self._full.counts))
        self.reset_statistics()

    def _learn(self) -> LineUpdate | None:
        """Update the statistics of apparent steps; change to a longer line if possible, and return its noise."""
        assert self._full is not None
        self._since_learnt, full, before = 0, self._full, self._plan
        if before is full:
            self._learns += 1
            compiled_checks.learn(self._sizes, self._bounds, self._learns, self._high)
            if self._learns % compiled_checks.SET_EVERY == 0 or not self._is_ready:
                self._apparent_step_rad *= compiled_checks.FORGET
                self._set_bounds(full)
            return None
        for share in (1, 2, 4):
            length = full.length // share
            if self._end >= length:
                if share == 1:
                    self._use_plan(full)
                    return LineUpdate(noise=self._noise()[0])
                after = tuple(count for count in full.counts if count <= length // 3)
                self._use_plan(step_plan(length, after or (1,)))
                break
        return None

    def _use_plan(self, plan: StepPlan) -> None:
        """Check samples with another plan from now on."""
        assert self._full is not None
        self._plan = plan
        self._least_rad = _SIGMAS * self._sigmas(plan)
        self._shares = plan.white / self._full.white[: len(plan.white)]
        self._bounds, self._scaled = np.empty(len(plan.white)), np.empty(plan.weights.shape)
        self._set_bounds(plan)

    def _set_bounds(self, plan: StepPlan) -> None:
        """Set the bounds of the apparent steps that the errors of good samples cause."""
        self._is_ready = compiled_checks.set_bounds(
            plan.weights,
            self._least_rad,
            self._shares,
            self._high,
            self._learns,
            ROUNDING_SPREAD * self._coarseness_rad,
            self._apparent_step_rad,
            self._first_rad,
            self._bounds,
            self._scaled,
        )

    def _sigmas(self, plan: StepPlan) -> FloatArray:
        """Return the sigma of each step of a plan due to noise of attitudes and rates, rad, shape (k,)."""
        turn_rad = self._rate_sigma * self._period.ns * 1e-9
        sigmas: FloatArray = np.hypot(self._white_rad * plan.white, turn_rad * plan.walk)
        return sigmas

    def _shift(self) -> LineUpdate:
        """Drop the older samples of the full buffer; return its noise and statistics.

        If the newest sample is more than ``_FAR_RAD`` from the origin of the line, this sample becomes the new origin.
        """
        assert self._full is not None
        keep, rows = self._full.length, self._rows
        seconds = float(self._times[-1] - self._times[0]) * 1e-9 * (1.0 - 1.0 / _ROOM)
        drift_n = (rows[-keep:].mean(axis=0) - rows[:keep].mean(axis=0)) / seconds
        noise, differences = self._noise()
        typical_rad = math.sqrt(float(np.mean(np.sum(differences**2, axis=1))))
        statistics = LineStatistics(drift_n, seconds, vector_length(self._rates.mean(axis=0)), typical_rad)
        for values in (rows, self._rates, self._times):
            values[:keep] = values[-keep:].copy()
        self._end = keep
        if vector_length(rows[keep - 1]) > _FAR_RAD:
            assert self._to_line is not None
            self._to_line = self._to_line.dot(exp_rotation(-rows[keep - 1]))
            rows[:keep] -= rows[keep - 1].copy()
        return LineUpdate(noise=noise, statistics=statistics)

    def _noise(self) -> tuple[NoiseSums | None, FloatArray]:
        """Return the noise sums of the accepted samples, and the differences of successive samples, rad, shape (n, 3).

        Samples at irregular times are not summed, because the integration error of the rates exceeds the noise there.
        """
        times_ns, differences = self._times[: self._end], np.diff(self._rows[: self._end], axis=0)
        steps_ns = np.diff(times_ns)
        if float(steps_ns.std()) <= _IRREGULAR * float(steps_ns.mean()):
            return noise_sums(times_ns, differences, _MISSING * self._period.ns), differences
        return None, differences

    def _detected_step(self) -> DetectedStep:
        """Return the step between the accepted samples, with the interval of stamps at which it may have happened."""
        assert self._plan is not None
        worst = max(range(len(self._sizes)), key=self._sizes.tolist().__getitem__)
        # Ratio of the observed errors of the samples to their stated noise.
        excess = float(self._bounds[worst]) / (_SIGMAS * float(self._sigmas(self._plan)[worst]))
        everywhere = step_plan(self._plan.length, tuple(range(1, self._plan.counts[-1] + 1)))
        sigmas_rad = excess * self._sigmas(everywhere)
        rows = self._rows[self._end - everywhere.length : self._end]
        step_n, sigma_rad, counts = locate_step(everywhere, rows, sigmas_rad)
        first_ns, last_ns = (int(self._times[self._end - count]) for count in (max(counts), min(counts)))
        return DetectedStep(first_ns, last_ns, step_n, sigma_rad)

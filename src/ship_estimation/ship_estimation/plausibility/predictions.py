"""Predictions of values from earlier values, with the check for jumps; for an INS by rates, motion or elapsed time.

Each value is compared with its prediction. :class:`PredictionBound` gives the largest difference of a good value.
:class:`JumpCheck` accepts a jump after a few rejected values that are consistent. :class:`InsPredictions` predicts the
samples of an INS.
"""

import enum
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ship_estimation.parameters.ship_devices import JUMP_SAMPLES
from ship_estimation.plausibility.integrated_rates import IntegratedAttitude
from ship_estimation.plausibility.stuck_check import ROUNDING_SPREAD, StuckCheck
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation, vector_length
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_kernels import compiled_checks

_SIGMAS = 7.0
"""Bound of a good difference, sigmas, so that at 100 Hz no good sample is rejected in a voyage."""
_TYPICAL = 6.0
"""Bound of a good difference, in units of the typical difference."""
_MEMORY = 100
"""Number of differences over which the typical difference is averaged."""
_LEARNING = 20
"""Number of differences before the typical difference is known; until then the bound is wider by ``_UNKNOWN_RAD``."""
_UNKNOWN_RAD = math.radians(0.1)
DRIFT_RAD_PER_S = 60.0 * ARCSEC
"""Bound of the drift of integrated rates against the attitude, rad/s, for Earth rate and gyroscope bias."""
_BOUND_SIGMAS = 3.0
"""Least ratio of the bound of a difference to the standard deviation of the difference."""
_LARGEST_ACCELERATION = math.radians(60.0)
"""Maximum angular acceleration of a hull, rad/s².

A small craft that rolls with an amplitude of 30° and a period of 5 s reaches 47°/s².
"""
FASTEST_RAD_PER_S = math.radians(60.0)
"""Maximum angular rate of a hull, rad/s.

This rate bounds the next attitude if neither rates nor continued motion predict the attitude.
"""
_LONGEST_STEP_S = 1.0
_PIECES, _LEARNT_RAD_PER_S, _FORGET = 12, 5.0 * ARCSEC, 0.95
"""Constants of the drift bound, which is the constant part plus twice the largest recent drift.

In order: number of drift measurements, each over a few seconds, in the running mean; constant part, rad/s; decay factor
of the largest recent drift at each measurement.
"""


class PredictionStep(NamedTuple):
    """The prediction of a value from an earlier value, and the uncertainty of the prediction.

    Attributes:
        seconds: time between the two values, s.
        samples: number of samples from the earlier to the later value, 1 for the next sample.
        uncertain_rad: error of the prediction due to accelerations or changes of the rate.
        noise_gain: variance of the difference per variance of a sample's noise.
        coarseness_rad: resolution of the source's values; zero if every value is new.
        drift_rad_per_s: bound of the drift of the prediction against the values.
    """

    seconds: float
    samples: int
    uncertain_rad: float
    noise_gain: float
    coarseness_rad: float
    drift_rad_per_s: float = DRIFT_RAD_PER_S


def step_by_motion(turned_s: float, seconds: float, max_acceleration: float, coarseness_rad: float) -> PredictionStep:
    """Return the prediction by continued motion between two earlier values.

    Args:
        turned_s: time between the two earlier values, s.
        seconds: time from the second earlier value to the predicted value, s.
        max_acceleration: maximum angular acceleration, rad/s².
        coarseness_rad: as in :class:`PredictionStep`.

    Example:
        The earlier values are one second apart; one second later the value is predicted, for accelerations up to 2°/s²:

        >>> step = step_by_motion(1.0, 1.0, math.radians(2.0), coarseness_rad=0.0)
        >>> print(f"{math.degrees(step.uncertain_rad):.1f} deg, noise gain {step.noise_gain:.0f}")
        2.0 deg, noise gain 6
    """
    ratio = seconds / turned_s
    uncertain_rad = 0.5 * max_acceleration * seconds * (seconds + turned_s)
    return PredictionStep(seconds, 1, uncertain_rad, 1.0 + (1.0 + ratio) ** 2 + ratio**2, coarseness_rad)


class PredictionMatch(NamedTuple):
    """A value compared with its prediction from an earlier value.

    Attributes:
        difference: value minus prediction, rad, shape (n,).
        bound_rad: bound of the difference.
        fits: True if the difference is within the bound; false for NaN.
        is_predicted: False if the value cannot be predicted; only the elapsed time limits the difference then.
    """

    difference: FloatArray
    bound_rad: float
    fits: bool
    is_predicted: bool = True

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the difference about each axis, derived from the bound."""
        return self.bound_rad / _BOUND_SIGMAS

    def is_consistent_with(self, step: "PredictionMatch") -> bool:
        """True if the value is consistent with the last accepted value although values between were rejected.

        The bound of this prediction grows with the time since the accepted value. If the value is consistent with the
        rejected value before it, the bound is therefore at most the bound of ``step``.

        Args:
            step: the same value compared with its prediction from the value before it, accepted or not.
        """
        limit_rad = step.bound_rad if step.fits else math.inf
        return vector_length(self.difference) <= min(self.bound_rad, limit_rad)


class PredictionBound:
    """Bound of the difference between a value and its prediction.

    The noise is the configured noise or, if larger, the noise of the differences so far, which contain rounding, rate
    noise and integration errors.

    Attributes:
        sigma_rad: noise of a value about its worst axis.
        typical_rad: root mean square difference of a value from its prediction by the value before; zero before enough
            differences are known.
        noise_rad: bound of such a difference due to noise; infinite before enough differences are known.

    >>> next_sample = PredictionStep(seconds=0.01, samples=1, uncertain_rad=0.0, noise_gain=2.0, coarseness_rad=0.0)
    >>> match = PredictionBound(sigma_rad=ARCSEC).match(np.array([0.0, 0.001, 0.0]), next_sample)
    >>> match.fits, round(match.bound_rad, 5)
    (True, 0.0018)
    """

    def __init__(self, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self.reset()

    def reset(self) -> None:
        """Reset the statistics of the differences."""
        self.typical_rad = self._mean_square = 0.0
        self.noise_rad = math.inf
        self._count = 0

    def match(self, difference: FloatArray, step: PredictionStep, led: bool = True) -> PredictionMatch:
        """Return the match of a difference with the bound of a step; ``led`` is False if the value is not predicted."""
        gain = math.sqrt(step.noise_gain)
        noise = max(_SIGMAS * gain * self.sigma_rad, _TYPICAL * self.typical_rad)
        more = self.typical_rad * math.sqrt(step.samples - 1)
        unknown = _UNKNOWN_RAD if self._count < _LEARNING else 0.0
        coarse = ROUNDING_SPREAD * math.sqrt(0.5) * gain * step.coarseness_rad
        bound_rad = noise + more + unknown + coarse + step.uncertain_rad + step.drift_rad_per_s * step.seconds
        return PredictionMatch(difference, bound_rad, vector_length(difference) <= bound_rad, led)

    def set_typical(self, typical_rad: float) -> None:
        """Set the typical difference, estimated from many values."""
        self._mean_square, self._count = typical_rad**2, _MEMORY
        self._set_typical()

    def learn(self, difference: FloatArray) -> None:
        """Add the difference of an accepted value from its prediction over one sample to the statistics."""
        self._count = min(self._count + 1, _MEMORY)
        self._mean_square += (vector_length(difference) ** 2 - self._mean_square) / self._count
        if self._count >= _LEARNING:
            self._set_typical()

    def _set_typical(self) -> None:
        self.typical_rad = math.sqrt(self._mean_square)
        self.noise_rad = max(_SIGMAS * math.sqrt(2.0) * self.sigma_rad, _TYPICAL * self.typical_rad)


class JumpDecision(enum.Enum):
    """Decision about a value."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    JUMPED = "jumped"


class JumpCheck:
    """Check that rejects values inconsistent with the last accepted value, until a jump is accepted.

    Args:
        samples: number of rejected, mutually consistent values after which the next consistent value is accepted.

    Attributes:
        rejected_count: number of successive values that were rejected and are mutually consistent.
        since_ns: stamp of the first of these values.

    >>> check = JumpCheck(samples=2)
    >>> [check.check(n, continues=False, is_consistent=n > 0).value for n in range(3)]
    ['rejected', 'rejected', 'jumped']
    """

    def __init__(self, samples: int = JUMP_SAMPLES) -> None:
        self.samples = samples
        self.rejected_count = 0
        self.since_ns = 0

    def check(self, time_ns: int, continues: bool, is_consistent: bool) -> JumpDecision:
        """Return the decision about a value.

        Args:
            time_ns: stamp of the value.
            continues: True if the value matches the prediction from the last accepted value.
            is_consistent: True if the value matches the prediction from the value before, accepted or not.
        """
        if continues:
            self.rejected_count = 0
            return JumpDecision.ACCEPTED
        if self.rejected_count >= self.samples and is_consistent:
            self.rejected_count = 0
            return JumpDecision.JUMPED
        self.rejected_count = self.rejected_count + 1 if is_consistent else 1
        if self.rejected_count == 1:
            self.since_ns = time_ns
        return JumpDecision.REJECTED


class NumberedSample(NamedTuple):
    """A sample with its number and the attitude by integrated rates.

    Attributes:
        sample: the sample itself.
        number: number of the sample among all samples.
        before: earlier sample that defines the motion at ``sample``; None if the motion is unknown.
        integrated: attitude by integrated rates at the stamp of the sample; None if the sample has no rate.
    """

    sample: AttitudeSample
    number: int
    before: AttitudeSample | None
    integrated: IntegratedAttitude | None


class RateDrift:
    """Estimate of the constant error of the rates.

    The gyroscope bias is constant in the deck frame. If the rates contain the Earth rate, the Earth rate is the larger
    part of the error and is constant in the horizon frame.

    Attributes:
        has_earth_rate: True if the rates contain the Earth rate.
        bound_rad_per_s: bound of the remaining error.

    >>> drift = RateDrift()
    >>> print(drift.update(drift_n=np.array([0.0, 1e-5, 0.0]), rotation_nd=np.eye(3)))
    [ 0.e+00 -1.e-05  0.e+00]
    """

    def __init__(self) -> None:
        self.has_earth_rate = False
        self.bound_rad_per_s = DRIFT_RAD_PER_S
        self._drift, self._pieces, self._largest = np.zeros(3), 0, 0.0

    def update(self, drift_n: FloatArray, rotation_nd: FloatArray) -> FloatArray:
        """Update the estimate; return the current error of the rates in the deck frame, rad/s, shape (3,).

        Args:
            drift_n: measured drift of the attitude against the rates after subtraction of the present estimate, horizon
                frame, rad/s, shape (3,).
            rotation_nd: current attitude, shape (3, 3).
        """
        self._pieces += 1
        # The attitude drifts against the rates by the negative of the rate error.
        self._drift = self._drift - (drift_n if self.has_earth_rate else drift_n @ rotation_nd) / min(
            self._pieces, _PIECES
        )
        self._largest = max(vector_length(drift_n), _FORGET * self._largest)
        if self._pieces >= _PIECES:
            self.bound_rad_per_s = min(_LEARNT_RAD_PER_S + 2.0 * self._largest, DRIFT_RAD_PER_S)
        drift_d: FloatArray = self._drift @ rotation_nd if self.has_earth_rate else self._drift
        return drift_d


class InsPredictions:
    """Comparison of samples with their predictions, and estimated bounds of the differences.

    Args:
        stuck: stuck check, which estimates the resolution of the attitude.

    Attributes:
        rate_bound: bound of the difference from a prediction by rates.
        motion_bound: bound of the difference from a prediction by continued motion.
        drift: constant error of the rates.
        reported_step_rad: size of a possible step at the newest sample, as reported by the source itself, rad.

    >>> predictions = InsPredictions(StuckCheck())
    >>> turns = [exp_rotation(np.array([0.0, 1e-4 * n, 0.0])) for n in (0, 1, 2, 50)]
    >>> samples = [AttitudeSample(n * 10_000_000, turn) for n, turn in enumerate(turns)]
    >>> seen = [NumberedSample(sample, n, samples[n - 1], None) for n, sample in enumerate(samples)]

    >>> matches = [predictions.match(one, end, rates_measured=False) for one, end in zip(seen[1:], seen[2:])]
    >>> [round(vector_length(match.difference), 4) for match in matches]
    [0.0, 0.0047]
    """

    def __init__(self, stuck: StuckCheck) -> None:
        self.rate_bound, self.motion_bound, self.drift = PredictionBound(0.0), PredictionBound(0.0), RateDrift()
        self.reported_step_rad = 0.0
        self._stuck_check = stuck

    def match(self, start: NumberedSample, end: NumberedSample, rates_measured: bool) -> PredictionMatch:
        """Compare two samples by the rates between them or, without measured rates in one run, by continued motion."""
        if rates_measured and are_in_one_run(start.integrated, end.integrated):
            return self.match_by_rates(start, end)
        return self.match_by_motion(start, end)

    def match_by_rates(self, start: NumberedSample, end: NumberedSample) -> PredictionMatch:
        """Compare two samples of one run by the integrated rates between them."""
        assert start.integrated is not None
        assert end.integrated is not None
        predicted_nd = start.sample.rotation_nd @ start.integrated.rotation.T @ end.integrated.rotation
        missed_rad = end.integrated.error_rad - start.integrated.error_rad
        step = self._step(seconds_between(start.sample, end.sample), missed_rad, end.number - start.number)
        return self.rate_bound.match(log_rotation(end.sample.rotation_nd @ predicted_nd.T), step)

    def match_by_motion(self, start: NumberedSample, end: NumberedSample) -> PredictionMatch:
        """Compare two samples by continued motion; if motion is unknown or intervals exceed 1 s, by elapsed time."""
        seconds, before = seconds_between(start.sample, end.sample), start.before
        turned_s = 0.0 if before is None else seconds_between(before, start.sample)
        if before is None or max(seconds, turned_s) > _LONGEST_STEP_S:
            return self.match_by_time(start.sample, end.sample)
        turn_d = seconds / turned_s * log_rotation(before.rotation_nd.T @ start.sample.rotation_nd)
        difference_n = log_rotation(end.sample.rotation_nd @ (start.sample.rotation_nd @ exp_rotation(turn_d)).T)
        step = step_by_motion(turned_s, seconds, _LARGEST_ACCELERATION, self._stuck_check.coarseness_rad)
        return self.motion_bound.match(difference_n, step)

    def match_by_two_rates(self, start: AttitudeSample, end: AttitudeSample, rates_measured: bool) -> PredictionMatch:
        """Compare two samples by their two rates; without measured rates or over more than 1 s, by elapsed time."""
        seconds = seconds_between(start, end)
        if not rates_measured or start.rate_d is None or end.rate_d is None or seconds > _LONGEST_STEP_S:
            return self.match_by_time(start, end)
        predicted_nd = start.rotation_nd @ exp_rotation((0.5 * seconds) * (start.rate_d + end.rate_d))
        step = self._step(seconds, compiled_checks.mean_rate_error(start.rate_d, end.rate_d, seconds))
        return self.rate_bound.match(log_rotation(end.rotation_nd @ predicted_nd.T), step)

    def are_rates_faulty_between(self, start: NumberedSample, end: NumberedSample, step: PredictionMatch) -> bool:
        """True if two samples are consistent, and the rates of the rejected samples between them are faulty.

        Args:
            start: the last accepted sample.
            end: a later sample.
            step: match of ``end`` with the rejected sample before it.
        """
        direct = self.match_by_two_rates(start.sample, end.sample, rates_measured=True)
        by_all = self.match(start, end, rates_measured=True)
        difference_rad = vector_length(by_all.difference - direct.difference)
        return direct.is_predicted and difference_rad > 2.0 * direct.bound_rad and direct.is_consistent_with(step)

    def match_by_time(self, start: AttitudeSample, end: AttitudeSample) -> PredictionMatch:
        """Compare two samples by the fastest rotation of a hull in the elapsed time."""
        seconds = seconds_between(start, end)
        step = self._step(seconds, FASTEST_RAD_PER_S * seconds)
        return self.motion_bound.match(log_rotation(end.rotation_nd @ start.rotation_nd.T), step, led=False)

    def _step(self, seconds: float, uncertain_rad: float, samples: int = 1) -> PredictionStep:
        uncertain_rad += self.reported_step_rad
        return PredictionStep(
            seconds, samples, uncertain_rad, 2.0, self._stuck_check.coarseness_rad, self.drift.bound_rad_per_s
        )


def extrapolate_back(sample: AttitudeSample, accepted: NumberedSample) -> AttitudeSample | None:
    """Return the attitude at the time of the last accepted sample, extrapolated back from a new sample.

    The motion is assumed to be the same as before the last accepted sample; None if this motion is unknown. The sample
    after ``sample`` is predicted from the result and ``sample``, so that a jump before ``sample`` is not taken as
    motion.

    Example:
        >>> still, turned = (AttitudeSample(n, exp_rotation(np.array([0.0, 0.1 * n, 0.0]))) for n in (1, 3))
        >>> before = AttitudeSample(0, exp_rotation(np.array([0.0, 0.05, 0.0])))
        >>> print(log_rotation(extrapolate_back(turned, NumberedSample(still, 1, before, None)).rotation_nd).round(6))
        [0.  0.2 0. ]
    """
    if accepted.before is None:
        return None
    ratio = seconds_between(accepted.sample, sample) / seconds_between(accepted.before, accepted.sample)
    turn_d = ratio * log_rotation(accepted.before.rotation_nd.T @ accepted.sample.rotation_nd)
    return replace(accepted.sample, rotation_nd=sample.rotation_nd @ exp_rotation(-turn_d))


def are_in_one_run(first: IntegratedAttitude | None, second: IntegratedAttitude | None) -> bool:
    """True if two attitudes by integrated rates belong to one unbroken run of rates.

    Example:
        >>> are_in_one_run(IntegratedAttitude(np.eye(3), 1, 0.0), None)
        False
    """
    return first is not None and second is not None and first.run == second.run


def seconds_between(first: AttitudeSample, second: AttitudeSample) -> float:
    """Return the time from one sample to another, s.

    Example:
        >>> seconds_between(AttitudeSample(0, np.eye(3)), AttitudeSample(500_000_000, np.eye(3)))
        0.5
    """
    return (second.time_ns - first.time_ns) * 1e-9

"""Two checks for any stream of values, one for a repeated value (frozen source) and one for a jump.

**Frozen source.** A frozen sensor repeats one value to the last bit, and so does a healthy sensor with coarse
resolution while there is little motion. Other sources, the motion references, distinguish the two sensors by the
rotation of the ship. A healthy sensor repeats a value only while the rotation is below its estimated resolution.

**Jump.** Each value is compared with its prediction from earlier values. :class:`PredictionBound` gives the largest
difference of a good value. :class:`JumpCheck` accepts a jump after a few rejected values that are consistent.
"""

import enum
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_estimation.parameters.ship_devices import JUMP_SAMPLES
from ship_estimation.plausibility.motion_check import HISTORY_NS, MotionCheck, MotionReference
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_kernels import compiled_checks

ROUNDING_SPREAD = 1.8
"""Bound of the error of a difference due to rounding to unit steps in three axes, a little more than sqrt(3)."""


def vector_length(vector: FloatArray) -> float:
    """Return the length of a vector of a few components, five times as fast as the norm of an array.

    Example:
        >>> vector_length(np.array([3.0, 4.0, 0.0]))
        5.0
    """
    return math.hypot(*vector.tolist())


_LEAST_NS = 500_000_000
"""Least time for which a value is repeated before it counts as frozen, ns; drivers occasionally repeat values."""
_UNKNOWN_RESOLUTION = np.deg2rad(0.1)
"""Resolution assumed before the value has changed, rad."""
_STEPS = 64
"""Number of the last changes of the value; the smallest of them is the resolution."""


StuckValue = tuple[FloatArray, float, str]
"""Value that must not stay constant, the largest standard deviation of its noise, rad, and a text for a rejection."""


def largest_sigma(covariance: FloatArray) -> float:
    """Return the largest standard deviation of a covariance's axes.

    Example:
        >>> largest_sigma(np.diag([1.0, 4.0, 9.0]))
        3.0
    """
    return math.sqrt(max(covariance.diagonal().tolist()))


class StuckCheck:
    """Detects a source that repeats one value while other sources show motion.

    A source is stuck if a value has been repeated for half a second and a motion reference has rotated meanwhile by
    more than five sigma (of both sources) beyond the resolution of the source. The next different value is accepted. If
    exactly the stuck value returns within two seconds, the source is still stuck.

    Attributes:
        is_repeated: True if the last value is equal to the value before.
        coarseness_rad: resolution of the source's values, rad; zero if every value is new.

    >>> guard = StuckCheck()
    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> references = [MotionReference(n * 300_000_000, turned if n else np.eye(3), ARCSEC) for n in range(3)]

    >>> [guard.observe(one.time_ns, np.eye(3), ARCSEC, {"another": one}) for one in references]
    [False, False, True]
    """

    def __init__(self) -> None:
        self._current: _RepeatedValue | None = None
        self._former: _RepeatedValue | None = None
        self._left_ns = 0
        self._steps: deque[float] = deque(maxlen=_STEPS)
        self._repeated: deque[bool] = deque(maxlen=_STEPS)
        self._resolution_rad = self.coarseness_rad = float(_UNKNOWN_RESOLUTION)
        self.is_repeated = False

    def is_frozen(self, value: FloatArray) -> bool:
        """True if the source is stuck at this value."""
        return self._current is not None and self._current.is_stuck and _is_equal(value, self._current.value)

    def observe(
        self, time_ns: int, value: FloatArray, sigma_rad: float, motion_references: Mapping[str, MotionReference]
    ) -> bool:
        """Check the next value of the source; return True if the source is stuck.

        Args:
            time_ns: stamp of the value.
            value: an attitude, shape (3, 3), directions of stars, shape (k, 3), or angles, shape (2,).
            sigma_rad: noise of the value about its worst axis.
            motion_references: attitude by each other source at about the time of the value, by name of the source.
        """
        current = self._current
        if current is not None and _is_equal(value, current.value):
            current.repeats += 1
        else:
            current = self._start_value(time_ns, value, motion_references)
        self.is_repeated = current.repeats > 0
        if self.is_repeated:
            if current.motion_check is None:
                current.motion_check = MotionCheck(current.since_ns, current.first_references)
            turned = current.motion_check.has_turned(
                motion_references, sigma_rad, ROUNDING_SPREAD * self._resolution_rad
            )
            current.is_stuck = current.is_stuck or (turned and time_ns - current.since_ns >= _LEAST_NS)
        return current.is_stuck

    def count_new_values(self, first_ns: int, values: FloatArray) -> int:
        """Return the number of leading values that need no check, because no value is a repetition.

        Args:
            first_ns: stamp of the first value.
            values: attitudes as in :meth:`observe`, shape (N, 3, 3).
        """
        current = self._current
        if current is None or current.is_stuck or current.repeats or not self._steps or any(self._repeated):
            return 0
        if self._former is not None and first_ns - self._left_ns <= HISTORY_NS:
            return 0
        new = (np.diff(values, axis=0, prepend=current.value[None]) != 0.0).any(axis=(1, 2))
        return len(new) if new.all() else int(np.argmin(new))

    def accept_new_values(
        self, time_ns: int, values: FloatArray, motion_references: Mapping[str, MotionReference]
    ) -> None:
        """Accept values without repetition, as counted by :meth:`count_new_values`.

        Args:
            time_ns: stamp of the last value.
            values: attitudes, shape (N, 3, 3), N at least 1.
            motion_references: as in :meth:`observe`, at the last value.
        """
        assert self._current is not None
        newest = values[-_STEPS:]
        before = values[-_STEPS - 1] if len(values) > _STEPS else self._current.value
        self._learn(before, newest)
        self._repeated.extend([False] * min(len(values), _STEPS))
        self.coarseness_rad, self.is_repeated = 0.0, False
        self._current = _RepeatedValue(values[-1], time_ns, dict(motion_references))

    def _start_value(
        self, time_ns: int, value: FloatArray, motion_references: Mapping[str, MotionReference]
    ) -> "_RepeatedValue":
        """Start a value that differs from the value before, either a new value or the frozen value again."""
        before, former = self._current, self._former
        if former is not None and time_ns - self._left_ns <= HISTORY_NS and _is_equal(value, former.value):
            self._current, self._former = former, None
            return former
        if before is not None:
            if before.is_stuck:
                self._former, self._left_ns = before, time_ns
            else:
                self._repeated.append(before.repeats > 0)
                if before.value.shape == value.shape:
                    self._learn(np.atleast_2d(before.value), value.reshape(1, -1, value.shape[-1]))
                self.coarseness_rad = self._resolution_rad if any(self._repeated) or not self._steps else 0.0
        self._current = _RepeatedValue(value, time_ns, dict(motion_references))
        return self._current

    def _learn(self, before: FloatArray, values: FloatArray) -> None:
        """Estimate the resolution from changes of values, shape (N, k, l), after the value ``before``, shape (k, l)."""
        # The change of a rotation is the largest change of an axis. The change of directions is the largest change of a
        # star.
        self._steps.extend(filter(math.isfinite, compiled_checks.changes(before, values)))
        if self._steps:
            self._resolution_rad = min(self._steps)


@dataclass
class _RepeatedValue:
    """A value, the stamp since which the source repeats it, and the motion references at that stamp."""

    value: FloatArray
    since_ns: int
    first_references: Mapping[str, MotionReference]
    repeats: int = 0
    is_stuck: bool = False
    motion_check: MotionCheck | None = None


def _is_equal(value: FloatArray, other: FloatArray) -> bool:
    """True if two values, not empty, are equal to the bit; the first numbers are compared first, for speed."""
    return bool(value.item(0) == other.item(0)) and np.array_equal(value, other)


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

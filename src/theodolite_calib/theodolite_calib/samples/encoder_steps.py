"""Detection of encoder steps: from one reading to the next the angles change by an offset, and move on as before.

A reading is predicted by a cubic through the readings before it, which a rotating or roll-compensating mount follows. A
prediction error far outside its estimated noise is a pending step, which the error of the next reading resolves. If
both errors are equal, the encoders have slipped, or the mount has moved and stopped between two readings. If the second
error is larger, a motion has begun or ended. If the second error is small, one reading was wrong.
"""

import math
from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ship_estimation.plausibility.value_checks import ROUNDING_SPREAD
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_tracks

_FIT_READINGS = 12
"""Maximum number of readings in the fit of a cubic."""
_MIN_READINGS = 7
"""Minimum number of readings in the fit of a cubic."""
_DETECTION_SIGMAS = 6.5
"""Threshold of a pending step in standard deviations; at fifty readings a second at most one false step in some hours
exceeds it."""
_LOWER_BOUND_SIGMAS = 3.0
_NOISE_READINGS = 200
"""Number of readings over which the noise is averaged."""
_WARM_UP_READINGS = 50
"""Number of readings after which the noise is known; no step is detected before."""
_MAX_NOISE_RATIO = 3.0
"""Limit to which prediction errors are reduced in the noise estimate, in multiples of the noise."""
_MIN_PERSISTENCE, _MAX_PERSISTENCE = 0.5, 1.25
"""Least and greatest ratio of the second prediction error to the first for a step. If a motion has begun, the ratio is
at least 1.5."""

_FULL_TURN = 2.0 * np.pi


class EncoderStep(NamedTuple):
    """Step of the encoders.

    Attributes:
        time_ns: time just before the first reading after the step.
        step: step of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each component.
        lower_bound_rad: lower bound of the larger component, three standard deviations below the smaller of the two
            prediction errors, rad.
        interval_s: interval between the readings before and after the step.
    """

    time_ns: int
    step: FloatArray
    sigma_rad: float
    lower_bound_rad: float
    interval_s: float


class _PredictionError(NamedTuple):
    """Prediction error of a reading relative to the cubic.

    Attributes:
        time_ns: stamp of the reading.
        error: error of azimuth and elevation, rad, shape (2,).
        gain: sigma of each component per sigma of a reading.
        sigma_rad: standard deviation of each component due to noise, rad.
        bound_rad: bound of the error without a step, rad.
    """

    time_ns: int
    error: FloatArray
    gain: float
    sigma_rad: float
    bound_rad: float

    @property
    def exceeds_bound(self) -> bool:
        """True if the error exceeds its bound, which makes it a pending step."""
        azimuth, elevation = self.error.tolist()
        return not (abs(azimuth) <= self.bound_rad and abs(elevation) <= self.bound_rad)


class EncoderStepDetector:
    """Step detector for the readings of one run, in the order of their stamps."""

    def __init__(self) -> None:
        self._previous: deque[tuple[int, FloatArray]] = deque(maxlen=_FIT_READINGS)
        self._pending_step: tuple[_PredictionError, FloatArray] | None = None
        self._variance, self._count = 0.0, 0

    @property
    def pending_step_rad(self) -> float:
        """Prediction error of the last reading if it is a pending step, rad; else 0."""
        return 0.0 if self._pending_step is None else math.hypot(*self._pending_step[0].error)

    def restart(self) -> None:
        """Restart the prediction with the next reading; the noise estimate is kept."""
        self._previous.clear()
        self._pending_step = None

    def observe(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float, max_gap_ns: int = SECOND_NS
    ) -> EncoderStep | None:
        """Add the next reading; return the pending step if this reading confirms it, else None.

        Args:
            time_ns: stamp of the reading.
            angles: azimuth and elevation, rad, shape (2,).
            sigma_rad: stated noise of each angle.
            coarseness_rad: resolution of the readings; 0 if no reading repeats the one before.
            max_gap_ns: maximum interval between readings that are compared.
        """
        if self._previous:
            before_ns, before = self._previous[-1]
            if time_ns - before_ns > max_gap_ns:
                self.restart()
            angles = before + wrap_angles(angles - before)
        prediction_error = self._prediction_error(time_ns, angles, sigma_rad, coarseness_rad)
        first, self._pending_step = self._pending_step, None
        if first is not None:
            assert prediction_error is not None  # predicted from the same readings as the first error
            return self._resolve_step(*first, prediction_error, angles)
        if prediction_error is not None and self._count >= _WARM_UP_READINGS and prediction_error.exceeds_bound:
            self._pending_step = prediction_error, angles
            return None
        if prediction_error is not None:
            self._update_noise(prediction_error)
        self._previous.append((time_ns, angles))
        return None

    def _prediction_error(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float
    ) -> _PredictionError | None:
        """Return the prediction error of a reading; None if there are too few readings before it."""
        if len(self._previous) < _MIN_READINGS:
            return None
        weights, gain = _weights_at_zero(tuple([before_ns - time_ns for before_ns, _ in self._previous]))
        predicted = weights @ np.array([before.tolist() for _, before in self._previous])
        noise_rad = max(sigma_rad, math.sqrt(self._variance))
        bound_rad = gain * (_DETECTION_SIGMAS * noise_rad + ROUNDING_SPREAD * math.sqrt(0.5) * coarseness_rad)
        return _PredictionError(time_ns, angles - predicted, gain, gain * noise_rad, bound_rad)

    def _resolve_step(
        self, first: _PredictionError, angles: FloatArray, prediction_error: _PredictionError, now: FloatArray
    ) -> EncoderStep | None:
        """Resolve a pending step at the reading ``angles`` by the next reading, ``now``."""
        axis = int(np.argmax(np.abs(first.error)))
        ratio, before_ns = prediction_error.error[axis] / first.error[axis], self._previous[-1][0]
        if ratio > _MIN_PERSISTENCE:
            # The readings before the change do not predict the readings after it.
            self._previous.clear()
            self._previous.append((first.time_ns, angles))
        self._previous.append((prediction_error.time_ns, now))
        if not _MIN_PERSISTENCE < ratio < _MAX_PERSISTENCE:
            return None
        lower_bound_rad = (
            min(abs(first.error[axis]), abs(prediction_error.error[axis])) - _LOWER_BOUND_SIGMAS * first.sigma_rad
        )
        within_s = (first.time_ns - before_ns) / SECOND_NS
        return EncoderStep(first.time_ns - 1, first.error, first.sigma_rad, lower_bound_rad, within_s)

    def _update_noise(self, prediction_error: _PredictionError) -> None:
        """Update the estimated noise of a reading, each axis, with a prediction error."""
        self._count = min(self._count + 1, _NOISE_READINGS)
        one = 0.5 * float(prediction_error.error @ prediction_error.error) / prediction_error.gain**2
        if self._count > _WARM_UP_READINGS:
            one = min(one, _MAX_NOISE_RATIO**2 * self._variance)
        self._variance += (one - self._variance) / self._count


@lru_cache(maxsize=64)
def _weights_at_zero(since_ns: tuple[int, ...]) -> tuple[FloatArray, float]:
    """Return the weights of earlier values in the least-squares prediction at zero, and the gain of its error.

    The gain is the standard deviation of value minus prediction per standard deviation of a value.
    """
    seconds = np.array(since_ns) / SECOND_NS
    weights = compiled_tracks.weights_at_zero(seconds / np.max(np.abs(seconds)))
    return weights, math.sqrt(1.0 + weights @ weights)


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles wrapped to at most half a turn, rad."""
    wrapped: FloatArray = angles - _FULL_TURN * np.rint(angles / _FULL_TURN)
    return wrapped

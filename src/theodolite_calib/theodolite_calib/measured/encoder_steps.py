"""Detection of encoder steps: from one reading to the next the encoders are elsewhere, and move on as before.

A reading is predicted by a cubic through the readings before it, which a rotating or roll-compensating mount follows. A
prediction error far outside its noise, which is estimated, is a pending step. The next reading decides. If its error
equals that of the reading before, the encoders have slipped, or the mount has moved and stopped between two readings.
If it is larger, a motion has begun or ended. If it is small, one reading was wrong.
"""

import math
from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ship_estimation.value_guards import ROUNDING_SPREAD
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.measured import compiled_cubics

_FITTED = 12
"""Number of readings in the cubic."""
_LEAST = 7
"""Minimum number of readings in the cubic."""
_DETECTION_SIGMAS = 6.5
"""Threshold of a pending step in standard deviations: at fifty readings a second at most one false one in some
hours."""
_SURE_SIGMAS = 3.0
_MEMORY = 200
"""Number of readings over which the noise is averaged."""
_LEARNING = 50
"""Number of readings before the noise is known and steps are detected."""
_LARGEST_SHARE = 3.0
"""Maximum prediction error that enters the noise estimate, in multiples of the noise."""
_GONE, _GOES_ON = 0.5, 1.25
"""Least and greatest ratio of the second prediction error to the first for a step. A motion that begins after the
reading before the last gives at least 1.5."""

_FULL_TURN = 2.0 * np.pi


class EncoderStep(NamedTuple):
    """Step of the encoders.

    Attributes:
        time_ns: just before the first reading after it.
        step: step of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each of the two.
        sure_rad: lower bound of the step about the larger axis, three standard deviations, rad.
        within_s: interval between the readings before and after it.
    """

    time_ns: int
    step: FloatArray
    sigma_rad: float
    sure_rad: float
    within_s: float


class _Off(NamedTuple):
    """Prediction error of a reading against the cubic.

    Attributes:
        time_ns: stamp of the reading.
        by: error of azimuth and elevation, rad, shape (2,).
        gain: sigma of each per sigma of one reading.
        sigma_rad: standard deviation of each by noise.
        bound_rad: bound for a valid reading.
    """

    time_ns: int
    by: FloatArray
    gain: float
    sigma_rad: float
    bound_rad: float

    @property
    def far(self) -> bool:
        """True if the error exceeds its bound: a pending step."""
        azimuth, elevation = self.by.tolist()
        return not (abs(azimuth) <= self.bound_rad and abs(elevation) <= self.bound_rad)


class EncoderSteps:
    """Step detector for the readings of one run, in the order of their stamps."""

    def __init__(self) -> None:
        self._before: deque[tuple[int, FloatArray]] = deque(maxlen=_FITTED)
        self._pending_step: tuple[_Off, FloatArray] | None = None
        self._variance, self._count = 0.0, 0

    @property
    def off_rad(self) -> float:
        """Prediction error of the last reading if it is a pending step, rad; else 0."""
        return 0.0 if self._pending_step is None else math.hypot(*self._pending_step[0].by)

    def restart(self) -> None:
        """Restart the prediction with the next reading; the noise estimate is kept."""
        self._before.clear()
        self._pending_step = None

    def observe(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float, longest_ns: int = SECOND_NS
    ) -> EncoderStep | None:
        """Add the next reading; return the step that it proves, or None.

        Args:
            time_ns: its stamp.
            angles: azimuth and elevation, rad, shape (2,).
            sigma_rad: stated noise of each.
            coarseness_rad: resolution of the printed values; 0 if every value is new.
            longest_ns: maximum interval between readings that are compared.
        """
        if self._before:
            before_ns, before = self._before[-1]
            if time_ns - before_ns > longest_ns:
                self.restart()
            angles = before + short_way(angles - before)
        off = self._off(time_ns, angles, sigma_rad, coarseness_rad)
        first, self._pending_step = self._pending_step, None
        if first is not None:
            assert off is not None  # by the same readings as the first
            return self._resolve_step(*first, off, angles)
        if off is not None and self._count >= _LEARNING and off.far:
            self._pending_step = off, angles
            return None
        if off is not None:
            self._learn(off)
        self._before.append((time_ns, angles))
        return None

    def _off(self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float) -> _Off | None:
        """Return the prediction error of a reading; None if there are too few readings before it."""
        if len(self._before) < _LEAST:
            return None
        weights, gain = _weights_at_zero(tuple([before_ns - time_ns for before_ns, _ in self._before]))
        led = weights @ np.array([before.tolist() for _, before in self._before])
        noise_rad = max(sigma_rad, math.sqrt(self._variance))
        bound_rad = gain * (_DETECTION_SIGMAS * noise_rad + ROUNDING_SPREAD * math.sqrt(0.5) * coarseness_rad)
        return _Off(time_ns, angles - led, gain, gain * noise_rad, bound_rad)

    def _resolve_step(self, first: _Off, angles: FloatArray, off: _Off, now: FloatArray) -> EncoderStep | None:
        """Resolve a pending step by the reading after it; the readings are ``angles`` and ``now``."""
        axis = int(np.argmax(np.abs(first.by)))
        share, before_ns = off.by[axis] / first.by[axis], self._before[-1][0]
        if share > _GONE:
            # The readings before the change do not predict the following ones.
            self._before.clear()
            self._before.append((first.time_ns, angles))
        self._before.append((off.time_ns, now))
        if not _GONE < share < _GOES_ON:
            return None
        sure_rad = min(abs(first.by[axis]), abs(off.by[axis])) - _SURE_SIGMAS * first.sigma_rad
        within_s = (first.time_ns - before_ns) / SECOND_NS
        return EncoderStep(first.time_ns - 1, first.by, first.sigma_rad, sure_rad, within_s)

    def _learn(self, off: _Off) -> None:
        """Update the noise estimate of one reading of one axis with a prediction error."""
        self._count = min(self._count + 1, _MEMORY)
        one = 0.5 * float(off.by @ off.by) / off.gain**2
        if self._count > _LEARNING:
            one = min(one, _LARGEST_SHARE**2 * self._variance)
        self._variance += (one - self._variance) / self._count


@lru_cache(maxsize=64)
def _weights_at_zero(since_ns: tuple[int, ...]) -> tuple[FloatArray, float]:
    """Return the least-squares weights of values at some times in the value at zero of the cubic through them.

    The second result is the standard deviation of a further value relative to that one, per standard deviation of a
    value.
    """
    seconds = np.array(since_ns) / SECOND_NS
    weights = compiled_cubics.weights_at_zero(seconds / np.max(np.abs(seconds)))
    return weights, math.sqrt(1.0 + weights @ weights)


def short_way(angles: FloatArray) -> FloatArray:
    """Return angles wrapped to half a turn."""
    wrapped: FloatArray = angles - _FULL_TURN * np.rint(angles / _FULL_TURN)
    return wrapped

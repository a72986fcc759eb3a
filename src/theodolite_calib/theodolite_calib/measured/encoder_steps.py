"""Steps of the encoders in place: from one reading to the next they are elsewhere, and move on as before.

A reading is predicted from a cubic through those before it: a mount that turns, or takes out the ship's roll, makes no
step. What is far outside the noise of such predictions, which is learnt, is a step at first sight. The next reading
tells what it was. Where it is as far from the cubic as the one before, the encoders have slipped, or the mount has
moved and stopped between two readings. Where it is farther off, a motion has begun or ended. Where it is back, one
reading was wrong.
"""

import math
from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ship_estimation.value_guards import ACROSS
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.measured import compiled_cubics

_FITTED = 12
"""A cubic is laid through so many readings."""
_LEAST = 7
"""Through fewer none is laid."""
_SIGMAS = 6.5
"""At fifty readings a second, good ones must not be suspected more than once in some hours."""
_SURE_SIGMAS = 3.0
_MEMORY = 200
"""The noise is a mean over about so many readings."""
_LEARNING = 50
"""Before so many readings the noise is not known, and no step is told."""
_LARGEST_SHARE = 3.0
"""A prediction that is off by more than so many times the noise is learnt as off by that much."""
_GONE, _GOES_ON = 0.5, 1.25
"""After a step in place the next reading is off by so many times as much as the first, at least and at most. The least
that a motion can do that begins after the reading before the last is one and a half times."""

_FULL_TURN = 2.0 * np.pi


class EncoderStep(NamedTuple):
    """A step in place.

    Attributes:
        time_ns: just before the first reading after it.
        step: of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each of the two.
        sure_rad: by so much at least, about the worse axis, with three sigmas.
        within_s: time between the readings before and after it.
    """

    time_ns: int
    step: FloatArray
    sigma_rad: float
    sure_rad: float
    within_s: float


class _Off(NamedTuple):
    """How far a reading is from the cubic.

    Attributes:
        time_ns: stamp of the reading.
        by: azimuth and elevation, rad, shape (2,).
        gain: sigma of each per sigma of one reading.
        sigma_rad: of each, by noise.
        bound_rad: by so much a good reading may be off.
    """

    time_ns: int
    by: FloatArray
    gain: float
    sigma_rad: float
    bound_rad: float

    @property
    def far(self) -> bool:
        """Whether it is a step at first sight."""
        azimuth, elevation = self.by.tolist()
        return not (abs(azimuth) <= self.bound_rad and abs(elevation) <= self.bound_rad)


class EncoderSteps:
    """Watches the readings of one run in the order of their stamps."""

    def __init__(self) -> None:
        self._before: deque[tuple[int, FloatArray]] = deque(maxlen=_FITTED)
        self._first: tuple[_Off, FloatArray] | None = None
        self._variance, self._count = 0.0, 0

    @property
    def off_rad(self) -> float:
        """How far the last reading is off where it is a step at first sight, which the next will tell; else 0."""
        return 0.0 if self._first is None else math.hypot(*self._first[0].by)

    def restart(self) -> None:
        """Readings that come now do not go on from those before; the noise stays known."""
        self._before.clear()
        self._first = None

    def observe(
        self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float, longest_ns: int = SECOND_NS
    ) -> EncoderStep | None:
        """Take the next reading; the step that it has proven, if it has.

        Args:
            time_ns: its stamp.
            angles: azimuth and elevation, rad, shape (2,).
            sigma_rad: stated noise of each.
            coarseness_rad: steps in which they are printed; 0 where every value is new.
            longest_ns: readings further apart are not compared.
        """
        if self._before:
            before_ns, before = self._before[-1]
            if time_ns - before_ns > longest_ns:
                self.restart()
            angles = before + short_way(angles - before)
        off = self._off(time_ns, angles, sigma_rad, coarseness_rad)
        first, self._first = self._first, None
        if first is not None:
            assert off is not None  # by the same readings as the first
            return self._told(*first, off, angles)
        if off is not None and self._count >= _LEARNING and off.far:
            self._first = off, angles
            return None
        if off is not None:
            self._learn(off)
        self._before.append((time_ns, angles))
        return None

    def _off(self, time_ns: int, angles: FloatArray, sigma_rad: float, coarseness_rad: float) -> _Off | None:
        """How far a reading is from the cubic; None where there is none."""
        if len(self._before) < _LEAST:
            return None
        weights, gain = _weights(tuple([before_ns - time_ns for before_ns, _ in self._before]))
        led = weights @ np.array([before.tolist() for _, before in self._before])
        noise_rad = max(sigma_rad, math.sqrt(self._variance))
        bound_rad = gain * (_SIGMAS * noise_rad + ACROSS * math.sqrt(0.5) * coarseness_rad)
        return _Off(time_ns, angles - led, gain, gain * noise_rad, bound_rad)

    def _told(self, first: _Off, angles: FloatArray, off: _Off, now: FloatArray) -> EncoderStep | None:
        """What the reading after a step at first sight says of it; the readings are ``angles`` and ``now``."""
        axis = int(np.argmax(np.abs(first.by)))
        share, before_ns = off.by[axis] / first.by[axis], self._before[-1][0]
        if share > _GONE:
            # What went before leads no further.
            self._before.clear()
            self._before.append((first.time_ns, angles))
        self._before.append((off.time_ns, now))
        if not _GONE < share < _GOES_ON:
            return None
        sure_rad = min(abs(first.by[axis]), abs(off.by[axis])) - _SURE_SIGMAS * first.sigma_rad
        within_s = (first.time_ns - before_ns) / SECOND_NS
        return EncoderStep(first.time_ns - 1, first.by, first.sigma_rad, sure_rad, within_s)

    def _learn(self, off: _Off) -> None:
        """Learn the noise of one reading of one axis from a prediction."""
        self._count = min(self._count + 1, _MEMORY)
        one = 0.5 * float(off.by @ off.by) / off.gain**2
        if self._count > _LEARNING:
            one = min(one, _LARGEST_SHARE**2 * self._variance)
        self._variance += (one - self._variance) / self._count


@lru_cache(maxsize=64)
def _weights(since_ns: tuple[int, ...]) -> tuple[FloatArray, float]:
    """Weights of values at some moments in the value at zero of the cubic through them, by least squares.

    The second is the sigma of a further value's distance from that one, per sigma of a value.
    """
    seconds = np.array(since_ns) / SECOND_NS
    weights = compiled_cubics.weights_at_zero(seconds / np.max(np.abs(seconds)))
    return weights, math.sqrt(1.0 + weights @ weights)


def short_way(angles: FloatArray) -> FloatArray:
    """Angles the short way round."""
    wrapped: FloatArray = angles - _FULL_TURN * np.rint(angles / _FULL_TURN)
    return wrapped

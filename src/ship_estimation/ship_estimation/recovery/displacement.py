"""Displacement of sources: has a source that contradicted the others moved back?

Each measurement of a source is compared with a remembered state, carried on by the INS. Their separation is a rotation
vector. It changes slowly, by the drift of the INS, and at once where a source or the INS moves. Only what changes at
once is summed: an INS that drifts by as much as the contradiction does not end it.
"""

from typing import NamedTuple

import numpy as np

from ship_estimation.chi_square import value_above
from ship_geometry.rotations import FloatArray

_FALSE_STEP = 5.733e-7
"""Probability that a second of a source at rest is taken for a step: that of 5 sigma of one normal variable."""
_SETTLING = 2
"""Seconds after a step in which the rest of it is summed, whatever its size."""
_LEFT_SHARE = 0.2
"""A source has moved back where no more than this share of its largest displacement is left."""
_DECISIVE_SIGMAS = 5.0
"""The remembered state decides where a source has moved back by so many of its standard deviations."""


class Separation(NamedTuple):
    """A measurement of a source against a remembered state.

    Attributes:
        turn: measured minus predicted, rotation vector or its components that are observed, rad, shape (k,).
        noise: covariance of the measurement's own noise, rad², shape (k, k).
        expected: covariance of ``turn`` by the remembered state carried to the time of the measurement, without that
            noise, rad², shape (k, k).
        drift: growth of ``expected`` in one second, rad²/s, shape (k, k).
    """

    turn: FloatArray
    noise: FloatArray
    expected: FloatArray
    drift: FloatArray


class _Second(NamedTuple):
    """The mean of a source's separations over about a second, with its covariance."""

    turn: FloatArray
    noise: FloatArray


class Displacement:
    """What has changed at once in the separation of one source.

    Attributes:
        turn: sum of the changes that are left, rad, shape (k,).
        largest_rad: the largest length that this sum had.

    Example:
        A source moves by 60″ about Up and back while the INS drifts by 30″ in between:

        >>> from ship_geometry.rotations import ARCSEC
        >>> source, up, noise = Displacement(), np.array([0.0, ARCSEC, 0.0]), (2.0 * ARCSEC) ** 2 * np.eye(3)
        >>> for second in range(100):
        ...     moved = 60.0 if 20 <= second < 80 else 0.0
        ...     source.add(Separation((moved + 0.3 * second) * up, noise, noise, 0.1 * noise))
        ...     source.end_second()
        ...     if second in (10, 50, 99):
        ...         print(source.is_displaced)
        False
        True
        False
    """

    def __init__(self) -> None:
        self._pending: list[Separation] = []
        self._held: _Second | None = None
        self._level: FloatArray | None = None
        self._covariance = np.empty((0, 0))
        self._settling = 0
        self._newest: Separation | None = None
        self._newest_turn = np.zeros(0)
        self.turn = np.zeros(0)
        self.largest_rad = 0.0

    def add(self, separation: Separation) -> None:
        """Take a measurement."""
        self._pending.append(separation)

    def inflate(self, covariance: FloatArray) -> None:
        """Allow for a jump of the INS that was detected by itself, rad², shape (k, k)."""
        if self._level is not None and self._covariance.shape == covariance.shape:
            self._covariance = self._covariance + covariance

    def end_second(self) -> None:
        """Compare the measurements of the last second with those before."""
        if not self._pending:
            if self._level is not None and self._newest is not None:
                self._covariance = self._covariance + self._newest.drift
            return
        newest, count = self._pending[-1], len(self._pending)
        turn = np.mean([one.turn for one in self._pending], axis=0)
        noise = np.mean([one.noise for one in self._pending], axis=0) / count
        self._pending.clear()
        self._newest, self._newest_turn = newest, turn
        if self._level is None:
            self._level, self._covariance = np.zeros_like(turn), newest.expected
            self.turn = np.zeros_like(turn)
        self._covariance = self._covariance + newest.drift
        step, covariance = turn - self._level, self._covariance + noise
        # Written so that NaN is no step: it says nothing of the source.
        is_step = float(step @ np.linalg.solve(covariance, step)) > value_above(_FALSE_STEP, len(step))
        if is_step or self._settling:
            self._settling = _SETTLING if is_step else self._settling - 1
            self.turn = self.turn + step
            self.largest_rad = max(self.largest_rad, float(np.linalg.norm(self.turn)))
            self._level, self._covariance, self._held = turn, noise + newest.drift, None
            return
        if self._held is not None:
            # A second late: one in which a step begins must not become a part of what is compared with.
            gain = self._covariance @ np.linalg.inv(self._covariance + self._held.noise)
            self._level = self._level + gain @ (self._held.turn - self._level)
            self._covariance = (np.eye(len(turn)) - gain) @ self._covariance
        self._held = _Second(turn, noise)

    @property
    def is_displaced(self) -> bool:
        """True if the source contradicted the others and has not moved back."""
        left_rad = _LEFT_SHARE * self.largest_rad
        if not self.largest_rad or float(np.linalg.norm(self.turn)) <= left_rad:
            return False
        assert self._newest is not None
        sigma_rad = float(np.sqrt(np.max(np.linalg.eigvalsh(self._newest.expected))))
        is_decisive = self.largest_rad - left_rad >= _DECISIVE_SIGMAS * sigma_rad
        return not (is_decisive and float(np.linalg.norm(self._newest_turn)) <= left_rad)

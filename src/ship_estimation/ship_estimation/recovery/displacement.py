"""Displacement of a source, or of several together: has what contradicted the others moved back?

Each measurement is compared with a remembered state, carried on by the INS. Their residual is a rotation vector. It
changes slowly, by the drift of the INS, and at once where a source or the INS moves. Only what changes at once is
displacement: an INS that drifts by as much as the contradiction does not end it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ship_estimation.chi_square import value_above
from ship_geometry.rotations import FloatArray

_FALSE_STEP = 5.733e-7
"""Probability that a second of a source at rest is taken for a step: that of 5 sigma of one normal variable."""
_AT_REST = 0.001
"""Probability that a source that is back is found to be displaced by its noise alone."""
_LEFT_SHARE, _MOST_LEFT_SHARE = 0.2, 0.5
"""A source has moved back where no more than the first share of its largest displacement is left; or no more than the
second, where its measurements do not show the displacement more precisely."""
_DECISIVE_SIGMAS = 5.0
"""The remembered state shows by itself that a source is back if a displacement is so many standard deviations of it."""
_STEP_LASTS = 4
"""Seconds from the beginning of a step in which all changes belong to it; the drift is small in this time."""


class MemoryResidual(NamedTuple):
    """A measurement of a source against a remembered state.

    Attributes:
        turn: measured minus predicted, rotation vector or those of its components that are observed, rad, shape (k,).
        noise: covariance of the measurement's own noise, rad², shape (k, k).
        expected: covariance of ``turn`` by the remembered state propagated to the time of the measurement, without that
            noise, rad², shape (k, k).
        drift: growth of ``expected`` in one second, rad²/s, shape (k, k).
    """

    turn: FloatArray
    noise: FloatArray
    expected: FloatArray
    drift: FloatArray


class Displacement:
    """The displacement of a source, or of several together: how far their residual has changed by steps.

    Example:
        A source moves by 60″ about Up and back while the INS drifts by 30″ in between:

        >>> from ship_geometry.rotations import ARCSEC
        >>> source, up, noise = Displacement(), np.array([0.0, ARCSEC, 0.0]), (2.0 * ARCSEC) ** 2 * np.eye(3)
        >>> for second in range(100):
        ...     moved = 60.0 if 20 <= second < 80 else 0.0
        ...     source.add(MemoryResidual((moved + 0.3 * second) * up, noise, noise, 0.1 * noise))
        ...     source.end_second()
        ...     if second in (10, 50, 99):
        ...         print(source.is_displaced)
        False
        True
        False
    """

    def __init__(self) -> None:
        self._pending: list[MemoryResidual] = []
        # The residual now, the part of it that is no displacement, the displacement now and before the last step;
        # covariances of the first and the third.
        self._level = self._at_rest = self._displaced = self._before = np.zeros(0)
        self._covariance = self._displaced_covariance = np.zeros((0, 0))
        # What is there at the beginning may be displaced already.
        self._since_step, self._is_clear = 0, False
        self._held: tuple[FloatArray, FloatArray] | None = None
        self._newest: MemoryResidual | None = None
        self._largest = np.zeros(0)

    @property
    def largest_rad(self) -> float:
        """Length of the largest displacement, or change of it, rad."""
        return float(np.linalg.norm(self._largest))

    def add(self, residual: MemoryResidual) -> None:
        """Take a measurement; one that is no number shows nothing."""
        if all(np.all(np.isfinite(part)) for part in residual):
            self._pending.append(residual)

    def inflate(self, covariance: FloatArray) -> None:
        """Allow for a jump of the INS that its own rates showed in this second, rad², shape (k, k).

        The measurements of this second are from before and after it: they are left out. A displacement that is no
        larger may have been that of the INS: it is forgotten.
        """
        self._pending.clear()
        if self._newest is None:
            return
        self._absorb_held()
        self._covariance = self._covariance + covariance
        self._displaced_covariance = self._displaced_covariance + covariance
        if self.largest_rad and _square(self._displaced, self._displaced_covariance) <= self._within_noise:
            self._at_rest, self._displaced = self._level, np.zeros_like(self._level)
            self._largest, self._displaced_covariance = self._displaced, np.zeros_like(covariance)
            # What the jump changes from now on is none either.
            self._is_clear, self._since_step = False, _STEP_LASTS

    def end_second(self) -> None:
        """Compare the measurements of the last second with those before."""
        if self._newest is not None:
            self._covariance = self._covariance + self._newest.drift
        if not self._pending:
            return
        newest = _mean(self._pending)
        turn, noise = newest.turn, newest.noise
        self._pending.clear()
        if self._newest is None:
            self._level = self._at_rest = self._displaced = self._before = self._largest = np.zeros_like(turn)
            self._covariance = self._displaced_covariance = newest.expected
        self._newest = newest
        if _square(turn - self._level, self._covariance + noise) > value_above(_FALSE_STEP, len(turn)):
            if self._since_step >= _STEP_LASTS:
                self._since_step, self._before = 0, self._displaced
                self._displaced_covariance = self._displaced_covariance + self._covariance
            self._level, self._covariance, self._held = turn, noise, None
        else:
            self._absorb_held()
            self._held = turn, noise
        self._sum_up(newest)

    def _absorb_held(self) -> None:
        """Update the level with the second before this one: it must not contain one in which a step begins."""
        if self._held is None:
            return
        turn, noise = self._held
        gain = self._covariance @ np.linalg.inv(self._covariance + noise)
        self._level = self._level + gain @ (turn - self._level)
        self._covariance = (np.eye(len(turn)) - gain) @ self._covariance
        self._held = None

    def _sum_up(self, newest: MemoryResidual) -> None:
        """Take the change of the level for displacement where a step is under way, for drift otherwise."""
        if self._since_step >= _STEP_LASTS:
            self._at_rest = self._level - self._displaced
            return
        self._since_step += 1
        self._displaced = self._level - self._at_rest
        for moved in (self._displaced, self._displaced - self._before):
            if _square(moved, newest.noise) > _square(self._largest, newest.noise):
                self._largest = moved
        of_both = self._displaced_covariance + self._covariance
        self._is_clear = self._is_clear or _square(self._displaced, of_both) > self._within_noise
        if self._since_step == _STEP_LASTS and self._is_clear:
            drift = _STEP_LASTS * newest.drift
            self._displaced_covariance = self._displaced_covariance + self._covariance + drift

    @property
    def is_displaced(self) -> bool:
        """True if the source has moved by a step and not back."""
        newest = self._newest
        if newest is None or not self._is_clear:
            return False
        largest, left = _square(self._largest, newest.noise), _square(self._displaced, newest.noise)
        if left <= _LEFT_SHARE**2 * largest:
            return False
        is_small = left <= _MOST_LEFT_SHARE**2 * largest and self._since_step >= _STEP_LASTS
        return not (is_small and _square(self._displaced, self._displaced_covariance) <= self._within_noise)

    def has_not_moved_as(self, other: "Displacement") -> bool:
        """True if the displacement of another source would have been a step of this one, and was none."""
        if self._newest is None or self.is_displaced:
            return False
        covariance = self._covariance + self._newest.noise + other._covariance + other._displaced_covariance
        return _square(other._displaced - self._displaced, covariance) > value_above(_FALSE_STEP, len(self._level))

    @property
    def _within_noise(self) -> float:
        """Squared length, in standard deviations, up to which a displacement is that of noise."""
        return value_above(_AT_REST, len(self._largest))

    @property
    def is_beyond_memory(self) -> bool:
        """True if the remembered state, carried on until now, is too vague to show a displacement of this size."""
        newest = self._newest
        if newest is None or not self.largest_rad:
            return False
        # The share of the largest displacement that a residual shows, by least squares.
        to_share = np.linalg.solve(newest.noise, self._largest) / _square(self._largest, newest.noise)
        sigma = float(np.sqrt(to_share @ (newest.expected + self._covariance) @ to_share))
        return not _DECISIVE_SIGMAS * sigma <= 1.0 - _LEFT_SHARE


def _mean(residuals: Sequence[MemoryResidual]) -> MemoryResidual:
    """Return the mean of residuals, weighted by their noise; what is remembered is common to them."""
    weights = [np.linalg.inv(one.noise) for one in residuals]
    noise = np.linalg.inv(sum(weights))
    turn = noise @ sum(weight @ one.turn for weight, one in zip(weights, residuals, strict=True))
    expected, drift = (np.mean([one[part] for one in residuals], axis=0) for part in (2, 3))
    return MemoryResidual(turn, noise, expected, drift)


def _square(turn: FloatArray, covariance: FloatArray) -> float:
    """Return a turn's squared length in its standard deviations."""
    return float(turn @ np.linalg.solve(covariance, turn))

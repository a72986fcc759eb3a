"""Displacement of each source and of all sources together, to find out whether a source has moved and moved back.

Each measurement is compared with a stored state, propagated by the INS. The residual is a rotation vector. The residual
changes slowly due to the drift of the INS, and in a step if a source or the INS moves. Only steps count as
displacement, so an inconsistency does not end if only a drift of the INS compensates it.

A source moves if its measured attitude changes by a step, whatever the cause. A rotation that all sources have in
common is measured by their weighted mean, because one star sensor measures a rotation about its line of sight poorly. A
source that moves by itself changes that mean, too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ship_estimation.innovations.gates import value_above
from ship_estimation.kalman.kalman_filter import LinearMeasurement, innovation, update
from ship_geometry.rotations import FloatArray

_FALSE_STEP = 5.733e-7
"""Probability of a false step in one second of a source at rest, as for 5 sigma of one normal variable."""
_BY_NOISE = 0.001
"""Probability that a source that has moved back still counts as displaced, due to its noise."""
_LEFT_SHARE, _MOST_LEFT_SHARE = 0.2, 0.5
"""Maximum shares of the largest displacement that may remain when a source has moved back: the first in any case, the
second if noise explains the remaining displacement and no step is recent."""
_DECISIVE_SIGMAS = 5.0
"""Minimum size of a return, in standard deviations of the stored state, for this state alone to show the return."""
_STEP_LASTS = 4
"""Duration of a step, s; further significant changes in this time belong to the step."""
_AT_REST, _DISPLACED = 0, 1
"""Indices of the two vectors of the state, the residual without displacement and the displacement."""
_UNKNOWN_RAD2 = 1.0
"""Variance of each component of a new displacement, rad²."""

TOGETHER = "all together"
"""Name of the displacement that all sources have in common."""


class MemoryResidual(NamedTuple):
    """A measurement of a source against a stored state.

    Attributes:
        turn: measured minus predicted attitude, observed components of a rotation vector, rad, shape (k,).
        noise: covariance of the measurement noise, rad², shape (k, k).
        expected: covariance of ``turn`` due to the stored state, which is propagated to the time of the measurement,
            rad², shape (k, k).
        drift: growth of ``expected`` in one second, rad²/s, shape (k, k).
    """

    turn: FloatArray
    noise: FloatArray
    expected: FloatArray
    drift: FloatArray


class Displacement:
    """The displacement of a source, or of several sources together: the change of their residual by steps.

    Example:
        A source moves by 60″ about Up and back, while the INS drifts by 0.3″ in each of 100 s:

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
        # State of a Kalman filter that consists of drift and displacement. A residual is the sum of the two.
        self._mean = np.zeros(0)
        self._covariance = self._start_covariance = np.zeros((0, 0))
        self._since_step, self._is_clear = 0, False
        self._delayed: MemoryResidual | None = None
        self._newest: MemoryResidual | None = None
        # Displacement before the last step, and largest displacement, or change of displacement, before the last
        # change.
        self._before = self._largest = np.zeros(0)

    @property
    def largest_rad(self) -> float:
        """Length of the largest displacement, or of the largest change of displacement, rad."""
        return 0.0 if self._newest is None else float(np.linalg.norm(self._largest_until_now(self._newest)))

    def add(self, residual: MemoryResidual) -> None:
        """Add a measurement; a measurement that is not finite is ignored."""
        if all(np.all(np.isfinite(part)) for part in residual):
            self._pending.append(residual)

    def inflate(self, covariance: FloatArray) -> None:
        """Add the covariance of a jump that a source (for example the INS) itself showed in this second, rad², (k, k).

        The measurements of this second, before and after the jump, are dropped. A displacement that is not larger than
        the jump may be the jump itself, so the displacement is reset to zero.
        """
        self._pending.clear()
        if self._newest is None:
            return
        self._absorb_delayed()
        self._add_error(_AT_REST, covariance)
        if self.largest_rad and _square(self._displaced, self._displaced_covariance + covariance) <= self._within_noise:
            self._start(self._by_both @ self._mean, self._residual_covariance)
            self._start_covariance = self._start_covariance + covariance
            # Further changes due to the jump are not displacement either.
            self._is_clear, self._since_step = False, _STEP_LASTS

    def end_second(self) -> None:
        """Compare the measurements of the last second with earlier measurements."""
        if self._newest is not None:
            self._add_error(_AT_REST, self._newest.drift)
        if not self._pending:
            return
        newest = _mean(self._pending)
        self._pending.clear()
        if self._newest is None:
            # The source may be displaced at the start already.
            self._start(np.zeros_like(newest.turn), np.zeros_like(newest.expected))
            self._add_error(_DISPLACED, newest.expected)
            self._start_covariance = newest.expected
        self._newest = newest
        nis = innovation(self._covariance[None], self._measurement(newest)).nis
        # NaN counts as a clear step.
        if not nis <= value_above(_FALSE_STEP, self._size):
            self._largest = self._largest_until_now(newest)
            if self._since_step >= _STEP_LASTS:
                self._before, self._since_step = self._displaced, 0
            self._delayed = None
            self._add_error(_DISPLACED, _UNKNOWN_RAD2 * np.eye(self._size))
            self._update(newest)
        else:
            self._absorb_delayed()
            self._delayed = newest
        self._since_step = min(self._since_step + 1, _STEP_LASTS)
        within = _square(self._displaced, self._displaced_covariance) <= self._within_noise
        self._is_clear = self._is_clear or not within

    def _start(self, at_rest: FloatArray, covariance: FloatArray) -> None:
        """Start the filter with a residual without displacement."""
        size = len(at_rest)
        self._mean = np.append(at_rest, np.zeros(size))
        self._covariance = np.zeros((2 * size, 2 * size))
        self._add_error(_AT_REST, covariance)
        self._before = self._largest = np.zeros(size)

    def _add_error(self, vector: int, covariance: FloatArray) -> None:
        """Add the covariance of an error to one of the two vectors."""
        rows = slice(vector * len(covariance), (vector + 1) * len(covariance))
        self._covariance[rows, rows] += covariance

    @property
    def _size(self) -> int:
        """Number of components of a residual, k."""
        return len(self._before)

    @property
    def _by_both(self) -> FloatArray:
        """Jacobian of a residual with respect to the state, shape (k, 2k)."""
        return np.tile(np.eye(self._size), 2)

    @property
    def _displaced(self) -> FloatArray:
        """The displacement now, rad, shape (k,)."""
        return self._mean[self._size :]

    @property
    def _displaced_covariance(self) -> FloatArray:
        """Covariance of the displacement, the covariance of the stored state included, rad², shape (k, k)."""
        covariance: FloatArray = self._covariance[self._size :, self._size :] + self._start_covariance
        return covariance

    @property
    def _residual_covariance(self) -> FloatArray:
        """Covariance of a residual now, without measurement noise, rad², shape (k, k)."""
        covariance: FloatArray = self._by_both @ self._covariance @ self._by_both.T
        return covariance

    def _measurement(self, residual: MemoryResidual) -> LinearMeasurement:
        """Return a residual as a measurement of the state."""
        by_both = self._by_both
        return LinearMeasurement(residual.turn - by_both @ self._mean, by_both, {0: residual.noise})

    def _absorb_delayed(self) -> None:
        """Update with the delayed second, because an update must not contain a second in which a step begins."""
        if self._delayed is not None:
            self._update(self._delayed)
            self._delayed = None

    def _update(self, residual: MemoryResidual) -> None:
        """Update the state with a residual."""
        parts, measurement = self._covariance[None], self._measurement(residual)
        correction, parts = update(parts, measurement, innovation(parts, measurement).gain)
        self._mean, self._covariance = self._mean + correction, parts[0]

    def _largest_until_now(self, newest: MemoryResidual) -> FloatArray:
        """Return the largest displacement, or the largest change of displacement by a step, up to now."""
        moved = self._largest, self._displaced, self._displaced - self._before
        return max(moved, key=lambda one: _square(one, newest.noise))

    @property
    def is_displaced(self) -> bool:
        """True if the source has moved by a step and not back."""
        newest = self._newest
        if newest is None or not self._is_clear:
            return False
        largest = _square(self._largest_until_now(newest), newest.noise)
        left = _square(self._displaced, newest.noise)
        if left <= _LEFT_SHARE**2 * largest:
            return False
        is_small = left <= _MOST_LEFT_SHARE**2 * largest and self._since_step >= _STEP_LASTS
        return not (is_small and _square(self._displaced, self._displaced_covariance) <= self._within_noise)

    def has_not_moved_as(self, other: "Displacement") -> bool:
        """True if this source is not displaced and would show the displacement of ``other`` as a clear step."""
        if self._newest is None or self.is_displaced:
            return False
        covariance = self._residual_covariance + other._residual_covariance
        covariance = covariance + self._newest.noise + other._displaced_covariance
        return _square(other._displaced - self._displaced, covariance) > value_above(_FALSE_STEP, self._size)

    @property
    def _within_noise(self) -> float:
        """Squared length, in standard deviations, up to which a displacement is explained by noise."""
        return value_above(_BY_NOISE, self._size)

    @property
    def is_beyond_memory(self) -> bool:
        """True if the stored state, propagated until now, is too uncertain to show the largest displacement."""
        newest = self._newest
        if newest is None or not self.largest_rad:
            return False
        # The share of the largest displacement that a residual shows, by least squares.
        largest = self._largest_until_now(newest)
        to_share = np.linalg.solve(newest.noise, largest) / _square(largest, newest.noise)
        sigma = float(np.sqrt(to_share @ (newest.expected + self._residual_covariance) @ to_share))
        return not _DECISIVE_SIGMAS * sigma <= 1.0 - _LEFT_SHARE


def _mean(residuals: Sequence[MemoryResidual]) -> MemoryResidual:
    """Return the mean of residuals, weighted by their noise; the error of the stored state is common to all."""
    weights = [np.linalg.inv(one.noise) for one in residuals]
    noise = np.linalg.inv(sum(weights))
    turn = noise @ sum(weight @ one.turn for weight, one in zip(weights, residuals, strict=True))
    expected, drift = (np.mean([one[part] for one in residuals], axis=0) for part in (2, 3))
    return MemoryResidual(turn, noise, expected, drift)


def _square(turn: FloatArray, covariance: FloatArray) -> float:
    """Return the squared length of a rotation vector in its standard deviations."""
    return float(turn @ np.linalg.solve(covariance, turn))


class Displacements:
    """The displacement of each source, and the displacement of all sources together."""

    def __init__(self) -> None:
        self._by_source: dict[str, Displacement] = {}
        self._together = Displacement()

    def add(self, source: str, residual: MemoryResidual) -> None:
        """Add a measurement of a source."""
        for displacement in (self._by_source.setdefault(source, Displacement()), self._together):
            displacement.add(residual)

    def inflate(self, covariance: FloatArray) -> None:
        """Add the covariance of a jump that a source (for example the INS) itself showed, rad², shape (k, k)."""
        for displacement in (*self._by_source.values(), self._together):
            displacement.inflate(covariance)

    def end_second(self) -> None:
        """Compare the measurements of the last second with earlier measurements."""
        for displacement in (*self._by_source.values(), self._together):
            displacement.end_second()

    @property
    def displaced(self) -> dict[str, float]:
        """Sources that have moved and not moved back, with their largest displacement, rad; :data:`TOGETHER` for all.

        A source has moved by itself only if another source has not moved with it. The result is empty if the weighted
        mean of all sources is not displaced.
        """
        if not self._together.is_displaced:
            return {}
        moved = {name: one for name, one in self._by_source.items() if one.is_displaced}
        if any(other.has_not_moved_as(one) for one in moved.values() for other in self._by_source.values()):
            return {name: one.largest_rad for name, one in moved.items()}
        return {TOGETHER: self._together.largest_rad}

    @property
    def is_undecided_by_memory(self) -> bool:
        """True if all sources have moved together by an amount that the stored state cannot show."""
        return TOGETHER in self.displaced and self._together.is_beyond_memory

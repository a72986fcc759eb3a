"""Whether the attitude of an INS creeps away from its own integrated rates.

The rates have a bias that changes slowly, and the attitude an error that walks. How fast the two run apart over some
seconds is therefore much the same from piece to piece. Where it suddenly is not, the attitude creeps, or the bias of
the rates has changed: one of the two is wrong.
"""

import math
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray

_OVER = (1, 2, 4)
"""Pieces that are looked at together: the slower the creep, the longer it takes to stand out."""
_LIMIT, _LIMIT_EARLY = 36.0, 25.0
"""Chi² that three axes exceed once in 1e7 pieces of two seconds, which is once in thousands of hours; and the one for
the first minute, in which few pieces tell how much slopes spread, widened as Student's distribution is."""
_LEAST, _MEMORY = 8, 500
"""So many pieces tell how much slopes spread before any is judged, and of so many the mean is made."""
_FARTHEST = 3.0
"""Of a slope no more than so many sigmas count towards the spread: one that creeps is no measure of it."""

_FASTER = 1.5
"""A ship that turns so many times faster than in all pieces known shows errors of scale that none of them has told."""


class Crept(NamedTuple):
    """How far an attitude has crept away from the rates.

    Attributes:
        turn_n: rotation vector in the horizon frame, rad, shape (3,).
        sigma_rad: its standard deviation about the worst axis.
    """

    turn_n: FloatArray
    sigma_rad: float


class SlopeWatch:
    """Watches how fast the attitude of one INS runs away from its rates, piece by piece.

    >>> watch, rng = SlopeWatch(), np.random.default_rng(1)
    >>> clean = [watch.crept(rng.normal(0.0, 1e-6, 3), 2.0, 0.1) for _ in range(30)]
    >>> crept = watch.crept(np.array([0.0, 2e-5, 0.0]), 2.0, 0.1)
    >>> set(clean), (crept.turn_n * 1e5).round() + 0.0
    ({None}, array([0., 4., 0.]))
    """

    def __init__(self) -> None:
        self._square, self._known = np.zeros(3), 0
        self._slopes_n: list[FloatArray] = []
        self._turning: list[float] = []
        self._fastest = 0.0
        self._fresh = -1

    def forget(self) -> None:
        """Learn the spread of slopes anew: the rates, or how they are measured, have changed."""
        self._square, self._known, self._fresh = np.zeros(3), 0, -1
        self._fastest = 0.0
        self._slopes_n.clear()
        self._turning.clear()

    def crept(self, slope_n: FloatArray, seconds: float, turning: float) -> Crept | None:
        """How far the attitude has crept with this piece and those before; None where that is no more than usual.

        Args:
            slope_n: of a piece, less what was learnt before, horizon frame, rad/s, shape (3,).
            seconds: length of the piece.
            turning: how fast the ship turned in it, all in all, rad/s.
        """
        self._fresh += 1
        if self._fresh == 0 and not self._known:
            return None  # The first piece holds the whole bias.
        self._slopes_n.append(slope_n)
        self._turning.append(turning)
        if len(self._slopes_n) > _OVER[-1]:
            # What is looked at is no measure of the spread yet.
            self._learn(self._slopes_n.pop(0), self._turning.pop(0))
        if self._known < _LEAST:
            return None
        if not turning <= _FASTER * self._fastest:
            self._fresh = 0
            return None
        limit = max(_LIMIT, self._known * math.expm1(_LIMIT_EARLY / self._known))
        for over in _OVER:
            summed_n = np.sum(self._slopes_n[-over:], axis=0)
            square = over * self._square
            # Written so that a spread of zero, and NaN, tell nothing.
            if over <= self._fresh and square.min() > 0.0 and float(np.sum(summed_n**2 / square)) > limit:
                self._fresh = 0
                return Crept(summed_n * seconds, math.sqrt(float(square.max())) * seconds)
        return None

    def _learn(self, slope_n: FloatArray, turning: float) -> None:
        known = self._known >= _LEAST
        if known and turning > _FASTER * self._fastest:
            # At once: while she turns so, each piece shows the same.
            self._square = np.maximum(self._square, slope_n**2)
        elif known:
            slope_n = np.minimum(np.abs(slope_n), _FARTHEST * np.sqrt(self._square))
        self._fastest = max(self._fastest, turning)
        self._known = min(self._known + 1, _MEMORY)
        self._square = self._square + (slope_n**2 - self._square) / self._known

"""Detection of a drift of an INS attitude against its own integrated rates.

The rates have a slowly changing bias, and the attitude error is a random walk. Their relative drift is therefore
similar from one piece of some seconds to the next. If this drift changes suddenly, the attitude drifts or the bias of
the rates has changed.
"""

import math
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray

_OVER = (1, 2, 4)
"""Numbers of pieces that are tested together; a slower drift needs more pieces."""
_LIMIT, _LIMIT_EARLY = 36.0, 25.0
"""Chi² limits of three axes, in general and in the first minute. The first limit is exceeded once in 1e7 pieces of two
seconds, which is once in thousands of hours. The second value gives a wider limit, as for Student's distribution, while
few pieces determine the spread."""
_LEAST, _MEMORY = 8, 500
"""Number of pieces from which the spread of the drifts is known, and number over which the spread is averaged."""
_FARTHEST = 3.0
"""Bound of a drift in the estimate of the spread, sigmas, so that a piece with a fault does not enlarge the spread."""

_FASTER = 1.5
"""Ratio to the fastest earlier rotation above which a piece is not tested, because the piece shows new scale errors."""


class RateDisagreement(NamedTuple):
    """Drift of an attitude against its rates.

    Attributes:
        turn_n: rotation vector of the drift in the horizon frame, rad, shape (3,).
        sigma_rad: standard deviation of the drift about the worst axis.
    """

    turn_n: FloatArray
    sigma_rad: float


class RateDriftDetector:
    """Detector of drift of one INS attitude against its rates, in successive pieces of time.

    >>> detector, rng = RateDriftDetector(), np.random.default_rng(1)
    >>> clean = [detector.detect(rng.normal(0.0, 1e-6, 3), 2.0, 0.1) for _ in range(30)]
    >>> drift = detector.detect(np.array([0.0, 2e-5, 0.0]), 2.0, 0.1)
    >>> set(clean), (drift.turn_n * 1e5).round() + 0.0
    ({None}, array([0., 4., 0.]))
    """

    def __init__(self) -> None:
        self._square, self._known = np.zeros(3), 0
        self._slopes_n: list[FloatArray] = []
        self._turning: list[float] = []
        self._fastest = 0.0
        self._fresh = -1

    def reset(self) -> None:
        """Reset the spread of the drifts, because the rates or their calibration have changed."""
        self._square, self._known, self._fresh = np.zeros(3), 0, -1
        self._fastest = 0.0
        self._slopes_n.clear()
        self._turning.clear()

    def detect(self, slope_n: FloatArray, seconds: float, turning: float) -> RateDisagreement | None:
        """Return the drift of the attitude in this piece and up to three pieces before, or None.

        The result is None if the drift is usual or cannot be tested.

        Args:
            slope_n: drift in the piece minus the estimated drift, horizon frame, rad/s, shape (3,).
            seconds: length of the piece, s.
            turning: magnitude of the ship's mean angular velocity in the piece, rad/s.
        """
        self._fresh += 1
        if self._fresh == 0 and not self._known:
            return None  # the first piece contains the whole bias
        self._slopes_n.append(slope_n)
        self._turning.append(turning)
        if len(self._slopes_n) > _OVER[-1]:
            # Pieces under test do not enter the spread.
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
            # The condition is false for a spread of zero and for NaN.
            if over <= self._fresh and square.min() > 0.0 and float(np.sum(summed_n**2 / square)) > limit:
                self._fresh = 0
                return RateDisagreement(summed_n * seconds, math.sqrt(float(square.max())) * seconds)
        return None

    def _learn(self, slope_n: FloatArray, turning: float) -> None:
        known = self._known >= _LEAST
        if known and turning > _FASTER * self._fastest:
            # The spread grows at once, because every piece during this rotation shows the same scale error.
            self._square = np.maximum(self._square, slope_n**2)
        elif known:
            slope_n = np.minimum(np.abs(slope_n), _FARTHEST * np.sqrt(self._square))
        self._fastest = max(self._fastest, turning)
        self._known = min(self._known + 1, _MEMORY)
        self._square = self._square + (slope_n**2 - self._square) / self._known

"""Results of the plausibility checks of INS samples (:mod:`ship_estimation.plausibility.ins_check`).

A result is a checked sample or block of samples, with the jumps of the attitude that were found. A step of the INS's
clock that would explain a jump is part of the jump.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_estimation.plausibility.stuck_check import MotionReference
from ship_estimation.rejection_rules import Rejection
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.rotations import FloatArray, vector_length
from ship_geometry.tracks.attitude_track import AttitudeSample, ExtraNoise

_CLOCK_SIGMAS, _CLOCK_SHARE = 3.0, 0.1
"""Bound of the part of a jump that a clock step does not explain: a number of sigmas plus a share of the jump."""
_CLEAR_SIGMAS = 15.0
"""Size in sigmas from which a jump along the ship's rotation is attributed to the clock."""


@dataclass(frozen=True)
class InsJump:
    """A permanent jump of the INS attitude.

    Attributes:
        time_ns: stamp just before the first sample after the jump.
        jump_n: rotation vector of the jump in the horizon frame, rad, shape (3,).
        sigma_rad: standard deviation of the jump about each axis.
        clock_s: step of the INS's clock that would explain the jump, s; NaN if no clock step would.
        is_drift: True if the attitude drifted by ``jump_n`` instead of jumping, and may drift further.

    >>> jump = InsJump(time_ns=0, jump_n=np.array([0.0, 0.1, 0.0]), sigma_rad=0.001)
    >>> [round(float(sigma), 3) for sigma in np.sqrt(np.diagonal(jump.covariance_n))]
    [0.005, 0.1, 0.005]
    """

    time_ns: int
    jump_n: FloatArray
    sigma_rad: float
    clock_s: float = math.nan
    is_drift: bool = False

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance by which the INS's correlated error is inflated for the jump, rad², shape (3, 3).

        The variance along the jump is the square of the jump. The variance of the estimated jump is added about every
        axis. The variance (jump²/2)² is also added about every axis, because large rotations do not commute.
        """
        covariance_n: FloatArray = np.outer(self.jump_n, self.jump_n) + self._across_rad**2 * np.eye(3)
        return covariance_n

    @property
    def shared_with_clock(self) -> tuple[FloatArray, FloatArray]:
        """Jump with one half attributed to the attitude and one half to the clock, and the covariance of both.

        While the ship rotates at a constant rate, a jump of the attitude and a clock step cannot be distinguished. In
        the covariance, a jump of the attitude alone and a clock step alone are both one sigma from the mean.

        Returns:
            Change of the correlated error and of the clock offset, rad and s, shape (4,), and covariance of this
            change, shape (4, 4).
        """
        half, jump_rad = 0.5 * np.append(self.jump_n, self.clock_s), vector_length(self.jump_n)
        covariance = np.outer(half, half)
        covariance[:3, :3] += self._across_rad**2 * np.eye(3)
        covariance[3, 3] += (self.clock_s * math.hypot(_CLOCK_SHARE, self.sigma_rad / jump_rad)) ** 2
        return half * [-1.0, -1.0, -1.0, 1.0], covariance

    @property
    def is_clock_step(self) -> bool:
        """True if a clock step explains the jump and the jump is large compared with its sigma."""
        clear = vector_length(self.jump_n) >= _CLEAR_SIGMAS * self.sigma_rad
        return clear and not math.isnan(self.clock_s)

    @property
    def _across_rad(self) -> float:
        return math.hypot(self.sigma_rad, 0.5 * float(self.jump_n @ self.jump_n))


InsChange = InsJump | ExtraNoise
"""Change of an INS error, either a jump of the attitude or a change of the sample noise."""


def clock_step_s(jump_n: FloatArray, sigma_rad: float, rate_n: FloatArray) -> float:
    """Return the clock step, s, during which the ship rotates by the jump; NaN if no clock step explains the jump.

    Args:
        jump_n: rotation vector of the jump, rad, shape (3,).
        sigma_rad: standard deviation of the jump about each axis.
        rate_n: angular velocity at the jump in the same frame, rad/s, shape (3,).

    Example:
        The attitude of a ship that rolls at 0.1 rad/s jumps by 2 mrad, in roll or in heading:

        >>> roll_n, heading_n = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.1, 0.0])
        >>> [round(clock_step_s(0.02 * turned_n, 1e-5, roll_n), 4) for turned_n in (roll_n, heading_n)]
        [0.02, nan]
    """
    square = float(rate_n @ rate_n)
    if not square > 0.0:
        return math.nan
    step_s = float(jump_n @ rate_n) / square
    # A share of the jump is tolerated, because the rate of rotation changes during the clock step.
    explained = vector_length(jump_n - step_s * rate_n) <= _CLOCK_SIGMAS * sigma_rad + _CLOCK_SHARE * vector_length(
        jump_n
    )
    return step_s if explained else math.nan


class CheckedInsSample(NamedTuple):
    """Result of the checks of a sample.

    Attributes:
        sample: sample to use, without its rate if the rates are not usable.
        rejection: reason not to use ``sample``, for example a step or drift detected with the sample; None if the
            sample is to be used.
        jumps: jump or drift of the attitude that is found with this sample; empty without one. A step against the rates
            is given at each end of the interval in which the step may have happened.
        rates_wrong_after_ns: stamp after which the rates of earlier samples were wrong; None without new information.
        noise: excess noise of the samples as estimated with this sample; None without new information.
    """

    sample: AttitudeSample
    rejection: Rejection | None = None
    jumps: tuple[InsJump, ...] = ()
    rates_wrong_after_ns: int | None = None
    noise: ExtraNoise | None = None


class CheckedBlock:
    """The leading samples of a block that were checked together.

    Attributes:
        count: number of checked samples.
        last: result for the last checked sample if it shows a drift, wrong rates or new excess noise; None otherwise.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last: CheckedInsSample | None = None
        self._pieces: list[_Piece] = []

    @property
    def accepted_count(self) -> int:
        """Number of leading samples that are accepted unchanged."""
        return self.count - (self.last is not None)

    def add(self, times_ns: StampArray, rotations: FloatArray, drift_rad_per_s: float) -> None:
        """Add checked stamps, attitudes by integrated rates, shape (N, 3, 3), and bound of the rate drift."""
        self._pieces.append(_Piece(self.count, times_ns, rotations, drift_rad_per_s))
        self.count += len(times_ns)

    def by_rates(self, number: int) -> MotionReference:
        """Return the attitude by integrated rates at a sample, as motion reference for the checks of other sources."""
        piece = self._pieces[-1]
        for piece in reversed(self._pieces):
            if piece.start <= number:
                break
        place = number - piece.start
        return MotionReference(int(piece.times_ns[place]), piece.rotations[place], 0.0, piece.drift_rad_per_s)


class _Piece(NamedTuple):
    """Samples from the number ``start`` on, with the arguments of :meth:`CheckedBlock.add`."""

    start: int
    times_ns: StampArray
    rotations: FloatArray
    drift_rad_per_s: float

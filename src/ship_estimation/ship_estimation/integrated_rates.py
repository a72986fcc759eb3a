"""The attitude by an INS's rates alone."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_watch
from ship_geometry import compiled_rotations
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

StampArray = NDArray[np.int64]
"""Stamps, ns."""

_LONGEST_STEP_NS = SECOND_NS
"""Rates that are further apart are not joined by integration."""


class Integrated(NamedTuple):
    """The attitude by the rates alone.

    Attributes:
        rotation: the attitude, from an arbitrary start, shape (3, 3).
        run: number of the unbroken run of rates to which it belongs; attitudes of two runs must not be compared.
        missed_rad: what the integration may have missed since that run began.
    """

    rotation: FloatArray
    run: int
    missed_rad: float


class IntegratedRun(NamedTuple):
    """The attitudes by the rates alone of N samples that belong to one run; see :class:`Integrated`.

    Attributes:
        rotations: shape (N, 3, 3).
        run: number of the run.
        missed_rad: shape (N,).
    """

    rotations: FloatArray
    run: int
    missed_rad: FloatArray

    def one(self, number: int) -> Integrated:
        """One of them."""
        return Integrated(self.rotations[number], self.run, float(self.missed_rad[number]))

    def some(self, which: slice) -> "IntegratedRun":
        """Some of them."""
        return IntegratedRun(self.rotations[which], self.run, self.missed_rad[which])


class RateIntegrator:
    """Integrates the rates of one INS in the order of their stamps.

    >>> from ship_geometry.rotations import log_rotation
    >>> integrator = RateIntegrator()
    >>> turns = [integrator.integrate(n * 100_000_000, np.array([0.0, 0.0, 0.1])) for n in range(11)]
    >>> print(log_rotation(turns[-1].rotation).round(6) + 0.0)
    [0.  0.  0.1]
    """

    def __init__(self) -> None:
        self._integrated = Integrated(np.eye(3), 0, 0.0)
        self._last: tuple[int, FloatArray] | None = None
        self._twice_drift_d = np.zeros(3)

    def integrate(self, time_ns: int, rate_d: FloatArray | None) -> Integrated | None:
        """Integrate the rates up to the next sample: the mean of two successive rates turns the attitude.

        For motion of one period the error is a constant small share of the turn. Where the step from the last sample
        with a rate is too long to integrate, a new run begins.

        Args:
            time_ns: stamp of the sample, later than all before.
            rate_d: its angular velocity in the deck frame, rad/s, shape (3,); None where it has none.

        Returns:
            The attitude by the rates alone; None where the sample has no rate, or one that is not a number.
        """
        if rate_d is None:
            return None
        rotation, run, missed_rad = self._integrated
        if self._last is None or not 0 < time_ns - self._last[0] <= _LONGEST_STEP_NS:
            run, missed_rad = run + 1, 0.0 * float(rate_d.sum())
        else:
            rotations, missed = self._integrate(np.array([time_ns]), rate_d[None])
            rotation, missed_rad = rotations[0], float(missed[0])
        if not missed_rad < math.inf:
            return None
        self._integrated, self._last = Integrated(rotation, run, missed_rad), (time_ns, rate_d)
        return self._integrated

    def integrate_all(self, times_ns: StampArray, rates_d: FloatArray) -> IntegratedRun:
        """The same for the samples of a block, in which nothing is taken yet: see :meth:`take`.

        Args:
            times_ns: their stamps, shape (N,).
            rates_d: their rates, rad/s, shape (N, 3).

        Returns:
            The attitudes of those that go on with the run of before; none where there is no run.
        """
        if self._last is None:
            return IntegratedRun(np.empty((0, 3, 3)), self._integrated.run, np.empty(0))
        rotations, missed = self._integrate(times_ns, rates_d)
        joined = int(np.count_nonzero(missed < math.inf))
        return IntegratedRun(rotations[:joined], self._integrated.run, missed[:joined])

    def take(self, time_ns: int, rate_d: FloatArray, integrated: Integrated) -> None:
        """Go on from a sample of a block, its rate in rad/s, shape (3,)."""
        self._integrated, self._last = integrated, (time_ns, rate_d)

    def _integrate(self, times_ns: StampArray, rates_d: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Attitudes by the rates, shape (N, 3, 3), and what may be missed, infinite from a gap on, shape (N,)."""
        assert self._last is not None
        rotation, _, missed_rad = self._integrated
        turns_d, missed = compiled_watch.turns(
            times_ns, rates_d, *self._last, missed_rad, self._twice_drift_d, _LONGEST_STEP_NS
        )
        return compiled_rotations.turned_on(rotation, turns_d), missed

    def take_out(self, drift_d: FloatArray) -> None:
        """From now on the rates are taken to be larger by this than the turn of the deck, rad/s, shape (3,)."""
        self._twice_drift_d = 2.0 * drift_d


def missed_by_mean_rad(first_rate_d: FloatArray, second_rate_d: FloatArray, seconds: float) -> float:
    """What the mean of two rates (rad/s, shape (3,)) may miss of the turn between them, rad.

    >>> steady = np.array([0.0, 0.0, 0.1])
    >>> missed_by_mean_rad(steady, steady, seconds=0.0)
    0.0
    """
    missed_rad: float = compiled_watch.missed_by_mean(first_rate_d, second_rate_d, seconds)
    return missed_rad

"""Attitude by integrated angular rates of an INS."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_checks, compiled_rotations

StampArray = NDArray[np.int64]
"""Stamps, ns."""

_LONGEST_STEP_NS = SECOND_NS
"""Maximum interval between two rates for their integration, ns."""


class IntegratedAttitude(NamedTuple):
    """An attitude by integrated rates.

    Attributes:
        rotation: attitude with respect to an arbitrary start, shape (3, 3).
        run: number of the unbroken run of rates; attitudes of two runs must not be compared.
        error_rad: bound of the integration error since the run began.
    """

    rotation: FloatArray
    run: int
    error_rad: float


class IntegratedRun(NamedTuple):
    """Attitudes by integrated rates of N samples of one run; see :class:`IntegratedAttitude`.

    Attributes:
        rotations: attitudes, shape (N, 3, 3).
        run: number of the run.
        error_rad: bounds of the integration error, shape (N,).
    """

    rotations: FloatArray
    run: int
    error_rad: FloatArray

    def sample(self, number: int) -> IntegratedAttitude:
        """Return the attitude of one sample."""
        return IntegratedAttitude(self.rotations[number], self.run, float(self.error_rad[number]))

    def subset(self, which: slice) -> "IntegratedRun":
        """Return the attitudes of a slice of the samples."""
        return IntegratedRun(self.rotations[which], self.run, self.error_rad[which])


class RateIntegrator:
    """Integrates the rates of one INS in the order of their stamps.

    >>> from ship_geometry.rotations import log_rotation
    >>> integrator = RateIntegrator()
    >>> integrated = [integrator.integrate(n * 100_000_000, np.array([0.0, 0.0, 0.1])) for n in range(11)]
    >>> print(log_rotation(integrated[-1].rotation).round(6) + 0.0)
    [0.  0.  0.1]
    """

    def __init__(self) -> None:
        self._integrated = IntegratedAttitude(np.eye(3), 0, 0.0)
        self._last: tuple[int, FloatArray] | None = None
        self._twice_drift_d = np.zeros(3)

    def integrate(self, time_ns: int, rate_d: FloatArray | None) -> IntegratedAttitude | None:
        """Integrate the rates up to the next sample, by the mean of two successive rates.

        For periodic motion the integration error is a constant small share of the rotation. If the interval since the
        last rate is too long, a new run starts.

        Args:
            time_ns: stamp of the sample, later than all stamps before.
            rate_d: angular velocity of the sample in the deck frame, rad/s, shape (3,); None if the sample has no rate.

        Returns:
            The attitude by integrated rates; None without a rate or with a rate that is not finite.
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
        self._integrated, self._last = IntegratedAttitude(rotation, run, missed_rad), (time_ns, rate_d)
        return self._integrated

    def integrate_all(self, times_ns: StampArray, rates_d: FloatArray) -> IntegratedRun:
        """Integrate the rates of a block without changing the state; see :meth:`resume_from`.

        Args:
            times_ns: stamps of the samples, shape (N,).
            rates_d: rates of the samples, rad/s, shape (N, 3).

        Returns:
            The attitudes of the leading samples that continue the present run; empty without a run.
        """
        if self._last is None:
            return IntegratedRun(np.empty((0, 3, 3)), self._integrated.run, np.empty(0))
        rotations, missed = self._integrate(times_ns, rates_d)
        joined = int(np.count_nonzero(missed < math.inf))
        return IntegratedRun(rotations[:joined], self._integrated.run, missed[:joined])

    def resume_from(self, time_ns: int, rate_d: FloatArray, integrated: IntegratedAttitude) -> None:
        """Continue from a sample of a block and its rate, rad/s, shape (3,)."""
        self._integrated, self._last = integrated, (time_ns, rate_d)

    def _integrate(self, times_ns: StampArray, rates_d: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return attitudes, shape (N, 3, 3), and bounds of their errors, infinite from a gap on, shape (N,)."""
        assert self._last is not None
        rotation, _, missed_rad = self._integrated
        turns_d, missed = compiled_checks.rotation_steps(
            times_ns, rates_d, *self._last, missed_rad, self._twice_drift_d, _LONGEST_STEP_NS
        )
        return compiled_rotations.cumulative_rotations(rotation, turns_d), missed

    def set_drift(self, drift_d: FloatArray) -> None:
        """Set the error of the rates, deck frame, rad/s, shape (3,), which is subtracted from now on."""
        self._twice_drift_d = 2.0 * drift_d


def mean_rate_error_rad(first_rate_d: FloatArray, second_rate_d: FloatArray, seconds: float) -> float:
    """Return a bound of the error of integrating the mean of two rates (rad/s, shape (3,)), rad.

    >>> steady = np.array([0.0, 0.0, 0.1])
    >>> mean_rate_error_rad(steady, steady, seconds=0.0)
    0.0
    """
    missed_rad: float = compiled_checks.mean_rate_error(first_rate_d, second_rate_d, seconds)
    return missed_rad

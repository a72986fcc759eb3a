"""Attitude by integrated angular rates of an INS, and consistency check of the rates.

The rates integrated over a short piece of motion must equal the rotation of the attitude. Their difference determines
the status of the rates (:class:`RateConsistencyCheck`), which detects rates that are zero, noise, in degrees or about
other axes. Without motion the last status is kept.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation, vector_length
from ship_kernels import compiled_checks, compiled_rotations

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


class RateStatus(enum.Enum):
    """Status of the rates of an INS."""

    UNPROVEN = "unproven"
    MEASURED = "measured"
    NOT_MEASURED = "not measured"
    WRONG_UNITS = "wrong units"


@dataclass(frozen=True)
class _PieceStart:
    """Start of a piece of motion."""

    time_ns: int
    number: int
    rotation_nd: FloatArray
    integrated: IntegratedAttitude


class RateConsistencyCheck:
    """Check of the rates of an INS in successive pieces of motion.

    A piece lasts until the rotation clearly exceeds the noise, at least a quarter of a second and at most two seconds.
    A piece without a clear rotation is ignored. The rates of a piece are right if they equal the rotation of the
    attitude to within 30 %. Before the first right piece a single wrong piece, which may be shorter, makes the rates
    unusable; later two successive wrong pieces do. Twenty successive right pieces make the rates usable again. Twenty
    pieces in which the rotations by rates and by attitude have a ratio of about 57.3 or 1/57.3 show a wrong unit. Four
    successive pieces with another ratio end the status WRONG_UNITS.

    Attributes:
        status: status of the rates.
        is_usable: True if the status is UNPROVEN or MEASURED.
        slope: ratio of the rotation by the rates to the rotation by the attitude, if the unit is wrong.
        due_ns: stamp before which no sample can end the piece of motion; zero if the next sample may.

    >>> from ship_geometry.rotations import exp_rotation
    >>> guard, integrator = RateConsistencyCheck(), RateIntegrator()
    >>> for n in range(10):
    ...     attitude = exp_rotation(np.array([0.0, 0.0, 0.01 * n]))
    ...     integrated = integrator.integrate(n * 100_000_000, np.array([0.0, 0.0, 0.1]))
    ...     _ = guard.observe(n * 100_000_000, n, attitude, integrated, sigma_rad=1e-5)
    >>> guard.status
    <RateStatus.MEASURED: 'measured'>
    """

    _SHORTEST_NS = 250_000_000
    _LONGEST_NS = 2 * SECOND_NS
    _SLOWEST_RAD_PER_S = 72.0 * ARCSEC
    """Slowest rotation that is checked, rad/s, because rates may contain the Earth rate, 15″ per second, or a bias."""
    _CLEAR_SIGMAS = 25.0
    _FIRST_SIGMA_RAD = 36.0 * ARCSEC / np.sqrt(12.0)
    """Least noise of a piece while the status is UNPROVEN, rad, from a resolution of 0.01°."""
    _TOLERANCE = 0.3
    _PIECES = 20
    _WRONG_PIECES = 2
    _OTHER_UNITS = 4
    _DEGREES = float(np.rad2deg(1.0))
    _SLOPE_TOLERANCE = 1.25
    _LEAST_CORRELATION = 0.9

    def __init__(self) -> None:
        self.status = RateStatus.UNPROVEN
        self.is_usable = True
        self.slope = 1.0
        self.due_ns = 0
        self._start: _PieceStart | None = None
        self._right = 0
        self._wrong = 0
        self._other_units = 0
        self._right_until_ns: int | None = None
        self._turns: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=self._PIECES)

    def restart(self) -> None:
        """End the piece of motion; the attitude of the next sample starts a new piece."""
        self._start, self.due_ns = None, 0

    def observe(
        self,
        time_ns: int,
        number: int,
        rotation_nd: FloatArray,
        integrated: IntegratedAttitude,
        sigma_rad: float,
        step_sigma_rad: float = 0.0,
    ) -> int | None:
        """Compare a measured attitude with the integrated rates, and update the status of the rates.

        Args:
            time_ns: stamp of both attitudes.
            number: number of the sample.
            rotation_nd: measured attitude, shape (3, 3).
            integrated: attitude by integrated rates. Another ``run`` starts a new piece.
            sigma_rad: noise of a measured attitude about its worst axis.
            step_sigma_rad: noise that the rate of each further sample of a piece adds.

        Returns:
            If this attitude made the rates unusable, the stamp of the end of the last right piece, or -1 without a
            right piece. None otherwise.
        """
        start, here = self._start, _PieceStart(time_ns, number, rotation_nd, integrated)
        if start is None or integrated.run != start.integrated.run:
            self._begin(here)
            return None
        lasted_ns = time_ns - start.time_ns
        if lasted_ns < self._SHORTEST_NS and self.status is not RateStatus.UNPROVEN:
            return None
        attitude = log_rotation(start.rotation_nd.T @ rotation_nd)
        rate = log_rotation(start.integrated.rotation.T @ integrated.rotation)
        turn, difference = max(vector_length(attitude), vector_length(rate)), vector_length(attitude - rate)
        piece_sigma_rad = math.hypot(sigma_rad, step_sigma_rad * math.sqrt(number - start.number))
        if self.status is RateStatus.UNPROVEN:
            piece_sigma_rad = max(piece_sigma_rad, self._FIRST_SIGMA_RAD)
        clear = turn > self._CLEAR_SIGMAS * piece_sigma_rad + self._SLOWEST_RAD_PER_S * lasted_ns * 1e-9
        right = difference <= self._TOLERANCE * turn
        were_usable = self.is_usable
        # Unconfirmed rates may be found wrong after one sample interval. Every other result needs a piece of at least
        # the shortest length.
        if clear and (lasted_ns >= self._SHORTEST_NS or not right):
            size_known = vector_length(attitude) > 0.4 * self._CLEAR_SIGMAS * sigma_rad
            self._evaluate(time_ns, right, attitude, rate, size_known)
        elif lasted_ns < self._LONGEST_NS:
            return None
        self._begin(here)
        if self.is_usable or not were_usable:
            return None
        return -1 if self._right_until_ns is None else self._right_until_ns

    def _begin(self, start: _PieceStart) -> None:
        self._start = start
        self.due_ns = start.time_ns + self._SHORTEST_NS if self.status is not RateStatus.UNPROVEN else 0

    def _evaluate(self, time_ns: int, right: bool, attitude: FloatArray, rate: FloatArray, size_known: bool) -> None:
        """Evaluate a piece with clear rotation; ``size_known`` is true if the attitude alone shows a clear rotation."""
        self._right, self._wrong = (self._right + 1, 0) if right else (0, self._wrong + 1)
        if size_known:
            self._turns.append((attitude, rate))
        if self.is_usable:
            if right:
                self.status, self._right_until_ns = RateStatus.MEASURED, time_ns
            elif self.status is RateStatus.UNPROVEN or self._wrong >= self._WRONG_PIECES:
                self.status = RateStatus.NOT_MEASURED
                self._turns.clear()
        elif self._right >= self._PIECES:
            self.status, self._right_until_ns = RateStatus.MEASURED, time_ns
        elif self.status is RateStatus.NOT_MEASURED and self._in_other_units(list(self._turns), self._PIECES):
            self.status, self._other_units = RateStatus.WRONG_UNITS, 0
        elif self.status is RateStatus.WRONG_UNITS and size_known:
            same = self._in_other_units([(attitude, rate)], 1)
            self._other_units = 0 if same else self._other_units + 1
            if self._other_units >= self._OTHER_UNITS:
                self.status = RateStatus.NOT_MEASURED
                self._turns.clear()
        self.is_usable = self.status in (RateStatus.UNPROVEN, RateStatus.MEASURED)

    def _in_other_units(self, turns: list[tuple[FloatArray, FloatArray]], least: int) -> bool:
        """True if rotations by rates and by attitude have a ratio of about 57.3 or 1/57.3; then set :attr:`slope`."""
        if len(turns) < least:
            return False
        attitude, rate = (np.array(values) for values in zip(*turns, strict=True))
        product, norms = np.sum(attitude * rate), np.sqrt(np.sum(attitude * attitude) * np.sum(rate * rate))
        if not product > self._LEAST_CORRELATION * norms:
            return False
        slope = float(product / np.sum(attitude * attitude))
        factor = max(slope, 1.0 / slope)
        if not self._DEGREES / self._SLOPE_TOLERANCE < factor < self._DEGREES * self._SLOPE_TOLERANCE:
            return False
        self.slope = slope
        return True

"""A guard against angular rates that are well formed but cannot be true: zero, noise, in degrees, about other axes.

The rates integrated over a short piece of motion must give the turn of the attitude. How they differ tells what they
are, and only motion can tell it: at rest the last verdict stands.
"""

import enum
from collections import deque
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation

_SECOND_NS = 1_000_000_000


class Rates(enum.Enum):
    """What the rates of an INS are worth."""

    UNPROVEN = "unproven"
    MEASURED = "measured"
    NOT_MEASURED = "not measured"
    WRONG_UNITS = "wrong units"


class RateIntegrator:
    """The attitude by the rates alone, from an arbitrary start: a witness of motion.

    The mean of two successive rates turns it: for motion of one period the error is a constant small share of the turn.
    """

    _LONGEST_STEP_NS = _SECOND_NS

    def __init__(self) -> None:
        self.rotation = np.eye(3)
        self._last: tuple[int, FloatArray] | None = None

    def advance(self, time_ns: int, rate_d: FloatArray) -> bool:
        """Integrate up to ``time_ns``; False where the step was too long, or backwards, to integrate."""
        last, self._last = self._last, (time_ns, rate_d)
        if last is None or not 0 < time_ns - last[0] <= self._LONGEST_STEP_NS:
            return False
        self.rotation = self.rotation.dot(exp_rotation((last[1] + rate_d) * ((time_ns - last[0]) * 0.5e-9)))
        return True


    def interrupt(self) -> None:
        """The next rate is not joined to the last one."""
        self._last = None


@dataclass(frozen=True)
class _Start:
    """Where a piece of motion begins."""

    time_ns: int
    rotation_nd: FloatArray
    integrated: FloatArray


class RateGuard:
    """Judges the rates of an INS piece by piece.

    A piece is as long as it takes to turn clearly, a quarter of a second at least and two at most; where nothing turns
    it says nothing. Its rates are right where they give the turn of the attitude but for three tenths. While no piece
    was right yet, one that is not is enough to doubt the rates; later it takes two in a row. Twenty right ones in a row
    prove rates that were doubted. Twenty whose rates are 57.3 or 1/57.3 times the turn are in a wrong unit, and four of
    another kind end that.

    Args:
        sigma_rad: noise of an attitude about its worst axis.

    Attributes:
        step_sigma_rad: what each further sample of a piece adds to that, by the noise of its rate.
        rates: the verdict.
        slope: turn by the rates over the turn by the attitude, once the unit is wrong.
        right_until_ns: end of the last piece whose rates were right.
    """

    _SHORTEST_NS = 250_000_000
    _LONGEST_NS = 2 * _SECOND_NS
    _SLOWEST_RAD_PER_S = 72.0 * ARCSEC
    """A turn slower than this is not judged: the Earth's own turn, 15 arcseconds a second, is within the rates of some
    and the bias of others."""
    _CLEAR_SIGMAS = 25.0
    _FIRST_SIGMA_RAD = 36.0 * ARCSEC / np.sqrt(12.0)
    """At the start nobody knows how coarsely the attitude is printed: to a hundredth of a degree, as many are."""
    _TOLERANCE = 0.3
    _PIECES = 20
    _DOUBTS = 2
    _OTHER_UNITS = 4
    _DEGREES = float(np.rad2deg(1.0))
    _SLOPE_TOLERANCE = 1.25
    _LEAST_CORRELATION = 0.9

    def __init__(self, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self.step_sigma_rad = 0.0
        self.rates = Rates.UNPROVEN
        self.slope = 1.0
        self.right_until_ns: int | None = None
        self._start: _Start | None = None
        self._samples = 0
        self._right = 0
        self._wrong = 0
        self._other_units = 0
        self._turns: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=self._PIECES)

    @property
    def usable(self) -> bool:
        """Whether nothing is known against the rates."""
        return self.rates in (Rates.UNPROVEN, Rates.MEASURED)

    def restart(self) -> None:
        """What comes next is not joined to what came before."""
        self._start = None

    def observe(self, time_ns: int, rotation_nd: FloatArray, integrated: FloatArray) -> None:
        """Take an attitude, and what the rates alone make of it.

        Args:
            time_ns: stamp of both.
            rotation_nd: measured attitude, shape (3, 3).
            integrated: attitude by the rates alone, shape (3, 3).
        """
        start = self._start
        self._samples += 1
        if start is None:
            self._begin(_Start(time_ns, rotation_nd, integrated))
            return
        lasted_ns = time_ns - start.time_ns
        if lasted_ns < self._SHORTEST_NS and self.rates is not Rates.UNPROVEN:
            return
        attitude = log_rotation(start.rotation_nd.T @ rotation_nd)
        rate = log_rotation(start.integrated.T @ integrated)
        turn, difference = max(_size(attitude), _size(rate)), _size(attitude - rate)
        sigma_rad = float(np.hypot(self.sigma_rad, self.step_sigma_rad * np.sqrt(self._samples)))
        if self.rates is Rates.UNPROVEN:
            sigma_rad = max(sigma_rad, self._FIRST_SIGMA_RAD)
        clear = turn > self._CLEAR_SIGMAS * sigma_rad + self._SLOWEST_RAD_PER_S * lasted_ns * 1e-9
        right = difference <= self._TOLERANCE * turn
        # Rates that nothing speaks for yet are doubted after one interval; all else takes its time.
        if clear and (lasted_ns >= self._SHORTEST_NS or not right):
            self._judge(time_ns, right, attitude, rate)
        elif lasted_ns < self._LONGEST_NS:
            return
        self._begin(_Start(time_ns, rotation_nd, integrated))

    def _begin(self, start: _Start) -> None:
        self._start, self._samples = start, 0

    def _judge(self, time_ns: int, right: bool, attitude: FloatArray, rate: FloatArray) -> None:
        """Take a piece that turned clearly into account."""
        self._right, self._wrong = (self._right + 1, 0) if right else (0, self._wrong + 1)
        if self._size_known(attitude):
            self._turns.append((attitude, rate))
        if self.usable:
            if right:
                self.rates, self.right_until_ns = Rates.MEASURED, time_ns
            elif self.rates is Rates.UNPROVEN or self._wrong >= self._DOUBTS:
                self.rates = Rates.NOT_MEASURED
                self._turns.clear()
        elif self._right >= self._PIECES:
            self.rates, self.right_until_ns = Rates.MEASURED, time_ns
        elif self.rates is Rates.NOT_MEASURED and self._in_other_units(list(self._turns), self._PIECES):
            self.rates, self._other_units = Rates.WRONG_UNITS, 0
        elif self.rates is Rates.WRONG_UNITS and self._size_known(attitude):
            same = self._in_other_units([(attitude, rate)], 1)
            self._other_units = 0 if same else self._other_units + 1
            if self._other_units >= self._OTHER_UNITS:
                self.rates = Rates.NOT_MEASURED
                self._turns.clear()

    def _size_known(self, attitude: FloatArray) -> bool:
        """Whether the attitude's turn is more than its noise."""
        return _size(attitude) > 0.4 * self._CLEAR_SIGMAS * self.sigma_rad

    def _in_other_units(self, turns: list[tuple[FloatArray, FloatArray]], least: int) -> bool:
        """Whether the rates give the turns of the attitude, but for a factor of about 57.3."""
        if len(turns) < least:
            return False
        attitude, rate = (np.array(values) for values in zip(*turns, strict=True))
        product, size = np.sum(attitude * rate), np.sqrt(np.sum(attitude * attitude) * np.sum(rate * rate))
        if not product > self._LEAST_CORRELATION * size:
            return False
        slope = float(product / np.sum(attitude * attitude))
        factor = max(slope, 1.0 / slope)
        if not self._DEGREES / self._SLOPE_TOLERANCE < factor < self._DEGREES * self._SLOPE_TOLERANCE:
            return False
        self.slope = slope
        return True


def _size(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))

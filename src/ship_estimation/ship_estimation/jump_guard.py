"""Values that jump: one wrong sample is refused, and one that stays is taken after a few that agree among themselves.

Each value is compared with where the last one that was taken leads. :class:`Continuation` says how far it is from there
and how far it may be; :class:`JumpGuard` counts. Of an attitude the integrated rates lead there; without rates, and of
the angles of a mount, the motion goes on as it was, and no faster can it change than a ship or a mount is accelerated.
"""

import enum
import math
from typing import NamedTuple

from ship_geometry.rotations import ARCSEC, FloatArray

JUMP_SAMPLES = 5
"""So many refused samples that agree among themselves are believed, if nothing else is configured."""

_SIGMAS = 7.0
"""At 100 samples a second, good ones must not be refused once in a voyage."""
_TYPICAL = 6.0
_MEMORY = 100
_LEARNING = 20
_UNKNOWN_RAD = math.radians(0.1)
_BIAS_RAD_PER_S = 60.0 * ARCSEC
"""The Earth's own turn, and the bias of a gyroscope."""
_FASTEST_RAD_PER_S = math.radians(60.0)
"""Nothing that floats turns faster: a bound where nothing leads from the last value to this one."""
_ACROSS = 1.8
"""Rounding to steps of one in each of three axes makes errors of up to sqrt(3)."""


class JumpVerdict(enum.Enum):
    """What becomes of a sample."""

    TAKEN = "taken"
    REFUSED = "refused"
    JUMPED = "jumped"


class JumpGuard:
    """Counts samples that contradict the last one taken.

    Args:
        samples: so many refused that agree among themselves, and the next is taken.

    Attributes:
        refused: samples in a row that were refused and agree among themselves.
    """

    def __init__(self, samples: int = JUMP_SAMPLES) -> None:
        self.samples = samples
        self.refused = 0

    def judge(self, continues: bool, agrees: bool) -> JumpVerdict:
        """Judge a sample.

        Args:
            continues: whether it lies where the last one that was taken leads.
            agrees: whether it lies where the sample before leads, taken or not.
        """
        if continues:
            self.refused = 0
            return JumpVerdict.TAKEN
        if self.refused >= self.samples and agrees:
            self.refused = 0
            return JumpVerdict.JUMPED
        self.refused = self.refused + 1 if agrees else 1
        return JumpVerdict.REFUSED


class Step(NamedTuple):
    """The way from one sample to another.

    Attributes:
        seconds: between them.
        samples: of the source between them, this one included: 1 for the next.
        uncertain_rad: error of what leads there by the change of the rates on the way, or by accelerations.
        noise_gain: variance of the difference per variance of a sample's noise.
        coarseness_rad: steps in which the source prints its values; zero where every value is new.
    """

    seconds: float
    samples: int
    uncertain_rad: float
    noise_gain: float
    coarseness_rad: float


class Continuation:
    """How far a value may be from where the one before leads.

    The noise is the configured one or, where it is larger, that of the differences met so far: it holds what rounding,
    the noise of the rates and their integration add.

    Args:
        sigma_rad: noise of a value about its worst axis.
    """

    def __init__(self, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self.forget()

    def forget(self) -> None:
        """Learn the differences anew."""
        self._mean_square = 0.0
        self._count = 0

    @property
    def typical_rad(self) -> float:
        """Root mean square of the differences met so far, one sample apart; zero before there are enough."""
        return math.sqrt(self._mean_square) if self._count >= _LEARNING else 0.0

    def bound_rad(self, step: Step) -> float:
        """How far a good value may be from where the one before leads."""
        typical_rad, gain = self.typical_rad, math.sqrt(step.noise_gain)
        noise = max(_SIGMAS * gain * self.sigma_rad, _TYPICAL * typical_rad)
        more = typical_rad * math.sqrt(step.samples - 1)
        unknown = _UNKNOWN_RAD if self._count < _LEARNING else 0.0
        coarse = _ACROSS * math.sqrt(0.5) * gain * step.coarseness_rad
        return noise + more + unknown + coarse + step.uncertain_rad + _BIAS_RAD_PER_S * step.seconds

    def learn(self, difference: FloatArray) -> None:
        """A value that was taken, one sample after the one before, was so far from where that led."""
        self._count = min(self._count + 1, _MEMORY)
        self._mean_square += (size(difference) ** 2 - self._mean_square) / self._count


def size(vector: FloatArray) -> float:
    """Length of one vector: for a few numbers this takes a fifth of the time of an array's norm."""
    return math.hypot(*vector.tolist())


def within(difference: FloatArray, bound_rad: float) -> bool:
    """Whether a difference is within its bound; NaN is not."""
    return size(difference) <= bound_rad


def far_bound_rad(seconds: float) -> float:
    """How far anything that floats can have turned."""
    return _FASTEST_RAD_PER_S * seconds

"""Two guards for any stream of values: one finds a value that stands still, the other a value that jumps.

**A value that stands still.** A frozen sensor repeats one value to the last bit, and so does a healthy sensor that
prints coarsely while little moves. Other sources, the witnesses, tell the two apart by how far the ship has turned
meanwhile: a healthy value stands no longer than until the turn exceeds the resolution, which the guard learns.

**A value that jumps.** Each value is compared with the place where the earlier values lead. :class:`Continuation` tells
how far a good value may be from there. :class:`JumpGuard` believes a jump after a few refused values that agree.
"""

import enum
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ship_estimation import compiled_watch
from ship_estimation.witnesses import RECENT_NS, TurnWatch, Witness
from ship_geometry.rotations import ARCSEC, FloatArray

JUMP_SAMPLES = 5
"""After so many refused values that agree among themselves a jump is believed, if nothing else is configured."""

ACROSS = 1.8
"""Rounding to steps of one in each of three axes makes errors of up to sqrt(3); this is a little more."""


def size(vector: FloatArray) -> float:
    """Length of one vector: for a few numbers this takes a fifth of the time of an array's norm.

    Example:
        >>> size(np.array([3.0, 4.0, 0.0]))
        5.0
    """
    return math.hypot(*vector.tolist())


_LEAST_NS = 500_000_000
"""A value that stands for less than this is not judged: drivers repeat a value now and then."""
_UNKNOWN_RESOLUTION = np.deg2rad(0.1)
"""Resolution that is assumed before the value has changed at all, rad."""
_STEPS = 64
"""The resolution is the smallest of so many changes of the value."""


class StuckGuard:
    """Finds a source that repeats one value while others say that the ship moves.

    A value is stuck when it has stood for half a second and a witness has turned meanwhile by more than five sigma (the
    noise of witness and source taken together) beyond the resolution of the source. The first other value is taken
    again. If the stuck value returns to the bit within two seconds, the source is still stuck.

    Attributes:
        repeated: whether the last value is equal to the one before it.
        coarseness_rad: steps in which the source prints its values; zero for a source whose every value is new.

    >>> guard = StuckGuard()
    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> said = [Witness(0, np.eye(3), ARCSEC), *(Witness(n * 300_000_000, turned, ARCSEC) for n in (1, 2))]
    >>> [guard.observe(one.time_ns, np.eye(3), ARCSEC, {"another": one}) for one in said]
    [False, False, True]
    """

    def __init__(self) -> None:
        self._held: _Held | None = None
        self._former: _Held | None = None
        self._left_ns = 0
        self._steps: deque[float] = deque(maxlen=_STEPS)
        self._repeated: deque[bool] = deque(maxlen=_STEPS)
        self._resolution_rad = self.coarseness_rad = float(_UNKNOWN_RESOLUTION)
        self.repeated = False

    def is_frozen(self, value: FloatArray) -> bool:
        """Whether a value is the one at which the source is stuck."""
        return self._held is not None and self._held.stuck and _same(value, self._held.value)

    def observe(self, time_ns: int, value: FloatArray, sigma_rad: float, witnesses: Mapping[str, Witness]) -> bool:
        """Take the next value of the source; True where the source is stuck.

        Args:
            time_ns: stamp of the value.
            value: what the source says now: its attitude, shape (3, 3), the directions of its stars, shape (k, 3), or
                its angles, shape (2,).
            sigma_rad: noise of the value about its worst axis.
            witnesses: by name, the attitude as others have it at about this time.
        """
        held = self._held
        if held is not None and _same(value, held.value):
            held.repeats += 1
        else:
            held = self._changed(time_ns, value, witnesses)
        self.repeated = held.repeats > 0
        if self.repeated:
            if held.watch is None:
                held.watch = TurnWatch(held.since_ns, held.first_said)
            turned = held.watch.turned(witnesses, sigma_rad, ACROSS * self._resolution_rad)
            held.stuck = held.stuck or (turned and time_ns - held.since_ns >= _LEAST_NS)
        return held.stuck

    def new_values(self, first_ns: int, values: FloatArray) -> int:
        """Of how many values in a row, from the first one on, it is plain that none stands; the rest is for observe().

        Args:
            first_ns: stamp of the first one.
            values: as in :meth:`observe`, shape (N, 3, 3).
        """
        held = self._held
        if held is None or held.stuck or held.repeats or not self._steps or any(self._repeated):
            return 0
        if self._former is not None and first_ns - self._left_ns <= RECENT_NS:
            return 0
        new = (np.diff(values, axis=0, prepend=held.value[None]) != 0.0).any(axis=(1, 2))
        return len(new) if new.all() else int(np.argmin(new))

    def follow(self, time_ns: int, values: FloatArray, witnesses: Mapping[str, Witness]) -> None:
        """Take values of which none stands (:meth:`new_values`).

        Args:
            time_ns: stamp of the last one.
            values: shape (N, 3, 3), N at least 1.
            witnesses: as in :meth:`observe`, at the last one.
        """
        assert self._held is not None
        newest = values[-_STEPS:]
        before = values[-_STEPS - 1] if len(values) > _STEPS else self._held.value
        self._learn(before, newest)
        self._repeated.extend([False] * min(len(values), _STEPS))
        self.coarseness_rad, self.repeated = 0.0, False
        self._held = _Held(values[-1], time_ns, dict(witnesses))

    def _changed(self, time_ns: int, value: FloatArray, witnesses: Mapping[str, Witness]) -> "_Held":
        """Take a value that differs from the one before: a new value, or the frozen value again."""
        before, former = self._held, self._former
        if former is not None and time_ns - self._left_ns <= RECENT_NS and _same(value, former.value):
            self._held, self._former = former, None
            return former
        if before is not None:
            if before.stuck:
                self._former, self._left_ns = before, time_ns
            else:
                self._repeated.append(before.repeats > 0)
                if before.value.shape == value.shape:
                    self._learn(np.atleast_2d(before.value), value.reshape(1, -1, value.shape[-1]))
                self.coarseness_rad = self._resolution_rad if any(self._repeated) or not self._steps else 0.0
        self._held = _Held(value, time_ns, dict(witnesses))
        return self._held

    def _learn(self, before: FloatArray, values: FloatArray) -> None:
        """Learn the resolution from the changes of values, shape (N, k, l), the first one from that before, (k, l)."""
        # Of rotations and of directions alike: the farthest that one of the axes, or stars, has turned.
        self._steps.extend(filter(math.isfinite, compiled_watch.changes(before, values)))
        if self._steps:
            self._resolution_rad = min(self._steps)


@dataclass
class _Held:
    """A value, since when the source says it, and what the witnesses said then."""

    value: FloatArray
    since_ns: int
    first_said: Mapping[str, Witness]
    repeats: int = 0
    stuck: bool = False
    watch: TurnWatch | None = None


def _same(value: FloatArray, other: FloatArray) -> bool:
    """Whether two values, not empty, are equal to the bit; mostly their first numbers tell that they are not."""
    return bool(value.item(0) == other.item(0)) and np.array_equal(value, other)


_SIGMAS = 7.0
"""At 100 samples a second, good ones must not be refused once in a voyage."""
_TYPICAL = 6.0
"""A good difference is at most so many times the typical one."""
_MEMORY = 100
"""The typical difference is a mean over about so many."""
_LEARNING = 20
"""Before so many differences were met, the typical one is not known and the bound is wider by the next constant."""
_UNKNOWN_RAD = math.radians(0.1)
DRIFT_RAD_PER_S = 60.0 * ARCSEC
"""Rates run away from the attitude by the Earth's own turn, and by the bias of a gyroscope."""
_BOUND_SIGMAS = 3.0
"""A bound on the difference of a good value is at least so many of its sigmas."""


class Step(NamedTuple):
    """What leads from one value to a later one, and how surely.

    Attributes:
        seconds: time between the two values.
        samples: samples of the source between them, the later one included: 1 for the next.
        uncertain_rad: error of the place to which the earlier value leads, by accelerations or changes of the rate.
        noise_gain: variance of the difference per variance of a sample's noise.
        coarseness_rad: steps in which the source prints its values; zero where every value is new.
        drift_rad_per_s: how fast what leads may run away from the values.
    """

    seconds: float
    samples: int
    uncertain_rad: float
    noise_gain: float
    coarseness_rad: float
    drift_rad_per_s: float = DRIFT_RAD_PER_S


def step_by_motion(turned_s: float, seconds: float, max_acceleration: float, coarseness_rad: float) -> Step:
    """The step that is led by the motion between two earlier values, which goes on as before.

    Args:
        turned_s: time between the two earlier values.
        seconds: time from the second of them to the value.
        max_acceleration: how fast the motion may change, rad/s².
        coarseness_rad: as in :class:`Step`.

    Example:
        A second after a turn that took a second, with accelerations up to 2°/s²:

        >>> step = step_by_motion(1.0, 1.0, math.radians(2.0), coarseness_rad=0.0)
        >>> print(f"{math.degrees(step.uncertain_rad):.1f} deg, noise gain {step.noise_gain:.0f}")
        2.0 deg, noise gain 6
    """
    ratio = seconds / turned_s
    uncertain_rad = 0.5 * max_acceleration * seconds * (seconds + turned_s)
    return Step(seconds, 1, uncertain_rad, 1.0 + (1.0 + ratio) ** 2 + ratio**2, coarseness_rad)


class Match(NamedTuple):
    """A value against the place where an earlier value leads.

    Attributes:
        difference: from that place to the value, rad, shape (n,).
        bound_rad: how large the difference may be.
        fits: whether it is within that bound; NaN is not.
        led: False where the value cannot be predicted from the earlier one; then only elapsed time limits the
            difference.
    """

    difference: FloatArray
    bound_rad: float
    fits: bool
    led: bool = True

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the difference about each axis, as far as the bound tells it."""
        return self.bound_rad / _BOUND_SIGMAS

    def fits_again(self, step: "Match") -> bool:
        """Whether the value fits the last value taken although values between were refused.

        The bound widens with time. A value that agrees with the refused one before it must not profit by that: then
        the bound is no wider than that of the last step alone.

        Args:
            step: the same value against the place where the value before it leads, refused or not.
        """
        limit_rad = step.bound_rad if step.fits else math.inf
        return size(self.difference) <= min(self.bound_rad, limit_rad)


class Continuation:
    """How far a value may be from the place where an earlier value leads.

    The noise is the configured one or, where it is larger, that of the differences met so far. These hold what
    rounding, the noise of the rates and their integration add.

    Attributes:
        sigma_rad: noise of a value about its worst axis.
        typical_rad: root mean square of the differences met so far, one sample apart; zero before there are enough.
        noise_rad: how far noise takes a value from the place where the one before leads; infinite before that.

    >>> next_sample = Step(seconds=0.01, samples=1, uncertain_rad=0.0, noise_gain=2.0, coarseness_rad=0.0)
    >>> match = Continuation(sigma_rad=ARCSEC).match(np.array([0.0, 0.001, 0.0]), next_sample)
    >>> match.fits, round(match.bound_rad, 5)
    (True, 0.0018)
    """

    def __init__(self, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self.forget()

    def forget(self) -> None:
        """Learn the differences anew."""
        self.typical_rad = self._mean_square = 0.0
        self.noise_rad = math.inf
        self._count = 0

    def match(self, difference: FloatArray, step: Step, led: bool = True) -> Match:
        """Compare a value with the place to which a step leads; arguments as in :class:`Match`."""
        gain = math.sqrt(step.noise_gain)
        noise = max(_SIGMAS * gain * self.sigma_rad, _TYPICAL * self.typical_rad)
        more = self.typical_rad * math.sqrt(step.samples - 1)
        unknown = _UNKNOWN_RAD if self._count < _LEARNING else 0.0
        coarse = ACROSS * math.sqrt(0.5) * gain * step.coarseness_rad
        bound_rad = noise + more + unknown + coarse + step.uncertain_rad + step.drift_rad_per_s * step.seconds
        return Match(difference, bound_rad, size(difference) <= bound_rad, led)

    def know(self, typical_rad: float) -> None:
        """Go on with a typical difference that is known from many values."""
        self._mean_square, self._count = typical_rad**2, _MEMORY
        self._set_typical()

    def learn(self, difference: FloatArray) -> None:
        """Learn from a value that was taken, one sample after the one before: how far it was from its place."""
        self._count = min(self._count + 1, _MEMORY)
        self._mean_square += (size(difference) ** 2 - self._mean_square) / self._count
        if self._count >= _LEARNING:
            self._set_typical()

    def _set_typical(self) -> None:
        self.typical_rad = math.sqrt(self._mean_square)
        self.noise_rad = max(_SIGMAS * math.sqrt(2.0) * self.sigma_rad, _TYPICAL * self.typical_rad)


class JumpVerdict(enum.Enum):
    """What becomes of a value."""

    TAKEN = "taken"
    REFUSED = "refused"
    JUMPED = "jumped"


class JumpGuard:
    """Counts values that contradict the last value taken.

    Args:
        samples: after so many refused values that agree among themselves, the next is believed.

    Attributes:
        refused: number of values in a row that were refused and agree among themselves.
        since_ns: stamp of the first of them.

    >>> guard = JumpGuard(samples=2)
    >>> [guard.judge(n, continues=False, agrees=n > 0).value for n in range(3)]
    ['refused', 'refused', 'jumped']
    """

    def __init__(self, samples: int = JUMP_SAMPLES) -> None:
        self.samples = samples
        self.refused = 0
        self.since_ns = 0

    def judge(self, time_ns: int, continues: bool, agrees: bool) -> JumpVerdict:
        """Judge a value.

        Args:
            time_ns: stamp of the value.
            continues: whether it lies where the last value taken leads.
            agrees: whether it lies where the value before leads, taken or not.
        """
        if continues:
            self.refused = 0
            return JumpVerdict.TAKEN
        if self.refused >= self.samples and agrees:
            self.refused = 0
            return JumpVerdict.JUMPED
        self.refused = self.refused + 1 if agrees else 1
        if self.refused == 1:
            self.since_ns = time_ns
        return JumpVerdict.REFUSED

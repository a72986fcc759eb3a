"""A guard against inputs that are well formed but cannot be true: frozen sensors.

A frozen sensor repeats one value to the last bit. So does a healthy one that prints coarsely while little moves. What
tells them apart is how far others say that the ship has turned meanwhile: a healthy value stands no longer than until
the turn exceeds its own resolution, and that is learnt from the steps in which it changes.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray, log_rotation

_LEAST_NS = 500_000_000
"""A value that stands for less is not judged: drivers repeat one now and then."""
_RECENT_NS = 2_000_000_000
"""A witness is compared with what it said since this long before; told within this time of motion."""
_APART_NS = 250_000_000
"""Between two memories of a witness."""
_SIGMAS = 5.0
_UNKNOWN_RESOLUTION = np.deg2rad(0.1)
"""Before the value has changed at all, rad."""
_STEPS = 64
"""Changes of the value of which the smallest is the resolution."""
_TWICE = 2
_ACROSS = 1.8
"""Rounding to steps of one in each of three axes hides a turn of up to sqrt(3), and a little."""


class Witness(NamedTuple):
    """What another source says of the ship's attitude.

    Attributes:
        time_ns: when it was so.
        rotation: the attitude, in any constant frame, shape (3, 3).
        sigma_rad: its noise about its worst axis.
        drift_rad_per_s: how fast its attitude may run away from the true one: that of integrated rates does.
    """

    time_ns: int
    rotation: FloatArray
    sigma_rad: float
    drift_rad_per_s: float = 0.0


class _Testimony:
    """What one witness said while a value stood.

    Args:
        first: the first that it said.
    """

    def __init__(self, first: Witness) -> None:
        self._first = self._last = first
        self._recent: deque[Witness] = deque([first])
        self._moved = 0

    def add(self, now: Witness, sigma_rad: float, resolution_rad: float) -> bool:
        """True where twice running it has turned by more than the value's and its own noise, drift and resolution.

        Twice: a witness that is asked for hours is five sigma off now and then.
        """
        if now.time_ns > self._last.time_ns:
            moved = any(_moved(then, now, sigma_rad, resolution_rad) for then in (self._first, *self._recent))
            self._moved = self._moved + 1 if moved else 0
            self._last = now
            if now.time_ns - self._recent[-1].time_ns >= _APART_NS:
                self._recent.append(now)
            while now.time_ns - self._recent[0].time_ns > _RECENT_NS:
                self._recent.popleft()
        return self._moved >= _TWICE


@dataclass
class _Standing:
    """A value, since when it stands, and what witnesses said meanwhile."""

    value: FloatArray
    since_ns: int
    repeats: int = 0
    stuck: bool = False
    testimonies: dict[str, _Testimony] = field(default_factory=dict)


class StuckGuard:
    """Finds a source that repeats one value while others say that the ship moves.

    Stuck is a value that has stood for half a second while a witness turned by more than five sigma, its own noise
    and the source's taken together, beyond the source's resolution. The first other value is taken again; one that
    returns to the bit within two seconds never was gone.

    Args:
        sigma_rad: noise of the source about its worst axis.
    """

    def __init__(self, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self._standing: _Standing | None = None
        self._former: _Standing | None = None
        self._left_ns = 0
        self._steps: deque[float] = deque(maxlen=_STEPS)
        self._repeated: deque[bool] = deque(maxlen=_STEPS)
        self._resolution_rad = self._coarseness_rad = float(_UNKNOWN_RESOLUTION)

    @property
    def stands(self) -> bool:
        """Whether the last value is the one before it."""
        return self._standing is not None and self._standing.repeats > 0

    @property
    def resolution_rad(self) -> float:
        """Smallest step of the value: it is not printed more coarsely than so."""
        return self._resolution_rad

    @property
    def coarseness_rad(self) -> float:
        """The same of a source that healthily repeats values; zero for one whose every value is new."""
        return self._coarseness_rad

    def is_frozen(self, value: FloatArray) -> bool:
        """Whether a value is the one at which the source is stuck."""
        return self._standing is not None and self._standing.stuck and _same(value, self._standing.value)

    def observe(self, time_ns: int, value: FloatArray, witnesses: dict[str, Witness]) -> bool:
        """True where the source is stuck.

        Args:
            time_ns: stamp of the value.
            value: what it says now: its attitude, shape (3, 3), the directions of its stars, or its angles.
            witnesses: by name, the attitude as others have it at about this time.
        """
        standing = self._standing
        if standing is not None and _same(value, standing.value):
            standing.repeats += 1
        else:
            standing = self._changed(time_ns, value)
        if self._turned(standing, witnesses) and time_ns - standing.since_ns >= _LEAST_NS:
            standing.stuck = True
        return standing.stuck

    def _changed(self, time_ns: int, value: FloatArray) -> _Standing:
        """Another value than before: a new one, or the frozen one again."""
        before, former = self._standing, self._former
        if former is not None and time_ns - self._left_ns <= _RECENT_NS and _same(value, former.value):
            self._standing, self._former = former, None
            return former
        if before is not None:
            if before.stuck:
                self._former, self._left_ns = before, time_ns
            else:
                self._repeated.append(before.repeats > 0)
                self._learn(before.value, value)
                self._coarseness_rad = self._resolution_rad if any(self._repeated) or not self._steps else 0.0
        self._standing = _Standing(value, time_ns)
        return self._standing

    def _learn(self, before: FloatArray, value: FloatArray) -> None:
        if before.shape == value.shape:
            # Of rotations and of directions alike: the farthest that one of the axes, or stars, has turned.
            rows = (value - before).tolist()
            sizes = [math.hypot(*row) for row in (rows if value.ndim > 1 else [rows])]
            if math.isfinite(sum(sizes)):
                self._steps.append(max(sizes))
                self._resolution_rad = min(self._steps)

    def _turned(self, standing: _Standing, witnesses: dict[str, Witness]) -> bool:
        """Whether a witness has turned too far for the value to stand."""
        turned = False
        for name, now in witnesses.items():
            # What it said before the value stood still says nothing of the time since.
            if now.time_ns < standing.since_ns:
                continue
            testimony = standing.testimonies.get(name)
            if testimony is None:
                standing.testimonies[name] = _Testimony(now)
                continue
            turned = testimony.add(now, self.sigma_rad, _ACROSS * self.resolution_rad) or turned
        return turned


def _same(value: FloatArray, other: FloatArray) -> bool:
    """Whether two values, not empty, are equal to the bit; mostly their first numbers tell that they are not."""
    return bool(value.item(0) == other.item(0)) and np.array_equal(value, other)


def _moved(then: Witness, now: Witness, sigma_rad: float, resolution_rad: float) -> bool:
    noise_rad = np.hypot(sigma_rad, np.hypot(then.sigma_rad, now.sigma_rad))
    drift_rad = now.drift_rad_per_s * (now.time_ns - then.time_ns) * 1e-9
    bound = _SIGMAS * noise_rad + drift_rad + resolution_rad
    return bool(np.linalg.norm(log_rotation(then.rotation.T @ now.rotation)) > bound)

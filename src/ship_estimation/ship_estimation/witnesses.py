"""What other sources say of the ship's motion while one source repeats its value, and whether that is a turn."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray, log_rotation

RECENT_NS = 2_000_000_000
"""A witness is compared with what it said up to this long before. Motion is told within this time."""
_APART_NS = 250_000_000
"""Time between two memories of a witness."""
_SIGMAS = 5.0
_TWICE = 2


class Witness(NamedTuple):
    """What another source says of the ship's attitude.

    Attributes:
        time_ns: moment of that attitude.
        rotation: the attitude, in any constant frame, shape (3, 3).
        sigma_rad: its noise about its worst axis.
        drift_rad_per_s: how fast the source may run away from the truth, as integrated rates do.
    """

    time_ns: int
    rotation: FloatArray
    sigma_rad: float
    drift_rad_per_s: float = 0.0


class TurnWatch:
    """Tells when one of the witnesses has turned while a value stood.

    Args:
        since_ns: since when the value stands. What a witness said of an earlier moment says nothing of the time since.
        first_said: by name, what the witnesses said when the value came.

    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> watch = TurnWatch(0, {"another": Witness(0, np.eye(3), sigma_rad=1e-5)})
    >>> [watch.turned({"another": Witness(time_ns, turned, 1e-5)}, 1e-5, 0.0) for time_ns in (1, 2)]
    [False, True]
    """

    def __init__(self, since_ns: int, first_said: Mapping[str, Witness]) -> None:
        self._since_ns = since_ns
        self._records: dict[str, _Record] = {}
        self.turned(first_said, 0.0, 0.0)

    def turned(self, witnesses: Mapping[str, Witness], sigma_rad: float, resolution_rad: float) -> bool:
        """Whether a witness has turned too far for the value to stand.

        Args:
            witnesses: by name, what the witnesses say now.
            sigma_rad: noise of the value that stands, about its worst axis.
            resolution_rad: the largest turn that the value cannot show.
        """
        turned = False
        for name, now in witnesses.items():
            if now.time_ns < self._since_ns:
                continue
            if name not in self._records:
                self._records[name] = _Record(now)
            turned = self._records[name].add(now, sigma_rad, resolution_rad) or turned
        return turned


class _Record:
    """What one witness said while a value stood.

    Args:
        first: the first attitude that the witness gave.
    """

    def __init__(self, first: Witness) -> None:
        self._first = self._last = first
        self._recent: deque[Witness] = deque([first])
        self._moved = 0

    def add(self, now: Witness, sigma_rad: float, resolution_rad: float) -> bool:
        """Take what the witness says now; True where it has turned, in two attitudes running.

        A turn is more than five sigma of all noise, the drift of the witness and the resolution of the value. It takes
        two in a row because a witness that is asked for hours is five sigma off now and then. An attitude that is no
        later than the last one says nothing new.
        """
        if now.time_ns > self._last.time_ns:
            moved = any(_moved(then, now, sigma_rad, resolution_rad) for then in (self._first, *self._recent))
            self._moved = self._moved + 1 if moved else 0
            self._last = now
            if now.time_ns - self._recent[-1].time_ns >= _APART_NS:
                self._recent.append(now)
            while now.time_ns - self._recent[0].time_ns > RECENT_NS:
                self._recent.popleft()
        return self._moved >= _TWICE


def _moved(then: Witness, now: Witness, sigma_rad: float, resolution_rad: float) -> bool:
    noise_rad = np.hypot(sigma_rad, np.hypot(then.sigma_rad, now.sigma_rad))
    drift_rad = now.drift_rad_per_s * (now.time_ns - then.time_ns) * 1e-9
    bound_rad = _SIGMAS * noise_rad + drift_rad + resolution_rad
    return bool(np.linalg.norm(log_rotation(then.rotation.T @ now.rotation)) > bound_rad)

"""Motion check, which detects by other sources that the ship rotated while one source repeated its value."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray, log_rotation

HISTORY_NS = 2_000_000_000
"""Maximum age of the recent attitudes of a reference that are compared with the current attitude, ns.

The first attitude is always compared."""
_SPACING_NS = 250_000_000
"""Spacing of the attitudes in a history, ns."""
_SIGMAS = 5.0
_REPEATS = 2


class MotionReference(NamedTuple):
    """The ship's attitude by another source.

    Attributes:
        time_ns: time of the attitude.
        rotation: attitude relative to any constant frame, shape (3, 3).
        sigma_rad: standard deviation of the attitude noise about the worst axis.
        drift_rad_per_s: bound of the attitude drift, for example of integrated rates.
    """

    time_ns: int
    rotation: FloatArray
    sigma_rad: float
    drift_rad_per_s: float = 0.0


class MotionCheck:
    """Detects that a motion reference has rotated while a source repeated its value.

    Args:
        since_ns: stamp since which the value is repeated; earlier reference attitudes are ignored.
        first_references: reference attitudes when the value first appeared, by name.

    >>> turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> watch = MotionCheck(0, {"another": MotionReference(0, np.eye(3), sigma_rad=1e-5)})
    >>> [watch.has_turned({"another": MotionReference(time_ns, turned, 1e-5)}, 1e-5, 0.0) for time_ns in (1, 2)]
    [False, True]
    """

    def __init__(self, since_ns: int, first_references: Mapping[str, MotionReference]) -> None:
        self._since_ns = since_ns
        self._records: dict[str, _ReferenceHistory] = {}
        self.has_turned(first_references, 0.0, 0.0)

    def has_turned(
        self, motion_references: Mapping[str, MotionReference], sigma_rad: float, resolution_rad: float
    ) -> bool:
        """True if two successive attitudes of a reference show a rotation that would change a healthy source's value.

        Args:
            motion_references: current reference attitudes, by name.
            sigma_rad: standard deviation of the noise of the repeated value about the worst axis.
            resolution_rad: largest rotation that the value cannot resolve.
        """
        turned = False
        for name, now in motion_references.items():
            if now.time_ns < self._since_ns:
                continue
            if name not in self._records:
                self._records[name] = _ReferenceHistory(now)
            turned = self._records[name].add(now, sigma_rad, resolution_rad) or turned
        return turned


class _ReferenceHistory:
    """Attitudes of one reference while a value is repeated.

    Args:
        first: the first attitude of the reference.
    """

    def __init__(self, first: MotionReference) -> None:
        self._first = self._last = first
        self._recent: deque[MotionReference] = deque([first])
        self._turn_count = 0

    def add(self, now: MotionReference, sigma_rad: float, resolution_rad: float) -> bool:
        """Add the current attitude; return True if two successive attitudes show a rotation.

        A rotation exceeds five sigma of all noise plus the drift of the reference and the resolution of the value. Two
        successive attitudes are required, because over hours single attitudes exceed five sigma. An attitude that is
        not later than the last attitude is ignored.
        """
        if now.time_ns > self._last.time_ns:
            moved = any(_has_turned(then, now, sigma_rad, resolution_rad) for then in (self._first, *self._recent))
            self._turn_count = self._turn_count + 1 if moved else 0
            self._last = now
            if now.time_ns - self._recent[-1].time_ns >= _SPACING_NS:
                self._recent.append(now)
            while now.time_ns - self._recent[0].time_ns > HISTORY_NS:
                self._recent.popleft()
        return self._turn_count >= _REPEATS


def _has_turned(then: MotionReference, now: MotionReference, sigma_rad: float, resolution_rad: float) -> bool:
    noise_rad = np.hypot(sigma_rad, np.hypot(then.sigma_rad, now.sigma_rad))
    drift_rad = now.drift_rad_per_s * (now.time_ns - then.time_ns) * 1e-9
    bound_rad = _SIGMAS * noise_rad + drift_rad + resolution_rad
    return bool(np.linalg.norm(log_rotation(then.rotation.T @ now.rotation)) > bound_rad)

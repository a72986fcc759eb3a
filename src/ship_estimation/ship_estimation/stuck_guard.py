"""A guard against inputs that are well formed but cannot be true: frozen sensors."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, log_rotation


@dataclass(frozen=True)
class Witness:
    """What another source says of the ship's attitude.

    Attributes:
        rotation: the attitude, in any constant frame, shape (3, 3).
        sigma_rad: its noise about its worst axis.
    """

    rotation: FloatArray
    sigma_rad: float


class StuckGuard:
    """Finds a source that repeats one value while others say that the ship moves.

    Stuck after ``count`` identical values during which a witness turned by more than five sigma, its own noise
    and the source's taken together; well again after ``count`` changing ones.

    Args:
        sigma_rad: noise of the source about its worst axis.
        count: identical, then changing values.
    """

    _SIGMAS = 5.0

    def __init__(self, sigma_rad: float, count: int = 20) -> None:
        self._sigma_rad = sigma_rad
        self._count = count
        self._value: FloatArray | None = None
        self._identical = 0
        self._changing = 0
        self._witnessed: dict[str, Witness] = {}
        self._moved = False
        self.stuck = False

    def observe(self, value: FloatArray, witnesses: dict[str, Witness]) -> bool:
        """True where the source is stuck.

        Args:
            value: what it says now: its attitude, shape (3, 3), or the directions of its stars.
            witnesses: by name, the attitude now as others have it.
        """
        if self._value is not None and np.array_equal(value, self._value):
            self._identical += 1
            self._changing = 0
            self._witness(witnesses)
        else:
            self._value, self._witnessed, self._moved = value, dict(witnesses), False
            self._identical = 0
            self._changing += 1
        if self._identical >= self._count - 1 and self._moved:
            self.stuck = True
        elif self.stuck and self._changing >= self._count:
            self.stuck = False
        return self.stuck

    def _witness(self, witnesses: dict[str, Witness]) -> None:
        for name, now in witnesses.items():
            start = self._witnessed.setdefault(name, now)
            sigma_rad = np.hypot(self._sigma_rad, np.hypot(start.sigma_rad, now.sigma_rad))
            turn = log_rotation(start.rotation.T @ now.rotation)
            if np.linalg.norm(turn) > self._SIGMAS * sigma_rad:
                self._moved = True

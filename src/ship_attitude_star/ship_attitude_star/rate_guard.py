"""A guard against rates that are well formed but cannot be true: in degrees."""

from collections import deque

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation


class RateIntegrator:
    """The attitude by the rates alone, from an arbitrary start: a witness of motion."""

    _LONGEST_STEP_NS = 250_000_000

    def __init__(self) -> None:
        self.rotation = np.eye(3)
        self._last_ns: int | None = None

    def advance(self, time_ns: int, rate_d: FloatArray) -> bool:
        """Integrate up to ``time_ns``; False where the step was too long, or backwards, to integrate."""
        previous_ns, self._last_ns = self._last_ns, time_ns
        if previous_ns is None or not 0 < time_ns - previous_ns <= self._LONGEST_STEP_NS:
            return False
        self.rotation = self.rotation @ exp_rotation(rate_d * ((time_ns - previous_ns) * 1e-9))
        return True


class RateUnitsGuard:
    """Finds angular rates in degrees per second (or attitudes in degrees) by integrating the rates.

    Over ``window_s`` the turns by the attitudes and by the rates are compared in short chunks; a slope near
    57.3 or 1/57.3 with a clear correlation means a wrong unit.
    """

    _CHUNK_NS = 250_000_000
    _DEGREES = float(np.rad2deg(1.0))
    _SLOPE_TOLERANCE = 1.25
    _LEAST_CORRELATION = 0.9

    def __init__(self, window_s: float = 5.0) -> None:
        self._chunks: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=round(window_s * 1e9 / self._CHUNK_NS))
        self._start: tuple[int, FloatArray, FloatArray] | None = None
        self.wrong = False
        self.slope = 1.0

    def restart(self, time_ns: int, rotation_nd: FloatArray, integrated: FloatArray) -> None:
        """Begin a chunk here: what came before is not joined to it."""
        self._start = (time_ns, rotation_nd, integrated)

    def observe(self, time_ns: int, rotation_nd: FloatArray, integrated: FloatArray) -> bool:
        """True where attitude and rate contradict one another by a factor of about 57.3.

        Args:
            time_ns: stamp of both.
            rotation_nd: measured attitude, shape (3, 3).
            integrated: attitude by the rates alone, shape (3, 3).
        """
        if self._start is None:
            self.restart(time_ns, rotation_nd, integrated)
            return self.wrong
        start_ns, start_rotation, start_integrated = self._start
        if time_ns - start_ns >= self._CHUNK_NS:
            by_attitude = log_rotation(start_rotation.T @ rotation_nd)
            self._chunks.append((by_attitude, log_rotation(start_integrated.T @ integrated)))
            self.restart(time_ns, rotation_nd, integrated)
            self.wrong = self._contradict()
        return self.wrong

    def _contradict(self) -> bool:
        if len(self._chunks) < (self._chunks.maxlen or 0):
            return False
        attitude, rate = (np.array(values) for values in zip(*self._chunks, strict=True))
        size_attitude, size_rate = np.sum(attitude * attitude), np.sum(rate * rate)
        product = np.sum(attitude * rate)
        if product <= self._LEAST_CORRELATION * np.sqrt(size_attitude * size_rate):
            return False
        self.slope = float(product / size_attitude)
        factor = max(self.slope, 1.0 / self.slope)
        return self._DEGREES / self._SLOPE_TOLERANCE < factor < self._DEGREES * self._SLOPE_TOLERANCE

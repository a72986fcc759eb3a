"""Does the mount move on as a mass can? Readings that would take a larger acceleration are wrong, or have slipped."""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.jump_guard import Continuation, JumpGuard, JumpVerdict, Step, within
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.measured.samples import EncoderSample

_LONGEST_STEP_S = 1.0
_BOUND_SIGMAS = 3.0


@dataclass(frozen=True)
class EncoderJump:
    """Encoders that have slipped for good: since then they read differently where the axis points.

    Attributes:
        time_ns: just before the first reading after it.
        jump: of azimuth and elevation, rad, shape (2,).
        sigma_rad: how far each may be off itself.
    """

    time_ns: int
    jump: FloatArray
    sigma_rad: float

    def content(self) -> bytes:
        """All values as bytes."""
        return self.jump.tobytes()


@dataclass(frozen=True)
class _Way:
    """Where two readings lead, and where a third one is."""

    difference: FloatArray
    bound_rad: float

    @property
    def kept(self) -> bool:
        """Whether it is there."""
        return within(self.difference, self.bound_rad)

    def text(self) -> str:
        """Why the third one is not believed."""
        size, bound = np.linalg.norm(self.difference) / ARCSEC, self.bound_rad / ARCSEC
        return f"{size:.0f}″ from where the readings before lead: more than {bound:.0f}″, which the mount can reach"


class EncoderJumps:
    """Compares each reading with where the two before lead: by its second difference.

    Args:
        sigma_rad: noise of a reading.
        max_acceleration: of an axis, rad/s².
    """

    def __init__(self, sigma_rad: float, max_acceleration: float) -> None:
        self._guard = JumpGuard()
        self._continuation = Continuation(sigma_rad)
        self.reconfigure(sigma_rad, max_acceleration)
        self._refused_from_ns = 0
        self.forget()

    def reconfigure(self, sigma_rad: float, max_acceleration: float) -> None:
        """Go on with another noise and another mount."""
        self._continuation.sigma_rad, self._max_acceleration = sigma_rad, max_acceleration

    def forget(self) -> None:
        """What comes next is not compared with what came before."""
        self._taken: list[EncoderSample] = []
        self._all: list[EncoderSample] = []

    def judge(self, sample: EncoderSample, coarseness_rad: float) -> tuple[JumpVerdict, EncoderJump | None, str]:
        """What becomes of a reading later than all before; with the jump where it is one, and why where it is refused.

        Args:
            sample: the reading.
            coarseness_rad: steps in which the encoders read; zero where every reading is new.
        """
        way, step = self._way(self._taken, sample, coarseness_rad), self._way(self._all, sample, coarseness_rad)
        self._all = [*self._all[-1:], sample]
        agrees = step is None or step.kept
        # With the time the bound widens: one that agrees with refused ones before it must not profit by that.
        limit_rad = step.bound_rad if step is not None and step.kept else np.inf
        kept = way is None or within(way.difference, min(way.bound_rad, limit_rad))
        after_refused = self._guard.refused > 0
        judged = self._guard.judge(kept, agrees)
        jump = None
        if judged is JumpVerdict.REFUSED:
            assert way is not None
            if self._guard.refused == 1:
                self._refused_from_ns = sample.time_ns
                self._all = [_moved_back(sample, *self._taken), sample]
            return judged, None, way.text()
        if judged is JumpVerdict.JUMPED:
            assert way is not None
            jump = EncoderJump(self._refused_from_ns - 1, way.difference, way.bound_rad / _BOUND_SIGMAS)
        elif way is not None and not after_refused:
            self._continuation.learn(way.difference)
        self._taken = list(self._all) if jump is not None else [*self._taken[-1:], sample]
        return judged, jump, ""

    def refusal(self, sample: EncoderSample, before: list[EncoderSample], coarseness_rad: float) -> str:
        """Why a reading that comes after later ones is wrong, by the two before it in time; empty where it is not."""
        way = self._way(before, sample, coarseness_rad)
        return "" if way is None or way.kept else way.text()

    def watched(self, time_ns: int) -> bool:
        """Whether a reading of this stamp or a later one was judged already."""
        return bool(self._all) and time_ns <= self._all[-1].time_ns

    def _way(self, before: list[EncoderSample], sample: EncoderSample, coarseness_rad: float) -> _Way | None:
        """None where there are no two readings to lead there, or too long ago."""
        if len(before) < 2:
            return None
        first, second = before
        turned_s, seconds = (second.time_ns - first.time_ns) * 1e-9, (sample.time_ns - second.time_ns) * 1e-9
        if max(turned_s, seconds) > _LONGEST_STEP_S:
            return None
        ratio = seconds / turned_s
        difference = _short(sample.vector - second.vector - ratio * _short(second.vector - first.vector))
        uncertain_rad = 0.5 * self._max_acceleration * seconds * (seconds + turned_s)
        step = Step(seconds, 1, uncertain_rad, 1.0 + (1.0 + ratio) ** 2 + ratio**2, coarseness_rad)
        return _Way(difference, self._continuation.bound_rad(step))


def _moved_back(sample: EncoderSample, first: EncoderSample, second: EncoderSample) -> EncoderSample:
    """Where the axis would have read before a reading, had it moved as it did from ``first`` to ``second``.

    After a slip this leads to the next reading.
    """
    ratio = (sample.time_ns - second.time_ns) / (second.time_ns - first.time_ns)
    return replace(second, vector=sample.vector - ratio * _short(second.vector - first.vector))


def _short(angles: FloatArray) -> FloatArray:
    """Angles the short way round."""
    wrapped: FloatArray = angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi))
    return wrapped

"""The watch over the encoders.

It refuses readings that cannot be true, believes a jump that lasts, and doubts what comes after until lights have
confirmed it.

A theodolite at rest reads the same for hours, and so does one that is stuck. The lights tell the two
apart: when they say that the telescope has turned in the deck, the encoders are stuck. Readings that stopped dead in
the midst of a motion are in doubt. A reading that the mount could reach only with a larger acceleration than it has is
wrong; a few such readings that agree among themselves are a slip of the encoders. A smaller step in place
(:mod:`theodolite_calib.measured.encoder_steps`) is in doubt until lights have confirmed it; where the mount could not
have moved and stopped between two readings, it is a slip.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_estimation.unconfirmed import Unconfirmed
from ship_estimation.value_guards import (
    Continuation,
    JumpGuard,
    JumpVerdict,
    Match,
    StuckGuard,
    size,
    step_by_motion,
)
from ship_estimation.witnesses import Witness
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.measured.encoder_steps import EncoderStep, EncoderSteps, short_way
from theodolite_calib.measured.samples import EncoderSample

_LIGHTS = "lights"
"""Name of the lights as a witness."""
_SIGMAS = 5.0
"""A motion of more than so many sigmas of a reading, from one reading to the next, is surely one."""
_LONGEST_STEP_S = 1.0
"""Readings that are further apart are not compared."""
_LARGEST_ELEVATION = 3.0 * np.pi
"""Largest elevation reading in radians: half a turn, counted a turn too far. Azimuths are taken modulo a turn."""
_SURE_AFTER = 20
"""Readings in a row beyond the largest elevation after which the unit is wrong; within it, after which it is right."""


@dataclass(frozen=True)
class EncoderJump:
    """Encoders that have slipped for good: since then they read differently where the axis points.

    Attributes:
        time_ns: just before the first reading after the slip.
        jump: of azimuth and elevation, rad, shape (2,).
        sigma_rad: standard deviation of each of the two.
    """

    time_ns: int
    jump: FloatArray
    sigma_rad: float


class JudgedReading(NamedTuple):
    """What is to be done with a reading.

    Attributes:
        refusal: why the reading is not used; None where it is.
        jump: the slip that is believed with this reading, used or not; None where there is none.
    """

    refusal: Refusal | None = None
    jump: EncoderJump | None = None


class EncoderWatch:
    """Watches the readings of one run in the order of their stamps.

    Args:
        sigma_rad: noise of a reading; an arcsecond where it is less.
        max_acceleration: that the mount can reach, rad/s².
    """

    def __init__(self, sigma_rad: float, max_acceleration: float) -> None:
        self._stuck, self._jumps, self._continuation = StuckGuard(), JumpGuard(), Continuation(sigma_rad)
        # Two readings that lead to the next: the last two taken, and the last two whether taken or not. In a healthy
        # run these are the same.
        self._taken: tuple[EncoderSample, ...] = ()
        self._all: tuple[EncoderSample, ...] = ()
        self._last: tuple[EncoderSample, FloatArray] | None = None
        self._newest_ns: int | None = None
        self._wrong_unit, self._otherwise = False, 0
        self._still_since_ns: int | None = None
        self._in_doubt_since_ns: int | None = None
        self._unconfirmed: Unconfirmed | None = None
        self._steps = EncoderSteps()
        self._stepped: tuple[int, float] | None = None
        self._witnesses: dict[str, Witness] = {}
        self.reconfigure(sigma_rad, max_acceleration)

    def reconfigure(self, sigma_rad: float, max_acceleration: float) -> None:
        """Go on with another noise and another mount."""
        self._continuation.sigma_rad = self._sigma_rad = max(sigma_rad, ARCSEC)
        self._max_acceleration = max_acceleration

    @property
    def doubt(self) -> str:
        """Why the readings are in doubt until a light has confirmed them; empty where they are not."""
        if self._unconfirmed is not None:
            return self._unconfirmed.text
        if self._in_doubt_since_ns is not None:
            return "the encoders stopped dead in a motion: at rest, or stuck"
        if self._stepped is not None:
            return f"the encoders have stepped by {self._stepped[1] / ARCSEC:.0f}″, and no light has confirmed it since"
        if self._steps.off_rad:
            return "the encoders are not where the readings before lead: moved, or slipped"
        return ""

    @property
    def doubt_rad(self) -> float:
        """By so much the readings may be wrong about each axis, as a standard deviation, beside their noise."""
        return math.hypot(self._steps.off_rad, 0.0 if self._stepped is None else self._stepped[1])

    def judge(
        self, sample: EncoderSample, track: VectorTrack[EncoderSample], late: Refusal | None = None
    ) -> JudgedReading:
        """Judge a reading.

        Args:
            sample: the reading.
            track: those taken so far; by these a reading is judged that comes after later ones.
            late: the refusal of a reading that comes too late; None where it does not. Its unit is judged all the same.
        """
        refusal = self._units_refusal(sample, counts=late is None) or late
        if refusal is not None:
            return JudgedReading(refusal)
        if self._newest_ns is not None and sample.time_ns <= self._newest_ns:
            match = self._match(_before(track, sample.time_ns), sample)
            return JudgedReading(None if match is None or match.fits else _gate_refusal(match))
        self._newest_ns = sample.time_ns
        judged = self._judge_jump(sample)
        if judged.refusal is not None:
            return judged
        if judged.jump is not None:
            self._unconfirmed = Unconfirmed(judged.jump.time_ns, "the encoders have jumped", "lights")
            self._steps.restart()
        step = self._steps.observe(sample.time_ns, sample.vector, self._sigma_rad, self._stuck.coarseness_rad)
        if step is not None:
            judged = self._judge_step(step)
        self._watch_motion(sample)
        if self._stuck.observe(sample.time_ns, sample.vector, self._sigma_rad, self._witnesses):
            # After a freeze the reading cannot be extrapolated.
            self._taken = self._all = ()
            self._steps.restart()
            self._unconfirmed = Unconfirmed(sample.time_ns, "the encoders were stuck", "lights")
            text = "both encoders stand still while the lights say that the telescope turns in the deck"
            return JudgedReading(Refusal(Reason.STUCK, text))
        return judged

    def see_lights(self, time_ns: int, telescope_dt: FloatArray, sigma_rad: float) -> None:
        """The telescope in the deck as lights had it at a moment, shape (3, 3), with the error about its worst axis."""
        # Before the readings stood still the telescope may well have turned.
        if self._still_since_ns is not None and time_ns >= self._still_since_ns:
            self._witnesses[_LIGHTS] = Witness(time_ns, telescope_dt, sigma_rad)

    def confirm(self, time_ns: int) -> None:
        """Lights at a moment agreed with the readings of that moment."""
        if self._in_doubt_since_ns is not None and time_ns > self._in_doubt_since_ns:
            self._in_doubt_since_ns = None
        if self._unconfirmed is not None:
            self._unconfirmed = self._unconfirmed.after_agreement(time_ns)
        self.believe_lights(time_ns)

    def believe_lights(self, time_ns: int) -> None:
        """Lights at a moment told where the encoders are, be they right or wrong: a step before it is known."""
        if self._stepped is not None and time_ns > self._stepped[0]:
            self._stepped = None

    def _units_refusal(self, sample: EncoderSample, counts: bool) -> Refusal | None:
        """Return the refusal of a reading that cannot be in radians; None where it can.

        A run of such readings shows that the unit is wrong: then all are refused until a run of others has come.
        """
        azimuth, elevation = sample.vector.tolist()
        beyond = not abs(elevation) <= _LARGEST_ELEVATION
        if counts:
            self._otherwise = self._otherwise + 1 if beyond is not self._wrong_unit else 0
            if self._otherwise >= _SURE_AFTER:
                self._wrong_unit, self._otherwise = beyond, 0
        if not (beyond or self._wrong_unit):
            return None
        text = f"azimuth {azimuth:.6g}, elevation {elevation:.6g}: expected radians, elevation within a turn; degrees?"
        return Refusal(Reason.UNITS, text)

    def _judge_jump(self, sample: EncoderSample) -> JudgedReading:
        """Judge a reading later than all before by where the two readings before lead."""
        match = self._match(self._taken, sample)
        step = match if self._all is self._taken else self._match(self._all, sample)
        fits = match is None or (match.fits if step is None else match.fits_again(step))
        after_refused = self._jumps.refused > 0
        verdict = self._jumps.judge(sample.time_ns, fits, step is None or step.fits)
        if verdict is JumpVerdict.REFUSED:
            assert match is not None
            first_refused = self._jumps.refused == 1
            self._all = (_moved_back(sample, *self._taken) if first_refused else self._all[-1], sample)
            return JudgedReading(_gate_refusal(match))
        healthy = self._all is self._taken
        self._all = (*self._all[-1:], sample)
        if verdict is JumpVerdict.JUMPED:
            assert match is not None
            self._taken = self._all
            return JudgedReading(jump=EncoderJump(self._jumps.since_ns - 1, match.difference, match.sigma_rad))
        self._taken = self._all if healthy else (*self._taken[-1:], sample)
        if match is not None and not after_refused:
            self._continuation.learn(match.difference)
        return JudgedReading()

    def _judge_step(self, step: EncoderStep) -> JudgedReading:
        """Judge the reading that proves a step in place."""
        step_rad = size(step.step)
        # From rest to rest: half of the way with all acceleration there is, and half of it braking.
        reached_rad = 0.25 * self._max_acceleration * step.within_s**2
        if not step.sure_rad > reached_rad:
            before_rad = 0.0 if self._stepped is None else self._stepped[1]
            self._stepped = step.time_ns, math.hypot(before_rad, step_rad)
            return JudgedReading()
        self._unconfirmed = Unconfirmed(step.time_ns, "the encoders have jumped", "lights")
        text = f"{step_rad / ARCSEC:.0f}″ off in one step: more than {reached_rad / ARCSEC:.0f}″, as the mount can"
        return JudgedReading(Refusal(Reason.GATE, text), EncoderJump(step.time_ns, step.step, step.sigma_rad))

    def _match(self, before: tuple[EncoderSample, ...], sample: EncoderSample) -> Match | None:
        """A reading against the place where two before it lead; None where there are not two, or too long ago."""
        if len(before) < 2:
            return None
        first, second = before
        turned_s, seconds = (second.time_ns - first.time_ns) * 1e-9, (sample.time_ns - second.time_ns) * 1e-9
        if max(turned_s, seconds) > _LONGEST_STEP_S:
            return None
        going_on = seconds / turned_s * short_way(second.vector - first.vector)
        difference = short_way(sample.vector - second.vector - going_on)
        step = step_by_motion(turned_s, seconds, self._max_acceleration, self._stuck.coarseness_rad)
        return self._continuation.match(difference, step)

    def _watch_motion(self, sample: EncoderSample) -> None:
        """Doubt begins with a reading equal to the last one although that one had moved."""
        if self._last is None:
            self._last, self._still_since_ns = (sample, np.zeros(2)), sample.time_ns
            return
        last, rate = self._last
        step = short_way(sample.vector - last.vector)
        interval_s = (sample.time_ns - last.time_ns) * 1e-9
        if step.any():
            self._witnesses, self._still_since_ns, self._in_doubt_since_ns = {}, sample.time_ns, None
        elif np.abs(rate).max() * interval_s > _SIGMAS * self._sigma_rad and self._in_doubt_since_ns is None:
            self._in_doubt_since_ns = sample.time_ns
        self._last = sample, step / interval_s


def _before(track: VectorTrack[EncoderSample], time_ns: int) -> tuple[EncoderSample, ...]:
    """Up to two readings before a moment."""
    found: tuple[EncoderSample, ...] = ()
    while len(found) < 2:
        sample = track.last_before(time_ns - 1)
        if sample is None:
            break
        found = (sample, *found)
        time_ns = sample.time_ns
    return found


def _moved_back(sample: EncoderSample, first: EncoderSample, second: EncoderSample) -> EncoderSample:
    """The reading at the time of ``second``, extrapolated back from ``sample``.

    The axis moves as it did from ``first`` to ``second``. After a slip, the next reading is predicted with it.
    """
    ratio = (sample.time_ns - second.time_ns) / (second.time_ns - first.time_ns)
    return replace(second, vector=sample.vector - ratio * short_way(second.vector - first.vector))


def _gate_refusal(match: Match) -> Refusal:
    off, bound = size(match.difference) / ARCSEC, match.bound_rad / ARCSEC
    text = f"{off:.0f}″ from where the readings before lead: more than {bound:.0f}″, which the mount can reach"
    return Refusal(Reason.GATE, text)

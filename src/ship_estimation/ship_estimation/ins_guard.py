"""The guard of an INS's samples: frozen, contradicted by its own rates, or with rates that are none.

It watches the samples in the order of their stamps. Its verdict on the rates decides what they are used for: rates that
are not measured are left out of the samples, and what was taken with them before is named, so that it can be mended.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ship_estimation.ins_continuation import InsContinuation, Known, Way, moved_back
from ship_estimation.jump_guard import JumpGuard, JumpVerdict, within
from ship_estimation.rate_guard import RateGuard, Rates
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC, FloatArray

_DRIFT_RAD_PER_S = 60.0 * ARCSEC
"""Integrated rates run away from the attitude by the Earth's turn and their bias."""
_STUCK = Refusal(Reason.STUCK, "orientation stands still while other sources move")
_BOUND_SIGMAS = 3.0
"""A bound on how far a sample may be from where the ones before lead is that many sigmas, at least."""


@dataclass(frozen=True)
class InsJump:
    """An attitude of the INS that has jumped for good.

    Attributes:
        time_ns: just before the first sample after it.
        jump_n: the jump, rotation vector in the horizon frame, rad, shape (3,).
        sigma_rad: how far it may be off itself, about each axis.
        source: ``ins``; with what follows, what every measurement in the log of a filter has.
        covariance_known: of a jump it is.
    """

    time_ns: int
    jump_n: FloatArray
    sigma_rad: float
    source: str = "ins"
    covariance_known: bool = True

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of what the INS's slow error may have become by it, rad², shape (3, 3).

        Along the jump; about every axis what is not known of it and, as two large turns do not commute, its square.
        """
        across_rad = math.hypot(self.sigma_rad, 0.5 * float(self.jump_n @ self.jump_n))
        covariance_n: FloatArray = np.outer(self.jump_n, self.jump_n) + across_rad**2 * np.eye(3)
        return covariance_n

    def content(self) -> bytes:
        """All values as bytes."""
        return self.jump_n.tobytes()


class JudgedIns(NamedTuple):
    """What is to be done with a sample.

    Attributes:
        sample: as it may be used: without rates where these are not measured.
        refusal: why it is not used; None where it is.
        jump: where its attitude has jumped and is believed.
        rates_wrong_after_ns: stamp after which the rates of samples taken before are no rates; None where nothing new
            is known of them.
    """

    sample: AttitudeSample
    refusal: Refusal | None = None
    jump: InsJump | None = None
    rates_wrong_after_ns: int | None = None


class InsGuard:
    """Judges the samples of one INS.

    Args:
        sigma_rad: noise of an attitude about its worst axis; an arcsecond where it is less.
        jump_samples: so many refused ones that agree among themselves, and the next is believed.
    """

    def __init__(self, sigma_rad: float, jump_samples: int) -> None:
        self._stuck = StuckGuard(sigma_rad)
        self._rates = RateGuard(sigma_rad)
        self._leads = InsContinuation(sigma_rad, self._stuck, self._rates)
        self._jumps = JumpGuard(jump_samples)
        self._previous: Known | None = None
        self._taken: Known | None = None
        self._smooth_since_taken = True
        self._jumped_ns = 0
        self.reconfigure(sigma_rad, jump_samples)

    def reconfigure(self, sigma_rad: float, jump_samples: int) -> None:
        """Go on with another noise."""
        self._sigma_rad = max(sigma_rad, ARCSEC)
        self._stuck.sigma_rad = self._sigma_rad
        self._leads.reconfigure(self._sigma_rad)
        self._jumps.samples = jump_samples

    @property
    def sigma_rad(self) -> float:
        """Noise of an attitude about its worst axis, rounding included."""
        return math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))

    @property
    def rates(self) -> Rates:
        """What the rates are worth."""
        return self._rates.rates

    def witness(self) -> Witness | None:
        """How the ship moves by the rates alone."""
        if self._previous is None or self._previous.integrated is None or not self._rates.usable:
            return None
        return Witness(self._previous.sample.time_ns, self._previous.integrated, 0.0, _DRIFT_RAD_PER_S)

    def watched(self, time_ns: int) -> bool:
        """Whether a sample of this stamp or a later one was judged already."""
        return self._previous is not None and time_ns <= self._previous.sample.time_ns

    def check(self, sample: AttitudeSample, witnesses: dict[str, Witness]) -> JudgedIns:
        """Judge a sample later than all before."""
        previous, known = self._previous, self._leads.known(self._previous, sample)
        self._previous = known
        if previous is None or known.leg != previous.leg:
            self._rates.restart()
        by_rates = self.witness()
        if by_rates is not None:
            witnesses = {**witnesses, "rate": by_rates}
        if self._stuck.observe(sample.time_ns, sample.rotation_nd, witnesses):
            self._rates.restart()
            self._smooth_since_taken = False
            return JudgedIns(self.usable(sample), _STUCK)
        if self._taken is None or previous is None:
            self._take(known, None)
            return JudgedIns(self.usable(sample))
        return self._compare(self._taken, previous, known)

    def check_late(self, sample: AttitudeSample, before: AttitudeSample | None) -> JudgedIns:
        """Judge a sample that comes after later ones, by the one before it in time."""
        refusal = None
        if self._stuck.is_frozen(sample.rotation_nd):
            refusal = _STUCK
        elif self._rates.rates is Rates.WRONG_UNITS:
            refusal = self._units_refusal()
        elif before is not None:
            way = self._leads.between(before, sample)
            refusal = None if way.kept else way.refusal()
        return JudgedIns(self.usable(sample), refusal)

    def usable(self, sample: AttitudeSample) -> AttitudeSample:
        """A sample without rates where these are not measured."""
        return sample if self._rates.usable or sample.rate_d is None else replace(sample, rate_d=None)

    def _compare(self, taken: Known, previous: Known, known: Known) -> JudgedIns:
        """Judge a sample by the last one taken and the one before it."""
        way = self._leads.way(taken, known)
        step = way if previous is taken else self._leads.way(previous, known)
        kept = way.kept if step is way else self._returns(taken, known, way, step)
        if not kept:
            smooth = self._smooth_since_taken and self._leads.moved(previous, known).kept
            self._smooth_since_taken = smooth
            # Rates that lose their trust have had the attitudes refused that they contradict.
            kept = smooth and not self._leads.rates_trusted
        judged = self._jumps.judge(kept, step.kept)
        wrong_after_ns = self._judge_rates(previous, known)
        if judged is JumpVerdict.REFUSED:
            if self._jumps.refused == 1:
                self._jumped_ns = known.sample.time_ns
                self._previous = known.moved_by(moved_back(known.sample, taken))
            return JudgedIns(self.usable(known.sample), way.refusal(), None, wrong_after_ns)
        jump = None
        if judged is JumpVerdict.JUMPED:
            jump = InsJump(self._jumped_ns - 1, way.difference_n, way.bound_rad / _BOUND_SIGMAS)
        elif step is way:
            self._leads.learn(taken, known, way)
        self._take(known, taken if jump is None else None)
        refusal = self._units_refusal() if self._rates.rates is Rates.WRONG_UNITS else None
        return JudgedIns(self.usable(known.sample), refusal, jump, wrong_after_ns)

    def _returns(self, taken: Known, known: Known, way: Way, step: Way) -> bool:
        """Whether a sample after refused ones is where the last one taken leads.

        With the time the bound widens. One that agrees with the refused one before it must not profit by that.
        """
        limit_rad = step.bound_rad if step.kept else math.inf
        # The rates of refused samples between may be as wrong as their attitudes.
        direct = self._leads.between(taken.sample, known.sample)
        ways = [way, direct] if direct.led else [way]
        return any(within(one.difference_n, min(one.bound_rad, limit_rad)) for one in ways)

    def _judge_rates(self, previous: Known, known: Known) -> int | None:
        """Let the rates be judged where the attitude can be true; the stamp after which they are wrong."""
        if known.leg != previous.leg or known.integrated is None or self._stuck.stands:
            return None
        if not self._leads.within_reach(previous.sample, known.sample):
            self._rates.restart()
            return None
        usable = self._rates.usable
        self._rates.sigma_rad, self._rates.step_sigma_rad = self.sigma_rad, self._leads.rate_noise_rad
        self._rates.observe(known.sample.time_ns, known.sample.rotation_nd, known.integrated)
        if not usable or self._rates.usable:
            return None
        self._leads.forget_rates()
        return -1 if self._rates.right_until_ns is None else self._rates.right_until_ns

    def _take(self, known: Known, before: Known | None) -> None:
        self._taken = known.moved_by(None if before is None else before.sample)
        if self._previous is known:
            self._previous = self._taken
        self._smooth_since_taken = True

    def _units_refusal(self) -> Refusal:
        text = (
            f"angular velocity turns {self._rates.slope:.3g} times as fast as the orientation: "
            "degrees for radians? ins/imu must be in rad/s"
        )
        return Refusal(Reason.UNITS, text)

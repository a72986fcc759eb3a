"""The guard of an INS's samples: frozen, contradicted by its own rates, or with rates that are none.

It watches the samples in the order of their stamps. Its verdict on the rates decides what they are used for: rates that
are not measured are left out of the samples, and what was taken with them before is named, so that it can be mended.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_attitude_star.rate_guard import RateGuard, RateIntegrator, Rates
from ship_estimation.jump_guard import Continuation, Judged, JumpGuard, Step, far_bound_rad, within
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.stuck_guard import StuckGuard, Witness
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation

_DRIFT_RAD_PER_S = 60.0 * ARCSEC
"""Integrated rates run away from the attitude by the Earth's turn and their bias."""
_LARGEST_ACCELERATION = np.deg2rad(60.0)
"""Of a hull: a small craft that rolls by 30 degrees in five seconds comes to 47 degrees per second squared."""
_STUCK = Refusal(Reason.STUCK, "orientation stands still while other sources move")
_LONGEST_STEP_S = 1.0
_BOUND_SIGMAS = 3.0
"""A bound on how far a sample may be from where the ones before lead is that many sigmas, at least."""
_CHANGE_SHARE = 0.25
"""Of the change of the rate over a step, times its time: what the mean of two rates may miss of the turn."""
_SHORTEST_PERIOD_S = 4.0
"""Of a hull's motion: the mean of two rates then gives the turn but for (2 pi h / period)² / 12 of it."""


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

    def content(self) -> bytes:
        """All values as bytes."""
        return self.jump_n.tobytes()


@dataclass(frozen=True)
class JudgedIns:
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


@dataclass(frozen=True)
class _Known:
    """A sample and what led to it.

    Attributes:
        sample: itself.
        number: of all samples.
        before: the one that tells how it moves; None where there is none.
        integrated: attitude by the rates alone at its stamp; None where it has no rate.
        leg: which unbroken run of rates it belongs to.
        missed_rad: what the integration may have missed since that began.
    """

    sample: AttitudeSample
    number: int
    before: AttitudeSample | None
    integrated: FloatArray | None
    leg: int
    missed_rad: float


@dataclass(frozen=True)
class _Way:
    """Where an earlier sample leads, and where the later one is.

    Attributes:
        difference_n: of the later one from there, rotation vector in the horizon frame, rad, shape (3,).
        bound_rad: how large that may be.
        led: whether something led there, and not only the time that has passed.
    """

    difference_n: FloatArray
    bound_rad: float
    led: bool = True

    @property
    def kept(self) -> bool:
        """Whether the later sample is where the earlier one leads."""
        return within(self.difference_n, self.bound_rad)

    def refusal(self) -> Refusal:
        """Why the later sample is not believed."""
        size, bound = np.rad2deg([float(np.linalg.norm(self.difference_n)), self.bound_rad])
        text = f"orientation is {size:.3g}° from where the samples before lead: more than {bound:.3g}°"
        return Refusal(Reason.GATE, text)


class InsGuard:
    """Judges the samples of one INS.

    Args:
        sigma_rad: noise of an attitude about its worst axis; an arcsecond where it is less.
        jump_samples: so many refused ones that agree among themselves, and the next is believed.
    """

    def __init__(self, sigma_rad: float, jump_samples: int) -> None:
        self._stuck = StuckGuard(sigma_rad)
        self._rates = RateGuard(sigma_rad)
        self._integrator = RateIntegrator()
        self._jumps = JumpGuard(jump_samples)
        self._by_rates, self._by_motion = Continuation(sigma_rad), Continuation(sigma_rad)
        self._previous: _Known | None = None
        self._taken: _Known | None = None
        self._smooth_since_taken = True
        self._jumped_ns = 0
        self.reconfigure(sigma_rad, jump_samples)

    def reconfigure(self, sigma_rad: float, jump_samples: int) -> None:
        """Go on with another noise."""
        self._sigma_rad = max(sigma_rad, ARCSEC)
        self._stuck.sigma_rad = self._by_rates.sigma_rad = self._by_motion.sigma_rad = self._sigma_rad
        self._jumps.samples = jump_samples

    @property
    def sigma_rad(self) -> float:
        """Noise of an attitude about its worst axis, rounding included."""
        return float(np.hypot(self._sigma_rad, self._stuck.coarseness_rad / np.sqrt(12.0)))

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
        previous, known = self._previous, self._known(sample)
        self._previous = known
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
            way = self._between(before, sample)
            refusal = None if way.kept else way.refusal()
        return JudgedIns(self.usable(sample), refusal)

    def usable(self, sample: AttitudeSample) -> AttitudeSample:
        """A sample without rates where these are not measured."""
        return sample if self._rates.usable or sample.rate_d is None else replace(sample, rate_d=None)

    def _compare(self, taken: _Known, previous: _Known, known: _Known) -> JudgedIns:
        """Judge a sample by the last one taken and the one before it."""
        way = self._way(taken, known)
        step = way if previous is taken else self._way(previous, known)
        kept = way.kept if step is way else self._returns(taken, known, way, step)
        if not kept:
            smooth = self._smooth_since_taken and self._moved(previous, known).kept
            self._smooth_since_taken = smooth
            # Rates that lose their trust have had the attitudes refused that they contradict.
            kept = smooth and not self._trusted
        judged = self._jumps.judge(kept, step.kept)
        wrong_after_ns = self._judge_rates(previous, known)
        if judged is Judged.REFUSED:
            if self._jumps.refused == 1:
                self._jumped_ns = known.sample.time_ns
                self._previous = replace(known, before=_moved_back(known.sample, taken))
            return JudgedIns(self.usable(known.sample), way.refusal(), None, wrong_after_ns)
        jump = None
        if judged is Judged.JUMPED:
            jump = InsJump(self._jumped_ns - 1, way.difference_n, way.bound_rad / _BOUND_SIGMAS)
        elif step is way:
            self._learn(taken, known, way)
        self._take(known, taken if jump is None else None)
        refusal = self._units_refusal() if self._rates.rates is Rates.WRONG_UNITS else None
        return JudgedIns(self.usable(known.sample), refusal, jump, wrong_after_ns)

    def _returns(self, taken: _Known, known: _Known, way: _Way, step: _Way) -> bool:
        """Whether a sample after refused ones is where the last one taken leads.

        With the time the bound widens. One that agrees with the refused one before it must not profit by that.
        """
        limit_rad = step.bound_rad if step.kept else np.inf
        # The rates of refused samples between may be as wrong as their attitudes.
        direct = self._between(taken.sample, known.sample)
        ways = [way, direct] if direct.led else [way]
        return any(within(one.difference_n, min(one.bound_rad, limit_rad)) for one in ways)

    # -- what leads to a sample -----------------------------------------------------------------------------

    @property
    def _trusted(self) -> bool:
        return self._rates.rates is Rates.MEASURED

    def _known(self, sample: AttitudeSample) -> _Known:
        previous = self._previous
        if sample.rate_d is None:
            self._integrator.interrupt()
        joined = sample.rate_d is not None and self._integrator.advance(sample.time_ns, sample.rate_d)
        if not joined:
            self._rates.restart()
        integrated = None if sample.rate_d is None else self._integrator.rotation
        if previous is None:
            return _Known(sample, 0, None, integrated, 0, 0.0)
        missed_rad = previous.missed_rad + _missed_rad(previous.sample, sample) if joined else 0.0
        leg = previous.leg if joined else previous.leg + 1
        return _Known(sample, previous.number + 1, previous.sample, integrated, leg, missed_rad)

    def _way(self, start: _Known, end: _Known) -> _Way:
        """The way by the rates of all samples between or, where these do not lead there, by the motion before."""
        if not self._trusted or start.leg != end.leg:
            return self._moved(start, end)
        return self._led(start, end, end.number - start.number, end.missed_rad - start.missed_rad)

    def _led(self, start: _Known, end: _Known, samples: int, missed_rad: float) -> _Way:
        """The way by the integrated rates."""
        assert start.integrated is not None
        assert end.integrated is not None
        predicted_nd = start.sample.rotation_nd @ start.integrated.T @ end.integrated
        step = Step(_seconds(start.sample, end.sample), samples, missed_rad, 2.0, self._stuck.coarseness_rad)
        return _Way(log_rotation(end.sample.rotation_nd @ predicted_nd.T), self._by_rates.bound_rad(step))

    def _moved(self, start: _Known, end: _Known) -> _Way:
        """The way by going on as before; where that is too long, only the time bounds it."""
        seconds, before = _seconds(start.sample, end.sample), start.before
        turned_s = 0.0 if before is None else _seconds(before, start.sample)
        if before is None or max(seconds, turned_s) > _LONGEST_STEP_S:
            return self._far(start.sample, end.sample)
        ratio = seconds / turned_s
        turn_d = ratio * log_rotation(before.rotation_nd.T @ start.sample.rotation_nd)
        difference_n = log_rotation(end.sample.rotation_nd @ (start.sample.rotation_nd @ exp_rotation(turn_d)).T)
        uncertain_rad = 0.5 * _LARGEST_ACCELERATION * seconds * (seconds + turned_s)
        gain = 1.0 + (1.0 + ratio) ** 2 + ratio**2
        step = Step(seconds, 1, uncertain_rad, gain, self._stuck.coarseness_rad)
        return _Way(difference_n, self._by_motion.bound_rad(step))

    def _between(self, start: AttitudeSample, end: AttitudeSample) -> _Way:
        """The way by the rates of two samples alone."""
        seconds = _seconds(start, end)
        if not self._trusted or start.rate_d is None or end.rate_d is None or seconds > _LONGEST_STEP_S:
            return self._far(start, end)
        predicted_nd = start.rotation_nd @ exp_rotation((0.5 * seconds) * (start.rate_d + end.rate_d))
        step = Step(seconds, 1, _missed_rad(start, end), 2.0, self._stuck.coarseness_rad)
        return _Way(log_rotation(end.rotation_nd @ predicted_nd.T), self._by_rates.bound_rad(step))

    def _far(self, start: AttitudeSample, end: AttitudeSample) -> _Way:
        """The way that a hull may have turned in the time."""
        seconds = _seconds(start, end)
        step = Step(seconds, 1, far_bound_rad(seconds), 2.0, self._stuck.coarseness_rad)
        difference_n = log_rotation(end.rotation_nd @ start.rotation_nd.T)
        return _Way(difference_n, self._by_motion.bound_rad(step), led=False)

    # -- what follows ---------------------------------------------------------------------------------------

    def _judge_rates(self, previous: _Known, known: _Known) -> int | None:
        """Let the rates be judged where the attitude can be true; the stamp after which they are wrong."""
        if known.leg != previous.leg or known.integrated is None or self._stuck.stands:
            return None
        if not self._far(previous.sample, known.sample).kept:
            self._rates.restart()
            return None
        usable = self._rates.usable
        self._rates.sigma_rad, self._rates.step_sigma_rad = self.sigma_rad, self._by_rates.typical_rad / np.sqrt(6.0)
        self._rates.observe(known.sample.time_ns, known.sample.rotation_nd, known.integrated)
        if not usable or self._rates.usable:
            return None
        self._by_rates.forget()
        return -1 if self._rates.right_until_ns is None else self._rates.right_until_ns

    def _learn(self, taken: _Known, known: _Known, way: _Way) -> None:
        """How far good samples are from where the ones before lead."""
        if self._trusted:
            if taken.leg == known.leg:
                self._by_rates.learn(way.difference_n)
            return
        if way.led:
            self._by_motion.learn(way.difference_n)
        if self._rates.usable and taken.leg == known.leg and known.integrated is not None:
            self._by_rates.learn(self._led(taken, known, 1, 0.0).difference_n)

    def _take(self, known: _Known, before: _Known | None) -> None:
        self._taken = replace(known, before=None if before is None else before.sample)
        if self._previous is known:
            self._previous = self._taken
        self._smooth_since_taken = True

    def _units_refusal(self) -> Refusal:
        text = (
            f"angular velocity turns {self._rates.slope:.3g} times as fast as the orientation: "
            "degrees for radians? ins/imu must be in rad/s"
        )
        return Refusal(Reason.UNITS, text)


def _moved_back(sample: AttitudeSample, taken: _Known) -> AttitudeSample | None:
    """Where the deck would have been before a sample, had it moved as it did before the last sample that was taken.

    After a jump this leads to the next sample.
    """
    if taken.before is None:
        return None
    ratio = _seconds(taken.sample, sample) / _seconds(taken.before, taken.sample)
    turn_d = ratio * log_rotation(taken.before.rotation_nd.T @ taken.sample.rotation_nd)
    return replace(taken.sample, rotation_nd=sample.rotation_nd @ exp_rotation(-turn_d))


def _seconds(first: AttitudeSample, second: AttitudeSample) -> float:
    return (second.time_ns - first.time_ns) * 1e-9


def _missed_rad(first: AttitudeSample, second: AttitudeSample) -> float:
    """What the mean of two rates may miss of the turn between them, rad."""
    assert first.rate_d is not None
    assert second.rate_d is not None
    seconds = _seconds(first, second)
    change = float(np.linalg.norm(second.rate_d - first.rate_d))
    mean = 0.5 * float(np.linalg.norm(second.rate_d + first.rate_d))
    share = (2.0 * np.pi * seconds / _SHORTEST_PERIOD_S) ** 2 / 12.0
    return seconds * (_CHANGE_SHARE * change + share * mean)

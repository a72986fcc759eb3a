"""The guard of an INS's samples. It tells a frozen INS, an attitude that jumps, and rates that are none.

The guard watches the samples in the order of their stamps. Each attitude is compared with the place where those before
lead: by the rates where these are proven, otherwise by the motion before, otherwise by what a hull can turn in the
time. Rates that are not measured are left out of the samples; what was taken with them before is named, so that it can
be mended.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from ship_estimation.ins import GuardedInsConfig, InsJump
from ship_estimation.rate_guard import Integrated, RateGuard, Rates, missed_by_mean_rad
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.value_guards import (
    Continuation,
    JumpGuard,
    JumpVerdict,
    Match,
    Step,
    StuckGuard,
    size,
    step_by_motion,
)
from ship_estimation.witnesses import Witness
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation

_DRIFT_RAD_PER_S = 60.0 * ARCSEC
"""Integrated rates run away from the attitude by the Earth's turn and their bias."""
_STUCK = Refusal(Reason.STUCK, "orientation stands still while other sources move")
_LARGEST_ACCELERATION = math.radians(60.0)
"""Of a hull, rad/s²: a small craft that rolls by 30 degrees in five seconds comes to 47 degrees per second squared."""
_FASTEST_RAD_PER_S = math.radians(60.0)
"""Nothing that floats turns faster: the limit used when no rate predicts the next attitude."""
_LONGEST_STEP_S = 1.0


class JudgedIns(NamedTuple):
    """What is to be done with a sample.

    Attributes:
        sample: the sample as it may be used: without its rate where the rates are not measured.
        refusal: why the sample is not used; None where it is.
        jump: the jump of the attitude that is believed with this sample; None where there is none.
        rates_wrong_after_ns: stamp after which the rates of samples taken before are no rates; None where nothing new
            is known of them.
    """

    sample: AttitudeSample
    refusal: Refusal | None = None
    jump: InsJump | None = None
    rates_wrong_after_ns: int | None = None


class _Seen(NamedTuple):
    """A sample as the guard has seen it.

    Attributes:
        sample: the sample itself.
        number: its number among all samples.
        before: the sample that tells how the deck moves at this one; None where there is none.
        integrated: attitude by the rates alone at its stamp; None where it has no rate.
    """

    sample: AttitudeSample
    number: int
    before: AttitudeSample | None
    integrated: Integrated | None


class InsGuard:
    """Judges the samples of one INS.

    Args:
        config: noise of the INS, and after how many refused samples a jump is believed.

    Attributes:
        noise_rad: noise of an attitude about its worst axis, rounding included.
        by_rates: attitude by the rates alone at the last sample, as a witness for the guards of other sources; None
            where the sample has no rate or the rates are not to be believed.

    >>> guard, used = InsGuard(GuardedInsConfig()), AttitudeTrack(max_gap_ns=500_000_000)
    >>> for ms, heading_deg in ((0, 10.0), (10, 10.01), (20, 10.02), (30, 55.0)):
    ...     attitude = exp_rotation([0.0, math.radians(heading_deg), 0.0])
    ...     judged = guard.judge(AttitudeSample(ms * 1_000_000, attitude), used, {})
    >>> judged.refusal.reason.name
    'GATE'
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self._stuck, self._rates, self._jumps = StuckGuard(), RateGuard(), JumpGuard()
        self._by_rates, self._by_motion = Continuation(0.0), Continuation(0.0)
        self._previous: _Seen | None = None
        self._taken: _Seen | None = None
        # Whether each sample since the last one taken goes on with the motion before it.
        self._smooth_since_taken = True
        self._told_rad = 0.0
        self.by_rates: Witness | None = None
        self.reconfigure(config)

    def reconfigure(self, config: GuardedInsConfig) -> None:
        """Go on with another noise, an arcsecond at least."""
        self._sigma_rad = max(config.white_sigma_arcsec * ARCSEC, ARCSEC)
        self._by_rates.sigma_rad = self._by_motion.sigma_rad = self._sigma_rad
        self._jumps.samples = config.jump_samples
        self.noise_rad = math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))

    @property
    def rates(self) -> Rates:
        """What the rates are worth."""
        return self._rates.rates

    def judge(
        self, sample: AttitudeSample, used: AttitudeTrack, witnesses: Mapping[str, Witness], told_rad: float = 0.0
    ) -> JudgedIns:
        """Judge a sample by those before it in time.

        The guards watch the stream in order. A sample that comes after later ones is judged by its neighbour alone.

        Args:
            sample: the sample.
            used: the samples used so far.
            witnesses: by name, the attitude as other sources have it at about this time.
            told_rad: by so much the source itself says that it may have stepped with this sample.
        """
        self._told_rad = told_rad
        previous = self._previous
        if previous is not None and sample.time_ns <= previous.sample.time_ns:
            judged = JudgedIns(sample, self._late_refusal(sample, used.last_before(sample.time_ns - 1)))
        else:
            judged = self._judge_next(sample, previous, witnesses)
        if self._rates.usable or sample.rate_d is None:
            return judged
        return judged._replace(sample=replace(sample, rate_d=None))

    def _judge_next(
        self, sample: AttitudeSample, previous: _Seen | None, witnesses: Mapping[str, Witness]
    ) -> JudgedIns:
        """Judge a sample later than all before."""
        integrated = self._rates.integrate(sample.time_ns, sample.rate_d)
        number, before = (0, None) if previous is None else (previous.number + 1, previous.sample)
        self._previous = seen = _Seen(sample, number, before, integrated)
        self.by_rates = None
        if integrated is not None and self._rates.usable:
            self.by_rates = Witness(sample.time_ns, integrated.rotation, 0.0, _DRIFT_RAD_PER_S)
            witnesses = {**witnesses, "rate": self.by_rates}
        stuck = self._stuck.observe(sample.time_ns, sample.rotation_nd, self._sigma_rad, witnesses)
        self.noise_rad = math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))
        if stuck:
            self._rates.restart()
            self._smooth_since_taken = False
            return JudgedIns(sample, _STUCK)
        if self._taken is None or previous is None:
            self._take(seen, None)
            return JudgedIns(sample)
        return self._compare(self._taken, previous, seen)

    def _compare(self, taken: _Seen, previous: _Seen, seen: _Seen) -> JudgedIns:
        """Judge a sample by the last one taken and the one before it."""
        match = self._match(taken, seen)
        step = match if previous is taken else self._match(previous, seen)
        fits = match.fits
        if step is not match:
            # The rates of refused samples between may be as wrong as their attitudes.
            direct = self._match_by_two_rates(taken.sample, seen.sample)
            fits = match.fits_again(step) or (direct.led and direct.fits_again(step))
        if not fits:
            smooth = self._smooth_since_taken and self._match_by_motion(previous, seen).fits
            self._smooth_since_taken = smooth
            # Trusted rates refuse the attitudes that they contradict. Once the rates have lost their trust these
            # attitudes are right after all, provided that each of them went on with the motion before it.
            fits = smooth and self._rates.rates is not Rates.MEASURED
        verdict = self._jumps.judge(seen.sample.time_ns, fits, step.fits)
        if verdict is JumpVerdict.REFUSED:
            if self._jumps.refused == 1:
                self._previous = seen._replace(before=_moved_back(seen.sample, taken))
            wrong_after_ns = self._judge_rates(previous, seen)
            return JudgedIns(seen.sample, _gate_refusal(match), None, wrong_after_ns)
        jump = None
        if verdict is JumpVerdict.JUMPED:
            jump = InsJump(self._jumps.since_ns - 1, match.difference, match.sigma_rad)
        self._take(seen, taken if jump is None else None)
        one_run = _one_run(taken.integrated, seen.integrated)
        wrong_after_ns = self._judge_rates(previous, seen)
        # How far good samples are from the place where those before lead is learnt from steps of one sample.
        if jump is None and step is match:
            if self._rates.rates is not Rates.MEASURED:
                self._learn_unproven(taken, seen, match, one_run)
            elif one_run:
                self._by_rates.learn(match.difference)
        refusal = self._units_refusal() if self._rates.rates is Rates.WRONG_UNITS else None
        return JudgedIns(seen.sample, refusal, jump, wrong_after_ns)

    def _late_refusal(self, sample: AttitudeSample, before: AttitudeSample | None) -> Refusal | None:
        """Why a sample that comes after later ones is not used, by the one used before it in time."""
        if self._stuck.is_frozen(sample.rotation_nd):
            return _STUCK
        if self._rates.rates is Rates.WRONG_UNITS:
            return self._units_refusal()
        if before is None:
            return None
        match = self._match_by_two_rates(before, sample)
        return None if match.fits else _gate_refusal(match)

    def _judge_rates(self, previous: _Seen, seen: _Seen) -> int | None:
        """Let the rates be judged where the attitude can be true; returns the stamp after which they are wrong."""
        sample, integrated = seen.sample, seen.integrated
        if integrated is None or not _one_run(previous.integrated, integrated) or self._stuck.repeated:
            return None
        reach_rad = _FASTEST_RAD_PER_S * _seconds(previous.sample, sample)
        # 0.75 of the chord between two matrices is more than the turn: good samples need no logarithm.
        chord = math.hypot(*(sample.rotation_nd - previous.sample.rotation_nd).ravel().tolist())
        if not (0.75 * chord <= reach_rad <= 1.0 or self._match_by_time(previous.sample, sample).fits):
            self._rates.restart()
            return None
        # The noise of a rate, as it adds to an attitude integrated from sample to sample, each axis.
        rate_noise_rad = self._by_rates.typical_rad / math.sqrt(6.0)
        turned = sample.rotation_nd, integrated.rotation
        wrong_after_ns = self._rates.observe(sample.time_ns, *turned, self.noise_rad, rate_noise_rad)
        if wrong_after_ns is not None:
            self._by_rates.forget()
        # The rates may have lost their trust with this sample, or have got it back.
        if not self._rates.usable:
            self.by_rates = None
        elif self.by_rates is None:
            self.by_rates = Witness(sample.time_ns, integrated.rotation, 0.0, _DRIFT_RAD_PER_S)
        return wrong_after_ns

    def _take(self, seen: _Seen, before: _Seen | None) -> None:
        """Take a sample; ``before`` tells how the deck moves at it, None after a jump."""
        self._taken = seen._replace(before=None if before is None else before.sample)
        if self._previous is seen:
            self._previous = self._taken
        self._smooth_since_taken = True

    def _learn_unproven(self, taken: _Seen, seen: _Seen, match: Match, one_run: bool) -> None:
        """Learn from a good sample while the rates are not proven: by the motion, and by rates that may be right."""
        if match.led:
            self._by_motion.learn(match.difference)
        if self._rates.usable and one_run:
            self._by_rates.learn(self._match_by_rates(taken, seen).difference)

    def _units_refusal(self) -> Refusal:
        text = f"angular velocity turns {self._rates.slope:.3g} times as fast as the orientation: degrees for radians?"
        return Refusal(Reason.UNITS, f"{text} ins/imu must be in rad/s")

    # -- where a sample leads -------------------------------------------------------------------------------

    def _match(self, start: _Seen, end: _Seen) -> Match:
        """By the rates of all samples between or, where these do not lead there, by the motion before."""
        if self._rates.rates is Rates.MEASURED and _one_run(start.integrated, end.integrated):
            return self._match_by_rates(start, end)
        return self._match_by_motion(start, end)

    def _match_by_rates(self, start: _Seen, end: _Seen) -> Match:
        """By the integrated rates of all samples between; both samples belong to one run of rates."""
        assert start.integrated is not None
        assert end.integrated is not None
        # This runs for every sample of the INS, and the method takes half the time of the operator.
        predicted_nd = start.sample.rotation_nd.dot(start.integrated.rotation.T).dot(end.integrated.rotation)
        missed_rad = end.integrated.missed_rad - start.integrated.missed_rad
        step = self._step(_seconds(start.sample, end.sample), missed_rad, end.number - start.number)
        return self._by_rates.match(log_rotation(end.sample.rotation_nd.dot(predicted_nd.T)), step)

    def _match_by_motion(self, start: _Seen, end: _Seen) -> Match:
        """By the motion going on as before; where the way is too long for that, by the time."""
        seconds, before = _seconds(start.sample, end.sample), start.before
        turned_s = 0.0 if before is None else _seconds(before, start.sample)
        if before is None or max(seconds, turned_s) > _LONGEST_STEP_S:
            return self._match_by_time(start.sample, end.sample)
        turn_d = seconds / turned_s * log_rotation(before.rotation_nd.T @ start.sample.rotation_nd)
        difference_n = log_rotation(end.sample.rotation_nd @ (start.sample.rotation_nd @ exp_rotation(turn_d)).T)
        step = step_by_motion(turned_s, seconds, _LARGEST_ACCELERATION, self._stuck.coarseness_rad)
        return self._by_motion.match(difference_n, step)

    def _match_by_two_rates(self, start: AttitudeSample, end: AttitudeSample) -> Match:
        """By the rates of the two samples alone; where these do not lead there, by the time."""
        seconds, proven = _seconds(start, end), self._rates.rates is Rates.MEASURED
        if not proven or start.rate_d is None or end.rate_d is None or seconds > _LONGEST_STEP_S:
            return self._match_by_time(start, end)
        predicted_nd = start.rotation_nd @ exp_rotation((0.5 * seconds) * (start.rate_d + end.rate_d))
        step = self._step(seconds, missed_by_mean_rad(start.rate_d, end.rate_d, seconds))
        return self._by_rates.match(log_rotation(end.rotation_nd @ predicted_nd.T), step)

    def _match_by_time(self, start: AttitudeSample, end: AttitudeSample) -> Match:
        """By nothing but what a hull can turn in the time."""
        seconds = _seconds(start, end)
        step = self._step(seconds, _FASTEST_RAD_PER_S * seconds)
        return self._by_motion.match(log_rotation(end.rotation_nd @ start.rotation_nd.T), step, led=False)

    def _step(self, seconds: float, uncertain_rad: float, samples: int = 1) -> Step:
        return Step(seconds, samples, uncertain_rad + self._told_rad, 2.0, self._stuck.coarseness_rad)


def _gate_refusal(match: Match) -> Refusal:
    """The refusal of a sample that is not where those before lead."""
    off, bound = math.degrees(size(match.difference)), math.degrees(match.bound_rad)
    text = f"orientation is {off:.3g}° from where the samples before lead: more than {bound:.3g}°"
    return Refusal(Reason.GATE, text)


def _moved_back(sample: AttitudeSample, taken: _Seen) -> AttitudeSample | None:
    """The deck at the time of the last accepted sample, extrapolated back from a new sample.

    It moves as it did before the last accepted sample. After a jump, the next sample is predicted with it.
    """
    if taken.before is None:
        return None
    ratio = _seconds(taken.sample, sample) / _seconds(taken.before, taken.sample)
    turn_d = ratio * log_rotation(taken.before.rotation_nd.T @ taken.sample.rotation_nd)
    return replace(taken.sample, rotation_nd=sample.rotation_nd @ exp_rotation(-turn_d))


def _one_run(first: Integrated | None, second: Integrated | None) -> bool:
    """Whether unbroken rates lead from one sample to the other."""
    return first is not None and second is not None and first.run == second.run


def _seconds(first: AttitudeSample, second: AttitudeSample) -> float:
    return (second.time_ns - first.time_ns) * 1e-9

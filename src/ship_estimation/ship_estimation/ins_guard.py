"""The guard of an INS's samples. It tells a frozen INS, an attitude that jumps, and rates that are none.

The guard watches the samples in the order of their stamps. Each attitude is compared with the place where those before
lead: by the rates where these are proven, otherwise by the motion before, otherwise by what a hull can turn in the
time. Rates that are not measured are left out of the samples; what was taken with them before is named, so that it can
be mended.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from ship_estimation.excess_noise import ExcessNoise
from ship_estimation.ins import GuardedInsConfig, InsJump, clock_step_s
from ship_estimation.ins_leads import FASTEST_RAD_PER_S, Leads, SeenSample, moved_back, one_run, seconds_between
from ship_estimation.integrated_rates import IntegratedRun, RateIntegrator, StampArray
from ship_estimation.rate_guard import RateGuard, Rates
from ship_estimation.rate_slopes import SlopeWatch
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.step_watch import StepWatch
from ship_estimation.value_guards import JumpGuard, JumpVerdict, Match, StuckGuard, size
from ship_estimation.witnesses import Witness
from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack, ExtraNoise, SampleBlock
from ship_geometry.rotations import ARCSEC, FloatArray

_STUCK = Refusal(Reason.STUCK, "orientation stands still while other sources move")


class JudgedIns(NamedTuple):
    """What is to be done with a sample.

    Attributes:
        sample: the sample as it may be used: without its rate where the rates are not measured.
        refusal: why the sample is not used; None where it is.
        jumps: the jump of the attitude that is believed with this sample, at each end of the time in which it may have
            happened; empty where there is none.
        rates_wrong_after_ns: stamp after which the rates of samples taken before are no rates; None where nothing new
            is known of them.
        noise: noise of the samples beyond what is stated, as it is known with this sample; None where nothing new is
            known of it.
    """

    sample: AttitudeSample
    refusal: Refusal | None = None
    jumps: tuple[InsJump, ...] = ()
    rates_wrong_after_ns: int | None = None
    noise: ExtraNoise | None = None


class Followed:
    """The samples of a block that were judged ahead.

    Attributes:
        count: how many these are.
        last: what is to be done with the last of them where something is, because the attitude crept, or the rates
            turned out to be wrong with it.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last: JudgedIns | None = None
        self._pieces: list[_Piece] = []

    @property
    def usual(self) -> int:
        """How many of them go the usual way, from the first one on."""
        return self.count - (self.last is not None)

    def add(self, times_ns: StampArray, rotations: FloatArray, drift_rad_per_s: float) -> None:
        """Further samples were judged: their stamps, their attitudes by the rates, shape (N, 3, 3), and their drift."""
        self._pieces.append(_Piece(self.count, times_ns, rotations, drift_rad_per_s))
        self.count += len(times_ns)

    def by_rates(self, number: int) -> Witness:
        """At one of them the attitude by the rates alone, for the guards of other sources."""
        piece = self._pieces[-1]
        for piece in reversed(self._pieces):
            if piece.start <= number:
                break
        place = number - piece.start
        return Witness(int(piece.times_ns[place]), piece.rotations[place], 0.0, piece.drift_rad_per_s)


class _Piece(NamedTuple):
    """Samples from a number on, and what :meth:`Followed.add` was told of them."""

    start: int
    times_ns: StampArray
    rotations: FloatArray
    drift_rad_per_s: float


class InsGuard:
    """Judges the samples of one INS.

    Args:
        config: noise of the INS, and after how many refused samples a jump is believed.

    Attributes:
        noise_rad: noise of an attitude about its worst axis, rounding included.
        by_rates: attitude by the rates alone at the last sample, as a witness for the guards of other sources; None
            where the sample has no rate or the rates are not to be believed.

    >>> from ship_geometry.rotations import exp_rotation
    >>> guard, used = InsGuard(GuardedInsConfig()), AttitudeTrack(max_gap_ns=500_000_000)
    >>> for ms, heading_deg in ((0, 10.0), (10, 10.01), (20, 10.02), (30, 55.0)):
    ...     attitude = exp_rotation([0.0, math.radians(heading_deg), 0.0])
    ...     judged = guard.judge(AttitudeSample(ms * 1_000_000, attitude), used, {})
    >>> judged.refusal.reason.name
    'GATE'
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self._stuck, self._rates, self._jumps = StuckGuard(), RateGuard(), JumpGuard()
        self._integrator, self._steps, self._leads = RateIntegrator(), StepWatch(ARCSEC, 0.0), Leads(self._stuck)
        self._slopes = SlopeWatch()
        self._previous: SeenSample | None = None
        self._taken: SeenSample | None = None
        # The first of the samples that are refused for a jump.
        self._jumps_with: AttitudeSample | None = None
        # Whether each sample since the last one taken goes on with the motion before it.
        self._smooth_since_taken = True
        # By so much attitudes contradicted the rates, and from which stamp on, when the rates lost their trust by it.
        self._disputed: InsJump | None = None
        # How often a drift of the rates was learnt.
        self._learnt = 0
        self._excess = ExcessNoise(ARCSEC)
        # Noise that is known but not returned yet, with the judgement of a sample.
        self._new_noise: ExtraNoise | None = None
        self.by_rates: Witness | None = None
        self.reconfigure(config)

    def reconfigure(self, config: GuardedInsConfig) -> None:
        """Go on with another noise, an arcsecond at least."""
        self._stated_rad = max(config.white_sigma_arcsec * ARCSEC, ARCSEC)
        self._rate_sigma = config.rate_sigma_arcsec_per_s * ARCSEC
        self._new_noise = self._excess.reconfigure(self._stated_rad) or self._new_noise
        self._jumps.samples = config.jump_samples
        self._leads.drift.with_earth = config.rate_has_earth_rate
        self._set_sigma()

    def _set_sigma(self) -> None:
        """Judge samples by the stated noise or, where more was measured, by that."""
        self._sigma_rad = self._excess.sigma_rad
        self._leads.by_rates.sigma_rad = self._leads.by_motion.sigma_rad = self._sigma_rad
        self._steps.reconfigure(self._sigma_rad, self._rate_sigma)
        self.noise_rad = math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))

    @property
    def rates(self) -> Rates:
        """What the rates are worth."""
        return self._rates.rates

    @property
    def excess_text(self) -> str:
        """Measured against stated noise of the samples, in words; empty where it is no larger."""
        found = self._excess.found
        return "" if found is None else found.text(self._stated_rad)

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
        self._leads.told_rad = told_rad
        previous = self._previous
        if previous is not None and sample.time_ns <= previous.sample.time_ns:
            judged = JudgedIns(sample, self._late_refusal(sample, used.last_before(sample.time_ns - 1)))
        else:
            judged = self._with_noise(self._judge_next(sample, previous, witnesses))
        if self._rates.usable or sample.rate_d is None:
            return judged
        return judged._replace(sample=replace(sample, rate_d=None))

    @property
    def least_step_rad(self) -> float:
        """While samples go the usual way, one with which the source may have stepped by no more is judged as others."""
        return self._steps.least_rad

    def looks_ahead(self, time_ns: int) -> bool:
        """Whether a sample may go the usual way: rates are proven, a line leads to it, and nothing is in question."""
        taken = self._taken
        if taken is None or self._previous is not taken or self._rates.rates is not Rates.MEASURED:
            return False
        in_order = taken.integrated is not None and taken.sample.time_ns < time_ns
        return in_order and self._disputed is None and self._steps.judges and not self._excess.collects

    def look_ahead(self, samples: Sequence[AttitudeSample], block: SampleBlock) -> Followed:
        """Judge the samples of a block, from the first one on, as long as they go the way of nearly all.

        Each of them is judged as by :meth:`judge` and may be used as it is; witnesses have no part in that. The next
        one is for :meth:`judge`, after :meth:`arrive`.

        Args:
            samples: later than all before, in the order of their stamps.
            block: the same as arrays.
        """
        followed = Followed()
        if not self.looks_ahead(samples[0].time_ns):
            return followed
        self._leads.told_rad = 0.0
        fresh = self._stuck.new_values(samples[0].time_ns, block.rotations_nd)
        while followed.count < fresh and followed.last is None:
            start = followed.count
            rest = block.some(slice(start, fresh))
            integrated = self._integrator.integrate_all(rest.times_ns, rest.rates_d)
            self._follow_run(samples[start:fresh], rest, integrated, followed)
            if followed.count == start:
                break
        return followed

    def arrive(self, values: FloatArray, followed: Followed, witnesses: Mapping[str, Witness]) -> None:
        """Samples that were judged ahead have come, all of them.

        Args:
            values: their attitudes, shape (N, 3, 3).
            followed: what :meth:`look_ahead` gave.
            witnesses: as in :meth:`judge`, at the last of them.
        """
        by_rates = followed.by_rates(followed.count - 1)
        # The guard of what stands still hears the rates as they were before they were judged with the last sample.
        self._stuck.follow(by_rates.time_ns, values, {**witnesses, "rate": by_rates})
        self.noise_rad = math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))
        self.by_rates = by_rates if self._rates.usable else None
        self._smooth_since_taken = True

    def _follow_run(
        self, samples: Sequence[AttitudeSample], block: SampleBlock, integrated: IntegratedRun, followed: Followed
    ) -> None:
        """Follow samples as far as their rates are integrated as before: until a drift of the rates is learnt."""
        start, joined, drift_rad_per_s = 0, len(integrated.missed_rad), self._leads.drift.bound_rad_per_s
        while start < joined and followed.last is None:
            # With the sample at which that is due the rates are judged.
            due = start + 1 + int(block.times_ns[start:joined].searchsorted(self._rates.due_ns))
            some = slice(start, min(due, joined))
            times_ns, learnt = block.times_ns[some], self._learnt
            count, followed.last = self._follow(samples[some], block.some(some), integrated.some(some), due - start)
            if count:
                followed.add(times_ns[:count], integrated.rotations[start : start + count], drift_rad_per_s)
            start += count
            if not count or self._learnt != learnt:
                return

    def _follow(
        self, samples: Sequence[AttitudeSample], block: SampleBlock, integrated: IntegratedRun, due: int
    ) -> tuple[int, JudgedIns | None]:
        """Take the samples that lie on one line with those before, up to one with which something is learnt.

        Args:
            samples: that may be taken.
            block: the same as arrays.
            integrated: their attitudes by the rates.
            due: with so many of them the rates are judged.

        Returns:
            How many are taken; and what is to be done with the last one where something is.
        """
        taken = self._taken
        if taken is None or taken.integrated is None or integrated.run != taken.integrated.run:
            return 0, None
        count = self._steps.follow(*block, integrated, self._leads.by_rates.noise_rad, self._stuck.coarseness_rad)
        if count == 0:
            return 0, None
        last = samples[count - 1]
        previous, self._taken = self._last_two(samples, integrated, taken, count)
        seen = self._taken
        self._integrator.take(last.time_ns, block.rates_d[count - 1], integrated.one(count - 1))
        jumps = self._crept_since(last)
        if jumps:
            self._taken = seen._replace(before=None)
        self._previous = self._taken
        wrong_after_ns = self._judge_rates(previous, seen) if count == due else None
        if not jumps and wrong_after_ns is None and self._new_noise is None:
            return count, None
        sample = last if self._rates.usable else replace(last, rate_d=None)
        return count, self._with_noise(JudgedIns(sample, _stepped(jumps), jumps, wrong_after_ns))

    @staticmethod
    def _last_two(
        samples: Sequence[AttitudeSample], integrated: IntegratedRun, taken: SeenSample, count: int
    ) -> tuple[SeenSample, SeenSample]:
        """The last two of so many samples taken, as the guard has seen them; before all of them is the one taken."""
        before = (taken.before, taken.sample, *samples[max(count - 3, 0) : count])
        last = SeenSample(samples[count - 1], taken.number + count, before[-2], integrated.one(count - 1))
        if count == 1:
            return taken, last
        return SeenSample(samples[count - 2], last.number - 1, before[-3], integrated.one(count - 2)), last

    def _judge_next(
        self, sample: AttitudeSample, previous: SeenSample | None, witnesses: Mapping[str, Witness]
    ) -> JudgedIns:
        """Judge a sample later than all before."""
        integrated = self._integrator.integrate(sample.time_ns, sample.rate_d)
        number, before = (0, None) if previous is None else (previous.number + 1, previous.sample)
        self._previous = seen = SeenSample(sample, number, before, integrated)
        self.by_rates = None
        if integrated is not None and self._rates.usable:
            self.by_rates = Witness(sample.time_ns, integrated.rotation, 0.0, self._leads.drift.bound_rad_per_s)
            witnesses = {**witnesses, "rate": self.by_rates}
        stuck = self._stuck.observe(sample.time_ns, sample.rotation_nd, self._sigma_rad, witnesses)
        self.noise_rad = math.hypot(self._sigma_rad, self._stuck.coarseness_rad / math.sqrt(12.0))
        if stuck:
            self._rates.restart()
            self._steps.restart()
            self._smooth_since_taken = False
            return JudgedIns(sample, _STUCK)
        if self._taken is None or previous is None:
            self._excess.suspect(sample.time_ns, 0.0)
            self._take(seen, None)
            return JudgedIns(sample)
        return self._compare(self._taken, previous, seen)

    def _compare(self, taken: SeenSample, previous: SeenSample, seen: SeenSample) -> JudgedIns:
        """Judge a sample by the last one taken and the one before it."""
        sample, on_line, measured = seen.sample, None, self._rates.rates is Rates.MEASURED
        if measured and seen.integrated is not None:
            if self._leads.told_rad and self._leads.told_rad > self._steps.smallest_rad:
                self._steps.restart()
            errors_rad = self._leads.by_rates.noise_rad, self._stuck.coarseness_rad
            on_line = self._steps.look(sample, seen.integrated, *errors_rad)
            if on_line is False:
                self._excess.suspect(sample.time_ns, self._leads.by_rates.typical_rad)
        if seen.integrated is not None and self._excess.collects:
            self._new_noise = self._excess.observe(sample, seen.integrated, measured) or self._new_noise
        if on_line and previous is taken:
            # Nearly all samples of a healthy INS go this way.
            jumps = self._kept(seen)
            self._take(seen, None if jumps else taken)
            due = sample.time_ns >= self._rates.due_ns
            return JudgedIns(sample, _stepped(jumps), jumps, self._judge_rates(previous, seen) if due else None)
        match = self._leads.match(taken, seen, measured) if on_line is None else self._steps.match()
        step = match if previous is taken else self._leads.match(previous, seen, measured)
        fits = match.fits
        if step is not match:
            fits = match.fits_again(step) or (measured and self._leads.lied_between(taken, seen, step))
        if not fits:
            smooth = self._smooth_since_taken and self._leads.match_by_motion(previous, seen).fits
            self._smooth_since_taken = smooth
            # Trusted rates refuse the attitudes that they contradict. Once the rates have lost their trust these
            # attitudes are right after all, provided that each of them went on with the motion before it.
            fits = smooth and not measured
        verdict = self._jumps.judge(sample.time_ns, fits, step.fits)
        if verdict is JumpVerdict.REFUSED:
            if self._jumps.refused == 1:
                self._jumps_with = sample
                self._previous = seen._replace(before=moved_back(sample, taken))
            wrong_after_ns = self._judge_rates(previous, seen)
            if wrong_after_ns is not None and measured:
                self._disputed = InsJump(self._jumps.since_ns - 1, match.difference, match.sigma_rad)
            return JudgedIns(sample, _gate_refusal(match), (), wrong_after_ns)
        return self._taken_after_all(taken, previous, seen, match, step is match, verdict is JumpVerdict.JUMPED)

    def _taken_after_all(
        self, taken: SeenSample, previous: SeenSample, seen: SeenSample, match: Match, next_one: bool, jumped: bool
    ) -> JudgedIns:
        """Take a sample that the line of those before does not tell of: there is none yet, or it has jumped."""
        jumps: tuple[InsJump, ...] = ()
        refusal = None
        if self._disputed is not None:
            # The rates are not believed any more; whether the attitudes were right, only others can tell.
            jumps, self._disputed = (self._disputed,), None
        elif jumped:
            jumps = (self._believed(match),)
        if not jumps and match.fits:
            jumps = self._kept(seen)
            refusal = _stepped(jumps)
        else:
            self._steps.restart()
        self._take(seen, None if jumps else taken)
        one = one_run(taken.integrated, seen.integrated)
        wrong_after_ns = self._judge_rates(previous, seen)
        # How far good samples are from the place where those before lead is learnt from steps of one sample.
        if not jumps and next_one:
            if self._rates.rates is not Rates.MEASURED:
                self._learn_unproven(taken, seen, match, one)
            elif one:
                self._leads.by_rates.learn(match.difference)
        if self._rates.rates is Rates.WRONG_UNITS:
            refusal = self._units_refusal()
        return JudgedIns(seen.sample, refusal, jumps, wrong_after_ns)

    def _believed(self, match: Match) -> InsJump:
        """The jump that is believed after samples that were refused for it."""
        first, clock_s = self._jumps_with, math.nan
        if first is not None and first.rate_d is not None and self._rates.rates is Rates.MEASURED:
            clock_s = clock_step_s(match.difference, match.sigma_rad, first.rotation_nd @ first.rate_d)
        return InsJump(self._jumps.since_ns - 1, match.difference, match.sigma_rad, clock_s)

    def _kept(self, seen: SeenSample) -> tuple[InsJump, ...]:
        """Take a sample into the line by which the next ones are judged; the jump that it makes known."""
        found = self._steps.keep()
        if found is None:
            return self._crept_since(seen.sample)
        self._excess.suspect(seen.sample.time_ns, self._leads.by_rates.typical_rad)
        self._rates.restart()
        moments_ns = sorted({found.first_ns, found.last_ns})
        return tuple(InsJump(time_ns - 1, found.step_n, found.sigma_rad) for time_ns in moments_ns)

    def _with_noise(self, judged: JudgedIns) -> JudgedIns:
        """Return the judgement with noise of the samples that has become known; they are judged by it from now on."""
        noise, self._new_noise = self._new_noise, None
        if noise is None:
            return judged
        self._set_sigma()
        self._steps.forget()
        self._leads.by_rates.forget()
        return judged._replace(noise=noise)

    def _crept_since(self, sample: AttitudeSample) -> tuple[InsJump, ...]:
        """Learn from what samples on a line tell; the jump as large as what has crept where it does not fit."""
        sums, self._steps.noise = self._steps.noise, None
        if sums is not None:
            self._new_noise = self._excess.add(sums) or self._new_noise
        learnt, self._steps.learnt = self._steps.learnt, None
        if learnt is None:
            return ()
        self._learnt += 1
        self._integrator.take_out(self._leads.drift.learnt(learnt.drift_n, sample.rotation_nd))
        self._leads.by_rates.know(learnt.typical_rad)
        crept = self._slopes.crept(learnt.drift_n, learnt.seconds, learnt.turning)
        return () if crept is None else (InsJump(sample.time_ns - 1, crept.turn_n, crept.sigma_rad, creeps=True),)

    def _late_refusal(self, sample: AttitudeSample, before: AttitudeSample | None) -> Refusal | None:
        """Why a sample that comes after later ones is not used, by the one used before it in time."""
        if self._stuck.is_frozen(sample.rotation_nd):
            return _STUCK
        if self._rates.rates is Rates.WRONG_UNITS:
            return self._units_refusal()
        if before is None:
            return None
        match = self._leads.match_by_two_rates(before, sample, self._rates.rates is Rates.MEASURED)
        return None if match.fits else _gate_refusal(match)

    def _judge_rates(self, previous: SeenSample, seen: SeenSample) -> int | None:
        """Let the rates be judged where the attitude can be true; returns the stamp after which they are wrong."""
        sample, integrated = seen.sample, seen.integrated
        if integrated is None or not one_run(previous.integrated, integrated) or self._stuck.repeated:
            return None
        reach_rad = FASTEST_RAD_PER_S * seconds_between(previous.sample, sample)
        # 0.75 of the chord between two matrices is more than the turn: good samples need no logarithm.
        chord = math.hypot(*(sample.rotation_nd - previous.sample.rotation_nd).ravel().tolist())
        if not (0.75 * chord <= reach_rad <= 1.0 or self._leads.match_by_time(previous.sample, sample).fits):
            self._rates.restart()
            return None
        # The noise of a rate, as it adds to an attitude integrated from sample to sample, each axis.
        rate_noise_rad = self._leads.by_rates.typical_rad / math.sqrt(6.0)
        wrong_after_ns = self._rates.observe(
            sample.time_ns, seen.number, sample.rotation_nd, integrated, self.noise_rad, rate_noise_rad
        )
        if wrong_after_ns is not None:
            self._leads.by_rates.forget()
            self._steps.forget()
            self._slopes.forget()
            self._excess.forget()
        # The rates may have lost their trust with this sample, or have got it back.
        if not self._rates.usable:
            self.by_rates = None
        elif self.by_rates is None:
            self.by_rates = Witness(sample.time_ns, integrated.rotation, 0.0, self._leads.drift.bound_rad_per_s)
        return wrong_after_ns

    def _take(self, seen: SeenSample, before: SeenSample | None) -> None:
        """Take a sample; ``before`` tells how the deck moves at it, None after a jump."""
        self._taken = seen._replace(before=None if before is None else before.sample)
        if self._previous is seen:
            self._previous = self._taken
        self._smooth_since_taken = True

    def _learn_unproven(self, taken: SeenSample, seen: SeenSample, match: Match, one: bool) -> None:
        """Learn from a good sample while the rates are not proven: by the motion, and by rates that may be right."""
        if match.led:
            self._leads.by_motion.learn(match.difference)
        if self._rates.usable and one:
            self._leads.by_rates.learn(self._leads.match_by_rates(taken, seen).difference)

    def _units_refusal(self) -> Refusal:
        text = f"angular velocity turns {self._rates.slope:.3g} times as fast as the orientation: degrees for radians?"
        return Refusal(Reason.UNITS, f"{text} ins/imu must be in rad/s")


def _gate_refusal(match: Match) -> Refusal:
    """The refusal of a sample that is not where those before lead."""
    off, bound = math.degrees(size(match.difference)), math.degrees(match.bound_rad)
    text = f"orientation is {off:.3g}° from where the samples before lead: more than {bound:.3g}°"
    return Refusal(Reason.GATE, text)


def _stepped(jumps: tuple[InsJump, ...]) -> Refusal | None:
    """The refusal that tells of a step found by means, or of a creep; None where there is none.

    The samples since were taken: only the one that makes the step known can tell of it.
    """
    if not jumps:
        return None
    off_arcsec, how = size(jumps[-1].jump_n) / ARCSEC, "crept" if jumps[-1].creeps else "stepped"
    return Refusal(Reason.GATE, f"orientation has {how} by {off_arcsec:.3g} arcsec against its own rates")

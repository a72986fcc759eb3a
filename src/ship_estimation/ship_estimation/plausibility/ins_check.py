"""Plausibility checks of INS samples: frozen values, jumps of the attitude, and rates that are not measured.

Samples are checked in the order of their stamps. Each attitude is compared with its prediction from earlier samples.
The prediction uses the rates if they are confirmed, otherwise continued motion, otherwise the fastest rotation of a
hull. Rates that are not measured, such as zeros or noise, are removed from the samples. The stamp after which earlier
rates were wrong is returned for the correction of the track.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedBlock, CheckedInsSample, InsJump, clock_step_s
from ship_estimation.plausibility.integrated_rates import IntegratedRun, RateConsistencyCheck, RateStatus
from ship_estimation.plausibility.predictions import (
    FASTEST_RAD_PER_S,
    InsPredictions,
    JumpCheck,
    JumpDecision,
    NumberedSample,
    PredictionMatch,
    are_in_one_run,
    extrapolate_back,
    seconds_between,
)
from ship_estimation.plausibility.rate_comparison import RateComparison
from ship_estimation.plausibility.stuck_check import MotionReference, StuckCheck
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import ARCSEC, FloatArray, vector_length
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack, SampleBlock

_STUCK = Rejection(Reason.STUCK, "orientation is constant while other sources show a rotation")


class InsCheck:
    """Plausibility checks of the samples of one INS.

    Args:
        config: noise of the INS, and number of rejected samples after which a jump is accepted.

    Attributes:
        by_rates: attitude by integrated rates at the last sample, as motion reference for the checks of other sources;
            None if the sample has no rate or the rates are not usable.
        comparison: comparison of the attitudes with the integrated rates, which measures excess noise.

    >>> from ship_geometry.rotations import exp_rotation
    >>> guard, used = InsCheck(CheckedInsConfig()), AttitudeTrack(max_gap_ns=500_000_000)
    >>> for ms, heading_deg in ((0, 10.0), (10, 10.01), (20, 10.02), (30, 55.0)):
    ...     attitude = exp_rotation([0.0, math.radians(heading_deg), 0.0])
    ...     checked = guard.check(AttitudeSample(ms * 1_000_000, attitude), used, {})
    >>> checked.rejection.reason.name
    'GATE'
    """

    def __init__(self, config: CheckedInsConfig) -> None:
        self._stuck_check, self._rate_check, self._jump_check = StuckCheck(), RateConsistencyCheck(), JumpCheck()
        self._predictions = InsPredictions(self._stuck_check)
        self.comparison = RateComparison(self._predictions, self._rate_check)
        self._previous: NumberedSample | None = None
        self._accepted: NumberedSample | None = None
        # First of the samples that are rejected before a jump is accepted.
        self._jump_candidate: AttitudeSample | None = None
        # True if each sample since the last accepted sample continues the motion of the samples before.
        self._is_smooth_since_accepted = True
        # Difference between attitudes and rates for which the rates were found to be wrong, with its stamp.
        self._unresolved_jump: InsJump | None = None
        self.by_rates: MotionReference | None = None
        self.reconfigure(config)

    def reconfigure(self, config: CheckedInsConfig) -> None:
        """Set the noise and the other parameters of a new configuration; the noise is an arcsecond at least."""
        stated_rad = max(config.white_sigma_arcsec * ARCSEC, ARCSEC)
        self.comparison.reconfigure(stated_rad, config.rate_sigma_arcsec_per_s * ARCSEC)
        self._jump_check.samples = config.jump_samples
        self._predictions.drift.has_earth_rate = config.rate_has_earth_rate

    @property
    def _noise_rad(self) -> float:
        """Noise of an attitude about its worst axis, rounding included, rad."""
        return math.hypot(self.comparison.sigma_rad, self._stuck_check.coarseness_rad / math.sqrt(12.0))

    @property
    def rate_status(self) -> RateStatus:
        """Status of the rates."""
        return self._rate_check.status

    def motion_references(self, time_ns: int, accepted_track: AttitudeTrack) -> dict[str, MotionReference]:
        """Return the attitudes by orientation and by rates at or before a stamp, for the checks of other sources."""
        references, noise_rad, ins = dict[str, MotionReference](), self._noise_rad, accepted_track.last_before(time_ns)
        if ins is not None:
            references["ins"] = MotionReference(ins.time_ns, ins.rotation_nd, noise_rad)
        if self.by_rates is not None and self.by_rates.time_ns <= time_ns:
            references["rate"] = self.by_rates
        return references

    def check(
        self,
        sample: AttitudeSample,
        accepted_track: AttitudeTrack,
        motion_references: Mapping[str, MotionReference],
        reported_step_rad: float = 0.0,
    ) -> CheckedInsSample:
        """Check a sample against earlier samples.

        The checks follow the stream in order. A sample that arrives after later samples is only compared with the
        accepted sample before it in time. Such a sample is also rejected while the source is frozen at the value of
        this sample, or while the rates have the wrong unit.

        Args:
            sample: sample to check.
            accepted_track: the samples accepted so far.
            motion_references: attitude by each other source at about the time of the sample, by name of the source.
            reported_step_rad: possible step with this sample that the source itself reports, rad.
        """
        self._predictions.reported_step_rad = reported_step_rad
        previous = self._previous
        if previous is not None and sample.time_ns <= previous.sample.time_ns:
            checked = CheckedInsSample(
                sample, self._late_rejection(sample, accepted_track.last_before(sample.time_ns - 1))
            )
        else:
            checked = self._check_next(sample, previous, motion_references)
            if self.comparison.new_noise is not None:
                checked = self.comparison.with_noise(checked)
        if self._rate_check.is_usable or sample.rate_d is None:
            return checked
        return checked._replace(sample=replace(sample, rate_d=None))

    def can_check_block(self, time_ns: int) -> bool:
        """True if a block may be checked from a stamp on: the rates are confirmed and no check is unresolved."""
        taken = self._accepted
        if taken is None or self._previous is not taken or self._rate_check.status is not RateStatus.MEASURED:
            return False
        if not self.comparison.step_detector.is_ready or self.comparison.excess.is_collecting:
            return False
        in_order = taken.integrated is not None and taken.sample.time_ns < time_ns
        return in_order and self._unresolved_jump is None

    def check_block(self, samples: Sequence[AttitudeSample], block: SampleBlock) -> CheckedBlock:
        """Check the leading samples of a block as long as all are accepted without special cases.

        The result for each sample is the result of :meth:`check`; motion references do not affect this result. If any
        sample was checked, :meth:`commit_block` must be called before the next sample is checked.

        Args:
            samples: samples in the order of their stamps, later than all samples before.
            block: the same samples as arrays.
        """
        followed = CheckedBlock()
        if not self.can_check_block(samples[0].time_ns):
            return followed
        self._predictions.reported_step_rad = 0.0
        fresh = self._stuck_check.count_new_values(samples[0].time_ns, block.rotations_nd)
        while followed.count < fresh and followed.last is None:
            start = followed.count
            rest = block.subset(slice(start, fresh))
            integrated = self.comparison.integrator.integrate_all(rest.times_ns, rest.rates_d)
            self._check_run(samples[start:fresh], rest, integrated, followed)
            if followed.count == start:
                break
        return followed

    def commit_block(
        self, values: FloatArray, checked: CheckedBlock, motion_references: Mapping[str, MotionReference]
    ) -> None:
        """Commit the samples that :meth:`check_block` checked.

        Args:
            values: attitudes of the checked samples, shape (N, 3, 3).
            checked: result of :meth:`check_block`.
            motion_references: as in :meth:`check`, at the last sample.
        """
        by_rates = checked.by_rates(checked.count - 1)
        # The stuck check uses the rates as they were before their check with the last sample.
        self._stuck_check.accept_new_values(by_rates.time_ns, values, {**motion_references, "rate": by_rates})
        self.by_rates = by_rates if self._rate_check.is_usable else None
        self._is_smooth_since_accepted = True

    def _check_run(
        self, samples: Sequence[AttitudeSample], block: SampleBlock, integrated: IntegratedRun, followed: CheckedBlock
    ) -> None:
        """Check samples until a new drift of the rates is estimated, which changes the integration of the rates."""
        start, joined, drift_rad_per_s = 0, len(integrated.error_rad), self._predictions.drift.bound_rad_per_s
        while start < joined and followed.last is None:
            # The rates are checked with the sample that reaches the due time.
            due = start + 1 + int(block.times_ns[start:joined].searchsorted(self._rate_check.due_ns))
            some = slice(start, min(due, joined))
            times_ns, learnt = block.times_ns[some], self.comparison.drift_updates
            count, followed.last = self._check_line(
                samples[some], block.subset(some), integrated.subset(some), due - start
            )
            if count:
                followed.add(times_ns[:count], integrated.rotations[start : start + count], drift_rad_per_s)
            start += count
            if not count or self.comparison.drift_updates != learnt:
                return

    def _check_line(
        self, samples: Sequence[AttitudeSample], block: SampleBlock, integrated: IntegratedRun, due: int
    ) -> tuple[int, CheckedInsSample | None]:
        """Accept leading samples on the line of earlier samples, up to a sample that updates the statistics.

        The line is the line of :mod:`ship_estimation.plausibility.ins_step_detector`.

        Args:
            samples: samples to check.
            block: the same samples as arrays.
            integrated: attitudes of the samples by integrated rates.
            due: number of samples after which the rates are checked.

        Returns:
            Number of accepted samples, and the result for the last accepted sample as in :attr:`CheckedBlock.last`.
        """
        taken = self._accepted
        if taken is None or taken.integrated is None or integrated.run != taken.integrated.run:
            return 0, None
        count, update = self.comparison.step_detector.accept_block(
            *block, integrated, self._predictions.rate_bound.noise_rad, self._stuck_check.coarseness_rad
        )
        if count == 0:
            return 0, None
        last = samples[count - 1]
        previous, self._accepted = self._last_two(samples, integrated, taken, count)
        seen = self._accepted
        self.comparison.integrator.resume_from(last.time_ns, block.rates_d[count - 1], integrated.sample(count - 1))
        jumps = () if update is None else self.comparison.apply_update(update, last)
        if jumps:
            self._accepted = seen._replace(before=None)
        self._previous = self._accepted
        wrong_after_ns = self._check_rates(previous, seen) if count == due else None
        sample = last if self._rate_check.is_usable else replace(last, rate_d=None)
        rejection = _step_rejection(jumps) if jumps else None
        checked = self.comparison.with_noise(CheckedInsSample(sample, rejection, jumps, wrong_after_ns))
        is_usual = not jumps and wrong_after_ns is None and checked.noise is None
        return count, None if is_usual else checked

    @staticmethod
    def _last_two(
        samples: Sequence[AttitudeSample], integrated: IntegratedRun, taken: NumberedSample, count: int
    ) -> tuple[NumberedSample, NumberedSample]:
        """Return the last two of ``count`` accepted samples, numbered; ``taken`` is the sample accepted before."""
        before = (taken.before, taken.sample, *samples[max(count - 3, 0) : count])
        last = NumberedSample(samples[count - 1], taken.number + count, before[-2], integrated.sample(count - 1))
        if count == 1:
            return taken, last
        return NumberedSample(samples[count - 2], last.number - 1, before[-3], integrated.sample(count - 2)), last

    def _check_next(
        self, sample: AttitudeSample, previous: NumberedSample | None, motion_references: Mapping[str, MotionReference]
    ) -> CheckedInsSample:
        """Check a sample that is later than all samples before."""
        integrated = self.comparison.integrator.integrate(sample.time_ns, sample.rate_d)
        number, before = (0, None) if previous is None else (previous.number + 1, previous.sample)
        self._previous = seen = NumberedSample(sample, number, before, integrated)
        self.by_rates = None
        if integrated is not None and self._rate_check.is_usable:
            self.by_rates = MotionReference(
                sample.time_ns, integrated.rotation, 0.0, self._predictions.drift.bound_rad_per_s
            )
            motion_references = {**motion_references, "rate": self.by_rates}
        sigma_rad = self.comparison.sigma_rad
        if self._stuck_check.observe(sample.time_ns, sample.rotation_nd, sigma_rad, motion_references):
            self._rate_check.restart()
            self.comparison.step_detector.restart()
            self._is_smooth_since_accepted = False
            return CheckedInsSample(sample, _STUCK)
        taken, is_on_line = self._accepted, None
        if taken is None or previous is None:
            self.comparison.excess.start_collecting(sample.time_ns, 0.0)
            self._accept(seen, None)
            return CheckedInsSample(sample)
        if integrated is not None:
            is_on_line, jumps = self.comparison.check(
                sample, integrated, self._stuck_check.coarseness_rad, accepts=previous is taken
            )
            if is_on_line and previous is taken:
                # Nearly all samples of a healthy INS take this branch.
                self._accepted = self._previous = seen._replace(before=None) if jumps else seen
                self._is_smooth_since_accepted = True
                is_due = sample.time_ns >= self._rate_check.due_ns
                wrong_after_ns = self._check_rates(previous, seen) if is_due else None
                return CheckedInsSample(sample, _step_rejection(jumps) if jumps else None, jumps, wrong_after_ns)
        return self._check_off_line(taken, previous, seen, is_on_line)

    def _check_off_line(
        self, taken: NumberedSample, previous: NumberedSample, seen: NumberedSample, on_line: bool | None
    ) -> CheckedInsSample:
        """Check a sample outside the usual case against the last accepted sample and the previous sample."""
        sample, measured = seen.sample, self._rate_check.status is RateStatus.MEASURED
        match = (
            self._predictions.match(taken, seen, measured) if on_line is None else self.comparison.step_detector.match()
        )
        step = match if previous is taken else self._predictions.match(previous, seen, measured)
        fits = match.fits
        if step is not match:
            fits = match.is_consistent_with(step) or (
                measured and self._predictions.are_rates_faulty_between(taken, seen, step)
            )
        if not fits:
            smooth = self._is_smooth_since_accepted and self._predictions.match_by_motion(previous, seen).fits
            self._is_smooth_since_accepted = smooth
            # Confirmed rates reject inconsistent attitudes. If the rates are then found to be wrong, these attitudes
            # are accepted, provided that each continued the motion of the samples before.
            fits = smooth and not measured
        verdict = self._jump_check.check(sample.time_ns, fits, step.fits)
        if verdict is JumpDecision.REJECTED:
            if self._jump_check.rejected_count == 1:
                self._jump_candidate = sample
                self._previous = seen._replace(before=extrapolate_back(sample, taken))
            wrong_after_ns = self._check_rates(previous, seen)
            if wrong_after_ns is not None and measured:
                self._unresolved_jump = InsJump(self._jump_check.since_ns - 1, match.difference, match.sigma_rad)
            return CheckedInsSample(sample, _gate_rejection(match), (), wrong_after_ns)
        return self._accept_off_line(taken, previous, seen, match, step is match, verdict is JumpDecision.JUMPED)

    def _accept_off_line(
        self,
        taken: NumberedSample,
        previous: NumberedSample,
        seen: NumberedSample,
        match: PredictionMatch,
        next_one: bool,
        jumped: bool,
    ) -> CheckedInsSample:
        """Accept a sample outside the usual case: without confirmed rates, after a rejected sample, or after a jump."""
        jumps: tuple[InsJump, ...] = ()
        rejection = None
        if self._unresolved_jump is not None:
            # The rates were found to be wrong; only other sources can confirm the attitudes.
            jumps, self._unresolved_jump = (self._unresolved_jump,), None
        elif jumped:
            jumps = (self._accepted_jump(match),)
        if not jumps and match.fits:
            jumps = self.comparison.accept(seen.sample)
            rejection = _step_rejection(jumps) if jumps else None
        else:
            self.comparison.step_detector.restart()
        self._accept(seen, None if jumps else taken)
        one = are_in_one_run(taken.integrated, seen.integrated)
        wrong_after_ns = self._check_rates(previous, seen)
        # The typical difference is estimated from steps of one sample.
        if not jumps and next_one:
            if self._rate_check.status is not RateStatus.MEASURED:
                self._learn_unproven(taken, seen, match, one)
            elif one:
                self._predictions.rate_bound.learn(match.difference)
        if self._rate_check.status is RateStatus.WRONG_UNITS:
            rejection = _units_rejection(self._rate_check.slope)
        return CheckedInsSample(seen.sample, rejection, jumps, wrong_after_ns)

    def _accepted_jump(self, match: PredictionMatch) -> InsJump:
        """Return the jump that is accepted after mutually consistent, rejected samples."""
        first, clock_s = self._jump_candidate, math.nan
        if first is not None and first.rate_d is not None and self._rate_check.status is RateStatus.MEASURED:
            clock_s = clock_step_s(match.difference, match.sigma_rad, first.rotation_nd @ first.rate_d)
        return InsJump(self._jump_check.since_ns - 1, match.difference, match.sigma_rad, clock_s)

    def _late_rejection(self, sample: AttitudeSample, before: AttitudeSample | None) -> Rejection | None:
        """Return the rejection of a sample that arrives after later samples, from the accepted sample ``before``."""
        if self._stuck_check.is_frozen(sample.rotation_nd):
            return _STUCK
        if self._rate_check.status is RateStatus.WRONG_UNITS:
            return _units_rejection(self._rate_check.slope)
        if before is None:
            return None
        match = self._predictions.match_by_two_rates(before, sample, self._rate_check.status is RateStatus.MEASURED)
        return None if match.fits else _gate_rejection(match)

    def _check_rates(self, previous: NumberedSample, seen: NumberedSample) -> int | None:
        """Check the rates if the attitude is plausible; return the stamp after which the rates are wrong, or None.

        If the status of the rates changes, :attr:`by_rates` is set or removed accordingly.
        """
        sample, integrated = seen.sample, seen.integrated
        if integrated is None or not are_in_one_run(previous.integrated, integrated) or self._stuck_check.is_repeated:
            return None
        reach_rad = FASTEST_RAD_PER_S * seconds_between(previous.sample, sample)
        # 0.75 of the chord between two matrices exceeds the rotation, so good samples need no logarithm.
        chord = math.hypot(*(sample.rotation_nd - previous.sample.rotation_nd).ravel().tolist())
        if not (0.75 * chord <= reach_rad <= 1.0 or self._predictions.match_by_time(previous.sample, sample).fits):
            self._rate_check.restart()
            return None
        # Noise of a rate, each axis, as an error of the attitude integrated over one sample interval.
        rate_noise_rad = self._predictions.rate_bound.typical_rad / math.sqrt(6.0)
        wrong_after_ns = self._rate_check.observe(
            sample.time_ns, seen.number, sample.rotation_nd, integrated, self._noise_rad, rate_noise_rad
        )
        if wrong_after_ns is not None:
            self.comparison.reset()
        # The status of the rates may have changed with this sample.
        if not self._rate_check.is_usable:
            self.by_rates = None
        elif self.by_rates is None:
            self.by_rates = MotionReference(
                sample.time_ns, integrated.rotation, 0.0, self._predictions.drift.bound_rad_per_s
            )
        return wrong_after_ns

    def _accept(self, seen: NumberedSample, before: NumberedSample | None) -> None:
        """Accept a sample; ``before`` is the earlier sample that defines its motion, None after a jump."""
        self._accepted = seen._replace(before=None if before is None else before.sample)
        if self._previous is seen:
            self._previous = self._accepted
        self._is_smooth_since_accepted = True

    def _learn_unproven(self, taken: NumberedSample, seen: NumberedSample, match: PredictionMatch, one: bool) -> None:
        """Update the bounds of predictions by motion and by usable rates, while the rates are not confirmed."""
        if match.is_predicted:
            self._predictions.motion_bound.learn(match.difference)
        if self._rate_check.is_usable and one:
            self._predictions.rate_bound.learn(self._predictions.match_by_rates(taken, seen).difference)


def _units_rejection(slope: float) -> Rejection:
    """Return the rejection of a sample whose rate turns ``slope`` times as fast as its attitude."""
    text = f"angular velocity turns {slope:.3g} times as fast as the orientation: degrees instead of radians?"
    return Rejection(Reason.UNITS, f"{text} ins/imu must be in rad/s")


def _gate_rejection(match: PredictionMatch) -> Rejection:
    """Return the rejection of a sample that differs from its prediction."""
    off, bound = math.degrees(vector_length(match.difference)), math.degrees(match.bound_rad)
    text = f"orientation is {off:.3g}° from its prediction by earlier samples: more than {bound:.3g}°"
    return Rejection(Reason.GATE, text)


def _step_rejection(jumps: tuple[InsJump, ...]) -> Rejection:
    """Return the rejection that reports a step or drift found in several samples.

    The samples since the step were accepted; the step is reported with the sample at which it was detected.
    """
    off_arcsec, how = vector_length(jumps[-1].jump_n) / ARCSEC, "drifted" if jumps[-1].is_drift else "stepped"
    return Rejection(Reason.GATE, f"orientation has {how} by {off_arcsec:.3g} arcsec against its own rates")

"""INS samples of the ship attitude: checks, track, batches, and the changes that a sample shows in the INS.

The adapter (:mod:`ship_node.adapters.input_processing`) reads a message by ``ins_sample`` of
:mod:`ship_node.messages.sensor_readers`, checks its clock, and passes the sample to :meth:`InsInput.add`. There it is
checked (:mod:`ship_estimation.plausibility.ins_check`), added to the time-ordered estimator, and corrected by the
filter's state for ``ship/attitude`` (``corrected_ins``). A sample is no measurement of the filter, but measurements
that waited for it are processed then, and a jump or new noise of the INS inflates the covariance. All files on this
way, from the callback of a live node on, are listed in ``docs/develop/architecture.md`` ("INS sample →
`ship/attitude`").

Offline, the samples of a period are available together and are checked in one call. Then the samples are committed in
order with the other inputs, so that the filter state at each sample equals that of a live node. Finally the attitudes
of all samples are computed, together for samples with the same filter state.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.attitude_output import AttitudeOutput, ShipEstimator
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import corrected_estimates
from ship_attitude_star.ship_attitude.model import INS
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.plausibility.checked_ins import CheckedBlock, CheckedInsSample, InsJump
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.plausibility.stuck_check import StuckChecks
from ship_estimation.recovery.recoverable_core import MAX_JUMPS
from ship_estimation.rejection_rules import Rejection, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_estimation.time_order.time_ordered_estimator import is_within_lag
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.tracks.attitude_track import (
    AttitudeSample,
    AttitudeTrack,
    ExtraNoise,
    SampleBlock,
    propagate_block,
)
from ship_stars.attitude_samples import AttitudeOutcome, AttitudeSeries


class _BatchSegment(NamedTuple):
    """Successive samples with the same filter state.

    Attributes:
        state: the filter state.
        start: index of the first sample.
        stop: index after the last sample.
        contradiction_texts: text of each sample, empty unless a source sent conflicting data; None if no source did.
    """

    state: FilterState
    start: int
    stop: int
    contradiction_texts: list[str] | None


@dataclass
class InsBatch:
    """A batch of checked INS samples.

    Attributes:
        samples: samples of the batch, which are the first samples of ``block``.
        block: samples as arrays; there may be further samples after those of the batch.
        arrivals_ns: arrival times, by the timeout clock.
        checked: results of the INS check. If the check found a sample that needs separate handling, this sample is
            ``checked.last``; it follows the batch and is not part of it.
        previous: the last samples before the batch, by whose rates the samples of the batch are propagated.
        extra_noise: noise of the samples in excess of the stated noise; None without excess noise.
        committed_count: number of committed samples.
        pending_outcomes: decisions and failures caused by samples, not yet retrieved, each with the index of its
            sample.
    """

    samples: list[AttitudeSample]
    block: SampleBlock
    arrivals_ns: StampArray
    checked: CheckedBlock
    previous: SampleBlock
    extra_noise: ExtraNoise | None = None
    committed_count: int = 0
    pending_outcomes: list[tuple[int, AttitudeOutcome]] = field(default_factory=list)
    _segments: list[_BatchSegment] = field(default_factory=list)

    def commit(self, state: FilterState, stop: int, contradiction_texts: list[str] | None) -> None:
        """Commit the samples before index ``stop``; arguments as the attributes of a segment."""
        start, self.committed_count = self.committed_count, stop
        last = self._segments[-1] if self._segments else None
        if (
            last is not None
            and last.state is state
            and last.contradiction_texts is None
            and contradiction_texts is None
        ):
            start = self._segments.pop().start
        self._segments.append(_BatchSegment(state, start, stop, contradiction_texts))

    def attitudes(self, output: AttitudeOutput) -> list[tuple[slice, AttitudeSeries | Rejection]]:
        """Return the attitudes of all committed samples in order, one series per segment.

        Args:
            output: corrections by filter states.

        Returns:
            Slices of sample indices, with their attitudes or the failure to compute them.
        """
        corrected = [output.corrected_by(segment.state) for segment in self._segments]
        samples = [slice(segment.start, segment.stop) for segment in self._segments]
        counts = [some.stop - some.start for some in samples]
        propagation_s = np.repeat([one.propagation_s for one in corrected], counts)
        propagated = propagate_block(self.previous, self.block, propagation_s).with_noise(self.extra_noise)
        times_ns, found = self.block.times_ns[: self.committed_count], list[AttitudeSeries | Rejection]()
        try:
            found += corrected_estimates(corrected, counts, times_ns, propagated)
        except Exception:
            # The segments are computed one by one to find the segment that fails.
            for one, some, count in zip(corrected, samples, counts, strict=True):
                part = propagated.subset(some)
                try:
                    found += corrected_estimates([one], [count], times_ns[some], part)
                except Exception as error:
                    found.append(failure_rejection(error))
        for segment, run in zip(self._segments, found, strict=True):
            for number, text in enumerate(segment.contradiction_texts or ()):
                if text and isinstance(run, AttitudeSeries):
                    run.status[number], run.text[number] = max(run.status[number], Status.DEGRADED), text
        return list(zip(samples, found, strict=True))


class InsInput:
    """Stream of INS samples.

    Args:
        config: parameters of the node.
        estimator: time-ordered estimator of the ship filter.
        output: attitudes to publish.

    Attributes:
        track: accepted samples.
        ins_check: plausibility checks of the samples.
        stuck_checks: checks for a constant value of the other sources.
        jumps: jumps that were detected from the INS rates and not yet read.
    """

    def __init__(self, config: ShipAttitudeConfig, estimator: ShipEstimator, output: AttitudeOutput) -> None:
        self._estimator, self._output = estimator, output
        self.jumps: deque[InsJump] = deque(maxlen=MAX_JUMPS)
        self._lag_s, self._max_gap_ns = config.lag_s, round(config.ins.max_gap_s * SECOND_NS)
        self.reset()

    def reset(self) -> None:
        """Discard all samples and restart the checks."""
        self.track = AttitudeTrack(self._max_gap_ns)
        self.ins_check, self.stuck_checks = InsCheck(self._output.config.ins), StuckChecks()
        self.jumps.clear()

    def add(self, sample: AttitudeSample, arrival_ns: int | None = None, estimate: bool = True) -> AttitudeOutcome:
        """Add an INS sample.

        Args:
            sample: attitude of the deck, and rate of the deck if the INS measures the rate.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
            estimate: False if no attitude is needed, as in a Monte Carlo run.
        """
        if sample.time_ns < self._estimator.window.oldest_ns:
            return AttitudeOutcome(self._estimator.window.late_rejection(sample.time_ns))
        checked = self.ins_check.check(sample, self.track, self.stuck_checks.motion_references)
        return self._use(checked, sample.time_ns if arrival_ns is None else arrival_ns, estimate)

    def evaluate_block(self, block: SampleBlock, arrivals_ns: StampArray) -> InsBatch | None:
        """Check the INS samples of a block as one batch, up to the first sample that needs separate handling.

        No other INS sample may be added until the batch is committed (:meth:`commit_block`, :meth:`finish_block`).

        Args:
            block: samples with rates, in the order of their stamps.
            arrivals_ns: arrival times by the timeout clock, shape (N,).

        Returns:
            The batch; None if the first sample needs separate handling.
        """
        first_ns = int(block.times_ns[0])
        # The vertical at a sample may change with position fixes that arrive before the block ends.
        if self._output.must_be_single or not self.ins_check.can_check_block(first_ns):
            return None
        newest, before, arrival_ns = self.track.newest, self.track.recent_block(), self._output.ins_arrival_ns
        if newest is None or before is None or arrival_ns is None:
            return None
        if not (newest.time_ns < first_ns and self._output.sequence.can_publish(first_ns)):
            return None
        # The batch ends before a gap, before an INS timeout, and before a sample that may be late.
        steps_ns = np.diff(block.times_ns, prepend=newest.time_ns)
        waits_ns = np.diff(arrivals_ns, prepend=arrival_ns)
        near = (
            (steps_ns <= self._max_gap_ns) & (waits_ns >= 0) & (waits_ns <= min(self._output.ins_timeout_ns, SECOND_NS))
        )
        near &= is_within_lag(block.times_ns, arrivals_ns, self._lag_s)
        block = block.subset(slice(len(near) if near.all() else int(np.argmin(near))))
        if not len(block.times_ns):
            return None
        samples = block.samples()
        checked = self.ins_check.check_block(samples, block)
        if not checked.count:
            return None
        extra = self.track.extra_noise(first_ns)
        return InsBatch(samples[: checked.accepted_count], block, arrivals_ns, checked, before, extra)

    def commit_block(self, batch: InsBatch, stop: int) -> None:
        """Commit the samples of a batch before index ``stop``."""
        while batch.committed_count < stop:
            if self._estimator.is_idle:
                end = stop
                self.track.extend(batch.samples[batch.committed_count : end])
                self._estimator.advance_to(batch.samples[end - 1].time_ns)
            else:
                # A pending measurement may need this sample.
                end, outcome = batch.committed_count + 1, AttitudeOutcome()
                self._estimator.add_sample(INS, self.track, batch.samples[batch.committed_count], outcome)
                if outcome.decisions or outcome.failures:
                    batch.pending_outcomes.append((batch.committed_count, outcome))
            contradiction_texts = None
            if not self._estimator.stamp_conflicts.is_empty:
                contradiction_texts = [
                    self._output.contradiction_text(sample.time_ns)
                    for sample in batch.samples[batch.committed_count : end]
                ]
            batch.commit(self._estimator.state_now, end, contradiction_texts)
            self._output.ins_arrival_ns = arrival_ns = int(batch.arrivals_ns[end - 1])
            self._output.sequence.record(batch.samples[end - 1].time_ns, arrival_ns, self._output.ins_timeout_ns)
            self.ins_check.by_rates = batch.checked.by_rates(end - 1)

    def finish_block(self, batch: InsBatch) -> AttitudeOutcome | None:
        """Finish a batch; return the outcome of the sample that needs separate handling, None without such a sample."""
        values, last = batch.block.rotations_nd[: batch.checked.count], batch.checked.last
        self.ins_check.commit_block(values, batch.checked, self.stuck_checks.motion_references)
        if last is None:
            return None
        return self._use(last, int(batch.arrivals_ns[len(batch.samples)]), True)

    def _use(self, checked: CheckedInsSample, arrival_ns: int, estimate: bool) -> AttitudeOutcome:
        """Use a checked INS sample and publish the attitude at its stamp."""
        sample, outcome = checked.sample, AttitudeOutcome()
        if checked.rates_wrong_after_ns is not None:
            # The rates are faulty. Measurements evaluated with these rates are evaluated again without rates.
            changed_after_ns = self.track.drop_rates(checked.rates_wrong_after_ns)
            if changed_after_ns is not None:
                self._estimator.rewind_after(changed_after_ns)
                self._estimator.apply(outcome)
        if checked.noise is not None:
            # Measurements since the change are evaluated again with the measured noise of the samples.
            since_ns = self.track.add_noise(checked.noise)
            self._estimator.add_jump(
                self._output.filter.change_effective_ns(checked.noise), INS, checked.noise, since_ns
            )
            self._estimator.apply(outcome)
        self.jumps.extend(checked.jumps)
        for jump in checked.jumps:
            effective_ns = self._output.filter.change_effective_ns(jump)
            self._estimator.add_jump(effective_ns, INS, jump, self.track.add_cut(jump.time_ns))
        if checked.rejection is not None:
            outcome.rejection = checked.rejection
            self._estimator.add_rejected(INS, self.track, sample)
            return outcome
        if not self._estimator.add_sample(INS, self.track, sample, outcome):
            return outcome
        # Propagation by a clock offset needs the rate. Without a rate an attitude is published only before the first
        # measurement.
        if self.track.newest is sample and (
            sample.rate_d is not None or self.track.is_newest_joined or self._estimator.state.time_ns is None
        ):
            self._output.ins_arrival_ns = arrival_ns
            if estimate:
                self._output.publish_from_ins(outcome, self.track, sample.time_ns, arrival_ns)
        return outcome

    def block_estimates(self, batch: InsBatch) -> list[tuple[slice, AttitudeSeries | Rejection]]:
        """Return the attitudes at the stamps of a batch; see :meth:`InsBatch.attitudes`."""
        return batch.attitudes(self._output)

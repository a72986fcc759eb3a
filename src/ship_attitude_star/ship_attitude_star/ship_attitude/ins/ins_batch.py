"""Batches of INS samples for offline processing, and the attitudes at their stamps.

Offline, the samples of a period are available together and are checked in one call. Then the samples are committed in
order with the other inputs, so that the filter state at each sample equals that of a live node. Finally the attitudes
of all samples are computed, together for samples with the same filter state.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.ins.corrected_ins import CorrectedIns, corrected_estimates
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.plausibility.checked_ins import CheckedBlock
from ship_estimation.rejection_rules import Rejection, failure_rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.tracks.attitude_track import (
    AttitudeSample,
    ExtraNoise,
    PropagatedBlock,
    RecentRates,
    SampleBlock,
    propagate_block,
)
from ship_stars.samples.attitude_samples import AttitudeOutcome, AttitudeSeries, StampArray


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
        previous_rates: rates of the samples before the batch.
        extra_noise: noise of the samples in excess of the stated noise; None without excess noise.
        committed_count: number of committed samples.
        pending_outcomes: decisions and failures caused by samples, not yet retrieved, each with the index of its
            sample.
    """

    samples: list[AttitudeSample]
    block: SampleBlock
    arrivals_ns: StampArray
    checked: CheckedBlock
    previous_rates: RecentRates
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

    def attitudes(
        self,
        corrected_by: Callable[[FilterState], CorrectedIns],
        propagation_s: Callable[[CorrectedIns], float],
        config: ShipAttitudeConfig,
    ) -> list[tuple[slice, AttitudeSeries | Rejection]]:
        """Return the attitudes of all committed samples in order, one series per segment.

        Args:
            corrected_by: function that returns the corrections by a filter state.
            propagation_s: function that returns the time by which a sample is propagated with these corrections, s.
            config: configuration of the node.

        Returns:
            Slices of sample indices, with their attitudes or the failure to compute them.
        """
        corrected = [corrected_by(segment.state) for segment in self._segments]
        counts = [stretch.stop - stretch.start for stretch in self._segments]
        propagated = propagate_block(
            self.previous_rates, self.block, np.repeat([propagation_s(one) for one in corrected], counts)
        )
        propagated = propagated.with_noise(self.extra_noise)
        try:
            found: list[AttitudeSeries | Rejection] = [
                *corrected_estimates(corrected, counts, self._times_ns, propagated, config)
            ]
        except Exception:
            # The segments are computed one by one to find the segment that fails.
            pairs = zip(corrected, self._segments, strict=True)
            found = [self._attitudes_of(one, stretch, propagated, config) for one, stretch in pairs]
        for stretch, run in zip(self._segments, found, strict=True):
            for number, text in enumerate(stretch.contradiction_texts or ()):
                if text and isinstance(run, AttitudeSeries):
                    run.status[number], run.text[number] = max(run.status[number], Status.DEGRADED), text
        return [(slice(stretch.start, stretch.stop), run) for stretch, run in zip(self._segments, found, strict=True)]

    @property
    def _times_ns(self) -> StampArray:
        return self.block.times_ns[: self.committed_count]

    def _attitudes_of(
        self, corrected: CorrectedIns, segment: _BatchSegment, propagated: PropagatedBlock, config: ShipAttitudeConfig
    ) -> AttitudeSeries | Rejection:
        """Return the attitudes of one segment, or the failure to compute them."""
        some, count = slice(segment.start, segment.stop), segment.stop - segment.start
        try:
            (run,) = corrected_estimates([corrected], [count], self._times_ns[some], propagated.subset(some), config)
        except Exception as error:
            return failure_rejection(error)
        return run

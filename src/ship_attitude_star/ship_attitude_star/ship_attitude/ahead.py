"""Samples of an INS that are judged before their turn, and the attitudes that they become when all of them have come.

Offline the samples of some time are there together. They are judged in one go. Then each has its turn among the other
inputs, so that the filter's state at each sample is what it is live. At the end the attitudes of all are computed,
those that rest on one state together.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeOutcome, AttitudeRun, StampArray
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns, estimates_by
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.ins_guard import Followed
from ship_estimation.outcome import Status
from ship_estimation.refusals import Refusal, failure
from ship_geometry.attitude_track import (
    AttitudeSample,
    ExtraNoise,
    MovedBlock,
    RecentRates,
    SampleBlock,
    moved_block,
)


class _Stretch(NamedTuple):
    """Samples that follow one another and whose attitudes rest on one state.

    Attributes:
        state: of the filter.
        start: number of the first one.
        stop: number behind the last one.
        doubts: of each, why its attitude is DEGRADED whatever it rests on, or an empty text; None for no doubt at all.
    """

    state: FilterState
    start: int
    stop: int
    doubts: list[str] | None


@dataclass
class InsAhead:
    """The samples of a block that were judged ahead.

    Attributes:
        samples: those that go the usual way, from the first one on.
        block: the same as arrays.
        arrivals_ns: when each comes, in the time of waiting.
        followed: what the guard said of them, and of one more where that does not go the usual way.
        before: the samples before them.
        extra: noise of the samples beyond what is stated; None where there is none.
        taken: how many had their turn.
        told: number of a sample, and what its turn led to besides an attitude, as far as nobody has asked for it.
    """

    samples: list[AttitudeSample]
    block: SampleBlock
    arrivals_ns: StampArray
    followed: Followed
    before: RecentRates
    extra: ExtraNoise | None = None
    taken: int = 0
    told: list[tuple[int, AttitudeOutcome]] = field(default_factory=list)
    _stretches: list[_Stretch] = field(default_factory=list)

    def had_turn(self, state: FilterState, stop: int, doubts: list[str] | None) -> None:
        """Samples up to one, not included, had their turn; arguments as in the attributes of a stretch."""
        start, self.taken = self.taken, stop
        last = self._stretches[-1] if self._stretches else None
        if last is not None and last.state is state and last.doubts is None and doubts is None:
            start = self._stretches.pop().start
        self._stretches.append(_Stretch(state, start, stop, doubts))

    def attitudes(
        self,
        corrected_by: Callable[[FilterState], CorrectedIns],
        moved_s: Callable[[CorrectedIns], float],
        config: ShipAttitudeConfig,
    ) -> list[tuple[slice, AttitudeRun | Refusal]]:
        """The attitudes of all samples that had their turn, in order, those of one state together.

        Args:
            corrected_by: INS attitudes corrected by a state.
            moved_s: by so much a sample is moved then, s.
            config: of the node.

        Returns:
            Numbers of the samples, and their attitudes, or why these could not be computed.
        """
        corrected = [corrected_by(stretch.state) for stretch in self._stretches]
        counts = [stretch.stop - stretch.start for stretch in self._stretches]
        moved = moved_block(self.before, self.block, np.repeat([moved_s(one) for one in corrected], counts))
        moved = moved.with_noise(self.extra)
        try:
            found: list[AttitudeRun | Refusal] = [*estimates_by(corrected, counts, self._times_ns, moved, config)]
        except Exception:
            # Which of them cannot be computed is found out one by one.
            pairs = zip(corrected, self._stretches, strict=True)
            found = [self._attitudes_of(one, stretch, moved, config) for one, stretch in pairs]
        for stretch, run in zip(self._stretches, found, strict=True):
            for number, doubt in enumerate(stretch.doubts or ()):
                if doubt and isinstance(run, AttitudeRun):
                    run.status[number], run.text[number] = max(run.status[number], Status.DEGRADED), doubt
        return [(slice(stretch.start, stretch.stop), run) for stretch, run in zip(self._stretches, found, strict=True)]

    @property
    def _times_ns(self) -> StampArray:
        return self.block.times_ns[: self.taken]

    def _attitudes_of(
        self, corrected: CorrectedIns, stretch: _Stretch, moved: MovedBlock, config: ShipAttitudeConfig
    ) -> AttitudeRun | Refusal:
        """The attitudes of one stretch, or why these cannot be computed."""
        some, count = slice(stretch.start, stretch.stop), stretch.stop - stretch.start
        try:
            (run,) = estimates_by([corrected], [count], self._times_ns[some], moved.some(some), config)
        except Exception as error:
            return failure(error)
        return run

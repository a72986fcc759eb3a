"""The guard of the ship's attitude, which may be told what comes: it then judges many attitudes at once.

Offline the attitudes of some seconds are read before the first of them has its turn. Those that go the way of nearly
all are judged together, as the samples of an INS are (:meth:`ship_estimation.ins_guard.InsGuard.look_ahead`); each
judgement is given out when its attitude comes. Where another one comes than was told, the guard goes back to the state
that it had before, judges what has come one by one, and goes on so. A live node tells nothing of what comes.
"""

import copy
import math
from collections.abc import Sequence

import numpy as np

from ship_estimation.ins import GuardedInsConfig
from ship_estimation.ins_guard import Followed, InsGuard, JudgedIns
from ship_estimation.rate_guard import Rates
from ship_geometry.attitude_track import AttitudeTrack, SampleBlock
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.measured.samples import ShipSample

_SIGMAS = 5.0
"""So many sigmas of what it states of its covariance the source may step."""

_PATIENCE = 8
"""Where an attitude does not go the usual way, so many after it are judged one by one."""


class GuardAhead:
    """Judges the attitudes of the ship, told ahead or not: what is said of each is the same.

    Args:
        config: noise of the attitudes, and after how many refused ones a jump is believed.
    """

    def __init__(self, config: GuardedInsConfig) -> None:
        self._guard = InsGuard(config)
        self._max_gap_ns = round(config.max_gap_s * SECOND_NS)
        self._forget_expected()

    def _forget_expected(self) -> None:
        self._expected: list[ShipSample] = []
        # Those of them that came, each with what the source said of a step; the guard as it was before the first.
        self._judged: list[tuple[ShipSample, float]] = []
        self._before: InsGuard | None = None
        # Those that were judged before their turn, and the place of the first of them.
        self._followed: Followed | None = None
        self._first = self._patience = 0

    def reconfigure(self, config: GuardedInsConfig) -> None:
        """Go on with another noise."""
        self._go_back()
        self._forget_expected()
        self._guard.reconfigure(config)

    @property
    def rates(self) -> Rates:
        """What the rates are worth."""
        return self._guard.rates if self._followed is None else Rates.MEASURED

    def expect(self, samples: Sequence[ShipSample]) -> None:
        """These attitudes come next, as far as is known now."""
        if self._judged or not self._expected:
            self._go_back()
            self._forget_expected()
            self._before = copy.deepcopy(self._guard)
        self._expected += samples
        self._block, self._told_rad = _arrays(self._expected)

    def judge(self, sample: ShipSample, used: AttitudeTrack, told_rad: float) -> JudgedIns:
        """What :meth:`ship_estimation.ins_guard.InsGuard.judge` says of an attitude, without witnesses.

        Args:
            sample: the attitude.
            used: those used so far.
            told_rad: by so much the source itself says that it may have stepped with it.
        """
        place = len(self._judged)
        if place == len(self._expected) or sample is not self._expected[place]:
            self._go_back()
            self._forget_expected()
            return self._guard.judge(sample, used, {}, told_rad)
        if self._followed is None:
            self._look_ahead(place, told_rad)
        self._judged.append((sample, told_rad))
        followed = self._followed
        if followed is None:
            return self._guard.judge(sample, used, {}, told_rad)
        if place + 1 < self._first + followed.count:
            return JudgedIns(sample)
        values = self._block.rotations_nd[self._first : place + 1]
        self._guard.arrive(values, followed, {})
        self._followed = None
        return JudgedIns(sample) if followed.last is None else followed.last

    def _look_ahead(self, place: int, told_rad: float) -> None:
        """Judge the attitudes from one on, as long as they go the usual way."""
        if self._patience:
            self._patience -= 1
            return
        times_ns, least_rad = self._block.times_ns, self._guard.least_step_rad
        # Written so that NaN is judged by itself.
        if not (self._guard.looks_ahead(int(times_ns[place])) and told_rad <= least_rad):
            return
        # Not beyond a gap, nor where the source may have stepped by what is told from noise.
        steps_ns = np.diff(times_ns[place:])
        usual = (steps_ns > 0) & (steps_ns <= self._max_gap_ns) & (self._told_rad[place + 1 :] <= least_rad)
        end = len(times_ns) if usual.all() else place + 1 + int(np.argmin(usual))
        followed = self._guard.look_ahead(self._expected[place:end], self._block.some(slice(place, end)))
        if followed.count:
            self._followed, self._first = followed, place
        else:
            self._patience = _PATIENCE

    def _go_back(self) -> None:
        """Judge what has come one by one, where some were judged that have not."""
        if self._followed is None:
            return
        assert self._before is not None
        self._guard, nothing = self._before, AttitudeTrack(0)
        for sample, told_rad in self._judged:
            self._guard.judge(sample, nothing, {}, told_rad)


def told_step_rad(covariance_n: FloatArray | None, before_n: FloatArray | None) -> float:
    """How far the source may have stepped with an attitude by what it states of its covariance, and did before."""
    if covariance_n is None or before_n is None:
        return 0.0
    return _SIGMAS * math.sqrt(abs(float((covariance_n - before_n).trace())))


def _arrays(samples: Sequence[ShipSample]) -> tuple[SampleBlock, FloatArray]:
    """Attitudes that have rates and covariances, and how far the source may have stepped with each, rad, shape (N,)."""
    block = SampleBlock(
        np.array([sample.time_ns for sample in samples]),
        np.array([sample.rotation_nd for sample in samples]),
        np.array([sample.rate_d for sample in samples]),
    )
    stated = [sample.slow_covariance_n for sample in samples]
    return block, np.array([told_step_rad(now, before) for now, before in zip(stated, [None, *stated], strict=False)])

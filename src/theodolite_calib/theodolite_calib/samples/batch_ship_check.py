"""Check of the ship's attitudes, one by one or in batches announced beforehand.

Offline the attitudes of some seconds are read before they are used. Regular attitudes are checked together
(:meth:`ship_estimation.plausibility.ins_check.InsCheck.check_block`), and each result is returned when its attitude
comes. If an attitude comes that was not announced, the check returns to its state before the batch and continues one by
one. A live node announces no attitudes.
"""

import copy
import math
from collections.abc import Sequence

import numpy as np

from ship_estimation.parameters.ins import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedBlock, CheckedInsSample
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.plausibility.rate_consistency import RateStatus
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack, SampleBlock
from theodolite_calib.samples.samples import ShipSample

_STATED_STEP_SIGMAS = 5.0
"""Possible step of a source's attitude, in multiples of the square root of the change of its stated variance."""

_SINGLE_CHECKS = 8
"""Number of attitudes that are checked one by one after a block whose first attitude could not be accepted."""


class BatchShipCheck:
    """Check of the ship's attitudes, with equal results whether attitudes are announced or not.

    Args:
        config: noise of the attitudes, and number of rejections after which a jump is accepted.
    """

    def __init__(self, config: CheckedInsConfig) -> None:
        self._ins_check = InsCheck(config)
        self._max_gap_ns = round(config.max_gap_s * SECOND_NS)
        self._clear_batch()

    def _clear_batch(self) -> None:
        self._batch: list[ShipSample] = []
        # Received attitudes of the batch, each with the step that the change of its stated covariance allows, rad.
        self._checked: list[tuple[ShipSample, float]] = []
        # Copy of the check from before the batch.
        self._check_before_batch: InsCheck | None = None
        # Result for the attitudes that were checked as a block, and the index of the first of these attitudes.
        self._checked_block: CheckedBlock | None = None
        self._first = self._single_checks_left = 0

    def reconfigure(self, config: CheckedInsConfig) -> None:
        """Apply a changed noise."""
        self._discard_checked_block()
        self._clear_batch()
        self._ins_check.reconfigure(config)

    @property
    def rate_status(self) -> RateStatus:
        """Status of the rates."""
        return self._ins_check.rate_status if self._checked_block is None else RateStatus.MEASURED

    def expect(self, samples: Sequence[ShipSample]) -> None:
        """Announce the next attitudes."""
        if self._checked or not self._batch:
            self._discard_checked_block()
            self._clear_batch()
            self._check_before_batch = copy.deepcopy(self._ins_check)
        self._batch += samples
        self._block, self._reported_steps_rad = _arrays(self._batch)

    def check(self, sample: ShipSample, accepted_track: AttitudeTrack, reported_step_rad: float) -> CheckedInsSample:
        """Check an attitude as ``InsCheck.check`` does, without motion references.

        Args:
            sample: the attitude.
            accepted_track: attitudes accepted before.
            reported_step_rad: possible step from the previous attitude to this one, as reported by the source, rad.
        """
        place = len(self._checked)
        if place == len(self._batch) or sample is not self._batch[place]:
            self._discard_checked_block()
            self._clear_batch()
            return self._ins_check.check(sample, accepted_track, {}, reported_step_rad)
        if self._checked_block is None:
            self._check_block(place, reported_step_rad)
        self._checked.append((sample, reported_step_rad))
        checked = self._checked_block
        if checked is None:
            return self._ins_check.check(sample, accepted_track, {}, reported_step_rad)
        if place + 1 < self._first + checked.count:
            return CheckedInsSample(sample)
        values = self._block.rotations_nd[self._first : place + 1]
        self._ins_check.commit_block(values, checked, {})
        self._checked_block = None
        return CheckedInsSample(sample) if checked.last is None else checked.last

    def _check_block(self, place: int, reported_step_rad: float) -> None:
        """Check the regular attitudes from the index ``place`` on as a block."""
        if self._single_checks_left:
            self._single_checks_left -= 1
            return
        times_ns, least_rad = self._block.times_ns, self._ins_check.least_step_rad
        # The condition is written so that attitudes with NaN are checked one by one.
        if not (self._ins_check.can_check_block(int(times_ns[place])) and reported_step_rad <= least_rad):
            return
        # The block ends before a gap, and before a reported step that exceeds the noise.
        steps_ns = np.diff(times_ns[place:])
        is_regular = (
            (steps_ns > 0) & (steps_ns <= self._max_gap_ns) & (self._reported_steps_rad[place + 1 :] <= least_rad)
        )
        end = len(times_ns) if is_regular.all() else place + 1 + int(np.argmin(is_regular))
        checked = self._ins_check.check_block(self._batch[place:end], self._block.subset(slice(place, end)))
        if checked.count:
            self._checked_block, self._first = checked, place
        else:
            self._single_checks_left = _SINGLE_CHECKS

    def _discard_checked_block(self) -> None:
        """Discard a block with attitudes that did not come, and check the received attitudes one by one."""
        if self._checked_block is None:
            return
        assert self._check_before_batch is not None
        self._ins_check, nothing = self._check_before_batch, AttitudeTrack(0)
        for sample, reported_step_rad in self._checked:
            self._ins_check.check(sample, nothing, {}, reported_step_rad)


def stated_step_rad(covariance_n: FloatArray | None, before_n: FloatArray | None) -> float:
    """Return the possible step of a source's attitude at a change of the stated covariance, rad."""
    if covariance_n is None or before_n is None:
        return 0.0
    return _STATED_STEP_SIGMAS * math.sqrt(abs(float((covariance_n - before_n).trace())))


def _arrays(samples: Sequence[ShipSample]) -> tuple[SampleBlock, FloatArray]:
    """Return attitudes with rates as arrays, and the source's possible step to each attitude, rad, shape (N,)."""
    block = SampleBlock(
        np.array([sample.time_ns for sample in samples]),
        np.array([sample.rotation_nd for sample in samples]),
        np.array([sample.rate_d for sample in samples]),
    )
    stated = [sample.correlated_covariance_n for sample in samples]
    return block, np.array([stated_step_rad(now, before) for now, before in zip(stated, [None, *stated], strict=False)])

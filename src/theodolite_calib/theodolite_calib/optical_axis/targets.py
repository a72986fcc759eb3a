"""Direction of a target at the middle of its exposure, from the main axis at that time.

An image waits until the pointings before and after it have been published. Images of targets do not affect the
pointings, which are equal to the last bit with and without the images.

The status of a direction is the worst status of three pointings: the published pointings before and after the middle,
and the pointing at the middle. Images with conflicting stamps also make the direction DEGRADED.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection, StampConflicts, failure_rejection, resolve_same_stamp
from ship_estimation.time_order.outcome import MeasurementDecision, Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.mount.axes import AxisErrors
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput
from theodolite_calib.optical_axis.target_direction import TargetOutput
from theodolite_calib.samples.samples import (
    EncoderSample,
    PointingOutcome,
    TargetEstimate,
    TargetSample,
)
from theodolite_calib.samples.tracks import MeasuredTracks

MAX_WAITING = 1000
"""Maximum number of pending images; beyond it the oldest are rejected."""

_MAX_ANSWERED = 5000
"""Maximum number of answered images stored to detect repetitions, enough for more than one second of data."""

_Key = tuple[int, str]


class PendingTargets:
    """Pending images of one run, and recently answered images.

    An image is answered by a direction or a rejection.

    Args:
        stamp_conflicts: stamp conflicts of the source of the images.

    Attributes:
        waiting: pending images, each with its time of reception, by stamp and target.
    """

    def __init__(self, stamp_conflicts: StampConflicts) -> None:
        self.waiting: dict[_Key, tuple[TargetSample, int]] = {}
        self._answered: dict[_Key, TargetSample] = {}
        self._order: deque[_Key] = deque()
        self._stamp_conflicts = stamp_conflicts

    def add(self, sample: TargetSample, waiting_ns: int) -> Rejection | None:
        """Add an image; return the rejection of this or the replaced image, None if the stamp is new for the target."""
        key = sample.time_ns, sample.target_id
        waits = self.waiting.get(key)
        known = waits[0] if waits is not None else self._answered.get(key)
        if known is not None:
            takes_its_place, rejection = resolve_same_stamp(known, sample)
            self._stamp_conflicts.record(sample.source, sample.time_ns, rejection)
            if takes_its_place and waits is not None:
                self.waiting[key] = sample, waits[1]
            return rejection
        self.waiting[key] = sample, waiting_ns
        return None

    def remove_overflow(self) -> list[TargetSample]:
        """Remove and return the oldest images if too many are pending."""
        keys = sorted(self.waiting)[: max(len(self.waiting) - MAX_WAITING, 0)]
        return [self.waiting.pop(key)[0] for key in keys]

    def pending_images(self) -> list[tuple[TargetSample, int]]:
        """Return the pending images in the order of their stamps, each with its time of reception."""
        return [self.waiting[key] for key in sorted(self.waiting)]

    def mark_answered(self, sample: TargetSample) -> None:
        """Mark an image as answered."""
        key = sample.time_ns, sample.target_id
        del self.waiting[key]
        self._answered[key] = sample
        self._order.append(key)
        if len(self._order) > _MAX_ANSWERED:
            del self._answered[self._order.popleft()]

    def conflict_text(self, time_ns: int) -> str:
        """Return the text about recently received conflicting images at a time; empty without conflicts.

        All targets share one text, because there is no limit to the number of target names that a source may send.
        """
        return self._stamp_conflicts.text(self._stamp_conflicts.active_at(time_ns))


class TargetProcessor:
    """Target images of one run; each answered image gives a direction, or an INVALID direction and a rejection.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        pointing: computes the pointings.
        tracks: tracks of the measured samples.
        stamp_conflicts: stamp conflicts of the source of the images.

    Attributes:
        pending: pending images.
    """

    def __init__(
        self,
        config: OpticalAxisConfig,
        filter_: CalibrationFilter,
        pointing: PointingOutput,
        tracks: MeasuredTracks,
        stamp_conflicts: StampConflicts,
    ) -> None:
        self.pending = PendingTargets(stamp_conflicts)
        self._published: deque[PendingPointing] = deque()
        self._tracks = tracks
        self.reconfigure(config, filter_, pointing)

    def reconfigure(self, config: OpticalAxisConfig, filter_: CalibrationFilter, pointing: PointingOutput) -> None:
        """Apply changed noise."""
        self._config, self._pointing = config, pointing
        self._directions = TargetOutput(config, filter_)
        self._axes = AxisErrors.from_vector(config.axes.values)

    def take_over(self, before: "TargetProcessor") -> None:
        """Take over the images and pointings of the processor ``before``, whose estimator ends."""
        self.pending, self._published = before.pending, before._published

    def add(self, sample: TargetSample, waiting_ns: int, outcome: PointingOutcome) -> None:
        """Add an image that is not late; if too many images wait, the oldest is rejected."""
        outcome.rejection = self.pending.add(sample, waiting_ns)
        for overflowing in self.pending.remove_overflow():
            text = "too many images of targets wait for the pointing: the oldest is rejected"
            outcome.decisions.append(_rejection(overflowing, Rejection(Reason.OVERFLOW, text)))

    def record_outputs(self, pointings: Sequence[PendingPointing], oldest_ns: int) -> None:
        """Record published pointings; later images are not older than ``oldest_ns``."""
        self._published.extend(pointings)
        # The last pointing up to ``oldest_ns`` stays, because the oldest possible image needs this pointing.
        while len(self._published) > 1 and self._published[1].sample.time_ns <= oldest_ns:
            self._published.popleft()

    def publish_ready(
        self, outcome: PointingOutcome, waiting_ns: int | None, oldest_ns: int, state: Callable[[], CalibrationState]
    ) -> None:
        """Publish the directions of images whose pointing is final or can no longer come, and of overdue images.

        Args:
            outcome: receives the directions and the rejections.
            waiting_ns: time by the timeout clock at a tick; None at a message. An image that has waited too long is
                thus processed at ticks only, because a rejected message must not trigger a direction.
            oldest_ns: time before which data can no longer come.
            state: returns the current state of the filter, for outputs.
        """
        max_wait_ns = max(SECOND_NS, round(self._config.lag_s * SECOND_NS))
        for sample, received_ns in self.pending.pending_images():
            is_overdue = waiting_ns is not None and waiting_ns - received_ns > max_wait_ns
            if is_overdue or sample.time_ns < oldest_ns or self._is_covered(sample):
                self.pending.mark_answered(sample)
                self._publish_direction(sample, outcome, state())

    def _is_covered(self, sample: TargetSample) -> bool:
        """True if later data cannot change the direction, and a pointing after the image has been published."""
        if not (self._published and self._published[-1].sample.time_ns >= sample.time_ns):
            return False
        return self._tracks.are_axes_final_at(sample.time_ns + sample.reach_ns)

    def _publish_direction(self, sample: TargetSample, outcome: PointingOutcome, state: CalibrationState) -> None:
        try:
            found = self._direction(sample, state)
        except Exception as error:
            outcome.failures.append((sample.time_ns, failure_rejection(error)))
            found = failure_rejection(error)
        if isinstance(found, Rejection):
            outcome.decisions.append(_rejection(sample, found))
            found = TargetEstimate(sample.time_ns, sample.target_id, Status.INVALID, found.text)
        outcome.targets.append(found)

    def _direction(self, sample: TargetSample, state: CalibrationState) -> TargetEstimate | Rejection:
        """Return the direction of a target, or the rejection if there is no pointing at the image."""
        adjacent, nodes = self._adjacent_pointings(sample.time_ns), sample.nodes
        axes = self._tracks.axes_at(sample.time_ns)
        if isinstance(axes, Rejection):
            return axes
        if adjacent is None:
            return Rejection(Reason.GAP, "no pointing was published on both sides of the exposure")
        point_m = sample.point_m
        if nodes is not None:
            rotations_nm = self._tracks.main_axis_over(sample.time_ns, nodes, self._axes)
            if rotations_nm is None:
                text = f"no encoder readings or attitudes of the ship over the exposure of {sample.exposure_s:g} s"
                return Rejection(Reason.GAP, text)
            path_m = self._directions.image_path_m(sample, rotations_nm, rotations_nm[nodes.offset_ns.index(0)])
            point_m = point_m - (nodes.mean(path_m) - point_m)
            # The point is a mean over the exposure, so encoders and ship have the noise of their means.
            axes = self._tracks.axes_at(sample.time_ns, nodes)
            assert not isinstance(axes, Rejection)  # as at the nodes
        ship, encoder = axes
        angles = np.array([encoder.azimuth, encoder.elevation])
        reading = EncoderSample(sample.time_ns, angles, float(np.sqrt(encoder.noise)))
        unconfirmed_reasons = [pending.unconfirmed_reason for pending in adjacent if pending.unconfirmed_reason]
        unconfirmed_sigma_rad = max(due.unconfirmed_sigma_rad for due in adjacent)
        due = PendingPointing(
            reading, ship, unconfirmed_reasons[-1] if unconfirmed_reasons else "", unconfirmed_sigma_rad, state
        )
        pointing = self._pointing.estimate(due)
        status, text = max(
            [(each.status, each.text) for each in (pointing, *map(self._pointing.estimate, adjacent))],
            key=lambda worth: worth[0],
        )
        conflict_text = self.pending.conflict_text(sample.time_ns)
        if conflict_text and status is not Status.DEGRADED:
            status, text = Status.DEGRADED, conflict_text
        return self._directions.estimate(sample, point_m, due, pointing, status, text)

    def _adjacent_pointings(self, time_ns: int) -> tuple[PendingPointing, PendingPointing] | None:
        """Return the last published pointing up to a time and the first from then on; None if there is a gap."""
        before = [due for due in self._published if due.sample.time_ns <= time_ns]
        after = [due for due in self._published if due.sample.time_ns >= time_ns]
        if not (before and after):
            return None
        gap_ns = after[0].sample.time_ns - before[-1].sample.time_ns
        return (before[-1], after[0]) if gap_ns <= self._tracks.encoder.max_gap_ns else None


def _rejection(sample: TargetSample, rejection: Rejection) -> MeasurementDecision[TargetSample]:
    return MeasurementDecision(sample, rejection.reason, text=rejection.text)

"""Direction of a target at the middle of its exposure, from the main axis at that time.

An image waits until the pointings before and after it have been published. Images of targets do not affect the
pointings, which are equal to the last bit with and without the images.

The status of a direction is the worst status of three pointings: the published pointings before and after the middle,
and the pointing at the middle. Images with conflicting stamps also make the direction DEGRADED.
"""

from collections import deque
from collections.abc import Callable

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection, StampConflicts, failure_rejection, resolve_same_stamp
from ship_estimation.time_order.outcome import MeasurementDecision, Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.mount.axes import AXES, SHIP, AxisErrors, axis_geometry
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput
from theodolite_calib.optical_axis.target_direction import (
    MainDetector,
    ObservedDirection,
    observed_direction,
    ranged_position,
    rotation_main_from_detector,
)
from theodolite_calib.samples.samples import (
    EncoderSample,
    PointingEstimate,
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
    """

    def __init__(self, stamp_conflicts: StampConflicts) -> None:
        self._waiting: dict[_Key, tuple[TargetSample, int]] = {}
        self._answered: dict[_Key, TargetSample] = {}
        self._order: deque[_Key] = deque()
        self._stamp_conflicts = stamp_conflicts

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, sample: TargetSample, waiting_ns: int) -> Rejection | None:
        """Add an image; return the rejection of this or the replaced image, None if the stamp is new for the target."""
        key = sample.time_ns, sample.target_id
        waits = self._waiting.get(key)
        known = waits[0] if waits is not None else self._answered.get(key)
        if known is not None:
            takes_its_place, rejection = resolve_same_stamp(known, sample)
            self._stamp_conflicts.record(sample.source, sample.time_ns, rejection)
            if takes_its_place and waits is not None:
                self._waiting[key] = sample, waits[1]
            return rejection
        self._waiting[key] = sample, waiting_ns
        return None

    def remove_overflow(self) -> list[TargetSample]:
        """Remove and return the oldest images if too many are pending."""
        keys = sorted(self._waiting)[: max(len(self._waiting) - MAX_WAITING, 0)]
        return [self._waiting.pop(key)[0] for key in keys]

    def pending_images(self) -> list[tuple[TargetSample, int]]:
        """Return the pending images in the order of their stamps, each with its time of reception."""
        return [self._waiting[key] for key in sorted(self._waiting)]

    def mark_answered(self, sample: TargetSample) -> None:
        """Mark an image as answered."""
        key = sample.time_ns, sample.target_id
        del self._waiting[key]
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
    """

    def __init__(
        self,
        config: OpticalAxisConfig,
        filter_: CalibrationFilter,
        pointing: PointingOutput,
        tracks: MeasuredTracks,
        stamp_conflicts: StampConflicts,
    ) -> None:
        self._pending = PendingTargets(stamp_conflicts)
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
        self._pending, self._published = before._pending, before._published

    def add(self, sample: TargetSample, waiting_ns: int, outcome: PointingOutcome) -> None:
        """Add an image that is not late; if too many images wait, the oldest is rejected."""
        outcome.rejection = self._pending.add(sample, waiting_ns)
        for overflowing in self._pending.remove_overflow():
            text = "too many images of targets wait for the pointing: the oldest is rejected"
            outcome.decisions.append(_rejection(overflowing, Rejection(Reason.OVERFLOW, text)))

    def record_output(self, pointing: PendingPointing, oldest_ns: int) -> None:
        """Record a published pointing; later images are not older than ``oldest_ns``."""
        self._published.append(pointing)
        # The last pointing up to ``oldest_ns`` stays, because the oldest possible image needs this pointing.
        while len(self._published) > 1 and self._published[1].time_ns <= oldest_ns:
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
        if not len(self._pending):
            return
        max_wait_ns = max(SECOND_NS, round(self._config.lag_s * SECOND_NS))
        for sample, received_ns in self._pending.pending_images():
            is_overdue = waiting_ns is not None and waiting_ns - received_ns > max_wait_ns
            if is_overdue or sample.time_ns < oldest_ns or self._is_covered(sample):
                self._pending.mark_answered(sample)
                self._publish_direction(sample, outcome, state())

    def _is_covered(self, sample: TargetSample) -> bool:
        """True if later data cannot change the direction, and a pointing after the image has been published."""
        if not (self._published and self._published[-1].time_ns >= sample.time_ns):
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
            found = invalid_direction(sample, found.text)
        outcome.targets.append(found)

    def _direction(self, sample: TargetSample, state: CalibrationState) -> TargetEstimate | Rejection:
        """Return the direction of a target, or the rejection if there is no pointing at the image."""
        adjacent = self._adjacent_pointings(sample.time_ns)
        tracks, nodes = self._tracks, sample.nodes
        ship, encoder = tracks.ship_at(sample.time_ns), tracks.encoder_at(sample.time_ns)
        if encoder is None:
            return Rejection(Reason.GAP, "no encoder readings on both sides of the exposure")
        if ship is None:
            return Rejection(Reason.GAP, "no attitudes of the ship on both sides of the exposure")
        if adjacent is None:
            return Rejection(Reason.GAP, "no pointing was published on both sides of the exposure")
        point_m = sample.point_m
        if nodes is not None:
            times_ns = [time_ns for time_ns, _ in nodes.times_and_weights(sample.time_ns)]
            rotations_nm = self._tracks.main_axis_at(times_ns, self._axes)
            if rotations_nm is None:
                text = f"no encoder readings or attitudes of the ship over the exposure of {sample.exposure_s:g} s"
                return Rejection(Reason.GAP, text)
            path_m = self._directions.image_path_m(sample, rotations_nm, rotations_nm[nodes.offset_ns.index(0)])
            point_m = point_m - (nodes.mean(path_m) - point_m)
            # The point is a mean over the exposure, so encoders and ship have the noise of their means.
            ship, encoder = tracks.ship_at(sample.time_ns, nodes), tracks.encoder_at(sample.time_ns, nodes)
            assert ship is not None  # as at the nodes
            assert encoder is not None
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
        conflict_text = self._pending.conflict_text(sample.time_ns)
        if conflict_text and status is not Status.DEGRADED:
            status, text = Status.DEGRADED, conflict_text
        return self._directions.estimate(sample, point_m, due, pointing, status, text)

    def _adjacent_pointings(self, time_ns: int) -> tuple[PendingPointing, PendingPointing] | None:
        """Return the last published pointing up to a time and the first from then on; None if there is a gap."""
        before = [due for due in self._published if due.time_ns <= time_ns]
        after = [due for due in self._published if due.time_ns >= time_ns]
        if not (before and after):
            return None
        gap_ns = after[0].time_ns - before[-1].time_ns
        return (before[-1], after[0]) if gap_ns <= self._tracks.encoder.max_gap_ns else None


class TargetOutput:
    """Computes directions of targets from the pointing at the middle of their exposure.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._config, self._filter = config, filter_
        detector = config.main_detector
        self._detector = MainDetector(
            detector.focal_length_m,
            detector.principal_point_m,
            detector.focal_length_sigma_m,
            detector.principal_sigma_m,
            detector.rotation_sigma_arcsec * ARCSEC,
        )

    def image_path_m(self, sample: TargetSample, rotations_nm: FloatArray, middle_nm: FloatArray) -> FloatArray:
        """Return the path over the detector, m, of a target whose direction in n is constant, shape (m, 2).

        If the target's direction rotates at a constant rate instead, the mean of the path changes only by terms of
        second order, the products of this rotation and the mount's rotation.

        Args:
            sample: image of the target.
            rotations_nm: horizon from main frame at m times, shape (m, 3, 3).
            middle_nm: horizon from main frame at the middle, when the target is at its image point, shape (3, 3).
        """
        camera = self._detector.camera
        rotation_mv = rotation_main_from_detector(sample.detector_rotation)
        seen_n = middle_nm @ rotation_mv @ camera.directions(sample.point_m[None])[0]
        return camera.points(seen_n @ (rotations_nm @ rotation_mv))

    def estimate(
        self,
        sample: TargetSample,
        point_m: FloatArray,
        pending: PendingPointing,
        pointing: PointingEstimate,
        status: Status,
        text: str,
    ) -> TargetEstimate:
        """Return the direction of a target.

        Args:
            sample: image of the target.
            point_m: detector point at the middle of the exposure, shape (2,).
            pending: inputs of the pointing at that time.
            pointing: pointing at that time.
            status: status of the direction.
            text: reason if the status is not VALID.
        """
        seen = observed_direction(
            self._detector, point_m, sample.sigma_m, sample.detector_rotation, pointing.rotation_nm
        )
        unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
        position_n, position_covariance_n = (
            self._position(sample, pending, pointing, seen) if sample.has_range else unknown
        )
        return TargetEstimate(
            time_ns=sample.time_ns,
            target_id=sample.target_id,
            direction_n=seen.direction_n,
            covariance_n=seen.covariance_n(pointing.covariance_n),
            position_n=position_n,
            position_covariance_n=position_covariance_n,
            status=status,
            text=text,
        )

    def _position(
        self, sample: TargetSample, pending: PendingPointing, pointing: PointingEstimate, seen: ObservedDirection
    ) -> tuple[FloatArray, FloatArray]:
        """Return the position of a target relative to the ship's antenna, m, and its covariance, m².

        Errors of ship, lever and air are states of the filter, so their joint covariance is used.
        """
        model, ship = self._filter.model, pending.ship
        state = self._filter.propagate(pointing.state, sample.time_ns, ship.correlated_covariance_n)
        errors = self._filter.sightings.geometry_errors(state.mean)
        geometry = axis_geometry(errors, ship.rotation_nd, ship.rate_d, *pending.sample.vector.tolist())
        lever_m, coefficient = self._config.lever.vector_m, self._config.air.coefficient
        if "lever" in model.slices:
            lever_m = lever_m + state.mean[model.slices["lever"]]
        if "refraction" in model.slices:
            coefficient += float(state.mean[model.slices["refraction"]][0])
        lever_n = geometry.rotation_nd @ lever_m
        place = ranged_position(seen.direction_n, sample.range_m, coefficient)

        by_turn_n, lever_by_turn_n = place.by_direction_n @ seen.by_turn_n, -skew(lever_n)
        axis_indices = axis_state_indices(model)
        by_state_n = np.zeros((3, model.size))
        by_state_n[:, axis_indices] = by_turn_n @ pointing.by_error_n
        # The ship's error and time offset rotate the lever; deformation and axis errors do not.
        ship_columns = np.r_[SHIP, AXES.stop : len(axis_indices)]
        by_state_n[:, axis_indices[ship_columns]] += lever_by_turn_n @ pointing.by_error_n[:, ship_columns]
        if "lever" in model.slices:
            by_state_n[:, model.slices["lever"]] = geometry.rotation_nd
        if "refraction" in model.slices:
            by_state_n[:, model.slices["refraction"]] = place.by_coefficient_n[:, None]

        # Covariance of the pointing minus the states' part: noise of encoders and ship, unconfirmed steps, separations.
        of_states_n = pointing.by_error_n @ state.covariance[np.ix_(axis_indices, axis_indices)] @ pointing.by_error_n.T
        other_n = pointing.covariance_n - of_states_n
        by_ship_noise_n = by_turn_n + lever_by_turn_n
        covariance_n = (
            by_state_n @ state.covariance @ by_state_n.T
            + by_turn_n @ other_n @ by_turn_n.T
            + ship.noise * (by_ship_noise_n @ by_ship_noise_n.T - by_turn_n @ by_turn_n.T)
            + place.by_direction_n @ seen.image_covariance_n @ place.by_direction_n.T
            + sample.range_sigma_m**2 * np.outer(place.by_range_n, place.by_range_n)
            + self._config.air.light_sigma**2 * np.outer(place.by_coefficient_n, place.by_coefficient_n)
        )
        return lever_n + place.path_n, 0.5 * (covariance_n + covariance_n.T)


def invalid_direction(sample: TargetSample, text: str) -> TargetEstimate:
    """Return an INVALID direction."""
    unknown, unknown_covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
    return TargetEstimate(
        time_ns=sample.time_ns,
        target_id=sample.target_id,
        direction_n=unknown,
        covariance_n=unknown_covariance,
        position_n=unknown,
        position_covariance_n=unknown_covariance,
        status=Status.INVALID,
        text=text,
    )


def _rejection(sample: TargetSample, rejection: Rejection) -> MeasurementDecision[TargetSample]:
    return MeasurementDecision(sample, rejection.reason, text=rejection.text)

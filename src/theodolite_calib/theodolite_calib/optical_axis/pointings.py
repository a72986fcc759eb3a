"""Pointings to publish: at encoder readings, which wait for the ship's attitude, or from stars after a timeout.

A pointing from the stars of one exposure alone is published if the ship's attitude or the encoders are missing. At
least three stars must be identified and consistent with one another, because the camera's attitude is not predicted.
The main axis follows from the estimated parallelism: R_main = R_camera · R(azimuth, elevation, roll).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ship_estimation.rejection_rules import Rejection, StampConflicts
from ship_estimation.time_order.outcome import Status
from ship_estimation.time_order.time_ordered_estimator import OutputSequence
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles, rotation_vector_from_angle_errors
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.residuals import SOURCE_STAR_NOISE
from ship_stars.attitude_from_stars.solution import SOLUTION_TERMS, SolutionStatus, solve_stars
from ship_stars.sky.sky_model import SkyModel
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_PARALLELISM, axis_state_indices, parallelism_block
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput, PointingSeries, invalid_pointing
from theodolite_calib.optical_axis.streams import AxisEstimator, MeasuredStreams
from theodolite_calib.optical_axis.targets import TargetProcessor
from theodolite_calib.samples.samples import (
    EncoderSample,
    Mode,
    PointingEstimate,
    PointingOutcome,
    ShipSample,
    TargetSample,
)

_STAR_NOISE_TERMS = ("installation", "catalogue")
"""Error terms of a solution that count as star noise, because the filter has no source for them. A single camera has
no installation besides its parallelism, and the filter has catalogue errors in the star noise."""


def pointing_by_stars(
    exposure: StarExposure,
    sky: SkyModel,
    config: OpticalAxisConfig,
    filter_: CalibrationFilter,
    state: CalibrationState,
    text: str,
) -> PointingEstimate | None:
    """Return the pointing at the middle of an exposure; None if the stars do not give a verified attitude.

    Args:
        exposure: exposure as the camera recorded it.
        sky: sky model.
        config: parameters of the node.
        filter_: filter of that configuration.
        state: state with the camera's parallelism.
        text: reason for a pointing from stars alone.
    """
    visible = visible_stars(exposure, sky, None)
    if isinstance(visible, Rejection):
        return None
    solution = solve_stars(visible[1])
    if solution.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return None
    if exposure.length is not None:
        # Noise is added, because the rotation of the camera during the exposure is not measured.
        unmeasured_acceleration = np.deg2rad(config.ins.untold_acceleration_deg_per_s2)
        solution = solution.with_added_noise(exposure.length.unmeasured_turn_variance(float(unmeasured_acceleration)))
    model, camera_id = filter_.model, exposure.source.partition(".")[2]
    block = model.slices[parallelism_block(camera_id, config)]
    azimuth, elevation, roll = config.telescopes[camera_id].parallelism + state.mean[block]
    by_angles_n = solution.rotation_nb @ rotation_vector_from_angle_errors(azimuth, elevation)
    covariance_by_source_n = np.zeros((len(model.sources), 3, 3))
    for term, part_n in zip(SOLUTION_TERMS, solution.covariance_by_source_n, strict=False):
        # The model has no source for a term that is zero.
        if not part_n.any():
            continue
        covariance_by_source_n[model.source_indices[SOURCE_STAR_NOISE if term in _STAR_NOISE_TERMS else term]] += part_n
    covariance_by_source_n[model.source_indices[SOURCE_PARALLELISM]] += (
        by_angles_n @ state.covariance[block, block] @ by_angles_n.T
    )
    covariance_n = covariance_by_source_n.sum(axis=0)
    return replace(
        invalid_pointing(filter_, state, exposure.time_ns, text),
        rotation_nm=solution.rotation_nb @ rotation_from_angles(azimuth, elevation, roll),
        covariance_by_source_n=covariance_by_source_n,
        covariance_n=covariance_n,
        covariance_without_separation_n=covariance_n,
        mode=Mode.STARS,
        status=Status.DEGRADED,
        by_error_n=np.zeros((3, len(axis_state_indices(model)))),
    )


class Pointings:
    """Published pointings, and the directions of targets.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        estimator: time-ordered estimator of the filter.
        streams: streams of encoders and ship's attitude.
        sky: sky model; None if no camera observes stars.
        on_pointing: called with each pointing that is computed immediately, and its inputs, None if from stars alone;
            None if the pointings are not stored.

    Attributes:
        filter: the filter.
        sequence: order and timeout of the pointings.
        output: computes the pointings.
        target_conflicts: stamp conflicts of the source of target images.
        pending: in a batch, the pointings that :meth:`compute_pending` computes together; None if each pointing is
            computed immediately.
    """

    def __init__(
        self,
        config: OpticalAxisConfig,
        filter_: CalibrationFilter,
        estimator: AxisEstimator,
        streams: MeasuredStreams,
        sky: SkyModel | None,
        on_pointing: Callable[[PointingEstimate, PendingPointing | None], None] | None,
    ) -> None:
        self._estimator, self._streams, self._sky = estimator, streams, sky
        self._on_pointing = on_pointing
        self.pending: list[PendingPointing] | None = None
        self._config, self.filter = config, filter_
        self.sequence, self.target_conflicts = OutputSequence(), StampConflicts()
        self.output = PointingOutput(config, filter_)
        self.reset()

    def reset(self) -> None:
        """Discard waiting images and stars, after a reset of the streams."""
        self.target_conflicts.reset()
        self._targets = TargetProcessor(
            self._config, self.filter, self.output, self._streams.tracks, self.target_conflicts
        )
        self._newest_stars: tuple[StarExposure, int] | None = None

    def reconfigure(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        """Continue with another configuration and filter."""
        self._config, self.filter, self.output = config, filter_, PointingOutput(config, filter_)
        self._targets.reconfigure(config, filter_, self.output)

    def take_over(self, before: "Pointings") -> None:
        """Continue the outputs of an estimator that ends and has no pending output."""
        self.sequence.continue_from(before.sequence)
        self.target_conflicts = before.target_conflicts
        self._targets.take_over(before._targets)
        self.pending = None if before.pending is None else []

    def compute_pending(self) -> list[tuple[slice, PointingSeries | Rejection]]:
        """Compute and return the pending pointings; see ``PointingOutput.compute_pending``."""
        pending, self.pending = self.pending or [], []
        return self.output.compute_pending(pending)

    def add_encoder(self, sample: EncoderSample, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an encoder reading; publish the pointings of waiting readings that the ship's attitudes cover.

        Args:
            sample: the reading.
            arrival_ns: arrival time by the timeout clock; None if each reading arrives at its stamp.
        """
        arrival_ns, outcome = sample.time_ns if arrival_ns is None else arrival_ns, PointingOutcome()
        if self._streams.add_encoder(sample, arrival_ns, outcome):
            self._publish(outcome, arrival_ns)
        return outcome

    def add_ship(self, sample: ShipSample, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an attitude of the ship; for the arrival see :meth:`add_encoder`."""
        arrival_ns, outcome = sample.time_ns if arrival_ns is None else arrival_ns, PointingOutcome()
        self._streams.add_ship(sample, arrival_ns, outcome)
        self._publish(outcome, arrival_ns)
        return outcome

    def add_target(self, sample: TargetSample, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an image of a target; :meth:`TargetProcessor.publish_ready` gives the conditions for its direction.

        Images of targets do not affect the pointings.
        """
        outcome = PointingOutcome(self._estimator.window.late_rejection(sample.time_ns))
        if outcome.rejection is None:
            waiting_ns = sample.time_ns if arrival_ns is None else arrival_ns
            self._targets.add(sample, waiting_ns, outcome)
            self._publish_targets(outcome)
        return outcome

    def add_stars(self, exposure: StarExposure, arrival_ns: int, outcome: PointingOutcome) -> None:
        """Store an accepted exposure of stars; publish its pointing if ship or encoders have timed out."""
        self._newest_stars = exposure, arrival_ns
        self._publish_from_stars(outcome, arrival_ns)

    def tick(self, outcome: PointingOutcome, now_ns: int, waiting_ns: int) -> None:
        """Publish from recent stars after a timeout, INVALID after a timeout of all outputs, and overdue targets."""
        self._publish_from_stars(outcome, waiting_ns)
        is_timed_out = "the encoders" in self._streams.timed_out(waiting_ns)
        missing = "no usable reading of the encoders" if is_timed_out else f"no attitude on {self._config.ship.source}"
        self.sequence.report_invalid(
            outcome, waiting_ns, lambda: invalid_pointing(self.filter, self._estimator.state, now_ns, missing)
        )
        self._publish_targets(outcome, waiting_ns)

    def _publish(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        """Publish or queue the pointings of the readings with an attitude, and then publish directions of targets.

        A reading before a published pointing, which can only be from stars, is skipped.
        """
        ready = self._streams.take_ready_readings()
        published = [reading for reading in ready if self.sequence.can_publish(reading.sample.time_ns)]
        if published and self.pending is not None:
            self.pending += published
        elif published:
            published = self._add_estimates(outcome, published)
        if published:
            self.sequence.record(published[-1].sample.time_ns, waiting_ns)
            self._targets.record_outputs(published, self._estimator.window.oldest_ns)
        self._publish_targets(outcome)

    def _add_estimates(self, outcome: PointingOutcome, readings: list[PendingPointing]) -> list[PendingPointing]:
        """Add the pointings of readings to the outcome; return the readings without those whose computation failed."""
        computed = []
        for part, series in self.output.compute_pending(readings):
            if isinstance(series, Rejection):
                outcome.failures += [(reading.sample.time_ns, series) for reading in readings[part]]
                continue
            for number, reading in enumerate(readings[part]):
                outcome.estimates.append(series.estimate(number))
                computed.append(reading)
                if self._on_pointing is not None:
                    self._on_pointing(outcome.estimates[-1], reading)
        return computed

    def _publish_targets(self, outcome: PointingOutcome, waiting_ns: int | None = None) -> None:
        if self._targets.pending.waiting:
            self._targets.publish_ready(
                outcome, waiting_ns, self._estimator.window.oldest_ns, lambda: self._estimator.state_now
            )

    def _publish_from_stars(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        """Publish the pointing from the newest stars if ship or encoders have timed out and the stars are recent."""
        timed_out = self._streams.timed_out(waiting_ns)
        if self._newest_stars is None or not timed_out:
            return
        (exposure, arrival_ns), self._newest_stars = self._newest_stars, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return
        text = f"by stars alone: no data from {' and '.join(timed_out)}"

        def by_stars() -> PointingEstimate | None:
            assert self._sky is not None
            return pointing_by_stars(exposure, self._sky, self._config, self.filter, self._estimator.state_now, text)

        count = len(outcome.estimates)
        self.sequence.add(outcome, exposure.time_ns, waiting_ns, by_stars)
        if self._on_pointing is not None and len(outcome.estimates) > count:
            self._on_pointing(outcome.estimates[-1], None)

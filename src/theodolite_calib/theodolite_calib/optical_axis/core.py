"""Core of ``optical_axis``, shared by node and replay: estimates the main axis from all measurements.

The core, without ROS, files or clock, combines the calibration filter and the tracks of measured samples with the
time-ordered estimator (:mod:`ship_estimation.time_order.time_ordered_estimator`), which applies exposures and publishes
pointings in the order of their stamps. This module adds the checks of encoders and ship's attitude, and the queue of
readings that wait for the ship's attitude. A pointing is published at the stamp of each encoder reading, as soon as the
ship's attitude of that time is available.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import RecoverableCore
from ship_estimation.rejections import Reason, Rejection, StampConflicts
from ship_estimation.time_order.output_sequence import OutputSequence
from ship_estimation.time_order.time_ordered_estimator import EstimatorModel, TimeOrderedEstimator
from ship_estimation.time_order.time_shift import with_shifted_stamps
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_geometry.tracks.sample_track import SampleTrack
from ship_stars.samples.readings import SkyInput
from ship_stars.sky.sky_model import SkyModel
from ship_stars.solution.exposure import StarExposure
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Jump
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.filter.subfilters import BEACON_PREFIX, ENCODER, SHIP, TELESCOPE
from theodolite_calib.optical_axis.by_stars import pointing_by_stars
from theodolite_calib.optical_axis.calibration import (
    Calibration,
    CalibrationPrior,
    calibration_from_state,
    prior_from_state,
    state_from_prior,
)
from theodolite_calib.optical_axis.memory import (
    StreamJump,
    is_consistent,
    largest_difference_sigmas,
    memory_residuals,
    propagate_memory,
    start_from_memory,
    stuck_encoder_jump,
)
from theodolite_calib.optical_axis.output import PendingPointing, PointingOutput, invalid_pointing
from theodolite_calib.optical_axis.targets import TargetProcessor
from theodolite_calib.samples.encoder_check import CheckedReading, EncoderCheck
from theodolite_calib.samples.samples import (
    AnyExposure,
    BaselineSample,
    EncoderSample,
    Exposure,
    ExposureDecision,
    PointingEstimate,
    PointingOutcome,
    PointingSeries,
    ShipSample,
    TargetSample,
)
from theodolite_calib.samples.ship_check import ShipCheck
from theodolite_calib.samples.sighting import Sighting, SightingAssembler
from theodolite_calib.samples.star_sighting import star_sighting
from theodolite_calib.samples.stream_consistency import StreamConsistency
from theodolite_calib.samples.tracks import MeasuredTracks

if TYPE_CHECKING:
    from theodolite_calib.escort.advice import EscortAdvice
    from theodolite_calib.optical_axis.escort_advisor import EscortAdvisor

_STREAM_FAULT_REASONS = frozenset({Reason.STUCK, Reason.CONFLICT, Reason.GATE})
"""Reasons of rejections that show a fault of the encoder or ship stream: stuck, repeated stamp, or jump."""
_REPEATED_TIME_TEXT = "encoders and ship both sent different data with equal stamps: a clock has repeated this time"


class _WaitingReading(NamedTuple):
    """Encoder reading that waits for the ship's attitude; ``unconfirmed_reason`` is empty for a confirmed reading."""

    sample: EncoderSample
    unconfirmed_reason: str
    unconfirmed_sigma_rad: float


class OpticalAxisCore(RecoverableCore[CalibrationState, StreamJump]):
    """Estimator of the main optical axis.

    Args:
        config: parameters of the node.
        sky: sky model; None if no camera observes stars.
        on_commit: callback for states that can no longer change, in order; None if unused.

    Attributes:
        pending: offline, the pointings that :meth:`compute_pending` computes together; None if each pointing is
            computed immediately.
    """

    filter_class: ClassVar[type[CalibrationFilter]] = CalibrationFilter
    config: OpticalAxisConfig
    _sky_model: SkyModel | None

    def __init__(
        self,
        config: OpticalAxisConfig,
        sky: SkyModel | None = None,
        on_commit: Callable[[Sequence[CalibrationState]], None] | None = None,
    ) -> None:
        self.pending: list[PendingPointing] | None = None
        self._sky_model = sky
        self._target_stamp_conflicts = StampConflicts()
        self._start: tuple[CalibrationPrior, int] | None = None
        self._calibration: tuple[CalibrationState, Calibration] | None = None
        self._build_models(config)
        model: EstimatorModel[CalibrationState, AnyExposure, ExposureDecision, Jump] = EstimatorModel(
            step=self._step,
            inflate=self._inflate_covariance,
            failure_decision=lambda exposure, why: ExposureDecision(exposure, why.reason, text=why.text),
            until_ns=lambda decision: decision.measurement.time_ns + decision.measurement.reach_ns,
            drop_before=self._drop_before,
            on_decision=self._update_checks,
            on_commit=on_commit,
        )
        self._estimator: TimeOrderedEstimator[CalibrationState, AnyExposure, ExposureDecision, Jump, PointingEstimate]
        reach_ns = MeasuredTracks(config).reach_ns
        self._estimator = TimeOrderedEstimator(model, self.filter.initial_state(), config.lag_s, reach_ns)
        self._outputs = OutputSequence()
        self.reset()

    def start_from(self, prior: CalibrationPrior, now_ns: int) -> list[str]:
        """Reset to a saved calibration; return remarks for the operator."""
        self._start = (prior, now_ns)
        return self.reset()

    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Discard all measurements; outputs may restart at earlier times if the clock has jumped.

        Returns:
            Remarks about the saved calibration, if the filter starts from a saved calibration.
        """
        initial = self.filter.initial_state()
        remarks: list[str] = []
        if self._start is not None:
            initial, remarks = state_from_prior(self.filter, self.config, *self._start)
        self._estimator.reset(initial)
        if clock_jumped:
            self._outputs.reset()
        if self._sky_model is not None:
            self._sky_model.reset()
        self._start_without_samples()
        return remarks

    def step_time_base(self, step_ns: int, state: CalibrationState) -> None:
        """Continue after a step of all clocks, during which no time has passed for the calibration.

        Args:
            step_ns: step, ns.
            state: state before the step.
        """
        self._estimator.reset(with_shifted_stamps(state, step_ns))
        self._outputs.step_time_base(step_ns)
        if self._sky_model is not None:
            self._sky_model.step_time_base(step_ns)
        self._start_without_samples()

    def _start_without_samples(self) -> None:
        """Discard all samples, waiting readings and images, and the states of the stream checks."""
        self._tracks = MeasuredTracks(self.config)
        self._sightings = SightingAssembler(self.config, self._tracks)
        self._encoder_check = EncoderCheck(*_encoder_limits(self.config))
        self._ship_check = ShipCheck(self.config, self._tracks.ship_shift_ns)
        self._target_stamp_conflicts.reset()
        self._targets = TargetProcessor(
            self.config, self.filter, self._pointing, self._tracks, self._target_stamp_conflicts
        )
        self._escort = self._make_escort_advisor()
        self._waiting_readings: deque[_WaitingReading] = deque()
        self._encoder_arrival_ns: int | None = None
        self._ship_arrival_ns: int | None = None
        self._newest_stars: tuple[StarExposure, int] | None = None
        self._repeated_time_ns: tuple[int, int] | None = None
        self._stream_fault_ns: dict[str, int] = {}
        self._clear_jumps()
        self._is_stuck = False
        self._ship_final_until_ns: int | None = None

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply changed noise and gates; geometry and the set of beacons must not change."""
        self._build_models(config)
        self._tracks.reconfigure(config)
        self._sightings = SightingAssembler(config, self._tracks)
        self._encoder_check.reconfigure(*_encoder_limits(config))
        self._ship_check.reconfigure(config)
        self._targets.reconfigure(config, self.filter, self._pointing)
        if self._escort is not None:
            self._escort.reconfigure(config, self.filter)

    def add_encoder(self, sample: EncoderSample, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an encoder reading; publish the pointings of waiting readings that the ship's attitudes cover.

        Args:
            sample: the reading.
            arrival_ns: arrival time by the timeout clock; None if each reading arrives at its stamp.
        """
        arrival_ns = sample.time_ns if arrival_ns is None else arrival_ns
        track, estimator = self._tracks.encoder, self._estimator
        result = self._encoder_check.check(sample, track, estimator.window.late_rejection(sample.time_ns))
        outcome = PointingOutcome(result.rejection)
        self._record_stream_fault(ENCODER, sample.time_ns, result.rejection, result.jump is not None)
        self._record_stream_jump(sample.time_ns, result)
        if result.jump is not None and (track.newest is None or sample.time_ns > track.newest.time_ns):
            estimator.add_jump(result.jump.time_ns, ENCODER, result.jump, track.add_cut(result.jump.time_ns))
        if result.rejection is not None:
            estimator.add_rejected(ENCODER, track, sample)
            self._check_repeated_time()
            return outcome
        estimator.add_sample(ENCODER, track, sample, outcome)
        if outcome.rejection is not None:
            self._record_stream_fault(ENCODER, sample.time_ns, outcome.rejection)
            self._check_repeated_time()
        elif track.newest is sample:
            self._encoder_arrival_ns = arrival_ns
            self._waiting_readings.append(
                _WaitingReading(
                    sample, self._encoder_check.unconfirmed_reason, self._encoder_check.unconfirmed_sigma_rad
                )
            )
            self._publish(outcome, arrival_ns)
        return outcome

    def add_ship(self, sample: ShipSample, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an attitude of the ship; for the arrival see :meth:`add_encoder`."""
        outcome = PointingOutcome(self._estimator.window.late_rejection(sample.time_ns))
        if outcome.rejection is None:
            outcome.rejection, sample = self._check_ship(sample, outcome)
        source, track = self.config.ship.source, self._tracks.ship
        if outcome.rejection is not None:
            self._estimator.add_rejected(source, track, sample)
        elif self._estimator.add_sample(source, track, sample, outcome):
            self._ship_final_until_ns = self._tracks.ship_final_until_ns
            self._ship_arrival_ns = sample.time_ns if arrival_ns is None else arrival_ns
        if outcome.rejection is not None:
            self._record_stream_fault(SHIP, sample.time_ns, outcome.rejection)
            self._check_repeated_time()
        self._publish(outcome, sample.time_ns if arrival_ns is None else arrival_ns)
        return outcome

    def add_baseline(self, beacon_id: str, sample: BaselineSample) -> PointingOutcome:
        """Add a baseline to a drone.

        An unusable baseline is rejected but stored, so that exposures do not wait for a usable one.
        """
        outcome = self._add(f"baseline.{beacon_id}", self._tracks.baselines[beacon_id], sample)
        if outcome.rejection is None:
            outcome.rejection = sample.rejection
        return outcome

    def add_drone_attitude(self, beacon_id: str, sample: AttitudeSample) -> PointingOutcome:
        """Add an attitude of a drone; a drone with its light at the antenna needs no attitudes."""
        track = self._tracks.drones.get(beacon_id)
        return PointingOutcome() if track is None else self._add(f"drone.{beacon_id}", track, sample)

    def add_surroundings(self, given: SkyInput) -> PointingOutcome:
        """Add a position fix of the ship or an air reading.

        Exposures of stars whose sky values have changed are applied again.
        """
        assert self._sky_model is not None
        surroundings, outcome = self._sky_model.surroundings, PointingOutcome()
        outcome.rejection = surroundings.rejection(given)
        changed_after_ns = surroundings.insert(given)
        if changed_after_ns is not None:
            changed_ns: int = changed_after_ns
            self._estimator.rewind_to_first(
                lambda decision: isinstance(decision.measurement, StarExposure)
                and decision.measurement.time_ns > changed_ns
            )
        self._estimator.apply(outcome)
        return outcome

    def add_exposure(self, exposure: Exposure) -> PointingOutcome:
        """Add an exposure with one or more beacons."""
        outcome = PointingOutcome(self._estimator.window.late_rejection(exposure.time_ns))
        if outcome.rejection is None:
            self._estimator.add(exposure, outcome)
        return outcome

    def add_stars(self, exposure: StarExposure, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an exposure of stars; for the arrival see :meth:`add_encoder`."""
        outcome = PointingOutcome(self._estimator.window.late_rejection(exposure.time_ns))
        if outcome.rejection is None and self._estimator.add(exposure, outcome):
            arrival_ns = exposure.time_ns if arrival_ns is None else arrival_ns
            self._newest_stars = exposure, arrival_ns
            self._publish_from_stars(outcome, arrival_ns)
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

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        """Set the text of a conflict of two publishers on one source; an empty text ends the conflict."""
        stamp_conflicts = (
            self._target_stamp_conflicts if source == TargetSample.source else self._estimator.stamp_conflicts
        )
        stamp_conflicts.set_duplicate_publishers(source, self._estimator.window.newest_ns, text)

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> PointingOutcome:
        """Apply delayed exposures; publish from recent stars after a timeout of encoders or ship.

        Directions of overdue images are published. If no output was published for a second, an INVALID output follows
        once a second.

        Args:
            now_ns: current time.
            waiting_ns: current time by the timeout clock; None if it equals ``now_ns``.
        """
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        outcome = PointingOutcome()
        self._estimator.tick(now_ns, outcome)
        self._publish_from_stars(outcome, waiting_ns)
        is_timed_out = _is_timed_out(self._encoder_arrival_ns, waiting_ns)
        missing = "no usable reading of the encoders" if is_timed_out else f"no attitude on {self.config.ship.source}"
        self._outputs.report_invalid(
            outcome, waiting_ns, lambda: invalid_pointing(self.filter, self.state, now_ns, missing)
        )
        self._publish_targets(outcome, waiting_ns)
        return outcome

    def no_output(self, now_ns: int, text: str) -> PointingEstimate:
        """Return an INVALID pointing with a given reason."""
        return invalid_pointing(self.filter, self.state, now_ns, text)

    def compute_pending(self) -> list[tuple[slice, PointingSeries | Rejection]]:
        """Compute and return the pending pointings; see :meth:`PointingOutput.compute_pending`."""
        pending, self.pending = self.pending or [], []
        return self._pointing.compute_pending(pending)

    def calibration(self) -> Calibration:
        """Return the calibration from the present state; cached per state, because several topics need it."""
        if self._calibration is None or self._calibration[0] is not self.state:
            self._calibration = self.state, calibration_from_state(self.filter, self.config, self.state)
        return self._calibration[1]

    def calibration_to_save(self) -> CalibrationPrior | None:
        """Return the prior for the next session.

        Before the first sighting, the result is the prior loaded at the start, or None.
        """
        if self.state.last_update_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_from_state(self.filter, self.config, self.state)

    def integrity(self, estimate: PointingEstimate) -> IntegrityReport:
        """Return protection levels and test statistics of a pointing."""
        return self._pointing.integrity(estimate)

    def escort(self, estimate: PointingEstimate) -> "EscortAdvice | None":
        """Return the advised positions of the drones for the latest pointing; None if there is no new advice."""
        return None if self._escort is None else self._escort.advice(estimate)

    def sighting(self, exposure: Exposure) -> Sighting | None:
        """Return the sighting of an exposure with the samples at its middle.

        The result is None if samples are missing, or if the baselines of all its beacons are rejected. The exposure
        must be at most ``lag_s`` old.
        """
        return self._sightings.assemble(exposure).sighting

    # -- recovery: see ship_estimation.recovery.recoverable_core --------------------------------------------------

    @property
    def excluded_sources(self) -> Set[str]:
        """Names of the excluded sources."""
        return self.state.fault_state.excluded.keys()

    @property
    def is_consistent(self) -> bool:
        """True after sightings of beacons or stars if no source is excluded, contradictory or unconfirmed."""
        now_ns = self._estimator.window.newest_ns
        unconfirmed_reason = (
            self._encoder_check.unconfirmed_reason
            or self._ship_check.unconfirmed_reason(now_ns)
            or self._contradiction_text(now_ns)
        )
        return is_consistent(self.state) and not unconfirmed_reason

    @property
    def has_unresolved_fault(self) -> bool:
        """True if beacons contradict encoders and ship in several sightings, and the faulty source is not isolated."""
        conflict = self.state.fault_state.unresolved_fault
        return conflict is not None and conflict.is_persistent

    def _start_from_memory(self, memory: CalibrationState, live: "OpticalAxisCore") -> None:
        """See :meth:`RecoverableCore._start_from_memory`."""
        self._estimator.reset(start_from_memory(self.filter, memory))
        self._start_without_samples()

    def propagate_memory(self, memory: CalibrationState, jumps: Sequence[StreamJump]) -> CalibrationState:
        """Return a stored state propagated to the oldest time of measurements that may still come."""
        return propagate_memory(self.filter, memory, jumps, self._estimator.window.oldest_ns)

    def memory_residuals(self, decision: ExposureDecision, memory: CalibrationState) -> Mapping[str, MemoryResidual]:
        """Return the residuals of the beacons of an exposure against a stored state; empty without a sighting."""
        sighting = self.sighting(decision.measurement) if isinstance(decision.measurement, Exposure) else None
        if sighting is None:
            return {}
        found = memory_residuals(self.filter, memory, sighting)
        return {BEACON_PREFIX + name: residual for name, residual in found.items()}

    def largest_difference_sigmas(
        self, state: CalibrationState, memory: CalibrationState, is_later: bool = False
    ) -> float:
        """Return the largest difference from a stored state, in joint standard deviations; inf in a gap of the data."""
        time_ns = state.time_ns
        ship = None if time_ns is None else self._tracks.ship_at(time_ns)
        encoder = None if time_ns is None else self._tracks.encoder_at(time_ns)
        if ship is None or encoder is None:
            return math.inf
        return largest_difference_sigmas(self.filter, state, memory, ship, encoder, is_later)

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those beacons among ``sources`` from which no recent measurement was accepted."""
        means, since_ns = (
            self.state.fault_state.innovation_means,
            self._estimator.window.newest_ns - MAX_MEASUREMENT_AGE_NS,
        )
        used = (means.last_measured_ns >= since_ns) & (means.rejection_counts[0] == 0)
        lights = self.filter.subfilters.sources
        return {name for name, is_used in zip(lights, used.tolist(), strict=True) if name in sources and not is_used}

    def take_over_outputs(self, live: "OpticalAxisCore") -> None:
        """Continue the outputs of the estimator ``live``, which ends and has no pending output."""
        super().take_over_outputs(live)
        self._target_stamp_conflicts = live._target_stamp_conflicts
        self._targets.take_over(live._targets)
        self.pending = None if live.pending is None else []

    # -- inputs ---------------------------------------------------------------------------------------------

    def _build_models(self, config: OpticalAxisConfig) -> None:
        self.config = config
        self.filter = self.filter_class(config)
        self._step_to = SightingStep(
            config, self.filter, self._stream_consistency, self._has_ship_drifted, self._stream_faults
        )
        sky = self._sky_model
        self._step_to_stars = None if sky is None else StarStep(config, self.filter, sky)
        self._pointing = PointingOutput(config, self.filter)
        self._calibration = None

    def _make_escort_advisor(self) -> "EscortAdvisor | None":
        """Return the advisor for the drones; None if advice is disabled."""
        if not self.config.escort.enabled:
            return None
        # Imported here, because loading scipy's optimisers takes longer than the rest of the node.
        from theodolite_calib.optical_axis.escort_advisor import EscortAdvisor

        return EscortAdvisor(self.config, self.filter, self._tracks)

    def _add(self, source: str, track: SampleTrack[Any], sample: Any) -> PointingOutcome:
        outcome = PointingOutcome(self._estimator.window.late_rejection(sample.time_ns))
        if outcome.rejection is None:
            self._estimator.add_sample(source, track, sample, outcome)
        return outcome

    def _check_ship(self, sample: ShipSample, outcome: PointingOutcome) -> tuple[Rejection | None, ShipSample]:
        """Check an attitude of the ship and apply detected jumps; return its rejection or None, and its usable part."""
        result = self._ship_check.check(sample, self._estimator.window.oldest_ns)
        if result.rates_wrong_after_ns is not None:
            # Exposures compared with wrong rates are compared again without rates.
            changed_after_ns = self._tracks.ship.drop_rates(result.rates_wrong_after_ns)
            if changed_after_ns is not None:
                self._estimator.rewind_after(changed_after_ns + self._tracks.ship_shift_ns)
                self._estimator.apply(outcome)
        if result.noise is not None:
            self._estimator.rewind_after(self._tracks.ship.add_noise(result.noise) + self._tracks.ship_shift_ns)
            self._estimator.apply(outcome)
        for jump in result.jumps:
            self._record_stream_fault(SHIP, jump.time_ns, None, jumped=True)
            changed_after_ns = self._tracks.ship.add_cut(jump.time_ns)
            time_ns = jump.time_ns + self._tracks.ship_shift_ns  # in the time scale of the exposures
            if changed_after_ns is not None:
                changed_after_ns += self._tracks.ship_shift_ns
            jump = replace(jump, time_ns=time_ns)
            self._jumps.append(StreamJump(jump))
            self._estimator.add_jump(time_ns, "ins", jump, changed_after_ns)
        assert isinstance(result.sample, ShipSample)
        # If the ship's attitude is that of the INS, no rates are used, so that no wrong rate can affect the pointing.
        by_ins = self.config.ship.source == "ins/imu"
        return result.rejection, replace(result.sample, rate_d=None) if by_ins else result.sample

    # -- model of the time-ordered estimator ----------------------------------------------------------------

    def _step(
        self, state: CalibrationState, exposure: AnyExposure, may_wait: bool
    ) -> tuple[CalibrationState, ExposureDecision] | None:
        if may_wait and self._tracks.is_waiting_for_data(exposure):
            return None
        repeated_time_ns = self._repeated_time_ns
        if repeated_time_ns is not None and repeated_time_ns[0] <= exposure.time_ns <= repeated_time_ns[1]:
            return state, ExposureDecision(exposure, Reason.CONFLICT, text=_REPEATED_TIME_TEXT)
        if isinstance(exposure, StarExposure):
            return self._step_by_stars(state, exposure)
        assembled = self._sightings.assemble(exposure)
        if assembled.sighting is None:
            assert assembled.rejection is not None
            reason, text = assembled.rejection.reason, assembled.rejection.text
            return state, ExposureDecision(exposure, reason, text=text, rejected_parts=assembled.rejected_beacons)
        state, decision = self._step_to(state, assembled.sighting, exposure, assembled.jumps)
        return state, replace(decision, rejected_parts=assembled.rejected_beacons + decision.rejected_parts)

    def _step_by_stars(
        self, state: CalibrationState, exposure: StarExposure
    ) -> tuple[CalibrationState, ExposureDecision]:
        assert self._step_to_stars is not None
        sighting = star_sighting(exposure, self.config, self._tracks)
        if isinstance(sighting, Rejection):
            return state, ExposureDecision(exposure, sighting.reason, text=sighting.text)
        return self._step_to_stars(state, sighting)

    def _inflate_covariance(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        return self.filter.inflate_covariance(state, jump)

    def _stream_consistency(self, since_ns: int, until_ns: int) -> StreamConsistency | None:
        """Return the consistency of the encoder and ship streams in a time range."""
        return self._tracks.stream_consistency(since_ns, until_ns)

    def _has_ship_drifted(self, time_ns: int) -> bool | None:
        """True if the ship's attitude departed from the integral of its rates before a time; None if unknown."""
        return self._tracks.has_ship_drifted(time_ns)

    def _record_stream_fault(
        self, source: str, time_ns: int, rejection: Rejection | None, jumped: bool = False
    ) -> None:
        """Record the time if the encoder or ship stream was stuck, jumped or repeated a stamp."""
        if jumped or (rejection is not None and rejection.reason in _STREAM_FAULT_REASONS):
            self._stream_fault_ns[source] = max(time_ns, self._stream_fault_ns.get(source, time_ns))

    def _record_stream_jump(self, time_ns: int, result: CheckedReading) -> None:
        """Record a jump of the encoders, or the first of several stuck readings, for :meth:`take_jumps`."""
        if result.jump is not None:
            self._jumps.append(StreamJump(result.jump))
        is_stuck = result.rejection is not None and result.rejection.reason is Reason.STUCK
        if is_stuck and not self._is_stuck:
            self._jumps.append(stuck_encoder_jump(time_ns))
        self._is_stuck = is_stuck

    def _stream_faults(self, time_ns: int) -> set[str]:
        """Return which of the encoder and ship streams had a fault since ``integrity.return_after_s`` before a time."""
        since_ns = time_ns - round(self.config.integrity.return_after_s * SECOND_NS)
        return {source for source, fault_ns in self._stream_fault_ns.items() if fault_ns >= since_ns}

    def _drop_before(self, time_ns: int) -> None:
        """Drop the data that no exposure at or after a stamp needs."""
        self._tracks.drop_before(time_ns)
        if self._sky_model is not None:
            self._sky_model.surroundings.drop_before(time_ns)

    def _update_checks(self, decision: ExposureDecision) -> None:
        """Pass the result of an exposure to the checks of encoders and ship's attitude."""
        time_ns = decision.measurement.time_ns
        if decision.telescope_dt is not None:
            self._encoder_check.record_beacon_attitude(time_ns, *decision.telescope_dt)
        # Beacons in a telescope that has shifted carry no information.
        if not decision.accepted or TELESCOPE in decision.excluded_sources:
            return
        if ENCODER in decision.excluded_sources:
            self._encoder_check.set_encoder_offset_from_beacons(time_ns)
        else:
            self._encoder_check.confirm(time_ns)
        if SHIP not in decision.excluded_sources:
            self._ship_check.confirm(time_ns)

    # -- outputs --------------------------------------------------------------------------------------------

    def _publish(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        """Publish the pointings of waiting readings, and then directions of targets.

        A reading waits until the ship's attitude at its time is final or overdue. A reading without an attitude is
        skipped.
        """
        if self._waiting_readings:
            self._publish_waiting(outcome, waiting_ns)
        self._publish_targets(outcome)

    def _publish_targets(self, outcome: PointingOutcome, waiting_ns: int | None = None) -> None:
        self._targets.publish_ready(
            outcome, waiting_ns, self._estimator.window.oldest_ns, lambda: self._estimator.state_now
        )

    def _publish_waiting(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        covered_ns, too_old_ns = self._ship_final_until_ns, self._estimator.window.oldest_ns - 1
        until_ns = too_old_ns if covered_ns is None else max(covered_ns, too_old_ns)
        while self._waiting_readings and self._waiting_readings[0].sample.time_ns <= until_ns:
            sample, unconfirmed_reason, unconfirmed_sigma_rad = self._waiting_readings.popleft()
            unconfirmed_reason = (
                unconfirmed_reason
                or self._ship_check.unconfirmed_reason(sample.time_ns)
                or self._contradiction_text(sample.time_ns)
            )
            ship = self._tracks.ship_at(sample.time_ns)
            if ship is not None:
                pending = PendingPointing(
                    sample, ship, unconfirmed_reason, unconfirmed_sigma_rad, self._estimator.state_now
                )
                self._add_pointing(outcome, pending, waiting_ns)

    def _add_pointing(self, outcome: PointingOutcome, pending: PendingPointing, waiting_ns: int) -> None:
        """Publish or queue (:attr:`pending`) a pointing; skip the pointing if a later output has been published."""
        if self.pending is None:
            follows = self._outputs.can_publish(pending.time_ns)
            self._outputs.add(outcome, pending.time_ns, waiting_ns, lambda: self._pointing.estimate(pending))
            if not (follows and not self._outputs.can_publish(pending.time_ns)):
                return
        elif self._outputs.can_publish(pending.time_ns):
            self.pending.append(pending)
            self._outputs.record(pending.time_ns, waiting_ns)
        else:
            return
        self._targets.record_output(pending, self._estimator.window.oldest_ns)

    def _publish_from_stars(self, outcome: PointingOutcome, waiting_ns: int) -> None:
        """Publish the pointing from the newest stars if ship or encoders have timed out and the stars are recent."""
        needed = {self.config.ship.source: self._ship_arrival_ns, "the encoders": self._encoder_arrival_ns}
        timed_out = [name for name, arrival_ns in needed.items() if _is_timed_out(arrival_ns, waiting_ns)]
        if self._newest_stars is None or not timed_out:
            return
        (exposure, arrival_ns), self._newest_stars = self._newest_stars, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return
        text = f"by stars alone: no data from {' and '.join(timed_out)}"

        def by_stars() -> PointingEstimate | None:
            assert self._sky_model is not None
            return pointing_by_stars(
                exposure, self._sky_model, self.config, self.filter, self._estimator.state_now, text
            )

        self._outputs.add(outcome, exposure.time_ns, waiting_ns, by_stars)

    def _check_repeated_time(self) -> None:
        """Apply exposures again if rejections show that encoders and ship both repeat a range of stamps."""
        before = self._repeated_time_ns
        together = self._estimator.stamp_conflicts.common_interval({ENCODER, self.config.ship.source})
        if together is None:
            return
        first_ns = together[0] - self._tracks.reach_ns
        self._repeated_time_ns = first_ns, together[1]
        if before is None or before[0] != first_ns:
            self._estimator.rewind_after(first_ns if before is None else min(before[0], first_ns))
        elif together[1] > before[1]:
            self._estimator.rewind_after(before[1])

    def _contradiction_text(self, time_ns: int) -> str:
        """Return the text about sources with recent conflicting samples at a time; empty without conflicts."""
        return self._estimator.stamp_conflicts.text(self._estimator.stamp_conflicts.active_at(time_ns))


def _is_timed_out(arrival_ns: int | None, waiting_ns: int) -> bool:
    """True if an input has timed out: no data yet, or the last data more than a second ago."""
    return arrival_ns is None or waiting_ns - arrival_ns > SECOND_NS


def _encoder_limits(config: OpticalAxisConfig) -> tuple[float, float]:
    """Return the noise of a reading, rad, and the largest acceleration of an axis, rad/s²."""
    return config.encoder.sigma_arcsec * ARCSEC, math.radians(config.encoder.max_acceleration_deg_per_s2)

"""Core of ``optical_axis``, shared by node and replay: estimates the main axis from all measurements.

The core uses no ROS, no files and no clock. The core combines the calibration filter, the sampled streams
(:mod:`theodolite_calib.optical_axis.streams`) and the published pointings
(:mod:`theodolite_calib.optical_axis.pointings`) with the time-ordered estimator
(:mod:`ship_estimation.time_order.time_ordered_estimator`), which applies exposures in the order of their stamps.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_estimation.recovery.recoverable_core import RecoverableCore, with_shifted_stamps
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.time_ordered_estimator import EstimatorModel, TimeOrderedEstimator
from ship_geometry.earth.time_scales import SECOND_NS
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import SkyInput
from ship_stars.sky.sky_model import SkyModel
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Jump
from theodolite_calib.filter.star_step import StarStep
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.calibration import CalibrationPrior, prior_from_state, state_from_prior
from theodolite_calib.optical_axis.memory import AxisConsistency, start_from_memory
from theodolite_calib.optical_axis.output import PendingPointing
from theodolite_calib.optical_axis.pointings import Pointings
from theodolite_calib.optical_axis.streams import AxisEstimator, MeasuredStreams, StreamJump
from theodolite_calib.samples.samples import (
    AnyExposure,
    ExposureDecision,
    PointingEstimate,
    PointingOutcome,
    TargetSample,
)
from theodolite_calib.samples.sighting import star_sighting
from theodolite_calib.samples.tracks import MeasuredTracks

if TYPE_CHECKING:
    from theodolite_calib.escort.advice import EscortAdvisor

_REPEATED_TIME_TEXT = "encoders and ship both sent different data with equal stamps: a clock has repeated this time"

_DROP_EVERY_NS = SECOND_NS // 10
"""Interval at which old samples are dropped, ns."""


class OpticalAxisCore(RecoverableCore[CalibrationState, StreamJump]):
    """Estimator of the main optical axis.

    Args:
        config: parameters of the node.
        sky: sky model; None if no camera observes stars.
        on_commit: callback for states that can no longer change, in order; None if unused.
        on_pointing: see :class:`Pointings`.

    Attributes:
        filter: the filter.
        streams: streams of encoders, ship's attitude and drones, and their checks.
        pointings: published pointings; encoder readings, ship's attitudes and target images are added there.
        escort: advisor for the drones; None if advice is disabled.
    """

    filter_class: ClassVar[type[CalibrationFilter]] = CalibrationFilter
    config: OpticalAxisConfig
    sky_model: SkyModel | None

    def __init__(
        self,
        config: OpticalAxisConfig,
        sky: SkyModel | None = None,
        on_commit: Callable[[Sequence[CalibrationState]], None] | None = None,
        on_pointing: Callable[[PointingEstimate, PendingPointing | None], None] | None = None,
    ) -> None:
        self.config, self.filter = config, self.filter_class(config)
        self.sky_model = sky
        self._start: tuple[CalibrationPrior, int] | None = None
        model: EstimatorModel[CalibrationState, AnyExposure, ExposureDecision, Jump] = EstimatorModel(
            step=self._step,
            inflate=self._inflate_covariance,
            failure_decision=lambda exposure, why: ExposureDecision(exposure, why.reason, text=why.text),
            until_ns=lambda decision: decision.measurement.time_ns + decision.measurement.reach_ns,
            drop_before=self._drop_before,
            on_decision=self._record_decision,
            on_commit=on_commit,
        )
        reach_ns = MeasuredTracks(config).reach_ns
        self._estimator: AxisEstimator = TimeOrderedEstimator(
            model, self.filter.initial_state(), config.lag_s, reach_ns
        )
        self.streams = MeasuredStreams(config, self._estimator)
        self.pointings = Pointings(config, self.filter, self._estimator, self.streams, sky, on_pointing)
        self.consistency = AxisConsistency(self._estimator, self.streams, self.pointings)
        self.reset()

    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Discard all measurements; see :meth:`RecoverableCore.reset`."""
        initial = self.filter.initial_state()
        remarks: list[str] = []
        if self._start is not None:
            initial, remarks = state_from_prior(self.filter, self.config, *self._start)
        self._estimator.reset(initial)
        if clock_jumped:
            self.pointings.sequence.reset()
        if self.sky_model is not None:
            self.sky_model.reset()
        self._start_without_samples()
        return remarks

    def step_time_base(self, step_ns: int, state: CalibrationState) -> None:
        """Continue after a step of all clocks, during which no time has passed for the calibration.

        Args:
            step_ns: step, ns.
            state: state before the step.
        """
        self._estimator.reset(with_shifted_stamps(state, step_ns))
        self.pointings.sequence.step_time_base(step_ns)
        if self.sky_model is not None:
            self.sky_model.step_time_base(step_ns)
        self._start_without_samples()

    def _start_without_samples(self) -> None:
        """Discard all samples, waiting readings and images, and the states of the stream checks."""
        self._dropped_until_ns = -_DROP_EVERY_NS
        self.streams.reset()
        self.pointings.reset()
        self._build_steps()
        self.escort: EscortAdvisor | None = None
        if self.config.escort.enabled:
            # Imported here, because loading scipy's optimisers takes longer than the rest of the node.
            from theodolite_calib.escort import advice

            self.escort = advice.EscortAdvisor(self.config, self.filter, self.streams.tracks)

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply changed noise and gates; geometry and the set of beacons must not change."""
        self.config, self.filter = config, self.filter_class(config)
        self._build_steps()
        self.streams.reconfigure(config)
        self.pointings.reconfigure(config, self.filter)
        if self.escort is not None:
            self.escort.reconfigure(config, self.filter)

    def _build_steps(self) -> None:
        self._step_to = SightingStep(
            self.config,
            self.filter,
            self.streams.tracks.stream_consistency,
            self.streams.tracks.has_ship_drifted,
            self.streams.faults,
        )
        self._step_to_stars = None if self.sky_model is None else StarStep(self.config, self.filter, self.sky_model)

    def add_surroundings(self, given: SkyInput) -> PointingOutcome:
        """Add a position fix of the ship or an air reading.

        Exposures of stars whose sky values have changed are applied again.
        """
        assert self.sky_model is not None
        surroundings, outcome = self.sky_model.surroundings, PointingOutcome()
        outcome.rejection = surroundings.rejection(given)
        changed_after_ns = surroundings.insert(given)
        if changed_after_ns is not None:
            changed_ns: int = changed_after_ns
            self._estimator.rewind_to_first(
                lambda decision: (
                    isinstance(decision.measurement, StarExposure) and decision.measurement.time_ns > changed_ns
                )
            )
        self._estimator.apply(outcome)
        return outcome

    def add_exposure(self, exposure: AnyExposure, arrival_ns: int | None = None) -> PointingOutcome:
        """Add an exposure of stars, or with one or more beacons.

        Args:
            exposure: the exposure.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
        """
        outcome = PointingOutcome(self._estimator.window.late_rejection(exposure.time_ns))
        if outcome.rejection is None and self._estimator.add(exposure, outcome) and isinstance(exposure, StarExposure):
            self.pointings.add_stars(exposure, exposure.time_ns if arrival_ns is None else arrival_ns, outcome)
        return outcome

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        """Set the text of a conflict of two publishers on one source; an empty text ends the conflict."""
        stamp_conflicts = (
            self.pointings.target_conflicts if source == TargetSample.source else self._estimator.stamp_conflicts
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
        outcome = PointingOutcome()
        self._estimator.tick(now_ns, outcome)
        self.pointings.tick(outcome, now_ns, now_ns if waiting_ns is None else waiting_ns)
        return outcome

    def calibration_to_save(self) -> CalibrationPrior | None:
        """Return the prior for the next session.

        Before the first sighting, the result is the prior loaded at the start, or None.
        """
        if self.state.last_update_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_from_state(self.filter, self.config, self.state)

    def integrity(self, estimate: PointingEstimate) -> IntegrityReport:
        """Return protection levels and test statistics of a pointing."""
        return self.pointings.output.integrity(estimate)

    @property
    def excluded_sources(self) -> Set[str]:
        """Names of the excluded sources."""
        return self.state.fault_state.excluded.keys()

    def _start_from_memory(self, memory: CalibrationState, live: "OpticalAxisCore") -> None:
        """See :meth:`RecoverableCore._start_from_memory`."""
        self._estimator.reset(start_from_memory(self.filter, memory))
        self._start_without_samples()

    def take_over_outputs(self, live: "OpticalAxisCore") -> None:
        """Continue the outputs of the estimator ``live``, which ends and has no pending output."""
        self.pointings.take_over(live.pointings)

    def _step(
        self, state: CalibrationState, exposure: AnyExposure, may_wait: bool
    ) -> tuple[CalibrationState, ExposureDecision] | None:
        if may_wait and self.streams.tracks.is_waiting_for_data(exposure):
            return None
        if self.streams.is_time_repeated(exposure.time_ns):
            return state, ExposureDecision(exposure, Reason.CONFLICT, text=_REPEATED_TIME_TEXT)
        if isinstance(exposure, StarExposure):
            assert self._step_to_stars is not None
            sighting = star_sighting(exposure, self.config, self.streams.tracks)
            if isinstance(sighting, Rejection):
                return state, ExposureDecision(exposure, sighting.reason, text=sighting.text)
            return self._step_to_stars(state, sighting)
        assembled = self.streams.sightings.assemble(exposure)
        if isinstance(assembled.sighting, Rejection):
            decision = ExposureDecision(exposure, assembled.sighting.reason, text=assembled.sighting.text)
        else:
            state, decision = self._step_to(state, assembled.sighting, exposure, assembled.jumps)
        return state, replace(decision, rejected_parts=assembled.rejected_beacons + decision.rejected_parts)

    def _inflate_covariance(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        return self.filter.inflate_covariance(state, jump)

    def _record_decision(self, decision: ExposureDecision) -> None:
        self.streams.record_decision(decision)

    def _drop_before(self, time_ns: int) -> None:
        """Drop the data that no exposure at or after ``time_ns`` needs; samples are dropped in intervals."""
        if time_ns >= self._dropped_until_ns + _DROP_EVERY_NS:
            self._dropped_until_ns = time_ns
            self.streams.tracks.drop_before(time_ns)
        if self.sky_model is not None:
            self.sky_model.surroundings.drop_before(time_ns)

"""Estimator of the ship attitude from an INS and star sensors, shared by the node and the replay.

The core uses no ROS, no files and no clock. The core consists of the filter, the INS samples and the sky model, in a
time-ordered estimator (:mod:`ship_estimation.time_order.time_ordered_estimator`), which decides when a measurement is
applied and which output may follow. This module adds the parts for the ship attitude. These are the plausibility checks
of the inputs, and the attitude from star sensors alone when the INS is not available.
"""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ship_attitude_star.plausibility.stream_checks import CheckedMeasurement, PlausibilityChecks
from ship_attitude_star.ship_attitude.alignment import (
    Alignment,
    AlignmentPrior,
    current_alignment,
    installation_rotation,
    prior_from_state,
    state_from_prior,
)
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins_batch import InsBatch
from ship_attitude_star.ship_attitude.integrity import integrity_of
from ship_attitude_star.ship_attitude.manoeuvre import RecentSource, RecommendedTurn, recommended_manoeuvre
from ship_attitude_star.ship_attitude.measurements.prediction import LinearisedMeasurement
from ship_attitude_star.ship_attitude.memory import (
    is_consistent,
    largest_difference_sigmas,
    memory_residual,
    propagate_memory,
    start_from_memory,
)
from ship_attitude_star.ship_attitude.observability import Observability, observability_of
from ship_attitude_star.ship_attitude.output import attitude_from_star, estimate_from_star, invalid_estimate
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.ship_attitude.utc_steps import with_utc_evaluated, with_utc_step
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_estimation.parameters.ins import InsChange, InsJump
from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.rate_consistency import RateStatus
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import RecoverableCore
from ship_estimation.rejections import Rejection
from ship_estimation.time_order.outcome import Measurement, Status
from ship_estimation.time_order.output_sequence import OutputSequence
from ship_estimation.time_order.time_ordered_estimator import EstimatorModel, TimeOrderedEstimator, is_within_lag
from ship_estimation.time_order.time_shift import with_shifted_stamps
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack, SampleBlock
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_stars.samples.attitude_samples import (
    AttitudeDecision,
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeOutcome,
    AttitudeSeries,
    StampArray,
)
from ship_stars.samples.readings import DeflectionReading, PositionFix, SkyInput
from ship_stars.sky.sky_model import SkyModel

INS = "ins"


class ShipAttitudeCore(RecoverableCore[FilterState, InsJump]):
    """Estimator of the ship attitude.

    Args:
        config: parameters of the node.
        sky_model: sky model; None if no sensor needs it.
        on_commit: called with states that can no longer change, in order; None if these states are not needed.
    """

    filter_class: ClassVar[type[ShipFilter]] = ShipFilter
    config: ShipAttitudeConfig
    _sky_model: SkyModel | None

    def __init__(
        self,
        config: ShipAttitudeConfig,
        sky_model: SkyModel | None = None,
        on_commit: Callable[[Sequence[FilterState]], None] | None = None,
    ) -> None:
        self.config = config
        self._sky_model = sky_model
        self.vertical: VerticalTrack | None = None
        if config.needs_vertical:
            self.vertical = VerticalTrack(config.gravity, config.sky)
        self.filter = self.filter_class(config, self.vertical)
        self._start: tuple[AlignmentPrior, int] | None = None
        self._ins_timeout_ns = round(config.ins.silence_s * SECOND_NS)
        self._max_gap_ns = round(config.ins.max_gap_s * SECOND_NS)
        exposes = any(star.input == "observations" for star in config.star_sensors.values())
        exposure_reach_ns = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns if exposes else 0
        # The stamps of a device may be offset from the stamps of the INS.
        self._stamp_reach_ns = round(self.filter.linearisation.longest_reach_s * SECOND_NS) + exposure_reach_ns
        model: EstimatorModel[FilterState, Measurement, AttitudeDecision, InsChange] = EstimatorModel(
            step=self._step,
            inflate=self._apply_ins_change,
            failure_decision=_failure_decision,
            until_ns=lambda decision: decision.ins_time_ns + decision.measurement.reach_ns,
            drop_before=self._drop_before,
            on_decision=self._record_decision,
            on_commit=on_commit,
        )
        self._estimator: TimeOrderedEstimator[FilterState, Measurement, AttitudeDecision, InsChange, AttitudeEstimate]
        self._estimator = TimeOrderedEstimator(
            model, self.filter.initial_state(), config.lag_s, self._max_gap_ns + self._stamp_reach_ns
        )
        self._outputs = OutputSequence()
        self.reset()

    def start_from(self, prior: AlignmentPrior, now_ns: int) -> list[str]:
        """Reset to a saved alignment; return remarks for the operator."""
        self._start = (prior, now_ns)
        self.reset()
        return self._initial()[1]

    def _initial(self) -> tuple[FilterState, list[str]]:
        """Return the state before any measurement, from prior or saved alignment, and remarks for the operator."""
        if self._start is None:
            return self.filter.initial_state(), []
        return state_from_prior(self.filter, self.config, *self._start)

    def reset(self, clock_jumped: bool = False) -> None:
        """Discard all measurements; after a jump of the clock, outputs may start again at earlier times."""
        initial, _ = self._initial()
        self._estimator.reset(initial)
        if clock_jumped:
            self._outputs.reset()
        if self._sky_model is not None:
            self._sky_model.reset()
        if self.vertical is not None:
            self.vertical.reset()
        self._start_without_samples(initial)

    def step_time_base(self, step_ns: int, state: FilterState) -> None:
        """Drop measurements and INS samples and continue after a step of the time base.

        INS error, mountings and ship position stay as they are. If all stars are excluded, they are reinstated.

        Args:
            step_ns: step of the time base, ns.
            state: state before the step.
        """
        stars = [source for source, device in self.filter.devices.items() if device.is_star]
        if stars and all(source in state.excluded for source in stars):
            # The stars may have been excluded for an error of UTC.
            state = self.filter.fault_detector.restart_subfilters(state)
        state = with_utc_step(with_shifted_stamps(state, step_ns), self.filter.model, step_ns)
        self._estimator.reset(state)
        self._outputs.step_time_base(step_ns)
        if self._sky_model is not None:
            self._sky_model.step_time_base(step_ns)
        if self.vertical is not None:
            self.vertical.step_time_base(step_ns)
        self._start_without_samples(state)

    def _start_without_samples(self, state: FilterState) -> None:
        """Start from a state, without INS samples."""
        self._corrected = CorrectedIns(self.filter, state, self.config.horizon)
        self._track = AttitudeTrack(self._max_gap_ns)
        self._plausibility = PlausibilityChecks(self.config.ins)
        self._ins_arrival_ns: int | None = None
        self._newest_star: tuple[Measurement, int] | None = None
        self._recent_sources: dict[str, RecentSource] = {}
        self._clear_jumps()

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """Continue with changed noise and gate parameters; geometry and the set of devices stay."""
        self.config = config
        self.filter = self.filter_class(config, self.vertical)
        self._corrected = CorrectedIns(self.filter, self.state, config.horizon)
        self._plausibility.ins.reconfigure(config.ins)

    def add_ins(self, sample: AttitudeSample, arrival_ns: int | None = None, estimate: bool = True) -> AttitudeOutcome:
        """Add an INS sample.

        Args:
            sample: attitude of the deck, and rate of the deck if the INS measures the rate.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
            estimate: False if no attitude is needed, as in a Monte Carlo run.
        """
        if sample.time_ns < self._estimator.window.oldest_ns:
            return AttitudeOutcome(self._estimator.window.late_rejection(sample.time_ns))
        outcome = AttitudeOutcome()
        checked = self._plausibility.ins.check(sample, self._track, self._plausibility.motion_references)
        return self._use_ins(checked, sample.time_ns if arrival_ns is None else arrival_ns, outcome, estimate)

    def evaluate_batch(self, block: SampleBlock, arrivals_ns: StampArray) -> InsBatch | None:
        """Check the INS samples of a block as one batch, up to the first sample that needs separate handling.

        No other INS sample may be added until the batch is committed (:meth:`commit_batch`, :meth:`finish_batch`).

        Args:
            block: samples with rates, in the order of their stamps.
            arrivals_ns: arrival times by the timeout clock, shape (N,).

        Returns:
            The batch; None if the first sample needs separate handling.
        """
        first_ns = int(block.times_ns[0])
        # The vertical at a sample may change with position fixes that arrive before the block ends.
        if self.vertical is not None or not self._plausibility.ins.can_check_block(first_ns):
            return None
        newest, before = self._track.newest, self._track.recent_rates()
        if newest is None or before is None or self._ins_arrival_ns is None:
            return None
        if not (newest.time_ns < first_ns and self._outputs.can_publish(first_ns)):
            return None
        # The batch ends before a gap, before an INS timeout, and before a sample that may be late.
        steps_ns = np.diff(block.times_ns, prepend=newest.time_ns)
        waits_ns = np.diff(arrivals_ns, prepend=self._ins_arrival_ns)
        near = (steps_ns <= self._max_gap_ns) & (waits_ns >= 0) & (waits_ns <= min(self._ins_timeout_ns, SECOND_NS))
        near &= is_within_lag(block.times_ns, arrivals_ns, self.config.lag_s)
        block = block.subset(slice(len(near) if near.all() else int(np.argmin(near))))
        if not len(block.times_ns):
            return None
        samples = block.samples()
        checked = self._plausibility.ins.check_block(samples, block)
        if not checked.count:
            return None
        extra = self._track.extra_noise(first_ns)
        return InsBatch(samples[: checked.accepted_count], block, arrivals_ns, checked, before, extra)

    def commit_batch(self, batch: InsBatch, stop: int) -> None:
        """Commit the samples of a batch before index ``stop``."""
        while batch.committed_count < stop:
            if self._estimator.is_idle:
                end = stop
                self._track.extend(batch.samples[batch.committed_count : end])
                self._estimator.advance_to(batch.samples[end - 1].time_ns)
            else:
                # A pending measurement may need this sample.
                end, outcome = batch.committed_count + 1, AttitudeOutcome()
                self._estimator.add_sample(INS, self._track, batch.samples[batch.committed_count], outcome)
                if outcome.decisions or outcome.failures:
                    batch.pending_outcomes.append((batch.committed_count, outcome))
            contradiction_texts = None
            if self._estimator.stamp_conflicts:
                contradiction_texts = [
                    self._contradiction_text(sample.time_ns) for sample in batch.samples[batch.committed_count : end]
                ]
            batch.commit(self._estimator.state_now, end, contradiction_texts)
            self._ins_arrival_ns = int(batch.arrivals_ns[end - 1])
            self._outputs.record(batch.samples[end - 1].time_ns, self._ins_arrival_ns, self._ins_timeout_ns)
            self._plausibility.ins.by_rates = batch.checked.by_rates(end - 1)

    def finish_batch(self, batch: InsBatch) -> AttitudeOutcome | None:
        """Finish a batch; return the outcome of the sample that needs separate handling, None without such a sample."""
        values, last = batch.block.rotations_nd[: batch.checked.count], batch.checked.last
        self._plausibility.ins.commit_block(values, batch.checked, self._plausibility.motion_references)
        if last is None:
            return None
        return self._use_ins(last, int(batch.arrivals_ns[len(batch.samples)]), AttitudeOutcome(), True)

    def batch_estimates(self, batch: InsBatch) -> list[tuple[slice, AttitudeSeries | Rejection]]:
        """Return the attitudes at the stamps of a batch; see :meth:`InsBatch.attitudes`."""
        return batch.attitudes(self._corrected_by, self._ins_propagation_s, self.config)

    def _use_ins(
        self, checked: CheckedInsSample, arrival_ns: int, outcome: AttitudeOutcome, estimate: bool
    ) -> AttitudeOutcome:
        """Use a checked INS sample and publish the attitude at its stamp."""
        time_ns = checked.sample.time_ns
        if checked.rates_wrong_after_ns is not None:
            # The rates are faulty. Measurements evaluated with these rates are evaluated again without rates.
            changed_after_ns = self._track.drop_rates(checked.rates_wrong_after_ns)
            if changed_after_ns is not None:
                self._estimator.rewind_after(changed_after_ns)
                self._estimator.apply(outcome)
        if checked.noise is not None:
            # Measurements since the change are evaluated again with the measured noise of the samples.
            since_ns = self._track.add_noise(checked.noise)
            self._estimator.add_jump(self.filter.change_effective_ns(checked.noise), INS, checked.noise, since_ns)
            self._estimator.apply(outcome)
        self._jumps.extend(checked.jumps)
        for jump in checked.jumps:
            effective_ns = self.filter.change_effective_ns(jump)
            self._estimator.add_jump(effective_ns, INS, jump, self._track.add_cut(jump.time_ns))
        if checked.rejection is not None:
            outcome.rejection = checked.rejection
            self._estimator.add_rejected(INS, self._track, checked.sample)
            return outcome
        if not self._estimator.add_sample(INS, self._track, checked.sample, outcome):
            return outcome
        # Propagation by a clock offset needs the rate. Without a rate an attitude is published only before the first
        # measurement.
        if self._track.newest is checked.sample and (self._track.has_newest_rate or self.state.time_ns is None):
            self._ins_arrival_ns = arrival_ns
            if estimate:

                def by_ins() -> AttitudeEstimate:
                    return self._estimate_by_newest_ins(self._estimator.state_now, time_ns)

                self._outputs.add(outcome, time_ns, arrival_ns, by_ins, self._ins_timeout_ns)
        return outcome

    def add_sky_input(self, sky_input: SkyInput) -> AttitudeOutcome:
        """Add a position fix or an air reading; affected measurements are evaluated again."""
        outcome = AttitudeOutcome()
        if self._sky_model is not None:
            outcome.rejection = self._sky_model.surroundings.rejection(sky_input)
            self._estimator.stamp_conflicts.record(sky_input.source, sky_input.time_ns, outcome.rejection)
            unchanged_until_ns = self._sky_model.surroundings.insert(sky_input)
            # A plain AttitudeMeasurement does not depend on the sky model; its subclass SolvedAttitude does.
            self._reevaluate(unchanged_until_ns, lambda used: type(used) is not AttitudeMeasurement)
        if self.vertical is not None and isinstance(sky_input, PositionFix):
            if self._sky_model is None:
                outcome.rejection = self.vertical.rejection(sky_input)
                self._estimator.stamp_conflicts.record(sky_input.source, sky_input.time_ns, outcome.rejection)
            self._reevaluate(self.vertical.insert(sky_input), lambda _used: True)
        self._estimator.apply(outcome)
        return outcome

    def add_deflection(self, reading: DeflectionReading) -> AttitudeOutcome:
        """Add a deflection of the vertical; measurements after its stamp are evaluated again."""
        assert self.vertical is not None
        outcome = AttitudeOutcome(self.vertical.rejection(reading))
        self._estimator.stamp_conflicts.record(reading.source, reading.time_ns, outcome.rejection)
        self._reevaluate(self.vertical.insert(reading), lambda _used: True)
        self._estimator.apply(outcome)
        return outcome

    def set_duplicate_publishers(self, source: str, text: str) -> None:
        """Record that two publishers send messages of one source; an empty text removes the record."""
        self._estimator.stamp_conflicts.set_duplicate_publishers(source, self._estimator.window.newest_ns, text)

    def add_measurement(self, measurement: CheckedMeasurement, arrival_ns: int | None = None) -> AttitudeOutcome:
        """Add a measurement of a star sensor, another attitude system or a baseline.

        Args:
            measurement: an attitude, single stars or a baseline.
            arrival_ns: arrival time by the timeout clock; None if it equals the stamp.
        """
        if measurement.time_ns < self._estimator.window.oldest_ns:
            return AttitudeOutcome(self._estimator.window.late_rejection(measurement.time_ns))
        arrival_ns = measurement.time_ns if arrival_ns is None else arrival_ns
        outcome = AttitudeOutcome(self._plausibility.check(measurement, self._track))
        if outcome.rejection is not None or not self._estimator.add(measurement, outcome):
            return outcome
        if self._outputs.can_publish(measurement.time_ns) and self._can_publish_from_stars(measurement.source):
            self._newest_star = measurement, arrival_ns
        self._publish_from_star(outcome, arrival_ns)
        return outcome

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> AttitudeOutcome:
        """Apply delayed measurements, and publish from stars alone after an INS timeout.

        After a timeout of all outputs an INVALID estimate is published once a second.

        Args:
            now_ns: current time.
            waiting_ns: current time by the timeout clock; None if it equals ``now_ns``.
        """
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        outcome = AttitudeOutcome()
        self._estimator.tick(now_ns, outcome)
        self._publish_from_star(outcome, waiting_ns)
        self._outputs.report_invalid(outcome, waiting_ns, lambda: invalid_estimate(self.filter, self.state, now_ns))
        return outcome

    def no_output(self, now_ns: int, text: str) -> AttitudeEstimate:
        """Return an INVALID estimate with a reason."""
        return invalid_estimate(self.filter, self.state, now_ns, text)

    def linearise(self, measurement: Measurement) -> LinearisedMeasurement | None:
        """Linearise a measurement at the current estimate; return None if it cannot be evaluated.

        The INS samples around the stamp must still be stored, so this call must follow the measurement decision
        directly.
        """
        state = self.state
        # The state contains the measurement already, so the noise is not increased for INS errors that this measurement
        # shares with others.
        result = self.filter.linearisation.linearise(
            measurement, state.mean, state.covariance, {}, self._track, self._sky_model
        )
        return result if isinstance(result, LinearisedMeasurement) else None

    def alignment(self) -> Alignment:
        """Return the current estimates of INS errors, installation angles, clock offsets and camera optics."""
        return current_alignment(self.filter, self.config, self.state)

    def star_installation(self, id_: str) -> FloatArray:
        """Return the estimated rotation deck from star sensor, shape (3, 3)."""
        return installation_rotation(self.filter, self.state, f"star.{id_}")

    def deflection(self, time_ns: int) -> DeflectionReading | None:
        """Return the estimated deflection of the vertical at a time; None without ``gravity.deflection``."""
        if self.vertical is None or not self.config.gravity.is_modelled:
            return None
        errors = self._corrected_by(self.state).errors([time_ns])
        return DeflectionReading(time_ns, errors.deflection[0], errors.deflection_covariance[0])

    def observability(self) -> Observability:
        """Return which states and combinations of states the data have determined."""
        return observability_of(self.filter, self.config, self.state)

    def recommended_manoeuvre(self, rotation_nd: FloatArray) -> RecommendedTurn | None:
        """Return the turn of the ship that would improve the attitude most; None if no turn is worthwhile."""
        return recommended_manoeuvre(self.filter, self.state, rotation_nd, self._recent_sources)

    def integrity(self, estimate: AttitudeEstimate) -> IntegrityReport:
        """Return the protection levels of an attitude and the excluded sources."""
        return integrity_of(self.filter, self.config, estimate)

    def alignment_to_save(self) -> AlignmentPrior | None:
        """Return the alignment to save for the next voyage.

        Before any measurement this is the alignment loaded at the start, or None if none was loaded.
        """
        if self.state.time_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_from_state(self.filter, self.config, self.state)

    # -- recovery: see ship_estimation.recovery.recoverable_core --------------------------------------------------

    @property
    def excluded_sources(self) -> Set[str]:
        """Excluded sources."""
        return self.state.excluded.keys()

    @property
    def is_consistent(self) -> bool:
        """True if the state is based on stars, no source is excluded and all sources are consistent."""
        return is_consistent(self.filter, self.state, self.config.gate.degraded_after)

    @property
    def has_unresolved_fault(self) -> bool:
        """True if a fault is detected and not isolated, or UTC is not verified."""
        return self.state.unresolved_fault is not None or self.state.utc_step is not None

    def _start_from_memory(self, memory: FilterState, live: "ShipAttitudeCore") -> None:
        """See :meth:`RecoverableCore._start_from_memory`."""
        if live.vertical is not None:
            self.vertical = live.vertical.clone()
            self.filter = self.filter_class(self.config, self.vertical)
        state = start_from_memory(self.filter, memory, live.state)
        self._estimator.reset(state)
        self._start_without_samples(state)

    def propagate_memory(self, memory: FilterState, jumps: Sequence[InsJump]) -> FilterState:
        """Return a stored state propagated to the oldest time that measurements may still have."""
        return propagate_memory(self.filter, memory, jumps, self._estimator.window.oldest_ns)

    def memory_residuals(self, decision: AttitudeDecision, memory: FilterState) -> Mapping[str, MemoryResidual]:
        """Return the residual of a star measurement against a stored state; empty for other measurements."""
        measurement = decision.measurement
        if not self.filter.devices[measurement.source].is_star:
            return {}
        residual = memory_residual(self.filter, memory, measurement, self._track, self._sky_model)
        return {} if residual is None else {measurement.source: residual}

    def largest_difference_sigmas(self, state: FilterState, memory: FilterState, is_later: bool = False) -> float:
        """Return the largest difference of a constant state from the stored state, in standard deviations."""
        return largest_difference_sigmas(self.filter, state, memory, is_later)

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those of ``sources`` that are devices of the filter without a recently accepted measurement."""
        since_ns, used_ns = self._estimator.window.newest_ns - MAX_MEASUREMENT_AGE_NS, self.state.last_used_ns
        return {name for name in sources if name in self.filter.devices and used_ns.get(name, since_ns - 1) < since_ns}

    @property
    def rate_status(self) -> RateStatus:
        """Result of the rate check of the INS; faulty rates are not used."""
        return self._plausibility.ins.rate_status

    @property
    def excess_noise(self) -> str:
        """Text about INS attitude noise in excess of the stated noise; empty without excess noise."""
        return self._plausibility.ins.comparison.excess_text

    # -- functions of the estimator model --------------------------------------------------------------------

    def _step(
        self, state: FilterState, measurement: Measurement, may_wait: bool
    ) -> tuple[FilterState, AttitudeDecision] | None:
        found = self.filter.step(state, measurement, self._track, self._sky_model, may_wait)
        if state.utc_step is None or found is None or not self.filter.devices[measurement.source].is_star:
            return found
        predicted = self.filter.propagate(state, measurement.time_ns)
        compared = with_utc_evaluated(state, predicted, self.filter.model, *found)
        if compared[0].utc_step is None:
            # UTC is verified, or cannot be verified any more, so the measurement is used.
            return self.filter.step(compared[0], measurement, self._track, self._sky_model, may_wait)
        return compared

    def _apply_ins_change(self, state: FilterState, change: InsChange) -> FilterState:
        return self.filter.apply_ins_change(state, change)

    def _record_decision(self, decision: AttitudeDecision) -> None:
        """Store an accepted measurement, and the time since the previous accepted measurement of the same source."""
        measurement = decision.measurement
        if decision.accepted:
            before = self._recent_sources.get(measurement.source)
            since_s = np.inf if before is None else (measurement.time_ns - before.measurement.time_ns) / SECOND_NS
            if since_s > 0.0:
                self._recent_sources[measurement.source] = RecentSource(measurement, since_s)

    def _drop_before(self, time_ns: int) -> None:
        """Discard data that no measurement at or after a stamp needs."""
        needed_since_ns = self._needed_since_ns(time_ns)
        self._track.drop_before(needed_since_ns - self._stamp_reach_ns)
        if self._sky_model is not None:
            self._sky_model.surroundings.drop_before(time_ns)
        if self.vertical is not None:
            state_ns = self._estimator.oldest_state.time_ns
            self.vertical.drop_before(time_ns, needed_since_ns if state_ns is None else min(needed_since_ns, state_ns))

    def _needed_since_ns(self, closed_ns: int) -> int:
        """Return the earliest time whose data are still needed; measurements before ``closed_ns`` are final."""
        return closed_ns

    def _reevaluate(self, changed_after_ns: int | None, affects: Callable[[Measurement], bool]) -> None:
        """Let the next ``apply`` evaluate again from the first affected measurement after ``changed_after_ns``.

        None changes nothing.
        """
        if changed_after_ns is not None:
            self._estimator.rewind_to_first(
                lambda decision: decision.measurement.time_ns > changed_after_ns and affects(decision.measurement)
            )

    # -- outputs --------------------------------------------------------------------------------------------

    def _estimate_by_newest_ins(self, state: FilterState, time_ns: int) -> AttitudeEstimate:
        """Return the attitude at the stamp of the newest INS sample, corrected by a filter state."""
        corrected = self._corrected_by(state)
        ins = self._track.propagate_newest(self._ins_propagation_s(corrected))
        return self._degrade_if_contradicted(corrected.estimate(time_ns, ins, self.config))

    def _corrected_by(self, state: FilterState) -> CorrectedIns:
        """Return the corrections by a filter state, cached per state."""
        if state is not self._corrected.state:
            self._corrected = self._corrected.with_state(state)
        return self._corrected

    def _ins_propagation_s(self, corrected: CorrectedIns) -> float:
        """Return the time by which an INS sample is propagated to be the attitude at its stamp, s."""
        return -(self.config.ins.time_offset_s + corrected.time_offset_s)

    def _degrade_if_contradicted(self, estimate: AttitudeEstimate) -> AttitudeEstimate:
        """Return the estimate, with status DEGRADED or worse if a source in use recently sent conflicting data."""
        text = self._contradiction_text(estimate.time_ns)
        if not text:
            return estimate
        return replace(estimate, status=max(estimate.status, Status.DEGRADED), text=text)

    def _contradiction_text(self, time_ns: int) -> str:
        """Return a text about the sources in use that recently sent conflicting data; empty without such a source."""
        if not self._estimator.stamp_conflicts:
            return ""
        used_ns, devices = self.state.last_used_ns, self.filter.devices
        contradictory = [
            source
            for source, since_ns in self._estimator.stamp_conflicts.active_at(time_ns).items()
            if source not in devices or used_ns.get(source, since_ns - 1) >= since_ns
        ]
        return self._estimator.stamp_conflicts.text(contradictory)

    def _publish_from_star(self, outcome: AttitudeOutcome, waiting_ns: int) -> None:
        """Publish the attitude from the newest star measurement after an INS timeout, if it arrived at most 1 s ago."""
        if self._newest_star is None or not self._is_ins_timed_out(waiting_ns):
            return
        (measurement, arrival_ns), self._newest_star = self._newest_star, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return

        def by_star() -> AttitudeEstimate | None:
            unmeasured_acceleration = np.deg2rad(self.config.ins.untold_acceleration_deg_per_s2)
            attitude = attitude_from_star(measurement, self._sky_model, float(unmeasured_acceleration))
            return None if attitude is None else estimate_from_star(
                self.filter, self.state, attitude, self.config.horizon
            )

        self._outputs.add(outcome, measurement.time_ns, waiting_ns, by_star)

    def _is_ins_timed_out(self, waiting_ns: int) -> bool:
        """True without an INS sample, or if the last accepted sample arrived more than ``ins.silence_s`` ago."""
        return self._ins_arrival_ns is None or waiting_ns - self._ins_arrival_ns > self._ins_timeout_ns

    def _can_publish_from_stars(self, source: str) -> bool:
        """True for a star sensor with fewer than ``gate.conflict_after`` rejections in a row."""
        in_conflict = self.state.consecutive_rejections.get(source, 0) >= self.config.gate.conflict_after
        return self.filter.devices[source].is_star and not in_conflict


def _failure_decision(measurement: Measurement, rejection: Rejection) -> AttitudeDecision:
    return AttitudeDecision(measurement, rejection.reason, text=rejection.text, ins_time_ns=measurement.time_ns)

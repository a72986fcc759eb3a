"""Estimator of the ship attitude from an INS and star sensors, shared by the node and the replay.

The core uses no ROS, no files and no clock. The core combines the filter, the INS samples
(:mod:`ship_attitude_star.ship_attitude.ins_input`), the sky model and the published attitudes
(:mod:`ship_attitude_star.ship_attitude.attitude_output`) with the time-ordered estimator
(:mod:`ship_estimation.time_order.time_ordered_estimator`), which applies measurements in the order of their stamps.
"""

import math
from collections.abc import Callable, Sequence, Set
from typing import Any, ClassVar, NamedTuple

from ship_attitude_star.ship_attitude.alignment import AlignmentPrior, prior_from_state, state_from_prior
from ship_attitude_star.ship_attitude.attitude_output import AttitudeOutput, ShipEstimator, invalid_estimate
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import integrity_of
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins_input import InsInput
from ship_attitude_star.ship_attitude.recovery import ShipConsistency, start_from_memory
from ship_attitude_star.ship_attitude.state import FilterState, with_utc_evaluated, with_utc_step
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_estimation.plausibility.checked_ins import InsChange, InsJump
from ship_estimation.recovery.recoverable_core import RecoverableCore, with_shifted_stamps
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_estimation.time_order.time_ordered_estimator import EstimatorModel, TimeOrderedEstimator
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S, exposure_nodes
from ship_stars.attitude_samples import (
    AirReading,
    AttitudeDecision,
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeOutcome,
    CheckedMeasurement,
    DeflectionReading,
    SkyInput,
)
from ship_stars.sky.sky_model import SkyModel


class RecentSource(NamedTuple):
    """Recent measurements of a source.

    Attributes:
        measurement: last accepted measurement.
        period_s: time between the last two accepted measurements; infinite after the first measurement.
    """

    measurement: Measurement
    period_s: float


class ShipAttitudeCore(RecoverableCore[FilterState, InsJump]):
    """Estimator of the ship attitude.

    Args:
        config: parameters of the node.
        sky_model: sky model; None if no sensor needs it.
        on_commit: called with states that can no longer change, in order; None if these states are not needed.
        on_estimate: called with each attitude from an INS sample; None if these attitudes are not stored.

    Attributes:
        ins: the INS samples, their checks, and batches of them.
        output: attitudes to publish, from the INS or from stars alone.
        filter: the filter.
        vertical: vertical along the track; None if the configuration does not need it.
        recent_sources: recent measurements by source.
    """

    records_updates: ClassVar[bool] = False
    config: ShipAttitudeConfig
    sky_model: SkyModel | None

    def __init__(
        self,
        config: ShipAttitudeConfig,
        sky_model: SkyModel | None = None,
        on_commit: Callable[[Sequence[FilterState]], None] | None = None,
        on_estimate: Callable[[AttitudeEstimate], None] | None = None,
    ) -> None:
        self.config = config
        self.sky_model = sky_model
        self.vertical: VerticalTrack | None = None
        if config.needs_vertical:
            self.vertical = VerticalTrack(config.gravity, config.sky)
        self.filter = ShipFilter(config, self.vertical, self.records_updates)
        self.recent_sources: dict[str, RecentSource] = {}
        self._start: tuple[AlignmentPrior, int] | None = None
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
        reach_ns = round(config.ins.max_gap_s * SECOND_NS) + self._stamp_reach_ns
        self._estimator: ShipEstimator = TimeOrderedEstimator(
            model, self.filter.initial_state(), config.lag_s, reach_ns
        )
        self.output = AttitudeOutput(config, self.filter, self._estimator, sky_model, on_estimate)
        self.ins = InsInput(config, self._estimator, self.output)
        self.consistency = ShipConsistency(self._estimator, self.output, self.ins)
        self.reset()

    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Discard all measurements; see :meth:`RecoverableCore.reset`."""
        initial, remarks = self.filter.initial_state(), list[str]()
        if self._start is not None:
            initial, remarks = state_from_prior(self.filter, self.config, *self._start)
        self._estimator.reset(initial)
        if clock_jumped:
            self.output.sequence.reset()
        for one in (self.sky_model, self.vertical):
            if one is not None:
                one.reset()
        self._start_without_samples()
        return remarks

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
        self.output.sequence.step_time_base(step_ns)
        for one in (self.sky_model, self.vertical):
            if one is not None:
                one.step_time_base(step_ns)
        self._start_without_samples()

    def _start_without_samples(self) -> None:
        """Start from the state of the estimator, without INS samples."""
        self.output.restart()
        self.ins.reset()
        self.recent_sources.clear()

    def reconfigure(self, config: ShipAttitudeConfig) -> None:
        """Continue with changed noise and gate parameters; geometry and the set of devices stay."""
        self.config = config
        self.filter = ShipFilter(config, self.vertical, self.records_updates)
        self.output.reconfigure(config, self.filter)
        self.ins.ins_check.reconfigure(config.ins)

    def add_surroundings(self, given: SkyInput | DeflectionReading) -> AttitudeOutcome:
        """Add a position fix, an air reading or a deflection of the vertical; evaluate affected measurements again."""
        assert self.vertical is not None or not isinstance(given, DeflectionReading)
        stores: list[tuple[Any, Callable[[Measurement], bool]]] = []
        if self.sky_model is not None and not isinstance(given, DeflectionReading):
            # A plain AttitudeMeasurement does not depend on the sky model; its subclass SolvedAttitude does.
            stores.append((self.sky_model.surroundings, lambda used: type(used) is not AttitudeMeasurement))
        if self.vertical is not None and not isinstance(given, AirReading):
            stores.append((self.vertical, lambda _used: True))
        outcome = AttitudeOutcome()
        if stores:
            # A position fix is in both stores; the decision of the sky model is reported.
            outcome.rejection = stores[0][0].rejection(given)
            self._estimator.stamp_conflicts.record(given.source, given.time_ns, outcome.rejection)
        for store, is_affected in stores:
            self._evaluate_again_after(store.insert(given), is_affected)
        self._estimator.apply(outcome)
        return outcome

    def _evaluate_again_after(self, time_ns: int | None, is_affected: Callable[[Measurement], bool]) -> None:
        """Let the next ``apply`` evaluate again from the first affected measurement after a stamp, if there is one."""
        if time_ns is not None:
            self._estimator.rewind_to_first(
                lambda decision: decision.measurement.time_ns > time_ns and is_affected(decision.measurement)
            )

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
        source, time_ns = measurement.source, measurement.time_ns
        by_ins = self.ins.ins_check.motion_references(time_ns, self.ins.track)
        outcome = AttitudeOutcome(self.ins.stuck_checks.check(source, time_ns, measurement.stuck_value, by_ins))
        if outcome.rejection is not None or not self._estimator.add(measurement, outcome):
            return outcome
        self.output.add_measurement(outcome, measurement, arrival_ns)
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
        self.output.publish_from_star(outcome, waiting_ns)
        self.output.sequence.report_invalid(
            outcome, waiting_ns, lambda: invalid_estimate(self.filter, self.state, now_ns)
        )
        return outcome

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

    @property
    def excluded_sources(self) -> Set[str]:
        """Excluded sources."""
        return self.state.excluded.keys()

    def _start_from_memory(self, memory: FilterState, live: "ShipAttitudeCore") -> None:
        """See :meth:`RecoverableCore._start_from_memory`."""
        if live.vertical is not None:
            self.vertical = live.vertical.clone()
            self.reconfigure(self.config)
        self._estimator.reset(start_from_memory(self.filter, memory, live.state))
        self._start_without_samples()

    def take_over_outputs(self, live: "ShipAttitudeCore") -> None:
        """Continue the outputs of another estimator."""
        self.output.sequence.continue_from(live.output.sequence)

    def _step(
        self, state: FilterState, measurement: Measurement, may_wait: bool
    ) -> tuple[FilterState, AttitudeDecision] | None:
        found = self.filter.step(state, measurement, self.ins.track, self.sky_model, may_wait)
        if state.utc_step is None or found is None or not self.filter.devices[measurement.source].is_star:
            return found
        predicted = self.filter.propagate(state, measurement.time_ns)
        compared = with_utc_evaluated(state, predicted, self.filter.model, *found)
        if compared[0].utc_step is None:
            # UTC is verified, or cannot be verified any more, so the measurement is used.
            return self.filter.step(compared[0], measurement, self.ins.track, self.sky_model, may_wait)
        return compared

    def _apply_ins_change(self, state: FilterState, change: InsChange) -> FilterState:
        return self.filter.apply_ins_change(state, change)

    def _record_decision(self, decision: AttitudeDecision) -> None:
        """Store an accepted measurement, and the time since the previous accepted measurement of the same source."""
        measurement = decision.measurement
        if decision.accepted:
            before = self.recent_sources.get(measurement.source)
            since_s = math.inf if before is None else (measurement.time_ns - before.measurement.time_ns) / SECOND_NS
            if since_s > 0.0:
                self.recent_sources[measurement.source] = RecentSource(measurement, since_s)

    def _drop_before(self, time_ns: int, needed_since_ns: int | None = None) -> None:
        """Discard data that no measurement at or after a stamp needs; keep the data of the ship since another stamp."""
        needed_since_ns = time_ns if needed_since_ns is None else needed_since_ns
        self.ins.track.drop_before(needed_since_ns - self._stamp_reach_ns)
        if self.sky_model is not None:
            self.sky_model.surroundings.drop_before(time_ns)
        if self.vertical is not None:
            state_ns = self._estimator.oldest_state.time_ns
            self.vertical.drop_before(time_ns, needed_since_ns if state_ns is None else min(needed_since_ns, state_ns))


def _failure_decision(measurement: Measurement, rejection: Rejection) -> AttitudeDecision:
    return AttitudeDecision(measurement, rejection.reason, text=rejection.text, ins_time_ns=measurement.time_ns)

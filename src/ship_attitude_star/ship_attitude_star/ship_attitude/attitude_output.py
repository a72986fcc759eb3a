"""Attitudes to publish: from the newest INS sample, corrected by the filter, or from stars alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins.corrected_ins import CorrectedIns
from ship_attitude_star.ship_attitude.output import attitude_from_star, estimate_from_star
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.plausibility.ins_jump import InsChange
from ship_estimation.time_order.outcome import Measurement, Status
from ship_estimation.time_order.output_sequence import OutputSequence
from ship_estimation.time_order.time_ordered_estimator import TimeOrderedEstimator
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_stars.samples.attitude_samples import AttitudeDecision, AttitudeEstimate, AttitudeOutcome
from ship_stars.samples.readings import DeflectionReading
from ship_stars.sky.sky_model import SkyModel

INS = "ins"

ShipEstimator = TimeOrderedEstimator[FilterState, Measurement, AttitudeDecision, InsChange, AttitudeEstimate]
"""Time-ordered estimator of the ship filter."""


class AttitudeOutput:
    """Published attitudes.

    Args:
        config: parameters of the node.
        filter_: the filter.
        estimator: time-ordered estimator of the filter.
        sky_model: sky model; None if no sensor needs it.
        on_estimate: called with each attitude from an INS sample; None if these attitudes are not stored.

    Attributes:
        config: parameters of the node.
        filter: the filter.
        sky_model: sky model; None if no sensor needs it.
        sequence: order and timeout of the outputs.
        corrected: the last used corrections of INS samples.
        ins_timeout_ns: time without an INS sample after which attitudes come from stars alone.
    """

    def __init__(
        self,
        config: ShipAttitudeConfig,
        filter_: ShipFilter,
        estimator: ShipEstimator,
        sky_model: SkyModel | None,
        on_estimate: Callable[[AttitudeEstimate], None] | None,
    ) -> None:
        self._estimator, self.sky_model, self._on_estimate = estimator, sky_model, on_estimate
        self.sequence, self.ins_timeout_ns = OutputSequence(), round(config.ins.silence_s * SECOND_NS)
        self.reconfigure(config, filter_)
        self.start_from(estimator.state)

    def reconfigure(self, config: ShipAttitudeConfig, filter_: ShipFilter) -> None:
        """Continue with another configuration and filter."""
        self.config, self.filter = config, filter_
        self.corrected = CorrectedIns(filter_, self._estimator.state, config.horizon)

    def start_from(self, state: FilterState) -> None:
        """Start from a state, without measurements."""
        self.corrected = CorrectedIns(self.filter, state, self.config.horizon)
        self._newest_star: tuple[Measurement, int] | None = None

    @property
    def must_be_single(self) -> bool:
        """True if each INS sample is processed by itself, because of the vertical or to store each attitude."""
        return self.filter.vertical is not None or self._on_estimate is not None

    def corrected_by(self, state: FilterState) -> CorrectedIns:
        """Return the corrections by a filter state, cached per state."""
        if state is not self.corrected.state:
            self.corrected = self.corrected.with_state(state)
        return self.corrected

    def propagation_s(self, corrected: CorrectedIns) -> float:
        """Return the time by which an INS sample is propagated to be the attitude at its stamp, s."""
        return -(self.config.ins.time_offset_s + corrected.time_offset_s)

    def publish_from_ins(self, outcome: AttitudeOutcome, track: AttitudeTrack, time_ns: int, waiting_ns: int) -> None:
        """Publish the attitude at the stamp of the newest INS sample, corrected by the state."""

        def by_ins() -> AttitudeEstimate:
            corrected = self.corrected_by(self._estimator.state_now)
            estimate = corrected.estimate(time_ns, track.propagate_newest(self.propagation_s(corrected)), self.config)
            text = self.contradiction_text(time_ns)
            if not text:
                return estimate
            return replace(estimate, status=max(estimate.status, Status.DEGRADED), text=text)

        count = len(outcome.estimates)
        self.sequence.add(outcome, time_ns, waiting_ns, by_ins, self.ins_timeout_ns)
        if self._on_estimate is not None and len(outcome.estimates) > count:
            self._on_estimate(outcome.estimates[-1])

    def contradiction_text(self, time_ns: int) -> str:
        """Return a text about the sources in use that recently sent conflicting data; empty without such a source."""
        if not self._estimator.stamp_conflicts:
            return ""
        used_ns, devices = self._estimator.state.last_used_ns, self.filter.devices
        contradictory = [
            source
            for source, since_ns in self._estimator.stamp_conflicts.active_at(time_ns).items()
            if source not in devices or used_ns.get(source, since_ns - 1) >= since_ns
        ]
        return self._estimator.stamp_conflicts.text(contradictory)

    def add_star(self, measurement: Measurement, arrival_ns: int) -> None:
        """Store a measurement of a star sensor with fewer than ``gate.conflict_after`` rejections in a row."""
        rejections = self._estimator.state.consecutive_rejections.get(measurement.source, 0)
        is_usable = self.filter.devices[measurement.source].is_star and rejections < self.config.gate.conflict_after
        if is_usable and self.sequence.can_publish(measurement.time_ns):
            self._newest_star = measurement, arrival_ns

    def publish_from_star(self, outcome: AttitudeOutcome, waiting_ns: int) -> None:
        """Publish the attitude from the newest star measurement, if that arrived at most 1 s ago."""
        if self._newest_star is None:
            return
        (measurement, arrival_ns), self._newest_star = self._newest_star, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return

        def by_star() -> AttitudeEstimate | None:
            unmeasured_acceleration = np.deg2rad(self.config.ins.untold_acceleration_deg_per_s2)
            attitude = attitude_from_star(measurement, self.sky_model, float(unmeasured_acceleration))
            return (
                None
                if attitude is None
                else estimate_from_star(self.filter, self._estimator.state, attitude, self.config.horizon)
            )

        self.sequence.add(outcome, measurement.time_ns, waiting_ns, by_star)

    def deflection(self, time_ns: int) -> DeflectionReading | None:
        """Return the estimated deflection of the vertical at a time; None without ``gravity.deflection``."""
        if self.filter.vertical is None or not self.config.gravity.is_modelled:
            return None
        errors = self.corrected_by(self._estimator.state).errors([time_ns])
        return DeflectionReading(time_ns, errors.deflection[0], errors.deflection_covariance[0])

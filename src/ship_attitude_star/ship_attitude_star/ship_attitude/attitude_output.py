"""Attitudes to publish: from the newest INS sample, corrected by the filter, from stars alone, or INVALID."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.config import GEODETIC, GRAVITY, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns, newest_star_ns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.plausibility.checked_ins import InsChange
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Measurement, Status
from ship_estimation.time_order.time_ordered_estimator import OutputSequence, TimeOrderedEstimator
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import exp_rotation, left_jacobian
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.solution import SolutionStatus, solve_stars
from ship_stars.attitude_samples import (
    AttitudeDecision,
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeOutcome,
    DeflectionReading,
    Horizon,
    InertialAttitude,
    SolvedAttitude,
)
from ship_stars.sky.sky_model import SkyModel
from ship_stars.sky.tracker_attitude import to_horizon_attitude

ShipEstimator = TimeOrderedEstimator[FilterState, Measurement, AttitudeDecision, InsChange, AttitudeEstimate]
"""Time-ordered estimator of the ship filter."""


def attitude_from_star(
    measurement: Measurement, sky_model: SkyModel | None, unmeasured_acceleration: float
) -> AttitudeMeasurement | None:
    """Return the attitude of a star sensor from one measurement alone; None if it does not determine the attitude.

    Args:
        measurement: measurement of the sensor.
        sky_model: sky model; None if no sensor needs it.
        unmeasured_acceleration: standard deviation of the unmeasured angular acceleration of the deck, each axis,
            rad/s².
    """
    attitude: Measurement | Rejection = measurement
    if isinstance(measurement, InertialAttitude | SolvedAttitude):
        assert sky_model is not None
        attitude = to_horizon_attitude(measurement, sky_model)
    if isinstance(attitude, Rejection):
        return None
    if isinstance(attitude, AttitudeMeasurement):
        return replace(attitude, common_n=attitude.correlated_n, shared_n=None)
    assert sky_model is not None
    assert isinstance(measurement, StarExposure)
    return _attitude_from_exposure(measurement, sky_model, unmeasured_acceleration)


def _attitude_from_exposure(
    exposure: StarExposure, sky_model: SkyModel, unmeasured_acceleration: float
) -> AttitudeMeasurement | None:
    """Return the sensor attitude from one exposure; None if the exposure is rejected or has no verified solution."""
    visible = visible_stars(exposure, sky_model, None)
    if isinstance(visible, Rejection):
        return None
    _, stars, _ = visible
    solution = solve_stars(stars)
    if solution.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return None
    rotation_ns = solution.rotation_nb
    noise_s = rotation_ns.T @ solution.noise_n @ rotation_ns
    if exposure.length is not None:
        noise_s = noise_s + exposure.length.unmeasured_turn_variance(unmeasured_acceleration) * np.eye(3)
    return AttitudeMeasurement(
        exposure.source, exposure.time_ns, rotation_ns, noise_s, solution.covariance_n - solution.noise_n
    )


def estimate_from_star(
    filter_: ShipFilter, state: FilterState, measurement: AttitudeMeasurement, horizon: str = GEODETIC
) -> AttitudeEstimate:
    """Return the ship attitude from the measurement and the estimated installation of one star sensor."""
    model, device = filter_.model, filter_.devices[measurement.source]
    state = filter_.propagate(state, measurement.time_ns)
    installation = state.mean[model.slices[f"{device.name}.installation"]]
    to_horizon = measurement.rotation_nv
    rotation_nd = to_horizon @ (device.rotation_dv0 @ exp_rotation(installation)).T
    rows, jacobian = model.state_indices(f"{device.name}.installation"), to_horizon @ left_jacobian(installation).T
    if f"{device.name}.flexure" in model.slices:
        # Without INS samples the flexure is not estimated, and its last estimate is soon outdated. Only the covariance
        # of the flexure is used.
        rows = np.r_[rows, model.state_indices(f"{device.name}.flexure")]
        jacobian = np.hstack([jacobian, rotation_nd])
    to_gravity = horizon == GRAVITY and filter_.vertical is not None
    if to_gravity:
        assert filter_.vertical is not None
        by_deflection = filter_.vertical.at(measurement.time_ns).deflection_jacobian
        deflection = model.state_indices("gravity.deflection")
        rotation_nd = exp_rotation(-by_deflection @ state.mean[deflection]) @ rotation_nd
        rows, jacobian = np.r_[rows, deflection], np.hstack([jacobian, -by_deflection])
    covariance_by_source = jacobian @ state.covariance_by_source[:, rows[:, None], rows] @ jacobian.T
    white, common = device.noise_sources[0], model.blocks[f"{device.name}.common"].source
    covariance_by_source[model.source_indices[white]] += to_horizon @ measurement.noise_v @ to_horizon.T
    covariance_by_source[model.source_indices[common]] += measurement.common_n
    covariance_n = covariance_by_source.sum(axis=0)
    return AttitudeEstimate(
        time_ns=measurement.time_ns,
        rotation_nd=rotation_nd,
        covariance_by_source_n=covariance_by_source,
        covariance_n=covariance_n,
        covariance_without_separation_n=covariance_n,
        status=Status.DEGRADED,
        horizon=Horizon.GRAVITY if to_gravity else Horizon.GEODETIC,
        sources=(measurement.source,),
        star_age_s=0.0,
        rate_d=np.full(3, np.nan),
        state=state,
        text="no INS data, stars alone",
    )


def invalid_estimate(filter_: ShipFilter, state: FilterState, now_ns: int, text: str = "") -> AttitudeEstimate:
    """Return an INVALID estimate, for lack of INS and star data or for the reason in the text."""
    unknown, star_ns = np.full((3, 3), np.nan), newest_star_ns(filter_, state)
    return AttitudeEstimate(
        time_ns=now_ns,
        rotation_nd=unknown,
        covariance_by_source_n=np.full((len(filter_.model.sources), 3, 3), np.nan),
        covariance_n=unknown,
        covariance_without_separation_n=unknown,
        status=Status.INVALID,
        horizon=Horizon.GRAVITY,
        sources=(),
        star_age_s=float("nan") if star_ns is None else (now_ns - star_ns) / SECOND_NS,
        rate_d=np.full(3, np.nan),
        state=state,
        text=text,
    )


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
        ins_arrival_ns: arrival time of the last accepted INS sample, by the timeout clock; None before a sample.
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
        self._newest_star: tuple[Measurement, int] | None = None
        self.ins_arrival_ns: int | None = None
        self.reconfigure(config, filter_)

    def reconfigure(self, config: ShipAttitudeConfig, filter_: ShipFilter) -> None:
        """Continue with another configuration and filter."""
        self.config, self.filter = config, filter_
        self.corrected = CorrectedIns(filter_, self._estimator.state, config)

    def restart(self) -> None:
        """Start from the state of the estimator, without measurements."""
        self.reconfigure(self.config, self.filter)
        self._newest_star = self.ins_arrival_ns = None

    @property
    def must_be_single(self) -> bool:
        """True if each INS sample is processed by itself, because of the vertical or to store each attitude."""
        return self.filter.vertical is not None or self._on_estimate is not None

    def corrected_by(self, state: FilterState | None = None) -> CorrectedIns:
        """Return the corrections by a filter state (default: the present state for outputs), cached per state."""
        if state is None:
            state = self._estimator.state_now
        if state is not self.corrected.state:
            self.corrected = self.corrected.with_state(state)
        return self.corrected

    def publish_from_ins(self, outcome: AttitudeOutcome, track: AttitudeTrack, time_ns: int, waiting_ns: int) -> None:
        """Publish the attitude at the stamp of the newest INS sample, corrected by the state."""

        def by_ins() -> AttitudeEstimate:
            text, corrected = self.contradiction_text(time_ns), self.corrected_by()
            estimate = corrected.estimate(time_ns, track.propagate_newest(corrected.propagation_s))
            return replace(estimate, status=max(estimate.status, Status.DEGRADED), text=text) if text else estimate

        count = len(outcome.estimates)
        self.sequence.add(outcome, time_ns, waiting_ns, by_ins, self.ins_timeout_ns)
        if self._on_estimate is not None and len(outcome.estimates) > count:
            self._on_estimate(outcome.estimates[-1])

    def contradiction_text(self, time_ns: int) -> str:
        """Return a text about the sources in use that recently sent conflicting data; empty without such a source."""
        if self._estimator.stamp_conflicts.is_empty:
            return ""
        used_ns, devices = self._estimator.state.last_used_ns, self.filter.devices
        contradictory = [
            source
            for source, since_ns in self._estimator.stamp_conflicts.active_at(time_ns).items()
            if source not in devices or used_ns.get(source, since_ns - 1) >= since_ns
        ]
        return self._estimator.stamp_conflicts.text(contradictory)

    def add_measurement(self, outcome: AttitudeOutcome, measurement: Measurement, arrival_ns: int) -> None:
        """Store a star measurement unless its sensor is in conflict; publish from it if the INS has timed out."""
        rejections = self._estimator.state.consecutive_rejections.get(measurement.source, 0)
        is_usable = self.filter.devices[measurement.source].is_star and rejections < self.config.gate.conflict_after
        if is_usable and self.sequence.can_publish(measurement.time_ns):
            self._newest_star = measurement, arrival_ns
        self.publish_from_star(outcome, arrival_ns)

    def publish_from_star(self, outcome: AttitudeOutcome, waiting_ns: int) -> None:
        """Publish the attitude from the newest star measurement, if the INS has timed out.

        A measurement that arrived more than 1 s ago is not published.
        """
        is_ins_recent = self.ins_arrival_ns is not None and waiting_ns - self.ins_arrival_ns <= self.ins_timeout_ns
        if is_ins_recent or self._newest_star is None:
            return
        (measurement, arrival_ns), self._newest_star = self._newest_star, None
        if waiting_ns - arrival_ns > SECOND_NS:
            return

        def by_star() -> AttitudeEstimate | None:
            unmeasured_acceleration = np.deg2rad(self.config.ins.untold_acceleration_deg_per_s2)
            attitude = attitude_from_star(measurement, self.sky_model, float(unmeasured_acceleration))
            if attitude is None:
                return None
            return estimate_from_star(self.filter, self._estimator.state, attitude, self.config.horizon)

        self.sequence.add(outcome, measurement.time_ns, waiting_ns, by_star)

    def deflection(self, time_ns: int) -> DeflectionReading | None:
        """Return the estimated deflection of the vertical at a time; None without ``gravity.deflection``."""
        if self.filter.vertical is None or not self.config.gravity.is_modelled:
            return None
        errors = self.corrected_by(self._estimator.state).errors([time_ns])
        return DeflectionReading(time_ns, errors.deflection[0], errors.deflection_covariance[0])

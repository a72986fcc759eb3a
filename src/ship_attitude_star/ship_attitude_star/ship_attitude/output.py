"""From the filter's state and the newest data to the published attitude and its covariance by source."""

import math
from dataclasses import replace

import numpy as np

from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import (
    AttitudeEstimate,
    AttitudeMeasurement,
    AttitudeRun,
    Horizon,
    SolvedAttitude,
    StampArray,
)
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins_at_fault import UNKNOWN_INS_RAD_PER_SQRT_S
from ship_attitude_star.ship_attitude.integrity import QUANTITIES, integrity_of
from ship_attitude_star.ship_attitude.model import SOURCE_INS_NOISE, SOURCE_INTERPOLATION
from ship_attitude_star.ship_attitude.row_table import INS
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure, visible_stars
from ship_attitude_star.stars.solution import SolutionStatus, solve_stars
from ship_estimation.kalman import lasting
from ship_estimation.outcome import Measurement, Status
from ship_estimation.protection import above_limit
from ship_estimation.refusals import Refusal
from ship_geometry import compiled_rotations
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian
from ship_geometry.time_scales import SECOND_NS

_ATTITUDE, _TIME_OFFSET = slice(0, 3), 3
"""Columns of the states that correct an INS attitude: its slow error (north, up, east) and its time offset."""


class CorrectedIns:
    """INS attitudes corrected by one filter state; made once per state, used at the INS's rate.

    Only the INS's slow error and its time offset enter, so only those rows of the covariance are carried.

    Args:
        filter_: the filter and its model.
        state: its state after the last measurement.

    Attributes:
        state: the same.
        time_offset_s: estimated tau, on top of the configured constant, s.
    """

    def __init__(self, filter_: ShipFilter, state: FilterState) -> None:
        self.state, self._filter = state, filter_
        model, slow = filter_.model, filter_.model.blocks["ins.attitude"]
        rows = np.r_[model.rows("ins.attitude"), model.rows("ins.time_offset")]
        self._error_n = state.mean[rows][_ATTITUDE]
        self.time_offset_s = float(state.mean[rows][_TIME_OFFSET])
        self._parts = np.ascontiguousarray(state.parts[:, rows[:, None], rows])
        self._drift_index = model.sources.index(slow.source)
        self._white_index = model.sources.index(SOURCE_INS_NOISE)
        self._interpolation_index = model.sources.index(SOURCE_INTERPOLATION)
        self._lasting = lasting(self._error_n, slow.sigma).view(np.uint8)
        self._correlation_time_s, self._steady_variance = slow.time_s, slow.sigma**2
        self._newest_star_ns = _newest_star_ns(filter_, state)
        self._white_variance = model.blocks["ins.noise"].sigma ** 2

    def attitudes(
        self,
        since_s: FloatArray,
        rotation_nd: FloatArray,
        rate_d: FloatArray,
        noise_gain: FloatArray,
        error_covariance_d: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Attitudes of N moments and their covariance by source, horizon frame, rad².

        The result depends on the arguments and the state alone; one moment gives, to the last bit, what it gives among
        others. The last four arguments are the INS's attitudes of these moments (its samples moved by tau), as
        :class:`ship_geometry.attitude_track.InterpolatedAttitude` has them.

        Args:
            since_s: time from the state to each moment, at least 0, s, shape (N,).
            rotation_nd: shape (N, 3, 3).
            rate_d: rad/s, shape (N, 3).
            noise_gain: shape (N,).
            error_covariance_d: rad², shape (N, 3, 3).

        Returns:
            Shapes (N, 3, 3) and (N, n_sources, 3, 3).
        """
        found: tuple[FloatArray, FloatArray] = compiled_rotations.corrected(
            since_s,
            rotation_nd,
            rate_d,
            noise_gain,
            error_covariance_d,
            self._error_n,
            self._lasting,
            self._correlation_time_s,
            self._steady_variance,
            self._white_variance,
            self._parts,
            self._drift_index,
            self._white_index,
            self._interpolation_index,
        )
        return found

    def estimate(self, time_ns: int, ins: InterpolatedAttitude, config: ShipAttitudeConfig) -> AttitudeEstimate:
        """The attitude at the stamp of an INS sample, with its status."""
        moved = ins.rotation_nd[None], ins.rate_d[None], np.array([ins.noise_gain]), ins.error_covariance_d[None]
        return self.estimates(np.array([time_ns]), *moved, config).one(0)

    def estimates(
        self,
        time_ns: StampArray,
        rotation_nd: FloatArray,
        rate_d: FloatArray,
        noise_gain: FloatArray,
        error_covariance_d: FloatArray,
        config: ShipAttitudeConfig,
    ) -> AttitudeRun:
        """The attitudes at the stamps of N INS samples, with their statuses.

        Args:
            time_ns: in ascending order, shape (N,).
            rotation_nd: and the next three as in :meth:`attitudes`.
            rate_d: rad/s.
            noise_gain: of the samples' white noise.
            error_covariance_d: rad².
            config: of the node.
        """
        state, since_ns = self.state, np.zeros(len(time_ns), dtype=np.int64)
        if state.time_ns is not None:
            since_ns = np.maximum(time_ns - state.time_ns, 0)
        since_s = 1e-9 * since_ns.astype(np.float64)
        attitude_nd, parts = self.attitudes(since_s, rotation_nd, rate_d, noise_gain, error_covariance_d)
        if state.doubt is not None:
            parts[:, self._drift_index] += state.doubt.covariance_n
        if INS in state.excluded:
            unknown = UNKNOWN_INS_RAD_PER_SQRT_S**2 * since_ns * 1e-9
            parts[:, self._drift_index] += unknown[:, None, None] * np.eye(3)
        covariance_n = undisputed_n = parts.sum(axis=1)
        if state.disputed_n is not None:
            parts[:, self._drift_index] += state.disputed_n
            covariance_n = parts.sum(axis=1)
        star_age_s = self._star_ages_s(time_ns)
        worth = [self._worth(age_s, config.coasting_after_s) for age_s in star_age_s.tolist()]
        run = AttitudeRun(
            time_ns=time_ns,
            rotation_nd=attitude_nd,
            covariance_parts_n=parts,
            covariance_n=covariance_n,
            undisputed_n=undisputed_n,
            rate_d=rate_d,
            status=[status for status, _ in worth],
            # NaN compares false: before the first star the horizon is the INS's own.
            horizon=np.where(star_age_s <= config.ins.tilt_time_s, Horizon.GEODETIC, Horizon.GRAVITY),
            sources=self._sources(time_ns, round(config.coasting_after_s * SECOND_NS)),
            star_age_s=star_age_s,
            state=state,
            text=[text for _, text in worth],
        )
        if config.integrity.alert_limit_arcsec:
            self._degrade_above_limit(run, config)
        return run

    def _star_ages_s(self, time_ns: StampArray) -> FloatArray:
        """Time since the last star measurement used; NaN where there was none."""
        if self._newest_star_ns is None:
            return np.full(len(time_ns), np.nan)
        ages_s: FloatArray = (time_ns - self._newest_star_ns) / SECOND_NS
        return ages_s

    def _sources(self, time_ns: StampArray, recent_ns: int) -> list[tuple[str, ...]]:
        """At each moment the INS, and the sources of which a measurement was used not long before."""

        def at(moment_ns: int) -> tuple[str, ...]:
            used = [source for source, used_ns in self.state.used_ns.items() if used_ns >= moment_ns - recent_ns]
            return INS, *sorted(used)

        first, last = at(int(time_ns[0])), at(int(time_ns[-1]))
        # As time goes on sources can only be left out.
        return [first] * len(time_ns) if first == last else [at(moment_ns) for moment_ns in time_ns.tolist()]

    def _degrade_above_limit(self, run: AttitudeRun, config: ShipAttitudeConfig) -> None:
        """Attitudes that may be wrong by more than the alert limit are DEGRADED."""
        for number, status in enumerate(run.status):
            if status is not Status.DEGRADED:
                text = above_limit(integrity_of(self._filter, config, run.one(number)), QUANTITIES)
                if text:
                    run.status[number], run.text[number] = Status.DEGRADED, text

    def _worth(self, star_age_s: float, coasting_after_s: float) -> tuple[Status, str]:
        """Status of an attitude, and why it is DEGRADED."""
        if self.state.doubt is not None:
            return Status.DEGRADED, self.state.doubt.text
        if math.isnan(star_age_s):
            return Status.DEGRADED, "INS alone, no star yet"
        if self.state.unconfirmed is not None:
            return Status.DEGRADED, self.state.unconfirmed.text
        if star_age_s <= coasting_after_s:
            return Status.VALID, ""
        if INS in self.state.excluded:
            return Status.DEGRADED, "no star is used, and the INS contradicted the stars"
        return Status.COASTING, ""


def attitude_alone(
    measurement: Measurement, watch: SkyWatch | None, untold_acceleration: float
) -> AttitudeMeasurement | None:
    """The attitude of a star sensor by one measurement and nothing else; None where it does not give one.

    Args:
        measurement: of the sensor.
        watch: the sky; None where no sensor needs it.
        untold_acceleration: angular acceleration of the deck that nothing tells, sigma of each axis, rad/s².
    """
    attitude: Measurement | Refusal = measurement
    if isinstance(measurement, InertialAttitude | SolvedAttitude):
        assert watch is not None
        attitude = in_horizon(measurement, watch)
    if isinstance(attitude, Refusal):
        return None
    if isinstance(attitude, AttitudeMeasurement):
        return replace(attitude, common_n=attitude.lasting_n, shared_n=None)
    assert watch is not None
    assert isinstance(measurement, StarExposure)
    return _by_stars(measurement, watch, untold_acceleration)


def _by_stars(exposure: StarExposure, watch: SkyWatch, untold_acceleration: float) -> AttitudeMeasurement | None:
    """The sensor's attitude by one exposure; None where its stars do not give one that others of them verify."""
    visible = visible_stars(exposure, watch, None)
    if isinstance(visible, Refusal):
        return None
    _, stars, _ = visible
    solution = solve_stars(stars)
    if solution.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return None
    rotation_ns = solution.rotation_nb
    noise_s = rotation_ns.T @ solution.noise_n @ rotation_ns
    if exposure.length is not None:
        noise_s = noise_s + exposure.length.untold_turn_variance(untold_acceleration) * np.eye(3)
    return AttitudeMeasurement(
        exposure.source, exposure.time_ns, rotation_ns, noise_s, solution.covariance_n - solution.noise_n
    )


def estimate_from_star(
    filter_: ShipFilter, state: FilterState, measurement: AttitudeMeasurement
) -> AttitudeEstimate:
    """With the INS gone, the attitude of one star sensor alone: its measurement and its installation."""
    model, device = filter_.model, filter_.devices[measurement.source]
    state = filter_.predicted(state, measurement.time_ns)
    installation = state.mean[model.slices[f"{device.name}.installation"]]
    to_horizon = measurement.rotation_nv
    rotation_nd = to_horizon @ (device.rotation_dv0 @ exp_rotation(installation)).T
    rows, jacobian = model.rows(f"{device.name}.installation"), to_horizon @ left_jacobian(installation).T
    if f"{device.name}.flexure" in model.slices:
        # Unknown now, and soon independent of what it was: only its covariance matters.
        rows = np.r_[rows, model.rows(f"{device.name}.flexure")]
        jacobian = np.hstack([jacobian, rotation_nd])
    parts = jacobian @ state.parts[:, rows[:, None], rows] @ jacobian.T
    parts[model.sources.index(device.noise_source)] += to_horizon @ measurement.noise_v @ to_horizon.T
    common = model.blocks[f"{device.name}.common"].source
    parts[model.sources.index(common)] += measurement.common_n
    covariance_n = parts.sum(axis=0)
    return AttitudeEstimate(
        time_ns=measurement.time_ns,
        rotation_nd=rotation_nd,
        covariance_parts_n=parts,
        covariance_n=covariance_n,
        undisputed_n=covariance_n,
        rate_d=np.full(3, np.nan),
        status=Status.DEGRADED,
        horizon=Horizon.GEODETIC,
        sources=(measurement.source,),
        star_age_s=0.0,
        state=state,
        text="INS gone, stars alone",
    )


def no_estimate(filter_: ShipFilter, state: FilterState, now_ns: int) -> AttitudeEstimate:
    """Neither INS nor star: no attitude is claimed."""
    return AttitudeEstimate(
        time_ns=now_ns,
        rotation_nd=np.full((3, 3), np.nan),
        covariance_parts_n=np.full((len(filter_.model.sources), 3, 3), np.nan),
        covariance_n=np.full((3, 3), np.nan),
        undisputed_n=np.full((3, 3), np.nan),
        rate_d=np.full(3, np.nan),
        status=Status.INVALID,
        horizon=Horizon.GRAVITY,
        sources=(),
        star_age_s=_age_s(_newest_star_ns(filter_, state), now_ns),
        state=state,
    )


def _newest_star_ns(filter_: ShipFilter, state: FilterState) -> int | None:
    """Stamp of the last star measurement used; None where there was none."""
    stars = (used_ns for source, used_ns in state.used_ns.items() if filter_.devices[source].is_star)
    return max(stars, default=None)


def _age_s(since_ns: int | None, time_ns: int) -> float:
    """Time since a moment; NaN where there was none."""
    return float("nan") if since_ns is None else (time_ns - since_ns) / SECOND_NS

"""Published attitude without INS samples, from the newest star measurement alone or INVALID."""

from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.config import GEODETIC, GRAVITY
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.ins.corrected_ins import newest_star_ns
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Measurement, Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import exp_rotation, left_jacobian
from ship_stars.samples.attitude_samples import AttitudeEstimate, AttitudeMeasurement, Horizon, SolvedAttitude
from ship_stars.samples.readings import InertialAttitude
from ship_stars.sky.sky_model import SkyModel
from ship_stars.sky.tracker_attitude import to_horizon_attitude
from ship_stars.solution.exposure import StarExposure, visible_stars
from ship_stars.solution.solution import SolutionStatus, solve_stars


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
        by_deflection, deflection = (
            filter_.vertical.at(measurement.time_ns).deflection_jacobian,
            model.state_indices("gravity.deflection"),
        )
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
        rate_d=np.full(3, np.nan),
        status=Status.DEGRADED,
        horizon=Horizon.GRAVITY if to_gravity else Horizon.GEODETIC,
        sources=(measurement.source,),
        star_age_s=0.0,
        state=state,
        text="no INS data, stars alone",
    )


def invalid_estimate(filter_: ShipFilter, state: FilterState, now_ns: int, text: str = "") -> AttitudeEstimate:
    """Return an INVALID estimate, for lack of INS and star data or for the reason in the text."""
    return AttitudeEstimate(
        time_ns=now_ns,
        rotation_nd=np.full((3, 3), np.nan),
        covariance_by_source_n=np.full((len(filter_.model.sources), 3, 3), np.nan),
        covariance_n=np.full((3, 3), np.nan),
        covariance_without_separation_n=np.full((3, 3), np.nan),
        rate_d=np.full(3, np.nan),
        status=Status.INVALID,
        horizon=Horizon.GRAVITY,
        sources=(),
        star_age_s=_age_s(newest_star_ns(filter_, state), now_ns),
        state=state,
        text=text,
    )


def _age_s(since_ns: int | None, time_ns: int) -> float:
    """Return the time since a stamp, s; NaN for None."""
    return float("nan") if since_ns is None else (time_ns - since_ns) / SECOND_NS

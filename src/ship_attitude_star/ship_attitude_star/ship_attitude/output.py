"""From the filter's state and the newest data to the published attitude and its covariance by source."""

import math

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeEstimate, AttitudeMeasurement, Horizon
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import FilterState, ShipFilter
from ship_attitude_star.ship_attitude.model import SOURCE_INS_NOISE, SOURCE_INTERPOLATION
from ship_estimation.outcome import Status
from ship_estimation.state import lasting
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian

_SECOND_NS = 1_000_000_000


class CorrectedIns:
    """INS attitudes corrected by one filter state; made once per state, used at the INS's rate.

    Only the INS's slow error and its time offset enter, so only those rows of the covariance are carried.

    Args:
        filter_: the filter and its model.
        state: its state after the last measurement.
    """

    def __init__(self, filter_: ShipFilter, state: FilterState) -> None:
        self.state = state
        self._model = filter_.model
        rows = np.r_[self._model.rows("ins.attitude"), self._model.rows("ins.time_offset")]
        self._attitude_rows = rows[:3]
        self._mean = state.mean[rows]
        self._parts = state.parts[:, rows[:, None], rows]
        self._drift_index = self._model.sources.index(self._model.blocks["ins.attitude"].source)
        self._white_index = self._model.sources.index(SOURCE_INS_NOISE)
        self._interpolation_index = self._model.sources.index(SOURCE_INTERPOLATION)
        self._lasting = lasting(self._mean[:3], self._model.blocks["ins.attitude"].sigma)
        self._newest_star_ns = _newest_star_ns(filter_, state)
        self._white_variance = self._model.blocks["ins.noise"].sigma ** 2

    @property
    def time_offset_s(self) -> float:
        """Estimated tau, on top of the configured constant, s."""
        return float(self._mean[3])

    def attitude(self, time_ns: int, ins: InterpolatedAttitude) -> tuple[FloatArray, FloatArray]:
        """Attitude and its covariance parts, horizon frame, rad², shapes (3, 3), (n_sources, 3, 3).

        Args:
            time_ns: the moment.
            ins: the INS's attitude of that moment (its samples moved by tau).
        """
        since_ns = self.state.time_ns if self.state.time_ns is not None else time_ns
        decay, noise = self._model.transition(max(time_ns - since_ns, 0) * 1e-9)
        decay = decay[self._attitude_rows]
        error = np.where(self._lasting, self._mean[:3], decay * self._mean[:3])
        correction = exp_rotation(error)
        # At the INS's rate; of single matrices the method takes half the time of the operator.
        rotation_nd = correction.dot(ins.rotation_nd)

        # Errors now, from errors at the state's moment.
        jacobian = np.empty((3, 4))
        jacobian[:, :3] = left_jacobian(error)
        jacobian[:, 3] = -rotation_nd.dot(ins.rate_d)
        propagated = jacobian.copy()
        propagated[:, :3] *= decay
        parts = propagated @ self._parts @ propagated.T
        drift = jacobian[:, :3] * np.sqrt(noise[self._attitude_rows])
        parts[self._drift_index] += drift.dot(drift.T)
        white = correction * np.sqrt(self._white_variance * ins.noise_gain)
        parts[self._white_index] += white.dot(white.T)
        parts[self._interpolation_index] += rotation_nd.dot(ins.error_covariance_d).dot(rotation_nd.T)
        return rotation_nd, parts

    def estimate(self, time_ns: int, ins: InterpolatedAttitude, config: ShipAttitudeConfig) -> AttitudeEstimate:
        """The attitude at the stamp of an INS sample, with its status."""
        rotation_nd, parts = self.attitude(time_ns, ins)
        recent_ns = time_ns - config.coasting_after_s * _SECOND_NS
        used = sorted(source for source, used_ns in self.state.used_ns.items() if used_ns >= recent_ns)
        star_age_s = _age_s(self._newest_star_ns, time_ns)
        if math.isnan(star_age_s) or self.state.jumped:
            status = Status.DEGRADED
        elif star_age_s <= config.coasting_after_s:
            status = Status.VALID
        else:
            status = Status.COASTING
        # NaN compares false: before the first star the horizon is the INS's own.
        horizon = Horizon.GEODETIC if star_age_s <= config.ins.tilt_time_s else Horizon.GRAVITY
        return AttitudeEstimate(
            time_ns, rotation_nd, parts, ins.rate_d, status, horizon, ("ins", *used), star_age_s
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
    return AttitudeEstimate(
        time_ns=measurement.time_ns,
        rotation_nd=rotation_nd,
        covariance_parts_n=parts,
        rate_d=np.full(3, np.nan),
        status=Status.DEGRADED,
        horizon=Horizon.GEODETIC,
        sources=(measurement.source,),
        star_age_s=0.0,
    )


def no_estimate(filter_: ShipFilter, state: FilterState, now_ns: int) -> AttitudeEstimate:
    """Neither INS nor star: no attitude is claimed."""
    return AttitudeEstimate(
        time_ns=now_ns,
        rotation_nd=np.full((3, 3), np.nan),
        covariance_parts_n=np.full((len(filter_.model.sources), 3, 3), np.nan),
        rate_d=np.full(3, np.nan),
        status=Status.INVALID,
        horizon=Horizon.GRAVITY,
        sources=(),
        star_age_s=_age_s(_newest_star_ns(filter_, state), now_ns),
    )


def _newest_star_ns(filter_: ShipFilter, state: FilterState) -> int | None:
    """Stamp of the last star measurement used; None where there was none."""
    stars = (used_ns for source, used_ns in state.used_ns.items() if filter_.devices[source].is_star)
    return max(stars, default=None)


def _age_s(since_ns: int | None, time_ns: int) -> float:
    """Time since a moment; NaN where there was none."""
    return float("nan") if since_ns is None else (time_ns - since_ns) / _SECOND_NS

"""Observability of the filter states, and the recommended turn that makes more of them observable.

At constant heading only sums of INS error and installation errors are observable. An unobserved state keeps its prior
standard deviation. An unobserved combination keeps its prior standard deviation even if other combinations of its
states are known well. Standard deviations and combinations are computed from the filter covariance.

A turn rotates the installation errors of the sensors relative to the INS error, and so makes both observable. For the
recommendation, the covariance is predicted for 15 min of measurements as accurate and as frequent as the last
measurements, with and without a turn. Errors of refraction, UT1 and position, which all stars share, are not observable
by a turn. These errors are omitted in both cases. The prediction does not change the filter state.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import RecentSource
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.prediction import predict_attitude
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.kalman.unobservable_combinations import unobservable_combinations
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_geometry.tracks.attitude_track import InterpolatedAttitude

_AXES = {
    "installation": ("forward", "up", "right"),
    "attitude": ("north", "up", "east"),
    "deflection": ("xi", "eta"),
    "time_offset": ("time_offset",),
}

_TURNS_DEG = (45.0, 90.0, 180.0)

_DURATION_S = 900.0
"""Predicted time on one heading, s."""

_MISSED_PERIODS = 3.0
"""Timeout of a source, in its measurement periods."""

_RATE_DEG_PER_S, _PIECE_DEG = 1.0, 15.0
"""Rate of turn, °/s, and size of the steps in which a turn is predicted, °. The INS error varies during the turn."""

_RECOMMENDED_RATIO = 0.9
"""A turn is recommended if the standard deviation after the turn, divided by that on course, is at most this ratio."""


class Observability(NamedTuple):
    """Observability of the states.

    Attributes:
        sigma_ratios: ratio of the current to the prior standard deviation, by state name; 1 if nothing was observed.
        unobservable_combinations: unobservable combinations of states, as texts with the state names.
    """

    sigma_ratios: dict[str, float]
    unobservable_combinations: tuple[str, ...]


def observability_of(filter_: ShipFilter, config: ShipAttitudeConfig, state: FilterState) -> Observability:
    """Return the observability of INS attitude, deflection, installations and clocks for a filter state.

    States with a prior standard deviation of 0 are omitted. Installations and clocks come first in the combinations.
    """
    names, rows, sigmas = [], [], []
    for block, sigma in _prior_sigmas(filter_, config).items():
        prefix, _, kind = block.rpartition(".")
        for axis, row, before in zip(_AXES[kind], filter_.model.state_indices(block).tolist(), sigma, strict=True):
            if before > 0.0:
                names.append(f"{prefix}.{axis}")
                rows.append(row)
                sigmas.append(float(before))
    before = np.array(sigmas)
    covariance = state.covariance[np.ix_(rows, rows)]
    sigma_ratios = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) / before
    by_name = dict(zip(names, sigma_ratios.tolist(), strict=True))
    return Observability(by_name, unobservable_combinations(covariance, before, names))


def _prior_sigmas(filter_: ShipFilter, config: ShipAttitudeConfig) -> dict[str, FloatArray]:
    """Return the prior standard deviations by block name, the devices first."""
    blocks = filter_.model.blocks
    own = [name for name in blocks if name.endswith((".installation", ".time_offset")) and not name.startswith("ins.")]
    found = {name: blocks[name].sigma for name in (*own, "ins.time_offset")}
    if config.models_deflection:
        found["gravity.deflection"] = np.full(2, config.gravity.unknown_sigma_arcsec * ARCSEC)
    return found | {"ins.attitude": blocks["ins.attitude"].sigma}


class RecommendedTurn(NamedTuple):
    """A recommended turn.

    Attributes:
        turn_deg: change of heading to starboard, °.
        quantity: "heading" or "tilt".
        sigma_now: present standard deviation of the quantity, rad.
        sigma_on_course: predicted standard deviation after 15 min on this course, rad.
        sigma_after_turn: predicted standard deviation after the turn and 15 min on the new heading, rad.
    """

    turn_deg: float
    quantity: str
    sigma_now: float
    sigma_on_course: float
    sigma_after_turn: float


def recommended_manoeuvre(
    filter_: ShipFilter, state: FilterState, rotation_nd: FloatArray, recent_sources: Mapping[str, RecentSource]
) -> RecommendedTurn | None:
    """Return the turn that improves the attitude most; None if no turn is worthwhile or no source measures.

    Args:
        filter_: filter and model.
        state: filter state after a measurement.
        rotation_nd: attitude of the ship, shape (3, 3).
        recent_sources: recent measurements by source.
    """
    if state.time_ns is None:
        return None
    active = {
        source: recent
        for source, recent in recent_sources.items()
        if source not in state.excluded and _is_active(recent, state.time_ns)
    }
    if not active:
        return None
    prediction, now = _ManoeuvrePrediction(filter_, state, rotation_nd, active), _sigmas(filter_, state.covariance)
    on_course = prediction.sigmas_after_turn(0.0)
    hints = []
    for turn_deg in _TURNS_DEG:
        after = prediction.sigmas_after_turn(turn_deg)
        hints += [RecommendedTurn(turn_deg, name, now[name], on_course[name], after[name]) for name in after]
    best = min(hints, key=lambda hint: hint.sigma_after_turn / hint.sigma_on_course)
    # NaN is not recommended.
    return best if best.sigma_after_turn <= _RECOMMENDED_RATIO * best.sigma_on_course else None


def _is_active(recent: RecentSource, time_ns: int) -> bool:
    """True if the source still measures; False before its second measurement."""
    since_s = (time_ns - recent.measurement.time_ns) / SECOND_NS
    return recent.period_s < math.inf and since_s <= _MISSED_PERIODS * recent.period_s


def _sigmas(filter_: ShipFilter, covariance: FloatArray) -> dict[str, float]:
    """Return the standard deviations of heading and tilt, rad."""
    rows = filter_.model.state_indices("ins.attitude")
    north, up, east = covariance[rows, rows].tolist()
    return {"heading": float(np.sqrt(up)), "tilt": float(np.sqrt(0.5 * (north + east)))}


class _ConstantVertical(NamedTuple):
    here: LocalVertical

    def at(self, time_ns: int) -> LocalVertical:
        return self.here


class _CovarianceTransition(NamedTuple):
    """Transition of a covariance P over a time with measurements.

    The result is transition P (1 + information P)^-1 transitionᵀ + noise. Successive transitions combine to one
    transition (S. Särkkä and Á. F. García-Fernández, Temporal parallelization of Bayesian smoothers, 2021, lemma 8).

    Attributes:
        transition: transition of the states, shape (n, n).
        noise: covariance added to the states, shape (n, n).
        information: information about the states at the start, shape (n, n).
    """

    transition: FloatArray
    noise: FloatArray
    information: FloatArray

    def followed_by(self, later: "_CovarianceTransition") -> "_CovarianceTransition":
        """Return the transition over this time and a later time."""
        one = np.eye(len(self.transition))
        through = np.linalg.solve((one + self.noise @ later.information).T, later.transition.T).T
        return _CovarianceTransition(
            through @ self.transition,
            through @ self.noise @ later.transition.T + later.noise,
            self.transition.T
            @ np.linalg.solve(one + later.information @ self.noise, later.information @ self.transition)
            + self.information,
        )

    def propagate(self, covariance: FloatArray) -> FloatArray:
        """Return a covariance propagated over the time, shape (n, n)."""
        one = np.eye(len(self.transition))
        propagated: FloatArray = (
            self.transition @ covariance @ np.linalg.solve(one + self.information @ covariance, self.transition.T)
        )
        return propagated + self.noise


class _ManoeuvrePrediction:
    """Prediction of the filter covariance with and without a turn."""

    def __init__(
        self,
        filter_: ShipFilter,
        state: FilterState,
        rotation_nd: FloatArray,
        recent_sources: Mapping[str, RecentSource],
    ) -> None:
        self._filter, self._state, self._rotation_nd, self._recent_sources = filter_, state, rotation_nd, recent_sources

    def sigmas_after_turn(self, turn_deg: float) -> dict[str, float]:
        """Return the standard deviations 15 min after a turn of ``turn_deg``, which may be 0."""
        total = None
        pieces = round(turn_deg / _PIECE_DEG)
        for number in range(pieces):
            piece = self._on_heading((number + 0.5) * _PIECE_DEG, _PIECE_DEG / _RATE_DEG_PER_S)
            total = piece if total is None else total.followed_by(piece)
        on_heading = self._on_heading(turn_deg, _DURATION_S)
        total = on_heading if total is None else total.followed_by(on_heading)
        return _sigmas(self._filter, total.propagate(self._state.covariance))

    def _on_heading(self, turned_deg: float, length_s: float) -> _CovarianceTransition:
        """Return the transition over a time on a heading.

        One step, at most as long as the shortest measurement period, is doubled until it covers the time.
        """
        model, devices, recent_sources = self._filter.model, self._filter.devices, self._recent_sources
        shortest_s = min(source.period_s for source in recent_sources.values())
        doublings = max(math.ceil(math.log2(length_s / shortest_s)), 0)
        step_s = length_s / 2.0**doublings
        turned_nd = exp_rotation(np.deg2rad([0.0, -turned_deg, 0.0])) @ self._rotation_nd
        ins, white = InterpolatedAttitude(turned_nd, np.zeros(3), 0.0), model.blocks["ins.noise"].sigma[0]
        jacobian = np.vstack(
            [
                _root(devices[source].information(recent.measurement), white, step_s / recent.period_s)
                @ predict_attitude(devices[source], model, self._state.mean, ins).jacobian_v
                for source, recent in recent_sources.items()
            ]
        )
        transition, noise = _step(self._filter, self._state, step_s)
        weighed = np.linalg.solve(jacobian @ noise @ jacobian.T + np.eye(len(jacobian)), jacobian)
        information = jacobian.T @ weighed
        transition_over_time = _CovarianceTransition(
            transition - noise @ information @ transition,
            noise - noise @ information @ noise,
            transition.T @ information @ transition,
        )
        for _ in range(doublings):
            transition_over_time = transition_over_time.followed_by(transition_over_time)
        return transition_over_time


def _step(filter_: ShipFilter, state: FilterState, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition matrix of the states over a time, and the added covariance, shape (n, n) each."""
    model = filter_.model
    decay, variance = model.transition(step_s)
    transition, noise = np.diag(decay), np.diag(variance)
    # The white INS noise is part of each measurement.
    white = model.state_indices("ins.noise")
    noise[white, white] = 0.0
    for source, steady in state.common_n.items():
        common = model.slices[f"{source}.common"]
        noise[common, common] += (1.0 - decay[common.start] ** 2) * steady
    if model.ins_process is not None and state.vertical is not None:
        assert state.time_ns is not None
        end_ns = state.time_ns + round(step_s * SECOND_NS)
        propagation = model.ins_process.propagation(
            state.time_ns, state.vertical, [end_ns], _ConstantVertical(state.vertical)
        )
        rows = np.ix_(model.process_indices, model.process_indices)
        transition[rows] = propagation.transition[0]
        noise[rows] = propagation.ins_noise[0] + propagation.deflection_noise[0]
    return transition, noise


def _root(information: FloatArray, ins_white: float, count: float) -> FloatArray:
    """Return a root, shape (3, 3); rootᵀ root is the information of ``count`` measurements with INS noise (rad)."""
    if ins_white > 0.0:
        information = information - information @ np.linalg.solve(information + np.eye(3) / ins_white**2, information)
    values, vectors = np.linalg.eigh(count * information)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return root

"""What a turn of the ship would bring: the accuracy of the attitude after it, beside that on this course.

The covariance is carried on as the filter would carry it: a quarter of an hour of measurements as good and as frequent
as the last ones, with the ship as she lies now, or turned. A turn moves the installation errors of sensors against the
INS's error, and so tells them apart. Errors that all stars share, of refraction, UT1 and position, no turn tells: they
are left out on both sides. Nothing is measured for the hint, and nothing is learnt from it.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ship_attitude_star.measurements.baseline import BaselineMeasurement
from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.ship_attitude.comparison import predict_attitude
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.state import FilterState
from ship_attitude_star.stars.exposure import StarExposure
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation.outcome import Measurement
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_geometry.time_scales import SECOND_NS

_TURNS_DEG = (45.0, 90.0, 180.0)
_LENGTH_S = 900.0
"""So long the ship lies turned, or as she does."""

_MISSED = 3.0
"""Periods after which a source that has said nothing counts as gone."""

_RATE_DEG_PER_S, _PIECE_DEG = 1.0, 15.0
"""How fast she turns, in pieces: the INS's error moves meanwhile, and blurs what the turn tells."""

_WORTH_TELLING = 0.9
"""A turn that leaves more than this share of the sigma is not told."""


class RecentSource(NamedTuple):
    """What a source measures lately.

    Attributes:
        measurement: the last one that was used.
        period_s: time between two that were used; infinite after the first.
    """

    measurement: Measurement
    period_s: float

    def goes_on_at(self, time_ns: int) -> bool:
        """Whether the source still measures; how often it does is known from its second measurement on."""
        since_s = (time_ns - self.measurement.time_ns) / SECOND_NS
        return self.period_s < math.inf and since_s <= _MISSED * self.period_s


class TurnHint(NamedTuple):
    """A turn that is worth it.

    Attributes:
        turn_deg: by how much.
        quantity: "heading" or "tilt".
        now: sigma, rad.
        on_course: the same after a quarter of an hour on this course.
        after: the same after a quarter of an hour in which the ship lies turned.
    """

    turn_deg: float
    quantity: str
    now: float
    on_course: float
    after: float


def worthwhile_turn(
    filter_: ShipFilter, state: FilterState, rotation_nd: FloatArray, lately: Mapping[str, RecentSource]
) -> TurnHint | None:
    """The turn that brings most; None where none is worth telling, or nothing is measured.

    Args:
        filter_: the filter.
        state: of it, after a measurement.
        rotation_nd: attitude of the ship, shape (3, 3).
        lately: by source, what it measures.
    """
    if state.time_ns is None:
        return None
    goes_on = {
        source: seen
        for source, seen in lately.items()
        if source not in state.excluded and seen.goes_on_at(state.time_ns)
    }
    if not goes_on:
        return None
    voyage, now = _Voyage(filter_, state, rotation_nd, goes_on), _sigmas(filter_, state.covariance)
    on_course = voyage.after_turn(0.0)
    hints = []
    for turn_deg in _TURNS_DEG:
        after = voyage.after_turn(turn_deg)
        hints += [TurnHint(turn_deg, name, now[name], on_course[name], after[name]) for name in after]
    best = min(hints, key=lambda hint: hint.after / hint.on_course)
    # Written so that NaN is not told.
    return best if best.after <= _WORTH_TELLING * best.on_course else None


def _sigmas(filter_: ShipFilter, covariance: FloatArray) -> dict[str, float]:
    """Sigma of heading and tilt, rad."""
    rows = filter_.model.rows("ins.attitude")
    north, up, east = covariance[rows, rows].tolist()
    return {"heading": float(np.sqrt(up)), "tilt": float(np.sqrt(0.5 * (north + east)))}


class _Still:
    """The vertical as it is now, for as long as it is asked."""

    def __init__(self, here: VerticalHere) -> None:
        self._here = here

    def at(self, time_ns: int) -> VerticalHere:
        return self._here


class _Stretch(NamedTuple):
    """What a stretch of time with measurements makes of a covariance P: left P (1 + known P)^-1 leftᵀ + added.

    Such stretches put together are one again (S. Särkkä and Á. F. García-Fernández, Temporal parallelization of
    Bayesian smoothers, 2021, lemma 8).

    Attributes:
        left: what it leaves of the states, shape (n, n).
        added: what it adds to their covariance, shape (n, n).
        known: what it tells of the states before it, shape (n, n).
    """

    left: FloatArray
    added: FloatArray
    known: FloatArray

    def then(self, later: "_Stretch") -> "_Stretch":
        """This stretch and one after it."""
        one = np.eye(len(self.left))
        through = np.linalg.solve((one + self.added @ later.known).T, later.left.T).T
        return _Stretch(
            through @ self.left,
            through @ self.added @ later.left.T + later.added,
            self.left.T @ np.linalg.solve(one + later.known @ self.added, later.known @ self.left) + self.known,
        )

    def after(self, covariance: FloatArray) -> FloatArray:
        """The covariance after it, shape (n, n)."""
        one = np.eye(len(self.left))
        after: FloatArray = self.left @ covariance @ np.linalg.solve(one + self.known @ covariance, self.left.T)
        return after + self.added


class _Voyage:
    """The ship as she is, and how her covariance goes on."""

    def __init__(
        self, filter_: ShipFilter, state: FilterState, rotation_nd: FloatArray, lately: Mapping[str, RecentSource]
    ) -> None:
        self._filter, self._state, self._rotation_nd, self._lately = filter_, state, rotation_nd, lately

    def after_turn(self, turn_deg: float) -> dict[str, float]:
        """Sigmas a quarter of an hour after the end of a turn, which may be none."""
        way = None
        pieces = round(turn_deg / _PIECE_DEG)
        for number in range(pieces):
            piece = self._lying((number + 0.5) * _PIECE_DEG, _PIECE_DEG / _RATE_DEG_PER_S)
            way = piece if way is None else way.then(piece)
        lying = self._lying(turn_deg, _LENGTH_S)
        way = lying if way is None else way.then(lying)
        return _sigmas(self._filter, way.after(self._state.covariance))

    def _lying(self, turned_deg: float, length_s: float) -> _Stretch:
        """A time in which the ship lies turned by so much: the shortest between two measurements, doubled again."""
        model, lately = self._filter.model, self._lately
        shortest_s = min(source.period_s for source in lately.values())
        doublings = max(math.ceil(math.log2(length_s / shortest_s)), 0)
        step_s = length_s / 2.0**doublings
        turned_nd = exp_rotation(np.deg2rad([0.0, -turned_deg, 0.0])) @ self._rotation_nd
        ins, white = InterpolatedAttitude(turned_nd, np.zeros(3), 0.0), model.blocks["ins.noise"].sigma[0]
        jacobian = np.vstack(
            [
                _root(_information(seen.measurement), white, step_s / seen.period_s)
                @ predict_attitude(self._filter.devices[source], model, self._state.mean, ins).jacobian_v
                for source, seen in lately.items()
            ]
        )
        transition, fresh = _step(self._filter, self._state, step_s)
        weighed = np.linalg.solve(jacobian @ fresh @ jacobian.T + np.eye(len(jacobian)), jacobian)
        told = jacobian.T @ weighed
        stretch = _Stretch(
            transition - fresh @ told @ transition, fresh - fresh @ told @ fresh, transition.T @ told @ transition
        )
        for _ in range(doublings):
            stretch = stretch.then(stretch)
        return stretch


def _step(filter_: ShipFilter, state: FilterState, step_s: float) -> tuple[FloatArray, FloatArray]:
    """What a time makes of the states, shape (n, n), and the covariance of what comes new, shape (n, n)."""
    model = filter_.model
    decay, fresh = model.transition(step_s)
    transition, noise = np.diag(decay), np.diag(fresh)
    # The INS's own noise is counted with each measurement.
    white = model.rows("ins.noise")
    noise[white, white] = 0.0
    for source, steady in state.common_n.items():
        common = model.slices[f"{source}.common"]
        noise[common, common] += (1.0 - decay[common.start] ** 2) * steady
    if model.ins_process is not None and state.vertical is not None:
        assert state.time_ns is not None
        end_ns = state.time_ns + round(step_s * SECOND_NS)
        carried = model.ins_process.carried(state.time_ns, state.vertical, [end_ns], _Still(state.vertical))
        rows = np.ix_(model.process_rows, model.process_rows)
        transition[rows], noise[rows] = carried.transition[0], carried.ins_noise[0] + carried.deflection_noise[0]
    return transition, noise


def _information(measurement: Measurement) -> FloatArray:
    """What a measurement tells of a turn of its device about (forward, up, right), 1/rad², shape (3, 3)."""
    if isinstance(measurement, (AttitudeMeasurement, InertialAttitude)):
        noise_v = measurement.noise_v if isinstance(measurement, AttitudeMeasurement) else measurement.noise_s
        # A variance of zero tells nothing here: a hint must not fail.
        inverse: FloatArray = np.asarray(np.linalg.pinv(noise_v, hermitian=True), dtype=np.float64)
        return _symmetric(inverse)
    if isinstance(measurement, BaselineMeasurement):
        variance = float(np.trace(measurement.noise_n)) / 3.0 / measurement.length_m**2
        return np.diag([0.0, 1.0, 1.0]) / variance
    assert isinstance(measurement, StarExposure)
    seen, weight = measurement.directions_s, measurement.sigma**-2.0
    information: FloatArray = np.einsum("k,kij->ij", weight, np.eye(3) - seen[:, :, None] * seen[:, None, :])
    return _symmetric(information)


def _symmetric(matrix: FloatArray) -> FloatArray:
    symmetric: FloatArray = 0.5 * (matrix + matrix.T)
    return symmetric


def _root(information: FloatArray, ins_white: float, count: float) -> FloatArray:
    """A root of what so many measurements tell, each beside the INS's own noise (rad): rootᵀ root, shape (3, 3)."""
    if ins_white > 0.0:
        information = information - information @ np.linalg.solve(
            information + np.eye(3) / ins_white**2, information
        )
    values, vectors = np.linalg.eigh(count * information)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return root

"""Cost of the ship's filter relative to GTSAM's smoothers with the same measurements, and to a step of filterpy.

The peers receive each measurement linearised and weighted by the filter. The peers have no error budget by source. The
time of a peer is the time for adding a measurement and computing the state and its covariance afterwards. GTSAM is
installed by ``make setup-all`` from Python 3.11 on, filterpy by ``pip install filterpy``; there are no rows of a peer
that is not installed.
"""

import importlib
import time
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from bench_filter import run_of, ship_steps_us
from bench_rows import Row, alternate, median_ratio, median_us
from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.run import SimulatedRun
from ship_testing.trials.main_filter_only import ShipFilterWithoutSubfilters
from ship_testing.trials.monte_carlo import core_for, feed_attitude

DURATION_S, ROUNDS = 60.0, 3
LAG_S = 2.0
MAX_SMOOTHER_RATIO = 0.1
MAX_DIFFERENCE_ARCSEC = 0.05
"""Maximum difference between the INS errors estimated by filter and peer after each measurement."""

_INS_ERROR = slice(0, 3)
"""Place of the INS error in the states of the filter and of a smoother at each time."""


class Measured(NamedTuple):
    """Measurement with the states before and after it, as in the filter.

    Attributes:
        time_s: time since the start of the run.
        linear: measurement, linearised at the predicted state.
        at_mean: predicted state.
        mean: state after the measurement.
    """

    time_s: float
    linear: LinearMeasurement
    at_mean: FloatArray
    mean: FloatArray


def peers_cost() -> list[Row]:
    """Measure the ship's filter and each installed peer, alternately."""
    run = run_of("paper", DURATION_S)
    rows: list[Row] = []
    if (gtsam := _import_if_installed("gtsam")) is not None:
        rows += _smoother_rows(gtsam, run)
    if (filterpy := _import_if_installed("filterpy.kalman")) is not None:
        rows += _filterpy_rows(filterpy, run)
    return rows


def _import_if_installed(module: str) -> ModuleType | None:
    try:
        return importlib.import_module(module)
    except Exception as problem:
        # A third-party library that does not fit this machine may raise any exception.
        print(f"bench: peers: no rows of {module.partition('.')[0]}, which cannot be imported: {problem}")
        return None


def _smoother_rows(gtsam: ModuleType, run: SimulatedRun) -> list[Row]:
    model, measured = _used_measurements(run)
    own, lag, whole = alternate(
        ROUNDS,
        lambda: (float(np.mean(ship_steps_us(run, ShipFilterWithoutSubfilters))), 0.0),
        lambda: _run_smoother(gtsam, model, measured, LAG_S),
        lambda: _run_smoother(gtsam, model, measured, None),
    )
    own_us, lag_us, whole_us = ([cost_us for cost_us, _ in figures] for figures in (own, lag, whole))
    of_lag = f"GTSAM's fixed lag of {LAG_S:g} s"
    of_whole = f"GTSAM's iSAM2 over {DURATION_S:g} s"
    return [
        Row(f"step of the ship's filter over {len(measured)} measurements: mean", float(np.median(own_us)), "us"),
        Row(f"the same measurements by {of_lag}: mean", float(np.median(lag_us)), "us"),
        Row(f"the same measurements by {of_whole}: mean", float(np.median(whole_us)), "us"),
        Row(f"ratio: ship's filter / {of_lag}", median_ratio(own_us, lag_us), "x", MAX_SMOOTHER_RATIO, of_lag),
        Row(f"ratio: ship's filter / {of_whole}", median_ratio(own_us, whole_us), "x", None, of_whole),
        Row(f"difference of the estimates by {of_lag}: greatest", lag[0][1], "arcsec", MAX_DIFFERENCE_ARCSEC),
        Row(f"difference of the estimates by {of_whole}: greatest", whole[0][1], "arcsec", MAX_DIFFERENCE_ARCSEC),
    ]


def _used_measurements(run: SimulatedRun) -> tuple[ShipStateModel, list[Measured]]:
    """Return the model of the ship's filter and all measurements that the filter uses in a run."""
    core = core_for(run.scenario)
    core.filter = ShipFilterWithoutSubfilters(core.config)
    core.reset()
    step, linearised = core.filter.step, core.filter.linearisation.linearise
    last: list[Any] = []
    measured: list[Measured] = []

    def record_linearisation(measurement: Any, mean: FloatArray, *others: Any) -> Any:
        last[:] = mean.copy(), linearised(measurement, mean, *others)
        return last[1]

    def record_step(state: Any, measurement: Any, *others: Any) -> Any:
        result = step(state, measurement, *others)
        if result is not None and result[1].accepted:
            time_s = float(measurement.time_ns - run.ins.time_ns[0]) * 1e-9
            measured.append(Measured(time_s, last[1].compared.linear, last[0], result[0].means[0]))
        return result

    core.filter.step, core.filter.linearisation.linearise = record_step, record_linearisation  # type: ignore[method-assign]
    feed_attitude(core, run)
    return core.filter.model, measured


def _run_smoother(
    gtsam: ModuleType, model: ShipStateModel, measured: list[Measured], lag_s: float | None
) -> tuple[float, float]:
    """Return the mean time per measurement, us, and the largest difference from the INS error of the filter, arcsec."""
    smoother = _Smoother(gtsam, model, lag_s)
    spent_s, means = 0.0, []
    for one in measured:
        begin_s = time.perf_counter()
        mean, _ = smoother.add(one)
        spent_s += time.perf_counter() - begin_s
        means.append(mean[_INS_ERROR])
    difference = np.abs(np.array(means) - [one.mean[_INS_ERROR] for one in measured]).max()
    return spent_s / len(measured) * 1e6, float(difference) / ARCSEC


class _Smoother:
    """Model of the filter as a factor graph, with a variable for each time and a variable for the constant states.

    States with a known value of zero are not included.

    Args:
        gtsam: module of the library.
        model: model of the filter.
        lag_s: age beyond which times are marginalised, s; None to keep all times.
    """

    _CONSTANT = 0
    """Key of the constant states; times are numbered from 1."""

    def __init__(self, gtsam: ModuleType, model: ShipStateModel, lag_s: float | None) -> None:
        parameters = gtsam.ISAM2Params()
        # The factors are linear.
        parameters.enableRelinearization = False
        self._lags = lag_s is not None
        self._smoother = gtsam.IncrementalFixedLagSmoother(lag_s, parameters) if lag_s else gtsam.ISAM2(parameters)
        self._gtsam, self._model = gtsam, model
        self._variance = model.initial_covariance_by_source().sum(axis=0).diagonal()
        decay, noise = model.transition(1.0)
        constant = (decay == 1.0) & (noise == 0.0)
        self._moving = np.flatnonzero(~constant & (self._variance > 0.0))
        self._constant = np.flatnonzero(constant & (self._variance > 0.0))
        self._moment, self._time_s = 0, 0.0

    def add(self, measured: Measured) -> tuple[FloatArray, FloatArray]:
        """Add a measurement; return the time-dependent states at its time, and their covariance."""
        graph, values = self._gtsam.NonlinearFactorGraph(), self._gtsam.Values()
        if self._moment == 0:
            for key, rows in ((self._CONSTANT, self._constant), (1, self._moving)):
                values.insert(key, np.zeros(len(rows)))
                graph.add(self._factor(np.zeros(len(rows)), {key: np.diag(self._variance[rows] ** -0.5)}))
            self._moment = 1
        elif measured.time_s != self._time_s:
            decay, noise = self._model.transition(measured.time_s - self._time_s)
            decay, weight = decay[self._moving], noise[self._moving] ** -0.5
            before, self._moment = self._moment, self._moment + 1
            values.insert(self._moment, np.zeros(len(weight)))
            moves = {before: np.diag(-weight * decay), self._moment: np.diag(weight)}
            graph.add(self._factor(np.zeros(len(weight)), moves))
        self._time_s = measured.time_s
        linear = measured.linear
        weight = np.linalg.inv(np.linalg.cholesky(linear.noise))
        by_state = weight @ linear.jacobian
        found = weight @ linear.residual + by_state @ measured.at_mean
        states = {self._moment: by_state[:, self._moving], self._CONSTANT: by_state[:, self._constant]}
        graph.add(self._factor(found, states))
        return self._update(graph, values)

    def _factor(self, found: FloatArray, by_state: dict[int, FloatArray]) -> Any:
        """Return the factor of ``found`` = sum of ``by_state`` times the states, with unit noise."""
        terms = [term for pair in by_state.items() for term in pair]
        noise = self._gtsam.noiseModel.Unit.Create(len(found))
        at_zero = self._gtsam.Values()
        for key, matrix in by_state.items():
            at_zero.insert(key, np.zeros(matrix.shape[1]))
        return self._gtsam.LinearContainerFactor(self._gtsam.JacobianFactor(*terms, found, noise), at_zero)

    def _update(self, graph: Any, values: Any) -> tuple[FloatArray, FloatArray]:
        if self._lags:
            # The constant states have the newest time, so that they are not marginalised.
            self._smoother.update(graph, values, {self._CONSTANT: self._time_s, self._moment: self._time_s})
            known = self._smoother.getISAM2()
        else:
            self._smoother.update(graph, values)
            known = self._smoother
        return self._smoother.calculateEstimateVector(self._moment), known.marginalCovariance(self._moment)


def _filterpy_rows(filterpy: ModuleType, run: SimulatedRun) -> list[Row]:
    """Compare the filter's step with filterpy's prediction and update, for the same number of states and components."""
    model, measured = _used_measurements(run)
    linear = measured[-1].linear
    peer = filterpy.KalmanFilter(dim_x=model.size, dim_z=len(linear.residual))
    decay, noise = model.transition(measured[-1].time_s - measured[-3].time_s)
    peer.F, peer.Q, peer.H, peer.R = np.diag(decay), np.diag(noise), linear.jacobian, linear.noise

    def step() -> None:
        peer.P = model.initial_covariance_by_source().sum(axis=0)
        peer.predict()
        peer.update(linear.residual)

    own_us, peer_us = alternate(
        ROUNDS, lambda: float(np.median(ship_steps_us(run, ShipFilterWithoutSubfilters))), lambda: median_us(step)
    )
    what = f"prediction and update of {model.size} states by filterpy"
    return [
        Row(f"{what}: median", float(np.median(peer_us)), "us"),
        Row(f"ratio: step of the ship's filter / {what}", median_ratio(own_us, peer_us), "x", None, "filterpy"),
    ]

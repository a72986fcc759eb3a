"""Peer of the ship's filter: INS and star attitudes of a run in a factor graph, solved by GTSAM's iSAM2.

The peer reads the samples directly and shares no model with the filter: the peer has its own interpolation of the INS,
residuals and noise. The unknowns are the INS's slow error at each exposure, the mounting of each sensor, and the INS's
clock. Python 3.10 has no wheel of GTSAM.
"""

from importlib import import_module
from typing import Any

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario import Scenario, StarSensor
from ship_testing.trials.monte_carlo import FinalError, error_at_end

_CLOCK = 0
"""Key of the INS's clock. The keys of the mountings are next, then the keys of the times."""
_RELINEARIZE_THRESHOLD = 1e-7
"""Change of an unknown, rad or s, above which its factors are relinearised: 0.02 arcseconds."""


def isam2_error(scenario: Scenario, seed: int) -> FinalError:
    """Simulate a run, smooth it, and compare with the truth at the last INS sample."""
    run = simulate(scenario, seed)
    return error_at_end(run, seed, *_Graph(run).solve())


class _Graph:
    """The graph of a run; star sensors give attitudes in the horizon with noise as their only error.

    Args:
        run: run whose samples and configured sigmas are used; its truth is not used.
    """

    def __init__(self, run: SimulatedRun) -> None:
        gtsam = self._gtsam = import_module("gtsam")
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(_RELINEARIZE_THRESHOLD)
        parameters.relinearizeSkip = 20
        self._smoother = gtsam.ISAM2(parameters)
        self._run, self._ins = run, _Ins(run)
        self._mounting_keys = {id_: 1 + number for number, id_ in enumerate(run.stars)}
        self._first_key = 1 + len(run.stars)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Return the attitude at the last INS sample, (3, 3), and its covariance in the horizon, rad², (3, 3)."""
        self._initialise()
        exposures = [
            (int(time_ns), id_, row)
            for id_, samples in self._run.stars.items()
            for row, time_ns in enumerate(samples.time_ns)
            if self._ins.has_samples_around(int(time_ns))
        ]
        before_ns = None
        key = self._first_key
        for key, (time_ns, id_, row) in enumerate(sorted(exposures), start=self._first_key):
            graph, values = self._add_state(key, before_ns, time_ns)
            graph.add(self._sighting(key, time_ns, id_, row))
            self._smoother.update(graph, values)
            before_ns = time_ns
        end_ns, end = int(self._ins.time_ns[-1]), key + 1
        self._smoother.update(*self._add_state(end, before_ns, end_ns))
        for _ in range(3):
            self._smoother.update()
        return self._attitude(end)

    def _initialise(self) -> None:
        """Add the clock and the mountings with their priors."""
        scenario, gtsam = self._run.scenario, self._gtsam
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        known = {_CLOCK: np.array([scenario.ins.time_offset_sigma_s])}
        for id_, key in self._mounting_keys.items():
            known[key] = _mounting_sigma(scenario.star_sensors[id_])
        for key, sigma in known.items():
            values.insert(key, np.zeros(len(sigma)))
            graph.add(self._prior(key, sigma))
        self._smoother.update(graph, values)

    def _prior(self, key: int, sigma: FloatArray) -> Any:
        def error(_: Any, values: Any, jacobians: Any) -> FloatArray:
            if jacobians is not None:
                jacobians[0] = np.eye(len(sigma))
            return values.atVector(key)

        return self._gtsam.CustomFactor(self._gtsam.noiseModel.Diagonal.Sigmas(sigma), [key], error)

    def _add_state(self, key: int, previous_ns: int | None, time_ns: int) -> tuple[Any, Any]:
        """Return factor and initial value of the INS's slow error at a new time, a Gauss–Markov process."""
        gtsam, ins = self._gtsam, self._run.scenario.ins
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        sigma = np.array([ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.tilt_sigma_arcsec]) * ARCSEC
        time_s = np.array([ins.tilt_time_s, ins.heading_time_s, ins.tilt_time_s])
        if previous_ns is None:
            values.insert(key, np.zeros(3))
            graph.add(self._prior(key, sigma))
            return graph, values
        decay = np.exp(-1e-9 * (time_ns - previous_ns) / time_s)
        values.insert(key, decay * self._smoother.calculateEstimateVector(key - 1))

        def error(_: Any, at: Any, jacobians: Any) -> FloatArray:
            if jacobians is not None:
                jacobians[0], jacobians[1] = -np.diag(decay), np.eye(3)
            return at.atVector(key) - decay * at.atVector(key - 1)

        step = gtsam.noiseModel.Diagonal.Sigmas(sigma * np.sqrt(1.0 - decay**2))
        graph.add(gtsam.CustomFactor(step, [key - 1, key], error))
        return graph, values

    def _sighting(self, key: int, time_ns: int, sensor_id: str, row: int) -> Any:
        """Return the factor R_star = exp(a) R_ins(t - tau) R0 exp(m) exp(noise), with the residual in the sensor."""
        sensor, samples = self._run.scenario.star_sensors[sensor_id], self._run.stars[sensor_id]
        mounting = self._mounting_keys[sensor_id]
        nominal_dv = rotation_from_angles(*np.deg2rad([sensor.azimuth_deg, sensor.elevation_deg, sensor.roll_deg]))
        measured_nv = samples.rotation_nv[row]

        def error(_: Any, at: Any, jacobians: Any) -> FloatArray:
            rotation_nd, rate_d = self._ins.attitude_at(time_ns, at.atVector(_CLOCK)[0])
            mounted_dv = nominal_dv @ exp_rotation(at.atVector(mounting))
            expected_nv = exp_rotation(at.atVector(key)) @ rotation_nd @ mounted_dv
            if jacobians is not None:
                jacobians[0], jacobians[1] = -expected_nv.T, -np.eye(3)
                jacobians[2] = (nominal_dv.T @ rate_d)[:, None]
            return log_rotation(expected_nv.T @ measured_nv)

        noise = samples.noise_v + self._ins.white_variance(time_ns) * np.eye(3)
        return self._gtsam.CustomFactor(
            self._gtsam.noiseModel.Gaussian.Covariance(noise), [key, mounting, _CLOCK], error
        )

    def _attitude(self, end: int) -> tuple[FloatArray, FloatArray]:
        found = self._smoother.calculateEstimate()
        rotation_nd, rate_d = self._ins.last_attitude(found.atVector(_CLOCK)[0])
        marginals = self._gtsam.Marginals(self._smoother.getFactorsUnsafe(), found)
        joint = marginals.jointMarginalCovariance([end, _CLOCK])
        covariance = np.block([[joint.at(one, other) for other in (end, _CLOCK)] for one in (end, _CLOCK)])
        by_unknown = np.hstack([np.eye(3), -(rotation_nd @ rate_d)[:, None]])
        white = (self._run.scenario.ins.white_sigma_arcsec * ARCSEC) ** 2 * np.eye(3)
        return exp_rotation(found.atVector(end)) @ rotation_nd, by_unknown @ covariance @ by_unknown.T + white


def _mounting_sigma(sensor: StarSensor) -> FloatArray:
    """Return the sigmas about forward, up and right, rad."""
    sigmas = [
        sensor.installation_sigma_forward_arcsec,
        sensor.installation_sigma_up_arcsec,
        sensor.installation_sigma_right_arcsec,
    ]
    return np.array(sigmas) * ARCSEC


class _Ins:
    """INS between two samples: both are extrapolated by their rates, and their mean is weighted by the times."""

    def __init__(self, run: SimulatedRun) -> None:
        ins = run.ins
        self.time_ns, self._rotation_nd, self._rate_d = ins.time_ns, ins.rotation_nd, ins.rate_d
        self._white = (run.scenario.ins.white_sigma_arcsec * ARCSEC) ** 2

    def has_samples_around(self, time_ns: int) -> bool:
        """True from the second sample to the last but one, which leaves a margin for the clock offset."""
        return bool(self.time_ns[1] <= time_ns <= self.time_ns[-2])

    def attitude_at(self, time_ns: int, offset_s: float) -> tuple[FloatArray, FloatArray]:
        """Return horizon from deck, (3, 3), and the angular rate in the deck, rad/s, for this clock offset."""
        left, part, step_s = self._interpolation(time_ns, offset_s)
        before, after = self._rate_d[left], self._rate_d[left + 1]
        rate_d = before + part * (after - before)
        by_left = self._rotation_nd[left] @ exp_rotation(0.5 * (before + rate_d) * part * step_s)
        by_right = self._rotation_nd[left + 1] @ exp_rotation(-0.5 * (rate_d + after) * (1.0 - part) * step_s)
        return by_left @ exp_rotation(part * log_rotation(by_left.T @ by_right)), rate_d

    def last_attitude(self, offset_s: float) -> tuple[FloatArray, FloatArray]:
        """Return attitude and rate at the last stamp: the last sample, its attitude moved by the clock offset."""
        _, halfway_d = self.attitude_at(int(self.time_ns[-1]), 0.5 * offset_s)
        return self._rotation_nd[-1] @ exp_rotation(-halfway_d * offset_s), self._rate_d[-1]

    def white_variance(self, time_ns: int) -> float:
        """Return the noise variance of the interpolated attitude about each axis, rad²."""
        _, part, _ = self._interpolation(time_ns, 0.0)
        return float(self._white * ((1.0 - part) ** 2 + part**2))

    def _interpolation(self, time_ns: int, offset_s: float) -> tuple[int, float, float]:
        """Return the number of the sample before, the fraction of the step to the next, and the step, s."""
        stamp_ns = time_ns - round(1e9 * offset_s)
        left = int(np.clip(np.searchsorted(self.time_ns, stamp_ns) - 1, 0, len(self.time_ns) - 2))
        step_ns = self.time_ns[left + 1] - self.time_ns[left]
        return left, (time_ns - self.time_ns[left] - 1e9 * offset_s) / step_ns, 1e-9 * step_ns

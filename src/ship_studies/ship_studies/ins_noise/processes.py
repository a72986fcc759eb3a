"""The two models of an INS's error as processes with parameters, and the corresponding suite parameters.

A fit searches logarithms of parameters, which are chosen so that a record determines them well. A Gauss-Markov process
has 2 sigma² / correlation time, the noise variance per second, which even a record much shorter than the correlation
time determines. To determine sigma and time separately, many correlation times are needed. For the Schuler process the
fitted parameters are noise, drift and bias of the sensors, and errors at the start. The time constants of drift and
bias, the latitude error at the start, and the damping are taken from the configuration.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import expm

from ship_attitude_star.ins_errors.schuler import SchulerIns
from ship_attitude_star.ship_attitude.config import InsConfig
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.parameters.ship_devices import GAUSS_MARKOV, SCHULER, SchulerConfig
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.ins_noise.star_record import ProcessSteps

_NARROWEST, _LONGEST_S = 1e-4, 1e7
_STEP_S = 1e-3
"""Resolution of the times between epochs, s."""


class Parameter(NamedTuple):
    """A parameter of a fit.

    Attributes:
        name: name for people.
        start: start value of the search; positive.
        least: lower bound.
        most: upper bound.
    """

    name: str
    start: float
    least: float
    most: float


class SuiteParameter(NamedTuple):
    """A parameter of ``ship_attitude``, computed from the fit: log value = constant + weights · log fit parameters.

    Attributes:
        name: name in the parameter file, after ``ins.``.
        unit: unit of the parameter.
        constant: constant part of the logarithm.
        weights: weights of the logarithms of the fit's parameters, shape (p,).
    """

    name: str
    unit: str
    constant: float
    weights: FloatArray


class FittableInsModel(Protocol):
    """A model of the INS's error that can be fitted to a record of stars.

    Attributes:
        parameters: parameters of the fit.
        suite_parameters: suite parameters determined by the fit.
        configured_values: suite parameters taken as configured, by name.
    """

    parameters: tuple[Parameter, ...]
    suite_parameters: tuple[SuiteParameter, ...]
    configured_values: dict[str, float]

    @property
    def name(self) -> str:
        """Value of ``ins.model``."""
        ...

    def steps(self, values: FloatArray, times_s: FloatArray) -> ProcessSteps:
        """Return the process for k parameter sets, shape (k, p), at the times of E epochs, shape (E,)."""
        ...


class GaussMarkovModel:
    """Gauss-Markov error of each axis with autocovariance sigma² exp(-t / time); both tilts have the same parameters.

    Args:
        ins: configuration with the start values of the search.
    """

    name = GAUSS_MARKOV

    def __init__(self, ins: InsConfig) -> None:
        tilt, heading = max(ins.tilt_sigma_arcsec, _NARROWEST), max(ins.heading_sigma_arcsec, _NARROWEST)
        self.parameters: tuple[Parameter, ...] = (
            Parameter("2 σ²/τ of tilt [arcsec²/s]", 2.0 * tilt**2 / ins.tilt_time_s, 1e-12, 1e6),
            Parameter("τ of tilt [s]", ins.tilt_time_s, 1.0, _LONGEST_S),
            Parameter("2 σ²/τ of heading [arcsec²/s]", 2.0 * heading**2 / ins.heading_time_s, 1e-12, 1e6),
            Parameter("τ of heading [s]", ins.heading_time_s, 1.0, _LONGEST_S),
            _white(ins),
        )
        half = 0.5 * math.log(0.5)
        self.suite_parameters: tuple[SuiteParameter, ...] = (
            SuiteParameter("white_sigma_arcsec", "arcsec", 0.0, np.eye(5)[4]),
            SuiteParameter("tilt_sigma_arcsec", "arcsec", half, np.array([0.5, 0.5, 0.0, 0.0, 0.0])),
            SuiteParameter("tilt_time_s", "s", 0.0, np.eye(5)[1]),
            SuiteParameter("heading_sigma_arcsec", "arcsec", half, np.array([0.0, 0.0, 0.5, 0.5, 0.0])),
            SuiteParameter("heading_time_s", "s", 0.0, np.eye(5)[3]),
        )
        self.configured_values: dict[str, float] = {}

    def steps(self, values: FloatArray, times_s: FloatArray) -> ProcessSteps:
        """See :class:`FittableInsModel`."""
        change, time_s = values[:, [0, 2, 0]], values[:, [1, 3, 1]]
        steady = 0.5 * change * time_s
        decay = np.exp(-np.diff(times_s)[:, None] / time_s[:, None])
        fresh = -np.expm1(-2.0 * np.diff(times_s)[:, None] / time_s[:, None]) * steady[:, None]
        unit = np.eye(3)
        return ProcessSteps(
            start=steady[:, None] * unit,
            transition=decay[..., None] * unit,
            noise=fresh[..., None] * unit,
            white=np.repeat(values[:, 4:5] ** 2, 3, axis=1),
        )


class SchulerModel:
    """Schuler oscillation with fitted errors of gyroscopes and accelerometers; the equations are those of the filter.

    Args:
        ins: configuration with the start values of the search and the values that are not fitted.
        here: mean latitude and velocity of the ship.
    """

    name = SCHULER

    def __init__(self, ins: InsConfig, here: LocalVertical) -> None:
        schuler = ins.schuler
        drift, bias = schuler.gyro_drift_sigma_deg_per_h, schuler.accelerometer_bias_sigma_m_per_s2
        velocity_walk = schuler.velocity_walk_m_per_s_per_sqrt_h
        found = (
            ("tilt_sigma_arcsec", "arcsec", ins.tilt_sigma_arcsec, 1e3),
            ("heading_sigma_arcsec", "arcsec", ins.heading_sigma_arcsec, 1e4),
            ("schuler.velocity_sigma_m_per_s", "m/s", schuler.velocity_sigma_m_per_s, 100.0),
            ("schuler.gyro_drift_sigma_deg_per_h", "deg/h", drift, 100.0),
            ("schuler.angle_walk_deg_per_sqrt_h", "deg/sqrt(h)", schuler.angle_walk_deg_per_sqrt_h, 10.0),
            ("schuler.accelerometer_bias_sigma_m_per_s2", "m/s2", bias, 1.0),
            ("schuler.velocity_walk_m_per_s_per_sqrt_h", "m/s/sqrt(h)", velocity_walk, 100.0),
        )
        white = _white(ins)
        self.parameters: tuple[Parameter, ...] = (
            *(Parameter(name, max(start, 1e-6 * most), 1e-8 * most, most) for name, _, start, most in found),
            white,
        )
        unit = np.eye(len(self.parameters))
        self.suite_parameters: tuple[SuiteParameter, ...] = (
            SuiteParameter("white_sigma_arcsec", "arcsec", 0.0, unit[-1]),
            *(SuiteParameter(name, unit_text, 0.0, unit[row]) for row, (name, unit_text, _, _) in enumerate(found)),
        )
        self.configured_values = {
            "schuler.position_sigma_m": schuler.position_sigma_m,
            "schuler.gyro_drift_time_s": schuler.gyro_drift_time_s,
            "schuler.accelerometer_bias_time_s": schuler.accelerometer_bias_time_s,
            "schuler.damping_time_s": schuler.damping_time_s,
        }
        self._config = schuler
        self._here = here
        self._cached: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def steps(self, values: FloatArray, times_s: FloatArray) -> ProcessSteps:
        """See :class:`FittableInsModel`."""
        transition, fresh = self._discrete_process(times_s)
        count = len(values)
        tilt, heading, velocity, drift, angle_walk, bias, velocity_walk, white = values.T
        configs = [
            replace(
                self._config,
                gyro_drift_sigma_deg_per_h=float(drift[row]),
                angle_walk_deg_per_sqrt_h=float(angle_walk[row]),
                accelerometer_bias_sigma_m_per_s2=float(bias[row]),
                velocity_walk_m_per_s_per_sqrt_h=float(velocity_walk[row]),
            )
            for row in range(count)
        ]
        # Noise densities of attitude, velocity, drift and bias, in the units of the states.
        density = np.array([_densities(config) for config in configs]) / self._scale[[0, 3, 6, 9]] ** 2
        sigma = np.zeros((count, 11))
        sigma[:, :3] = np.column_stack([tilt, heading, tilt])
        sigma[:, 3:5] = velocity[:, None] / self._scale[3]
        sigma[:, 5] = self._config.latitude_sigma / self._scale[5]
        sigma[:, 6:9] = np.array([config.gyro_drift for config in configs])[:, None] / self._scale[6]
        sigma[:, 9:] = bias[:, None] / self._scale[9]
        return ProcessSteps(
            start=sigma[:, :, None] ** 2 * np.eye(11),
            transition=transition[None],
            noise=np.einsum("kd,dbij->kbij", density, fresh),
            white=np.repeat(white[:, None] ** 2, 3, axis=1),
        )

    @cached_property
    def _scale(self) -> FloatArray:
        """Units of the states: size of each state that causes about one arcsecond of tilt."""
        return np.array([ARCSEC] * 3 + [0.04] * 2 + [ARCSEC] + [1e-3 * ARCSEC] * 3 + [10.0 * ARCSEC] * 2)

    def _discrete_process(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the discretised process between epochs, for unit densities of attitude, velocity, drift and bias.

        Returns:
            Transitions, shape (E - 1, 11, 11), and covariances, shape (4, E - 1, 11, 11).
        """
        if self._cached is None or not np.array_equal(self._cached[0], times_s):
            steps = np.round(np.diff(times_s) / _STEP_S).astype(np.int64)
            kinds, of = np.unique(steps, return_inverse=True)
            process = SchulerIns(self._config, np.ones(3), None)
            rates = process.system_matrix(self._here) * self._scale / self._scale[:, None]
            found = [_discretise(rates, kind * _STEP_S) for kind in kinds.tolist()]
            transition = np.array([way[0] for way in found]).reshape(-1, 11, 11)[of]
            fresh = np.array([way[1] for way in found]).reshape(-1, 4, 11, 11)[of]
            self._cached = times_s, transition, np.moveaxis(fresh, 0, 1)
        return self._cached[1:]


def _discretise(rates: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition over a time, (n, n), and the covariances of unit densities, (4, n, n) (Van Loan 1978)."""
    size = len(rates)
    fresh = []
    for rows in (range(3), range(3, 5), range(6, 9), range(9, 11)):
        density = np.zeros((size, size))
        density[rows, rows] = 1.0
        whole = expm(dt_s * np.block([[-rates, density], [np.zeros_like(rates), rates.T]]))
        transition = whole[size:, size:].T
        fresh.append(transition @ whole[:size, size:])
    return transition, np.array(fresh)


def _densities(config: SchulerConfig) -> list[float]:
    """Return the noise variance per second of each axis of attitude, velocity, drift and bias."""
    return [
        config.angle_walk**2,
        config.velocity_walk**2,
        2.0 * config.gyro_drift**2 / config.gyro_drift_time_s,
        2.0 * config.accelerometer_bias_sigma_m_per_s2**2 / config.accelerometer_bias_time_s,
    ]


def _white(ins: InsConfig) -> Parameter:
    return Parameter("white_sigma_arcsec", max(ins.white_sigma_arcsec, 0.1), 1e-3, 1e4)


def candidate_models(ins: InsConfig, here: LocalVertical | None) -> Sequence[FittableInsModel]:
    """Return the models to be fitted; the Schuler model only if the latitude is known."""
    gauss_markov = GaussMarkovModel(ins)
    return (gauss_markov,) if here is None else (gauss_markov, SchulerModel(ins, here))

"""Satellite positioning solutions for the baseline between two antennas, both on board or one on a drone."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import CorrelatedError, arrival_times, is_outside, random_stream
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.theodolite_scenario import Rtk
from ship_simulation.ship.motion import Carrier

NONE, FLOAT, FIXED = 0, 3, 4
"""Values of RtkBaseline.NONE, RtkBaseline.FLOAT, RtkBaseline.FIXED."""


@dataclass(frozen=True)
class BaselineSamples:
    """Satellite positioning solutions for the baseline from one antenna to another.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        baseline_n: (North, Up, East), m, shape (n, 3); NaN where the fix is NONE.
        covariance_n: covariance of the white error and the FLOAT error, m², shape (n, 3, 3); NaN where the fix is NONE.
        fix: NONE, FLOAT or FIXED, shape (n,).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    baseline_n: FloatArray
    covariance_n: FloatArray
    fix: np.ndarray

    def select(self, which: np.ndarray) -> "BaselineSamples":
        """Return the selected samples."""
        return BaselineSamples(
            self.time_ns[which],
            self.log_time_ns[which],
            self.baseline_n[which],
            self.covariance_n[which],
            self.fix[which],
        )


def simulate_solutions(
    name: str, config: Rtk, time_ns: np.ndarray, true_n: FloatArray, stretch: Stretch, draws: Draws
) -> BaselineSamples:
    """Return solutions of true baselines (North, Up, East), m, shape (n, 3), with white and correlated errors.

    Args:
        name: begin of the names of the random streams.
        config: errors and rate.
        time_ns: stamps.
        true_n: the true baselines, plus the errors that other baselines share.
        stretch: part of the voyage.
        draws: random draws of the run.
    """
    t_s = (time_ns - stretch.start_ns) / SECOND_NS
    bias = _correlated_error(name + ".bias", stretch, config.bias_sigma_m, config.bias_time_s, draws)
    float_error = _correlated_error(name + ".float", stretch, config.float_sigma_m, config.float_time_s, draws)
    is_float = ~is_outside(t_s, config.float_times)
    white_n = config.sigma_m * draws.stream(name + ".white").standard_normal((time_ns.size, 3))
    error_n = white_n + bias.values_at(t_s) + is_float[:, None] * float_error.values_at(t_s)
    variance = config.sigma_m**2 + is_float * config.float_sigma_m**2
    # NaN where there is no solution.
    unsolved = ~is_outside(t_s, config.no_solution_times)
    blank = np.where(unsolved, np.nan, 1.0)
    arrival = draws.stream(name + ".arrival")
    log_time_ns = arrival_times(time_ns, config.latency_s, config.jitter_s, arrival)
    sent = is_outside(t_s, config.outages)
    return BaselineSamples(
        time_ns=time_ns[sent],
        log_time_ns=log_time_ns[sent],
        baseline_n=(blank[:, None] * (true_n + error_n))[sent],
        covariance_n=((blank * variance)[:, None, None] * np.eye(3))[sent],
        fix=np.where(unsolved, NONE, np.where(is_float, FLOAT, FIXED))[sent],
    )


def simulate_ship_baseline(scenario: Scenario, carrier: Carrier, stretch: Stretch, draws: Draws) -> BaselineSamples:
    """Return solutions for the baseline between the two antennas on board, whose true vector has a survey error."""
    config, name = scenario.ship_baseline, "ship_baseline"
    time_ns = stretch.stamps(config.rtk.rate_hz, config.rtk.phase_s)
    surveyed_off_d = config.sigma_m * random_stream(draws.seed, name + ".survey").standard_normal(3)
    vector_d = config.vector_d + surveyed_off_d
    true_n = carrier.attitude((time_ns - stretch.start_ns) / SECOND_NS) @ vector_d
    return simulate_solutions(name + ".rtk", config.rtk, time_ns, true_n, stretch, draws)


def _correlated_error(name: str, stretch: Stretch, sigma_m: float, time_s: float, draws: Draws) -> CorrelatedError:
    return draws.correlated_error(name, stretch.duration_s, np.full(3, sigma_m), time_s)

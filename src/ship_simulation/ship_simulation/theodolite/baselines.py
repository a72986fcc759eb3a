"""What satellite positioning says of the way from the ship's antenna to a drone's."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import SECOND_NS, SlowError, arrival_times, random_stream, stamps
from ship_simulation.ship.attitude_device import outside
from ship_simulation.theodolite.scene import Scene

NONE, FLOAT, FIXED = 0, 3, 4
"""RtkBaseline.NONE, RtkBaseline.FLOAT, RtkBaseline.FIXED."""


@dataclass(frozen=True)
class BaselineSamples:
    """Solutions.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        baseline_n: (North, Up, East), m, shape (n, 3); NaN with the fix NONE.
        covariance_n: of what is new in each solution, and of the error of FLOAT, m², shape (n, 3, 3); NaN likewise.
        fix: NONE, FLOAT or FIXED, shape (n,).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    baseline_n: FloatArray
    covariance_n: FloatArray
    fix: np.ndarray


def solve_baselines(
    beacon_id: str, scene: Scene, ship_antenna: SlowError, start_ns: int, duration_s: float, seed: int
) -> BaselineSamples:
    """Solutions with white noise, a slow error of their own, and that of the ship's antenna, which all share."""
    light, name = scene.lights[beacon_id], f"beacon.{beacon_id}.rtk"
    config = light.config.rtk
    time_ns = stamps(start_ns, config.rate_hz, config.phase_s, duration_s)
    t_s = (time_ns - start_ns) / SECOND_NS
    bias = _slow(name + ".bias", duration_s, config.bias_sigma_m, config.bias_time_s, seed)
    unfixed = _slow(name + ".float", duration_s, config.float_sigma_m, config.float_time_s, seed)
    is_float = ~outside(t_s, config.float_times)
    white_n = config.sigma_m * random_stream(seed, name + ".white").standard_normal((time_ns.size, 3))
    error_n = white_n + bias.at(t_s) + ship_antenna.at(t_s) + is_float[:, None] * unfixed.at(t_s)
    true_n = light.path(t_s) + scene.carrier.attitude(t_s) @ scene.theodolite.lever_d
    variance = config.sigma_m**2 + is_float * config.float_sigma_m**2
    # The blank of what has no solution.
    unsolved = ~outside(t_s, config.no_solution_times)
    blank = np.where(unsolved, np.nan, 1.0)
    arrival = random_stream(seed, name + ".arrival")
    log_time_ns = arrival_times(time_ns, config.latency_s, config.jitter_s, arrival)
    sent = (t_s < light.config.leaves_s) & outside(t_s, config.outages)
    return BaselineSamples(
        time_ns=time_ns[sent],
        log_time_ns=log_time_ns[sent],
        baseline_n=(blank[:, None] * (true_n + error_n))[sent],
        covariance_n=((blank * variance)[:, None, None] * np.eye(3))[sent],
        fix=np.where(unsolved, NONE, np.where(is_float, FLOAT, FIXED))[sent],
    )


def _slow(name: str, duration_s: float, sigma_m: float, time_s: float, seed: int) -> SlowError:
    return SlowError(random_stream(seed, name), duration_s, np.full(3, sigma_m), time_s)

"""What a drone says of its own attitude."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation
from ship_simulation.draws.noise import SECOND_NS, SlowError, arrival_times, random_stream, stamps
from ship_simulation.theodolite.scene import TrueLight


@dataclass(frozen=True)
class DroneSamples:
    """Its attitude.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        rotation_nb: horizon from drone (nose, up, right) as measured, shape (n, 3, 3).
        rate_b: angular velocity in the drone's frame, rad/s, shape (n, 3).
        covariance_n: of its rotation vector (North, Up, East), in all, rad², shape (3, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nb: FloatArray
    rate_b: FloatArray
    covariance_n: FloatArray


def simulate_drone_attitude(
    beacon_id: str, light: TrueLight, start_ns: int, duration_s: float, seed: int
) -> DroneSamples:
    """Samples by R_true(t) = exp(e) exp(w) R_drone(t), e Gauss–Markov, until it leaves."""
    config, name = light.config.imu, f"beacon.{beacon_id}.imu"
    time_ns = stamps(start_ns, config.rate_hz, config.phase_s, duration_s)
    t_s = (time_ns - start_ns) / SECOND_NS
    sigma = np.deg2rad([config.tilt_sigma_deg, config.heading_sigma_deg, config.tilt_sigma_deg])
    white_sigma = np.deg2rad(config.white_sigma_deg)
    slow = SlowError(random_stream(seed, name + ".slow"), duration_s, sigma, config.time_s)
    white_n = white_sigma * random_stream(seed, name + ".white").standard_normal((time_ns.size, 3))
    arrival = random_stream(seed, name + ".arrival")
    log_time_ns = arrival_times(time_ns, config.latency_s, config.jitter_s, arrival)
    there = t_s < light.config.leaves_s
    measured = exp_rotation(-white_n) @ exp_rotation(-slow.at(t_s)) @ light.attitude.attitude(t_s)
    return DroneSamples(
        time_ns=time_ns[there],
        log_time_ns=log_time_ns[there],
        rotation_nb=measured[there],
        rate_b=light.attitude.body_rate(t_s)[there],
        covariance_n=np.diag(sigma**2 + white_sigma**2),
    )

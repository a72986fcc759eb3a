"""The fused attitude of the ship: the true one with slow errors, as INS and stars together leave them."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_simulation.draws.noise import SECOND_NS, SlowError, arrival_times, random_stream, stamps
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.ship.motion import Carrier


@dataclass(frozen=True)
class FusedSamples:
    """What ``ship/attitude`` says.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        rotation_nd: horizon from deck as estimated, shape (n, 3, 3).
        rate_d: angular velocity (bow, up, starboard), rad/s, shape (n, 3).
        covariance_n: of its rotation vector (North, Up, East), in all, rad², shape (3, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nd: FloatArray
    rate_d: FloatArray
    covariance_n: FloatArray


def simulate_fused_attitude(scenario: Scenario, carrier: Carrier, start_ns: int, seed: int) -> FusedSamples:
    """Samples by R_true(t) = exp(e) exp(w) R_fused(t), e Gauss–Markov, w white."""
    config = scenario.fused_attitude
    time_ns = stamps(start_ns, config.rate_hz, config.phase_s, scenario.duration_s)
    since_start_s = (time_ns - start_ns) / SECOND_NS
    sigma = ARCSEC * np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec])
    error = SlowError(random_stream(seed, "fused.error"), scenario.duration_s, sigma, config.time_s)
    white_sigma = config.white_sigma_arcsec * ARCSEC
    white_n = white_sigma * random_stream(seed, "fused.white").standard_normal((time_ns.size, 3))
    arrival = random_stream(seed, "fused.arrival")
    return FusedSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        rotation_nd=exp_rotation(-white_n) @ exp_rotation(-error.at(since_start_s)) @ carrier.attitude(since_start_s),
        rate_d=carrier.body_rate(since_start_s),
        covariance_n=np.diag(sigma**2 + white_sigma**2),
    )

"""The INS: true motion in, its samples with their errors out."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_simulation.draws.noise import SECOND_NS, arrival_times, gauss_markov, random_stream, stamps
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.ship.motion import Carrier


@dataclass(frozen=True)
class InsSamples:
    """What the INS says.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        rotation_nd: horizon from deck as measured, shape (n, 3, 3).
        rate_d: angular velocity as measured, (bow, up, starboard), rad/s, shape (n, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nd: FloatArray
    rate_d: FloatArray


@dataclass(frozen=True)
class InsTruth:
    """What is wrong with the INS.

    Attributes:
        attitude_error_n: slow error a at each sample (north, up, east), rad, shape (n, 3).
        time_offset_s: a sample is valid at its stamp plus this.
    """

    attitude_error_n: FloatArray
    time_offset_s: float


def simulate_ins(scenario: Scenario, carrier: Carrier, start_ns: int, seed: int) -> tuple[InsSamples, InsTruth]:
    """Samples by R_true(s + tau) = exp(a) exp(w) R_ins(s), with the true rate of s + tau."""
    config = scenario.ins
    time_ns = stamps(start_ns, config.rate_hz, 0.0, scenario.duration_s)
    truth = InsTruth(
        attitude_error_n=gauss_markov(
            random_stream(seed, "ins.attitude_error"),
            time_ns.size,
            1.0 / config.rate_hz,
            sigma=ARCSEC * np.array([config.tilt_sigma_arcsec, config.heading_sigma_arcsec, config.tilt_sigma_arcsec]),
            time_s=np.array([config.tilt_time_s, config.heading_time_s, config.tilt_time_s]),
        ),
        time_offset_s=config.time_offset_s
        + config.time_offset_sigma_s * random_stream(seed, "ins.time_offset").standard_normal(),
    )
    valid_s = (time_ns - start_ns) / SECOND_NS + truth.time_offset_s
    white_n = random_stream(seed, "ins.white").standard_normal((time_ns.size, 3)) * config.white_sigma_arcsec * ARCSEC
    rate_noise = random_stream(seed, "ins.rate").standard_normal((time_ns.size, 3))
    samples = InsSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, random_stream(seed, "ins.arrival")),
        rotation_nd=exp_rotation(-white_n) @ exp_rotation(-truth.attitude_error_n) @ carrier.attitude(valid_s),
        rate_d=carrier.body_rate(valid_s) + config.rate_sigma_arcsec_per_s * ARCSEC * rate_noise,
    )
    return samples, truth

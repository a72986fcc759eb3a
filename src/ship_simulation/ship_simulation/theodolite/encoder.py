"""What the encoders say."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray, wrap_two_pi
from ship_simulation.draws.noise import arrival_times, random_stream
from ship_simulation.scenario.theodolite_scenario import Encoder
from ship_simulation.theodolite.scene import MountState


@dataclass(frozen=True)
class EncoderSamples:
    """Readings.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        azimuth: rad, 0 to 2 pi, shape (n,).
        elevation: rad, shape (n,).
        sigma: of each angle, rad.
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    azimuth: FloatArray
    elevation: FloatArray
    sigma: float


def read_encoders(config: Encoder, mount: MountState, time_ns: np.ndarray, seed: int) -> EncoderSamples:
    """Readings of the mount at the stamps ``time_ns``, with their noise."""
    sigma = config.sigma_arcsec * ARCSEC
    noise = sigma * random_stream(seed, "theodolite.encoder").standard_normal((2, time_ns.size))
    arrival = random_stream(seed, "theodolite.encoder.arrival")
    return EncoderSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        azimuth=wrap_two_pi(mount.azimuth + noise[0]),
        elevation=mount.elevation + noise[1],
        sigma=sigma,
    )

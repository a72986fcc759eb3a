"""Star sensors that solve for their attitude among the stars, as most star trackers do."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation
from ship_simulation.draws.noise import arrival_times, random_stream
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.ship.attitude_device import MountedMotion, outside, sigma_of_attitudes
from ship_simulation.stars.sky import TrueSky


@dataclass(frozen=True)
class InertialSamples:
    """What such a sensor says.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: moments of arrival, in any order, shape (n,).
        rotation_iv: ICRS from sensor (forward, up, right) as measured, shape (n, 3, 3).
        noise_v: covariance of its error, in the sensor frame, rad², shape (3, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_iv: FloatArray
    noise_v: FloatArray


def simulate_inertial_sensor(
    sensor_id: str, scenario: Scenario, motion: MountedMotion, sky: TrueSky, seed: int
) -> InertialSamples:
    """Samples by R_iv = R_ni^T L^T R_star exp(n), L the lift by the air at the boresight.

    The sensor knows the velocity of the Earth and takes aberration out; of the air it knows nothing, so it finds the
    attitude from which it would see the same stars without air. No attitude while the Sun is up, in an outage, or
    with the boresight lower than the refraction model holds.
    """
    config, name = scenario.star_sensors[sensor_id], f"star.{sensor_id}"
    sigma_v = sigma_of_attitudes(config)
    noise_v = sigma_v * random_stream(seed, name + ".white").standard_normal((motion.time_ns.size, 3))
    arrival = random_stream(seed, name + ".arrival")
    log_time_ns = arrival_times(motion.time_ns, config.latency_s, config.jitter_s, arrival)
    rotation_ni = sky.rotation_horizon_from_icrs(motion.valid_ns)
    rotation_nv = np.swapaxes(sky.lift(motion.rotation_nv[..., 0]), -1, -2) @ motion.rotation_nv
    rotation_iv = np.swapaxes(rotation_ni, -1, -2) @ rotation_nv @ exp_rotation(noise_v)
    dark = sky.sun_elevation(motion.valid_ns) < np.deg2rad(config.sun_limit_deg)
    kept = dark & outside(motion.since_start_s, config.outages) & np.isfinite(rotation_iv[:, 0, 0])
    return InertialSamples(motion.time_ns[kept], log_time_ns[kept], rotation_iv[kept], np.diag(sigma_v**2))

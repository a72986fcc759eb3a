"""Measurements of the devices around a theodolite: encoders, telescope, satellite positioning, and drones."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.mount.image import Camera
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, wrap_two_pi
from ship_simulation.draws.noise import (
    CorrelatedError,
    arrival_times,
    centroids,
    exposure_times,
)
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.theodolite_scenario import Encoder, Telescope
from ship_simulation.ship.rtk import BaselineSamples, simulate_solutions
from ship_simulation.theodolite.scene import MountState, Scene, TrueBeacon


@dataclass(frozen=True)
class EncoderSamples:
    """Readings of the two encoders.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        azimuth: readings of the azimuth encoder, rad, 0 to 2 pi, shape (n,).
        elevation: readings of the elevation encoder, rad, shape (n,).
        sigma: standard deviation of each angle, rad.
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    azimuth: FloatArray
    elevation: FloatArray
    sigma: float


def simulate_encoders(config: Encoder, mount: MountState, stretch: Stretch, draws: Draws) -> EncoderSamples:
    """Return readings of the mount at the stamps of the encoders, with their noise."""
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    sigma = config.sigma_arcsec * ARCSEC
    # The random numbers of the elevation follow all numbers of the azimuth.
    starts = (0, stretch.count(config.rate_hz, config.phase_s))
    noise = [sigma * draws.stream("theodolite.encoder", start).standard_normal(time_ns.size) for start in starts]
    arrival = draws.stream("theodolite.encoder.arrival")
    return EncoderSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        azimuth=wrap_two_pi(mount.azimuth + noise[0]),
        elevation=mount.elevation + noise[1],
        sigma=sigma,
    )


@dataclass(frozen=True)
class ImageSamples:
    """Exposures of the calibration telescope.

    The lights found in exposure i are those from ``first[i]`` up to ``first[i + 1]``.

    Attributes:
        time_ns: middles of the exposures, increasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        first: index of the first light of each exposure, shape (n + 1,).
        beacon_ids: ids of all lights of the scenario.
        beacon_index: index of each found light in ``beacon_ids``, shape (k,).
        point_m: points of the found lights on the detector, along right and up, shape (k, 2).
        sigma_m: standard deviation of each coordinate for a light at rest.
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    first: np.ndarray
    beacon_ids: tuple[str, ...]
    beacon_index: np.ndarray
    point_m: FloatArray
    sigma_m: float

    def sightings(self, exposure: int) -> list[tuple[str, FloatArray]]:
        """Return (id, point on the detector, shape (2,)) of each light in an exposure."""
        rows = range(self.first[exposure], self.first[exposure + 1])
        return [(self.beacon_ids[self.beacon_index[row]], self.point_m[row]) for row in rows]


def simulate_images(config: Telescope, scene: Scene, stretch: Stretch, draws: Draws) -> ImageSamples:
    """Return the exposures of a stretch, including those without lights."""
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    t_s = (time_ns - stretch.start_ns) / SECOND_NS
    noise = draws.stream("theodolite.detection").standard_normal((time_ns.size, len(scene.beacons), 2))
    times = exposure_times(config.exposure_s)
    path_m = np.array([points_on_detector(config, scene, t_s + t, scene.mount(t_s + t)) for t in times.since_middle_s])
    point_m = centroids(times, path_m, config.psf_sigma_m, config.sigma_m, noise)
    seen = is_in_view(config, scene, t_s, point_m)
    arrival = draws.stream("theodolite.telescope.arrival")
    return ImageSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        first=np.append(0, np.cumsum(seen.sum(axis=1))),
        beacon_ids=tuple(scene.beacons),
        beacon_index=np.nonzero(seen)[1],
        point_m=point_m[seen],
        sigma_m=config.sigma_m,
    )


def points_on_detector(config: Telescope, scene: Scene, t_s: FloatArray, mount: MountState) -> FloatArray:
    """Return true points of the lights on the plane of the detector, m, shape (k, N, 2); NaN behind the telescope."""
    camera = Camera(scene.theodolite.focal_length_m, 0.0, config.principal_point_m)
    return camera.points(scene.directions_n(t_s, mount) @ scene.rotation_nt(mount))


def is_in_view(config: Telescope, scene: Scene, t_s: FloatArray, point_m: FloatArray) -> np.ndarray:
    """True if a light is present, not hidden, and on the detector, shape (k, N)."""
    on_detector = np.all(np.abs(point_m) <= 0.5 * np.array([config.width_m, config.height_m]), axis=-1)
    shown = [light.is_visible(t_s) for light in scene.beacons.values()]
    seen: np.ndarray = on_detector & (np.stack(shown, axis=-1) if shown else np.empty((t_s.size, 0), dtype=bool))
    return seen


def simulate_baselines(
    beacon_id: str, scene: Scene, ship_antenna: CorrelatedError, stretch: Stretch, draws: Draws
) -> BaselineSamples:
    """Return solutions for the baseline from the ship's antenna to a drone's antenna, until the drone leaves.

    The baselines to all drones contain the same error of the ship's antenna.
    """
    beacon = scene.beacons[beacon_id]
    config = beacon.config.rtk
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    t_s = (time_ns - stretch.start_ns) / SECOND_NS
    true_n = beacon.path(t_s) + scene.carrier.attitude(t_s) @ scene.theodolite.lever_d
    found = simulate_solutions(
        f"beacon.{beacon_id}.rtk", config, time_ns, true_n + ship_antenna.values_at(t_s), stretch, draws
    )
    return found.select(found.time_ns - stretch.start_ns < beacon.config.leaves_s * SECOND_NS)


@dataclass(frozen=True)
class DroneSamples:
    """The attitude that a drone publishes.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        rotation_nb: horizon from drone (nose, up, right) as measured, shape (n, 3, 3).
        rate_b: angular velocity in the drone's frame, rad/s, shape (n, 3).
        covariance_n: covariance of the total error as a rotation vector (North, Up, East), rad², shape (3, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_nb: FloatArray
    rate_b: FloatArray
    covariance_n: FloatArray


def simulate_drone_attitude(
    beacon_id: str, beacon: TrueBeacon, stretch: Stretch, draws: Draws
) -> DroneSamples:
    """Return samples R_drone(t), where R_true(t) = exp(e) exp(w) R_drone(t), until the drone leaves.

    The error e is Gauss–Markov, the error w is white.
    """
    config, name = beacon.config.imu, f"beacon.{beacon_id}.imu"
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    t_s = (time_ns - stretch.start_ns) / SECOND_NS
    sigma = np.deg2rad([config.tilt_sigma_deg, config.heading_sigma_deg, config.tilt_sigma_deg])
    white_sigma = np.deg2rad(config.white_sigma_deg)
    slow = draws.correlated_error(name + ".slow", stretch.duration_s, sigma, config.time_s)
    white_n = white_sigma * draws.stream(name + ".white").standard_normal((time_ns.size, 3))
    arrival = draws.stream(name + ".arrival")
    log_time_ns = arrival_times(time_ns, config.latency_s, config.jitter_s, arrival)
    there = t_s < beacon.config.leaves_s
    measured = exp_rotation(-white_n) @ exp_rotation(-slow.values_at(t_s)) @ beacon.attitude.attitude(t_s)
    return DroneSamples(
        time_ns=time_ns[there],
        log_time_ns=log_time_ns[there],
        rotation_nb=measured[there],
        rate_b=beacon.attitude.body_rate(t_s)[there],
        covariance_n=np.diag(sigma**2 + white_sigma**2),
    )

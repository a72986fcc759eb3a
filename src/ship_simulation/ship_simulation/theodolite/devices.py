"""Measurements of the devices around a theodolite: encoders, telescope, main detector, baselines, and drones.

A satellite positioning solution is the baseline between two antennas, both on board or one on a drone. A target of the
main tube is observed in its direction from the intersection of the axes, raised by refraction like the directions of
lights. The main detector's axes v are rotated about the main axis by ρ. The image point follows from the true focal
length.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import Camera
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, wrap_pi, wrap_two_pi
from ship_simulation.random_draws import (
    CorrelatedError,
    Draws,
    Stretch,
    arrival_times,
    centroids,
    exposure_times,
    is_outside,
    random_stream,
)
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.theodolite_scenario import Encoder, MainDetector, Rtk, Target, Telescope
from ship_simulation.ship.motion import Carrier
from ship_simulation.theodolite.scene import (
    MountState,
    ObservedBody,
    Scene,
    TrueBeacon,
    flight_path,
    refracted_directions,
)

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
        return BaselineSamples(*(getattr(self, field)[which] for field in vars(self)))


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
    bias = draws.correlated_error(
        name + ".bias", stretch.duration_s, np.full(3, config.bias_sigma_m), config.bias_time_s
    )
    float_error = draws.correlated_error(
        name + ".float", stretch.duration_s, np.full(3, config.float_sigma_m), config.float_time_s
    )
    is_float = ~is_outside(t_s, config.float_times)
    white_n = config.sigma_m * draws.stream(name + ".white").standard_normal((time_ns.size, 3))
    error_n = white_n + bias.values_at(t_s) + is_float[:, None] * float_error.values_at(t_s)
    variance = config.sigma_m**2 + is_float * config.float_sigma_m**2
    # NaN where there is no solution.
    unsolved = ~is_outside(t_s, config.no_solution_times)
    blank = np.where(unsolved, np.nan, 1.0)
    arrival = draws.stream(name + ".arrival")
    samples = BaselineSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        baseline_n=blank[:, None] * (true_n + error_n),
        covariance_n=(blank * variance)[:, None, None] * np.eye(3),
        fix=np.where(unsolved, NONE, np.where(is_float, FLOAT, FIXED)),
    )
    return samples.select(is_outside(t_s, config.outages))


def simulate_ship_baseline(scenario: Scenario, carrier: Carrier, stretch: Stretch, draws: Draws) -> BaselineSamples:
    """Return solutions for the baseline between the two antennas on board, whose true vector has a survey error."""
    config, name = scenario.ship_baseline, "ship_baseline"
    time_ns = stretch.stamps(config.rtk.rate_hz, config.rtk.phase_s)
    surveyed_off_d = config.sigma_m * random_stream(draws.seed, name + ".survey").standard_normal(3)
    vector_d = config.vector_d + surveyed_off_d
    true_n = carrier.attitude((time_ns - stretch.start_ns) / SECOND_NS) @ vector_d
    return simulate_solutions(name + ".rtk", config.rtk, time_ns, true_n, stretch, draws)


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


@dataclass(frozen=True)
class TrueTarget(ObservedBody):
    """A target; ``config`` is its part of the scenario."""

    config: Target


@dataclass(frozen=True)
class TargetSamples:
    """Images of targets on the main detector, one per target and exposure, and the truth of each.

    Attributes:
        time_ns: middles of the exposures, not decreasing, shape (n,).
        log_time_ns: arrival times, shape (n,).
        target_ids: ids of all targets of the scenario.
        target: index of the target of each image in ``target_ids``, shape (n,).
        point_m: points on the detector, along the detector's right and up, shape (n, 2).
        rotation: reported rotation of the detector, rad, shape (n,).
        range_m: reported range, shape (n,); NaN if there is none.
        range_sigma_m: sigma of the reported range, shape (n,); NaN if there is no range.
        direction_n: true direction of observation, unit vector (North, Up, East), shape (n, 3).
        position_n: true position, from the ship's antenna, m, shape (n, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    target_ids: tuple[str, ...]
    target: np.ndarray
    point_m: FloatArray
    rotation: FloatArray
    range_m: FloatArray
    range_sigma_m: FloatArray
    direction_n: FloatArray
    position_n: FloatArray


def draw_targets(scenario: Scenario, draws: Draws) -> dict[str, TrueTarget]:
    """Return the targets of a run, in the order of ids."""
    air = scenario.theodolite.air
    return {
        key: TrueTarget(
            config=target,
            path=flight_path(target.course, scenario.theodolite.programme),
            refraction=draws.correlated_error(
                f"target.{key}.refraction", scenario.duration_s, np.array([air.light_sigma]), air.time_s
            ),
        )
        for key, target in sorted(scenario.targets.items())
    }


def simulate_targets(
    config: MainDetector, targets: dict[str, TrueTarget], scene: Scene, stretch: Stretch, draws: Draws
) -> TargetSamples:
    """Return the images in a stretch: one per exposure of each target that is present, not hidden, on the detector."""
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    t_s = (time_ns - stretch.start_ns) / SECOND_NS
    reported_rotation = np.deg2rad(config.rotation_deg + config.rotation_rate_deg_per_s * t_s)
    # Each target has a stream of its own, so that a further target does not change the others.
    drawn = [draws.stream(f"target.{key}.image").standard_normal((time_ns.size, 3)) for key in targets]
    noise = np.stack(drawn, axis=1) if drawn else np.empty((time_ns.size, 0, 3))
    times = exposure_times(config.exposure_s)
    camera, rotation_error = _true_detector(config, draws.seed)
    rotation = reported_rotation + rotation_error
    rotation_mv = rotation_from_angles(np.zeros_like(rotation), np.zeros_like(rotation), rotation)
    # Points on the plane of the detector, NaN behind the tube.
    path_m = np.array([
        camera.points(_directions_n(scene, targets, t_s + t) @ scene.mount(t_s + t).rotation_nm @ rotation_mv)
        for t in times.since_middle_s
    ])  # fmt: skip
    # The effect of streaks on the centroid is part of sigma_m, the only error that the main detector states.
    point_m = centroids(times, path_m, np.inf, config.sigma_m, noise[..., :2])
    on_detector = np.all(np.abs(point_m) <= 0.5 * np.array([config.width_m, config.height_m]), axis=-1)
    shown = _stack_by_target(targets, lambda one: one.is_visible(t_s), (t_s.size, 0))
    exposure, target = np.nonzero(on_detector & shown.astype(bool))
    paths_n = _stack_by_target(targets, lambda one: one.path(t_s), (t_s.size, 0, 3))
    range_sigma_m = np.array([one.config.range_sigma_m or np.nan for one in targets.values()])
    range_m = np.linalg.norm(paths_n, axis=-1) + range_sigma_m * noise[..., 2]
    lever_n = scene.carrier.attitude(t_s) @ scene.theodolite.lever_d
    arrival = draws.stream("theodolite.target.arrival")
    return TargetSamples(
        time_ns=time_ns[exposure],
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival)[exposure],
        target_ids=tuple(targets),
        target=target,
        point_m=point_m[exposure, target],
        rotation=wrap_pi(reported_rotation)[exposure],
        range_m=range_m[exposure, target],
        range_sigma_m=range_sigma_m[target],
        direction_n=_directions_n(scene, targets, t_s)[exposure, target],
        position_n=(lever_n[:, None] + paths_n)[exposure, target],
    )


def _true_detector(config: MainDetector, seed: int) -> tuple[Camera, float]:
    """Return the detector's true geometry, drawn about the known geometry, and the detector's rotation error, rad."""
    focal, x, z, rotation = random_stream(seed, "theodolite.main_detector").standard_normal(4)
    principal_point_m = config.principal_point_m + config.principal_sigma_m * np.array([x, z])
    focal_length_m = config.focal_length_m + config.focal_length_sigma_m * focal
    return Camera(focal_length_m, 0.0, principal_point_m), config.rotation_sigma_arcsec * ARCSEC * rotation


def _directions_n(scene: Scene, targets: dict[str, TrueTarget], t_s: FloatArray) -> FloatArray:
    """Return unit vectors along which the targets are observed, shape (k, N, 3)."""
    common = scene.coefficient + scene.refraction.values_at(t_s)[:, 0]
    return _stack_by_target(
        targets,
        lambda one: refracted_directions(one.path(t_s), common + one.refraction.values_at(t_s)[:, 0]),
        (t_s.size, 0, 3),
    )


def _stack_by_target(
    targets: dict[str, TrueTarget], of: Callable[[TrueTarget], np.ndarray], none: tuple[int, ...]
) -> np.ndarray:
    """Return a quantity of each target, along a second axis; an array of the shape ``none`` if there is no target."""
    return np.stack([of(target) for target in targets.values()], axis=1) if targets else np.empty(none)

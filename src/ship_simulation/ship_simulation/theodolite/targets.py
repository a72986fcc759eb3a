"""Targets of the main tube: their courses, their images on the main detector, and their true positions.

A target is observed in its direction from the intersection of the axes, raised by refraction like the directions of
lights. The detector's axes v are rotated about the main axis by ρ. The image point follows from the true focal length.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import Camera
from ship_geometry.rotations import ARCSEC, FloatArray, wrap_pi
from ship_simulation.draws.noise import arrival_times, centroids, exposure_times, random_stream
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.theodolite_scenario import MainDetector, Target
from ship_simulation.theodolite.flight import flight_path
from ship_simulation.theodolite.scene import ObservedBody, Scene, refracted_directions


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
    path_m = np.array([
        _points(camera, scene, targets, t_s + t, reported_rotation + rotation_error) for t in times.since_middle_s
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


def _points(
    camera: Camera, scene: Scene, targets: dict[str, TrueTarget], t_s: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return true points of the targets on the plane of the detector, m, shape (k, N, 2); NaN behind the tube."""
    rotation_mv = rotation_from_angles(np.zeros_like(rotation), np.zeros_like(rotation), rotation)
    return camera.points(_directions_n(scene, targets, t_s) @ scene.mount(t_s).rotation_nm @ rotation_mv)


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

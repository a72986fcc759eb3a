"""What the calibration telescope sees: the lights on its detector."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import SECOND_NS, arrival_times, random_stream, stamps
from ship_simulation.draws.streaks import centroids, exposure_times
from ship_simulation.scenario.theodolite_scenario import Telescope
from ship_simulation.theodolite.scene import MountState, Scene
from theodolite_calib.lights.image import Camera


@dataclass(frozen=True)
class ImageSamples:
    """Exposures; the lights found in exposure i are those from ``first[i]`` up to ``first[i + 1]``.

    Attributes:
        time_ns: middles of the exposures, increasing, shape (n,).
        log_time_ns: moments of arrival, shape (n,).
        first: shape (n + 1,).
        beacon_ids: of all lights of the scenario.
        light: which of them each found one is, shape (k,).
        point_m: on the detector, along right and up, shape (k, 2).
        sigma_m: of each coordinate, of a light at rest.
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    first: np.ndarray
    beacon_ids: tuple[str, ...]
    light: np.ndarray
    point_m: FloatArray
    sigma_m: float

    def sightings(self, exposure: int) -> list[tuple[str, FloatArray]]:
        """(id, point on the detector, shape (2,)) of each light in an exposure."""
        rows = range(self.first[exposure], self.first[exposure + 1])
        return [(self.beacon_ids[self.light[row]], self.point_m[row]) for row in rows]


def expose(config: Telescope, scene: Scene, start_ns: int, duration_s: float, seed: int) -> ImageSamples:
    """All exposures of a run, lights or none."""
    time_ns = stamps(start_ns, config.rate_hz, config.phase_s, duration_s)
    t_s = (time_ns - start_ns) / SECOND_NS
    noise = random_stream(seed, "theodolite.detection").standard_normal((time_ns.size, len(scene.lights), 2))
    times = exposure_times(config.exposure_s)
    way_m = np.array([points_on_detector(config, scene, t_s + t, scene.mount(t_s + t)) for t in times.since_middle_s])
    point_m = centroids(times, way_m, config.psf_sigma_m, config.sigma_m, noise)
    seen = in_view(config, scene, t_s, point_m)
    arrival = random_stream(seed, "theodolite.telescope.arrival")
    return ImageSamples(
        time_ns=time_ns,
        log_time_ns=arrival_times(time_ns, config.latency_s, config.jitter_s, arrival),
        first=np.append(0, np.cumsum(seen.sum(axis=1))),
        beacon_ids=tuple(scene.lights),
        light=np.nonzero(seen)[1],
        point_m=point_m[seen],
        sigma_m=config.sigma_m,
    )


def points_on_detector(config: Telescope, scene: Scene, t_s: FloatArray, mount: MountState) -> FloatArray:
    """Where the lights truly are on the plane of the detector, m, shape (k, N, 2); NaN behind the telescope."""
    principal_point_m = np.array([config.principal_x_m, config.principal_z_m])
    camera = Camera(scene.theodolite.focal_length_m, 0.0, principal_point_m)
    return camera.points(scene.directions_n(t_s, mount) @ scene.rotation_nt(mount))


def in_view(config: Telescope, scene: Scene, t_s: FloatArray, point_m: FloatArray) -> np.ndarray:
    """Whether the lights are there, not hidden, and on the detector, shape (k, N)."""
    on_detector = np.all(np.abs(point_m) <= 0.5 * np.array([config.width_m, config.height_m]), axis=-1)
    shown = [light.shows(t_s) for light in scene.lights.values()]
    return on_detector & (np.stack(shown, axis=-1) if shown else np.empty((t_s.size, 0), dtype=bool))

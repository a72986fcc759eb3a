"""Star cameras on the theodolite, which rotate with its main axis and measure like star sensors."""

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import exposure_times, random_stream
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.scenario import StarTelescope
from ship_simulation.ship.attitude_device import DeviceExposures
from ship_simulation.stars.sky import TrueSky
from ship_simulation.stars.star_sightings import StarSightings, simulate_sightings
from ship_simulation.theodolite.scene import Scene


def draw_parallelism(camera_id: str, config: StarTelescope, seed: int) -> FloatArray:
    """Return the true azimuth, elevation and roll of the main axis in a camera, rad, shape (3,)."""
    errors = random_stream(seed, f"{_source(camera_id)}.parallelism").standard_normal(3)
    return config.parallelism + config.parallelism_sigma * errors


def simulate_mount_stars(
    camera_id: str,
    config: StarTelescope,
    parallelism: FloatArray,
    scene: Scene,
    sky: TrueSky,
    stretch: Stretch,
    draws: Draws,
) -> StarSightings:
    """Return the exposures of a camera in a stretch; ``parallelism`` is from :func:`draw_parallelism`."""
    motion = _motion(config, parallelism, scene, stretch)
    sightings, _ = simulate_sightings(_source(camera_id), config, motion, sky, draws)
    return sightings


def _motion(config: StarTelescope, parallelism: FloatArray, scene: Scene, stretch: Stretch) -> DeviceExposures:
    """Return the attitude of a camera: R_camera(t) = R_main(t) R(azimuth, elevation, roll)^T."""
    time_ns = stretch.stamps(config.rate_hz, config.phase_s)
    since_start_s = (time_ns - stretch.start_ns) / SECOND_NS
    times = exposure_times(config.exposure_s)
    rotation_sm = rotation_from_angles(*parallelism)

    def rotation_ns(t_s: FloatArray) -> FloatArray:
        turned: FloatArray = scene.mount(t_s).rotation_nm @ rotation_sm.T
        return turned

    middle_ns = rotation_ns(since_start_s)
    passing = [rotation_ns(since_start_s + t_s) for t_s in times.since_middle_s] if config.exposure_s else [middle_ns]
    return DeviceExposures(
        time_ns=time_ns,
        since_start_s=since_start_s,
        valid_ns=time_ns,
        rotation_nv=middle_ns,
        times=times,
        exposure_nv=np.array(passing),
    )


def _source(camera_id: str) -> str:
    """Return the name of a camera's random streams."""
    return f"theodolite.telescopes.{camera_id}"

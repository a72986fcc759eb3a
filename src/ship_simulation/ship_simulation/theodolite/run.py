"""The theodolite's part of a simulated voyage as arrays: measurements, arrival times, and the truth.

Star cameras on the theodolite rotate with its main axis and measure like star sensors.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_simulation.random_draws import Draws, Stretch, exposure_times, random_stream, truth_indices
from ship_simulation.scenario.scenario import Scenario, StarTelescope
from ship_simulation.ship.attitude_device import DeviceExposures
from ship_simulation.ship.motion import Carrier
from ship_simulation.stars.sky import TrueSky
from ship_simulation.stars.star_sightings import StarSightings, simulate_sightings
from ship_simulation.theodolite.devices import (
    BaselineSamples,
    DroneSamples,
    EncoderSamples,
    ImageSamples,
    TargetSamples,
    draw_targets,
    is_in_view,
    points_on_detector,
    simulate_baselines,
    simulate_drone_attitude,
    simulate_encoders,
    simulate_images,
    simulate_targets,
)
from ship_simulation.theodolite.scene import MountState, Scene, draw_scene


def draw_parallelism(camera_id: str, config: StarTelescope, seed: int) -> FloatArray:
    """Return the true azimuth, elevation and roll of the main axis in a camera, rad, shape (3,)."""
    errors = random_stream(seed, f"{_source(camera_id)}.parallelism").standard_normal(3)
    return config.parallelism + config.parallelism_sigma * errors


def _motion(config: StarTelescope, parallelism: FloatArray, scene: Scene, stretch: Stretch) -> DeviceExposures:
    """Return the exposures of a camera in a stretch: R_camera(t) = R_main(t) R(azimuth, elevation, roll)^T."""
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


@dataclass(frozen=True)
class PointingTruth:
    """The true quantities that the theodolite's devices measure.

    Attributes:
        encoder_index: indices of the encoder samples at whose stamps the truth is given, shape (m,): the first sample
            in each tenth of a second, and the last sample of the voyage.
        mount: the true mount at those stamps.
        rotation_nt: horizon from telescope at those stamps, shape (m, 3, 3).
        beacon_count: number of lights in the telescope's view at those stamps, shape (m,).
        scene: all true quantities, at any time.
        star_parallelism: id of a star camera → true angles of the main axis in the camera, rad, shape (3,).
    """

    encoder_index: np.ndarray
    mount: MountState
    rotation_nt: FloatArray
    beacon_count: np.ndarray
    scene: Scene
    star_parallelism: dict[str, FloatArray]


@dataclass(frozen=True)
class TheodoliteRun:
    """One draw of a theodolite with its lights, targets and stars. Keys are the ids of drones or of star cameras."""

    encoder: EncoderSamples
    images: ImageSamples
    targets: TargetSamples
    stars: dict[str, StarSightings]
    baselines: dict[str, BaselineSamples]
    drones: dict[str, DroneSamples]
    truth: PointingTruth


def simulate_theodolite(
    scenario: Scenario, carrier: Carrier, sky: TrueSky | None, stretch: Stretch, draws: Draws
) -> TheodoliteRun:
    """Return the theodolite's part of a stretch; ``sky`` is None only if the theodolite has no star cameras.

    Raises:
        BadInput: the theodolite would have to point along its vertical axis, or a recorded motion is too short.
    """
    config = scenario.theodolite
    scene = draw_scene(scenario, carrier, draws)
    antenna = config.ship_antenna
    ship_antenna = draws.correlated_error(
        "theodolite.ship_antenna", stretch.duration_s, np.full(3, antenna.sigma_m), antenna.time_s
    )
    time_ns = stretch.stamps(config.encoder.rate_hz, config.encoder.phase_s)
    mount = scene.mount((time_ns - stretch.start_ns) / SECOND_NS)
    parallelism = {key: draw_parallelism(key, camera, draws.seed) for key, camera in scenario.telescopes.items()}
    return TheodoliteRun(
        encoder=simulate_encoders(config.encoder, mount, stretch, draws),
        images=simulate_images(config.telescope, scene, stretch, draws),
        targets=simulate_targets(config.main_detector, draw_targets(scenario, draws), scene, stretch, draws),
        stars={
            key: simulate_sightings(
                _source(key), camera, _motion(camera, parallelism[key], scene, stretch), sky, draws
            )[0]
            for key, camera in scenario.telescopes.items()
            if sky is not None
        },
        baselines={key: simulate_baselines(key, scene, ship_antenna, stretch, draws) for key in scene.beacons},
        drones={key: simulate_drone_attitude(key, light, stretch, draws) for key, light in scene.beacons.items()},
        truth=_truth(scenario, scene, parallelism, mount, time_ns, stretch),
    )


def _truth(
    scenario: Scenario,
    scene: Scene,
    parallelism: dict[str, FloatArray],
    mount: MountState,
    time_ns: np.ndarray,
    stretch: Stretch,
) -> PointingTruth:
    encoder = scenario.theodolite.encoder
    index = truth_indices(time_ns, stretch.start_ns, stretch.contains_last(encoder.rate_hz, encoder.phase_s))
    chosen = MountState(*(getattr(mount, field)[index] for field in vars(mount)))
    t_s = (time_ns[index] - stretch.start_ns) / SECOND_NS
    telescope = scenario.theodolite.telescope
    point_m = points_on_detector(telescope, scene, t_s, chosen)
    return PointingTruth(
        encoder_index=index,
        mount=chosen,
        rotation_nt=scene.rotation_nt(chosen),
        beacon_count=is_in_view(telescope, scene, t_s, point_m).sum(axis=1),
        scene=scene,
        star_parallelism=parallelism,
    )

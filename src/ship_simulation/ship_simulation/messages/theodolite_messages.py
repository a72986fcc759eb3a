"""Messages of the theodolite and of the drones from a run, and the truth about theodolite and targets."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import ENU_FROM_HORIZON, enu_covariance
from ship_geometry.mount.axes import NAMES
from ship_simulation.messages.ship_messages import (
    LazyRows,
    Maker,
    angle_rows,
    make_imu,
    make_vector,
    observations_maker,
    quaternion_rows,
    rate_rows,
)
from ship_simulation.random_draws import first_in_each_second
from ship_simulation.scenario.names import (
    ANTENNA_FRAME,
    BASELINE,
    ENCODER,
    ENCODER_TOPIC,
    IMAGE,
    IMAGE_TOPIC,
    MAIN_DETECTOR_FRAME,
    MOUNT_FRAME,
    SHIP_ANTENNA_ID,
    TARGET,
    TARGET_TOPIC,
    TELESCOPE_FRAME,
    TELESCOPE_ID,
    baseline_topic,
    beacon_frame,
    drone_topic,
    mount_camera_frame,
    mount_stars_topic,
)
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.theodolite_scenario import MainDetector
from ship_simulation.theodolite.devices import (
    BaselineSamples,
    DroneSamples,
    EncoderSamples,
    ImageSamples,
    TargetSamples,
)
from ship_simulation.theodolite.run import TheodoliteRun

MAIN_FRAME, HORIZON_FRAME = "theodolite_main", "horizon"

_TWO_LIGHTS, _ONE_LIGHT, _ENCODER = 0, 1, 2
_EXACT = np.zeros(9)
"""Covariance of a quantity without error."""

CALIBRATION_NAMES = (
    *NAMES,
    "focal_length",
    "telescope_azimuth",
    "telescope_elevation",
    "telescope_rotation",
    "deformation_bow",
    "deformation_up",
    "deformation_starboard",
)
"""Names in truth/calibration; the names telescope_... are angles of the main axis in the telescope."""

_CAMERA_ANGLES = "azimuth", "elevation", "roll"
"""Names of the angles of the main axis in a star camera, after the prefix ``telescopes.<id>.``"""


def theodolite_sources(
    run: TheodoliteRun, scenario: Scenario, factory: MessageFactory
) -> dict[str, tuple[np.ndarray, np.ndarray, Maker]]:
    """Return topic → stamps, log times and maker of messages."""
    theodolite = scenario.theodolite
    image = image_maker(run.images, theodolite.telescope.exposure_s, factory)
    sources = {
        ENCODER_TOPIC: (run.encoder.time_ns, run.encoder.log_time_ns, encoder_maker(run.encoder, factory)),
        IMAGE_TOPIC: (run.images.time_ns, run.images.log_time_ns, image),
    }
    if scenario.targets:
        target = target_maker(run.targets, theodolite.main_detector, factory)
        sources[TARGET_TOPIC] = run.targets.time_ns, run.targets.log_time_ns, target
    for key, stars in run.stars.items():
        exposure_s = scenario.telescopes[key].exposure_s
        maker = observations_maker(key, mount_camera_frame(key), stars, exposure_s, factory)
        sources[mount_stars_topic(key)] = stars.time_ns, stars.log_time_ns, maker
    for key, baselines in run.baselines.items():
        maker = baseline_maker(key, baselines, factory)
        sources[baseline_topic(key)] = baselines.time_ns, baselines.log_time_ns, maker
    for key, drone in run.drones.items():
        sources[drone_topic(key)] = drone.time_ns, drone.log_time_ns, drone_maker(key, drone, factory)
    return sources


def encoder_maker(samples: EncoderSamples, factory: MessageFactory) -> Maker:
    """Return the maker of theodolite/encoder."""

    def make(stamp: int, value: int) -> Any:
        return factory.make(
            ENCODER,
            header=make_header(factory, int(samples.time_ns[stamp]), MOUNT_FRAME),
            azimuth=float(samples.azimuth[value]),
            elevation=float(samples.elevation[value]),
            sigma=samples.sigma,
            status=0,
        )

    return make


def image_maker(samples: ImageSamples, exposure_s: float, factory: MessageFactory) -> Maker:
    """Return the maker of theodolite/beacons."""

    def make(stamp: int, value: int) -> Any:
        lights = [
            factory.make(
                "ship_msgs/msg/BeaconSighting",
                beacon_id=beacon_id,
                x=float(point_m[0]),
                z=float(point_m[1]),
                sigma=samples.sigma_m,
            )
            for beacon_id, point_m in samples.sightings(value)
        ]
        return factory.make(
            IMAGE,
            header=make_header(factory, int(samples.time_ns[stamp]), TELESCOPE_FRAME),
            telescope_id=TELESCOPE_ID,
            exposure_s=exposure_s,
            beacons=lights,
        )

    return make


def baseline_maker(rover_id: str, samples: BaselineSamples, factory: MessageFactory) -> Maker:
    """Return the maker of beacon/<id>/baseline, and of ship/baseline."""
    enu_m: LazyRows[list[float]] = LazyRows(lambda part: (samples.baseline_n[part] @ ENU_FROM_HORIZON.T).tolist())
    covariances = LazyRows(lambda part: list(enu_covariance(samples.covariance_n[part]).reshape(-1, 9)))

    def make(stamp: int, value: int) -> Any:
        return factory.make(
            BASELINE,
            header=make_header(factory, int(samples.time_ns[stamp]), ANTENNA_FRAME),
            base_id=SHIP_ANTENNA_ID,
            rover_id=rover_id,
            enu=make_vector(factory, enu_m[value]),
            covariance=covariances[value],
            fix=int(samples.fix[value]),
            age_s=float("nan"),
            satellites=0,
        )

    return make


def drone_maker(beacon_id: str, samples: DroneSamples, factory: MessageFactory) -> Maker:
    """Return the maker of beacon/<id>/imu. The covariance of the orientation describes its total error."""
    quaternions = quaternion_rows(samples.rotation_nb)
    rates = rate_rows(samples.rate_b)
    covariance = enu_covariance(samples.covariance_n).ravel()

    def make(stamp: int, value: int) -> Any:
        header = make_header(factory, int(samples.time_ns[stamp]), beacon_frame(beacon_id))
        return make_imu(factory, header, quaternions[value], covariance, rates[value], _EXACT)

    return make


def target_maker(samples: TargetSamples, config: MainDetector, factory: MessageFactory) -> Maker:
    """Return the maker of theodolite/target."""

    def make(stamp: int, value: int) -> Any:
        x, z = samples.point_m[value].tolist()
        return factory.make(
            TARGET,
            header=make_header(factory, int(samples.time_ns[stamp]), MAIN_DETECTOR_FRAME),
            target_id=samples.target_ids[samples.target[value]],
            x=x,
            z=z,
            sigma=config.sigma_m,
            exposure_s=config.exposure_s,
            detector_rotation=float(samples.rotation[value]),
            range=float(samples.range_m[value]),
            range_sigma=float(samples.range_sigma_m[value]),
        )

    return make


def true_directions(samples: TargetSamples, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, TargetDirection) of each image: the true direction, and the position by the true range."""
    north, up, east = samples.direction_n.T
    azimuth, elevation = np.mod(np.arctan2(east, north), 2.0 * np.pi), np.arctan2(up, np.hypot(north, east))
    directions, positions = samples.direction_n @ ENU_FROM_HORIZON.T, samples.position_n @ ENU_FROM_HORIZON.T
    for row, time_ns in enumerate(samples.time_ns.tolist()):
        message = factory.make(
            "ship_msgs/msg/TargetDirection",
            header=make_header(factory, time_ns, HORIZON_FRAME),
            target_id=samples.target_ids[samples.target[row]],
            azimuth=float(azimuth[row]),
            elevation=float(elevation[row]),
            covariance=np.zeros(4),
            direction=make_vector(factory, directions[row].tolist()),
            direction_covariance=_EXACT,
            position=make_vector(factory, positions[row].tolist()),
            position_covariance=_EXACT,
            status=0,
        )
        yield time_ns, message


def true_pointings(run: TheodoliteRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, OpticalAxisPointing) at the stamps of the truth; the mode depends on the lights in view."""
    truth = run.truth
    main = angle_rows(truth.mount.rotation_nm)
    telescope = angle_rows(truth.rotation_nt)
    for row, time_ns in enumerate(map(int, run.encoder.time_ns[truth.encoder_index])):
        count = int(truth.beacon_count[row])
        message = factory.make(
            "ship_msgs/msg/OpticalAxisPointing",
            header=make_header(factory, time_ns, MAIN_FRAME),
            **dict(zip(("azimuth", "elevation", "image_rotation"), main[row], strict=True)),
            covariance=_EXACT,
            rotation_covariance=_EXACT,
            telescope_azimuth=telescope[row][0],
            telescope_elevation=telescope[row][1],
            telescope_rotation=telescope[row][2],
            mode=_TWO_LIGHTS if count >= 2 else _ONE_LIGHT if count else _ENCODER,
            status=0,
            light_count=count,
        )
        yield time_ns, message


def true_calibrations(
    run: TheodoliteRun, start_ns: int, ends: bool, factory: MessageFactory
) -> Iterator[tuple[int, Any]]:
    """Yield (stamp, TheodoliteCalibration) once per second at stamps of the truth, and at the voyage's last stamp."""
    truth, time_ns = run.truth, run.encoder.time_ns[run.truth.encoder_index]
    constants = truth.scene.theodolite
    constant = [*constants.axis_errors.vector(), constants.focal_length_m, *constants.parallelism]
    of_cameras = [angle for angles in truth.star_parallelism.values() for angle in angles.tolist()]
    names = [*CALIBRATION_NAMES]
    names += [f"telescopes.{id_}.{angle}" for id_ in truth.star_parallelism for angle in _CAMERA_ANGLES]
    for row in first_in_each_second(time_ns, start_ns, ends).tolist():
        stamp_ns = int(time_ns[row])
        message = factory.make(
            "ship_msgs/msg/TheodoliteCalibration",
            header=make_header(factory, stamp_ns, MOUNT_FRAME),
            names=names,
            values=np.array([*constant, *truth.mount.deformation_d[row], *of_cameras]),
            covariance=np.zeros(len(names) ** 2),
            units=["m" if name == "focal_length" else "rad" for name in names],
            unobservable=[],
            sighting_count=0,
            residual_rms=float("nan"),
        )
        yield stamp_ns, message

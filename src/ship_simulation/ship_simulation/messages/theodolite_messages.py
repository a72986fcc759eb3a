"""Messages of the theodolite and of the drones from the arrays of a run; what a maker is: :mod:`device_messages`."""

from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.ros_axes import ENU_FROM_HORIZON, enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_simulation.messages.device_messages import Maker, make_imu, make_vector
from ship_simulation.messages.topics import (
    BASELINE,
    ENCODER,
    ENCODER_TOPIC,
    IMAGE,
    IMAGE_TOPIC,
    baseline_topic,
    drone_topic,
)
from ship_simulation.theodolite.baselines import BaselineSamples
from ship_simulation.theodolite.drone_attitude import DroneSamples
from ship_simulation.theodolite.encoder import EncoderSamples
from ship_simulation.theodolite.images import ImageSamples
from ship_simulation.theodolite.run import TheodoliteRun

MOUNT_FRAME, TELESCOPE_FRAME, ANTENNA_FRAME = "theodolite", "telescope", "ship_antenna"
TELESCOPE_ID, SHIP_ANTENNA_ID = "calibration", "ship"

_UNKNOWN = float("nan")
_EXACT_RATE = np.zeros(9)


def beacon_frame(beacon_id: str) -> str:
    """frame_id of a drone."""
    return f"beacon_{beacon_id}"


def theodolite_sources(
    run: TheodoliteRun, exposure_s: float, factory: MessageFactory
) -> dict[str, tuple[np.ndarray, np.ndarray, Maker]]:
    """Topic → stamps, log times and maker of messages."""
    sources = {
        ENCODER_TOPIC: (run.encoder.time_ns, run.encoder.log_time_ns, encoder_maker(run.encoder, factory)),
        IMAGE_TOPIC: (run.images.time_ns, run.images.log_time_ns, image_maker(run.images, exposure_s, factory)),
    }
    for key, baselines in run.baselines.items():
        maker = baseline_maker(key, baselines, factory)
        sources[baseline_topic(key)] = baselines.time_ns, baselines.log_time_ns, maker
    for key, drone in run.drones.items():
        sources[drone_topic(key)] = drone.time_ns, drone.log_time_ns, drone_maker(key, drone, factory)
    return sources


def encoder_maker(samples: EncoderSamples, factory: MessageFactory) -> Maker:
    """Maker of theodolite/encoder."""

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
    """Maker of theodolite/beacons."""

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


def baseline_maker(beacon_id: str, samples: BaselineSamples, factory: MessageFactory) -> Maker:
    """Maker of beacon/<id>/baseline."""
    enu_m = (samples.baseline_n @ ENU_FROM_HORIZON.T).tolist()
    covariances = enu_covariance(samples.covariance_n).reshape(-1, 9)

    def make(stamp: int, value: int) -> Any:
        return factory.make(
            BASELINE,
            header=make_header(factory, int(samples.time_ns[stamp]), ANTENNA_FRAME),
            base_id=SHIP_ANTENNA_ID,
            rover_id=beacon_id,
            enu=make_vector(factory, enu_m[value]),
            covariance=covariances[value],
            fix=int(samples.fix[value]),
            age_s=_UNKNOWN,
            satellites=0,
        )

    return make


def drone_maker(beacon_id: str, samples: DroneSamples, factory: MessageFactory) -> Maker:
    """Maker of beacon/<id>/imu. The orientation's covariance is that of its total error."""
    quaternions = quaternion_from_rotation(samples.rotation_nb).tolist()
    rates = flu_from_device_vector(samples.rate_b).tolist()
    covariance = enu_covariance(samples.covariance_n).ravel()

    def make(stamp: int, value: int) -> Any:
        header = make_header(factory, int(samples.time_ns[stamp]), beacon_frame(beacon_id))
        return make_imu(factory, header, quaternions[value], covariance, rates[value], _EXACT_RATE)

    return make

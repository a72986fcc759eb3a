"""Inputs of ``ship_attitude`` from the sensors that are compared with the INS: topic, reader and core method."""

import functools
from collections.abc import Callable, Iterator
from typing import Any

from ship_attitude_star.messages import input_messages
from ship_attitude_star.messages.attitude_messages import IMU_TYPE
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig, StarSensorConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.measurements.devices import BASELINE
from ship_node.adapters.adapter import Feed
from ship_node.health.duplicate_publishers import INNOVATION
from ship_node.messages.field_checks import ReadMessage, ReadRows
from ship_node.messages.inputs_outputs import InputTopic
from ship_stars.messages import star_messages
from ship_stars.sky.sky_model import SkyModel

_STAR_TYPES = {
    "horizon_attitude": "ship_msgs/msg/StarHorizonAttitude",
    "solution": "ship_msgs/msg/StarHorizonAttitude",
    "observations": "ship_msgs/msg/StarObservationArray",
    "inertial_attitude": "ship_msgs/msg/StarInertialAttitude",
}


def sensor_feeds(config: ShipAttitudeConfig, core: ShipAttitudeCore, sky_model: SkyModel | None) -> Iterator[Feed]:
    """Yield the inputs of all sensors; each star sensor has one topic only.

    Raises:
        ParameterError: the camera of a sensor that gives single stars is incomplete.
    """

    def feed(source: str, topic: str, type_name: str, read: Callable[..., ReadMessage[Any]], **options: Any) -> Feed:
        given = InputTopic(topic, type_name, False, depth=1000, is_configured=True)
        return Feed(given, source, read, core.add_measurement, has_decision=True, **options)

    for id_, star in config.star_sensors.items():
        topic, (read, read_rows) = f"star/{id_}/{star.input}", _star_readers(id_, star, sky_model)
        type_name = _STAR_TYPES[star.input]
        yield feed(f"star.{id_}", topic, type_name, read, read_rows=read_rows, stream_quantity=INNOVATION)
    for name, reference in config.references.items():
        read = functools.partial(input_messages.reference_measurement, name=name, config=reference)
        yield feed(f"reference.{name}", f"reference/{name}/imu", IMU_TYPE, read, stream_quantity=INNOVATION)
    if config.ship_baseline.is_aboard:
        read = functools.partial(input_messages.baseline, config=config.ship_baseline)
        yield feed(BASELINE, "ship/baseline", "ship_msgs/msg/RtkBaseline", read)


def _star_readers(
    id_: str, star: StarSensorConfig, sky_model: SkyModel | None
) -> tuple[Callable[..., ReadMessage[Any]], Callable[..., ReadRows] | None]:
    """Return the readers of a star sensor's messages: of single messages, and of blocks (None for some inputs)."""
    if star.input == "observations":
        assert sky_model is not None
        camera = star.camera.camera(f"star_sensors.{id_}.camera")
        sensor = star_messages.ExposingSensor(id_, star.frame_id, camera, star.camera, star.sensor_masks)
        return functools.partial(star_messages.star_exposure, sensor=sensor, catalogue=sky_model.catalogue), None
    if star.input == "inertial_attitude":
        return functools.partial(input_messages.inertial_attitude, sensor_id=id_, config=star), None
    read = functools.partial(input_messages.star_measurement, sensor_id=id_, config=star)
    return read, functools.partial(input_messages.star_attitudes, sensor_id=id_, config=star)

"""The input topics of ``ship_attitude``: what the messages of each become, and which method of the core takes them."""

from dataclasses import dataclass
from typing import Any

from ship_attitude_star.measurements.samples import AttitudeOutcome
from ship_attitude_star.ros import messages_in, star_messages_in
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Refusal
from ship_node.edge.messages_in import ins_sample
from ship_node.edge.topics import InputTopic

INS_TOPIC = "ins/imu"
_IMU = "sensor_msgs/msg/Imu"
_STAR_TYPES = {
    "horizon_attitude": "ship_msgs/msg/StarHorizonAttitude",
    "solution": "ship_msgs/msg/StarHorizonAttitude",
    "observations": "ship_msgs/msg/StarObservationArray",
    "inertial_attitude": "ship_msgs/msg/StarInertialAttitude",
}


@dataclass(frozen=True)
class Taken:
    """A message that the core has been given.

    Attributes:
        time_ns: its stamp.
        outcome: what it led to.
        judged: whether a decision follows; otherwise the message is used as soon as it is not refused.
        covariance_known: False where the configured sigma stands in.
        stars_refused: stars that could not be read, by name.
    """

    time_ns: int
    outcome: AttitudeOutcome
    judged: bool = True
    covariance_known: bool = True
    stars_refused: tuple[tuple[str, Refusal], ...] = ()


class ShipInputs:
    """Topics and their way into the core.

    Args:
        config: the node's parameters.
        core: takes the measurements.
        watch: the sky; None where no sensor looks at it itself.

    Raises:
        ParameterError: a sensor that gives single stars has no camera.
    """

    def __init__(self, config: ShipAttitudeConfig, core: ShipAttitudeCore, watch: SkyWatch | None) -> None:
        self.config = config
        self._core, self._watch = core, watch
        self._cameras = {
            id_: star.camera.camera(f"star_sensors.{id_}.camera")
            for id_, star in config.star_sensors.items()
            if star.input == "observations"
        }
        stars = {f"star/{id_}/{star.input}": f"star.{id_}" for id_, star in config.star_sensors.items()}
        references = {f"reference/{name}/imu": f"reference.{name}" for name in config.references}
        sky = () if watch is None else messages_in.TOPICS
        self._sky_topics = {entry.topic for entry in sky}
        # Each star sensor feeds the filter by exactly one topic: no star counts twice.
        self.sources = {INS_TOPIC: "ins", **stars, **references, **{topic: topic for topic in self._sky_topics}}
        types = {topic: _STAR_TYPES[topic.rpartition("/")[2]] for topic in stars}
        self.topics: tuple[InputTopic, ...] = (
            InputTopic(INS_TOPIC, _IMU, required=True, depth=1000),
            *(InputTopic(topic, type_name, False, depth=1000, named=True) for topic, type_name in types.items()),
            *(InputTopic(topic, _IMU, False, depth=1000, named=True) for topic in references),
            *sky,
        )

    def take(self, topic: str, message: Any, receive_ns: int, waiting_ns: int) -> Taken:
        """Give a message to the core.

        Args:
            topic: it came on.
            message: it.
            receive_ns: when it came, by the node's clock.
            waiting_ns: the same in the time of waiting.

        Raises:
            Refused: it cannot be read; nothing has changed.
        """
        if topic == INS_TOPIC:
            sample = ins_sample(message, self.config.ins, receive_ns)
            outcome = self._core.add_ins(sample.value, waiting_ns)
            return Taken(sample.value.time_ns, outcome, judged=False, covariance_known=sample.covariance_known)
        if topic in self._sky_topics:
            told = messages_in.sky_input(topic, message, self.config.sky, receive_ns)
            outcome = self._core.add_sky_input(told)
            return Taken(told.time_ns, outcome, judged=False, covariance_known=told.sigma_known)
        kind, _, id_ = self.sources[topic].partition(".")
        if kind == "star" and self.config.star_sensors[id_].input == "observations":
            return self._take_stars(id_, message, receive_ns, waiting_ns)
        measurement: Measurement
        if kind == "reference":
            measurement = messages_in.reference_measurement(message, id_, self.config.references[id_], receive_ns)
        elif self.config.star_sensors[id_].input == "inertial_attitude":
            measurement = messages_in.inertial_attitude(message, id_, self.config.star_sensors[id_], receive_ns)
        else:
            measurement = messages_in.star_measurement(message, id_, self.config.star_sensors[id_], receive_ns)
        outcome = self._core.add_measurement(measurement, waiting_ns)
        return Taken(measurement.time_ns, outcome, covariance_known=measurement.covariance_known)

    def _take_stars(self, id_: str, message: Any, receive_ns: int, waiting_ns: int) -> Taken:
        sensor = self.config.star_sensors[id_]
        assert self._watch is not None
        exposure, unread = star_messages_in.star_exposure(
            message, id_, sensor.frame_id, self._cameras[id_], sensor.camera, self._watch.catalogue, receive_ns
        )
        if not message.stars:
            # The sensor works and sees no star: nothing to compare, and nothing wrong.
            return Taken(exposure.time_ns, AttitudeOutcome(), judged=False)
        return Taken(
            exposure.time_ns,
            self._core.add_measurement(exposure, waiting_ns),
            covariance_known=star_messages_in.sigmas_given(message),
            stars_refused=tuple((f"star {row + 1} of the message", refusal) for row, refusal in unread),
        )

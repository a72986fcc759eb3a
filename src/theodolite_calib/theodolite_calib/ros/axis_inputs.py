"""The input topics of ``optical_axis``: what the messages of each become, and which method of the core takes them."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.refusals import Refusal
from ship_node.edge.topics import InputTopic
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.measured.samples import PointingOutcome
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.ros import messages_in

ENCODER_TOPIC = "theodolite/encoder"
BEACONS_TOPIC = "theodolite/beacons"
_IMU = "sensor_msgs/msg/Imu"
_SHIP_TYPES = {"ship/attitude": "ship_msgs/msg/ShipAttitude", "ins/imu": _IMU}


@dataclass(frozen=True)
class Taken:
    """A message that the core has been given.

    Attributes:
        time_ns: its stamp.
        outcome: what it led to.
        judged: whether a decision follows; otherwise the message is used as soon as it is not refused.
        covariance_known: False where the configured sigma stands in.
        lights_refused: lights that could not be read, by name.
    """

    time_ns: int
    outcome: PointingOutcome
    judged: bool = False
    covariance_known: bool = True
    lights_refused: tuple[tuple[str, Refusal], ...] = ()


class AxisInputs:
    """Topics and their way into the core.

    Args:
        config: the node's parameters.
        core: takes the measurements.
    """

    def __init__(self, config: OpticalAxisConfig, core: OpticalAxisCore) -> None:
        self.config, self._core = config, core
        ship = config.ship.source
        baselines = {f"beacon/{id_}/baseline": f"baseline.{id_}" for id_ in config.beacons}
        imus = {f"beacon/{id_}/imu": f"drone.{id_}" for id_ in config.beacons}
        self.sources = {ENCODER_TOPIC: "encoder", ship: "ship", BEACONS_TOPIC: "lights", **baselines, **imus}
        self.topics: tuple[InputTopic, ...] = (
            InputTopic(ENCODER_TOPIC, "ship_msgs/msg/TheodoliteEncoder", required=True, depth=1000),
            InputTopic(ship, _SHIP_TYPES[ship], required=True, depth=1000),
            InputTopic(BEACONS_TOPIC, "ship_msgs/msg/BeaconImage", required=False, depth=1000),
            *(InputTopic(topic, "ship_msgs/msg/RtkBaseline", required=False, depth=1000) for topic in baselines),
            *(InputTopic(topic, _IMU, required=False, depth=1000) for topic in imus),
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
        kind, _, id_ = self.sources[topic].partition(".")
        config = self.config
        if kind == "lights":
            return self._take_exposure(message, receive_ns)
        if kind == "encoder":
            converted = messages_in.encoder(message, config, receive_ns)
            outcome = self._core.add_encoder(converted.value, waiting_ns)
        elif kind == "baseline":
            converted = messages_in.baseline(message, config.beacons[id_], config.least_fix, receive_ns)
            outcome = self._core.add_baseline(id_, converted.value)
        elif kind == "drone":
            converted = messages_in.drone_attitude(message, config.beacons[id_], receive_ns)
            outcome = self._core.add_drone_attitude(id_, converted.value)
        else:
            by_ins = topic == "ins/imu"
            read = messages_in.ins_attitude if by_ins else messages_in.ship_attitude
            converted = read(message, config, receive_ns)
            outcome = self._core.add_ship(converted.value, waiting_ns)
        return Taken(converted.value.time_ns, outcome, covariance_known=converted.covariance_known)

    def _take_exposure(self, message: Any, receive_ns: int) -> Taken:
        converted = messages_in.exposure(message, self.config, receive_ns)
        exposure = converted.value
        if not exposure.lights:
            # The telescope works and sees no light, or none that can be read: nothing to compare.
            return Taken(exposure.time_ns, PointingOutcome(), lights_refused=converted.lights_refused)
        return Taken(
            exposure.time_ns,
            self._core.add_exposure(exposure),
            judged=True,
            covariance_known=converted.covariance_known,
            lights_refused=converted.lights_refused,
        )

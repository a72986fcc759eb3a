"""Minimal adapter: Imu in, ShipAttitude with the same stamp out. Also an executable, for tests."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason
from ship_node.adapters.adapter import Overload, ServiceResult
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, diagnostic_array
from ship_node.messages.field_checks import MessageRejected, check_frame, stamp_ns, unit_quaternion
from ship_node.messages.inputs_outputs import Arrival, Batch, BatchOutputs, InputTopic, OutputMessage, OutputTopic
from ship_node.saved_files.saved_document import DISK, Files
from ship_testing.one_message import process_each

EXPLOSIVE_FRAME = "explosive"


@dataclass(frozen=True)
class GateConfig:
    """A group of live parameters."""

    probability: float = parameter(0.99, doc="gate", minimum=0.5, maximum=1.0, live=True)
    count: int = parameter(3, doc="refusals in a row", minimum=1, live=True)
    bias_deg: float = parameter(0.0, doc="no range", unit="deg", live=True)


@dataclass(frozen=True)
class SensorConfig:
    """One device of a mapping."""

    elevation_deg: float = parameter(doc="elevation", unit="deg", minimum=-90.0, maximum=90.0)
    mode: str = parameter("fast", doc="mode", choices=("fast", "slow"))


@dataclass(frozen=True)
class RelayConfig:
    """All parameters of the relay."""

    gate: GateConfig = section(GateConfig)
    sensors: dict[str, SensorConfig] = mapping_of("sensors by id")
    frame_id: str = parameter("", doc="frame_id expected")
    offsets_s: tuple[float, ...] = parameter((0.0, 1.0), doc="offsets", unit="s", maximum=9.0, live=True)


class RelayAdapter:
    """Relays every Imu as ShipAttitude."""

    node_name = "relay"
    config_type = RelayConfig
    services = ("reset", "explode")
    block_topics: frozenset[str] = frozenset()

    def __init__(self, config: RelayConfig, factory: MessageFactory, files: Files = DISK) -> None:
        self.config = config
        self.factory = factory
        self.inputs = (InputTopic("ins/imu", "sensor_msgs/msg/Imu", required=True, depth=100),)
        self.outputs = (
            OutputTopic("ship/attitude", "ship_msgs/msg/ShipAttitude"),
            OutputTopic("input_health", "ship_msgs/msg/InputHealth"),
            OutputTopic("ship/calibration", "ship_msgs/msg/AlignmentState", latched=True),
        )
        self.health = InputHealthMonitor(self.inputs)
        self.start_warnings: tuple[str, ...] = ()
        self.notices: list[str] = []
        self.changes: dict[str, Any] = {}
        self.ticks: list[int] = []
        self.node_times: list[int] = []
        self.resets: list[int] = []
        self.clock_steps: list[int] = []
        self.handled: list[int] = []
        self.overloads: list[Overload] = []
        self.overload_times_ns: list[int] = []
        self.duplicates: list[tuple[str, str]] = []

    def process(self, batch: Batch) -> BatchOutputs:
        return process_each(batch, self._relay, self.tick)

    def _relay(self, arrival: Arrival) -> list[OutputMessage]:
        topic, message, receive_ns = arrival.topic, arrival.message, arrival.receive_ns
        self.health.record_arrival(topic, arrival.waiting_ns)
        if message.header.frame_id == EXPLOSIVE_FRAME:
            raise RuntimeError("a defect of the adapter")
        try:
            time_ns = stamp_ns(message.header, receive_ns)
            check_frame(message.header.frame_id, self.config.frame_id)
            x, y, z, w = unit_quaternion(message.orientation)
        except MessageRejected as rejected:
            self.health.record_rejected(topic, rejected.rejection, receive_ns)
            return []
        self.health.record_accepted(topic, time_ns, receive_ns)
        self.handled.append(receive_ns)
        quaternion = self.factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        rate = self.factory.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        attitude = self.factory.make(
            "ship_msgs/msg/ShipAttitude",
            header={"stamp": time_ns, "frame_id": message.header.frame_id},
            heading=0.0,
            pitch=0.0,
            roll=0.0,
            covariance=np.zeros(9),
            orientation=quaternion,
            rotation_covariance=np.zeros(9),
            angular_velocity=rate,
            status=0,
            horizon=1,
            sources=["ins"],
            star_age_s=float("nan"),
        )
        return [("ship/attitude", attitude)]

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        self.ticks.append(now_ns if waiting_ns is None else waiting_ns)
        self.node_times.append(now_ns)
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        messages, statuses = self.health.messages_and_statuses(self.factory, now_ns, waiting_ns)
        published = [(DIAGNOSTICS_TOPIC, diagnostic_array(now_ns, self.node_name, statuses))]
        return published + [("input_health", message) for message in messages]

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        self.overloads.append(change)
        self.overload_times_ns.append(now_ns)
        for topic, count in change.cut.items():
            self.health.record_dropped(topic, count, Reason.BEHIND, change.text(self.node_name), now_ns)
        return []

    def clock_jumped_back(self, now_ns: int) -> list[OutputMessage]:
        self.resets.append(now_ns)
        self.health.restart()
        return []

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        self.clock_steps.append(step_ns)
        return []

    def service(self, name: str, now_ns: int) -> ServiceResult:
        if name == "explode":
            raise RuntimeError("a defect of a service")
        self.health.restart()
        return ServiceResult(True, "reset")

    def set_duplicate_publishers(self, topic: str, text: str) -> None:
        self.health.set_duplicate_publishers(topic, text)
        self.duplicates.append((topic, text))

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        if changes.get("gate.count") == 13:
            raise ParameterError("parameter 'gate.count' = 13 is not wanted by the adapter")
        self.changes |= changes


if __name__ == "__main__":
    from ship_node.live.node_runtime import run

    sys.exit(run(RelayAdapter))

"""Which topics a recorder takes, with what quality of service, and which of them say that a voyage goes on."""

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ship_bags.mcap.bag_writer import qos_text

# Deep enough for ten seconds at 100 Hz, or one at 1 kHz, of a recorder that the disk holds up.
DEPTH = 1000

_LEFT_OUT = ("/clock",)
"""Left out unless named: /clock is the time of the log itself, which a player gives again."""

REPORTS = frozenset(
    {
        *("rosgraph_msgs/msg/Clock", "rcl_interfaces/msg/Log", "rcl_interfaces/msg/ParameterEvent"),
        *("diagnostic_msgs/msg/DiagnosticArray", "ship_msgs/msg/InputHealth", "ship_msgs/msg/AlignmentState"),
        *("ship_msgs/msg/ErrorBudget", "ship_msgs/msg/TheodoliteCalibration", "ship_msgs/msg/AttitudeErrorArcsec"),
        "ship_msgs/msg/PointingErrorArcsec",
    }
)
"""Types by which a node tells of itself, on its own clock, for as long as it lives: whether anything comes or not."""

_RESULTS = ("ship_msgs/msg/ShipAttitude", "ship_msgs/msg/OpticalAxisPointing")
"""Types of results, which a node without input goes on to put out as INVALID."""


def is_activity(type_name: str, kind: Any, data: bytes) -> bool:
    """Whether a message says that something goes on: a measurement, or a result that rests on one.

    Args:
        type_name: of the message.
        kind: its class.
        data: its CDR bytes.
    """
    if type_name not in _RESULTS:
        return type_name not in REPORTS
    return bool(deserialize_message(data, kind).status != kind.INVALID)


def offers(node: Node, wanted: Sequence[str]) -> dict[str, list[TopicEndpointInfo]]:
    """Topics to record that somebody publishes now, with what their publishers offer.

    Args:
        node: the recording node.
        wanted: names of topics; empty means all but hidden ones and /clock.
    """
    names = {node.resolve_topic_name(name) for name in wanted}
    found = {}
    for topic, _ in node.get_topic_names_and_types():
        if topic in names if wanted else topic not in _LEFT_OUT and "/_" not in topic:
            endpoints = node.get_publishers_info_by_topic(topic)
            if endpoints:
                found[topic] = endpoints
    return found


def adapted_qos(endpoints: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """The strongest quality of service that all publishers of a topic offer."""
    profiles = [endpoint.qos_profile for endpoint in endpoints]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def qos_texts(endpoints: Sequence[TopicEndpointInfo]) -> str:
    """What the publishers of a topic offer, one entry each, as rosbag2 notes it.

    DDS does not tell the history of a distant publisher: it is unknown and of depth 0, there as here.
    """
    profiles = (endpoint.qos_profile for endpoint in endpoints)
    return "".join(
        qos_text(
            profile.history.name.lower(),
            profile.depth,
            profile.reliability.name.lower(),
            profile.durability.name.lower(),
        )
        for profile in profiles
    )

"""Network information for a recorder: topics, subscriptions, and the nodes' parameters.

Some topics show activity; other topics report a node's own state, even without input. The parameters are requested
through the nodes' services and become a suite file in the recording.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ship_bags.mcap.bag_writer import qos_text
from ship_bags.parameter_yaml import full_name, is_runtime_parameter, sections_text
from ship_bags.topic_names import is_topic_parameter

DEPTH = 1000
"""Queue depth per topic for delays by the disk: ten seconds at 100 Hz, one second at 1 kHz."""

_EXCLUDED_TOPICS = ("/clock",)
"""Topics that are recorded only if named; a player publishes /clock itself, from the times of the log."""

STATUS_TYPES = frozenset(
    {
        *("rosgraph_msgs/msg/Clock", "rcl_interfaces/msg/Log", "rcl_interfaces/msg/ParameterEvent"),
        *("diagnostic_msgs/msg/DiagnosticArray", "ship_msgs/msg/InputHealth", "ship_msgs/msg/AlignmentState"),
        *("ship_msgs/msg/ErrorBudget", "ship_msgs/msg/TheodoliteCalibration", "ship_msgs/msg/AttitudeErrorArcsec"),
        *("ship_msgs/msg/PointingErrorArcsec", "ship_msgs/msg/AlertArray", "ship_msgs/msg/SuiteState"),
        "tf2_msgs/msg/TFMessage",
    }
)
"""Types of messages with which a running node reports its own state periodically, even without input."""

_RESULTS = ("ship_msgs/msg/ShipAttitude", "ship_msgs/msg/AttitudeDeg", "ship_msgs/msg/OpticalAxisPointing")
"""Types of results: a node without input continues to publish them, as INVALID."""

ANSWER_TIMEOUT_S = 5.0
"""Timeout of a node's answers, from the discovery of the node, s."""

MAX_NODES = 200
MAX_PARAMETERS = 5000
"""Maximum number of nodes that are queried, and of parameters that are taken from each node."""


def is_activity(type_name: str, kind: Any, data: bytes) -> bool:
    """Return True if a message shows activity: a measurement, or a result that depends on one.

    Args:
        type_name: type of the message.
        kind: class of the message.
        data: CDR bytes of the message.
    """
    if type_name not in _RESULTS:
        return type_name not in STATUS_TYPES
    return bool(deserialize_message(data, kind).status != kind.INVALID)


def offered_topics(node: Node, wanted: Sequence[str]) -> dict[str, list[TopicEndpointInfo]]:
    """Return the topics to record that have publishers now, with the endpoints of the publishers.

    Args:
        node: the recording node.
        wanted: names of topics; empty for all but hidden topics and /clock.
    """
    names = {node.resolve_topic_name(name) for name in wanted}
    found = {}
    for topic, _ in node.get_topic_names_and_types():
        if topic in names if wanted else topic not in _EXCLUDED_TOPICS and "/_" not in topic:
            endpoints = node.get_publishers_info_by_topic(topic)
            if endpoints:
                found[topic] = endpoints
    return found


def adapted_qos(endpoints: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return the strongest quality of service that all publishers of a topic offer."""
    profiles = [endpoint.qos_profile for endpoint in endpoints]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def qos_texts(endpoints: Sequence[TopicEndpointInfo]) -> str:
    """Return the QoS that the publishers of a topic offer, one entry each, as rosbag2 stores it.

    DDS does not transmit the history of a remote publisher, so it is stored as unknown with depth 0, as in rosbag2.
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


@dataclass
class _ParameterRequest:
    """Query of one node: first for the names, then for the values."""

    deadline_s: float
    clients: list[Client] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    answer: Future | None = None


class ParameterCollector:
    """Collector of the nodes' parameters; each node is queried once. :meth:`update` must be called periodically.

    Attributes:
        unanswered: full names of nodes that did not answer.

    Args:
        node: the recording node, which is not queried.
        attach: called with the suite file when it has grown and no query is pending.
    """

    def __init__(self, node: Node, attach: Callable[[str], None]) -> None:
        self.unanswered: list[str] = []
        self._node, self._attach = node, attach
        self._known = {full_name(node.get_name(), node.get_namespace())}
        self._requests: dict[str, _ParameterRequest] = {}
        self._received: dict[str, dict[str, Any]] = {}
        self._attached = 0

    @property
    def is_pending(self) -> bool:
        """True if a query is pending."""
        return bool(self._requests)

    def update(self) -> None:
        """Query new nodes, process answers, give up nodes after the timeout."""
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = full_name(name, namespace)
            if full not in self._known and not name.startswith("_") and len(self._known) <= MAX_NODES:
                self._known.add(full)
                self._requests[full] = self._request(full)
        for full, request in list(self._requests.items()):
            if self._continue_request(full, request):
                self._finish_request(full)
            elif time.monotonic() > request.deadline_s:
                self.unanswered.append(full)
                self._finish_request(full)
        if not self._requests and len(self._received) > self._attached:
            self._attached = len(self._received)
            self._attach(sections_text(self._received))

    def close(self) -> None:
        """End the queries; pending nodes count as unanswered."""
        for full in list(self._requests):
            self.unanswered.append(full)
            self._finish_request(full)
        if len(self._received) > self._attached:
            self._attach(sections_text(self._received))

    def _request(self, full: str) -> _ParameterRequest:
        kinds = ((ListParameters, "list_parameters"), (GetParameters, "get_parameters"))
        clients = [self._node.create_client(kind, f"{full}/{service}") for kind, service in kinds]
        return _ParameterRequest(time.monotonic() + ANSWER_TIMEOUT_S, clients)

    def _continue_request(self, full: str, request: _ParameterRequest) -> bool:
        """Send a node the next request after its answer; return True after the last answer."""
        by_name, by_value = request.clients
        if request.answer is None:
            if by_name.service_is_ready() and by_value.service_is_ready():
                request.answer = by_name.call_async(
                    ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
                )
            return False
        if not request.answer.done():
            return False
        answer = request.answer.result()
        if not request.names:
            # Parameters of the node runtime (clock, black box) do not change the results and are left out.
            names = answer.result.names[:MAX_PARAMETERS]
            request.names = [name for name in names if is_topic_parameter(name) or not is_runtime_parameter(name)]
            if not request.names:
                return True
            request.answer = by_value.call_async(GetParameters.Request(names=request.names))
            return False
        values = map(parameter_value_to_python, answer.values)
        self._received[full] = {
            name: list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
            for name, value in zip(request.names, values, strict=False)
            if value is not None and not _has_bytes(value)
        }
        return True

    def _finish_request(self, full: str) -> None:
        for client in self._requests.pop(full).clients:
            self._node.destroy_client(client)


def _has_bytes(value: Any) -> bool:
    """Return True if a value contains bytes, which no parameter file can represent."""
    return isinstance(value, (bytes, list)) and any(isinstance(element, bytes) for element in value)

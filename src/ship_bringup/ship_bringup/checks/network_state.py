"""State of the live network before the suite starts: its nodes, and the topics of sensors during some seconds.

This is the only check that needs ROS. It subscribes like the nodes of the suite and publishes nothing.
"""

import contextlib
import math
import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import command_node, is_security_requested
from ship_bags.message_factory import message_class
from ship_bags.parameter_yaml import full_name
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bringup.security.demand import ENCLAVE
from ship_node.messages.inputs_outputs import InputTopic

NAME = "preflight"

STRONGER_QOS = frozenset({"reliable", "transient_local"})
"""Qualities of service that a subscriber may require; publishers that lack a required quality are not received."""

_DEPTH = 200
_MAX_STAMPS = 200
"""Maximum number of newest messages of a topic whose stamps are compared with the clock."""

_DISCOVERY_S = 4.0
"""Time for discovery, s.

On one machine discovery takes 0.06 s to 1.6 s. If the first announcements of a participant are lost, the next follow
after 3 s.
"""
_FIRST_MESSAGE_TIMEOUT_S = 12.0
"""Additional timeout for the first message of a required or configured topic, s.

On a busy machine the publisher of the topic may be discovered late, and connected even later.
"""

_POLL_S = 0.1
"""Period at which the end conditions are checked, s."""

_UNNAMED = "_NODE_NAME_UNKNOWN_"
"""Node name of a publisher that was discovered before its node."""
_NODE_NAME_TIMEOUT_S = 5.0
"""Timeout for the name of a publisher's node, s; a publisher outside a ROS node never gets a name."""


@dataclass(frozen=True)
class Publisher:
    """A publisher of a topic: full name of its node, type of the topic, and the qualities of STRONGER_QOS it offers."""

    node: str
    type_name: str
    offered_qos: frozenset[str] = STRONGER_QOS


@dataclass(frozen=True)
class ObservedTopic:
    """Observations of one input of the suite.

    Attributes:
        input: the topic.
        publishers: publishers of the topic.
        rate_hz: messages per second, by :func:`observed_rate_hz`; 0 for fewer than two messages.
        message_bytes: mean length of a message; 0 without messages.
        count: number of messages.
        age_s: median age of the messages at receipt, negative for stamps in the future; None without stamps.
    """

    input: InputTopic
    publishers: tuple[Publisher, ...] = ()
    rate_hz: float = 0.0
    message_bytes: float = 0.0
    count: int = 0
    age_s: float | None = None


@dataclass(frozen=True)
class NetworkState:
    """Observations of the network.

    Attributes:
        rmw: the middleware.
        nodes: full names of all nodes except our own and hidden nodes; a name used by two nodes is listed twice.
        inputs: the inputs of the suite.
        already_published: topics that only the suite publishes → nodes that publish them already.
        has_clock: True if /clock is published.
        failure: reason why the network was not observed; empty if it was observed.
    """

    rmw: str = ""
    nodes: tuple[str, ...] = ()
    inputs: tuple[ObservedTopic, ...] = ()
    already_published: dict[str, tuple[str, ...]] = field(default_factory=dict)
    has_clock: bool = False
    failure: str = ""


def observe_network(
    inputs: Sequence[InputTopic],
    outputs: Sequence[str],
    namespace: str,
    listen_s: float,
    ship_names: Mapping[str, str] = MappingProxyType({}),
) -> NetworkState:
    """Receive the inputs of a suite for some time; return what was observed, or why nothing was observed.

    Args:
        inputs: inputs of the suite from outside.
        outputs: relative names of topics that the suite itself publishes.
        namespace: namespace of the suite, without its outer slashes.
        listen_s: time for which a topic is received from its first message on, s.
        ship_names: names of inputs on the ship, if they differ.
    """
    if is_security_requested(os.environ):
        os.environ.setdefault(ENCLAVE, full_name(NAME, namespace))
    rules = [f"__ns:=/{namespace}"] if namespace else []
    rules += [f"{name}:={ship_name}" for name, ship_name in ship_names.items()]
    arguments = ["--ros-args", *(word for rule in rules for word in ("-r", rule))] if rules else []
    try:
        with command_node(NAME, arguments) as node, _spinner(node) as spin:
            observers = [_TopicObserver(node, topic, listen_s) for topic in inputs]
            spin(_DISCOVERY_S + listen_s, lambda: False)
            spin(_FIRST_MESSAGE_TIMEOUT_S, lambda: not any(observer.is_awaited for observer in observers))
            # Optional inputs may have started meanwhile; each is received for its full time.
            spin(len(observers) * listen_s, lambda: all(ear.is_done or not ear.has_received for ear in observers))
            _wait_for_names(node, [*outputs, *(topic.topic for topic in inputs)])
            return NetworkState(
                rmw=get_rmw_implementation_identifier(),
                nodes=_other_nodes(node),
                inputs=tuple(ear.observed_topic() for ear in observers),
                already_published={topic: names for topic in outputs if (names := _publishing_nodes(node, topic))},
                has_clock=any(node.count_publishers(name) for name in ("/clock", full_name("clock", namespace))),
            )
    except (BadInput, RuntimeError) as problem:
        return NetworkState(failure=str(problem))


def observed_rate_hz(count: int, span_s: float, observed_s: float) -> float:
    """Return the rate of messages from their mean interval; at most their number divided by the time of observation.

    Args:
        count: number of messages.
        span_s: time from the first to the last message, s.
        observed_s: time of observation from the first message on, s.
    """
    if count < 2:
        return 0.0
    in_all_hz = count / observed_s
    return min((count - 1) / span_s, in_all_hz) if span_s > 0.0 else in_all_hz


class _TopicObserver:
    """One subscription, and its messages for some time from the first message on."""

    def __init__(self, node: Node, topic: InputTopic, listen_s: float) -> None:
        self._node, self._topic, self._listen_s = node, topic, listen_s
        self._kind = message_class(topic.type_name)
        self._count = self._bytes = 0
        self._first_s = self._last_s = math.inf
        self._newest: list[tuple[bytes, int]] = []
        qos = QoSProfile(
            depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
        )
        self._subscription: Subscription = node.create_subscription(
            self._kind, topic.topic, self._take, qos, raw=True
        )

    @property
    def has_received(self) -> bool:
        """True if a message was received."""
        return self._count > 0

    @property
    def is_awaited(self) -> bool:
        """True if no message was received yet, and the topic is required or configured."""
        return not self.has_received and (self._topic.required or self._topic.is_configured)

    @property
    def is_done(self) -> bool:
        """True if the time of observation from the first message on is over."""
        return time.monotonic() >= self._first_s + self._listen_s

    def observed_topic(self) -> ObservedTopic:
        """Return the observations of the topic."""
        return ObservedTopic(
            input=self._topic,
            publishers=_publishers(self._node, self._topic.topic),
            rate_hz=observed_rate_hz(self._count, self._last_s - self._first_s, self._listen_s),
            message_bytes=self._bytes / max(self._count, 1),
            count=self._count,
            age_s=self._age_s(),
        )

    def _take(self, data: bytes) -> None:
        if self.is_done:
            return
        self._last_s = time.monotonic()
        if not self.has_received:
            self._first_s = self._last_s
        self._count += 1
        self._bytes += len(data)
        self._newest.append((data, time.time_ns()))
        del self._newest[:-_MAX_STAMPS]

    def _age_s(self) -> float | None:
        messages = [(deserialize_message(data, self._kind), came_ns) for data, came_ns in self._newest]
        ages = [came_ns - ns_from_stamp(each.header.stamp) for each, came_ns in messages if hasattr(each, "header")]
        return statistics.median(ages) / NS_PER_S if ages else None


@contextlib.contextmanager
def _spinner(node: Node) -> Iterator[Callable[[float, Callable[[], bool]], None]]:
    """Yield a function that handles the callbacks of a node for some seconds, or until a condition holds."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin(seconds: float, is_enough: Callable[[], bool]) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0 and not is_enough():
            executor.spin_once(timeout_sec=min(left_s, _POLL_S))

    try:
        yield spin
    finally:
        executor.shutdown()


def _wait_for_names(node: Node, topics: Sequence[str]) -> None:
    """Wait until the names of the nodes that publish some topics are known, or until a timeout.

    Discovery needs no spinning. Callbacks are not handled meanwhile, so that no further message is counted.
    """
    end_s = time.monotonic() + _NODE_NAME_TIMEOUT_S
    while (
        any(_UNNAMED in name for topic in topics for name in _publishing_nodes(node, topic))
        and time.monotonic() < end_s
    ):
        time.sleep(0.1)


def _publishers(node: Node, topic: str) -> tuple[Publisher, ...]:
    name = node.resolve_topic_name(topic)
    return tuple(
        Publisher(
            full_name(info.node_name, info.node_namespace),
            info.topic_type,
            STRONGER_QOS & {info.qos_profile.reliability.name.lower(), info.qos_profile.durability.name.lower()},
        )
        for info in node.get_publishers_info_by_topic(name)
    )


def _publishing_nodes(node: Node, topic: str) -> tuple[str, ...]:
    return tuple(publisher.node for publisher in _publishers(node, topic))


def _other_nodes(node: Node) -> tuple[str, ...]:
    own = full_name(node.get_name(), node.get_namespace())
    named = (full_name(name, namespace) for name, namespace in node.get_node_names_and_namespaces())
    return tuple(sorted(name for name in named if name != own and not name.rpartition("/")[2].startswith("_")))

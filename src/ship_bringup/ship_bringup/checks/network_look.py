"""A look at the live network before the suite is there: who takes part, and what the sensors say for some seconds.

This is the only check that needs ROS. It subscribes as the nodes will and publishes nothing.
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
from ship_bags.live.dds import is_demanded
from ship_bags.live.ros_process import command_node
from ship_bags.message_factory import message_class
from ship_bags.parameter_yaml import full_name
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bringup.security.demand import ENCLAVE
from ship_node.edge.topics import InputTopic

NAME = "preflight"

STRONGER = frozenset({"reliable", "transient_local"})
"""Qualities of service by which a subscriber hears nobody who does not offer them."""

_DEPTH = 200
_MOST_STAMPS = 200
"""Of each topic the stamps of the newest messages, so many, are compared with the clock."""

_DISCOVERY_S = 4.0
"""Discovery on one machine takes 0.06 s to 1.6 s. Where the first announcements of a participant are lost, the next
comes after 3 s more."""
_FIRST_MESSAGE_S = 12.0
"""A topic that the suite needs and that has been silent is waited for so much longer: a busy machine may find its
publisher late, and link it to us later still."""

_ENOUGH_S = 0.1
"""A look asks this often whether enough has come."""

_UNNAMED = "_NODE_NAME_UNKNOWN_"
"""Of a publisher that was met before its node was."""
_NAMES_S = 5.0
"""So long a node is waited for that has been met by a publisher of its; one that is no ROS node never gets a name."""


@dataclass(frozen=True)
class Publisher:
    """One publisher of a topic: its node's full name, its type, and which of the stronger qualities it offers."""

    node: str
    type_name: str
    offers: frozenset[str] = STRONGER


@dataclass(frozen=True)
class HeardTopic:
    """What was heard of one input of the suite.

    Attributes:
        input: the topic.
        publishers: who publishes it.
        rate_hz: messages a second, as :func:`heard_rate_hz` tells; 0 with fewer than two.
        message_bytes: mean length of a message; 0 without any.
        count: messages.
        age_s: median of receipt minus stamp, negative for stamps of the future; None where none bore a stamp.
    """

    input: InputTopic
    publishers: tuple[Publisher, ...] = ()
    rate_hz: float = 0.0
    message_bytes: float = 0.0
    count: int = 0
    age_s: float | None = None


@dataclass(frozen=True)
class NetworkState:
    """What was seen.

    Attributes:
        rmw: the middleware.
        nodes: full names of all nodes, those of the look itself aside; a name that two bear stands twice.
        heard: the inputs of the suite.
        given: topics that only the suite gives → nodes that publish them already.
        has_clock: whether somebody sets the time.
        failure: why nothing was seen; empty where it was.
    """

    rmw: str = ""
    nodes: tuple[str, ...] = ()
    heard: tuple[HeardTopic, ...] = ()
    given: dict[str, tuple[str, ...]] = field(default_factory=dict)
    has_clock: bool = False
    failure: str = ""


def look_at_network(
    inputs: Sequence[InputTopic],
    outputs: Sequence[str],
    namespace: str,
    listen_s: float,
    ship_names: Mapping[str, str] = MappingProxyType({}),
) -> NetworkState:
    """Listen to the inputs of a suite.

    Args:
        inputs: from outside.
        outputs: relative names of topics that the suite itself gives.
        namespace: of the suite, without its outer slashes.
        listen_s: how long a topic is listened to from its first message on, s.
        ship_names: of inputs that the ship names otherwise.
    """
    if is_demanded(os.environ):
        os.environ.setdefault(ENCLAVE, full_name(NAME, namespace))
    rules = [f"__ns:=/{namespace}"] if namespace else []
    rules += [f"{name}:={ship_name}" for name, ship_name in ship_names.items()]
    arguments = ["--ros-args", *(word for rule in rules for word in ("-r", rule))] if rules else []
    try:
        with command_node(NAME, arguments) as node, _spinning(node) as spin:
            ears = [_Ear(node, topic, listen_s) for topic in inputs]
            spin(_DISCOVERY_S + listen_s, lambda: False)
            spin(_FIRST_MESSAGE_S, lambda: not any(ear.is_awaited for ear in ears))
            # One that nobody waited for may begin meanwhile, each once.
            spin(len(ears) * listen_s, lambda: all(ear.is_done or not ear.has_begun for ear in ears))
            _await_names(node, [*outputs, *(topic.topic for topic in inputs)])
            return NetworkState(
                rmw=get_rmw_implementation_identifier(),
                nodes=_others(node),
                heard=tuple(ear.heard() for ear in ears),
                given={topic: names for topic in outputs if (names := _nodes_of(node, topic))},
                has_clock=any(node.count_publishers(name) for name in ("/clock", full_name("clock", namespace))),
            )
    except (BadInput, RuntimeError) as problem:
        return NetworkState(failure=str(problem))


def heard_rate_hz(count: int, span_s: float, listened_s: float) -> float:
    """Messages a second, by the mean interval between them; never more than came in the whole time.

    Args:
        count: how many came.
        span_s: from the first to the last, s.
        listened_s: from the first on, s.
    """
    if count < 2:
        return 0.0
    in_all_hz = count / listened_s
    return min((count - 1) / span_s, in_all_hz) if span_s > 0.0 else in_all_hz


class _Ear:
    """One subscription, and what came by it in the time from its first message on."""

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
    def has_begun(self) -> bool:
        """Whether a message has come."""
        return self._count > 0

    @property
    def is_awaited(self) -> bool:
        """Whether no message has come of a topic that the suite needs."""
        return not self.has_begun and (self._topic.required or self._topic.named)

    @property
    def is_done(self) -> bool:
        """Whether the time from its first message on is over."""
        return time.monotonic() >= self._first_s + self._listen_s

    def heard(self) -> HeardTopic:
        """What came."""
        return HeardTopic(
            input=self._topic,
            publishers=_publishers(self._node, self._topic.topic),
            rate_hz=heard_rate_hz(self._count, self._last_s - self._first_s, self._listen_s),
            message_bytes=self._bytes / max(self._count, 1),
            count=self._count,
            age_s=self._age_s(),
        )

    def _take(self, data: bytes) -> None:
        if self.is_done:
            return
        self._last_s = time.monotonic()
        if not self.has_begun:
            self._first_s = self._last_s
        self._count += 1
        self._bytes += len(data)
        self._newest.append((data, time.time_ns()))
        del self._newest[:-_MOST_STAMPS]

    def _age_s(self) -> float | None:
        messages = [(deserialize_message(data, self._kind), came_ns) for data, came_ns in self._newest]
        ages = [came_ns - ns_from_stamp(each.header.stamp) for each, came_ns in messages if hasattr(each, "header")]
        return statistics.median(ages) / NS_PER_S if ages else None


@contextlib.contextmanager
def _spinning(node: Node) -> Iterator[Callable[[float, Callable[[], bool]], None]]:
    """A function that serves the callbacks of a node for so many seconds, or until something is so."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin(seconds: float, is_enough: Callable[[], bool]) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0 and not is_enough():
            executor.spin_once(timeout_sec=min(left_s, _ENOUGH_S))

    try:
        yield spin
    finally:
        executor.shutdown()


def _await_names(node: Node, topics: Sequence[str]) -> None:
    """Wait until the nodes that publish some topics are known by name, or for as long as that may take.

    Discovery goes on by itself. Callbacks are not served meanwhile: what comes is not counted any more.
    """
    end_s = time.monotonic() + _NAMES_S
    while any(_UNNAMED in name for topic in topics for name in _nodes_of(node, topic)) and time.monotonic() < end_s:
        time.sleep(0.1)


def _publishers(node: Node, topic: str) -> tuple[Publisher, ...]:
    name = node.resolve_topic_name(topic)
    return tuple(
        Publisher(
            full_name(info.node_name, info.node_namespace),
            info.topic_type,
            STRONGER & {info.qos_profile.reliability.name.lower(), info.qos_profile.durability.name.lower()},
        )
        for info in node.get_publishers_info_by_topic(name)
    )


def _nodes_of(node: Node, topic: str) -> tuple[str, ...]:
    return tuple(publisher.node for publisher in _publishers(node, topic))


def _others(node: Node) -> tuple[str, ...]:
    own = full_name(node.get_name(), node.get_namespace())
    named = (full_name(name, namespace) for name, namespace in node.get_node_names_and_namespaces())
    return tuple(sorted(name for name in named if name != own and not name.rpartition("/")[2].startswith("_")))

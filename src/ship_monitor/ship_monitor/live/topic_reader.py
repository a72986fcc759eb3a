"""Reader of the topics of one namespace: messages wait in DDS as bytes until a fetch decodes them.

No code runs when a message arrives: DDS keeps the newest messages of each topic, and :meth:`TopicReader.fetch` fetches
these messages. An INS at 1 kHz therefore costs a few decoded messages a second, and no Python thread is woken.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock

from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_class
from ship_bags.live.ros_process import prepare_dds
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_bags.topic_names import TRUTH_PREFIX, relative_topic

ALERTS_TOPIC = "ship/alerts"

MAX_QUEUE_DEPTH = 256
"""Queue depth of a topic whose messages are all needed: a quarter of a second at 1 kHz."""

CLOCK_TOPIC = "/clock"
_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
_ABSOLUTE = ("/diagnostics", CLOCK_TOPIC)
DISCOVERY_NS = 500_000_000
"""Period of the discovery of new topics, ns."""

_CLOCK_BACK_NS = 100_000_000
"""Step back of /clock that resets the nodes, ns (:mod:`ship_node.live.live_node`)."""
_STAMPS_BACK_NS = 5 * NS_PER_S
"""Step back of an output's stamp that indicates another voyage, ns: within a voyage the stamps increase."""
_OUTPUTS = ("ship/attitude", "theodolite/pointing")
_MIN_SLEEP_NS = 5 * NS_PER_S

_CLOCK_MEMORY_NS = 10 * NS_PER_S
"""Time before an output, ns. The output counts as played or simulated if /clock or a truth topic existed in this time.

/clock or the truth topic may have ended while the output is still displayed."""


def are_latched(publishers: Sequence[TopicEndpointInfo]) -> bool:
    """True if all publishers of a topic are transient local, so that a late subscriber gets the last message."""
    durability = {each.qos_profile.durability for each in publishers}
    return durability == {DurabilityPolicy.TRANSIENT_LOCAL}


class RawSubscription:
    """Subscription whose newest messages wait in DDS until they are fetched; no code runs when a message arrives.

    The subscription is best effort, so that no publisher waits for it. Latched topics are subscribed reliably, because
    DDS delivers the last message to reliable subscriptions only.

    Attributes:
        type_name: type of the messages.
        is_latched: True if a message published before the subscription is delivered.
        message_class: class of the messages.

    Args:
        node: node of the subscription; the node need not be spun.
        topic: full name of the topic.
        type_name: type of the messages, as ``sensor_msgs/msg/Imu``.
        is_latched: see :func:`are_latched`.
        depth: number of messages that may wait.

    Raises:
        BadInput: the type is not installed.
    """

    def __init__(self, node: Node, topic: str, type_name: str, is_latched: bool, depth: int) -> None:
        self.type_name, self.is_latched = type_name, is_latched
        self.message_class = installed_class(type_name)
        self._node, self._depth = node, depth
        qos = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if is_latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
        )
        self._subscription = node.create_subscription(self.message_class, topic, lambda _: None, qos, raw=True)

    def fetch_messages(self) -> Iterator[tuple[bytes, int]]:
        """Yield CDR bytes and arrival time (UTC of the system's clock, ns) of each waiting message."""
        handle = self._subscription.handle
        for _ in range(self._depth):
            with handle:
                taken = handle.take_message(self.message_class, True)
            if taken is None:
                return
            data, info = taken
            yield data, info["received_timestamp"]

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


def steady_ns() -> int:
    """Return a time that never steps and, unlike ``time.monotonic_ns``, runs while the computer sleeps, ns."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


@dataclass(frozen=True)
class ReceivedMessage:
    """One message: its relative topic, the decoded message, and its arrival by :func:`steady_ns`."""

    topic: str
    message: Any
    arrival_ns: int


@dataclass(frozen=True)
class ReceivedBatch:
    """Messages received since the last fetch.

    Attributes:
        time_went_back: True if the suite's time went back, as at the start of a bag: earlier data are invalid.
        messages: messages in the order of their arrival, without /clock; after a step back of the time, without earlier
            messages that are not latched.
        alerts_ended: True if the alert node has ended since the last fetch.
    """

    time_went_back: bool
    messages: tuple[ReceivedMessage, ...]
    alerts_ended: bool


@dataclass
class _SubscribedTopic:
    """A subscribed topic and its relative name."""

    subscription: RawSubscription
    relative_name: str


class TopicReader:
    """Reads the topics of a namespace and discovers new topics.

    The reader has its own context and its own node, which is not spun. After the computer has slept for more than 5 s,
    the reader joins the network again, because the addresses may have changed.

    Attributes:
        domain_id: ROS domain of the reader.
        namespace: namespace with a leading slash; "/" for no namespace.
        context: context of the node, for another node in this process; renewed after the computer has slept.
        node: node for subscriptions in the thread that calls :meth:`fetch`; renewed after the computer has slept.

    Args:
        name: name of the node.
        namespace: namespace of the suite, with or without slashes; empty for no namespace.
        queue_depth: returns the queue depth for relative name and type of a topic: 1 if the newest message is enough,
            :data:`MAX_QUEUE_DEPTH` if each message is needed, 0 if the topic is not needed.

    Raises:
        BadInput: the namespace is invalid, or DDS security is required but not available.
    """

    def __init__(self, name: str, namespace: str, queue_depth: Callable[[str, str], int]) -> None:
        self.namespace = "/" + namespace.strip("/")
        self._name, self._queue_depth = name, queue_depth
        self._sleep_time_ns = self._last_fetch_ns = self._next_discovery_ns = 0
        self._latest_ns: dict[str, int] = {}
        self._output_ns = 0
        self._truth_ns = self._clock_ns = -_CLOCK_MEMORY_NS
        self._open()

    def fetch(self) -> ReceivedBatch:
        """Subscribe to new topics; return the newest messages since the last call, at most a queue depth per topic."""
        asleep_ns = _sleep_time_ns()
        if asleep_ns - self._sleep_time_ns > _MIN_SLEEP_NS:
            self.close()
            self._open()
        now_ns, present = steady_ns(), self._published_topics
        if now_ns >= self._next_discovery_ns:
            self._discover()
            self._next_discovery_ns = now_ns + DISCOVERY_NS
        alerts_ended = ALERTS_TOPIC in present - self._published_topics
        received = sorted(self._decode_waiting(now_ns), key=lambda each: each.arrival_ns)
        self._last_fetch_ns = now_ns
        # The alerts topic exists if a message was received, also if the next discovery is still pending.
        self._published_topics |= {each.topic for each in received if each.topic == ALERTS_TOPIC}
        self._output_ns = max([self._output_ns, *(each.arrival_ns for each in received if each.topic in _OUTPUTS)])
        jump_ns = max(filter(None, map(self._jump_ns, received)), default=None)
        kept = (each for each in received if each.topic != CLOCK_TOPIC)
        if jump_ns is None:
            return ReceivedBatch(False, tuple(kept), alerts_ended)
        # The outputs step back after /clock. Their latest stamps are reset, so that the step is not counted twice.
        self._latest_ns = {CLOCK_TOPIC: self._latest_ns[CLOCK_TOPIC]} if CLOCK_TOPIC in self._latest_ns else {}
        latched = {
            subscribed.relative_name
            for subscribed in self._subscriptions.values()
            if subscribed.subscription.is_latched
        }
        kept = (each for each in kept if each.arrival_ns >= jump_ns or each.topic in latched)
        return ReceivedBatch(True, tuple(kept), alerts_ended)

    @property
    def is_simulated(self) -> bool:
        """True if the suite's truth is on the network, or was there within 10 s before the last output."""
        return self._output_ns - self._truth_ns < _CLOCK_MEMORY_NS

    @property
    def is_played(self) -> bool:
        """True if a /clock is published, as by a bag player, or was published within 10 s before the last output."""
        return self._output_ns - self._clock_ns < _CLOCK_MEMORY_NS

    @property
    def location(self) -> str:
        """Namespace and domain, and other namespaces with a suite, as text."""
        where = f"namespace {self.namespace}, domain {self.domain_id}"
        others = [f"/{name}" for name in self._other_namespaces if f"/{name}" != self.namespace]
        return f"{where}; suite found in {', '.join(others)}" if others else where

    def relative_name(self, topic: str) -> str | None:
        """Return the name relative to the namespace, unchanged if all suites share the topic; None for other topics."""
        return topic if topic in _ABSOLUTE else relative_topic(topic, self.namespace)

    def close(self) -> None:
        """Leave the network."""
        self.node.destroy_node()
        self.context.try_shutdown()

    def _open(self) -> None:
        prepare_dds()
        self.context = Context()
        self.context.init(args=[])
        self.domain_id = int(self.context.get_domain_id())
        try:
            self.node = Node(
                self._name,
                context=self.context,
                namespace=self.namespace,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
            )
        except (InvalidNamespaceException, ValueError) as problem:
            self.context.try_shutdown()
            reason = f"'{self.namespace}' is not a namespace of ROS; expected letters, digits, _ and /"
            raise BadInput(reason) from problem
        self._subscriptions: dict[str, _SubscribedTopic] = {}
        self._published_topics: set[str] = set()
        self._unusable: set[tuple[str, str]] = set()
        self._other_namespaces: tuple[str, ...] = ()
        self._latest_ns = {}
        self._sleep_time_ns = _sleep_time_ns()
        self._last_fetch_ns = self._next_discovery_ns = steady_ns()

    def _discover(self) -> None:
        """Subscribe to new topics, and again to topics whose type or durability has changed."""
        names = self.node.get_topic_names_and_types()
        ending = "/" + _OUTPUTS[0]
        self._other_namespaces = tuple(sorted(name[1 : -len(ending)] for name, _ in names if name.endswith(ending)))
        clock_topic = self._clock_topic(dict(names))
        if self.node.count_publishers(clock_topic):
            self._clock_ns = steady_ns()
        present = set()
        for topic, types in names:
            relative = CLOCK_TOPIC if topic == clock_topic else self.relative_name(topic)
            if relative is None or (topic == CLOCK_TOPIC != clock_topic):
                continue
            depths = {each: 1 if relative == CLOCK_TOPIC else self._queue_depth(relative, each) for each in types}
            if not any(depths.values()) and not relative.startswith(TRUTH_PREFIX):
                continue
            publishers = self.node.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            present.add(relative)
            type_name = publishers[-1].topic_type
            if depths.get(type_name):
                self._subscribe(topic, relative, type_name, depths[type_name], are_latched(publishers))
        self._published_topics = present
        if any(topic.startswith(TRUTH_PREFIX) for topic in present):
            self._truth_ns = steady_ns()

    def _clock_topic(self, types: Mapping[str, list[str]]) -> str:
        """Return the topic of the suite's clock: the clock in the namespace if one is published there, else /clock.

        If the topic changes, the latest time of the former topic is dropped: the change does not count as a step back.
        """
        own = self.namespace.rstrip("/") + CLOCK_TOPIC
        is_there = types.get(own) == [_CLOCK_TYPE] and self.node.count_publishers(own) > 0
        topic = own if is_there else CLOCK_TOPIC
        former = CLOCK_TOPIC if is_there else own
        if former != topic and former in self._subscriptions:
            self._subscriptions.pop(former).subscription.close()
            self._latest_ns.pop(CLOCK_TOPIC, None)
        return topic

    def _subscribe(self, topic: str, relative: str, type_name: str, depth: int, is_latched: bool) -> None:
        subscribed = self._subscriptions.get(topic)
        if subscribed is not None:
            if (subscribed.subscription.type_name, subscribed.subscription.is_latched) == (type_name, is_latched):
                return
            subscribed.subscription.close()
            del self._subscriptions[topic]
        if (topic, type_name) in self._unusable:
            return
        try:
            subscription = RawSubscription(self.node, topic, type_name, is_latched, depth)
        except BadInput as problem:
            self._unusable.add((topic, type_name))
            self.node.get_logger().warning(f"topic '{topic}' is not shown: {problem}")
            return
        self._subscriptions[topic] = _SubscribedTopic(subscription, relative)

    def _decode_waiting(self, now_ns: int) -> Iterator[ReceivedMessage]:
        """Yield the waiting messages, decoded; messages that cannot be decoded (other type definition) are skipped."""
        clock_offset_ns = time.time_ns() - now_ns
        for subscribed in self._subscriptions.values():
            for data, received_ns in subscribed.subscription.fetch_messages():
                # The middleware gives the time of the system's clock, which may have been set since the last fetch.
                arrival_ns = min(max(received_ns - clock_offset_ns, self._last_fetch_ns), now_ns)
                try:
                    message = deserialize_message(data, subscribed.subscription.message_class)
                except Exception as problem:
                    self.node.get_logger().warning(
                        f"topic '{subscribed.relative_name}' is not read: {problem}", throttle_duration_sec=10.0
                    )
                    continue
                yield ReceivedMessage(subscribed.relative_name, message, arrival_ns)

    def _jump_ns(self, received: ReceivedMessage) -> int | None:
        """Return the arrival, ns, of a message of /clock or a valid output whose time went back; otherwise None.

        Steps back within the tolerance of the topic do not count.
        """
        message = received.message
        if isinstance(message, Clock):
            time_ns, tolerance_ns = ns_from_stamp(message.clock), _CLOCK_BACK_NS
        elif received.topic in _OUTPUTS and message.status != message.INVALID:
            time_ns, tolerance_ns = ns_from_stamp(message.header.stamp), _STAMPS_BACK_NS
        else:
            return None
        latest_ns = self._latest_ns.get(received.topic, time_ns)
        self._latest_ns[received.topic] = time_ns
        return received.arrival_ns if time_ns < latest_ns - tolerance_ns else None


def _sleep_time_ns() -> int:
    """Return the time that the computer has slept since its start, ns."""
    return steady_ns() - time.monotonic_ns()

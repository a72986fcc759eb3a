"""Relay of a suite's topics as bytes to a receiver outside ROS.

/clock, /diagnostics and the topics of the namespace are offered once they have a publisher. Only topics requested by
the receiver are subscribed, so that other topics cost nothing. Up to 256 waiting messages of each topic are forwarded
at once, also where a display reads only the newest message.
"""

import logging
from typing import Protocol

from rclpy.node import Node

from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_definition
from ship_monitor.live.raw_subscription import RawSubscription, are_latched
from ship_monitor.live.topic_reader import DISCOVERY_NS, MAX_QUEUE_DEPTH, TopicReader, steady_ns


class TopicReceiver(Protocol):
    """Receiver of topics. All names of topics are full names; all methods return at once."""

    def offer(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic; a known topic may be offered again with another type."""

    def subscribed_topics(self) -> frozenset[str]:
        """Return the offered topics that have a subscriber."""

    def new_subscriptions(self) -> frozenset[str]:
        """Return the topics with a new subscriber since the last call."""

    def forward(self, topic: str, data: bytes, arrival_utc_ns: int) -> None:
        """Forward the CDR bytes of a message; ``arrival_utc_ns`` is its arrival time."""


class TopicRelay:
    """Forwards topics to a receiver, with subscriptions on the node of a topic reader.

    The thread that fetches from the reader also calls the relay. Relay and reader share one DDS participant, which
    receives each message once.

    Args:
        reader: topic reader of the namespace.
        receiver: receiver of the messages.
    """

    def __init__(self, reader: TopicReader, receiver: TopicReceiver) -> None:
        self._reader, self._receiver = reader, receiver
        self._node: Node | None = None
        self._types: dict[str, str] = {}
        self._known_types: dict[str, list[str]] = {}
        self._unusable: set[str] = set()
        self._subscriptions: dict[str, RawSubscription] = {}
        self._next_discovery_ns = 0

    def forward_messages(self) -> None:
        """Update offers and subscriptions, and forward the waiting messages."""
        if self._reader.node is not self._node:
            # The computer has slept: the former node and its subscriptions no longer exist.
            self._node = self._reader.node
            self._subscriptions.clear()
            self._next_discovery_ns = 0
        now_ns = steady_ns()
        is_discovery_time = now_ns >= self._next_discovery_ns
        if is_discovery_time:
            self._offer_topics()
            self._next_discovery_ns = now_ns + DISCOVERY_NS
        wanted, new_subscriptions = self._receiver.subscribed_topics(), self._receiver.new_subscriptions()
        for topic, subscription in list(self._subscriptions.items()):
            # DDS delivers the last message of a latched topic only to a new subscription.
            if topic not in wanted or (subscription.is_latched and topic in new_subscriptions):
                self._unsubscribe(topic)
        for topic in wanted if is_discovery_time else wanted & new_subscriptions:
            self._subscribe(topic)
        for topic, subscription in self._subscriptions.items():
            for data, arrival_utc_ns in subscription.fetch_messages():
                self._receiver.forward(topic, data, arrival_utc_ns)

    def _offer_topics(self) -> None:
        """Offer topics that are new or have another type; a topic without publishers stays offered."""
        for topic, types in self._reader.node.get_topic_names_and_types():
            is_known = self._known_types.get(topic) == types
            if is_known or self._reader.relative_name(topic) is None or "/_" in topic:
                continue
            present = {each.topic_type for each in self._reader.node.get_publishers_info_by_topic(topic)}
            if not present:
                continue
            self._known_types[topic] = types
            if self._types.get(topic) not in present:
                self._offer(topic, min(present))

    def _offer(self, topic: str, type_name: str) -> None:
        if type_name in self._unusable:
            return
        try:
            definition = installed_definition(type_name).text
        except (BadInput, LookupError, OSError, ImportError) as problem:
            self._unusable.add(type_name)
            logging.getLogger(__name__).warning(f"topic '{topic}' and others of its type are not offered: {problem}")
            return
        self._types[topic] = type_name
        self._receiver.offer(topic, type_name, definition)
        if topic in self._subscriptions:
            self._unsubscribe(topic)  # this subscription has the former type

    def _subscribe(self, topic: str) -> None:
        """Subscribe to a topic; subscribe again if the durability of its publishers has changed."""
        publishers = self._reader.node.get_publishers_info_by_topic(topic)
        own = [each for each in publishers if each.topic_type == self._types[topic]]
        former = self._subscriptions.get(topic)
        if publishers and not own:
            del self._known_types[topic]  # the publishers have another type now
        if not own or (former is not None and former.is_latched == are_latched(own)):
            return
        if former is not None:
            self._unsubscribe(topic)
        self._subscriptions[topic] = RawSubscription(
            self._reader.node, topic, self._types[topic], are_latched(own), MAX_QUEUE_DEPTH
        )

    def _unsubscribe(self, topic: str) -> None:
        self._subscriptions.pop(topic).close()

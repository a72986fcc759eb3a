"""A running suite: its state, the relay of its topics as bytes, and the acknowledgement of its alerts.

A reader receives the topics, and a monitor computes the state from their messages. Topics are read in a separate
thread. Without this thread, a display that is busy for a second would look like a gap in the data.

The thread also forwards topics to a receiver outside ROS, if a receiver is given. /clock, /diagnostics and the topics
of the namespace are offered once they have a publisher. Only topics requested by the receiver are subscribed, so that
other topics cost nothing. Up to 256 waiting messages of each topic are forwarded at once, also where a display reads
only the newest message.
"""

import itertools
import logging
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_definition
from ship_monitor.live.topic_reader import (
    DISCOVERY_NS,
    MAX_QUEUE_DEPTH,
    RawSubscription,
    ReceivedBatch,
    TopicReader,
    are_latched,
    steady_ns,
)
from ship_msgs.srv import AcknowledgeAlert
from ship_watch.history.history import History
from ship_watch.published_state import STATE_TOPIC, STATE_TYPE
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import SuiteState
from ship_watch.topics import monitored_topic

SERVICE = "alerts/acknowledge"
"""Relative name of the service."""

READ_PERIOD_S = 0.2
"""Period at which topics are read, s."""

_RELAYS_PER_READ = 4
"""Number of forwarding steps for each reading of topics: twenty steps a second."""

_STATE_PERIOD_NS = 200_000_000
_CLOSE_TIMEOUT_S = 5.0

_FOUND_WITHIN_S = 2.0
_ANSWERED_WITHIN_S = 3.0


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


class LiveSuite:
    """A suite on the network: one reader and one monitor for all displays.

    Args:
        node_name: name of the node on the network.
        namespace: namespace of the suite, with or without slashes; empty for no namespace.
        limits: limits of the ship, for the state of a suite without an alert node.
        receiver: receiver of the suite's topics as bytes; None for no receiver.

    Raises:
        BadInput: as in :class:`ship_monitor.live.topic_reader.TopicReader`.
    """

    def __init__(self, node_name: str, namespace: str, limits: Limits, receiver: TopicReceiver | None = None) -> None:
        self._reader = TopicReader(node_name, namespace, queue_depth)
        self._relay = None if receiver is None else TopicRelay(self._reader, receiver)
        self._monitor = SuiteMonitor(limits)
        self._suite_state: SuiteState | None = None
        self._has_rejected_state = False
        self._suite_state_ns = 0
        self._pending: SimpleQueue[ReceivedBatch] = SimpleQueue()
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name="topics", daemon=True)
        self._thread.start()

    def tick(self) -> None:
        """Process the messages read so far; the method is called some times a second, also without a display."""
        while True:
            try:
                batch = self._pending.get_nowait()
            except Empty:
                return
            if batch.time_went_back:
                self._monitor.reset()
            if batch.alerts_ended:
                self._monitor.clear_alerts()
            for received in batch.messages:
                if received.topic == STATE_TOPIC:
                    self._process_suite_state(received.message, received.arrival_ns)
                else:
                    self._monitor.process_message(received.topic, received.message, received.arrival_ns)

    def _process_suite_state(self, message: Any, arrival_ns: int) -> None:
        """Process a SuiteState message; an invalid message is dropped, and a warning is logged for the first."""
        try:
            self._monitor.process_suite_state(message, arrival_ns)
        except ValueError as problem:
            if not self._has_rejected_state:
                text = "%s is not shown: %s; do the alert node and this viewer have the same version?"
                logging.getLogger(__name__).warning(text, STATE_TOPIC, problem)
            self._has_rejected_state = True

    def current_state(self) -> SuiteState:
        """Return the current state; calls within 0.2 s return the same state."""
        now_ns = steady_ns()
        if self._suite_state is None or now_ns - self._suite_state_ns > _STATE_PERIOD_NS:
            # Messages read already are processed before the state is evaluated.
            self.tick()
            now_ns = steady_ns()
            self._suite_state, self._suite_state_ns = self._monitor.current_state(now_ns), now_ns
        return self._suite_state

    def _read(self) -> None:
        """Read and forward topics until closed."""
        rounds = 1 if self._relay is None else _RELAYS_PER_READ
        for number in itertools.count():
            if self._is_closed.wait(READ_PERIOD_S / rounds):
                return
            # An error is logged; data that are not read become old.
            try:
                if number % rounds == 0:
                    batch = self._reader.fetch()
                    if batch.time_went_back or batch.messages or batch.alerts_ended:
                        self._pending.put(batch)
                if self._relay is not None:
                    self._relay.forward_messages()
            except Exception:
                logging.getLogger(__name__).exception("topics are not read")

    @property
    def history(self) -> History:
        """Data of the plots."""
        return self._monitor.history

    @property
    def label(self) -> str:
        """LIVE, or "BAG · played" if a bag is played; with truth on the network "SIMULATED" or "SIMULATED · bag"."""
        if self._reader.is_simulated:
            return "SIMULATED · bag" if self._reader.is_played else "SIMULATED"
        return "BAG · played" if self._reader.is_played else "LIVE"

    @property
    def name(self) -> str:
        """Namespace without its slash; "ship" if there is no namespace."""
        return self._reader.namespace.strip("/") or "ship"

    @property
    def location(self) -> str:
        """Namespace and domain of the reader, as text."""
        return self._reader.location

    def acknowledge(self, alert_id: str, instance: int) -> str:
        """Acknowledge one instance of an alert; return the result in words. The call may take seconds."""
        return _acknowledge(self._reader.context, self._reader.namespace, alert_id, instance)

    def controls(self, _on_move: Callable[[], None]) -> None:
        """Return None: a live suite has no controls."""

    def close(self) -> None:
        """Leave the network."""
        self._is_closed.set()
        self._thread.join(_CLOSE_TIMEOUT_S)
        self._reader.close()


def _acknowledge(context: Context, namespace: str, alert_id: str, instance: int) -> str:
    """Acknowledge an alert; wait for the answer and return the result in words.

    The temporary node shares the reader's context, and with it the DDS participant: two participants in one process
    can deadlock.
    """
    node = rclpy.create_node("acknowledge", namespace=namespace, context=context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        client = node.create_client(AcknowledgeAlert, SERVICE)
        if not client.wait_for_service(timeout_sec=_FOUND_WITHIN_S):
            return f"not acknowledged: no service {client.service_name}; is the node alerts running?"
        answer = client.call_async(AcknowledgeAlert.Request(id=alert_id, instance=instance))
        executor.spin_until_future_complete(answer, timeout_sec=_ANSWERED_WITHIN_S)
        response = answer.result() if answer.done() else None
        if response is None:
            return f"not acknowledged: no answer of {client.service_name} within {_ANSWERED_WITHIN_S:.0f} s"
        if response.success:
            return str(response.message) or f"{alert_id} acknowledged"
        return f"not acknowledged: {response.message}"
    finally:
        executor.shutdown()
        node.destroy_node()


def queue_depth(topic: str, type_name: str) -> int:
    """Return the queue depth of a topic (:class:`ship_monitor.live.topic_reader.TopicReader`)."""
    if topic == STATE_TOPIC:
        return int(type_name == STATE_TYPE)
    row = monitored_topic(topic, type_name)
    return 0 if row is None else MAX_QUEUE_DEPTH if row.keeps_every_message else 1

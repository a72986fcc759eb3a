"""Topics of a live node: quality of service of inputs and outputs, and the subscriptions of its inputs.

A parameter file may override some policies of the quality of service. With the subscriptions are the readers of their
messages and the check of their publishers.
"""

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import QoSMessageLostInfo, QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from ship_bags.errors import BadInput
from ship_bags.message_factory import CdrReader, RosidlFactory, message_class
from ship_node.adapters.adapter import Adapter
from ship_node.health.duplicate_publishers import ActivePublishers, duplicate_publishers_text, publisher_names
from ship_node.live.node_report import ExceptionGuard, NodeLog
from ship_node.live.ros_parameters import NodeParameters
from ship_node.messages.inputs_outputs import InputTopic, OutputTopic

OUTPUT_DEPTH = 2000
"""Number of messages kept for late acknowledgements, enough for two seconds at 1 kHz or 20 s at 100 Hz."""

RELIABLE_DEPTH = 2000
"""Number of messages of a reliable input that may arrive at once after an outage of the link."""

_OVERRIDABLE = QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH
_EXPECTED = (
    "reliability: reliable | best_effort, durability: volatile | transient_local, history: keep_last | keep_all, "
    "depth: an integer from 1"
)

OnMessage = Callable[[str, tuple[bytes, Mapping[str, Any]]], None]
"""Callback with the adapter's name of a topic, and a received message with its information."""


def input_qos(input_topic: InputTopic, is_reliable: bool) -> QoSProfile:
    """Return the QoS of an input: best effort by default, so that a lost message never delays newer messages.

    Args:
        input_topic: the topic, with a depth of one second of data.
        is_reliable: True if lost messages must be sent again, even after an outage of the link.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(input_topic.depth, RELIABLE_DEPTH) if is_reliable else input_topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


def create_publisher(node: Node, output_topic: OutputTopic) -> Publisher:
    """Create the publisher of an output: reliable; a latched topic keeps its last message for late subscribers.

    Raises:
        BadInput: an override of the QoS cannot be used.
    """
    qos = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1 if output_topic.latched else OUTPUT_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if output_topic.latched else DurabilityPolicy.VOLATILE,
    )
    kind, name = message_class(output_topic.type_name), output_topic.topic
    with check_overrides(node, name):
        return node.create_publisher(kind, name, qos, qos_overriding_options=overriding_options())


def overriding_options() -> QoSOverridingOptions:
    """Return the options that declare parameters such as ``qos_overrides./TOPIC.subscription.reliability``."""
    return QoSOverridingOptions(_OVERRIDABLE, callback=_check_depth)


@contextlib.contextmanager
def check_overrides(node: Node, topic: str) -> Iterator[None]:
    """Report unusable overrides while the publisher or subscription of a topic is created in this context.

    Raises:
        BadInput: an override cannot be used; the text names the parameter and what is expected.
    """
    try:
        with warnings.catch_warnings():
            # rclpy only warns of a depth of 0, which is refused here.
            warnings.simplefilter("ignore")
            yield
    except (RuntimeError, InvalidQosOverridesError, ParameterException) as error:
        name = f"qos_overrides.{node.resolve_topic_name(topic)}"
        raise BadInput(f"parameter '{name}': {error}; expected {_EXPECTED}", parameters=(name,)) from error


def _check_depth(profile: QoSProfile) -> SetParametersResult:
    return SetParametersResult(successful=profile.depth > 0, reason="depth must be at least 1")


class InputSubscriptions:
    """Subscriptions of all inputs of an adapter.

    Args:
        node: the rclpy node.
        adapter: the adapter, whose health gets lost messages, incompatible QoS and the number of publishers.
        parameters: names of the topics, and reliability of the inputs.
        factory: factory of the messages.
        guard: calls each callback; an exception does not end the node.
        log: the node's log.
        on_message: called with each message.
        note_event: called when messages were lost; see :meth:`ship_node.live.node_events.NodeEvents.note_event`.

    Attributes:
        depths: depth of each input's queue, by topic.

    Raises:
        BadInput: an override of the QoS cannot be used.
    """

    def __init__(
        self,
        node: Node,
        adapter: Adapter,
        parameters: NodeParameters,
        factory: RosidlFactory,
        guard: ExceptionGuard,
        log: NodeLog,
        on_message: OnMessage,
        note_event: Callable[[], None],
    ) -> None:
        self._node, self._adapter, self._guard, self._log = node, adapter, guard, log
        self._note_event = note_event
        profiles = {each: input_qos(each, parameters.has_reliable_inputs) for each in adapter.inputs}
        self.depths = {each.topic: qos.depth for each, qos in profiles.items()}
        self._active_publishers = {topic: ActivePublishers() for topic in self.depths}
        self._duplicate_publishers: dict[str, str] = {}
        self._subscriptions = {
            each.topic: self._subscribe(each, qos, parameters.topics.get(each.topic, each.topic), on_message)
            for each, qos in profiles.items()
        }
        self._readers = {each.topic: CdrReader(each.type_name, factory.definition) for each in adapter.inputs}

    def message(self, topic: str, data: bytes) -> Any:
        """Return a message from its received bytes."""
        message = self._readers[topic].message(data)
        return deserialize_message(data, self._subscriptions[topic].msg_type) if message is None else message

    def add_message(self, topic: str, number: int) -> bool:
        """Record the sequence number of a message; return True if it newly shows two publishers."""
        has_two = self._active_publishers[topic].add_message(number, time.monotonic_ns())
        return has_two and topic not in self._duplicate_publishers

    def check_publishers(self, topic: str, has_time: bool) -> str | None:
        """Check by the messages and the graph whether two publishers send on a topic.

        Args:
            topic: name of the topic.
            has_time: False if the clock has not started; a change is then found by a later check.

        Returns:
            The changed text about two publishers, empty if only one is left; None without a change.
        """
        name = self._subscriptions[topic].topic_name
        count, active, names = self._node.count_publishers(name), self._active_publishers[topic], []
        if count > 1:
            names = publisher_names(self._node.get_publishers_info_by_topic(name))
        elif topic in self._duplicate_publishers:
            active.keep_latest()
        self._adapter.health.set_publisher_count(topic, count, names)
        text = duplicate_publishers_text(topic, names) if active.has_two(time.monotonic_ns()) else ""
        if text == self._duplicate_publishers.get(topic, "") or not has_time:
            return None
        self._duplicate_publishers[topic] = text
        if text:
            self._log.error(text)
        else:
            del self._duplicate_publishers[topic]
            self._log.info(f"one publisher sends on {topic}")
        return text

    def _subscribe(self, input_topic: InputTopic, qos: QoSProfile, name: str, on_message: OnMessage) -> Subscription:
        topic = input_topic.topic
        events = SubscriptionEventCallbacks(
            incompatible_qos=partial(self._guard.call, "QoS event", self._on_incompatible_qos, topic),
            message_lost=partial(self._guard.call, "QoS event", self._on_messages_lost, topic),
        )
        with check_overrides(self._node, name):
            subscription = self._node.create_subscription(
                message_class(input_topic.type_name),
                name,
                partial(self._guard.call, topic, on_message, topic),
                qos,
                event_callbacks=events,
                qos_overriding_options=overriding_options(),
                # The black box records the received bytes.
                raw=True,
            )
        # rclpy would derive the callback type from the callback's signature, but rclpy's events executor calls with one
        # argument: a tuple of the message and its information.
        subscription._callback_type = Subscription.CallbackType.WithMessageInfo
        return subscription

    def _on_incompatible_qos(self, topic: str, event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        text = f"a publisher of {topic} offers another {policy} than requested; none of its messages will arrive"
        self._adapter.health.record_incompatible_qos(topic, text)
        self._log.error(f"incompatible QoS: {text}")

    def _on_messages_lost(self, topic: str, event: QoSMessageLostInfo) -> None:
        self._note_event()
        self._adapter.health.record_lost(topic, event.total_count_change)

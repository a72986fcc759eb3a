"""Subscription to a topic as bytes."""

from collections.abc import Iterator, Sequence

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ship_bags.live.installed_types import installed_class


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

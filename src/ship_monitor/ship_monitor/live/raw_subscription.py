"""A topic that is subscribed to as bytes."""

from collections.abc import Iterator, Sequence

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ship_bags.live.installed_types import installed_class


def are_latched(publishers: Sequence[TopicEndpointInfo]) -> bool:
    """Whether all publishers of a topic keep their last message for those who come later."""
    durability = {each.qos_profile.durability for each in publishers}
    return durability == {DurabilityPolicy.TRANSIENT_LOCAL}


class RawSubscription:
    """Messages wait in DDS, the newest, until somebody fetches them: nothing runs when one arrives.

    No publisher ever waits for it: it is best effort. Only topics that keep their last message for those who come later
    are taken reliably, because DDS gives that message to nobody else.

    Attributes:
        type_name: of its messages.
        is_latched: whether the last message comes even where it was published before.
        kind: their class.

    Args:
        node: which nobody needs to spin.
        topic: its full name.
        type_name: as ``sensor_msgs/msg/Imu``.
        is_latched: see :func:`are_latched`.
        depth: how many messages may wait.

    Raises:
        BadInput: the type is not installed.
    """

    def __init__(self, node: Node, topic: str, type_name: str, is_latched: bool, depth: int) -> None:
        self.type_name, self.is_latched = type_name, is_latched
        self.kind = installed_class(type_name)
        self._node, self._depth = node, depth
        qos = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if is_latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
        )
        self._subscription = node.create_subscription(self.kind, topic, lambda _: None, qos, raw=True)

    def fetched(self) -> Iterator[tuple[bytes, int]]:
        """CDR bytes of all that waits, each with the time of the system's clock at which it came (UTC, ns)."""
        handle = self._subscription.handle
        for _ in range(self._depth):
            with handle:
                taken = handle.take_message(self.kind, True)
            if taken is None:
                return
            data, info = taken
            yield data, info["received_timestamp"]

    def close(self) -> None:
        """Subscribe no more."""
        self._node.destroy_subscription(self._subscription)

"""Node that publishes the outputs of a suite, in a separate context."""

from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from ship_bags.stamps import stamp_fields
from ship_msgs.msg import ShipAttitude


class SuitePublisher:
    """Publishes messages; a publisher is created with the first message of its topic."""

    def __init__(self, namespace: str = "demo") -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("suite", context=self.context, namespace=namespace)
        self.publishers: dict[str, Any] = {}

    def publish(self, topic: str, message: Any, qos: Any = 10) -> None:
        """Publish a message."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(type(message), topic, qos)
        self.publishers[topic].publish(message)

    def wait_for_subscribers(
        self, wait_until: Callable[[Callable[[], Any]], Any], act: Callable[[], Any], *topics: str
    ) -> None:
        """Call ``act``, which lets the node under test receive and returns True, until each topic has a subscriber."""
        wait_until(lambda: act() and all(self.publishers[topic].get_subscription_count() for topic in topics))

    def stop(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()
        self.context.try_shutdown()


def attitude(time_ns: int, status: int = ShipAttitude.VALID, variance: float = 1e-12) -> ShipAttitude:
    """Return an attitude with heading 1 rad."""
    message = ShipAttitude(status=status, heading=1.0, covariance=[variance if i % 4 == 0 else 0.0 for i in range(9)])
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time_ns)
    return message

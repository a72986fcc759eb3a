"""Simulated time in the order of the data: /clock queued like any input."""

from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

CLOCK_DEPTH = 1000
"""Messages of /clock that may wait for the node: ten seconds of a bag's time at the usual 100 Hz."""


def queue_clock(node: Node, heard: Callable[[], None] = lambda: None) -> None:
    """Keep every message of /clock until the node takes it; without ``use_sim_time`` there is nothing to do.

    rclpy keeps the newest only. In a node that is behind for a moment — a fast bag, a busy machine — time then runs
    ahead of the inputs that still wait: they look late, and their silence is reported while they lie in the queue.
    With an executor that handles messages in order of arrival, queued time is right for each of them.

    Args:
        node: whose /clock.
        heard: called after each message of it.
    """
    # There is no public way to this subscription, and rclpy allows no QoS overrides for it.
    time_source = node._time_source
    if time_source._clock_sub is None:
        return

    def take(message: Clock) -> None:
        time_source.clock_callback(message)
        heard()

    node.destroy_subscription(time_source._clock_sub)
    time_source._clock_sub = node.create_subscription(
        Clock,
        "/clock",
        take,
        QoSProfile(depth=CLOCK_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
    )

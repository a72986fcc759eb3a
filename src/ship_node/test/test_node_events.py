"""More messages than a node can take: what waits is dropped before it piles up, and the newest still come."""

import time

import pytest
import rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import Int32

from ship_node.edge.messages_out import Level
from ship_node.live.guard import Guard
from ship_node.live.node_events import MOST_EVENTS, NodeEvents

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("dds")]
DEPTH = 100


@pytest.fixture
def context(own_domain):
    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


def test_mend_18_events_do_not_pile_up_in_the_executor(context):
    node = rclpy.create_node("flooded", context=context)
    steady_ns = 0
    events = NodeEvents(context, Guard(node.get_logger(), time.monotonic_ns), lambda: steady_ns)
    seen = []

    def take(data):
        events.came()
        seen.append(data)

    node.create_subscription(Int32, "data", take, DEPTH, raw=True)
    publisher = node.create_publisher(Int32, "data", DEPTH)
    events.start(node)
    sent = [serialize_message(Int32(data=number)) for number in range(2)]
    deadline_s = time.monotonic() + 15.0
    while not seen and time.monotonic() < deadline_s:
        # Until both are connected.
        publisher.publish(sent[0])
        events.take(0.01)
    assert events.status().level is Level.OK
    rounds = 0
    while events.status().level is Level.OK and rounds < 200:
        # Half as many again as can be taken, each for a message that is soon displaced.
        for _ in range(MOST_EVENTS * 3 // 2):
            publisher.publish(sent[0])
        steady_ns += 200_000_000
        events.take(0.0)
        rounds += 1
    status = events.status()
    assert status.level is Level.ERROR
    assert "more came than this node can take" in status.message

    publisher.publish(sent[1])
    while seen[-1] != sent[1] and time.monotonic() < deadline_s:
        events.take(0.01)
    assert seen[-1] == sent[1]
    steady_ns += 60_000_000_000
    assert events.status().level is Level.WARN
    events.close()
    node.destroy_node()

"""Ticks, timeout clock and node time: a node that is behind reads the /clock of each message, not the newest one."""

import time

import pytest
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32

from ship_node.live.node_clock import CLOCK_DEPTH, TickGrid, TimeoutClock, queue_clock

COUNT = 200


@pytest.fixture
def context(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=100)
    yield context
    rclpy.shutdown(context=context)


@pytest.mark.live
def test_each_message_is_processed_at_its_own_time(context):
    sim_time = [Parameter("use_sim_time", value=True)]
    node = rclpy.create_node("behind", context=context, parameter_overrides=sim_time)
    queue_clock(node)
    seen = {}
    node.create_subscription(
        Int32, "data", lambda m: seen.update({m.data: node.get_clock().now().nanoseconds}), CLOCK_DEPTH
    )
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    clock = node.create_publisher(Clock, "/clock", CLOCK_DEPTH)
    data = node.create_publisher(Int32, "data", CLOCK_DEPTH)

    def publish(number):
        message = Clock()
        message.clock.sec = number
        clock.publish(message)
        data.publish(Int32(data=number))

    deadline_s = time.monotonic() + 10
    while seen.get(1) != 10**9 and time.monotonic() < deadline_s:
        # Until both are connected.
        publish(1)
        executor.spin_once(0.01)
    # All messages are queued before the node takes the first of them. Within one process, DDS keeps the order of
    # messages across topics.
    for number in range(2, COUNT):
        publish(number)
    while COUNT - 1 not in seen and time.monotonic() < deadline_s:
        executor.spin_once(0.01)
    executor.shutdown()
    node.destroy_node()  # and its DDS participant, which would outlive the context
    assert seen == {number: number * 10**9 for number in range(1, COUNT)}


@pytest.mark.live
def test_system_time_is_unchanged(context):
    node = rclpy.create_node("wall", context=context)
    queue_clock(node)
    # Only the node's own subscriptions are read: the graph may still hold nodes of other tests.
    topics = [subscription.topic_name for subscription in node.subscriptions]
    node.destroy_node()
    assert "/clock" not in topics


def test_first_call_only_starts_the_grid():
    assert list(TickGrid(100).ticks_until(1050)) == []


def test_every_tick_occurs_once():
    grid = TickGrid(100)
    list(grid.ticks_until(1050))
    assert list(grid.ticks_until(1099)) == []
    assert list(grid.ticks_until(1100)) == [1100]
    assert list(grid.ticks_until(1100)) == []
    assert list(grid.ticks_until(1420)) == [1200, 1300, 1400]


def test_a_small_jump_back_repeats_no_tick():
    grid = TickGrid(100)
    list(grid.ticks_until(1050))
    assert list(grid.ticks_until(1210)) == [1100, 1200]
    assert list(grid.ticks_until(1190)) == []
    assert list(grid.ticks_until(1300)) == [1300]


def test_restart_skips_missed_ticks():
    grid = TickGrid(100)
    list(grid.ticks_until(1050))
    grid.restart(500)
    assert list(grid.ticks_until(700)) == [600, 700]


def test_timeout_clock_counts_only_listening_time() -> None:
    start_ns, steady_ns = 1_700_000_000_000_000_000, 5_000_000_000
    clock = TimeoutClock(lambda: steady_ns)
    assert clock.now_ns(start_ns) == start_ns
    steady_ns += 1_200_000_000
    # No reading for that time: the node was stopped.
    assert clock.now_ns(start_ns) == start_ns + 200_000_000
    steady_ns += 50_000_000
    # Independent of the system's clock.
    assert clock.now_ns(start_ns - 3600 * 10**9) == start_ns + 250_000_000
    assert clock.now_ns(start_ns + 3600 * 10**9) == start_ns + 250_000_000

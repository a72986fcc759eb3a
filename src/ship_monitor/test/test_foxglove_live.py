"""A suite's topics at a Foxglove client: from DDS to the websocket, with unchanged bytes."""

import contextlib
import os
import signal
import time

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64, String

from ship_bags.live.ros_process import executable
from ship_bags.stamps import NS_PER_S
from ship_monitor.live import topic_reader as reader_module
from ship_monitor.live.live_suite import LiveSuite
from ship_monitor.web.foxglove_server import FoxgloveServer
from ship_msgs.msg import AlertArray, ErrorBudget, ShipAttitude
from ship_testing.foxglove_client import FoxgloveClient, client_that_never_reads
from ship_testing.publishing_ship import SuitePublisher, attitude
from ship_testing.trials.live_process import LiveProcess
from ship_watch.safety.limits import Limits

pytestmark = pytest.mark.live

START_NS = 1_700_000_000 * NS_PER_S
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def resources():
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def server(resources):
    server = FoxgloveServer("demo", "127.0.0.1", 0)
    resources.callback(server.close)
    return server


@pytest.fixture
def live_suite(resources, server):
    live_suite = LiveSuite("monitor", "demo", Limits(), server)
    resources.callback(live_suite.close)
    return live_suite


@pytest.fixture
def sail(resources):
    """Return a function that starts a ship."""

    def make(namespace="demo"):
        ship = SuitePublisher(namespace)
        resources.callback(ship.stop)
        return ship

    return make


@pytest.fixture
def connect(resources, server):
    def make():
        client = FoxgloveClient(server.address)
        resources.callback(client.close)
        return client

    return make


def subscribe(client, topic):
    """Subscribe to a topic of the ship after it has been offered."""
    client.wait_until(lambda: f"/demo/{topic}" in client.channels)
    client.subscribe(f"/demo/{topic}")


def receive(client, ship, topic, message):
    """Subscribe to a topic of the ship, and publish a message until it arrives: later messages then arrive too."""
    subscribe(client, topic)
    ship.publish(topic, message)
    client.wait_until(lambda: client.received or ship.publish(topic, message))


def decode(client, received):
    """Return a message decoded with its advertised definition only."""
    channel = client.channels[received.topic]
    schema = Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
    return DecoderFactory().decoder_for(channel["encoding"], schema)(received.data)


def hundred_attitudes():
    for number in range(100):
        message = attitude(START_NS + number * 10_000_000)
        message.heading, message.covariance[1] = number / 7.0, -number * 1e-13
        yield message


@pytest.mark.usefixtures("live_suite")
def test_messages_arrive_unchanged_with_definition_and_arrival_time(sail, connect):
    ship, client = sail(), connect()
    ship.publish("ship/attitude", attitude(START_NS))
    receive(client, ship, "ship/attitude", attitude(START_NS))
    messages = list(hundred_attitudes())
    # Published as bytes: the padding of two serializations of one message differs.
    published, begin_ns = [serialize_message(message) for message in messages], time.time_ns()
    for data in published:
        ship.publish("ship/attitude", data)
        time.sleep(0.01)
    client.wait_until(lambda: client.received[-1].data == published[-1])
    received = client.received[-100:]
    assert [each.data for each in received] == published
    times_ns = [each.log_time_ns for each in received]
    assert begin_ns <= times_ns[0] <= times_ns[-1] <= time.time_ns()
    # The times are arrivals of single messages, not the times of the fetches (twenty a second).
    assert len(set(times_ns)) == 100
    for each, message in zip(received, messages, strict=True):
        found = decode(client, each)
        assert (found.heading, list(found.covariance)) == (message.heading, list(message.covariance))
        assert (found.header.stamp.sec, found.header.stamp.nanosec, found.status) == (
            message.header.stamp.sec,
            message.header.stamp.nanosec,
            ShipAttitude.VALID,
        )


@pytest.mark.usefixtures("live_suite")
def test_all_topics_of_the_namespace_are_offered(sail, connect, server):
    ship, other, client = sail(), sail("voyage"), connect()
    ship.publish("ship/attitude", attitude(START_NS))
    ship.publish("ins/imu", Imu(), BEST_EFFORT)
    ship.publish("ship/error_budget", ErrorBudget())
    other.publish("ship/attitude", attitude(START_NS))
    expected = {"/demo/ship/attitude", "/demo/ins/imu", "/demo/ship/error_budget"}
    client.wait_until(lambda: expected <= set(client.channels))
    assert not any(topic.startswith("/voyage") for topic in client.channels)
    # Without a client there is no subscription to topics that the page does not read.
    assert not server.subscribed_topics()
    assert ship.publishers["ins/imu"].get_subscription_count() == 0
    imu = Imu()
    imu.angular_velocity.z = 0.1
    receive(client, ship, "ins/imu", imu)
    assert decode(client, client.received[0]).angular_velocity.z == 0.1
    client.unsubscribe("/demo/ins/imu")
    client.wait_until(lambda: ship.publishers["ins/imu"].get_subscription_count() == 0)


@pytest.mark.usefixtures("live_suite")
def test_late_clients_get_the_last_message_of_a_latched_topic(sail, connect):
    ship = sail()
    alerts = AlertArray()
    alerts.header.stamp.sec = 7
    ship.publish("ship/alerts", alerts, LATCHED)
    for client in (connect(), connect()):
        subscribe(client, "ship/alerts")
        client.wait_until(lambda client=client: client.received)
        assert decode(client, client.received[0]).header.stamp.sec == 7


@pytest.mark.usefixtures("live_suite")
def test_subscription_survives_a_restart_of_the_estimator(sail, connect):
    client = connect()
    for heading in (0.25, 0.5):
        ship = sail()
        message = attitude(START_NS)
        message.heading = heading
        ship.publish("ship/attitude", message)
        if heading == 0.25:
            subscribe(client, "ship/attitude")

        def came(ship=ship, message=message):
            ship.publish("ship/attitude", message)
            return any(decode(client, each).heading == message.heading for each in client.received)

        client.wait_until(came)
        ship.stop()
    assert sum(each["op"] == "advertise" for each in client.server_messages) == 1


@pytest.mark.parametrize("is_awaited", [False, True])
def test_topic_with_another_type_is_offered_again(sail, connect, live_suite, is_awaited):
    ship, client = sail(), connect()
    if is_awaited:  # Both types exist at the same time: the subscriber has Float64, the publisher has String.
        sail().node.create_subscription(Float64, "text", lambda _: None, 10)
    ship.publish("text", String(data="a"))
    receive(client, ship, "text", String(data="a"))
    client.wait_until(lambda: len(live_suite._relay._known_types["/demo/text"]) == 1 + is_awaited)
    ship.stop()
    ship = sail()
    ship.publish("text", Float64(data=1.0))
    client.wait_until(lambda: client.channels.get("/demo/text", {}).get("schemaName") == "std_msgs/msg/Float64")
    client.received.clear()
    receive(client, ship, "text", Float64(data=2.0))
    assert decode(client, client.received[0]).data == 2.0


def test_clients_receive_messages_after_a_sleep(sail, connect, live_suite, monkeypatch):
    ship, client = sail(), connect()
    ship.publish("ship/attitude", attitude(START_NS))
    receive(client, ship, "ship/attitude", attitude(START_NS))
    former = live_suite._reader.node
    asleep_ns = reader_module._sleep_time_ns() + 3600 * NS_PER_S
    monkeypatch.setattr(reader_module, "_sleep_time_ns", lambda: asleep_ns)
    client.wait_until(lambda: live_suite._reader.node is not former)
    client.received.clear()

    def came():
        ship.publish("ship/attitude", attitude(START_NS + NS_PER_S))
        return client.received

    client.wait_until(came)


def test_page_does_not_depend_on_a_client(sail, connect, live_suite):
    ship, client = sail(), connect()
    ship.publish("ship/attitude", attitude(START_NS))
    receive(client, ship, "ship/attitude", attitude(START_NS))
    times = iter(range(START_NS, START_NS + 1000 * NS_PER_S, NS_PER_S // 50))

    def heading():
        ship.publish("ship/attitude", attitude(next(times)))
        live_suite.tick()
        shown = next(each for each in live_suite.current_state().angles if each.name == "heading")
        return not shown.is_old and shown.value == 1.0

    client.wait_until(heading)


@pytest.fixture
def monitor(resources, tmp_path):
    """Return the process of the executable, and the address of its Foxglove server."""
    command = [*executable("ship_monitor", "monitor"), "--namespace", "demo", "--port", "0", "--foxglove", "0"]
    process = resources.enter_context(LiveProcess(command, tmp_path / "log", os.environ))
    deadline_s = time.monotonic() + 60.0
    while "http://" not in process.log_text():
        assert process.exit_code is None, process.log_text()
        assert time.monotonic() < deadline_s, process.log_text()
        time.sleep(0.05)
    return process, next(word for word in process.log_text().split() if word.startswith("ws://127.0.0.1:"))


def test_executable_serves_page_and_foxglove_and_ends_with_ctrl_c(sail, resources, monitor):
    process, address = monitor
    ship, client = sail(), FoxgloveClient(address)
    resources.callback(client.close)
    ship.publish("ship/attitude", attitude(START_NS))
    receive(client, ship, "ship/attitude", attitude(START_NS))
    assert client.server_messages[0]["name"] == "demo"
    assert process.end(signal.SIGINT) == 0
    client.wait_until(lambda: client.is_over)
    assert len(process.log_text().splitlines()) == 2, process.log_text()


def test_executable_ends_with_a_client_that_does_not_read(sail, resources, monitor):
    process, address = monitor
    ship, client = sail(), FoxgloveClient(address)
    resources.callback(client.close)
    message = String(data="x" * 60_000)
    ship.publish("text", message)
    receive(client, ship, "text", message)
    stalled = resources.enter_context(client_that_never_reads(address, client.channels["/demo/text"]["id"]))
    # These messages exceed the buffers of a connection: unread messages then wait in the server.
    client.received.clear()

    def has_come():
        for _ in range(5):
            ship.publish("text", message)
        return len(client.received) >= 200

    client.wait_until(has_come)
    assert process.end(signal.SIGTERM) == 0
    assert len(process.log_text().splitlines()) == 2, process.log_text()
    assert stalled.fileno() >= 0

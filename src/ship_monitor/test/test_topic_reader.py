"""The topic reader with publishers in its own domain."""

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_monitor.live import topic_reader as reader_module
from ship_monitor.live.topic_reader import MAX_QUEUE_DEPTH, TopicReader, steady_ns
from ship_msgs.msg import AlertArray, Innovation, ShipAttitude
from ship_testing.publishing_ship import SuitePublisher, attitude

pytestmark = pytest.mark.live

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def ship():
    ship = SuitePublisher()
    yield ship
    ship.stop()


def depth_of(topic, type_name):
    if topic.startswith("/"):
        return 0
    return MAX_QUEUE_DEPTH if type_name.endswith("/Innovation") else 1


@pytest.fixture
def reader():
    reader = TopicReader("monitor", "demo", depth_of)
    yield reader
    reader.close()


def fetch_until(reader, until, topic, count=1):
    """Return the messages of a topic after ``count`` of them have been fetched."""
    found = []

    def look():
        found.extend(each for each in reader.fetch().messages if each.topic == topic)
        return len(found) >= count

    until(look)
    return found


def publish_until_taken(ship, reader, until, message):
    """Publish an attitude until the reader fetches it: messages before the discovery of both sides are lost."""

    def look():
        ship.publish("ship/attitude", message)
        return any(each.message == message for each in reader.fetch().messages)

    assert until(look)


def test_newest_message_of_streams_and_every_message_of_other_topics(ship, reader, until):
    ship.publish("ins/imu", Imu())
    ship.publish("ship/innovation", Innovation())
    ship.wait_for_subscribers(until, reader.fetch, "ins/imu", "ship/innovation")
    reader.fetch()
    for number in range(50):
        imu = Imu()
        imu.header.stamp.sec = number + 1
        ship.publish("ins/imu", imu)
        ship.publish("ship/innovation", Innovation(nis=float(number)), 100)
    innovations, imus = [], []

    def have_all_come():
        for each in reader.fetch().messages:
            (imus if each.topic == "ins/imu" else innovations).append(each.message)
        return len(innovations) >= 50 and imus and imus[-1].header.stamp.sec == 50

    until(have_all_come)
    assert [each.nis for each in innovations][-50:] == [float(number) for number in range(50)]
    assert len(imus) < 50


def test_arrivals_are_ordered_and_between_two_fetches(ship, reader, until):
    ship.publish("ship/innovation", Innovation())
    ship.wait_for_subscribers(until, reader.fetch, "ship/innovation")
    before_ns = steady_ns()
    for number in range(5):
        ship.publish("ship/innovation", Innovation(nis=float(number)))
    arrived = fetch_until(reader, until, "ship/innovation", 5)
    times = [each.arrival_ns for each in arrived]
    assert times == sorted(times)
    assert before_ns - 1_000_000 <= times[0] <= times[-1] <= steady_ns()


def test_late_reader_gets_the_last_message_of_a_latched_topic(ship, reader, until):
    ship.publish("ship/alerts", AlertArray(), LATCHED)
    assert fetch_until(reader, until, "ship/alerts")


def test_restarted_publisher_is_received(reader, until):
    for namespace in ("demo", "demo"):
        ship = SuitePublisher(namespace)
        publish_until_taken(ship, reader, until, attitude(6 * NS_PER_S))
        ship.stop()


def test_topic_that_becomes_latched_is_subscribed_again(ship, reader, until):
    ship.publish("ship/alerts", AlertArray())
    ship.wait_for_subscribers(until, reader.fetch, "ship/alerts")
    ship.node.destroy_publisher(ship.publishers.pop("ship/alerts"))
    ship.publish("ship/alerts", AlertArray(), LATCHED)
    assert fetch_until(reader, until, "ship/alerts")


@pytest.mark.parametrize(("shift_s", "is_other_voyage"), [(-60, True), (60, False), (-2, False)])
def test_outputs_that_step_back_are_another_voyage(ship, reader, until, shift_s, is_other_voyage):
    ship.publish("ship/attitude", attitude(1000 * NS_PER_S))
    ship.wait_for_subscribers(until, reader.fetch, "ship/attitude")
    ship.publish("ship/attitude", attitude(1000 * NS_PER_S))
    fetch_until(reader, until, "ship/attitude")
    ship.publish("ship/attitude", attitude((1000 + shift_s) * NS_PER_S))
    taken = until(lambda: (taken := reader.fetch()).messages and taken)
    assert taken.time_went_back is is_other_voyage
    assert taken.messages[-1].message.header.stamp.sec == 1000 + shift_s


def test_invalid_attitude_is_no_step_back(ship, reader, until):
    ship.publish("ship/attitude", attitude(1000 * NS_PER_S))
    ship.wait_for_subscribers(until, reader.fetch, "ship/attitude")
    ship.publish("ship/attitude", attitude(1000 * NS_PER_S))
    fetch_until(reader, until, "ship/attitude")
    ship.publish("ship/attitude", attitude(10 * NS_PER_S, ShipAttitude.INVALID))
    taken = until(lambda: (taken := reader.fetch()).messages and taken)
    assert not taken.time_went_back


def test_clock_step_back_drops_earlier_messages(ship, reader, until):
    clock = Clock()
    clock.clock.sec = 100
    ship.publish("/clock", clock)
    ship.publish("ship/innovation", Innovation())
    ship.wait_for_subscribers(until, reader.fetch, "/clock", "ship/innovation")
    ship.publish("/clock", clock)
    until(lambda: reader.is_played and reader.fetch() and "/clock" in reader._latest_ns)
    ship.publish("ship/innovation", Innovation(nis=1.0))
    clock.clock.sec = 40
    ship.publish("/clock", clock)
    taken = until(lambda: (taken := reader.fetch()).time_went_back and taken)
    assert all(each.message.nis != 1.0 for each in taken.messages)
    ship.publish("ship/innovation", Innovation(nis=2.0))
    assert fetch_until(reader, until, "ship/innovation")[0].message.nis == 2.0


def clock_at(time_s):
    clock = Clock()
    clock.clock.sec = time_s
    return clock


def test_clock_in_the_namespace_is_used(ship, reader, until):
    """Each suite has the clock of its own bag, as with `suite --bag --namespace`."""
    ship.publish("ship/innovation", Innovation())
    ship.publish("clock", clock_at(100))
    ship.wait_for_subscribers(until, reader.fetch, "clock", "ship/innovation")
    ship.publish("clock", clock_at(100))
    until(lambda: reader.is_played and reader.fetch() and "/clock" in reader._latest_ns)
    ship.publish("clock", clock_at(40))
    until(lambda: reader.fetch().time_went_back)


def test_own_clock_replaces_the_global_one(ship, reader, until):
    ship.publish("/clock", clock_at(900))
    ship.wait_for_subscribers(until, reader.fetch, "/clock")
    ship.publish("/clock", clock_at(900))
    until(lambda: reader.is_played and reader.fetch() and "/clock" in reader._latest_ns)
    # The clock of the namespace is earlier than the global clock: no step back. Then the bag of the global clock
    # restarts.
    ship.publish("clock", clock_at(100))
    looks = []

    def receive(topic, time_s):
        def look():
            ship.publish(topic, clock_at(time_s))
            looks.append(reader.fetch())
            return reader._latest_ns.get("/clock") == time_s * NS_PER_S

        return look

    until(receive("clock", 100))
    for _ in range(20):
        receive("/clock", 5)()
    until(receive("clock", 101))
    assert not any(taken.time_went_back for taken in looks)
    # After the clock of the namespace has ended, the global clock is used again.
    ship.node.destroy_publisher(ship.publishers.pop("clock"))
    until(receive("/clock", 6))


def test_clock_topic_of_another_type_is_ignored(ship, reader, until):
    ship.publish("clock", Imu())
    ship.publish("ship/innovation", Innovation())
    ship.wait_for_subscribers(until, reader.fetch, "ship/innovation")
    assert not reader.is_played


def test_location_names_other_namespaces_with_a_suite(reader, until):
    assert reader.location.startswith("namespace /demo, domain ")
    other = SuitePublisher("voyage")
    other.publish("ship/attitude", attitude(1 * NS_PER_S))
    until(lambda: reader.fetch() and "suite found in /voyage" in reader.location)
    other.stop()


def test_truth_on_the_network_means_simulated(ship, reader, until):
    ship.publish("ship/attitude", attitude(1 * NS_PER_S))
    ship.wait_for_subscribers(until, reader.fetch, "ship/attitude")
    assert not reader.is_simulated
    ship.publish("truth/attitude", attitude(1 * NS_PER_S))
    until(lambda: reader.fetch() and reader.is_simulated)


def test_reader_rejoins_the_network_after_a_sleep(ship, reader, until, monkeypatch):
    publish_until_taken(ship, reader, until, attitude(1 * NS_PER_S))
    former = reader.node
    monkeypatch.setattr(reader_module, "_sleep_time_ns", lambda: 3600 * 10**9)
    reader.fetch()
    assert reader.node is not former
    publish_until_taken(ship, reader, until, attitude(2 * NS_PER_S))


def test_invalid_namespace_is_refused_in_one_line():
    with pytest.raises(BadInput, match=r"'/a b' is not a namespace"):
        TopicReader("monitor", "a b", lambda *_: 1)

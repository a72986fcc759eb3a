"""Live monitoring of a suite: start, end, restart, and a step back in time."""

import threading
import time

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from ship_bags.stamps import NS_PER_S
from ship_monitor.alerts.alert_node import AlertNode
from ship_monitor.live.live_suite import LiveSuite, queue_depth
from ship_monitor.live.topic_reader import DISCOVERY_NS, MAX_QUEUE_DEPTH
from ship_msgs.msg import Alert, AlertArray, SuiteSource, SuiteState
from ship_testing.publishing_ship import SuitePublisher, attitude
from ship_watch.safety.limits import Limits
from ship_watch.suite_state import Safety

pytestmark = pytest.mark.live

START_NS = 1_700_000_000 * NS_PER_S


@pytest.fixture
def live_suite():
    live_suite = LiveSuite("monitor", "demo", Limits())
    yield live_suite
    live_suite.close()


@pytest.fixture
def ship():
    ship = SuitePublisher()
    yield ship
    ship.stop()


def heading(live_suite):
    live_suite.tick()
    return next(each for each in live_suite.current_state().angles if each.name == "heading")


def sail(ship, live_suite, until, time_ns=START_NS):
    """Publish attitudes until one is displayed."""
    times = iter(range(time_ns, time_ns + 1000 * NS_PER_S, NS_PER_S // 50))

    def look():
        ship.publish("ship/attitude", attitude(next(times)))
        return (shown := heading(live_suite)) and not shown.is_old and shown

    return until(look)


def test_location_is_shown_while_waiting(live_suite):
    live_suite.tick()
    assert live_suite.current_state().waiting_for == "ship/attitude"
    assert live_suite.location.startswith("namespace /demo, domain ")
    assert (live_suite.name, live_suite.label) == ("demo", "LIVE")


@pytest.mark.smoke
def test_suite_started_later_is_shown(live_suite, ship, until):
    heading(live_suite)
    assert sail(ship, live_suite, until).value == 1.0
    assert live_suite.current_state().waiting_for == ""


@pytest.mark.smoke
def test_ended_suite_gets_old_and_recovers(live_suite, until):
    for start_ns in (START_NS, START_NS + 100 * NS_PER_S):
        ship = SuitePublisher()
        sail(ship, live_suite, until, start_ns)
        ship.stop()
        until(lambda: heading(live_suite).is_old)


def test_step_back_in_time_resets_the_state(live_suite, ship, until):
    sail(ship, live_suite, until)
    ship.publish("ship/attitude", attitude(START_NS - 3600 * NS_PER_S))
    until(lambda: heading(live_suite).stamp_ns < START_NS)
    assert all(event.utc_ns < START_NS for event in live_suite.current_state().events)


def test_busy_display_causes_no_timeout(live_suite, ship, until):
    sail(ship, live_suite, until)
    stamp_ns = heading(live_suite).stamp_ns
    # Two seconds without an update of the display while the ship publishes; an attitude is old after 1 s.
    for number in range(1, 101):
        ship.publish("ship/attitude", attitude(stamp_ns + number * NS_PER_S // 50))
        time.sleep(0.02)
    live_suite.tick()
    live_suite.current_state()
    assert not [event for event in live_suite.current_state().events if "no data" in event.text]


def test_played_bag_with_truth_is_simulated(live_suite, ship, until):
    sail(ship, live_suite, until)
    assert live_suite.label == "LIVE"
    ship.publish("truth/attitude", attitude(START_NS))
    until(lambda: heading(live_suite) and live_suite.label == "SIMULATED")
    ship.stop()
    until(lambda: heading(live_suite).is_old)
    time.sleep(2 * DISCOVERY_NS / NS_PER_S)
    assert live_suite.label == "SIMULATED"  # the displayed values are still simulated


def test_alerts_of_an_ended_node_are_cleared(live_suite, until):
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for _ in range(2):
        ship = SuitePublisher()
        alert = Alert(id="ins.out", priority=Alert.ALARM, instance=1, state=Alert.ACTIVE_UNACKNOWLEDGED)
        ship.publish("ship/alerts", AlertArray(alerts=[alert]), latched)
        until(
            lambda: (
                heading(live_suite) and [alert.id for alert in live_suite.current_state().alerts or ()] == ["ins.out"]
            )
        )
        ship.stop()
        until(lambda: heading(live_suite) and live_suite.current_state().alerts is None)


@pytest.mark.parametrize(
    ("topic", "type_name", "count"),
    [
        ("ship/attitude", "ship_msgs/msg/ShipAttitude", 1),
        ("ship/innovation", "ship_msgs/msg/Innovation", MAX_QUEUE_DEPTH),
        ("ship/attitude", "std_msgs/msg/String", 0),
        ("ins/imu", "sensor_msgs/msg/Imu", 0),
    ],
)
def test_queue_depths(topic, type_name, count):
    assert queue_depth(topic, type_name) == count


def test_page_terminal_and_alerts_show_one_state(ship, until):
    """Displays show the state of an alert node with tight limits; after the node has ended, they show their own."""
    tight = Limits(heading_arcsec=0.2, tilt_arcsec=0.2, pointing_arcsec=0.2)
    context = Context()
    rclpy.init(context=context)
    node = Node("alerts", context=context, namespace="demo")
    alerts = AlertNode(node, tight, None)
    thread = threading.Thread(target=alerts.run)
    thread.start()
    viewers = [LiveSuite(name, "demo", Limits()) for name in ("monitor", "monitor_terminal")]
    times = iter(range(START_NS, START_NS + 1000 * NS_PER_S, NS_PER_S // 50))

    def words():
        ship.publish("ship/attitude", attitude(next(times)))
        shown = [viewer.current_state().angles for viewer in viewers]
        return [[(angle.limit, angle.safety, angle.reason) for angle in angles[:3]] for angles in shown]

    try:
        wanted = tight.angle_limit("heading")
        by_page, by_terminal = until(lambda: (now := words()) and now[0][0][0] == now[1][0][0] == wanted and now)
        assert by_page == by_terminal
        assert by_page[0][1] is not Safety.SAFE
        alerts.stop()
        thread.join()
        own = Limits().angle_limit("heading")
        assert until(lambda: (now := words()) and now[0][0][0] == now[1][0][0] == own)
    finally:
        alerts.stop()
        thread.join()
        for viewer in viewers:
            viewer.close()
        node.destroy_node()  # otherwise its latched alerts remain in the domain for other tests
        context.try_shutdown()


def test_invalid_state_is_dropped_and_later_messages_are_processed(live_suite, ship, until, caplog):
    """SuiteState messages with an unknown presence are dropped with one warning; the attitude is still displayed."""
    wrong = SuiteState(sources=[SuiteSource(name="ins", presence=9)])
    times = iter(range(START_NS, START_NS + 1000 * NS_PER_S, NS_PER_S // 50))

    def look():
        ship.publish("ship/suite_state", wrong)
        ship.publish("ship/attitude", attitude(next(times)))
        shown = heading(live_suite)
        return "presence 9" in caplog.text and not shown.is_old and shown

    assert until(look).value == 1.0
    assert caplog.text.count("is not shown") == 1

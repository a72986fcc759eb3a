"""Real node over real DDS: relaying, exceptions, refusals, clocks."""

import math
import os
import re
import subprocess
import sys
import threading
import time
from itertools import pairwise
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

import ship_node.live.node_clock as node_clock
import ship_node.live.node_events as node_events
from ship_bags.message_store import message_store
from ship_bags.stamps import ns_from_stamp
from ship_node.adapters.adapter import TICK_PERIOD_NS
from ship_node.live.node_clock import CLOCK_TIMEOUT_NS
from ship_node.live.node_events import MAX_MESSAGE_BYTES
from ship_testing.live_relay import RELIABLE_INPUT, SIM_TIME, TIMEOUT_S, imu_message
from ship_testing.relay_adapter import EXPLOSIVE_FRAME

IMU = "sensor_msgs/msg/Imu"
RELIABLE = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)

pytestmark = pytest.mark.live


def set_parameter(relay, name: str, value: object):
    parameter = Parameter(name, value=value).to_parameter_msg()
    return relay.call(SetParameters, "set_parameters", SetParameters.Request(parameters=[parameter])).results[0]


@pytest.mark.smoke
def test_relays_a_thousand_messages_at_500_hz_and_loses_none(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    sent_ns = []
    for _ in range(1000):
        sent_ns.append(time.time_ns())
        publisher.publish(imu_message(sent_ns[-1]))
        relay.spin()
        time.sleep(0.002)
    relay.wait_until(lambda: len(relay.attitudes) >= 1000)
    assert [ns_from_stamp(a.header.stamp) for a in relay.attitudes] == sent_ns


def test_messages_of_another_byte_order_length_or_text_are_read_too(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    store, sent_ns = message_store(), [time.time_ns() + number for number in range(4)]
    frames = "ins", "gps", "ins", "ins"
    usual, other, swapped, longer = map(serialize_message, map(imu_message, sent_ns, frames))
    swapped = bytes(store.serialize_cdr(store.deserialize_cdr(swapped, IMU), IMU, little_endian=False))
    assert swapped[1] == 0, "big endian"
    for data in (usual, other, swapped, longer + bytes(4)):
        publisher.publish(data)
    relay.wait_until(lambda: len(relay.attitudes) == 4)
    assert [ns_from_stamp(a.header.stamp) for a in relay.attitudes] == sent_ns


def test_exception_in_handle_is_reported_and_the_next_message_is_relayed(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    for _ in range(3):
        publisher.publish(imu_message(time.time_ns(), EXPLOSIVE_FRAME))
    publisher.publish(imu_message(time.time_ns()))
    relay.wait_until(lambda: len(relay.attitudes) == 1)
    relay.wait_until(lambda: relay.has_level("relay: callbacks", DiagnosticStatus.ERROR))
    text = relay.diagnostics["relay: callbacks"].message
    assert text.startswith("exceptions: 3, the last in ins/imu: RuntimeError: a defect of the adapter")
    assert "relay_adapter.py:" in text


def test_message_rejected_by_the_adapter_is_counted_and_shown(live_relay):
    relay = live_relay(*RELIABLE_INPUT, "-p", "frame_id:=ins")
    publisher = relay.imu_publisher()
    publisher.publish(imu_message(time.time_ns(), "radar"))
    relay.wait_until(lambda: "rejected, frame" in getattr(relay.diagnostics.get("relay: input ins/imu"), "message", ""))
    status = relay.diagnostics["relay: input ins/imu"]
    assert status.message == "rejected, frame: frame_id is 'radar': expected 'ins'"
    assert {v.key: v.value for v in status.values}["reason frame"] == "1"
    assert relay.attitudes == []


def test_a_step_of_the_systems_clock_is_reported_once(live_relay, monkeypatch):
    off_ns = [0]
    monkeypatch.setattr(node_clock, "time", SimpleNamespace(time_ns=lambda: time.time_ns() + off_ns[0]))
    relay = live_relay(*RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    for number, step_s in enumerate((0, -300, 900), start=1):
        off_ns[0] += step_s * 10**9
        publisher.publish(imu_message(time.time_ns() + off_ns[0]))
        relay.wait_until(lambda number=number: len(relay.attitudes) == number)
    assert [round(step_ns / 1e9, 2) for step_ns in relay.adapter.clock_steps] == [-300.0, 900.0]


def test_services_answer_also_if_the_adapter_raises(live_relay):
    relay = live_relay()
    assert relay.call(Trigger, "reset", Trigger.Request()) == Trigger.Response(success=True, message="reset")
    answer = relay.call(Trigger, "explode", Trigger.Request())
    assert not answer.success
    assert "exception" in answer.message
    assert relay.call(Trigger, "reset", Trigger.Request()).success


def test_live_parameter_reaches_the_adapter(live_relay):
    relay = live_relay()
    assert set_parameter(relay, "gate.probability", 0.75).successful
    assert relay.adapter.changes == {"gate.probability": 0.75}
    assert relay.live.node.get_parameter("gate.probability").value == 0.75
    assert set_parameter(relay, "offsets_s", [2.0, 3.0, 4.0]).successful
    assert relay.adapter.changes["offsets_s"] == [2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("gate.probability", 1.5, "parameter 'gate.probability' = 1.5 is out of its range [0.5, 1.0]"),
        ("gate.probability", "high", "parameter 'gate.probability' must be of type float, got 'high'"),
        ("gate.probability", 1, "expected 'Type.DOUBLE' got 'Type.INTEGER'"),
        ("gate.bias_deg", math.nan, "parameter 'gate.bias_deg' must be finite, got nan"),
        ("gate.count", 13, "parameter 'gate.count' = 13 is not wanted by the adapter"),
        ("gate.count", 0, "parameter 'gate.count' = 0 is out of its range [1, inf]"),
        ("offsets_s", [1.0, 10.0], "parameter 'offsets_s[1]' = 10.0 s is out of its range [-inf, 9.0] s"),
        ("sensors.fore.elevation_deg", 50.0, "cannot be changed while the node runs: set it at the start"),
        ("gate.probabilty", 0.75, "parameter 'gate.probabilty' is unknown"),
        ("use_sim_time", 3, "expected 'Type.BOOL' got 'Type.INTEGER'"),
        pytest.param("use_sim_time", True, "cannot be changed while the node runs", id="use_sim_time_changed"),
    ],
)
def test_bad_live_parameter_is_refused_with_a_reason(live_relay, name, value, reason):
    relay = live_relay("-p", "sensors.fore.elevation_deg:=45")
    before = relay.live.node.get_parameter_or(name).value
    result = set_parameter(relay, name, value)
    assert not result.successful
    assert reason in result.reason
    assert relay.adapter.changes == {}
    assert relay.live.node.get_parameter_or(name).value == before


def test_parameters_are_described_with_unit_and_range(live_relay):
    relay = live_relay("-p", "sensors.fore.elevation_deg:=45")
    request = DescribeParameters.Request(names=["sensors.fore.elevation_deg", "gate.count", "sensors.fore.mode"])
    elevation, count, mode = relay.call(DescribeParameters, "describe_parameters", request).descriptors
    assert (elevation.description, elevation.read_only) == ("elevation [deg]", True)
    bounds = elevation.floating_point_range[0]
    assert (bounds.from_value, bounds.to_value, bounds.step) == (-90.0, 90.0, 0.0)
    assert (count.integer_range[0].from_value, count.read_only) == (1, False)
    assert mode.additional_constraints == "one of fast, slow"
    # 45 was an integer on the command line.
    assert relay.adapter.config.sensors["fore"].elevation_deg == 45.0
    parameter = relay.live.node.get_parameter("sensors.fore.elevation_deg").get_parameter_value()
    assert parameter == ParameterValue(type=3, double_value=45.0)


def test_publisher_with_incompatible_qos_is_an_error_that_names_the_policy(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    relay.imu_publisher(ReliabilityPolicy.BEST_EFFORT, match=False)
    name = "relay: input ins/imu"
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.ERROR))
    assert "incompatible QoS" in relay.diagnostics[name].message
    assert "RELIABILITY" in relay.diagnostics[name].message


def test_quality_of_service_of_the_contract(live_relay):
    node = live_relay().live.node
    (imu,) = node.get_subscriptions_info_by_topic("/ins/imu")
    assert imu.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    (attitude,) = node.get_publishers_info_by_topic("/ship/attitude")
    assert attitude.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert attitude.qos_profile.durability == DurabilityPolicy.VOLATILE
    (calibration,) = node.get_publishers_info_by_topic("/ship/calibration")
    assert calibration.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ((), ReliabilityPolicy.RELIABLE),
        (("-p", "qos_overrides./ins/imu.subscription.reliability:=best_effort"), ReliabilityPolicy.BEST_EFFORT),
    ],
)
def test_reliable_inputs_and_the_override_of_one_topic(live_relay, more, expected):
    (imu,) = live_relay("-p", "reliable_inputs:=true", *more).live.node.get_subscriptions_info_by_topic("/ins/imu")
    assert imu.qos_profile.reliability == expected


def test_a_reliable_input_queues_a_burst_after_an_outage(live_relay):
    """The burst is five times as long as the queue of a best-effort input, and faster than the slow node."""
    relay = live_relay("-p", "reliable_inputs:=true")
    process, count = relay.adapter.process, 5 * relay.adapter.inputs[0].depth

    def process_slowly(batch):
        time.sleep(0.002)
        return process(batch)

    relay.adapter.process = process_slowly
    publisher = relay.imu_publisher()
    for number in range(count):
        publisher.publish(imu_message(10**9 + number * 10**7))
    relay.wait_until(lambda: len(relay.attitudes) == count)


def test_a_flood_stops_neither_ticks_nor_later_messages(live_relay):
    relay = live_relay()
    process, depth = relay.adapter.process, relay.adapter.inputs[0].depth

    def process_slowly(batch):
        time.sleep(0.002)
        return process(batch)

    relay.adapter.process = process_slowly
    publisher = relay.imu_publisher(ReliabilityPolicy.BEST_EFFORT)
    old = serialize_message(imu_message(10**9))
    ticks_before = len(relay.adapter.ticks)
    end_s = time.monotonic() + 1.5
    while time.monotonic() < end_s:
        for _ in range(10):
            publisher.publish(old)
        time.sleep(0.001)
    # Without limits, thousands of events would now wait in front of the ticks.
    assert len(relay.adapter.ticks) - ticks_before >= 5
    handled = len(relay.adapter.handled)
    relay.wait_until(lambda: len(relay.live._inbox) == 0)
    assert len(relay.adapter.handled) - handled <= 3 * depth
    relay.wait_until(lambda: "reason overflow" in {v.key for v in relay.diagnostics["relay: input ins/imu"].values})
    latest_ns = time.time_ns()
    publisher.publish(imu_message(latest_ns))
    relay.wait_until(lambda: ns_from_stamp(relay.attitudes[-1].header.stamp) == latest_ns)


def test_waiting_messages_are_processed_before_timeouts_after_a_standstill(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    process, uses = relay.adapter.process, []

    def process_noting(batch):
        uses.append(batch.arrivals[0].waiting_ns)
        if len(uses) == 1:
            time.sleep(1.3)
        return process(batch)

    relay.adapter.process = process_noting
    publisher = relay.imu_publisher()
    for _ in range(30):
        publisher.publish(imu_message(time.time_ns()))
        relay.spin()
        time.sleep(0.03)
    relay.wait_until(lambda: len(relay.attitudes) == 30)
    # The timeout clock hardly advanced: at most two ticks are between the messages before and after the stop.
    stop_ns = max(later - earlier for earlier, later in pairwise(uses))
    assert stop_ns <= 2 * TICK_PERIOD_NS
    assert sum(uses[0] < tick_ns <= uses[1] for tick_ns in relay.adapter.ticks) <= 2


def test_overload_state_begins_and_ends_with_the_load(live_relay):
    """The load is ten times what the node can process on any computer: 100 Hz, and each message takes 0.1 s."""
    relay = live_relay(*RELIABLE_INPUT)
    process, load_s, used = relay.adapter.process, 0.1, []

    def process_slowly(batch):
        time.sleep(load_s)
        used.append(ns_from_stamp(batch.arrivals[0].message.header.stamp))
        return process(batch)

    relay.adapter.process = process_slowly
    publisher = relay.imu_publisher()

    def publish_until(happened):
        end_s = time.monotonic() + TIMEOUT_S
        while not happened():
            assert time.monotonic() < end_s, (relay.adapter.overloads, relay.diagnostics)
            publisher.publish(imu_message(time.time_ns()))
            relay.spin()
            time.sleep(0.01)

    publish_until(lambda: len(relay.adapter.overloads) == 2)
    publish_until(lambda: len(used) > 3 and used[-1] > used[-2])
    for overload in relay.adapter.overloads:
        assert overload.behind_s > 1.0
        assert overload.cut["ins/imu"] > 10
    load_s = 0.0
    publish_until(lambda: relay.adapter.overloads[-1].behind_s == 0.0)
    assert used == sorted(used)
    received = relay.adapter.health.records["ins/imu"].received
    publish_until(lambda: relay.adapter.health.records["ins/imu"].received > received + 20)
    assert relay.adapter.overloads[-1].behind_s == 0.0


@pytest.fixture
def slow_bag_relay(live_relay, monkeypatch):
    """Return a function that starts a relay with /clock, lets events wait at a standstill, and goes on.

    The node then takes at most ``max_events`` events at once.
    """

    def run(max_events: int, first_clock_s: float | None, bag_times_s: list[float]):
        relay = live_relay(*SIM_TIME, *RELIABLE_INPUT)
        set_time, publisher = relay.clock_publisher(), relay.imu_publisher()
        clock = relay.peer.create_publisher(Clock, "/clock", 100)
        relay.wait_until(lambda: clock.get_subscription_count() == 1)
        if first_clock_s is not None:
            set_time(first_clock_s)
            relay.wait_until(lambda: relay.live._last_ns == round(first_clock_s * 1e9))
        take, stands, goes_on = relay.live._events.process_events, threading.Event(), threading.Event()

        def take_after_standstill(timeout_s):
            stands.set()
            assert goes_on.wait(TIMEOUT_S)
            return take(timeout_s)

        # On a busy machine the first event may take long although it existed already.
        monkeypatch.setattr(node_events, "_WAITED_NS", 10**10)
        monkeypatch.setattr(node_events, "MAX_EVENTS", max_events)
        monkeypatch.setattr(relay.live._events, "process_events", take_after_standstill)
        assert stands.wait(TIMEOUT_S)
        for bag_s in bag_times_s:
            bag_ns = round(bag_s * 1e9)
            publisher.publish(imu_message(bag_ns))
            clock.publish(Clock(clock=imu_message(bag_ns).header.stamp))
        assert publisher.wait_for_all_acked()
        goes_on.set()
        return relay

    return run


SIX_SECONDS = [1000.0 + 0.1 * tenth for tenth in range(61)]


@pytest.mark.parametrize("first_clock_s", [1000.0, None], ids=["after the first clock", "before the first clock"])
def test_events_waiting_in_bag_time_are_an_overload(slow_bag_relay, first_clock_s):
    """A node that processes one event at a time uses each message immediately, but six seconds of the bag wait as
    events.
    """
    relay = slow_bag_relay(1, first_clock_s, SIX_SECONDS)
    relay.wait_until(lambda: relay.adapter.overloads)
    assert relay.adapter.overloads[0].behind_s > 1.0


@pytest.mark.parametrize("first_clock_s", [1000.0, None], ids=["after the first clock", "before the first clock"])
def test_messages_that_wait_too_long_are_dropped_when_the_clock_goes_back(slow_bag_relay, first_clock_s):
    """Processing them all would stop a slow node for as long as that takes, without another check."""
    relay = slow_bag_relay(1000, first_clock_s, [*SIX_SECONDS, 500.0])
    relay.wait_until(lambda: relay.adapter.resets == [500_000_000_000])
    assert relay.adapter.overloads[0].behind_s > 3.0
    assert sum(overload.cut["ins/imu"] for overload in relay.adapter.overloads) > 30
    assert 0 not in relay.adapter.overload_times_ns
    relay.wait_until(lambda: relay.adapter.overloads[-1].behind_s == 0.0)


def test_an_oversized_message_is_counted_and_dropped(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    publisher.publish(imu_message(time.time_ns(), "x" * 2 * MAX_MESSAGE_BYTES))
    publisher.publish(imu_message(time.time_ns()))
    relay.wait_until(lambda: len(relay.attitudes) == 1)
    name = "relay: input ins/imu"
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.WARN))
    assert "rejected, overflow: 1 messages dropped, the last larger than" in relay.diagnostics[name].message
    assert len(relay.adapter.handled) == 1


def test_bag_time_ticks_on_the_grid_and_a_jump_back_restarts_once(live_relay):
    relay = live_relay(*SIM_TIME, *RELIABLE_INPUT)
    set_time = relay.clock_publisher()
    for time_s in (1000.03, 1000.12, 1000.34):
        set_time(time_s)
        # Wait until the node has read /clock; otherwise a slow node would begin its grid at the next time.
        relay.wait_until(lambda time_s=time_s: relay.live._last_ns == round(time_s * 1e9))
    relay.wait_until(lambda: len(relay.adapter.ticks) == 3)
    assert relay.adapter.ticks == [1000_100_000_000, 1000_200_000_000, 1000_300_000_000]
    set_time(1000.33)
    assert relay.adapter.resets == []
    set_time(500.0)
    relay.wait_until(lambda: relay.adapter.resets == [500_000_000_000])
    set_time(500.1)
    relay.wait_until(lambda: relay.adapter.ticks[3:] == [500_100_000_000])
    relay.imu_publisher().publish(imu_message(500_050_000_000))
    relay.wait_until(lambda: len(relay.attitudes) == 1)
    assert len(relay.adapter.resets) == 1


def test_long_jump_forward_is_not_made_up_for_tick_by_tick(live_relay):
    relay = live_relay(*SIM_TIME)
    set_time = relay.clock_publisher()
    set_time(1000.0)
    relay.wait_until(lambda: relay.live._last_ns == 1000_000_000_000)
    set_time(5000.0)
    relay.wait_until(lambda: relay.live._last_ns == 5000_000_000_000)
    set_time(5000.1)
    relay.wait_until(lambda: relay.adapter.ticks == [5000_100_000_000])


def test_messages_before_the_first_clock_wait_for_it(live_relay):
    relay = live_relay(*SIM_TIME, *RELIABLE_INPUT)
    publisher = relay.imu_publisher()
    for stamp_s in (999, 1000):
        publisher.publish(imu_message(stamp_s * 1_000_000_000))
    relay.wait_until(lambda: len(relay.live._inbox) == 2)
    assert relay.adapter.ticks == []
    assert not relay.call(Trigger, "reset", Trigger.Request()).success
    relay.clock_publisher()(1000.0)
    relay.wait_until(lambda: len(relay.attitudes) == 2)
    assert relay.adapter.handled == [1000_000_000_000] * 2


def test_topic_with_a_publisher_and_no_message_is_reported_after_five_seconds(live_relay):
    relay = live_relay(*SIM_TIME, *RELIABLE_INPUT)
    set_time = relay.clock_publisher()
    relay.imu_publisher()
    name = "relay: input ins/imu"
    set_time(1000.0)
    for tenth in range(1, 50):
        set_time(1000.0 + 0.1 * tenth)
    assert relay.diagnostics[name].level == DiagnosticStatus.OK
    relay.wait_until(lambda: relay.adapter.health._publishers.get("ins/imu") == 1)
    # The timeout begins with the first /clock received: on a busy computer that is not the first one published.
    set_time(1008.0)
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.ERROR))
    text = r"required input: no message for [5-8] s from 1 publisher\(s\): QoS mismatch"
    assert re.match(text, relay.diagnostics[name].message)


def test_clock_that_never_starts_is_an_error(live_relay):
    relay = live_relay(*SIM_TIME)
    name = "relay: clock"
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.ERROR))
    assert "but no /clock for" in relay.diagnostics[name].message


def test_timeout_of_clock_is_reported_and_timeouts_continue(live_relay):
    relay = live_relay(*SIM_TIME, *RELIABLE_INPUT)
    name, set_time = "relay: clock", relay.clock_publisher()
    # A paused playback also publishes the same time again and again.
    end_s = time.monotonic() + CLOCK_TIMEOUT_NS * 1e-9 + 1.0
    while time.monotonic() < end_s:
        set_time(1000.0)
        relay.spin()
        assert not relay.has_level(name, DiagnosticStatus.ERROR)
    relay.imu_publisher().publish(imu_message(1000_000_000_000))
    relay.wait_until(lambda: len(relay.attitudes) == 1)
    ticks = len(relay.adapter.ticks)
    # No /clock from now on.
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.ERROR))
    assert re.fullmatch(r"no /clock for \d+ s: node time is frozen", relay.diagnostics[name].message)
    relay.wait_until(lambda: len(relay.adapter.ticks) >= ticks + 22)
    # The node time is frozen, the timeout clock goes on, tick by tick.
    assert relay.adapter.node_times[-1] == 1000_000_000_000
    assert relay.adapter.ticks[ticks:][:22] == [1000_000_000_000 + n * TICK_PERIOD_NS for n in range(1, 23)]
    relay.wait_until(lambda: "no data for" in relay.diagnostics["relay: input ins/imu"].message)

    set_time(1000.5)
    relay.wait_until(lambda: relay.has_level(name, DiagnosticStatus.OK))
    relay.wait_until(lambda: relay.adapter.node_times[-1] > 1000_000_000_000)
    assert relay.adapter.ticks == sorted(set(relay.adapter.ticks))
    assert relay.adapter.node_times == sorted(relay.adapter.node_times)
    assert relay.adapter.resets == []


def test_two_nodes_with_one_name_are_reported(live_relay):
    relay = live_relay()
    relay.wait_until(lambda: relay.has_level("relay: name", DiagnosticStatus.OK))
    twin = rclpy.create_node("relay", context=relay.context, use_global_arguments=False)
    relay.wait_until(lambda: relay.has_level("relay: name", DiagnosticStatus.ERROR))
    assert relay.diagnostics["relay: name"].message.startswith("2 nodes are called '/relay': stop all but one")
    twin.destroy_node()
    relay.wait_until(lambda: relay.has_level("relay: name", DiagnosticStatus.OK))


def test_a_bag_of_another_year_is_reported_with_the_remedy(live_relay, capfd):
    relay = live_relay(*RELIABLE_INPUT)
    # /clock is published too, and the node does not use it.
    relay.peer.create_publisher(Clock, "/clock", 10)
    publisher = relay.imu_publisher()
    for _ in range(3):
        publisher.publish(imu_message(1_400_000_000_000_000_000))
    name = "relay: input ins/imu"
    relay.wait_until(lambda: "use_sim_time:=true" in getattr(relay.diagnostics.get(name), "message", ""))
    assert relay.diagnostics[name].level == DiagnosticStatus.ERROR
    text = r"stamps \d\d years before the node's clock: /clock is published: start the node with use_sim_time"
    assert re.match(text, relay.diagnostics[name].message)
    assert len(relay.attitudes) == 3
    assert capfd.readouterr().err.count("years before the node's clock") == 1


class Sender:
    """Node that publishes ins/imu."""

    def __init__(self, relay, name: str) -> None:
        self.node = rclpy.create_node(name, context=relay.context, use_global_arguments=False)
        self.publisher = self.node.create_publisher(Imu, "ins/imu", RELIABLE)
        relay.wait_until(lambda: self.publisher.get_subscription_count() == 1)

    def send(self) -> None:
        self.publisher.publish(imu_message(time.time_ns()))


@pytest.fixture
def two_senders(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    senders = Sender(relay, "ins_a"), Sender(relay, "ins_b")
    yield relay, *senders
    for sender in senders:
        sender.node.destroy_node()


TWO = "two publishers send on ins/imu: /ins_a and /ins_b; stop all but one"


def send_until(relay, senders, happened) -> float:
    """Return the time until a condition is met while all senders publish at 20 Hz, s."""
    start_s = time.monotonic()

    def all_sent_and_happened() -> bool:
        for sender in senders:
            sender.send()
        time.sleep(0.05)
        return happened()

    relay.wait_until(all_sent_and_happened)
    return time.monotonic() - start_s


def test_two_active_publishers_are_named_until_one_has_stopped(two_senders):
    relay, first, second = two_senders
    send_until(relay, [first], lambda: len(relay.attitudes) >= 20)
    assert relay.adapter.duplicates == []
    found_s = send_until(relay, [first, second], lambda: relay.adapter.duplicates == [("ins/imu", TWO)])
    send_until(relay, [first, second], lambda: relay.has_level("relay: input ins/imu", DiagnosticStatus.ERROR))
    assert relay.diagnostics["relay: input ins/imu"].message == TWO
    over_s = send_until(relay, [first], lambda: relay.adapter.duplicates[1:] == [("ins/imu", "")])
    send_until(relay, [first], lambda: relay.has_level("relay: input ins/imu", DiagnosticStatus.OK))
    print(f"found after {found_s:.2f} s, over {over_s:.2f} s after one has stopped")


def test_a_publisher_that_never_sends_is_a_hint_in_the_diagnostics(two_senders):
    relay, first, _ = two_senders
    send_until(relay, [first], lambda: relay.has_level("relay: input ins/imu", DiagnosticStatus.OK))

    def input_text() -> str:
        values = relay.diagnostics["relay: input ins/imu"].values
        return next((value.value for value in values if value.key == "publishers"), "")

    send_until(relay, [first], lambda: input_text() == "2: /ins_a, /ins_b")
    assert relay.adapter.duplicates == []


@pytest.mark.slow
def test_a_restarted_publisher_counts_as_one(live_relay):
    relay = live_relay(*RELIABLE_INPUT)
    script = (
        "import rclpy, time; from sensor_msgs.msg import Imu; from ship_testing.live_relay import imu_message\n"
        "rclpy.init(); node = rclpy.create_node('ins'); publisher = node.create_publisher(Imu, 'ins/imu', 100)\n"
        "while True: publisher.publish(imu_message(time.time_ns())); time.sleep(0.02)"
    )
    path = os.pathsep.join(sys.path)
    for _ in range(2):
        count = len(relay.attitudes)
        process = subprocess.Popen([sys.executable, "-c", script], env=os.environ | {"PYTHONPATH": path})
        try:
            relay.wait_until(lambda: len(relay.attitudes) >= count + 100)  # noqa: B023 - called in this round alone
        finally:
            process.kill()
            process.wait()
    assert relay.live.node.count_publishers("/ins/imu") == 2, "the lease of the first one has not ended"
    assert relay.adapter.duplicates == []

"""Bounded queues: events are dropped before they accumulate, and the newest messages still arrive.

The messages that wait for an adapter are in order, bounded, and counted when cut.
"""

import time

import pytest
import rclpy
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Int32
from std_srvs.srv import SetBool

from ship_node.live.node_events import MAX_EVENTS, MAX_MESSAGE_BYTES, Inbox, NodeEvents, WaitingMessage
from ship_node.live.node_report import ExceptionGuard
from ship_node.messages.common_messages import Level

DEPTH = 100
S = 1_000_000_000


@pytest.fixture
def context(own_domain):
    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


@pytest.mark.live
def test_events_do_not_accumulate_in_the_executor(context):
    node = rclpy.create_node("flooded", context=context)
    steady_ns = 0
    events = NodeEvents(context, ExceptionGuard(node.get_logger(), time.monotonic_ns), lambda: steady_ns)
    seen = []

    def take(data):
        events.note_event()
        seen.append(data)

    node.create_subscription(Int32, "data", take, DEPTH, raw=True)
    publisher = node.create_publisher(Int32, "data", DEPTH)
    events.start(node)
    sent = [serialize_message(Int32(data=number)) for number in range(2)]
    deadline_s = time.monotonic() + 15.0
    while not seen and time.monotonic() < deadline_s:
        # Until publisher and subscription are connected.
        publisher.publish(sent[0])
        events.process_events(0.01)
    assert events.status().level is Level.OK
    rounds = 0
    while events.status().level is Level.OK and rounds < 200:
        # 1.5 times the maximum number of events; most of their messages are displaced by newer ones.
        for _ in range(MAX_EVENTS * 3 // 2):
            publisher.publish(sent[0])
        steady_ns += 200_000_000
        events.process_events(0.0)
        rounds += 1
    status = events.status()
    assert status.level is Level.ERROR
    assert "too many events for this node" in status.message

    publisher.publish(sent[1])
    while seen[-1] != sent[1] and time.monotonic() < deadline_s:
        events.process_events(0.01)
    assert seen[-1] == sent[1]
    steady_ns += 60_000_000_000
    assert events.status().level is Level.WARN
    events.close()
    node.destroy_node()


@pytest.mark.live
def test_no_message_or_request_is_late_after_dropped_events(context):
    node = rclpy.create_node("flooded", context=context)
    events = NodeEvents(context, ExceptionGuard(node.get_logger(), time.monotonic_ns), time.monotonic_ns)
    seen, requests = [], []

    def take(data):
        events.note_event()
        seen.append(deserialize_message(data, Int32).data)

    def serve(request, response):
        events.note_event()
        requests.append(request.data)
        return response

    def take_until(happened):
        deadline_s = time.monotonic() + 15.0
        while not happened() and time.monotonic() < deadline_s:
            events.process_events(0.01)
        assert happened()

    node.create_subscription(Int32, "data", take, DEPTH, raw=True)
    node.create_service(SetBool, "switch", serve)
    publisher = node.create_publisher(Int32, "data", DEPTH)
    client = node.create_client(SetBool, "switch")
    events.start(node)
    take_until(lambda: publisher.get_subscription_count() == 1 and client.service_is_ready())
    for number in range(2 * DEPTH):
        publisher.publish(Int32(data=number))
    futures = [client.call_async(SetBool.Request(data=True))]
    time.sleep(1.0)  # until the middleware has reported all messages and the request
    seen.clear()
    events._drop()
    assert (seen[-1], requests) == (2 * DEPTH - 1, [True])
    for number in range(1000, 1010):
        publisher.publish(Int32(data=number))
        take_until(lambda: seen[-1] >= 1000)
        futures.append(client.call_async(SetBool.Request(data=False)))
        take_until(lambda: len(requests) == len(futures))
        assert seen.pop() == number
    take_until(lambda: all(future.done() for future in futures))
    events.close()
    node.destroy_node()


def new_messages(topic: str, *numbers: int) -> list[WaitingMessage]:
    return [WaitingMessage(topic, bytes([number]), number, number) for number in numbers]


def take_all(inbox: Inbox) -> list[tuple[str, int]]:
    return [(message.topic, message.now_ns) for message in iter(lambda: inbox.take() if inbox else None, None)]


def test_messages_of_all_topics_are_taken_in_order_of_arrival() -> None:
    inbox = Inbox({"ins": 5, "star": 5})
    for message in new_messages("ins", 1) + new_messages("star", 2) + new_messages("ins", 3) + new_messages("star", 4):
        inbox.add(message)
    assert take_all(inbox) == [("ins", 1), ("star", 2), ("ins", 3), ("star", 4)]
    assert inbox.take_cuts() == {}


def test_a_flood_on_one_topic_displaces_only_its_own_oldest_messages() -> None:
    inbox = Inbox({"ins": 3, "star": 2})
    for message in new_messages("star", 0) + new_messages("ins", *range(1, 101)) + new_messages("star", 101):
        inbox.add(message)
    assert len(inbox) == 5
    ((topic, why), count), *others = inbox.take_cuts().items()
    assert (topic, count, others) == ("ins", 97, [])
    assert "the oldest of more than 3" in why
    assert inbox.take_cuts() == {}
    assert take_all(inbox) == [("star", 0), ("ins", 98), ("ins", 99), ("ins", 100), ("star", 101)]


def test_an_oversized_message_is_not_queued() -> None:
    inbox = Inbox({"star": 2})
    inbox.add(WaitingMessage("star", bytes(MAX_MESSAGE_BYTES + 1), 1, 1))
    inbox.add(WaitingMessage("star", bytes(MAX_MESSAGE_BYTES), 2, 2))
    assert list(inbox.take_cuts().items()) == [(("star", f"larger than {MAX_MESSAGE_BYTES} bytes"), 1)]
    assert take_all(inbox) == [("star", 2)]


def stamped_messages(topic: str, *seconds: int) -> list[WaitingMessage]:
    stamps = [second.to_bytes(4, "little") + bytes(4) for second in seconds]
    return [WaitingMessage(topic, bytes([0, 1, 0, 0]) + stamp, 7, 7, 7) for stamp in stamps]


def test_an_overload_cuts_all_topics_at_one_time() -> None:
    inbox = Inbox({"ins": 100, "star": 100, "fix": 10}, valid_until_next={"fix"})
    for message in (
        stamped_messages("star", 1)
        + stamped_messages("ins", *range(1, 50))
        + stamped_messages("fix", 2)
        + stamped_messages("star", 40)
    ):
        inbox.add(message)
    assert inbox.oldest_queued_ns == 7
    inbox.cut_all(now_ns=90 * S, waiting_ns=91, since_ns=92)
    assert inbox.take_overload_cuts() == {"star": 2, "ins": 49}
    assert inbox.take_overload_cuts() == {}
    # The newest position is valid until the next one, so it is kept and used now.
    assert [message[2:5] for message in iter(lambda: inbox.take() if inbox else None, None)] == [(90 * S, 91, 92)]
    # Stars from before the newest INS sample that was cut have no INS sample for comparison.
    for message in stamped_messages("star", 48, 49, 50) + stamped_messages("ins", 50) + stamped_messages("fix", 3):
        inbox.add(message)
    assert inbox.take_overload_cuts() == {"star": 2}
    assert [topic for topic, _ in take_all(inbox)] == ["star", "ins", "fix"]
    assert inbox.take_cuts() == {}
    inbox.resume()
    inbox.add(stamped_messages("star", 48)[0])
    assert len(inbox) == 1


@pytest.mark.parametrize(
    ("ins_s", "first_taken_s"),
    [
        ([*range(1, 50), 2_000_000_000], 50),  # one stamp of the year 2033
        (range(19, 69), 51),  # a device that stamps by GPS time, 18 s ahead
        ([2_000_000_000] * 50, 51),
    ],
)
def test_a_future_stamp_at_a_cut_drops_no_later_message(ins_s, first_taken_s) -> None:
    inbox = Inbox({"ins": 100, "star": 100})
    for message in stamped_messages("star", 40) + stamped_messages("ins", *ins_s):
        inbox.add(message)
    inbox.cut_all(now_ns=50 * S, waiting_ns=7, since_ns=7)
    for message in stamped_messages("star", first_taken_s - 1, first_taken_s) + stamped_messages("ins", first_taken_s):
        inbox.add(message)
    assert [message.topic for message in iter(lambda: inbox.take() if inbox else None, None)] == ["star", "ins"]


def test_a_message_without_a_stamp_is_cut_once() -> None:
    inbox = Inbox({"ins": 10})
    inbox.add(WaitingMessage("ins", bytes(3), 1, 1))
    inbox.cut_all(2, 2, 2)
    inbox.add(WaitingMessage("ins", bytes(3), 3, 3))
    assert inbox.take_overload_cuts() == {"ins": 1}
    assert take_all(inbox) == [("ins", 3)]

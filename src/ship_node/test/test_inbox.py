"""What waits for an adapter: in order, bounded, what is cut is counted."""

from ship_node.live.inbox import LARGEST_MESSAGE_BYTES, Arrival, Inbox


def arrivals(topic: str, *numbers: int) -> list[Arrival]:
    return [Arrival(topic, bytes([number]), number, number) for number in numbers]


def taken(inbox: Inbox) -> list[tuple[str, int]]:
    return [(arrival.topic, arrival.now_ns) for arrival in iter(lambda: inbox.take() if inbox else None, None)]


def test_messages_of_all_topics_are_taken_in_order_of_arrival() -> None:
    inbox = Inbox({"ins": 5, "star": 5})
    for arrival in arrivals("ins", 1) + arrivals("star", 2) + arrivals("ins", 3) + arrivals("star", 4):
        inbox.put(arrival)
    assert taken(inbox) == [("ins", 1), ("star", 2), ("ins", 3), ("star", 4)]
    assert inbox.take_cuts() == {}


def test_mend_18_a_flood_on_one_topic_displaces_its_own_oldest_alone() -> None:
    inbox = Inbox({"ins": 3, "star": 2})
    for arrival in arrivals("star", 0) + arrivals("ins", *range(1, 101)) + arrivals("star", 101):
        inbox.put(arrival)
    assert len(inbox) == 5
    ((topic, why), count), *others = inbox.take_cuts().items()
    assert (topic, count, others) == ("ins", 97, [])
    assert "the oldest of more than 3" in why
    assert inbox.take_cuts() == {}
    assert taken(inbox) == [("star", 0), ("ins", 98), ("ins", 99), ("ins", 100), ("star", 101)]


def test_mend_18_a_message_of_megabytes_is_not_kept() -> None:
    inbox = Inbox({"star": 2})
    inbox.put(Arrival("star", bytes(LARGEST_MESSAGE_BYTES + 1), 1, 1))
    inbox.put(Arrival("star", bytes(LARGEST_MESSAGE_BYTES), 2, 2))
    assert list(inbox.take_cuts().items()) == [(("star", f"larger than {LARGEST_MESSAGE_BYTES} bytes"), 1)]
    assert taken(inbox) == [("star", 2)]

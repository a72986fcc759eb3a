"""Reader of a bag's messages for nodes: messages of one topic as a block where possible, other messages decoded."""

from collections import defaultdict
from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.message_store import definition_in
from ship_bags.stamps import stamps_of_rows
from ship_bags.topic_names import TRUTH_PREFIX
from ship_node.messages.batch import Arrival, Batch, Block
from ship_replay.offline.message_times import MessageTimes
from ship_replay.offline.replay_summary import ReplaySummary

_MIN_BLOCK = 3
"""Minimum number of messages of one topic for a block; fewer messages are decoded."""


class ReplayEvent(NamedTuple):
    """A tick, or a message of the bag.

    Attributes:
        time_ns: time of the tick, or log time of the message.
        topic: relative topic of the message; empty for a tick.
        record: the message; None for a tick.
    """

    time_ns: int
    topic: str = ""
    record: BagRecord | None = None


class InputReader:
    """Reader of the messages of a bag.

    Args:
        summary: result of the replay; the reader adds the statistics of the inputs.
    """

    def __init__(self, summary: ReplaySummary) -> None:
        self._summary = summary
        self._templates: dict[tuple[str, int], CdrTemplate | None] = {}

    def batch(self, events: Sequence[ReplayEvent], block_topics: Container[str]) -> Batch:
        """Return one arrival for each event; messages that cannot be decoded, and the truth, have no content.

        Args:
            events: the events in order.
            block_topics: topics whose messages may be given as a block.
        """
        arrivals = [Arrival(time_ns, time_ns, topic) for time_ns, topic, _ in events]
        records: dict[str, list[BagRecord]] = defaultdict(list)
        places: dict[str, list[int]] = defaultdict(list)
        for place, (_, topic, record) in enumerate(events):
            if record is not None and not topic.startswith(TRUTH_PREFIX):
                records[topic].append(record)
                places[topic].append(place)
        blocks: dict[int, Block] = {}
        for topic, of_topic in records.items():
            messages = self.rows(of_topic) if topic in block_topics else None
            if messages is not None:
                times_ns = np.array([record.log_time_ns for record in of_topic])
                key = len(blocks)
                blocks[key] = Block(topic, messages, times_ns, np.array(places[topic]))
                self._count_block(blocks[key])
                for place in places[topic]:
                    arrivals[place] = arrivals[place]._replace(block=key)
                continue
            for place, record in zip(places[topic], of_topic, strict=True):
                arrivals[place] = self._decode(arrivals[place], record)
        return Batch(arrivals, blocks)

    def rows(self, records: Sequence[BagRecord]) -> CdrRows | None:
        """Return messages as rows; None if there are too few messages, or if layouts differ or are unknown."""
        if len(records) < _MIN_BLOCK:
            return None
        first, length = records[0], len(records[0].data)
        if any(len(record.data) != length for record in records):
            return None
        kind = first.topic, length
        if kind not in self._templates:
            self._templates[kind] = _template(first)
        template = self._templates[kind]
        if template is None:
            return None
        rows = np.frombuffer(b"".join([record.data for record in records]), dtype=np.uint8).reshape(len(records), -1)
        return CdrRows(template, rows) if template.matching_rows(rows).all() else None

    def _decode(self, arrival: Arrival, record: BagRecord) -> Arrival:
        topic = arrival.topic
        try:
            message = record.decode()
        except BadInput:
            self._summary.undecodable[topic] += 1
            return arrival
        self._summary.inputs[topic] += 1
        self._summary.times.setdefault(topic, MessageTimes()).add(record)
        self._summary.log_delays.add(topic, record)
        return arrival._replace(message=message)

    def _count_block(self, block: Block) -> None:
        stamps_ns = stamps_of_rows(block.messages.numbers)
        self._summary.inputs[block.topic] += len(stamps_ns)
        self._summary.times.setdefault(block.topic, MessageTimes()).add_block(stamps_ns, block.receive_ns)
        self._summary.log_delays.add_block(block.topic, stamps_ns, block.receive_ns)


def _template(record: BagRecord) -> CdrTemplate | None:
    """Return the layout of a message; None if it cannot be determined."""
    try:
        return CdrTemplate.of_message(record.type_name, lambda name: definition_in(record.store, name), record.data)
    except (ValueError, TypeError):
        return None

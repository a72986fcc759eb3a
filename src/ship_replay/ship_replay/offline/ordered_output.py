"""Buffer of a replay's outputs, written in the order of events."""

from collections import Counter
from typing import Any

import numpy as np

from ship_bags.message_store import serialize
from ship_node.messages.batch import OutputBlock, StampArray
from ship_replay.offline.sinks import MessageSink


class OrderedOutput:
    """Buffer that sorts messages by event and order before writing.

    Args:
        sink: sink that receives the messages.
        counts: topic → number of messages written; only messages added as rows are counted here.

    Attributes:
        position: event index and order of messages written one by one.
    """

    def __init__(self, sink: MessageSink, counts: Counter[str]) -> None:
        self._sink, self._counts = sink, counts
        self._topics: dict[tuple[str, str], int] = {}
        self.position = 0, 0
        self._single: list[tuple[int, int, int, int]] = []
        self._data: list[bytes] = []
        # Event index, order in the event, topic and log time of each message: single messages, and those of blocks.
        self._rows: list[tuple[StampArray, StampArray, StampArray, StampArray]] = []
        self._row_data: list[bytes] = []

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message."""
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Add a serialised message."""
        self._single.append((*self.position, self._topic(topic, type_name), log_time_ns))
        self._data.append(data)

    def add_block(self, block: OutputBlock, log_times_ns: StampArray) -> None:
        """Add messages of one topic, with the log time of each; the places are event indices."""
        topic = np.full(len(block.places), self._topic(block.topic, block.messages.type_name))
        self._rows.append((block.places, block.orders, topic, log_times_ns))
        self._row_data += block.messages.message_bytes()
        self._counts[block.topic] += len(block.places)

    def flush(self) -> None:
        """Write all buffered messages."""
        data = self._data + self._row_data
        if not data:
            return
        if not self._rows:
            self._flush_single()
            return
        single = np.array(self._single, dtype=np.int64).reshape(-1, 4).T
        places, orders, topics, log_times_ns = (
            np.concatenate(columns) for columns in zip(single, *self._rows, strict=True)
        )
        self._single, self._rows, self._data, self._row_data = [], [], [], []
        # The sort is stable: messages with equal keys keep their order.
        order = np.lexsort((orders, places))
        ordered = [data[number] for number in order.tolist()]
        self._sink.write_many(list(self._topics), topics[order], ordered, log_times_ns[order])

    def _flush_single(self) -> None:
        """Write the buffered messages, of which none is in a block."""
        order = sorted(range(len(self._data)), key=lambda number: self._single[number][:2])
        single, data = self._single, self._data
        self._single, self._data = [], []
        _, _, topics, log_times_ns = np.array([single[number] for number in order], dtype=np.int64).T
        self._sink.write_many(list(self._topics), topics, [data[number] for number in order], log_times_ns)

    def _topic(self, topic: str, type_name: str) -> int:
        return self._topics.setdefault((topic, type_name), len(self._topics))

"""Buffer of a replay's outputs, written in the order of message-by-message replay."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ship_bags.message_store import serialize
from ship_node.messages.batches import OutputRows, StampArray


class BatchSink(Protocol):
    """Receiver of many messages at once: a bag writer."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :meth:`ship_bags.mcap.bag_writer.BagWriter.write_many`."""
        ...


class _PendingMessages(NamedTuple):
    """Buffered messages; each attribute has one element per message.

    Attributes:
        indices: first sort key, the index of the event.
        orders: second sort key, the order within the event.
        topics: index of the topic, in order of first use.
        log_times_ns: log time.
    """

    indices: StampArray
    orders: StampArray
    topics: StampArray
    log_times_ns: StampArray


class OrderedOutput:
    """Buffer that sorts messages by event and order before writing.

    Args:
        sink: sink that receives the messages.
        counts: topic → number of messages written; only messages added as rows are counted here.

    Attributes:
        position: event index and order of messages written one by one.
    """

    def __init__(self, sink: BatchSink, counts: Counter[str]) -> None:
        self._sink, self._counts = sink, counts
        self._topics: dict[tuple[str, str], int] = {}
        self.position = 0, 0
        self._single: list[tuple[int, int, int, int]] = []
        self._data: list[bytes] = []
        self._rows: list[_PendingMessages] = []
        self._row_data: list[bytes] = []

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message."""
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Add a serialised message."""
        self._single.append((*self.position, self._topic(topic, type_name), log_time_ns))
        self._data.append(data)

    def add_rows(
        self, rows: OutputRows, places: StampArray, orders: StampArray, log_times_ns: StampArray
    ) -> None:
        """Add messages of one topic, with event index, order and log time of each."""
        topic = np.full(len(places), self._topic(rows.topic, rows.messages.type_name))
        self._rows.append(_PendingMessages(places, orders, topic, log_times_ns))
        self._row_data += rows.messages.message_bytes()
        self._counts[rows.topic] += len(places)

    def flush(self) -> None:
        """Write all buffered messages."""
        single = np.array(self._single, dtype=np.int64).reshape(-1, 4).T
        places, orders, topics, log_times_ns = (
            np.concatenate(columns) for columns in zip(single, *self._rows, strict=True)
        )
        data = self._data + self._row_data
        self._single, self._rows, self._data, self._row_data = [], [], [], []
        if data:
            # The sort is stable: messages with equal keys keep their order.
            order = np.lexsort((orders, places))
            ordered = [data[number] for number in order.tolist()]
            self._sink.write_many(list(self._topics), topics[order], ordered, log_times_ns[order])

    def _topic(self, topic: str, type_name: str) -> int:
        return self._topics.setdefault((topic, type_name), len(self._topics))

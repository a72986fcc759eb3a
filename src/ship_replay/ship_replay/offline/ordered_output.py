"""What a replay publishes of some time, kept until all of it is there, and written in the order of one by one."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ship_bags.message_store import serialize
from ship_node.edge.blocks import PublishedRows, StampArray


class ManySink(Protocol):
    """Takes many messages at once: a bag that is written."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :meth:`ship_bags.mcap.bag_writer.BagWriter.write_many`."""
        ...


class _Messages(NamedTuple):
    """Messages that wait; each attribute has one element for each message.

    Attributes:
        places: with the two, in which order they are written.
        orders: the same within one place.
        topics: number of each one's topic.
        log_times_ns: when it is logged.
    """

    places: StampArray
    orders: StampArray
    topics: StampArray
    log_times_ns: StampArray


class OrderedOutput:
    """Keeps messages, and writes them in the order of their places.

    Args:
        sink: takes them.
        counts: topic → messages written, is filled for those that come as rows.

    Attributes:
        place: of the messages that come one by one, and order within it.
    """

    def __init__(self, sink: ManySink, counts: Counter[str]) -> None:
        self._sink, self._counts = sink, counts
        self._topics: dict[tuple[str, str], int] = {}
        self.place = 0, 0
        self._single: list[tuple[int, int, int, int]] = []
        self._data: list[bytes] = []
        self._rows: list[_Messages] = []
        self._row_data: list[bytes] = []

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take a message."""
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take a message given by its bytes."""
        self._single.append((*self.place, self._topic(topic, type_name), log_time_ns))
        self._data.append(data)

    def add_rows(
        self, rows: PublishedRows, places: StampArray, orders: StampArray, log_times_ns: StampArray
    ) -> None:
        """Take messages of one topic, with place, order and log time of each."""
        topic = np.full(len(places), self._topic(rows.topic, rows.messages.type_name))
        self._rows.append(_Messages(places, orders, topic, log_times_ns))
        self._row_data += rows.messages.each()
        self._counts[rows.topic] += len(places)

    def flush(self) -> None:
        """Write all that waits."""
        single = np.array(self._single, dtype=np.int64).reshape(-1, 4).T
        places, orders, topics, log_times_ns = (
            np.concatenate(columns) for columns in zip(single, *self._rows, strict=True)
        )
        data = self._data + self._row_data
        self._single, self._rows, self._data, self._row_data = [], [], [], []
        if data:
            # What has one place and order keeps the order in which it came.
            order = np.lexsort((orders, places))
            ordered = [data[number] for number in order.tolist()]
            self._sink.write_many(list(self._topics), topics[order], ordered, log_times_ns[order])

    def _topic(self, topic: str, type_name: str) -> int:
        return self._topics.setdefault((topic, type_name), len(self._topics))

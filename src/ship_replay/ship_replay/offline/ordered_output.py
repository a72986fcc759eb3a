"""What a replay in blocks publishes, kept until it is worth writing together, and written in order of log time."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ship_bags.message_store import serialize
from ship_node.edge.blocks import PublishedRows, StampArray

RowsOf = Callable[[Sequence[Any]], Iterator[PublishedRows]]
"""What the outputs of several runs become."""

_MOST = 2000
"""Messages and outputs that wait, at most."""


class ManySink(Protocol):
    """Takes many messages at once: a bag that is written."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :meth:`ship_bags.mcap.bag_writer.BagWriter.write_many`."""
        ...


class _WaitingRun(NamedTuple):
    """Outputs of which messages are still to be made.

    Attributes:
        rows_of: makes them.
        run: the outputs.
        log_times_ns: when each is logged.
        number: place of the first one among all that was published.
    """

    rows_of: RowsOf
    run: Any
    log_times_ns: StampArray
    number: int


class OrderedOutput:
    """Keeps messages, and outputs that become messages, and writes them in order of log time.

    Args:
        sink: takes them.
        counts: topic → messages written, is filled.
    """

    def __init__(self, sink: ManySink, counts: Counter[str]) -> None:
        self._sink, self._counts = sink, counts
        self._topics: dict[tuple[str, str], int] = {}
        self._number = 0
        self._messages: list[tuple[int, int, int, bytes]] = []
        self._runs: list[_WaitingRun] = []

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take a message."""
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take a message given by its bytes."""
        self._messages.append((log_time_ns, self._number, self._topic(topic, type_name), data))
        self._number += 1

    def add_run(self, rows_of: RowsOf, run: Any, log_times_ns: StampArray) -> None:
        """Take outputs, each logged at a time of its own."""
        self._runs.append(_WaitingRun(rows_of, run, log_times_ns, self._number))
        self._number += len(log_times_ns)

    @property
    def is_full(self) -> bool:
        """Whether so much waits that it should be written."""
        return len(self._messages) + sum(len(waiting.log_times_ns) for waiting in self._runs) >= _MOST

    def flush(self) -> list[PublishedRows]:
        """Write all that waits; returns the messages that the outputs became."""
        made: list[PublishedRows] = []
        times = [np.array([message[0] for message in self._messages], dtype=np.int64)]
        numbers = [np.array([message[1] for message in self._messages], dtype=np.int64)]
        topics = [np.array([message[2] for message in self._messages], dtype=np.int64)]
        data = [message[3] for message in self._messages]
        for rows_of in dict.fromkeys(waiting.rows_of for waiting in self._runs):
            runs = [waiting for waiting in self._runs if waiting.rows_of == rows_of]
            logged_ns = np.concatenate([waiting.log_times_ns for waiting in runs])
            of_output = np.concatenate([waiting.number + np.arange(len(waiting.log_times_ns)) for waiting in runs])
            for rows in rows_of([waiting.run for waiting in runs]):
                times.append(logged_ns[rows.places])
                numbers.append(of_output[rows.places])
                topics.append(np.full(len(rows.places), self._topic(rows.topic, rows.messages.type_name)))
                data += rows.messages.each()
                self._counts[rows.topic] += len(rows.places)
                made.append(rows)
        self._messages, self._runs = [], []
        if data:
            log_times_ns, of_topic = np.concatenate(times), np.concatenate(topics)
            order = np.lexsort((np.concatenate(numbers), log_times_ns))
            ordered = [data[place] for place in order.tolist()]
            self._sink.write_many(list(self._topics), of_topic[order], ordered, log_times_ns[order])
        return made

    def _topic(self, topic: str, type_name: str) -> int:
        return self._topics.setdefault((topic, type_name), len(self._topics))

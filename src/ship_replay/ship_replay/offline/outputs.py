"""Outputs of a replay: sinks of messages, the buffer that orders messages by event, and errors against the truth.

A replay of a simulated bag writes the errors to ``ship/error_arcsec`` and similar topics; an estimator never receives
the truth.
"""

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Container, Sequence
from operator import itemgetter
from typing import Any, Protocol

import numpy as np

from ship_bags.message_store import message_store, serialize
from ship_bags.stamps import ns_from_stamp, stamps_of_rows
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_node.messages.inputs_outputs import OutputBlock
from ship_watch.orientations import Orientation

TRUTH_GAP_NS = 1_000_000_000
"""Maximum time between two samples of the truth for which the truth is interpolated, ns."""

_MAX_TRUTH_DELAY_NS = 2_000_000_000
"""Maximum delay of the truth after an output, ns; after this time an error message is written without errors."""


class MessageSink(Protocol):
    """Receiver of a replay's messages, for example a bag writer."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :meth:`ship_bags.mcap.bag_writer.BagWriter.write_many`."""
        ...


class NullSink:
    """Sink that discards all messages."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """Discard messages."""


class DecodingSink(ABC):
    """Sink that receives decoded messages.

    Attributes:
        topics: topics of the messages to decode; other messages are ignored.
    """

    topics: Container[str]

    @abstractmethod
    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Receive a message."""

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: StampArray, data: Sequence[bytes], log_times_ns: StampArray
    ) -> None:
        """See :class:`MessageSink`."""
        read = message_store().deserialize_cdr
        for number, content, time_ns in zip(of_topic.tolist(), data, log_times_ns.tolist(), strict=True):
            topic, type_name = topics[number]
            if topic in self.topics:
                self.write(topic, read(content, type_name), time_ns)


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
        # Event index and order in the event, topic, log time and bytes of each single message.
        self._single: list[tuple[tuple[int, int], int, int, bytes]] = []
        # Event index, order in the event, topic and log time of each message of a block.
        self._rows: list[tuple[StampArray, StampArray, StampArray, StampArray]] = []
        self._row_data: list[bytes] = []

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message."""
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Add a serialised message."""
        self._single.append((self.position, self._topic(topic, type_name), log_time_ns, data))

    def add_block(self, block: OutputBlock, log_times_ns: StampArray) -> None:
        """Add messages of one topic, with the log time of each; the places are event indices."""
        topic = np.full(len(block.places), self._topic(block.topic, block.messages.type_name))
        self._rows.append((block.places, block.orders, topic, log_times_ns))
        self._row_data += block.messages.message_bytes()
        self._counts[block.topic] += len(block.places)

    def flush(self) -> None:
        """Write all buffered messages."""
        if not self._rows:
            if self._single:
                self._flush_single()
            return
        data = [content for *_, content in self._single] + self._row_data
        numbers = [(*position, topic, log_time_ns) for position, topic, log_time_ns, _ in self._single]
        single = np.array(numbers, dtype=np.int64).reshape(-1, 4).T
        places, orders, topics, log_times_ns = (
            np.concatenate(columns) for columns in zip(single, *self._rows, strict=True)
        )
        self._single, self._rows, self._row_data = [], [], []
        # The sort is stable: messages with equal keys keep their order.
        order = np.lexsort((orders, places))
        ordered = [data[number] for number in order.tolist()]
        self._sink.write_many(list(self._topics), topics[order], ordered, log_times_ns[order])

    def _flush_single(self) -> None:
        """Write the buffered messages, of which none is in a block."""
        # The sort is stable, as that of blocks.
        _, topics, log_times_ns, data = zip(*sorted(self._single, key=itemgetter(0)), strict=True)
        self._single = []
        self._sink.write_many(list(self._topics), np.array(topics), data, np.array(log_times_ns))

    def _topic(self, topic: str, type_name: str) -> int:
        return self._topics.setdefault((topic, type_name), len(self._topics))


class TruthErrors:
    """Buffer of error messages until the truth at their stamps is known.

    Messages arrive in order of log time; completed messages keep their own log time.
    """

    def __init__(self, orientation: Orientation) -> None:
        self.orientation = orientation
        self._truth = AttitudeTrack(TRUTH_GAP_NS)
        self._attitudes: dict[int, FloatArray] = {}
        self._pending: deque[tuple[int, Any]] = deque()

    def add_truth(self, sample: AttitudeSample | None) -> None:
        """Add a sample of the truth; None, from a message without an orientation, is ignored."""
        if sample is not None:
            self._truth.insert(sample)

    def add_attitude(self, message: Any) -> None:
        """Add a published message of the orientation."""
        self._attitudes[ns_from_stamp(message.header.stamp)] = self.orientation.angles_of(message)

    def add_block(self, block: OutputBlock) -> None:
        """Add published messages; messages on other topics are ignored."""
        if block.topic == self.orientation.topic:
            numbers = block.messages.numbers
            stamps_ns, angles = stamps_of_rows(numbers), self.orientation.angles_of_rows(numbers)
            self._attitudes.update(zip(stamps_ns.tolist(), angles, strict=True))

    @property
    def has_pending(self) -> bool:
        """True if an error message waits for the truth."""
        return bool(self._pending)

    def is_ready(self, now_ns: int | None) -> bool:
        """True if the oldest error message is ready: the truth is known, or the message has waited long enough."""
        if not self.has_pending:
            return False
        log_time_ns, message = self._pending[0]
        may_wait = now_ns is not None and now_ns - log_time_ns < _MAX_TRUTH_DELAY_NS
        return not may_wait or self._truth.at(ns_from_stamp(message.header.stamp)) is not None

    def add_error(self, message: Any, log_time_ns: int) -> None:
        """Add a published error message, whose errors are still empty."""
        self._pending.append((log_time_ns, message))

    def pop_ready(self, now_ns: int | None) -> list[tuple[int, Any]]:
        """Return (log time, message) of the error messages ready at ``now_ns`` (None: no more truth will come)."""
        ready: list[tuple[int, Any]] = []
        while self.is_ready(now_ns):
            log_time_ns, message = self._pending.popleft()
            stamp_ns = ns_from_stamp(message.header.stamp)
            truth, attitude = self._truth.at(stamp_ns), self._attitudes.get(stamp_ns)
            if truth is not None and attitude is not None:
                errors_arcsec = self.orientation.errors_arcsec(attitude, truth.rotation_nd)
                for channel, error in zip(self.orientation.channels, errors_arcsec.tolist(), strict=True):
                    setattr(message, f"error_{channel}", error)
            ready.append((log_time_ns, message))
            self._truth.drop_before(stamp_ns)
            self._attitudes = {time: value for time, value in self._attitudes.items() if time >= stamp_ns}
        return ready

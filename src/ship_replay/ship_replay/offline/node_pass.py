"""Processing of successive messages of all topics, with the ticks between them, by one node, in blocks where possible.

For each event the node receives the same as in message-by-message replay: outputs of earlier nodes, then the message of
the bag or the tick. For a block of messages, only computations that do not depend on other inputs are done together.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_node.adapters.adapter import TICK_PERIOD_NS, Adapter
from ship_node.adapters.batch_adapter import BatchAdapter
from ship_node.adapters.deferring_adapter import DeferringAdapter
from ship_node.messages.batches import BatchOutput, OutputRows, PendingBatch, StampArray
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.topics import OutputMessage

_BACKOFF_MESSAGES = 8
"""Number of messages processed one by one after a block could not be started."""


@dataclass(slots=True)
class InputEvent:
    """A tick, or a message of the bag.

    Attributes:
        now_ns: time of the event.
        topic: relative topic of the message; empty for a tick.
        message: decoded message; None for a tick, and for a message that is not decoded.
    """

    now_ns: int
    topic: str = ""
    message: Any = None


class TopicBlock(NamedTuple):
    """Messages of one topic among the events, all with the same layout.

    Attributes:
        messages: the messages.
        times_ns: arrival times, shape (N,).
        event_indices: index of the event of each message, shape (N,).
    """

    messages: CdrRows
    times_ns: StampArray
    event_indices: StampArray


def read_ahead(
    adapter: Adapter, topic: str, messages: CdrRows, times_ns: StampArray
) -> Sequence[ReadMessage[Any] | None]:
    """Let a node read messages of a topic ahead of their turn; None for messages that it must read at their turn."""
    if isinstance(adapter, BatchAdapter) and adapter.can_read_rows(topic):
        return adapter.read_rows(topic, messages, times_ns)
    return [None] * len(times_ns)


class EstimateBatch(NamedTuple):
    """Estimates of several events; ``orders`` is the key that sorts each estimate among the outputs of its event."""

    topic: str
    event_indices: StampArray
    orders: StampArray
    estimates: Any


class MessageBatch(NamedTuple):
    """Messages made from estimates, on one topic, with the event index and the order of each message."""

    rows: OutputRows
    event_indices: StampArray
    orders: StampArray


@dataclass
class NodeOutputs:
    """Outputs of a node.

    Attributes:
        messages: event index, order within the event, and messages.
        estimates: batches of estimates.
        message_batches: messages made from the estimates.
    """

    messages: list[tuple[int, int, list[OutputMessage]]] = field(default_factory=list)
    estimates: list[EstimateBatch] = field(default_factory=list)
    message_batches: list[MessageBatch] = field(default_factory=list)


class NodePass:
    """Processing of a batch by one node.

    Args:
        adapter: adapter of the node.
        input_topics: input topics of the node.
        events: events in order.
        rows: topic → its messages, for topics that a node may process in blocks; messages of other topics are decoded.
        forwarded: event index → messages of earlier nodes on the input topics, some already read by :func:`read_ahead`.
    """

    def __init__(
        self,
        adapter: Adapter,
        input_topics: Set[str],
        events: list[InputEvent],
        rows: Mapping[str, TopicBlock],
        forwarded: Mapping[int, list[OutputMessage]],
    ) -> None:
        self._adapter, self._input_topics, self._events, self._forwarded = adapter, input_topics, events, forwarded
        self._rows, self._next = rows, dict.fromkeys(rows, 0)
        self._read_messages = {
            topic: read_ahead(adapter, topic, block.messages, block.times_ns)
            for topic, block in rows.items()
            if topic in input_topics
        }
        # The adapter if it processes blocks; else None.
        self._block_adapter = adapter if isinstance(adapter, BatchAdapter) else None
        self._batch: PendingBatch | None = None
        self._batch_indices: StampArray = np.empty(0, dtype=np.int64)
        self._arrived = self._backoff = self._order = 0
        # The adapter if it publishes outputs later, and the event index and order of each pending output.
        self._deferring_adapter = adapter if isinstance(adapter, DeferringAdapter) else None
        self._pending_outputs: list[tuple[int, int]] = []
        if self._deferring_adapter is not None:
            self._deferring_adapter.defer_outputs()
        self.outputs = NodeOutputs()

    def run(self) -> NodeOutputs:
        """Process all events, then make the messages of the estimates."""
        for index, event in enumerate(self._events):
            for topic, message in self._forwarded.get(index, ()):
                self._handle(index, topic, message)
            if not event.topic:
                self._tick(index, event.now_ns)
            elif event.topic in self._input_topics:
                if event.topic in self._rows:
                    self._add_block_message(index, event)
                elif event.message is not None:
                    self._handle(index, event.topic, event.message)
        if self._deferring_adapter is not None and self._pending_outputs:
            self._publish_deferred(self._deferring_adapter)
        if self._block_adapter is not None and self.outputs.estimates:
            self._make_messages(self._block_adapter, self.outputs.estimates)
        return self.outputs

    def _make_messages(self, adapter: BatchAdapter, runs: list[EstimateBatch]) -> None:
        places = np.concatenate([run.event_indices for run in runs])
        orders = np.concatenate([run.orders for run in runs])
        for rows in adapter.batch_messages([run.estimates for run in runs]):
            self.outputs.message_batches.append(MessageBatch(rows, places[rows.places], orders[rows.places]))

    def _tick(self, index: int, now_ns: int) -> None:
        # A block ends before the first tick with an effect (_start_batch), so a tick within the block can be skipped.
        if self._batch is not None and self._block_adapter is not None and self._block_adapter.has_idle_ticks:
            return
        self._commit_arrived()
        self._publish(index, self._adapter.tick(now_ns))

    def _commit_arrived(self) -> None:
        """Commit the messages of the block that have arrived, before another input is processed."""
        if self._batch is not None:
            assert self._block_adapter is not None
            self._publish_parts(self._block_adapter.commit_batch(self._batch, self._arrived))

    def _handle(self, index: int, topic: str, message: Any) -> None:
        self._commit_arrived()
        now_ns = self._events[index].now_ns
        if isinstance(message, ReadMessage):
            assert self._block_adapter is not None
            self._publish(index, self._block_adapter.handle_read(topic, message, now_ns))
        else:
            self._publish(index, self._adapter.handle(topic, message, now_ns))

    def _add_block_message(self, index: int, event: InputEvent) -> None:
        """Process a message of a topic block."""
        number = self._next[event.topic]
        self._next[event.topic] += 1
        if self._batch is None and self._block_adapter is not None and self._block_adapter.accepts_batches(event.topic):
            self._batch = self._start_batch(self._block_adapter, event.topic, number)
        if self._block_adapter is None or self._batch is None or self._batch.topic != event.topic:
            reading = self._read_messages[event.topic][number]
            message = self._rows[event.topic].messages.message(number) if reading is None else reading
            self._handle(index, event.topic, message)
            return
        self._arrived += 1
        if self._arrived == self._batch.evaluated.checked.count:
            batch, self._batch = self._batch, None
            self._publish_parts(self._block_adapter.commit_batch(batch, self._arrived))
            self._publish_parts(self._block_adapter.finish_batch(batch))

    def _start_batch(self, adapter: BatchAdapter, topic: str, number: int) -> PendingBatch | None:
        """Start a block that begins with a message; return None if this is not possible."""
        if self._backoff:
            self._backoff -= 1
            return None
        rows, batch = self._rows[topic], None
        # The block ends before the first tick with an effect. A tick precedes a message logged at the same time.
        tick_ns = -(-adapter.idle_until_ns // TICK_PERIOD_NS) * TICK_PERIOD_NS
        some = slice(number, int(np.searchsorted(rows.times_ns, tick_ns)))
        if some.stop > some.start:
            batch = adapter.evaluate_batch(topic, rows.messages.subset(some), rows.times_ns[some])
        if batch is None:
            self._backoff = _BACKOFF_MESSAGES
        self._batch_indices, self._arrived = rows.event_indices[some], 0
        return batch

    def _publish(self, index: int, published: list[OutputMessage]) -> None:
        if published:
            self.outputs.messages.append((index, self._order, published))
            self._order += 1
        if self._deferring_adapter is not None:
            while len(self._pending_outputs) < self._deferring_adapter.pending_count:
                self._pending_outputs.append((index, self._order))
                self._order += 2  # one for the messages published before the output, one for the output

    def _publish_deferred(self, adapter: DeferringAdapter) -> None:
        """Collect the outputs that were deferred during this pass."""
        places, orders = np.array(self._pending_outputs, dtype=np.int64).T
        for part in adapter.take_outputs():
            if part.published:
                self.outputs.messages.append((int(places[part.place]), int(orders[part.place]), part.published))
            if part.estimates is not None:
                some = slice(part.place, part.place + len(part.estimates.time_ns))
                run = EstimateBatch(adapter.main_topic, places[some], orders[some] + 1, part.estimates)
                self.outputs.estimates.append(run)

    def _publish_parts(self, parts: list[BatchOutput]) -> None:
        assert self._block_adapter is not None
        for part in parts:
            self._publish(int(self._batch_indices[part.place]), part.published)
            if part.estimates is not None:
                places = self._batch_indices[part.place : part.place + len(part.estimates.time_ns)]
                orders = np.full(len(places), self._order)
                self.outputs.estimates.append(
                    EstimateBatch(self._block_adapter.main_topic, places, orders, part.estimates)
                )
                self._order += 1

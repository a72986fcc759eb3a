"""Walk of an adapter through a batch, with the outputs of its messages and ticks one by one, to the last bit.

For a block of messages, only computations that do not depend on other inputs are done together. A message that differs
from the others in more than numbers, or is late, jumps, is rejected or follows a gap, ends a block and is processed
alone. Outputs on which no other message depends are computed at the end.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_geometry.earth.time_scales import StampArray
from ship_node.adapters.adapter import TICK_PERIOD_NS, BlockFeed, DeferringPart, EvaluatedBlock, Feed
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.inputs_outputs import (
    Arrival,
    Batch,
    BatchOutputs,
    Block,
    OutputBlock,
    OutputMessage,
    PlacedMessages,
    ReadBlock,
)

if TYPE_CHECKING:
    from ship_node.adapters.input_processing import InputProcessing

_BACKOFF_MESSAGES = 8
"""Number of messages processed one by one after a block could not be evaluated."""


class _Part(NamedTuple):
    """Part of outputs that are computed together.

    Attributes:
        number: index of the output at which the part is published; with ``estimates``, index of the first of them.
        published: messages to publish.
        estimates: outputs still to be converted to messages; None if there are no outputs.
    """

    number: int
    published: list[OutputMessage]
    estimates: Any = None


class _Estimates(NamedTuple):
    """Outputs still to be converted to messages, with the place and order of each."""

    places: StampArray
    orders: StampArray
    estimates: Any


@dataclass(slots=True)
class _CurrentBlock:
    """Messages of a block that were read and evaluated, and are committed in order with the other arrivals.

    Attributes:
        feed: entry of the topic.
        block_feed: processing of the block by the core.
        reading: the messages as read, possibly more messages than were evaluated.
        receive_ns: receive times of the evaluated messages.
        places: index of the arrival of each message.
        evaluated: the core's evaluation.
        arrived_count: number of messages whose place in the batch has been reached.
    """

    feed: Feed
    block_feed: BlockFeed
    reading: ReadBlock
    receive_ns: StampArray
    places: StampArray
    evaluated: EvaluatedBlock
    arrived_count: int = 0


class BatchPass:
    """Processing of a batch by an adapter.

    Args:
        adapter: the adapter.
        batch: the batch.
    """

    def __init__(self, adapter: "InputProcessing", batch: Batch) -> None:
        self._adapter, self._batch = adapter, batch
        # For each block, the index of its next message, and the messages that are read in advance.
        self._next = dict.fromkeys(batch.blocks, 0)
        self._readings = {
            key: feed.read_rows(block.messages, block.receive_ns)
            for key, block in batch.blocks.items()
            if (feed := adapter.feeds[block.topic]).read_rows is not None
        }
        self._evaluated: _CurrentBlock | None = None
        self._backoff = self._order = 0
        self._outputs = BatchOutputs()
        self._estimates: list[_Estimates] = []
        # Place and order of each pending output, and the outputs computed so far.
        self._pending_places: list[tuple[int, int]] = []
        self._computed: list[_Part] = []
        self._computed_count = 0

    def run(self) -> BatchOutputs:
        """Process all arrivals, then convert the estimates to messages."""
        if self._deferring is not None:
            self._deferring.pending = []
        try:
            for place, arrival in enumerate(self._batch.arrivals):
                if not arrival.topic:
                    self._tick(place, arrival)
                elif arrival.block is not None:
                    self._add_block_message(place, arrival, arrival.block)
                else:
                    self._process_message(place, arrival)
            self._publish_pending()
        finally:
            if self._deferring is not None:
                self._deferring.pending = None
        if self._estimates:
            places = np.concatenate([some.places for some in self._estimates])
            orders = np.concatenate([some.orders for some in self._estimates])
            for rows in self._adapter.batch_messages([some.estimates for some in self._estimates]):
                block = OutputBlock(rows.topic, rows.messages, places[rows.places], orders[rows.places])
                self._outputs.blocks.append(block)
        return self._outputs

    @property
    def _deferring(self) -> DeferringPart | None:
        """Part of the core that defers outputs; an adoption within the batch replaces the core."""
        return self._adapter.deferring_part

    def compute_pending(self) -> None:
        """Compute the pending outputs, because the next output or report must follow them."""
        if self._deferring is None or not self._deferring.pending:
            return
        times_ns = [pending.time_ns for pending in self._deferring.pending]
        for some, found in self._deferring.compute_pending():
            parts = self._estimate_parts(some, found, times_ns)
            self._computed += [part._replace(number=self._computed_count + part.number) for part in parts]
        self._computed_count += len(times_ns)

    # -- arrivals -------------------------------------------------------------------------------------------

    def _tick(self, place: int, arrival: Arrival) -> None:
        # A block ends before the first tick with an effect (_evaluate), so a tick within the block can be skipped.
        if self._evaluated is None or not self._adapter.has_idle_ticks:
            self._commit_arrived()
            self._publish(place, self._adapter.tick(arrival.receive_ns, arrival.waiting_ns))

    def _process_message(self, place: int, arrival: Arrival, reading: ReadMessage[Any] | None = None) -> None:
        self._commit_arrived()
        self._publish(place, self._adapter.process_message(arrival, reading))

    def _add_block_message(self, place: int, arrival: Arrival, key: int) -> None:
        block, number = self._batch.blocks[key], self._next[key]
        self._next[key] += 1
        if self._evaluated is None:
            self._evaluated = self._evaluate(block, number)
        if self._evaluated is None or self._evaluated.feed.input.topic != arrival.topic:
            reading = self._readings[key][number] if key in self._readings else None
            if reading is None:
                arrival = arrival._replace(message=block.messages.message(number))
            self._process_message(place, arrival, reading)
            return
        self._evaluated.arrived_count += 1
        if self._evaluated.arrived_count == self._evaluated.evaluated.checked.count:
            self._commit_arrived()
            evaluated, self._evaluated = self._evaluated, None
            self._finish(evaluated)

    # -- blocks ---------------------------------------------------------------------------------------------

    def _evaluate(self, block: Block, number: int) -> _CurrentBlock | None:
        """Evaluate the messages of a block from an index on; return None if the first must be processed alone."""
        adapter, feed = self._adapter, self._adapter.feeds[block.topic]
        if feed.block is None or block.topic in adapter.off_topics or adapter.time_base.is_step_pending:
            return None
        if self._backoff:
            self._backoff -= 1
            return None
        # The messages before the first tick with an effect. A tick precedes a message that arrives at the same time.
        tick_ns = -(-adapter.idle_until_ns // TICK_PERIOD_NS) * TICK_PERIOD_NS
        some, found = slice(number, int(np.searchsorted(block.receive_ns, tick_ns))), None
        if some.stop > some.start and not (adapter.saved is not None and adapter.saved.is_pending):
            found = self._evaluate_rows(feed, feed.block, block, some)
        if found is None:
            self._backoff = _BACKOFF_MESSAGES
        return found

    def _evaluate_rows(self, feed: Feed, block_feed: BlockFeed, block: Block, some: slice) -> _CurrentBlock | None:
        adapter, topic, receive_ns = self._adapter, block.topic, block.receive_ns[some]
        reading = block_feed.read(block.messages.subset(some), receive_ns)
        samples, time_base = reading.samples, adapter.time_base
        stamps_ns = samples.times_ns.tolist()
        count = time_base.count_without_step(topic, stamps_ns, receive_ns[: len(stamps_ns)].tolist())
        if count:
            unmoved = samples.subset(slice(count))
            count = adapter.duplicates.count_before_change(topic, unmoved.times_ns, unmoved.rotations_nd)
        evaluated = block_feed.core.evaluate_block(samples.subset(slice(count)), receive_ns[:count]) if count else None
        if evaluated is None:
            return None
        count = evaluated.checked.count
        time_base.add_block(topic, stamps_ns[count - 1], int(receive_ns[count - 1]), count)
        return _CurrentBlock(feed, block_feed, reading, receive_ns[:count], block.places[some], evaluated)

    def _commit_arrived(self) -> None:
        """Commit the messages of the block that have arrived, before another input is processed."""
        block = self._evaluated
        if block is None:
            return
        evaluated = block.evaluated
        block.block_feed.core.commit_block(evaluated, min(block.arrived_count, evaluated.checked.accepted_count))
        outcomes, evaluated.pending_outcomes[:] = list(evaluated.pending_outcomes), []
        for number, outcome in outcomes:
            now_ns = int(block.receive_ns[number])
            self._publish(int(block.places[number]), self._adapter.report_outcome(outcome, now_ns, now_ns))

    def _finish(self, block: _CurrentBlock) -> None:
        """Finish a block whose messages are all committed; publish its remaining outputs."""
        adapter, feed, core = self._adapter, block.feed, block.block_feed.core
        receive_ns, reading, count = block.receive_ns, block.reading, block.evaluated.checked.accepted_count
        samples = reading.samples.subset(slice(len(receive_ns)))
        adapter.duplicates.add_block(feed.input.topic, samples.times_ns, samples.rotations_nd)
        if count:
            if feed.shows_present:
                adapter.last_usable_ns[feed.shows_present] = int(receive_ns[count - 1])
            times_ns = samples.times_ns[:count]
            adapter.health.record_block(feed.input.topic, receive_ns[:count], times_ns, reading.covariance_known)
        parts = [
            part
            for some, found in core.block_estimates(block.evaluated)
            for part in self._estimate_parts(some, found, reading.samples.times_ns)
        ]
        last = core.finish_block(block.evaluated)
        if last is not None:
            now_ns = int(receive_ns[count])
            message = ReadMessage(reading.samples.sample(count), reading.covariance_known)
            parts.append(_Part(count, adapter.report_input(feed, message, last, now_ns, now_ns)))
        for part in parts:
            self._publish(int(block.places[part.number]), part.published)
            if part.estimates is not None:
                places = block.places[part.number : part.number + len(part.estimates.time_ns)]
                self._estimates.append(_Estimates(places, np.full(len(places), self._order), part.estimates))
                self._order += 1

    def _estimate_parts(self, some: slice, found: Any, times_ns: Sequence[int] | StampArray) -> Iterator[_Part]:
        """Yield estimates to publish, with the protection levels that must be published before some of them.

        Args:
            some: indices of ``found`` among all estimates that are computed together.
            found: a run of estimates, or the rejection if they could not be computed.
            times_ns: stamps of all estimates that are computed together.
        """
        adapter = self._adapter
        if isinstance(found, Rejection):
            for index in range(some.start, some.stop):
                yield _Part(index, [adapter.report_failure(adapter.main_topic, int(times_ns[index]), found)])
            return
        if adapter.integrity_topic:
            yield from self._parts_with_levels(some.start, found)
        else:
            yield _Part(some.start, [], found)
        adapter.latest = adapter.pending_budget = found.estimate(len(found.time_ns) - 1)

    def _parts_with_levels(self, first: int, run: Any) -> Iterator[_Part]:
        """Yield estimates from one state, the first with index ``first``, split where protection levels precede one."""
        adapter, published = self._adapter, self._adapter.published_levels
        redundancy_keys = list(zip(*adapter.redundancy_key(run), strict=True))
        directions, start, count = adapter.directions(run), 0, len(run.time_ns)
        while start < count:
            yield _Part(first + start, adapter.protection_level_messages(run.estimate(start)))
            rest = slice(start + 1, count)
            end = start + 1 + published.covered_count(run.time_ns[rest], run.covariance_n[rest], directions[rest])
            changed = (other for other in range(start + 1, end) if redundancy_keys[other] != published.redundancy_key)
            end = next(changed, end)
            yield _Part(first + start, [], run if end - start == count else run.subset(slice(start, end)))
            start = end

    # -- outputs --------------------------------------------------------------------------------------------

    def _publish(self, place: int, published: list[OutputMessage]) -> None:
        if published:
            self._outputs.messages.append(PlacedMessages(place, self._order, published))
            self._order += 1
        if self._deferring is not None:
            while len(self._pending_places) < self._computed_count + len(self._deferring.pending or ()):
                self._pending_places.append((place, self._order))
                self._order += 2  # one for the messages published before the output, one for the output

    def _publish_pending(self) -> None:
        self.compute_pending()
        if not self._computed:
            return
        places, orders = np.array(self._pending_places, dtype=np.int64).T
        for part in self._computed:
            if part.published:
                messages = PlacedMessages(int(places[part.number]), int(orders[part.number]), part.published)
                self._outputs.messages.append(messages)
            if part.estimates is not None:
                some = slice(part.number, part.number + len(part.estimates.time_ns))
                self._estimates.append(_Estimates(places[some], orders[some] + 1, part.estimates))

"""One replay: messages of a bag are passed to adapters in batches, and the published messages to a sink.

Messages of one topic are read as a block where possible; other messages are decoded one by one. Each node processes a
whole batch before the next node does, because data flow between nodes in one direction only. The size of the batches
changes neither the outputs nor their order.
"""

from collections import defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.message_store import definition_in
from ship_bags.stamps import NS_PER_S, stamps_of_rows
from ship_bags.topic_names import TRUTH_PREFIX
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.adapters.adapter import TICK_PERIOD_NS
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC
from ship_node.messages.inputs_outputs import (
    Arrival,
    Batch,
    Block,
    OutputBlock,
    OutputMessage,
    PlacedMessages,
)
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.message_times import MessageTimes
from ship_replay.offline.outputs import MessageSink, OrderedOutput, TruthErrors
from ship_replay.offline.replay_summary import (
    INTEGRITY_TOPICS,
    STATUS_TOPICS,
    ExclusionHistory,
    ReplaySummary,
    StatusHistory,
)
from ship_watch.orientations import ORIENTATIONS

_MIN_BLOCK = 3
"""Minimum number of messages of one topic for a block; fewer messages are decoded."""

LARGEST_BATCH = 1000
"""Maximum number of messages and ticks in a batch."""

_MAX_TICK_GAP_NS = 600 * NS_PER_S
"""Maximum time after a message for which ticks are generated, ns.

By then every timeout of the nodes has expired. The limit avoids hours of ticks after a wrong log time, from a damaged
file or a wrong clock.
"""

_LAST_INDEX = 1 << 62


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
        arrivals: list[Arrival] = []
        of_blocks: dict[str, dict[int, BagRecord]] = defaultdict(dict)
        for place, (time_ns, topic, record) in enumerate(events):
            message = None
            if topic in block_topics and record is not None:
                of_blocks[topic][place] = record
            elif record is not None and not topic.startswith(TRUTH_PREFIX):
                message = self._decode(topic, record)
            arrivals.append(Arrival(time_ns, time_ns, topic, message))
        blocks: dict[int, Block] = {}
        for topic, records in of_blocks.items():
            messages = self.rows(list(records.values()))
            if messages is None:
                for place, record in records.items():
                    arrivals[place] = arrivals[place]._replace(message=self._decode(topic, record))
                continue
            times_ns = np.array([record.log_time_ns for record in records.values()])
            key = len(blocks)
            blocks[key] = Block(topic, messages, times_ns, np.array(list(records)))
            self._count_block(blocks[key])
            for place, record in records.items():
                arrivals[place] = Arrival(record.log_time_ns, record.log_time_ns, topic, None, key)
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

    def _decode(self, topic: str, record: BagRecord) -> Any:
        """Return the message, counted in the summary; None if it cannot be decoded."""
        try:
            message = record.decode()
        except BadInput:
            self._summary.undecodable[topic] += 1
            return None
        self._summary.inputs[topic] += 1
        self._summary.times.setdefault(topic, MessageTimes()).add(record)
        self._summary.log_delays.add(topic, record)
        return message

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


class ReplayRun:
    """Replay of a bag through a chain of adapters.

    Args:
        chain: chain of adapters.
        sink: sink that receives the outputs.
        summary: result, which is filled during the replay.
        truth_topics: truth topics of the bag; errors are computed only for an orientation whose truth topic is
            included.
        batch_size: maximum number of messages and ticks in a batch; with 1, each message is processed as in a live
            node, and its outputs are received by the sink at once.

    Attributes:
        last_time_ns: arrival time of the last message; None before the first message.
    """

    def __init__(
        self,
        chain: AdapterChain,
        sink: MessageSink,
        summary: ReplaySummary,
        truth_topics: Container[str],
        batch_size: int = LARGEST_BATCH,
    ) -> None:
        self._chain = chain
        self._output = OrderedOutput(sink, summary.outputs)
        self._summary = summary
        self._reader = InputReader(summary)
        self._batch_size = batch_size
        self._events: list[ReplayEvent] = []
        known = [orientation for orientation in ORIENTATIONS if orientation.truth_topic in truth_topics]
        self._status_topics = {
            f"{adapter.node_name}: {output.topic.rpartition('/')[2]}": output.topic
            for adapter in chain.adapters
            for output in adapter.outputs
            if output.topic in STATUS_TOPICS
        }
        self._errors = [TruthErrors(orientation) for orientation in known]
        self.last_time_ns: int | None = None

    def process_message(self, topic: str, record: BagRecord) -> None:
        """Add one message of the bag, in order of log time; process the batch when it is full."""
        for now_ns in self._tick_times_ns(record.log_time_ns):
            self._add(ReplayEvent(now_ns))
        self._add(ReplayEvent(record.log_time_ns, topic, record))

    def finish(self) -> None:
        """Process the last batch, and write the error messages that still wait for the truth."""
        self._process_batch()
        self._output.position = _LAST_INDEX, 0
        self._write_errors(None)
        self._output.flush()

    def _tick_times_ns(self, time_ns: int) -> range:
        """Return the tick times up to a message, ns, and remember the message's time.

        These are the multiples of the period since the last message, for at most ten minutes.
        """
        last_ns, self.last_time_ns = self.last_time_ns, time_ns
        if last_ns is None:
            return range(0)
        end_ns = min(time_ns, last_ns + _MAX_TICK_GAP_NS)
        return range((last_ns // TICK_PERIOD_NS + 1) * TICK_PERIOD_NS, end_ns + 1, TICK_PERIOD_NS)

    def _add(self, event: ReplayEvent) -> None:
        self._events.append(event)
        if len(self._events) >= self._batch_size:
            self._process_batch()

    def _process_batch(self) -> None:
        """Let the chain process the events, then write the outputs."""
        events, self._events = self._events, []
        block_topics = self._chain.block_topics if len(events) > 1 else ()
        outputs = self._chain.process(self._reader.batch(events, block_topics))
        for block in outputs.blocks:
            self._output.add_block(block, np.array([events[place].time_ns for place in block.places.tolist()]))
            for errors in self._errors:
                errors.add_block(block)
        self._publish_batch(events, outputs.messages, outputs.blocks)
        self._output.flush()

    # -- outputs --------------------------------------------------------------------------------------------

    def _publish_batch(
        self, events: Sequence[ReplayEvent], messages: Sequence[PlacedMessages], blocks: Sequence[OutputBlock]
    ) -> None:
        """Write the single messages event by event, with the truth and the errors against it."""
        single: dict[int, list[PlacedMessages]] = defaultdict(list)
        for some in messages:
            single[some.place].append(some)
        truth, statuses = self._truth(events), _statuses(blocks, sorted(single), len(events))
        for place, (time_ns, topic, record) in enumerate(events):
            is_truth = topic.startswith(TRUTH_PREFIX)
            if not (place in single or is_truth or any(errors.has_pending for errors in self._errors)):
                continue
            self._add_statuses(statuses[place])
            for some in sorted(single[place], key=lambda each: each.order):
                self._output.position = place, some.order
                self._publish(some.published, time_ns)
            self._output.position = place, _LAST_INDEX
            if record is not None:
                if is_truth:
                    self._copy_truth(topic, record, truth.get(place))
                self._write_errors(time_ns)
        self._add_statuses(statuses[len(events)])

    def _truth(self, events: Sequence[ReplayEvent]) -> dict[int, AttitudeSample | None]:
        """Return event index → sample of the truth, for truth messages that can be read as a block."""
        found: dict[int, AttitudeSample | None] = {}
        if len(events) < _MIN_BLOCK:
            return found
        for errors in self._errors:
            truth_topic = errors.orientation.truth_topic
            of_topic = {
                place: record
                for place, (_, topic, record) in enumerate(events)
                if topic == truth_topic and record is not None
            }
            messages = self._reader.rows(list(of_topic.values()))
            if messages is not None:
                found |= zip(of_topic, errors.orientation.samples(messages), strict=True)
        return found

    def _copy_truth(self, topic: str, record: BagRecord, sample: AttitudeSample | None) -> None:
        """Copy a message of the truth; `sample` is its decoded content if already known."""
        self._output.write_raw(topic, record.type_name, record.data, record.log_time_ns)
        self._summary.outputs[topic] += 1
        for errors in self._errors:
            if topic == errors.orientation.truth_topic:
                errors.add_truth(errors.orientation.sample(record.decode()) if sample is None else sample)

    def _publish(self, published: list[OutputMessage], time_ns: int) -> None:
        for topic, message in published:
            if not self._defer_error(topic, message, time_ns):
                self._write(topic, message, time_ns)

    def _defer_error(self, topic: str, message: Any, time_ns: int) -> bool:
        """Defer an error message until the truth is known; True if the message was deferred."""
        for errors in self._errors:
            if topic == errors.orientation.error_topic:
                errors.add_error(message, time_ns)
                return True
            if topic == errors.orientation.topic:
                errors.add_attitude(message)
        return False

    def _write_errors(self, now_ns: int | None) -> None:
        for errors in self._errors:
            for log_time_ns, message in errors.pop_ready(now_ns):
                self._write(errors.orientation.error_topic, message, log_time_ns)

    def _write(self, topic: str, message: Any, time_ns: int) -> None:
        self._output.write(topic, message, time_ns)
        self._summary.outputs[topic] += 1
        if topic in STATUS_TOPICS:
            self._summary.status_histories.setdefault(topic, StatusHistory()).add(message)
        elif topic in INTEGRITY_TOPICS.values():
            self._summary.exclusions.setdefault(topic, ExclusionHistory()).add(message)
        elif topic == DIAGNOSTICS_TOPIC:
            self._record_diagnostics(message)

    def _add_statuses(self, runs: Sequence[tuple[str, StampArray, StampArray]]) -> None:
        """Add the statuses of outputs that were made together."""
        for topic, statuses, stamps_ns in runs:
            self._summary.status_histories.setdefault(topic, StatusHistory()).add_run(statuses.tolist(), stamps_ns)

    def _record_diagnostics(self, diagnostics: Any) -> None:
        """Record the diagnostics about statuses: "ship_attitude: attitude" is about ship/attitude."""
        for status in diagnostics.status:
            history = self._summary.status_histories.get(self._status_topics.get(status.name, ""))
            if history is not None:
                history.add_diagnostic(status.message)


def process_records(
    chain: AdapterChain,
    records: Iterable[BagRecord],
    names: Mapping[str, str],
    sink: MessageSink,
    batch_size: int = LARGEST_BATCH,
) -> ReplaySummary:
    """Process inputs of a chain of adapters, without the truth; return their counts.

    Args:
        chain: chain of adapters.
        records: the inputs, in order of log time.
        names: topic of a record → relative topic.
        sink: sink that receives the outputs.
        batch_size: see :class:`ReplayRun`.
    """
    summary = ReplaySummary()
    run = ReplayRun(chain, sink, summary, (), batch_size)
    for record in records:
        run.process_message(names[record.topic], record)
    run.finish()
    return summary


def _statuses(
    blocks: Sequence[OutputBlock], single_places: Sequence[int], last_place: int
) -> dict[int, list[tuple[str, StampArray, StampArray]]]:
    """Return the statuses in the blocks as place → topic, statuses and stamps of outputs at this place or before.

    Args:
        blocks: messages that were made together.
        single_places: places of messages that were published one by one, in order.
        last_place: place of the outputs after the last of these places.
    """
    found: dict[int, list[tuple[str, StampArray, StampArray]]] = defaultdict(list)
    for topic in dict.fromkeys(block.topic for block in blocks if block.topic in STATUS_TOPICS):
        of_topic = [block for block in blocks if block.topic == topic]
        places = np.concatenate([block.places for block in of_topic])
        order = np.lexsort((np.concatenate([block.orders for block in of_topic]), places))
        numbers = [block.messages.numbers for block in of_topic]
        statuses = np.concatenate([some["status"] for some in numbers])[order]
        stamps_ns = np.concatenate([stamps_of_rows(some) for some in numbers])[order]
        stops, start = np.searchsorted(places[order], single_places, side="right").tolist(), 0
        for place, stop in zip([*single_places, last_place], [*stops, len(order)], strict=True):
            if stop > start:
                found[place].append((topic, statuses[start:stop], stamps_ns[start:stop]))
            start = stop
    return found

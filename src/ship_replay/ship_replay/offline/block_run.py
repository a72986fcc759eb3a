"""Replay in blocks: one node after another processes many messages of all topics; INS samples are checked together.

Outputs and their order are those of :class:`ship_replay.offline.replay_run.ReplayRun` for the same messages one by one.
Data flow between nodes in one direction only, so a node may process a whole batch before the next node does.
"""

from collections import defaultdict
from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.message_store import definition_in
from ship_bags.stamps import stamps_of_rows
from ship_bags.topic_names import TRUTH_PREFIX
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.adapters.adapter import Adapter
from ship_node.messages.batches import StampArray
from ship_node.messages.topics import OutputMessage
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.message_times import MessageTimes
from ship_replay.offline.node_pass import InputEvent, NodeOutputs, NodePass, TopicBlock, read_ahead
from ship_replay.offline.ordered_output import BatchSink, OrderedOutput
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary
from ship_replay.offline.status_history import StatusHistory

_MAX_BATCH = 1000
"""Maximum number of messages per batch."""
_MIN_BLOCK = 3
"""Minimum number of messages of one topic for a block; fewer messages are processed one by one."""

_NODE_BITS = 32
"""Number of low bits of an output's order in its event that give the order within a node; higher bits give the node."""
_LAST_INDEX = 1 << 62


class BlockRun(ReplayRun):
    """Replay of a chain of adapters in blocks.

    The arguments are those of :class:`ReplayRun`, but the writer is a sink for batches.
    """

    def __init__(
        self, chain: AdapterChain, writer: BatchSink, summary: ReplaySummary, truth_topics: Container[str]
    ) -> None:
        self._output = OrderedOutput(writer, summary.outputs)
        super().__init__(chain, self._output, summary, truth_topics)
        self._pending: list[tuple[str, BagRecord]] = []
        self._templates: dict[tuple[str, int], CdrTemplate | None] = {}

    def process_message(self, topic: str, record: BagRecord) -> None:
        """Buffer one message of the bag, in order of log time; process the batch when it is full."""
        self._pending.append((topic, record))
        if len(self._pending) == _MAX_BATCH:
            self._process_pending()

    def finish(self) -> None:
        """Process the buffered messages and write all pending outputs."""
        self._process_pending()
        self._output.position = _LAST_INDEX, 0
        super().finish()
        self._output.flush()

    def _process_pending(self) -> None:
        """Let one node after another process the buffered messages, then write the outputs."""
        records, self._pending = self._pending, []
        events, event_records = self._events(records)
        rows = self._topic_blocks(events, event_records)
        self._count_messages(events, event_records, rows)
        node_outputs: list[NodeOutputs] = []
        for adapter, input_topics in zip(self._chain.adapters, self._chain.input_topics, strict=True):
            forwarded = (
                self._forwarded_messages(adapter, node_outputs, input_topics, events) if self._chain.linked else {}
            )
            node_outputs.append(NodePass(adapter, input_topics, events, rows, forwarded).run())
            self._add_message_batches(len(node_outputs) - 1, node_outputs[-1], events)
        self._publish_batch(events, event_records, node_outputs, self._truth(events, event_records))
        self._output.flush()

    # -- inputs ---------------------------------------------------------------------------------------------

    def _events(self, records: list[tuple[str, BagRecord]]) -> tuple[list[InputEvent], list[BagRecord | None]]:
        """Return the ticks and messages of a batch, and the record of each message."""
        events: list[InputEvent] = []
        event_records: list[BagRecord | None] = []
        for topic, record in records:
            ticks_ns = self._tick_times_ns(record.log_time_ns)
            events += map(InputEvent, ticks_ns)
            events.append(InputEvent(record.log_time_ns, topic))
            event_records += [None] * len(ticks_ns) + [record]
        return events, event_records

    def _topic_blocks(self, events: list[InputEvent], event_records: list[BagRecord | None]) -> dict[str, TopicBlock]:
        """Return topic → its messages as a block, if possible; decode all other messages except the truth."""
        blocks = self._chain.block_topics()
        places: dict[str, list[int]] = defaultdict(list)
        for place, (event, record) in enumerate(zip(events, event_records, strict=True)):
            if event.topic in blocks:
                places[event.topic].append(place)
            elif record is not None and not event.topic.startswith(TRUTH_PREFIX):
                self._decode(event, record)
        rows = {}
        for topic, of_topic in places.items():
            records = [record for place in of_topic if (record := event_records[place]) is not None]
            messages = self._as_rows(records)
            if messages is not None:
                times_ns = np.array([record.log_time_ns for record in records])
                rows[topic] = TopicBlock(messages, times_ns, np.array(of_topic))
                continue
            for place, record in zip(of_topic, records, strict=True):
                self._decode(events[place], record)
        return rows

    def _truth(
        self, events: list[InputEvent], event_records: list[BagRecord | None]
    ) -> dict[int, AttitudeSample | None]:
        """Return event index → sample of the truth, for truth messages that can be read as a block."""
        found: dict[int, AttitudeSample | None] = {}
        for errors in self._errors:
            truth_topic = errors.orientation.truth_topic
            places = [place for place, event in enumerate(events) if event.topic == truth_topic]
            messages = self._as_rows([record for place in places if (record := event_records[place]) is not None])
            if messages is not None:
                found |= zip(places, errors.orientation.samples(messages), strict=True)
        return found

    def _decode(self, event: InputEvent, record: BagRecord) -> None:
        try:
            event.message = record.decode()
        except BadInput:
            self._summary.undecodable[event.topic] += 1

    def _as_rows(self, records: list[BagRecord]) -> CdrRows | None:
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

    def _count_messages(
        self, events: list[InputEvent], event_records: list[BagRecord | None], rows: dict[str, TopicBlock]
    ) -> None:
        """Add the messages to the statistics of the inputs."""
        for topic, (messages, times_ns, _) in rows.items():
            stamps_ns = stamps_of_rows(messages.numbers)
            self._summary.inputs[topic] += len(times_ns)
            self._summary.times.setdefault(topic, MessageTimes()).add_block(stamps_ns, times_ns)
            self._summary.log_delays.add_block(topic, stamps_ns, times_ns)
        for event, record in zip(events, event_records, strict=True):
            if event.message is not None and record is not None:
                self._count_message(event.topic, record)

    # -- from node to node ----------------------------------------------------------------------------------

    def _forwarded_messages(
        self, adapter: Adapter, node_outputs: list[NodeOutputs], input_topics: Container[str], events: list[InputEvent]
    ) -> dict[int, list[OutputMessage]]:
        """Return event index → messages of earlier nodes on the input topics, in order.

        Messages that the adapter can read as a block are already read.
        """
        found: list[tuple[int, int, int, OutputMessage]] = []
        for node, one in enumerate(node_outputs):
            for place, order, published in one.messages:
                found += [(place, node, order, message) for message in published if message[0] in input_topics]
            for rows, places, orders in one.message_batches:
                if rows.topic in input_topics:
                    readings = read_ahead(adapter, rows.topic, rows.messages, _times_ns(events, places))
                    found += [
                        (place, node, order, (rows.topic, rows.messages.message(number) if read is None else read))
                        for number, (place, order, read) in enumerate(
                            zip(places.tolist(), orders.tolist(), readings, strict=True)
                        )
                    ]
        forwarded: dict[int, list[OutputMessage]] = defaultdict(list)
        for place, _, _, message in sorted(found, key=lambda each: each[:3]):
            forwarded[place].append(message)
        return forwarded

    def _add_message_batches(self, node: int, node_outputs: NodeOutputs, events: list[InputEvent]) -> None:
        """Queue the messages made from a node's estimates."""
        for rows, places, orders in node_outputs.message_batches:
            self._output.add_rows(rows, places, (node << _NODE_BITS) + orders, _times_ns(events, places))
            for errors in self._errors:
                errors.add_rows(rows)

    # -- outputs --------------------------------------------------------------------------------------------

    def _publish_batch(
        self,
        events: list[InputEvent],
        event_records: list[BagRecord | None],
        node_outputs: list[NodeOutputs],
        truth: Mapping[int, AttitudeSample | None],
    ) -> None:
        """Write the outputs event by event, with the truth and the errors against it."""
        single: dict[int, list[tuple[int, list[OutputMessage]]]] = defaultdict(list)
        runs: dict[int, list[tuple[str, Any]]] = defaultdict(list)
        for node, one in enumerate(node_outputs):
            for place, order, published in one.messages:
                single[place].append(((node << _NODE_BITS) + order, published))
            for run in one.estimates:
                runs[int(run.event_indices[0])].append((run.topic, run.estimates))
        copied = {place for place, event in enumerate(events) if event.topic.startswith(TRUTH_PREFIX)}
        has_pending = self._has_pending_errors
        for place, (event, record) in enumerate(zip(events, event_records, strict=True)):
            if not has_pending and place not in single and place not in runs and place not in copied:
                continue
            for topic, estimates in runs.get(place, ()):
                history = self._summary.status_histories.setdefault(topic, StatusHistory())
                history.add_run(estimates.status, estimates.time_ns)
            for order, published in sorted(single.get(place, ()), key=lambda each: each[0]):
                self._output.position = place, order
                self._publish(published, event.now_ns)
            self._output.position = place, _LAST_INDEX
            if record is not None:
                if place in copied:
                    self._copy_truth(event.topic, record, truth.get(place))
                self._write_errors(event.now_ns)
            has_pending = self._has_pending_errors


def _times_ns(events: list[InputEvent], places: StampArray) -> StampArray:
    """Return the times of some events, ns."""
    return np.array([events[place].now_ns for place in places.tolist()], dtype=np.int64)


def _template(record: BagRecord) -> CdrTemplate | None:
    """Return the layout of a message; None if it cannot be determined."""
    try:
        return CdrTemplate.of_message(record.type_name, lambda name: definition_in(record.store, name), record.data)
    except (ValueError, TypeError):
        return None

"""A replay in blocks: messages of one topic that follow one another are handed over together where that can be.

What is published and in which order is what :class:`ship_replay.offline.replay_run.ReplayRun` makes of the same
messages one by one. A block ends at the next message of another topic, and at the next tick that says something.
Messages of the truth end none, for no adapter hears them.
"""

from collections.abc import Container

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.message_store import definition_in
from ship_bags.topic_names import TRUTH_PREFIX
from ship_node.edge.adapter import TICK_PERIOD_NS
from ship_node.edge.blocks import StampArray
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.message_times import MessageTimes
from ship_replay.offline.ordered_output import ManySink, OrderedOutput
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary
from ship_replay.offline.status_course import StatusCourse

_MOST = 1000
"""Messages that wait to be handed over together, at most."""
_LEAST = 3
"""Fewer are handed over one by one."""


class BlockRun(ReplayRun):
    """A chain of adapters fed with blocks; arguments as of :class:`ReplayRun`, the sink takes many messages at once."""

    def __init__(
        self, chain: AdapterChain, writer: ManySink, summary: ReplaySummary, truth_topics: Container[str]
    ) -> None:
        self._output = OrderedOutput(writer, summary.outputs)
        super().__init__(chain, self._output, summary, truth_topics)
        self._waiting: list[BagRecord] = []
        self._waiting_topic = ""
        self._truth_waiting: list[tuple[str, BagRecord]] = []
        self._templates: dict[tuple[str, int], CdrTemplate | None] = {}

    def take(self, topic: str, record: BagRecord) -> None:
        """One message of the bag, in order of log time."""
        if topic.startswith(TRUTH_PREFIX):
            self._truth_waiting.append((topic, record))
            if len(self._truth_waiting) == _MOST:
                self._take_waiting()
        elif self._chain.takes_blocks(topic):
            waiting = self._waiting
            if waiting and (
                topic != self._waiting_topic or len(waiting) == _MOST or len(record.data) != len(waiting[0].data)
            ):
                self._take_waiting()
            self._waiting_topic = topic
            self._waiting.append(record)
        else:
            self._take_waiting()
            super().take(topic, record)

    def finish(self) -> None:
        """Take what waits, and write all that is not written."""
        self._take_waiting()
        super().finish()
        self._output.flush()

    def _take_waiting(self) -> None:
        truth, records = self._truth_waiting, self._waiting
        self._truth_waiting, self._waiting = [], []
        for topic, record in truth:
            self._copy_truth(topic, record)
        if records:
            self._take_together(self._waiting_topic, records)
        ends = [*records[-1:], *(record for _, record in truth[-1:])]
        if ends:
            last_ns = max(record.log_time_ns for record in ends)
            self._tick_until(last_ns)
            self._write_errors(last_ns)

    def _take_together(self, topic: str, records: list[BagRecord]) -> None:
        messages, start = self._rows(records), 0
        times_ns = np.array([record.log_time_ns for record in records])
        while start < len(records):
            # The first tick that is not quiet comes before the message logged with it.
            tick_ns = -(-self._chain.quiet_until_ns // TICK_PERIOD_NS) * TICK_PERIOD_NS
            some = slice(start, int(np.searchsorted(times_ns, tick_ns)))
            count = 0
            if messages is not None and some.stop - start >= _LEAST:
                count = self._hand_over_some(topic, messages.some(some), times_ns[some])
            if count == 0:
                self._tick_until(records[start].log_time_ns)
                self._hand_over(topic, records[start])
                count = 1
            start += count

    def _hand_over_some(self, topic: str, messages: CdrRows, times_ns: StampArray) -> int:
        """Hand the first messages of a block over, those that can be taken together; how many these were."""
        adapter, count, parts = self._chain.handle_block(topic, messages, times_ns)
        if count == 0:
            return 0
        self.last_time_ns = int(times_ns[count - 1])
        self._summary.inputs[topic] += count
        numbers = messages.some(slice(count)).numbers
        stamps_ns = numbers["header.stamp.sec"].astype(np.int64) * 1_000_000_000 + numbers["header.stamp.nanosec"]
        self._summary.times.setdefault(topic, MessageTimes()).add_block(stamps_ns, times_ns[:count])
        self._summary.log_times.add_block(topic, stamps_ns, times_ns[:count])
        for part in parts:
            self._publish(part.published, int(times_ns[part.place]))
            if part.estimates is not None:
                run = part.estimates
                logged_ns = times_ns[part.place : part.place + len(run.time_ns)]
                self._output.add_run(adapter.block_messages, run, logged_ns)
                self._summary.statuses.setdefault(adapter.main_topic, StatusCourse()).add_run(run.status, run.time_ns)
        return count

    def _rows(self, records: list[BagRecord]) -> CdrRows | None:
        """Messages of one length as rows; None where they are laid out in different ways, or in one unknown."""
        if len(records) < _LEAST:
            return None
        first = records[0]
        kind = first.topic, len(first.data)
        if kind not in self._templates:
            self._templates[kind] = _template(first)
        template = self._templates[kind]
        if template is None:
            return None
        rows = np.frombuffer(b"".join([record.data for record in records]), dtype=np.uint8).reshape(len(records), -1)
        return CdrRows(template, rows) if template.fitting(rows).all() else None

    def _write_errors(self, now_ns: int | None) -> None:
        # The attitudes that errors are of may still be waiting.
        if self._output.is_full or any(errors.is_ready(now_ns) for errors in self._errors):
            for rows in self._output.flush():
                for errors in self._errors:
                    errors.add_rows(rows)
        super()._write_errors(now_ns)


def _template(record: BagRecord) -> CdrTemplate | None:
    """How a message is laid out; None where that cannot be told."""
    try:
        return CdrTemplate.of_message(record.type_name, lambda name: definition_in(record.store, name), record.data)
    except (ValueError, TypeError):
        return None


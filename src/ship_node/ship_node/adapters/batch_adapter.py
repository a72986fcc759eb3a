"""Adapter that can evaluate many messages of a topic as one batch, offline.

Each message gives bit for bit the same result as in :mod:`ship_node.adapters.reporting_adapter`.
"""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from ship_bags.cdr_template import CdrRows
from ship_estimation.rejections import Rejection
from ship_node.adapters.reporting_adapter import ReportingAdapter
from ship_node.messages.batches import BatchOutput, OutputRows, PendingBatch, StampArray, outputs_with_levels
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.topics import OutputMessage


class BatchAdapter(ReportingAdapter):
    """Adapter that can also process the messages of some topics in batches; see :class:`ReportingAdapter`."""

    has_idle_ticks: ClassVar[bool] = True
    """True if a tick among the messages of a batch does not change the core."""

    def accepts_batches(self, topic: str) -> bool:
        """Return True if messages of a topic can be processed in batches now."""
        return self.feeds[topic].batch is not None and not self.is_off(topic) and not self.time_base.is_step_pending

    def can_read_rows(self, topic: str) -> bool:
        """Return True if many messages of a topic can be read together, to be processed one by one afterwards."""
        return topic in self.feeds and self.feeds[topic].read_rows is not None

    def read_rows(self, topic: str, messages: CdrRows, receive_ns: StampArray) -> Sequence[ReadMessage[Any] | None]:
        """Read messages for :meth:`handle_read`; return None for each message that :meth:`handle` must process."""
        read = self.feeds[topic].read_rows
        assert read is not None
        return read(messages, receive_ns)

    def handle_read(self, topic: str, reading: ReadMessage[Any], receive_ns: int) -> list[OutputMessage]:
        """Process one message of an input topic that was read in advance."""
        feed = self.feeds[topic]
        if self.is_off(topic):
            return self.report_off_source(feed, reading, receive_ns, receive_ns)
        if self.saved is not None and self.saved.is_pending:
            self.saved.start(receive_ns)
        rejection = self.check_clock(feed, reading.value.time_ns, receive_ns, receive_ns)
        if rejection is not None:
            self.health.record_unreadable(topic, receive_ns, receive_ns, reading.value.time_ns, rejection)
            return [self.rejection_message(feed.source, reading.value.time_ns, rejection)]
        self.check_single_publisher(feed, reading)
        return self.report_input(feed, reading, feed.process(reading.value, receive_ns), receive_ns, receive_ns)

    @property
    def idle_until_ns(self) -> int:
        """Timeout-clock time before which a tick only calls the core; 0 if every tick may do more."""
        if self.next_slow_ns is None or (self.saved is not None and self.saved.is_pending):
            return 0
        if self.saved is None:
            return self.next_slow_ns
        return min(self.next_slow_ns, self.saved.next_autosave_ns(self.config.alignment_autosave_s))

    def evaluate_batch(self, topic: str, messages: CdrRows, receive_ns: StampArray) -> PendingBatch | None:
        """Read and evaluate the leading messages of a batch; return None if the first message must be processed alone.

        Until the whole batch is committed, no other message of the topic is processed. Estimates and protection levels,
        on which no other message depends, are computed at the end (:meth:`finish_batch`).
        """
        feed = self.feeds[topic].batch
        if feed is None or (self.saved is not None and self.saved.is_pending):
            return None
        reading = feed.read(messages, receive_ns)
        samples = reading.samples
        stamps_ns = samples.times_ns.tolist()
        count = self.time_base.count_without_step(topic, stamps_ns, receive_ns[: len(stamps_ns)].tolist())
        if count:
            unmoved = samples.subset(slice(count))
            count = self._duplicates.count_before_change(topic, unmoved.times_ns, unmoved.rotations_nd)
        batch = feed.core.evaluate_batch(samples.subset(slice(count)), receive_ns[:count]) if count else None
        if batch is None:
            return None
        count = batch.checked.count
        self.time_base.add_batch(topic, stamps_ns[count - 1], int(receive_ns[count - 1]), count)
        return PendingBatch(topic, reading, receive_ns[:count], batch)

    def commit_batch(self, pending: PendingBatch, stop: int) -> list[BatchOutput]:
        """Commit the messages of a batch before index ``stop``; return the outputs to publish now."""
        feed = self.feeds[pending.topic].batch
        assert feed is not None
        feed.core.commit_batch(pending.evaluated, min(stop, pending.evaluated.checked.accepted_count))
        outcomes, pending.evaluated.pending_outcomes[:] = list(pending.evaluated.pending_outcomes), []
        parts = []
        for place, outcome in outcomes:
            now_ns = int(pending.receive_ns[place])
            parts.append(BatchOutput(place, self.report_outcome(outcome, now_ns, now_ns)))
        return parts

    def finish_batch(self, pending: PendingBatch) -> list[BatchOutput]:
        """Finish a batch whose messages are all committed; return its remaining outputs."""
        feed, reading, accepted_count = (
            self.feeds[pending.topic],
            pending.reading,
            pending.evaluated.checked.accepted_count,
        )
        assert feed.batch is not None
        samples = reading.samples.subset(slice(len(pending.receive_ns)))
        self._duplicates.add_batch(pending.topic, samples.times_ns, samples.rotations_nd)
        if accepted_count:
            receive_ns, times_ns = pending.receive_ns[:accepted_count], reading.samples.times_ns[:accepted_count]
            self.health.record_batch(pending.topic, receive_ns, times_ns, reading.covariance_known)
        parts: list[BatchOutput] = []
        for some, found in feed.batch.core.batch_estimates(pending.evaluated):
            parts += self.batch_outputs(some, found, reading.samples.times_ns)
        last = feed.batch.core.finish_batch(pending.evaluated)
        if last is not None:
            message = ReadMessage(reading.samples.sample(accepted_count), reading.covariance_known)
            now_ns = int(pending.receive_ns[accepted_count])
            parts.append(BatchOutput(accepted_count, self.report_input(feed, message, last, now_ns, now_ns)))
        return parts

    def batch_outputs(self, some: slice, found: Any, times_ns: Sequence[int] | StampArray) -> Iterator[BatchOutput]:
        """Yield estimates to publish, with the protection levels that must be published before some of them.

        Args:
            some: indices of ``found`` among all estimates that are computed together.
            found: a run of estimates, or the rejection if they could not be computed.
            times_ns: stamps of all estimates that are computed together.
        """
        if isinstance(found, Rejection):
            for place in range(some.start, some.stop):
                yield BatchOutput(place, [self.report_failure(self.main_topic, int(times_ns[place]), found)])
            return
        if self.integrity_topic:
            redundancy_keys = list(zip(*self.redundancy_key(found), strict=True))
            directions, levels_before = self.directions(found), self.protection_level_messages
            yield from outputs_with_levels(
                some.start, found, self.published_levels, redundancy_keys, directions, levels_before
            )
        else:
            yield BatchOutput(some.start, [], found)
        self.latest = self.pending_budget = found.estimate(len(found.time_ns) - 1)

    @abstractmethod
    def batch_messages(self, runs: Sequence[Any]) -> Iterator[OutputRows]:
        """Return the messages of several runs of outputs; the messages of one output are in order of publication."""

"""One replay: messages of a bag are passed to adapters, and the published messages to a sink."""

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass, field
from typing import Any, Protocol

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import TRUTH_PREFIX
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.adapters.adapter import TICK_PERIOD_NS
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC
from ship_node.messages.topics import OutputMessage
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.exclusion_history import INTEGRITY_TOPICS, ExclusionHistory
from ship_replay.offline.message_times import LogDelays, MessageTimes
from ship_replay.offline.status_history import STATUS_TOPICS, StatusHistory
from ship_replay.offline.truth_errors import TruthErrors
from ship_watch.orientations import ORIENTATIONS

_MAX_TICK_GAP_NS = 600 * NS_PER_S
"""Maximum time after a message for which ticks are generated, ns.

By then every timeout of the nodes has expired. The limit avoids hours of ticks after a wrong log time, from a damaged
file or a wrong clock.
"""


@dataclass
class ReplaySummary:
    """Result of a replay.

    Attributes:
        inputs: relative topic → number of messages processed.
        outputs: topic → number of messages written, truth included.
        rejected: input topic, after the node's name if several nodes are replayed → reason → number of messages not
            used.
        accepted_with_note: the same topics → reason → number of messages used with a note, or of message parts not
            used.
        undecodable: relative topic → number of messages that do not match their type.
        status_histories: topic with a status → its status history.
        exclusions: topic of Integrity messages → history of the reported exclusions.
        times: relative topic → stamps and arrival times of its messages.
        log_delays: statistics of log time minus stamp.
        reasons: reasons for which outputs were INVALID or DEGRADED, one line each.
        absent: optional input topics that are not in the bag.
        problems: nodes that are not replayed, and problems of the bag, one line each.
        duration_s: length of the bag, s.
        elapsed_s: processing time, s.
    """

    inputs: Counter[str] = field(default_factory=Counter)
    outputs: Counter[str] = field(default_factory=Counter)
    rejected: dict[str, dict[str, int]] = field(default_factory=dict)
    accepted_with_note: dict[str, dict[str, int]] = field(default_factory=dict)
    undecodable: Counter[str] = field(default_factory=Counter)
    status_histories: dict[str, StatusHistory] = field(default_factory=dict)
    exclusions: dict[str, ExclusionHistory] = field(default_factory=dict)
    times: dict[str, MessageTimes] = field(default_factory=dict)
    log_delays: LogDelays = field(default_factory=LogDelays)
    reasons: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    duration_s: float = 0.0
    elapsed_s: float = 0.0

    def status_lines(self) -> list[str]:
        """Return each output's status history, with the exclusions and reinstatements of sources below it."""
        lines = []
        for topic, status_history in sorted(self.status_histories.items()):
            lines += status_history.lines(topic)
            history = self.exclusions.get(INTEGRITY_TOPICS.get(topic, ""))
            if history is not None and status_history.spans:
                lines += history.lines(status_history.spans[0].start_ns)
        return lines


class MessageSink(Protocol):
    """Receiver of a replay's messages: a bag writer, or a comparison."""

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Receive a message."""
        ...

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Receive a serialised message of the truth, which is copied."""
        ...


class ReplayRun:
    """Replay of a bag through a chain of adapters, message by message.

    Args:
        chain: chain of adapters.
        writer: sink that receives the outputs.
        summary: result, which is filled during the replay.
        truth_topics: truth topics of the bag; errors are computed only for an orientation whose truth topic is
            included.

    Attributes:
        last_time_ns: arrival time of the last message; None before the first message.
    """

    def __init__(
        self, chain: AdapterChain, writer: MessageSink, summary: ReplaySummary, truth_topics: Container[str]
    ) -> None:
        self._chain = chain
        self._writer = writer
        self._summary = summary
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
        """Process one message of the bag."""
        self._tick_until(record.log_time_ns)
        if topic.startswith(TRUTH_PREFIX):
            self._copy_truth(topic, record)
        else:
            self._process_input(topic, record)
        self._write_errors(record.log_time_ns)

    def _copy_truth(self, topic: str, record: BagRecord, sample: AttitudeSample | None = None) -> None:
        """Copy a message of the truth; `sample` is its decoded content if already known."""
        self._writer.write_raw(topic, record.type_name, record.data, record.log_time_ns)
        self._summary.outputs[topic] += 1
        for errors in self._errors:
            if topic == errors.orientation.truth_topic:
                errors.add_truth(errors.orientation.sample(record.decode()) if sample is None else sample)

    def _process_input(self, topic: str, record: BagRecord) -> None:
        try:
            message = record.decode()
        except BadInput:
            self._summary.undecodable[topic] += 1
            return
        self._count_message(topic, record)
        self._publish(self._chain.handle(topic, message, record.log_time_ns), record.log_time_ns)

    def _count_message(self, topic: str, record: BagRecord) -> None:
        self._summary.inputs[topic] += 1
        self._summary.times.setdefault(topic, MessageTimes()).add(record)
        self._summary.log_delays.add(topic, record)

    def finish(self) -> None:
        """Write the error messages that still wait for the truth."""
        self._write_errors(None)

    def _tick_until(self, time_ns: int) -> None:
        for now_ns in self._tick_times_ns(time_ns):
            self._publish(self._chain.tick(now_ns), now_ns)

    def _tick_times_ns(self, time_ns: int) -> range:
        """Return the tick times up to a message, ns, and remember the message's time.

        These are the multiples of the period since the last message, for at most ten minutes.
        """
        last_ns, self.last_time_ns = self.last_time_ns, time_ns
        if last_ns is None:
            return range(0)
        end_ns = min(time_ns, last_ns + _MAX_TICK_GAP_NS)
        return range((last_ns // TICK_PERIOD_NS + 1) * TICK_PERIOD_NS, end_ns + 1, TICK_PERIOD_NS)

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

    @property
    def _has_pending_errors(self) -> bool:
        """True if an error message waits for the truth."""
        return any(errors.has_pending for errors in self._errors)

    def _write_errors(self, now_ns: int | None) -> None:
        for errors in self._errors:
            for log_time_ns, message in errors.pop_ready(now_ns):
                self._write(errors.orientation.error_topic, message, log_time_ns)

    def _write(self, topic: str, message: Any, time_ns: int) -> None:
        self._writer.write(topic, message, time_ns)
        self._summary.outputs[topic] += 1
        if topic in STATUS_TOPICS:
            self._summary.status_histories.setdefault(topic, StatusHistory()).add(message)
        elif topic in INTEGRITY_TOPICS.values():
            self._summary.exclusions.setdefault(topic, ExclusionHistory()).add(message)
        elif topic == DIAGNOSTICS_TOPIC:
            self._record_diagnostics(message)

    def _record_diagnostics(self, diagnostics: Any) -> None:
        """Record the diagnostics about statuses: "ship_attitude: attitude" is about ship/attitude."""
        for status in diagnostics.status:
            history = self._summary.status_histories.get(self._status_topics.get(status.name, ""))
            if history is not None:
                history.add_diagnostic(status.message)

"""Replays a bag through the adapters of the suite's nodes, in process and as fast as it goes.

Messages are handed over in order of log time, with the log time as time of arrival, or of their stamps; between them
the adapters are ticked on a fixed grid. The same bag and configuration give the same output, byte for byte.
"""

import time
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import TRUTH_PREFIX, likely_namespace, relative_topics
from ship_node.edge.adapter import TICK_PERIOD_NS, Adapter
from ship_node.edge.messages_out import DIAGNOSTICS_TOPIC
from ship_node.edge.topics import Published
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain, suite_text
from ship_replay.offline.message_times import LogTimes, MessageTimes, in_order_of_stamps
from ship_replay.offline.status_course import STATUS_TOPICS, StatusCourse, reasons_for
from ship_replay.offline.truth_errors import TruthErrors
from ship_watch.orientations import ORIENTATIONS

Watcher = Callable[[Iterator[BagRecord], Bag], Iterator[BagRecord]]

_LONGEST_SILENCE_NS = 600 * NS_PER_S
"""Ticks stop this long after the last message. By then the nodes have said all that they say of a silence. A log time
decades ahead, of a damaged file or of a clock set wrongly, must not lead to hours of ticks."""


@dataclass
class ReplaySummary:
    """What a replay did.

    Attributes:
        inputs: relative topic → messages handed over.
        outputs: topic → messages written, truth included.
        refused: relative topic → reason → messages not used.
        noted: relative topic → reason → messages used with a note, or parts of them that were not.
        undecodable: relative topic → messages whose bytes are not of their type.
        statuses: topic of a status → its course over time.
        times: relative topic → when its messages were stamped and arrived.
        log_times: how regularly they were logged.
        reasons: why outputs were INVALID or DEGRADED, one line each.
        absent: optional input topics that are not in the bag.
        problems: what is wrong with the bag, one line each.
        duration_s: length of the bag.
        elapsed_s: time that the replay took.
    """

    inputs: Counter[str] = field(default_factory=Counter)
    outputs: Counter[str] = field(default_factory=Counter)
    refused: dict[str, dict[str, int]] = field(default_factory=dict)
    noted: dict[str, dict[str, int]] = field(default_factory=dict)
    undecodable: Counter[str] = field(default_factory=Counter)
    statuses: dict[str, StatusCourse] = field(default_factory=dict)
    times: dict[str, MessageTimes] = field(default_factory=dict)
    log_times: LogTimes = field(default_factory=LogTimes)
    reasons: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    duration_s: float = 0.0
    elapsed_s: float = 0.0


class MessageSink(Protocol):
    """Takes what a replay gives: a bag, or a comparison."""

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take a message."""
        ...

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Take a message given by its bytes: the truth, which is copied."""
        ...


def replay(
    bag_path: Path,
    out_path: Path,
    adapter_classes: Sequence[type[Adapter]],
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
    by_stamps: bool = False,
) -> ReplaySummary:
    """Replay a bag and write what the adapters publish, and the truth as it is.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        out_path: .mcap file to write; it appears only when the replay is complete.
        adapter_classes: of the nodes that may take part, the main one first.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.
        by_stamps: messages arrive at their stamps, whenever they were logged.

    Raises:
        BadInput: the bag, its topics or the configuration do not serve; nothing is written.
    """
    started_s = time.monotonic()
    with read_bag(bag_path) as bag:
        if out_path.resolve() == bag_path.resolve():
            raise BadInput("the output would overwrite the input", file=out_path)
        factory = RosbagsFactory()
        config_text = suite_text(bag, config_path)
        chain, left_out = suite_chain(bag, adapter_classes, factory, config_path, namespace)
        input_names = match_inputs(bag, chain, namespace)
        names = input_names | _truth_names(bag, namespace)
        summary = ReplaySummary(absent=[topic.topic for topic in chain.inputs if topic.topic not in input_names])
        with BagWriter(out_path) as writer:
            _announce(writer, bag, chain, config_text)
            run = ReplayRun(chain, writer, summary, truth_topics=names)
            relative_names = {name: relative for relative, name in names.items()}
            records = watch(bag.records(relative_names), bag)
            if by_stamps:
                records = in_order_of_stamps(records, _usual_delay_ns(bag_path, relative_names))
            for record in records:
                run.take(relative_names[record.topic], record)
            if bag.last_time_ns is None or bag.start_ns is None:
                told = "".join(f"; {problem}" for problem in bag.problems)
                raise BadInput(f"no message of {', '.join(sorted(relative_names))} could be read{told}", file=bag_path)
            run.finish()
        last_ns = bag.last_time_ns if run.last_time_ns is None else run.last_time_ns
        for adapter in chain.adapters:
            health = adapter.health.messages(factory, last_ns)
            _tell_of_node(summary, adapter, chain.configs[adapter.node_name], health, is_alone=len(chain.adapters) == 1)
        summary.problems = left_out + bag.problems
        summary.duration_s = (bag.last_time_ns - bag.start_ns) / NS_PER_S
    summary.elapsed_s = time.monotonic() - started_s
    return summary


def _tell_of_node(
    summary: ReplaySummary, adapter: Adapter, config: Any, health: Sequence[Any], is_alone: bool
) -> None:
    """Note why a node's outputs were no better, and what it did not use of its inputs."""
    for output in adapter.outputs:
        if output.topic in summary.statuses:
            course = summary.statuses[output.topic]
            summary.reasons += reasons_for(course, adapter, config, summary.times, health)
    for topic, counts in adapter.health.refused_and_noted().items():
        name = topic if is_alone else f"{adapter.node_name}: {topic}"
        for kept, reasons in zip((summary.refused, summary.noted), counts, strict=True):
            if reasons:
                kept[name] = {reason.word: count for reason, count in reasons.items()}


def _usual_delay_ns(bag_path: Path, relative_names: Mapping[str, str]) -> int:
    """Log time minus stamp of most of the messages."""
    times = LogTimes()
    with read_bag(bag_path) as bag:
        for record in bag.records(relative_names):
            times.add(record.topic, record)
    return times.usual_ns()


def match_inputs(bag: Bag, adapter: Adapter | AdapterChain, namespace: str) -> dict[str, str]:
    """Relative name → name in the bag, of the adapter's input topics that the bag holds.

    Raises:
        BadInput: a required topic is missing, a topic has another type, or a message definition lacks something.
    """
    found = relative_topics(bag.topics, namespace)
    required = [topic.topic for topic in adapter.inputs if topic.required]
    missing = [topic for topic in required if topic not in found]
    if missing:
        hint = likely_namespace(bag.topics, required)
        advice = f" (found under the namespace '{hint}': give --namespace {hint})" if hint and hint != namespace else ""
        skipped = "".join(f"; '{topic}' is unusable: {why}" for topic, why in sorted(bag.skipped_topics.items()))
        raise BadInput(
            f"required topics {', '.join(missing)} are missing; found {', '.join(sorted(found)) or 'none'}"
            f"{skipped}{advice}",
            file=bag.path,
        )
    for topic in adapter.inputs:
        type_name = bag.topics[found[topic.topic]] if topic.topic in found else topic.type_name
        if type_name != topic.type_name:
            raise BadInput(f"topic '{found[topic.topic]}' is {type_name}: expected {topic.type_name}", file=bag.path)
        lacking = [line for line in bag.differences.get(type_name, []) if not line.endswith("unknown here")]
        if topic.topic in found and lacking:
            raise BadInput(f"topic '{found[topic.topic]}': {'; '.join(lacking)}", file=bag.path)
    return {topic.topic: found[topic.topic] for topic in adapter.inputs if topic.topic in found}


def _truth_names(bag: Bag, namespace: str) -> dict[str, str]:
    """Relative name → name in the bag, of the truth topics, which are copied."""
    found = relative_topics(bag.topics, namespace)
    names = {relative: name for relative, name in found.items() if relative.startswith(TRUTH_PREFIX)}
    for name in names.values():
        if bag.topics[name] in bag.differences:
            lines = "; ".join(bag.differences[bag.topics[name]])
            raise BadInput(f"topic '{name}' cannot be copied, its definition is another: {lines}", file=bag.path)
    return names


def _announce(writer: BagWriter, bag: Bag, chain: AdapterChain, config_text: str) -> None:
    """Write the head of the output: attachments, metadata, topics."""
    writer.add_attachment(SUITE_ATTACHMENT, config_text)
    if SCENARIO_ATTACHMENT in bag.attachments:
        writer.add_attachment(SCENARIO_ATTACHMENT, bag.attachments[SCENARIO_ATTACHMENT])
    for name, entries in bag.metadata.items():
        # rosbag2 keeps its own file information in a record of that name; it would be wrong in another file.
        if name != "rosbag2":
            writer.add_metadata(name, entries)
    for output in chain.outputs:
        writer.add_topic(output.topic, output.type_name, output.latched)


class ReplayRun:
    """A chain of adapters fed message by message, its outputs given to a sink.

    Args:
        chain: of adapters.
        writer: takes the outputs.
        summary: is filled.
        truth_topics: topics of the bag; where the truth of an orientation is among them, its errors are filled in.

    Attributes:
        last_time_ns: arrival of the last message; None before the first.
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

    def take(self, topic: str, record: BagRecord) -> None:
        """One message of the bag."""
        self._tick_until(record.log_time_ns)
        if topic.startswith(TRUTH_PREFIX):
            self._writer.write_raw(topic, record.type_name, record.data, record.log_time_ns)
            self._summary.outputs[topic] += 1
            for errors in self._errors:
                if topic == errors.orientation.truth_topic:
                    errors.add_truth(record.decode())
        else:
            try:
                message = record.decode()
            except BadInput:
                self._summary.undecodable[topic] += 1
                return
            self._summary.inputs[topic] += 1
            self._summary.times.setdefault(topic, MessageTimes()).add(record)
            self._summary.log_times.add(topic, record)
            self._publish(self._chain.handle(topic, message, record.log_time_ns), record.log_time_ns)
        self._write_errors(record.log_time_ns)

    def finish(self) -> None:
        """Write the messages that still wait for the truth."""
        self._write_errors(None)

    def _tick_until(self, time_ns: int) -> None:
        """Tick at each multiple of the period between the last message and a time, both in ns."""
        if self.last_time_ns is not None:
            end_ns = min(time_ns, self.last_time_ns + _LONGEST_SILENCE_NS)
            first_ns = (self.last_time_ns // TICK_PERIOD_NS + 1) * TICK_PERIOD_NS
            for now_ns in range(first_ns, end_ns + 1, TICK_PERIOD_NS):
                self._publish(self._chain.tick(now_ns), now_ns)
        self.last_time_ns = time_ns

    def _publish(self, published: list[Published], time_ns: int) -> None:
        for topic, message in published:
            if not self._held_back(topic, message, time_ns):
                self._write(topic, message, time_ns)

    def _held_back(self, topic: str, message: Any, time_ns: int) -> bool:
        """Whether a message waits for the truth."""
        for errors in self._errors:
            if topic == errors.orientation.error_topic:
                errors.add_error(message, time_ns)
                return True
            if topic == errors.orientation.topic:
                errors.add_attitude(message)
        return False

    def _write_errors(self, now_ns: int | None) -> None:
        for errors in self._errors:
            for log_time_ns, message in errors.filled(now_ns):
                self._write(errors.orientation.error_topic, message, log_time_ns)

    def _write(self, topic: str, message: Any, time_ns: int) -> None:
        self._writer.write(topic, message, time_ns)
        self._summary.outputs[topic] += 1
        if topic in STATUS_TOPICS:
            self._summary.statuses.setdefault(topic, StatusCourse()).add(message)
        elif topic == DIAGNOSTICS_TOPIC:
            self._note_sayings(message)

    def _note_sayings(self, diagnostics: Any) -> None:
        """What the nodes say of their statuses: the diagnostics "ship_attitude: attitude" are about ship/attitude."""
        for said in diagnostics.status:
            course = self._summary.statuses.get(self._status_topics.get(said.name, ""))
            if course is not None:
                course.note(said.message)

"""Replays a bag through a node's adapter, in process and as fast as it goes.

Messages are handed over in order of log time, with the log time as time of arrival; between them the adapter is
ticked on a fixed grid. The same bag and configuration give the same output, byte for byte.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ship_node.adapter import Adapter
from ship_node.parameter_file import load_config
from ship_replay.bag_reader import Bag, BagRecord, read_bag
from ship_replay.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT, BagWriter
from ship_replay.errors import BadInput
from ship_replay.message_store import RosbagsFactory
from ship_replay.replay_run import ReplayRun, ReplaySummary
from ship_replay.times import NS_PER_S
from ship_replay.topic_names import TRUTH_PREFIX, likely_namespace, relative_topics
from ship_replay.truth_errors import TRUTH_TOPIC

Watcher = Callable[[Iterator[BagRecord], Bag], Iterator[BagRecord]]


def replay(
    bag_path: Path,
    out_path: Path,
    adapter_class: type[Adapter],
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
) -> ReplaySummary:
    """Replay a bag and write what the adapter publishes, and the truth as it is.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        out_path: .mcap file to write; it appears only when the replay is complete.
        adapter_class: the node's adapter.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.

    Raises:
        BadInput: the bag, its topics or the configuration do not serve; nothing is written.
    """
    started_s = time.monotonic()
    with read_bag(bag_path) as bag:
        if out_path.resolve() == bag_path.resolve():
            raise BadInput(f"{out_path}: the output would overwrite the input")
        factory = RosbagsFactory()
        config_text = suite_text(bag, config_path)
        adapter = adapter_class(suite_config(bag, adapter_class, config_path), factory)
        input_names = match_inputs(bag, adapter, namespace)
        names = input_names | _truth_names(bag, namespace)
        summary = ReplaySummary(absent=[topic.topic for topic in adapter.inputs if topic.topic not in input_names])
        with BagWriter(out_path) as writer:
            _announce(writer, bag, adapter, config_text)
            run = ReplayRun(adapter, writer, summary, has_truth=TRUTH_TOPIC in names)
            relative_names = {name: relative for relative, name in names.items()}
            for record in watch(bag.records(relative_names), bag):
                run.take(relative_names[record.topic], record)
            run.finish()
        last_ns = bag.last_time_ns or 0
        for message in adapter.health.messages(factory, last_ns):
            if len(message.reasons):
                counts = [int(count) for count in message.reason_counts]
                summary.refused[message.topic] = dict(zip(message.reasons, counts, strict=True))
        summary.problems = bag.problems
        summary.duration_s = (last_ns - (bag.start_ns or 0)) / NS_PER_S
    summary.elapsed_s = time.monotonic() - started_s
    return summary


def suite_text(bag: Bag, config_path: Path | None) -> str:
    """Text of the suite configuration: the file's, else the one attached to the bag.

    Raises:
        BadInput: there is none, or the file cannot be read.
    """
    if config_path is not None:
        try:
            return config_path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            raise BadInput(f"{config_path}: cannot be read: {problem}") from problem
    if SUITE_ATTACHMENT not in bag.attachments:
        raise BadInput(f"{bag.path}: no configuration {SUITE_ATTACHMENT} is attached to the bag: give one by --config")
    return bag.attachments[SUITE_ATTACHMENT].decode("utf-8", errors="replace")


def suite_config(bag: Bag, adapter_class: type[Adapter], config_path: Path | None) -> Any:
    """The node's configuration: of the file, else of the one attached to the bag.

    Raises:
        BadInput: there is none, or it is not one of this node; names the parameter.
    """
    if config_path is not None:
        return load_config(adapter_class.config_type, config_path, adapter_class.node_name)
    text = suite_text(bag, None)
    try:
        return load_config(adapter_class.config_type, text, adapter_class.node_name)
    except BadInput as problem:
        raise BadInput(f"{bag.path}: attachment {SUITE_ATTACHMENT}: {problem}") from problem


def match_inputs(bag: Bag, adapter: Adapter, namespace: str) -> dict[str, str]:
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
            f"{bag.path}: required topics {', '.join(missing)} are missing; found {', '.join(sorted(found)) or 'none'}"
            f"{skipped}{advice}"
        )
    for topic in adapter.inputs:
        type_name = bag.topics[found[topic.topic]] if topic.topic in found else topic.type_name
        if type_name != topic.type_name:
            raise BadInput(f"{bag.path}: topic '{found[topic.topic]}' is {type_name}: expected {topic.type_name}")
        lacking = [line for line in bag.differences.get(type_name, []) if not line.endswith("unknown here")]
        if topic.topic in found and lacking:
            raise BadInput(f"{bag.path}: topic '{found[topic.topic]}': {'; '.join(lacking)}")
    return {topic.topic: found[topic.topic] for topic in adapter.inputs if topic.topic in found}


def _truth_names(bag: Bag, namespace: str) -> dict[str, str]:
    """Relative name → name in the bag, of the truth topics, which are copied."""
    found = relative_topics(bag.topics, namespace)
    names = {relative: name for relative, name in found.items() if relative.startswith(TRUTH_PREFIX)}
    for name in names.values():
        if bag.topics[name] in bag.differences:
            lines = "; ".join(bag.differences[bag.topics[name]])
            raise BadInput(f"{bag.path}: topic '{name}' cannot be copied, its definition is another: {lines}")
    return names


def _announce(writer: BagWriter, bag: Bag, adapter: Adapter, config_text: str) -> None:
    """Write what stands at the head of the output."""
    writer.add_attachment(SUITE_ATTACHMENT, config_text)
    if SCENARIO_ATTACHMENT in bag.attachments:
        writer.add_attachment(SCENARIO_ATTACHMENT, bag.attachments[SCENARIO_ATTACHMENT])
    for name, entries in bag.metadata.items():
        # rosbag2 keeps its own file information in a record of that name; it would be wrong in another file.
        if name != "rosbag2":
            writer.add_metadata(name, entries)
    for output in adapter.outputs:
        writer.add_topic(output.topic, output.type_name, output.latched)

"""Replay of a bag through the adapters of the suite's nodes, in process and as fast as possible.

Messages are processed in order of log time, which is their arrival time, or in order of stamps. Between messages, the
adapters are ticked at fixed times. The same bag and configuration give the same output, byte for byte, whether
messages are processed one by one or in batches.
"""

import time
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, ProgressWrapper, read_bag
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import ADDITIONAL_FIELD, RosbagsFactory
from ship_bags.provenance import COMMIT_RECORD, commit_record
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import TRUTH_PREFIX, likely_namespace, relative_topics, remap_advice
from ship_node.adapters.adapter import Adapter
from ship_node.messages.inputs_outputs import OutputTopic
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain, suite_text
from ship_replay.offline.message_times import LogDelays, sort_by_stamp
from ship_replay.offline.replay_run import LARGEST_BATCH, ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary, poor_status_reasons
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.adapters.triangulation_adapter import TriangulationAdapter

ADAPTERS = (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter, TriangulationAdapter)
"""Adapters of these nodes. The first node, the main node, also runs if the configuration names no node."""


def replay(
    bag_path: Path,
    out_path: Path,
    adapter_classes: Sequence[type[Adapter]],
    config_path: Path | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
    by_stamps: bool = False,
    one_by_one: bool = False,
) -> ReplaySummary:
    """Replay a bag and write the outputs of the adapters, with a copy of the truth.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        out_path: .mcap file to write; it appears only when the replay is complete.
        adapter_classes: adapters of the nodes that may take part, the main node first.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag.
        progress: function that wraps the iteration over the bag in a progress bar.
        by_stamps: if true, messages arrive at their stamps instead of their log times.
        one_by_one: if true, each message is processed by itself, as in a live node; otherwise messages are processed in
            batches, with the same result in a fraction of the time.

    Raises:
        BadInput: the bag, its topics or the configuration cannot be used; nothing is written.
    """
    started_s = time.monotonic()
    with read_bag(bag_path) as bag:
        if out_path.resolve() == bag_path.resolve():
            raise BadInput("the output would overwrite the input", file=out_path)
        factory = RosbagsFactory()
        config_text = suite_text(bag, config_path)
        chain, left_out = suite_chain(bag, adapter_classes, factory, config_path, namespace)
        inputs, truth = match_inputs(bag, chain, namespace), truth_topic_names(bag, namespace)
        names, found = inputs | truth, set(inputs.values())
        summary = ReplaySummary(absent=[topic.topic for topic in chain.inputs if topic.topic not in found])
        with BagWriter(out_path) as writer:
            write_head(writer, bag, chain.outputs, config_text)
            run = ReplayRun(chain, writer, summary, truth.values(), 1 if one_by_one else LARGEST_BATCH)
            records = progress(bag.records(names), bag)
            if by_stamps:
                records = sort_by_stamp(records, median_delay_ns(bag_path, names))
            for record in records:
                run.process_message(names[record.topic], record)
            if bag.last_time_ns is None:
                problem_text = "".join(f"; {problem}" for problem in bag.problems)
                looked_for = sorted(names) or sorted({topic.topic for topic in chain.inputs})
                text = f"no message of {', '.join(looked_for)} could be read{problem_text}"
                if not names:
                    text += "; if the topics are in a namespace, give it by --namespace"
                raise BadInput(text, file=bag_path)
            run.finish()
        last_ns = bag.last_time_ns if run.last_time_ns is None else run.last_time_ns
        for adapter in chain.adapters:
            health = adapter.health.messages(factory, last_ns)
            _summarise_node(
                summary, adapter, chain.configs[adapter.node_name], health, is_alone=len(chain.adapters) == 1
            )
        summary.problems = left_out + bag.problems
        summary.duration_s = (bag.last_time_ns - bag.start_ns) / NS_PER_S
    summary.elapsed_s = time.monotonic() - started_s
    return summary


def _summarise_node(
    summary: ReplaySummary, adapter: Adapter, config: Any, health: Sequence[Any], is_alone: bool
) -> None:
    """Add a node's reasons for poor statuses, and its counts of messages rejected or accepted with a note."""
    for output in adapter.outputs:
        if output.topic in summary.status_histories:
            history = summary.status_histories[output.topic]
            summary.reasons += poor_status_reasons(history, adapter, config, summary.times, health)
    for topic, counts in adapter.health.rejection_and_note_counts().items():
        name = topic if is_alone else f"{adapter.node_name}: {topic}"
        for target, reasons in zip((summary.rejected, summary.accepted_with_note), counts, strict=True):
            if reasons:
                target[name] = {reason.word: count for reason, count in reasons.items()}


def median_delay_ns(bag_path: Path, topics: Collection[str]) -> int:
    """Return the median of log time minus stamp over all messages of some topics, ns."""
    times = LogDelays()
    with read_bag(bag_path) as bag:
        for record in bag.records(topics):
            times.add(record.topic, record)
    return times.median_ns()


def match_inputs(bag: Bag, adapter: Adapter | AdapterChain, namespace: str) -> dict[str, str]:
    """Return name in the bag → relative name, for the adapter's input topics that the bag contains.

    Raises:
        BadInput: a required topic is missing, a topic has another type, or the message definition of an input
            differs from the suite's by more than additional fields.
    """
    found = relative_topics(bag.topics, namespace)
    required = [topic.topic for topic in adapter.inputs if topic.required]
    missing = [topic for topic in required if topic not in found]
    if missing:
        hint = likely_namespace(bag.topics, required)
        advice = f" (found under the namespace '{hint}': give --namespace {hint})" if hint and hint != namespace else ""
        kinds = {topic.topic: topic.type_name for topic in adapter.outputs}
        kinds |= {topic.topic: topic.type_name for topic in adapter.inputs}
        remaps = (remap_advice(name, kinds[name], bag.topics, kinds, namespace) for name in missing)
        advice = advice or "".join(f"; {text}" for text in remaps if text)
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
        differences = [line for line in bag.differences.get(type_name, []) if not line.endswith(ADDITIONAL_FIELD)]
        if topic.topic in found and differences:
            raise BadInput(f"topic '{found[topic.topic]}': {'; '.join(differences)}", file=bag.path)
    return {found[topic.topic]: topic.topic for topic in adapter.inputs if topic.topic in found}


def truth_topic_names(bag: Bag, namespace: str) -> dict[str, str]:
    """Return name in the bag → relative name, for the truth topics.

    Raises:
        BadInput: the message definition of a truth topic differs, so it cannot be copied.
    """
    found = relative_topics(bag.topics, namespace)
    names = {name: relative for relative, name in found.items() if relative.startswith(TRUTH_PREFIX)}
    for name in names:
        if bag.topics[name] in bag.differences:
            lines = "; ".join(bag.differences[bag.topics[name]])
            raise BadInput(f"topic '{name}' cannot be copied, its message definition differs: {lines}", file=bag.path)
    return names


def write_head(writer: BagWriter, bag: Bag, output_topics: Sequence[OutputTopic], config_text: str) -> None:
    """Write the head of the output: attachments, metadata, topics."""
    writer.add_attachment(SUITE_ATTACHMENT, config_text)
    if SCENARIO_ATTACHMENT in bag.attachments:
        writer.add_attachment(SCENARIO_ATTACHMENT, bag.attachments[SCENARIO_ATTACHMENT])
    for name, entries in bag.metadata.items():
        # The record "rosbag2" contains information about the file, which would be wrong in another file.
        if name not in ("rosbag2", COMMIT_RECORD):
            writer.add_metadata(name, entries)
    if commit := commit_record():
        writer.add_metadata(COMMIT_RECORD, commit)
    for output in output_topics:
        writer.add_topic(output.topic, output.type_name, output.latched)

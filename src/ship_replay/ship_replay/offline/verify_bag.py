"""Replays the inputs of an ordinary bag and compares with the outputs that it holds, topic by topic."""

from collections import defaultdict, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.topic_names import relative_topics
from ship_node.edge.adapter import Adapter
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain
from ship_replay.offline.message_difference import Difference, message_difference, stamp_of
from ship_replay.offline.replay import Watcher, match_inputs
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary
from ship_replay.offline.verification import ASIDE, Verification


def verify_bag(
    bag: Bag,
    adapter_classes: Sequence[type[Adapter]],
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
) -> Verification:
    """Compare what a replay gives with what a bag holds.

    A recorder does not know the order in which the node used its inputs, nor its service calls: only a black box makes
    sure that a difference is one of the estimate.

    Args:
        bag: inputs and outputs of one run.
        adapter_classes: of the nodes that may take part, the main one first.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.

    Raises:
        BadInput: the bag, its topics or the configuration do not serve, or it holds no outputs.
    """
    # Each node is given what was recorded, also of what another one gave it: that is what it met.
    chain, left_out = suite_chain(bag, adapter_classes, RosbagsFactory(), config_path, namespace, linked=False)
    inputs = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
    outputs = _recorded_outputs(bag, chain, namespace)
    comparison = _Comparison(set(outputs.values()))
    summary = ReplaySummary()
    run = ReplayRun(chain, comparison, summary, truth_topics=())
    for record in watch(bag.records(inputs | outputs), bag):
        if record.topic in inputs:
            run.take(inputs[record.topic], record)
        if record.topic in outputs:
            comparison.add_recorded(outputs[record.topic], record.decode(), record.log_time_ns)
        if comparison.result.difference is not None:
            break
    else:
        comparison.finish()
    comparison.result.used.update(summary.inputs)
    comparison.result.notes += left_out + bag.problems
    return comparison.result


def _recorded_outputs(bag: Bag, chain: AdapterChain, namespace: str) -> dict[str, str]:
    """Name in the bag → relative name, of the outputs that are compared."""
    found = relative_topics(bag.topics, namespace)
    outputs = {}
    for output in chain.outputs:
        if output.topic in found and output.type_name not in ASIDE:
            name = found[output.topic]
            if lines := bag.differences.get(bag.topics[name]):
                raise BadInput(f"{bag.path}: topic '{name}': the message definition has changed: {'; '.join(lines)}")
            if bag.topics[name] != output.type_name:
                raise BadInput(f"{bag.path}: topic '{name}' is {bag.topics[name]}: expected {output.type_name}")
            outputs[name] = output.topic
    if not outputs:
        raise BadInput(f"{bag.path}: it holds no outputs of {chain.name}: there is nothing to verify")
    return outputs


class _Comparison:
    """Pairs what was recorded with what is replayed, per topic in order; takes a replay's outputs as a bag would."""

    def __init__(self, topics: set[str]) -> None:
        self.result = Verification()
        self._topics = topics
        self._recorded: defaultdict[str, deque[tuple[Any, int]]] = defaultdict(deque)
        self._replayed: defaultdict[str, deque[tuple[Any, int]]] = defaultdict(deque)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take what the replay gave."""
        if topic in self._topics:
            self._replayed[topic].append((message, log_time_ns))
            self._compare(topic)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """The truth is no output."""

    def add_recorded(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Take what was recorded."""
        self._recorded[topic].append((message, log_time_ns))
        self._compare(topic)

    def finish(self) -> None:
        """What is left over on one side only is a difference."""
        left = [
            (rest[0][1], topic, rest[0][0], values)
            for side, values in ((self._recorded, ("a message", "nothing")), (self._replayed, ("nothing", "a message")))
            for topic, rest in side.items()
            if rest
        ]
        if left and self.result.difference is None:
            time_ns, topic, message, (one, other) = min(left, key=lambda entry: entry[:2])
            self.result.difference = Difference(topic, stamp_of(message, time_ns), "", one, other)

    def _compare(self, topic: str) -> None:
        if self._recorded[topic] and self._replayed[topic]:
            recorded, time_ns = self._recorded[topic].popleft()
            replayed, _ = self._replayed[topic].popleft()
            difference = message_difference(topic, recorded, replayed, time_ns)
            if difference is None:
                self.result.equal[topic] += 1
            elif self.result.difference is None:
                self.result.difference = difference

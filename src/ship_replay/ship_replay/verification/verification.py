"""Comparison of a replay with recorded outputs to the last bit, for two messages and for a whole bag.

Messages are compared field by field. Numbers and names (strings without a space) must be equal. Texts that differ are
counted.
"""

import dataclasses
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, ProgressWrapper
from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_bags.stamps import ns_from_stamp, utc_text
from ship_bags.topic_names import relative_topics
from ship_node.adapters.adapter import Adapter
from ship_node.messages.common_messages import DIAGNOSTICS_TYPE
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain
from ship_replay.offline.outputs import DecodingSink
from ship_replay.offline.replay import match_inputs
from ship_replay.offline.replay_run import ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary

Value = str | npt.NDArray[Any]
"""A text, or an array; a number is an array without dimensions."""

UNCOMPARED_TYPES = DIAGNOSTICS_TYPE, "ship_msgs/msg/InputHealth"
"""Types of messages that are not compared: they also contain the state of the middleware."""


def values(message: Any, name: str = "") -> Iterator[tuple[str, Value]]:
    """Yield the dotted name and the value of each field; a sequence of messages or texts is preceded by its length.

    Args:
        message: message as rosbags decodes it, or a part of one.
        name: dotted name of the part, empty for a message.
    """
    if dataclasses.is_dataclass(message):
        for field in dataclasses.fields(message):
            if not field.name.startswith("__"):
                yield from values(getattr(message, field.name), f"{name}.{field.name}".lstrip("."))
    elif isinstance(message, list):
        yield f"{name} (length)", np.asarray(len(message))
        for i, element in enumerate(message):
            yield from values(element, f"{name}[{i}]")
    else:
        yield name, message if isinstance(message, str) else np.asarray(message)


def are_texts(one: object, other: object) -> bool:
    """True if both values are strings and at least one contains a space.

    Strings without a space are names of frames, sources or reasons. Names are compared like numbers.

    Example:
        >>> are_texts("late: 2 s", "late by 2 s"), are_texts("star.fore", "star.aft"), are_texts("1", 1)
        (True, False, False)
    """
    return isinstance(one, str) and isinstance(other, str) and " " in one + other


@dataclass(frozen=True)
class Difference:
    """A field in which a replayed and a recorded message differ, or a message that only replay or recording has.

    Attributes:
        topic: topic, service or file.
        stamp_ns: stamp of the message, or its time if it has no stamp.
        field: dotted name of the field; empty if the message is missing on one side.
        recorded: value in the bag.
        replayed: value in the replay.
        is_text: True if only the words of a text differ.
    """

    topic: str
    stamp_ns: int
    field: str
    recorded: str
    replayed: str
    is_text: bool = False

    @property
    def line(self) -> str:
        """The difference as text for the user."""
        field = f", field {self.field}" if self.field else ""
        when = f"{utc_text(self.stamp_ns)} ({self.stamp_ns} ns)"
        return f"{self.topic}, stamp {when}{field}: recorded {self.recorded}, replayed {self.replayed}"


def message_difference(topic: str, recorded: Any, replayed: Any, time_ns: int) -> Difference | None:
    """Return the first number or name in which two messages differ, or else the first text; None if they are equal.

    Args:
        topic: topic of both messages.
        recorded: message decoded from the bag.
        replayed: message of the replay, of the same type.
        time_ns: time of publication, for messages without a stamp.
    """
    # Both messages are serialised again: the bytes between the fields are not part of a message.
    one, other = serialize(recorded), serialize(replayed)
    if one == other:
        return None
    read = message_store().deserialize_cdr
    pair = read(one, recorded.__msgtype__), read(other, replayed.__msgtype__)
    found = list(_value_differences(topic, *pair, stamp_of(recorded, time_ns)))
    return next((difference for difference in found if not difference.is_text), found[0] if found else None)


def stamp_of(message: Any, time_ns: int) -> int:
    """Return the stamp of a message, ns; ``time_ns`` if it has no stamp."""
    header = getattr(message, "header", None)
    return time_ns if header is None else ns_from_stamp(header.stamp)


def _value_differences(topic: str, recorded: Any, replayed: Any, stamp_ns: int) -> Iterator[Difference]:
    """Yield the fields that differ, up to the first sequence with another length."""
    for (name, one), (_, other) in zip(values(recorded), values(replayed), strict=False):
        if isinstance(one, str) or isinstance(other, str):
            if one != other:
                yield Difference(topic, stamp_ns, name, repr(one), repr(other), is_text=are_texts(one, other))
        elif one.shape != other.shape:
            yield Difference(topic, stamp_ns, f"{name} (length)", str(one.size), str(other.size))
            return
        elif one.tobytes() != other.tobytes():
            index = next(i for i in np.ndindex(one.shape) if one[i].tobytes() != other[i].tobytes())
            field = f"{name}[{index[0]}]" if index else name
            yield Difference(topic, stamp_ns, field, repr(one[index].item()), repr(other[index].item()))
            if name.endswith("(length)"):
                return


@dataclass
class Verification:
    """Result of a comparison.

    Attributes:
        input_counts: input topic or kind of event → number of messages or events that the adapter received.
        equal_counts: output topic → number of messages whose numbers and names are equal to the last bit, before
            ``difference``.
        other_texts: output topic, service or file → number of messages, answers or contents that differ in texts only,
            before ``difference``.
        difference: first difference in a number or name; None if all are equal.
        text_difference: first difference in a text before ``difference``; None if there is none.
        notes: further lines for the user.
        incomplete_reason: reason for which a part of the bag could not be compared; empty if all was compared.
        is_truncated: True if the comparison is incomplete only because the file ends suddenly.
    """

    input_counts: Counter[str] = field(default_factory=Counter)
    equal_counts: Counter[str] = field(default_factory=Counter)
    other_texts: Counter[str] = field(default_factory=Counter)
    difference: Difference | None = None
    text_difference: Difference | None = None
    notes: list[str] = field(default_factory=list)
    incomplete_reason: str = ""
    is_truncated: bool = False

    @property
    def is_verified(self) -> bool:
        """True if no number or name differs and all was compared, at least up to the sudden end of the file."""
        return self.difference is None and (self.is_truncated or not self.incomplete_reason)

    def add(self, topic: str, difference: Difference | None) -> None:
        """Add the comparison of two messages.

        Args:
            topic: topic of both messages.
            difference: a number, name or text that differs; None if the messages are equal.
        """
        if difference is not None:
            self.add_difference(difference)
        if self.difference is None:
            self.equal_counts[topic] += 1

    def add_difference(self, difference: Difference) -> None:
        """Keep the first difference in a number or name; until then, count the differences in texts."""
        if not difference.is_text:
            self.difference = self.difference or difference
        elif self.difference is None:
            self.other_texts[difference.topic] += 1
            self.text_difference = self.text_difference or difference


def verify_bag(
    bag: Bag,
    adapter_classes: Sequence[type[Adapter]],
    config_path: Path | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
) -> Verification:
    """Compare the outputs of a replay with those recorded in a bag, up to the first different number or name.

    A recording contains neither the order in which the node used its inputs nor its service calls, so outputs may
    differ although the estimator is the same. With a black box a difference always comes from the computation.

    Args:
        bag: bag with inputs and outputs of one run.
        adapter_classes: adapter classes of the nodes that may take part, the main node first.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag.
        progress: function that wraps the iteration over the bag in a progress bar.

    Raises:
        BadInput: the bag, its topics or the configuration cannot be used, or the bag contains no outputs.
    """
    # As at sea, each node receives the recorded messages, including messages of other nodes.
    chain, left_out = suite_chain(bag, adapter_classes, RosbagsFactory(), config_path, namespace, linked=False)
    inputs = match_inputs(bag, chain, namespace)
    outputs = _recorded_outputs(bag, chain, namespace)
    comparison = _Comparison(set(outputs.values()))
    summary = ReplaySummary()
    run = ReplayRun(chain, comparison, summary, truth_topics=(), batch_size=1)
    for record in progress(bag.records(inputs | outputs), bag):
        if record.topic in inputs:
            run.process_message(inputs[record.topic], record)
        if record.topic in outputs:
            comparison.add_recorded(outputs[record.topic], record.decode(), record.log_time_ns)
        if comparison.result.difference is not None:
            break
    else:
        comparison.finish()
    comparison.result.input_counts.update(summary.inputs)
    comparison.result.notes += left_out + bag.problems
    return comparison.result


def _recorded_outputs(bag: Bag, chain: AdapterChain, namespace: str) -> dict[str, str]:
    """Return name in the bag → relative name, for the outputs that are compared.

    Topics with several publishers, such as ``/tf``, are not compared: a recording does not contain the publisher.
    """
    found = relative_topics(bag.topics, namespace)
    outputs = {}
    for output in chain.outputs:
        if output.topic in found and output.type_name not in UNCOMPARED_TYPES:
            name = found[output.topic]
            if lines := bag.differences.get(bag.topics[name]):
                raise BadInput(f"topic '{name}': the message definition has changed: {'; '.join(lines)}", file=bag.path)
            if bag.topics[name] != output.type_name:
                raise BadInput(f"topic '{name}' is {bag.topics[name]}: expected {output.type_name}", file=bag.path)
            outputs[name] = output.topic
    if not outputs:
        raise BadInput(f"no outputs of {chain.name} in this bag: there is nothing to verify", file=bag.path)
    return outputs


class _Comparison(DecodingSink):
    """Sink of a replay that compares the messages of each topic with the recorded messages, in order."""

    def __init__(self, topics: set[str]) -> None:
        self.result = Verification()
        self.topics = topics
        self._recorded: defaultdict[str, deque[tuple[Any, int]]] = defaultdict(deque)
        self._replayed: defaultdict[str, deque[tuple[Any, int]]] = defaultdict(deque)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a replayed message."""
        self._replayed[topic].append((message, log_time_ns))
        self._compare(topic)

    def add_recorded(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a recorded message."""
        self._recorded[topic].append((message, log_time_ns))
        self._compare(topic)

    def finish(self) -> None:
        """End the comparison: a message that only replay or recording has is a difference."""
        unmatched = []
        for side, found in ((self._recorded, ("a message", "nothing")), (self._replayed, ("nothing", "a message"))):
            for topic, rest in side.items():
                if rest:
                    message, time_ns = rest[0]
                    unmatched.append((time_ns, topic, Difference(topic, stamp_of(message, time_ns), "", *found)))
        if unmatched and self.result.difference is None:
            _, _, self.result.difference = min(unmatched, key=lambda entry: entry[:2])

    def _compare(self, topic: str) -> None:
        if self._recorded[topic] and self._replayed[topic]:
            recorded, time_ns = self._recorded[topic].popleft()
            replayed, _ = self._replayed[topic].popleft()
            self.result.add(topic, message_difference(topic, recorded, replayed, time_ns))

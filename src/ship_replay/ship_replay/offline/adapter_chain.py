"""Chain of the nodes of a suite in a replay: outputs of one node are inputs of later nodes at the same time.

The suite configuration, from a file or attached to the bag, determines which nodes take part.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_bags.errors import BadInput
from ship_bags.input_files import check_regular
from ship_bags.mcap.bag_reader import Bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_factory import MessageFactory
from ship_bags.parameter_yaml import full_name
from ship_bags.topic_names import relative_topics
from ship_node.adapters.adapter import Adapter
from ship_node.messages.inputs_outputs import (
    Arrival,
    Batch,
    BatchOutputs,
    Block,
    InputTopic,
    OutputTopic,
    PlacedMessages,
)
from ship_node.parameters.parameter_file import has_section, load_config, section_warning
from ship_node.saved_files.saved_document import READ_ONLY

_DEVICE_PREFIXES = "star/", "theodolite/", "beacon/"
"""Prefixes of device topics, next to occasional inputs. A node whose devices are all missing in a bag is not replayed.

The first configured node is an exception."""

_Forwarded = tuple[str, Any, int | None]

_NODE_BITS = 32
"""Number of low bits of an output's order that give the order within a node; higher bits give the node."""


def suite_text(bag: Bag, config_path: Path | None) -> str:
    """Return the text of the suite configuration from the file, or without a file from the bag's attachment."""
    if config_path is not None:
        try:
            check_regular(config_path)
            return config_path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            raise BadInput(f"cannot be read: {problem}", file=config_path) from problem
    if SUITE_ATTACHMENT not in bag.attachments:
        text = f"no configuration {SUITE_ATTACHMENT} is attached to the bag: give one by --config"
        raise BadInput(text, file=bag.path)
    return bag.attachments[SUITE_ATTACHMENT].decode("utf-8", errors="replace")


def suite_config(bag: Bag, adapter_class: type[Adapter], config_path: Path | None, node: str) -> Any:
    """Return the node's configuration from the file, or without a file from the bag's attachment.

    Args:
        bag: the bag.
        adapter_class: adapter of the node.
        config_path: file of the configuration; None for the bag's attachment.
        node: full name of the node, which selects sections (:mod:`ship_node.parameters.parameter_file`).

    Raises:
        BadInput: there is no configuration, or it does not fit this node; the text names the parameter.
    """
    if config_path is not None:
        return load_config(adapter_class.config_type, config_path, node)
    text = suite_text(bag, None)
    try:
        return load_config(adapter_class.config_type, text, node)
    except BadInput as problem:
        raise attachment_error(bag, problem) from problem


def suite_nodes(
    bag: Bag, adapter_classes: Sequence[type[Adapter]], config_path: Path | None, namespace: str = ""
) -> tuple[type[Adapter], ...]:
    """Return the nodes for which the configuration has sections; see :func:`nodes_of`.

    Args:
        bag: the bag.
        adapter_classes: known nodes, the main node first.
        config_path: file of the configuration; None for the bag's attachment.
        namespace: namespace of the nodes.

    Raises:
        BadInput: there is no configuration, it is not a parameter file, or a section nearly fits a node.
    """
    if config_path is not None:
        return _checked_nodes(config_path, adapter_classes, namespace)
    try:
        return _checked_nodes(suite_text(bag, None), adapter_classes, namespace)
    except BadInput as problem:
        raise attachment_error(bag, problem) from problem


def nodes_of(
    source: Path | str, adapter_classes: Sequence[type[Adapter]], namespace: str = ""
) -> tuple[type[Adapter], ...]:
    """Return the nodes of a namespace for which a configuration (a path, or the text itself) has sections.

    The first of the known nodes is the main node. The main node is also selected by a section for all nodes (``/**``),
    and if no other node has a section. Other nodes are selected only by sections with their names.

    Raises:
        BadInput: the configuration is not a parameter file.
    """
    main, *others = adapter_classes
    names = {kind: full_name(kind.node_name, namespace) for kind in adapter_classes}
    meant = [kind for kind in others if has_section(source, names[kind], wildcards=False)]
    if not meant or has_section(source, names[main]):
        meant.insert(0, main)
    return tuple(meant)


def _checked_nodes(
    source: Path | str, adapter_classes: Sequence[type[Adapter]], namespace: str
) -> tuple[type[Adapter], ...]:
    for kind in adapter_classes:
        # This call only checks for sections that nearly fit. A file need not have a section for every node.
        section_warning(source, full_name(kind.node_name, namespace))
    return nodes_of(source, adapter_classes, namespace)


def attachment_error(bag: Bag, problem: BadInput) -> BadInput:
    """Return an error about the suite configuration attached to a bag, as bad input that names the bag."""
    text = f"attachment {SUITE_ATTACHMENT}: {problem}"
    return BadInput(text, file=bag.path, parameters=problem.parameters, value=problem.value)


class AdapterChain:
    """Several adapters with the interface of a single adapter.

    Args:
        adapters: adapters in any order; the chain sorts them so that publishers come before their subscribers.
        linked: if true, outputs of an adapter are inputs of later adapters; otherwise all inputs come from outside.
        configs: node name → configuration of the node; may be omitted.

    Attributes:
        configs: node name → configuration of the node.
        input_topics: input topics of each adapter, from outside or from earlier adapters.
        linked: True if outputs of an adapter are inputs of later adapters.
        inputs: input topics from outside.
        outputs: output topics.
    """

    def __init__(
        self, adapters: Sequence[Adapter], linked: bool = True, configs: Mapping[str, Any] | None = None
    ) -> None:
        self.adapters = _sort_by_flow(adapters)
        self.configs = dict(configs or {})
        self.linked = linked
        self.input_topics = [_names(adapter.inputs) for adapter in self.adapters]
        self.outputs: tuple[OutputTopic, ...] = _first_by_topic(t for adapter in self.adapters for t in adapter.outputs)
        inside = _names(self.outputs) if linked else set()
        wanted = [t for adapter in self.adapters for t in adapter.inputs if t.topic not in inside]
        # Required topics come first: a topic is required if any adapter requires it.
        self.inputs: tuple[InputTopic, ...] = _first_by_topic(sorted(wanted, key=lambda topic: not topic.required))

    @property
    def name(self) -> str:
        """Names of the nodes."""
        return " and ".join(adapter.node_name for adapter in self.adapters)

    @property
    def block_topics(self) -> Set[str]:
        """Topics from outside whose messages a batch may contain as a block."""
        return set().union(*(adapter.block_topics for adapter in self.adapters)) & _names(self.inputs)

    def process(self, batch: Batch) -> BatchOutputs:
        """Let one node after another process a batch; a node receives the outputs of earlier nodes before its input.

        Arrivals of other topics, and messages without a content, are ignored. The places of the outputs are indices of
        the arrivals of the batch.
        """
        outputs = BatchOutputs()
        for node, (adapter, input_topics) in enumerate(zip(self.adapters, self.input_topics, strict=True)):
            of_node, places = _node_batch(batch, outputs if self.linked else BatchOutputs(), input_topics)
            if not of_node.arrivals:
                continue
            found, first_order = adapter.process(of_node), node << _NODE_BITS
            outputs.messages += [
                PlacedMessages(places[place], first_order + order, published)
                for place, order, published in found.messages
            ]
            outputs.blocks += [
                block._replace(places=np.array(places)[block.places], orders=first_order + block.orders)
                for block in found.blocks
            ]
        return outputs


def _node_batch(batch: Batch, outputs: BatchOutputs, input_topics: Set[str]) -> tuple[Batch, list[int]]:
    """Return the batch for a node, and the index in the whole batch of each arrival.

    Args:
        batch: the whole batch.
        outputs: outputs of earlier nodes.
        input_topics: input topics of the node.
    """
    forwarded, contents = _forwarded_messages(outputs, input_topics)
    contents |= {number: (block.topic, block.messages) for number, block in batch.blocks.items()}
    arrivals: list[Arrival] = []
    places: list[int] = []
    of_blocks: dict[int, list[int]] = {number: [] for number, (topic, _) in contents.items() if topic in input_topics}
    for place, arrival in enumerate(batch.arrivals):
        here = [arrival] if not arrival.topic or (arrival.topic in input_topics and not arrival.is_empty) else []
        if place in forwarded:
            outputs_here = forwarded[place]
            here = [arrival._replace(topic=topic, message=each, block=key) for topic, each, key in outputs_here] + here
        for one in here:
            if one.block is not None:
                of_blocks[one.block].append(len(arrivals))
            arrivals.append(one)
            places.append(place)
    blocks = {}
    for number, of_block in of_blocks.items():
        times_ns = np.array([arrivals[place].receive_ns for place in of_block])
        blocks[number] = Block(*contents[number], times_ns, np.array(of_block))
    return Batch(arrivals, blocks), places


def _forwarded_messages(
    outputs: BatchOutputs, input_topics: Set[str]
) -> tuple[dict[int, list[_Forwarded]], dict[int, tuple[str, CdrRows]]]:
    """Return messages of earlier nodes on the input topics.

    Returns:
        Place → messages in order, each with its topic and the key of its block or None; and the key of each block →
        its topic and its messages. The keys are negative.
    """
    if not (outputs.messages or outputs.blocks):
        return {}, {}
    found: list[tuple[int, int, _Forwarded]] = []
    for place, order, published in outputs.messages:
        found += [(place, order, (topic, message, None)) for topic, message in published if topic in input_topics]
    contents = {}
    for key, block in enumerate(outputs.blocks, -len(outputs.blocks)):
        if block.topic in input_topics:
            places_and_orders = zip(block.places.tolist(), block.orders.tolist(), strict=True)
            found += [(place, order, (block.topic, None, key)) for place, order in places_and_orders]
            contents[key] = block.topic, block.messages
    forwarded: dict[int, list[_Forwarded]] = defaultdict(list)
    for place, _, message in sorted(found, key=lambda each: each[:2]):
        forwarded[place].append(message)
    return forwarded, contents


def suite_chain(
    bag: Bag,
    adapter_classes: Sequence[type[Adapter]],
    factory: MessageFactory,
    config_path: Path | None = None,
    namespace: str = "",
    linked: bool = True,
) -> tuple[AdapterChain, list[str]]:
    """Return the chain of nodes of a suite configuration.

    A node whose devices are all missing in the bag is left out, unless it is the first configured node.

    Args:
        bag: the bag.
        adapter_classes: known nodes; see :func:`suite_nodes`.
        factory: factory for the messages of the nodes.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag and of its nodes.
        linked: see :class:`AdapterChain`.

    Returns:
        The chain, and one line for each node that is not replayed.

    Raises:
        BadInput: the configuration cannot be used.
    """
    configured = suite_nodes(bag, adapter_classes, config_path, namespace)
    found, adapters, configs, left_out = relative_topics(bag.topics, namespace), [], {}, []
    for kind in configured:
        config = suite_config(bag, kind, config_path, full_name(kind.node_name, namespace))
        adapter = kind(config, factory, READ_ONLY)
        devices = [t.topic for t in adapter.inputs if t.is_occasional or t.topic.startswith(_DEVICE_PREFIXES)]
        if kind is not configured[0] and not found.keys() & devices:
            wanted = ", ".join(devices) or "the devices that it needs"
            left_out.append(f"{kind.node_name} is not replayed: the bag has no {wanted}")
        else:
            adapters.append(adapter)
            configs[kind.node_name] = config
    return AdapterChain(adapters, linked, configs), left_out


def _sort_by_flow(adapters: Sequence[Adapter]) -> tuple[Adapter, ...]:
    """Sort the adapters so that each adapter comes after the adapters that publish its inputs, unless in a cycle."""
    ordered, rest = [], list(adapters)
    while rest:
        free = [
            adapter
            for adapter in rest
            if not any(_names(adapter.inputs) & _names(other.outputs) for other in rest if other is not adapter)
        ]
        ordered.append(free[0] if free else rest[0])
        rest.remove(ordered[-1])
    return tuple(ordered)


def _names(topics: Iterable[InputTopic | OutputTopic]) -> set[str]:
    return {topic.topic for topic in topics}


def _first_by_topic(topics: Any) -> tuple[Any, ...]:
    """Return the first entry of each topic."""
    first: dict[str, Any] = {}
    for topic in topics:
        first.setdefault(topic.topic, topic)
    return tuple(first.values())

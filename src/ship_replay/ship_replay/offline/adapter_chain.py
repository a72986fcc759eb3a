"""Chain of the nodes of a suite in a replay: outputs of one node are inputs of later nodes at the same time.

The suite configuration, from a file or attached to the bag, determines which nodes take part.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_factory import MessageFactory
from ship_bags.parameter_yaml import full_name
from ship_bags.regular_files import check_regular
from ship_bags.topic_names import relative_topics
from ship_node.adapters.adapter import Adapter
from ship_node.adapters.batch_adapter import BatchAdapter
from ship_node.messages.topics import InputTopic, OutputMessage, OutputTopic
from ship_node.parameters.parameter_file import has_section, load_config, section_warning
from ship_node.saved_files.saved_document import READ_ONLY

_DEVICE_PREFIXES = "star/", "theodolite/", "beacon/"
"""Prefixes of device topics, next to occasional inputs. A node whose devices are all missing in a bag is not replayed.

The first configured node is an exception."""


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

    def handle(self, topic: str, message: Any, receive_ns: int) -> list[OutputMessage]:
        """Process one message of an input topic."""
        return self._handle(0, topic, message, receive_ns)

    def block_topics(self) -> set[str]:
        """Return the topics from outside that an adapter can process in blocks."""
        return {
            topic
            for adapter, input_topics in zip(self.adapters, self.input_topics, strict=True)
            for topic in input_topics & _names(self.inputs)
            if isinstance(adapter, BatchAdapter) and (adapter.accepts_batches(topic) or adapter.can_read_rows(topic))
        }

    def tick(self, now_ns: int) -> list[OutputMessage]:
        """Tick all adapters in order; each has already received the outputs of earlier adapters at this tick."""
        published: list[OutputMessage] = []
        for index, adapter in enumerate(self.adapters):
            published += self._forward(index, adapter.tick(now_ns), now_ns)
        return published

    def _handle(self, first: int, topic: str, message: Any, receive_ns: int) -> list[OutputMessage]:
        published: list[OutputMessage] = []
        for index in range(first, len(self.adapters)):
            if topic in self.input_topics[index]:
                outputs = self.adapters[index].handle(topic, message, receive_ns)
                published += self._forward(index, outputs, receive_ns)
        return published

    def _forward(self, index: int, outputs: list[OutputMessage], now_ns: int) -> list[OutputMessage]:
        """Return an adapter's outputs, and the outputs of later adapters that result from these outputs."""
        published = list(outputs)
        if self.linked:
            for topic, message in outputs:
                published += self._handle(index + 1, topic, message, now_ns)
        return published


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

"""The nodes of a suite replayed together: what one gives is, at the same moment, an input of those after it.

The suite configuration, a file's or else the one attached to the bag, says which nodes take part.
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
from ship_node.documents.saved_document import UNTOUCHED
from ship_node.edge.adapter import Adapter
from ship_node.edge.block_adapter import BlockAdapter
from ship_node.edge.topics import InputTopic, OutputTopic, Published
from ship_node.parameters.parameter_file import has_section, load_config, misfit

_DEVICE_PREFIXES = "star/", "theodolite/", "beacon/"
"""How topics of devices begin, beside those that come at times. A node whose devices are all missing in a bag has
nothing to do."""


def suite_text(bag: Bag, config_path: Path | None) -> str:
    """Text of the suite configuration: the file's, else the one attached to the bag.

    Raises:
        BadInput: there is none, or the file cannot be read.
    """
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
    """The node's configuration: of the file, else of the one attached to the bag.

    Args:
        bag: the bag.
        adapter_class: of the node.
        config_path: configuration; None takes the one attached to the bag.
        node: its full name, by which sections fit (:mod:`ship_node.parameters.parameter_file`).

    Raises:
        BadInput: there is none, or it is not one of this node; names the parameter.
    """
    if config_path is not None:
        return load_config(adapter_class.config_type, config_path, node)
    text = suite_text(bag, None)
    try:
        return load_config(adapter_class.config_type, text, node)
    except BadInput as problem:
        raise attached(bag, problem) from problem


def suite_nodes(
    bag: Bag, adapter_classes: Sequence[type[Adapter]], config_path: Path | None, namespace: str = ""
) -> tuple[type[Adapter], ...]:
    """The nodes that the configuration is about; see :func:`nodes_of`.

    Args:
        bag: the bag.
        adapter_classes: nodes that are known, the main one first.
        config_path: configuration; None takes the one attached to the bag.
        namespace: of the nodes.

    Raises:
        BadInput: there is none, it is no parameter file, or one of its sections fits no node but was meant for one.
    """
    if config_path is not None:
        return _judged_nodes(config_path, adapter_classes, namespace)
    try:
        return _judged_nodes(suite_text(bag, None), adapter_classes, namespace)
    except BadInput as problem:
        raise attached(bag, problem) from problem


def nodes_of(
    source: Path | str, adapter_classes: Sequence[type[Adapter]], namespace: str = ""
) -> tuple[type[Adapter], ...]:
    """The nodes in a namespace that a configuration (a path, or the text itself) is about.

    The first of those known is the main one: a section for all nodes (``/**``) is its too, and it is meant where no
    node is named at all. The others must be named.

    Raises:
        BadInput: it is no parameter file.
    """
    main, *others = adapter_classes
    names = {kind: full_name(kind.node_name, namespace) for kind in adapter_classes}
    meant = [kind for kind in others if has_section(source, names[kind], wildcards=False)]
    if not meant or has_section(source, names[main]):
        meant.insert(0, main)
    return tuple(meant)


def _judged_nodes(
    source: Path | str, adapter_classes: Sequence[type[Adapter]], namespace: str
) -> tuple[type[Adapter], ...]:
    for kind in adapter_classes:
        # That a file says nothing of some nodes is no fault of it.
        misfit(source, full_name(kind.node_name, namespace))
    return nodes_of(source, adapter_classes, namespace)


def attached(bag: Bag, problem: BadInput) -> BadInput:
    """What is wrong with the suite configuration attached to a bag, as bad input that names the bag."""
    text = f"attachment {SUITE_ATTACHMENT}: {problem}"
    return BadInput(text, file=bag.path, parameters=problem.parameters, value=problem.value)


class AdapterChain:
    """Several adapters that take messages and ticks like one.

    Args:
        adapters: in any order: data flows from those that give a topic to those that take it.
        linked: whether what one gives goes to those after it; otherwise all inputs come from outside.
        configs: node name → its configuration; none where nobody asks for it.

    Attributes:
        configs: the same.
        taken: topics that each adapter takes, from outside or from those before it.
        linked: whether what one gives goes to those after it.
        inputs: topics taken from outside.
        outputs: topics given.
    """

    def __init__(
        self, adapters: Sequence[Adapter], linked: bool = True, configs: Mapping[str, Any] | None = None
    ) -> None:
        self.adapters = _in_order_of_flow(adapters)
        self.configs = dict(configs or {})
        self.linked = linked
        self.taken = [_names(adapter.inputs) for adapter in self.adapters]
        self.outputs: tuple[OutputTopic, ...] = _by_topic(t for adapter in self.adapters for t in adapter.outputs)
        inside = _names(self.outputs) if linked else set()
        wanted = [t for adapter in self.adapters for t in adapter.inputs if t.topic not in inside]
        # The first of equals wins: a topic is required if any adapter requires it.
        self.inputs: tuple[InputTopic, ...] = _by_topic(sorted(wanted, key=lambda topic: not topic.required))

    @property
    def name(self) -> str:
        """Names of the nodes."""
        return " and ".join(adapter.node_name for adapter in self.adapters)

    def handle(self, topic: str, message: Any, receive_ns: int) -> list[Published]:
        """Take one message of an input topic."""
        return self._handle(0, topic, message, receive_ns)

    def topics_in_blocks(self) -> set[str]:
        """Topics from outside of which an adapter can take many messages at once."""
        return {
            topic
            for adapter, taken in zip(self.adapters, self.taken, strict=True)
            for topic in taken & _names(self.inputs)
            if isinstance(adapter, BlockAdapter) and (adapter.takes_blocks(topic) or adapter.reads_rows(topic))
        }

    def tick(self, now_ns: int) -> list[Published]:
        """Tick all adapters; each has then been given what those before it gave at this tick."""
        published: list[Published] = []
        for index, adapter in enumerate(self.adapters):
            published += self._passed_on(index, adapter.tick(now_ns), now_ns)
        return published

    def _handle(self, first: int, topic: str, message: Any, receive_ns: int) -> list[Published]:
        published: list[Published] = []
        for index in range(first, len(self.adapters)):
            if topic in self.taken[index]:
                given = self.adapters[index].handle(topic, message, receive_ns)
                published += self._passed_on(index, given, receive_ns)
        return published

    def _passed_on(self, index: int, given: list[Published], now_ns: int) -> list[Published]:
        """What an adapter gave, and what the adapters after it made of that."""
        published = list(given)
        if self.linked:
            for topic, message in given:
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
    """The nodes that a suite configuration is about, without those that have nothing to do with the bag.

    Args:
        bag: the bag.
        adapter_classes: nodes that are known; see :func:`suite_nodes`.
        factory: makes their messages.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag, and so of its nodes.
        linked: see :class:`AdapterChain`.

    Returns:
        The chain, and one line for each node that was left out.

    Raises:
        BadInput: the configuration does not serve.
    """
    meant = suite_nodes(bag, adapter_classes, config_path, namespace)
    found, adapters, configs, left_out = relative_topics(bag.topics, namespace), [], {}, []
    for kind in meant:
        config = suite_config(bag, kind, config_path, full_name(kind.node_name, namespace))
        adapter = kind(config, factory, UNTOUCHED)
        devices = [t.topic for t in adapter.inputs if t.at_times or t.topic.startswith(_DEVICE_PREFIXES)]
        if kind is not meant[0] and not found.keys() & devices:
            wanted = ", ".join(devices) or "the devices that it needs"
            left_out.append(f"{kind.node_name} is left out: the bag has nothing of {wanted}")
        else:
            adapters.append(adapter)
            configs[kind.node_name] = config
    return AdapterChain(adapters, linked, configs), left_out


def _in_order_of_flow(adapters: Sequence[Adapter]) -> tuple[Adapter, ...]:
    """The adapters in an order in which each stands after those that give it something."""
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


def _by_topic(topics: Any) -> tuple[Any, ...]:
    """The first of each topic."""
    first: dict[str, Any] = {}
    for topic in topics:
        first.setdefault(topic.topic, topic)
    return tuple(first.values())

"""The nodes of a suite replayed together: what one gives is, at the same moment, an input of those after it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ship_node.adapter import Adapter
from ship_node.message_factory import MessageFactory
from ship_node.topics import InputTopic, OutputTopic, Published
from ship_replay.bag_reader import Bag
from ship_replay.bag_suite import suite_config, suite_nodes
from ship_replay.topic_names import relative_topics

_DEVICE_PREFIX = "star/"
"""Topics of star sensors: without any of its own a node has nothing to do."""


class AdapterChain:
    """Several adapters that take messages and ticks like one.

    Args:
        adapters: in the order in which data flows.
        linked: whether what one gives goes to those after it; otherwise all inputs come from outside.

    Attributes:
        inputs: topics taken from outside.
        outputs: topics given.
    """

    def __init__(self, adapters: Sequence[Adapter], linked: bool = True) -> None:
        self.adapters = tuple(adapters)
        self._linked = linked
        self._taken = [{topic.topic for topic in adapter.inputs} for adapter in adapters]
        self.outputs: tuple[OutputTopic, ...] = _by_topic(topic for adapter in adapters for topic in adapter.outputs)
        inside = {topic.topic for topic in self.outputs} if linked else set()
        wanted = [topic for adapter in adapters for topic in adapter.inputs if topic.topic not in inside]
        # The first of equals wins: a topic is required if any adapter requires it.
        self.inputs: tuple[InputTopic, ...] = _by_topic(sorted(wanted, key=lambda topic: not topic.required))

    @property
    def name(self) -> str:
        """Names of the nodes."""
        return " and ".join(adapter.node_name for adapter in self.adapters)

    def handle(self, topic: str, message: Any, receive_ns: int) -> list[Published]:
        """Take one message of an input topic."""
        return self._handle(0, topic, message, receive_ns)

    def tick(self, now_ns: int) -> list[Published]:
        """Tick all adapters, each after it was given what those before it had to give."""
        published: list[Published] = []
        for index, adapter in enumerate(self.adapters):
            published += self._passed_on(index, adapter.tick(now_ns), now_ns)
        return published

    def _handle(self, first: int, topic: str, message: Any, receive_ns: int) -> list[Published]:
        published: list[Published] = []
        for index in range(first, len(self.adapters)):
            if topic in self._taken[index]:
                given = self.adapters[index].handle(topic, message, receive_ns)
                published += self._passed_on(index, given, receive_ns)
        return published

    def _passed_on(self, index: int, given: list[Published], now_ns: int) -> list[Published]:
        """What an adapter gave, and what came of it in those after it."""
        published = list(given)
        if self._linked:
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
    """The nodes that a suite configuration is about, those left out that have nothing to do with the bag.

    Args:
        bag: the bag.
        adapter_classes: nodes that are known, in the order in which data flows; see :func:`suite_nodes`.
        factory: makes their messages.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        linked: see :class:`AdapterChain`.

    Returns:
        The chain, and one line for each node that was left out.

    Raises:
        BadInput: the configuration does not serve.
    """
    meant = suite_nodes(bag, adapter_classes, config_path)
    found, adapters, left_out = relative_topics(bag.topics, namespace), [], []
    for kind in meant:
        adapter = kind(suite_config(bag, kind, config_path), factory)
        devices = [topic.topic for topic in adapter.inputs if topic.topic.startswith(_DEVICE_PREFIX)]
        if kind is not meant[-1] and not found.keys() & devices:
            wanted = ", ".join(devices) or "star sensors"
            left_out.append(f"{kind.node_name} is left out: the bag has nothing of {wanted}")
        else:
            adapters.append(adapter)
    return AdapterChain(adapters, linked), left_out


def _by_topic(topics: Any) -> tuple[Any, ...]:
    """The first of each topic."""
    first: dict[str, Any] = {}
    for topic in topics:
        first.setdefault(topic.topic, topic)
    return tuple(first.values())

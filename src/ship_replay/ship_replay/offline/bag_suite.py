"""The suite configuration that belongs to a bag: a file's, else the one attached to it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.parameter_yaml import full_name
from ship_node.edge.adapter import Adapter
from ship_node.parameters.parameter_file import has_section, load_config, misfit


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
        raise _attached(bag, problem) from problem


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
        raise _attached(bag, problem) from problem


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


def _attached(bag: Bag, problem: BadInput) -> BadInput:
    return BadInput(f"{bag.path}: attachment {SUITE_ATTACHMENT}: {problem}")

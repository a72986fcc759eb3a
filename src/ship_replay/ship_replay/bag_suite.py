"""The suite configuration that belongs to a bag: a file's, else the one attached to it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ship_node.adapter import Adapter
from ship_node.parameter_file import has_section, load_config
from ship_replay.bag_reader import Bag
from ship_replay.bag_writer import SUITE_ATTACHMENT
from ship_replay.errors import BadInput


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
        raise _attached(bag, problem) from problem


def suite_nodes(
    bag: Bag, adapter_classes: Sequence[type[Adapter]], config_path: Path | None
) -> tuple[type[Adapter], ...]:
    """The nodes that the configuration is about; see :func:`nodes_of`.

    Args:
        bag: the bag.
        adapter_classes: nodes that are known, the main one first.
        config_path: configuration; None takes the one attached to the bag.

    Raises:
        BadInput: there is none, or it is no parameter file.
    """
    if config_path is not None:
        return nodes_of(config_path, adapter_classes)
    try:
        return nodes_of(suite_text(bag, None), adapter_classes)
    except BadInput as problem:
        raise _attached(bag, problem) from problem


def nodes_of(source: Path | str, adapter_classes: Sequence[type[Adapter]]) -> tuple[type[Adapter], ...]:
    """The nodes that a configuration (a path, or the text itself) is about.

    The first of those known is the main one: a section for all nodes (``/**``) is its too, and it is meant where no
    node is named at all. The others must be named.

    Raises:
        BadInput: it is no parameter file.
    """
    main, *others = adapter_classes
    meant = [kind for kind in others if has_section(source, kind.node_name, wildcards=False)]
    if not meant or has_section(source, main.node_name):
        meant.insert(0, main)
    return tuple(meant)


def _attached(bag: Bag, problem: BadInput) -> BadInput:
    return BadInput(f"{bag.path}: attachment {SUITE_ATTACHMENT}: {problem}")

"""Check that a black box can be replayed here: format, node, versions, parameters and message definitions."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.message_store import message_store, serialize
from ship_bags.parameter_yaml import full_name, in_any_namespace
from ship_bags.provenance import versions
from ship_estimation.parameters.schema import build, flatten, nest
from ship_node.adapters.adapter import Adapter
from ship_node.black_box.black_box_format import EVENTS_TOPIC, FORMAT, METADATA, VERSIONS_ATTACHMENT
from ship_node.parameters.parameter_file import read_matching_sections, read_node_parameters
from ship_replay.offline.adapter_chain import suite_config, suite_text
from ship_replay.verification.verification import UNCOMPARED_TYPES

_OFF_VALUES = {"alignment_autosave_s": 0.0, "accept_unset_covariance": True}
"""Last part of the name of a parameter introduced after the first black boxes → value for the former behaviour."""
_RATE_COVARIANCE_PARAMETER = "ins.accept_unset_covariance"
"""Parameter introduced together with the covariance of the rates in ``ship/imu``."""


def is_black_box(bag: Bag) -> bool:
    """True if a bag was written by a node's black box."""
    return METADATA in bag.metadata or EVENTS_TOPIC in bag.topics


def black_box_adapter(bag: Bag, adapters: Iterable[type[Adapter]]) -> type[Adapter]:
    """Return the adapter of the node that wrote a black box.

    Raises:
        BadInput: the metadata are missing, the format or the node is not known here, or the file is not the first part.
    """
    if METADATA not in bag.metadata:
        raise BadInput(f"metadata record '{METADATA}' is missing: the head of the black box is damaged", file=bag.path)
    entries = bag.metadata[METADATA]
    if entries.get("format") != FORMAT:
        raise BadInput(
            f"version {entries.get('format')} of the black box: expected {FORMAT}; "
            "replay it with the release of the suite that wrote it",
            file=bag.path,
        )
    part = entries.get("part", "1")
    if part != "1":
        text = f"part {part} of a black box: give its first file, {entries.get('first')}, with all parts in its folder"
        raise BadInput(text, file=bag.path)
    known = {adapter.node_name: adapter for adapter in adapters}
    if entries.get("node") not in known:
        raise BadInput(
            f"black box of node '{entries.get('node')}': expected one of {', '.join(sorted(known))}",
            file=bag.path,
        )
    return known[entries["node"]]


def black_box_config(bag: Bag, adapter_class: type[Adapter], config_path: Path | None, notes: list[str]) -> Any:
    """Return the configuration for the replay, from the black box or from a file; a file adds a line to ``notes``.

    Raises:
        BadInput: the black box is of another version of the suite or lacks an attachment, and no file was given. Also
            if the attachment of the versions cannot be read, or if the parameters do not fit this node.
    """
    _check_versions(bag, adapter_class, config_path, notes)
    name = adapter_class.node_name
    # The parameters in the black box fit in any namespace; a file must fit the node's full name.
    node = (
        in_any_namespace(name) if config_path is None else full_name(name, bag.metadata[METADATA].get("namespace", ""))
    )
    config = _without_later_parameters(suite_config(bag, adapter_class, config_path, node), bag, node, config_path)
    if config_path is not None:
        changes = _parameter_changes(bag, config, adapter_class)
        notes.append(f"replayed with {config_path} instead of the black box's own parameters{changes}")
    return config


def older_message_converters(bag: Bag) -> dict[str, Callable[[Any], Any]]:
    """Return output topic → function that converts a message to the black box's release; empty if none is needed."""
    own = _recorded_parameters(bag)
    return {"ship/imu": _without_rate_covariance} if own and _RATE_COVARIANCE_PARAMETER not in own else {}


def check_definitions(bag: Bag) -> None:
    """Check that the definitions of all compared messages are the same here.

    Raises:
        BadInput: a definition differs, and the text names the fields; or a topic cannot be read.
    """
    for topic, type_name in sorted(bag.topics.items()):
        if type_name not in UNCOMPARED_TYPES and type_name in bag.differences:
            lines = "; ".join(bag.differences[type_name])
            raise BadInput(f"topic '{topic}': the message definition has changed: {lines}", file=bag.path)
    for topic, why in sorted(bag.skipped_topics.items()):
        raise BadInput(f"topic '{topic}' is unusable: {why}", file=bag.path)


def check_topics(bag: Bag, adapter: Adapter, notes: list[str], other_config: bool) -> None:
    """Check that all topics of the black box are topics of the adapter, with the same types.

    Raises:
        BadInput: a topic is not a topic of the adapter; with another configuration, ``notes`` gets a line instead.
    """
    expected = {topic.topic: topic.type_name for topic in adapter.inputs}
    expected |= {topic.topic: topic.type_name for topic in adapter.outputs}
    for topic, type_name in sorted(bag.topics.items()):
        if topic == EVENTS_TOPIC or type_name in UNCOMPARED_TYPES or expected.get(topic) == type_name:
            continue
        text = f"topic '{topic}' ({type_name}) is not a topic of {adapter.node_name} with these parameters"
        if not other_config:
            raise BadInput(f"{text}: if it was written with other parameters, give them by --config", file=bag.path)
        notes.append(f"{text}: ignored")


def _check_versions(bag: Bag, adapter_class: type[Adapter], config_path: Path | None, notes: list[str]) -> None:
    here = versions(adapter_class.__module__.partition(".")[0], {})
    if VERSIONS_ATTACHMENT not in bag.attachments:
        _raise_or_note(bag, f"attachment {VERSIONS_ATTACHMENT} is missing", config_path, notes)
        return
    try:
        there = json.loads(bag.attachments[VERSIONS_ATTACHMENT])
        suite, others = dict(there["suite"]), {key: there[key] for key in ("python", "machine", "libraries")}
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(f"attachment {VERSIONS_ATTACHMENT} cannot be read: {error!r}", file=bag.path) from error
    if differing := _version_differences(suite, here["suite"]):
        _raise_or_note(bag, f"written by another version of the suite ({differing})", config_path, notes)
    if differing := _version_differences(others, {key: here[key] for key in others}):
        notes.append(f"written elsewhere ({differing}): the last bits may differ")


def _without_later_parameters(config: Any, bag: Bag, node: str, config_path: Path | None) -> Any:
    """Return the configuration; functions unknown to the release that wrote the black box are switched off.

    A black box contains all parameters of its node, defaults included, so a missing parameter was unknown to this
    release. A file may still set such a parameter.
    """
    known = _recorded_parameters(bag) | (
        set() if config_path is None else set(read_node_parameters(config_path, node).lines)
    )
    values = flatten(config)
    off = {
        name: _OFF_VALUES[last]
        for name in values
        if (last := name.rpartition(".")[2]) in _OFF_VALUES and name not in known
    }
    return build(type(config), nest(values | off)) if off else config


def _recorded_parameters(bag: Bag) -> set[str]:
    """Return dotted names of the parameters in the black box and of their groups; empty without the attachment."""
    if SUITE_ATTACHMENT not in bag.attachments:
        return set()
    return set(read_matching_sections(suite_text(bag, None), in_any_namespace(bag.metadata[METADATA]["node"])).lines)


def _without_rate_covariance(message: Any) -> Any:
    """Return a sensor_msgs/Imu whose covariance of the rates, if positive, is replaced by zeros."""
    imu: Any = message_store().deserialize_cdr(serialize(message), message.__msgtype__)
    if imu.angular_velocity_covariance[0] > 0.0:
        imu.angular_velocity_covariance = np.zeros(9)
    return imu


def _raise_or_note(bag: Bag, text: str, config_path: Path | None, notes: list[str]) -> None:
    if config_path is None:
        raise BadInput(f"{text}: give the parameters by --config FILE to replay it nevertheless", file=bag.path)
    notes.append(text)


def _version_differences(there: dict[str, Any], here: dict[str, Any]) -> str:
    names = sorted(there.keys() | here.keys())
    return ", ".join(
        f"{name} {there.get(name)} there, {here.get(name)} here" for name in names if there.get(name) != here.get(name)
    )


def _parameter_changes(bag: Bag, config: Any, adapter_class: type[Adapter]) -> str:
    """Return the parameters that differ from those in the black box, as text; empty if the black box has none."""
    try:
        own, now = (
            flatten(suite_config(bag, adapter_class, None, in_any_namespace(adapter_class.node_name))),
            flatten(config),
        )
    except BadInput:
        return ""
    names = sorted(name for name in own.keys() | now.keys() if own.get(name) != now.get(name))
    return ": " + (", ".join(f"{name} = {now.get(name)}, was {own.get(name)}" for name in names) or "the same values")

"""Says before the voyage what a suite configuration lacks, and what of it does not fit a bag."""

import copy
import dataclasses
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ship_attitude_star.config import ShipAttitudeConfig
from ship_attitude_star.device_config import MountingConfig
from ship_attitude_star.star_attitude_config import StarAttitudeConfig
from ship_estimation.parameters import ParameterDescription, ParameterError, build, describe
from ship_node.adapter import Adapter
from ship_node.errors import BadInput as BadNodeInput
from ship_node.parameter_file import ParameterFile, read
from ship_replay.bag_reader import Bag
from ship_replay.bag_suite import nodes_of
from ship_replay.message_store import RosbagsFactory
from ship_replay.topic_names import likely_namespace, relative_topics

_INS_TOPIC = "ins/imu"
_SENSOR_TOPIC = re.compile(
    r"(?P<group>star|reference)/(?P<name>[^/]+)/(horizon_attitude|inertial_attitude|observations|solution|imu)"
)
_GROUPS = {"star": "star_sensors", "reference": "references"}


@dataclass
class Findings:
    """What was found.

    Attributes:
        errors: one line each: with these the node would not start, or would refuse what the bag holds.
        warnings: one line each: probably not meant so.
    """

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass
class CheckedNode:
    """A node of a configuration, wrong values replaced by allowed ones for the checks that follow.

    Attributes:
        file: its parameters in the file.
        config: its configuration.
        adapter: its adapter.
    """

    file: ParameterFile
    config: Any
    adapter: Adapter


def check_file(path: Path, adapter_classes: Sequence[type[Adapter]], findings: Findings) -> list[CheckedNode]:
    """Check the parameters of a file, all of them.

    Args:
        path: the file.
        adapter_classes: nodes that are known; see :func:`nodes_of`.
        findings: takes what is found.

    Returns:
        The nodes that the file is about and that can be made by it.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    checked = (_checked(path, kind, findings) for kind in nodes_of(path, adapter_classes))
    nodes = [node for node in checked if node is not None]
    findings.warnings += list(_different_mountings(path, nodes))
    return nodes


def _checked(path: Path, adapter_class: type[Adapter], findings: Findings) -> CheckedNode | None:
    kind = adapter_class.config_type
    file = read(path, adapter_class.node_name)
    values = copy.deepcopy(file.values)
    descriptions = list(describe(kind))
    while True:
        try:
            config = build(kind, values)
            break
        except ParameterError as problem:
            findings.errors.append(str(file.error(str(problem))))
            if not _put_right(values, str(problem), descriptions):
                return None
    if isinstance(config, ShipAttitudeConfig) and not config.star_sensors and not config.references:
        findings.warnings.append(f"{path}: no star_sensors and no references: the attitude will be the INS's alone")
    if isinstance(config, StarAttitudeConfig) and not config.star_sensors:
        findings.warnings.append(f"{path}: no star_sensors: {adapter_class.node_name} has nothing to solve")
    try:
        return CheckedNode(file, config, adapter_class(config, RosbagsFactory()))
    except ParameterError as problem:
        findings.errors.append(str(file.error(str(problem))))
    except BadNodeInput as problem:
        findings.errors.append(f"{path}: {problem}")
    return None


def _different_mountings(path: Path, nodes: Sequence[CheckedNode]) -> Iterator[str]:
    """Sensors that two nodes take to be bolted elsewhere, or to be known otherwise."""
    names = [field.name for field in dataclasses.fields(MountingConfig) if field.name != "frame_id"]
    sensors = [(node, id_, star) for node in nodes for id_, star in getattr(node.config, "star_sensors", {}).items()]
    for (node, id_, star), (other, other_id, other_star) in itertools.combinations(sensors, 2):
        for name in names if id_ == other_id else ():
            one, two = getattr(star, name), getattr(other_star, name)
            if one != two:
                line = other.file.line_of(f"star_sensors.{id_}.{name}")
                yield (
                    f"{path}:{line}: parameter 'star_sensors.{id_}.{name}' is {two!r} for "
                    f"{other.adapter.node_name}, but {one!r} for {node.adapter.node_name}"
                )


def check_bag(path: Path, nodes: Sequence[CheckedNode], bag: Bag, namespace: str, findings: Findings) -> None:
    """Check a configuration against the topics of a bag: presence, type, definition, frame_id.

    Args:
        path: file of the configuration.
        nodes: what it is about.
        bag: a bag recorded with the sensors of the voyage.
        namespace: namespace of the ship in the bag.
        findings: takes what is found.
    """
    found = relative_topics(bag.topics, namespace)
    given = {topic.topic for node in nodes for topic in node.adapter.outputs}
    for node in nodes:
        _check_inputs(path, node, bag, found, given, findings)
    taken = {topic.topic for node in nodes for topic in node.adapter.inputs}
    findings.warnings += list(_not_configured([node.config for node in nodes], bag, found, taken | given))
    findings.warnings += bag.problems


def _check_inputs(
    path: Path, node: CheckedNode, bag: Bag, found: dict[str, str], given: set[str], findings: Findings
) -> None:
    """Check what a node takes from a bag; ``given`` are topics that some node gives itself."""
    readable: dict[str, str] = {}
    for topic in node.adapter.inputs:
        place = _place(node.file, path, topic.topic)
        if topic.topic not in found:
            if topic.topic in given:
                continue
            hint = likely_namespace(bag.topics, [topic.topic])
            advice = f" (there is one under the namespace '{hint}')" if hint else ""
            where = findings.errors if topic.required else findings.warnings
            where.append(f"{place}: topic '{topic.topic}' is not in {bag.path}{advice}")
            continue
        type_name = bag.topics[found[topic.topic]]
        if type_name != topic.type_name:
            findings.errors.append(
                f"{place}: topic '{topic.topic}' in {bag.path} is {type_name}: expected {topic.type_name}"
            )
            continue
        findings.errors += [f"{bag.path}: topic '{topic.topic}': {line}" for line in bag.differences.get(type_name, [])]
        if type_name not in bag.differences:
            readable[topic.topic] = found[topic.topic]
    findings.errors += _frame_errors(path, node, bag, readable)


def _frame_errors(path: Path, node: CheckedNode, bag: Bag, readable: dict[str, str]) -> Iterator[str]:
    """Messages that would be refused because their frame_id is not the configured one."""
    expected = {topic: _frame_id(node.config, topic) for topic in readable}
    waiting = {readable[topic]: topic for topic, frame in expected.items() if frame}
    for record in bag.records(waiting) if waiting else ():
        topic = waiting.pop(record.topic, None)
        if topic is not None:
            frame = record.decode().header.frame_id
            if frame != expected[topic]:
                name = f"{_section(topic)}.frame_id"
                yield (
                    f"{_place(node.file, path, topic, 'frame_id')}: parameter '{name}' = '{expected[topic]}', but "
                    f"topic '{topic}' in {bag.path} carries frame_id '{frame}'"
                )
        if not waiting:
            break


def _frame_id(config: Any, topic: str) -> str:
    """The frame_id that messages of an input topic must carry; empty for any."""
    if topic == _INS_TOPIC:
        return str(config.ins.frame_id)
    group, *rest = topic.split("/")
    return str(getattr(config, _GROUPS[group])[rest[0]].frame_id) if group in _GROUPS else ""


def _not_configured(configs: Sequence[Any], bag: Bag, found: dict[str, str], known: set[str]) -> Iterator[str]:
    """Sensors in the bag that the configuration does not use."""
    for topic in sorted(found.keys() - known):
        match = _SENSOR_TOPIC.fullmatch(topic)
        if match is None:
            continue
        name, group = match["name"], _GROUPS[match["group"]]
        if not any(name in getattr(config, group, {}) for config in configs):
            yield f"{bag.path}: topic '{topic}' has no {group}.{name} in the configuration: not used"
        elif group == "star_sensors" and not any(t.startswith(f"star/{name}/") for t in known & found.keys()):
            yield f"{bag.path}: topic '{topic}' is not used: star_sensors.{name}.input is another"


def _section(topic: str) -> str:
    """Dotted name of the parameters about an input topic."""
    group, *rest = topic.split("/")
    return f"{_GROUPS[group]}.{rest[0]}" if group in _GROUPS else group


def _place(file: ParameterFile, path: Path, topic: str, parameter: str = "") -> str:
    """File and line that speak of an input topic."""
    line = file.line_of(f"{_section(topic)}.{parameter}".rstrip("."))
    return f"{path}:{line}" if line else str(path)


def _put_right(values: dict[str, Any], problem: str, descriptions: list[ParameterDescription]) -> bool:
    """Take the value that a problem names out, and put an allowed one in where there must be one.

    Returns:
        Whether anything changed: if not, the same problem would come again.
    """
    quoted = re.search(r"'([^'\[]+)", problem)
    if quoted is None:
        return False
    *groups, leaf = quoted[1].split(".")
    level = values
    for group in groups:
        level = level.setdefault(group, {})
    removed = level.pop(leaf, None) is not None
    for description in descriptions:
        pattern = re.escape(description.name).replace("<id>", r"[^.]+")
        if description.default is None and re.fullmatch(pattern, quoted[1]):
            level[leaf] = _allowed(description)
            return True
    return removed


def _allowed(description: ParameterDescription) -> Any:
    if description.choices:
        return description.choices[0]
    if description.kind in (int, float):
        low, high = description.minimum, description.maximum
        return description.kind(min(max(0.0, -1e300 if low is None else low), 1e300 if high is None else high))
    return description.kind()

"""Says before the voyage what a suite configuration lacks, and what of it does not fit a bag."""

import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_attitude_star.config import ShipAttitudeConfig
from ship_estimation.parameters import ParameterDescription, ParameterError, build, describe
from ship_node.errors import BadInput as BadNodeInput
from ship_node.parameter_file import ParameterFile, read
from ship_replay.bag_reader import Bag
from ship_replay.message_store import RosbagsFactory
from ship_replay.topic_names import likely_namespace, relative_topics

_INS_TOPIC = "ins/imu"
_SENSOR_TOPIC = re.compile(r"(?P<group>star|reference)/(?P<name>[^/]+)/(?P<input>horizon_attitude|solution|imu)")
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


def check_file(path: Path, findings: Findings) -> ShipAttitudeConfig | None:
    """Check the parameters of a file, all of them.

    Returns:
        The configuration with wrong values replaced by allowed ones, for the checks that follow; None where that
        cannot be had.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    file = read(path, ShipAttitudeAdapter.node_name)
    values = copy.deepcopy(file.values)
    descriptions = list(describe(ShipAttitudeConfig))
    while True:
        try:
            config = build(ShipAttitudeConfig, values)
            break
        except ParameterError as problem:
            findings.errors.append(str(file.error(str(problem))))
            if not _put_right(values, str(problem), descriptions):
                return None
    if not config.star_sensors and not config.references:
        findings.warnings.append(f"{path}: no star_sensors and no references: the attitude will be the INS's alone")
    return config


def check_bag(path: Path, config: ShipAttitudeConfig, bag: Bag, namespace: str, findings: Findings) -> None:
    """Check a configuration against the topics of a bag: presence, type, definition, frame_id.

    Args:
        path: file of the configuration.
        config: the configuration.
        bag: a bag recorded with the sensors of the voyage.
        namespace: namespace of the ship in the bag.
        findings: takes what is found.
    """
    file = read(path, ShipAttitudeAdapter.node_name)
    try:
        adapter = ShipAttitudeAdapter(config, RosbagsFactory())
    except BadNodeInput as problem:
        findings.errors.append(f"{path}: {problem}")
        return
    found = relative_topics(bag.topics, namespace)
    readable: dict[str, str] = {}
    for topic in adapter.inputs:
        place = _place(file, path, topic.topic)
        if topic.topic not in found:
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
    findings.errors += _frame_errors(path, file, config, bag, readable)
    configured = {topic.topic for topic in adapter.inputs}
    findings.warnings += list(_not_configured(config, bag, found, configured))
    findings.warnings += bag.problems


def _frame_errors(
    path: Path, file: ParameterFile, config: ShipAttitudeConfig, bag: Bag, readable: dict[str, str]
) -> Iterator[str]:
    """Messages that would be refused because their frame_id is not the configured one."""
    expected = {_INS_TOPIC: config.ins.frame_id}
    expected |= {f"star/{name}/{sensor.input}": sensor.frame_id for name, sensor in config.star_sensors.items()}
    expected |= {f"reference/{name}/imu": reference.frame_id for name, reference in config.references.items()}
    waiting = {readable[topic]: topic for topic, frame in expected.items() if frame and topic in readable}
    for record in bag.records(waiting) if waiting else ():
        topic = waiting.pop(record.topic, None)
        if topic is not None:
            frame = record.decode().header.frame_id
            if frame != expected[topic]:
                name = f"{_section(topic)}.frame_id"
                yield (
                    f"{_place(file, path, topic, 'frame_id')}: parameter '{name}' = '{expected[topic]}', but topic "
                    f"'{topic}' in {bag.path} carries frame_id '{frame}'"
                )
        if not waiting:
            break


def _not_configured(config: ShipAttitudeConfig, bag: Bag, found: dict[str, str], configured: set[str]) -> Iterator[str]:
    """Sensors in the bag that the configuration does not use."""
    known = {"star": config.star_sensors, "reference": config.references}
    for topic in sorted(found.keys() - configured):
        match = _SENSOR_TOPIC.fullmatch(topic)
        if match is None:
            continue
        group, name = match["group"], match["name"]
        if name not in known[group]:
            yield f"{bag.path}: topic '{topic}' has no {_GROUPS[group]}.{name} in the configuration: not used"
        elif group == "star" and f"star/{name}/{config.star_sensors[name].input}" not in found:
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

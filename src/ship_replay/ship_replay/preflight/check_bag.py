"""Contradictions between a suite configuration and a bag: topics, types, frames, too long gaps; processor load."""

import os
import re
from collections.abc import Collection, Iterator
from typing import Any

from ship_bags.renamed_topics import remap_advice
from ship_bags.topic_names import likely_namespace
from ship_replay.offline.message_times import MessageTimes, exceeded_limits
from ship_replay.preflight.check_config import BagCheck, CheckedNode
from ship_replay.preflight.load import load_text, load_warnings, measured_slowness, node_loads

_INS_TOPIC = "ins/imu"
_SENSOR_TOPIC = re.compile(
    r"(?P<group>star|reference)/(?P<name>[^/]+)/(horizon_attitude|inertial_attitude|observations|solution|imu)"
)
_GROUPS = {"star": "star_sensors", "reference": "references"}


def check_bag(check: BagCheck) -> None:
    """Check a configuration against the topics of a bag: presence, type, definition, frame_id, unconfigured sensors."""
    published = {topic.topic for node in check.nodes for topic in node.adapter.outputs}
    _check_presence(check, check.topic_names.keys() | published)
    for node in check.nodes:
        _check_inputs(check, node)
    # A problem of a topic is found for each node that uses the topic, but is reported once.
    check.findings.errors = list(dict.fromkeys(check.findings.errors))
    input_topics = {topic.topic for node in check.nodes for topic in node.adapter.inputs}
    check.findings.warnings += [*_not_configured(check, input_topics | published), *check.bag.problems]


def _check_presence(check: BagCheck, present: Collection[str]) -> None:
    """Report each input that is neither in the bag nor published by a node, with the nodes that use the input.

    Occasional inputs may be missing.
    """
    absent: dict[str, list[tuple[CheckedNode, bool]]] = {}
    for node in check.nodes:
        for topic in node.adapter.inputs:
            if topic.topic not in present and not topic.is_occasional:
                absent.setdefault(topic.topic, []).append((node, topic.required))
    adapters = [node.adapter for node in check.nodes]
    kinds = {topic.topic: topic.type_name for each in adapters for topic in each.outputs}
    kinds |= {topic.topic: topic.type_name for each in adapters for topic in each.inputs}
    for name, takers in absent.items():
        needing = [node.adapter.node_name for node, required in takers if required]
        optional = [node.adapter.node_name for node, required in takers if not required]
        roles = ("needed by", needing), ("optional for", optional)
        whose = ", ".join(f"{role} {' and '.join(names)}" for role, names in roles if names)
        hint = likely_namespace(check.bag.topics, [name])
        similar = remap_advice(name, kinds[name], check.bag.topics, kinds, check.namespace)
        advice = f" (found in namespace '{hint}')" if hint else f" ({similar})" if similar else ""
        place = takers[0][0].place(check.path, _section(name))
        check.report(bool(needing), f"{place}: topic '{name}' is not in {check.bag.path}: {whose}{advice}")


def _check_inputs(check: BagCheck, node: CheckedNode) -> None:
    """Check the inputs of a node in a bag."""
    bag, errors = check.bag, check.findings.errors
    readable: dict[str, str] = {}
    for topic in node.adapter.inputs:
        if topic.topic not in check.topic_names:
            continue
        type_name = bag.topics[check.topic_names[topic.topic]]
        if type_name != topic.type_name:
            place = node.place(check.path, _section(topic.topic))
            errors.append(f"{place}: topic '{topic.topic}' in {bag.path} is {type_name}: expected {topic.type_name}")
            continue
        errors += [f"{bag.path}: topic '{topic.topic}': {line}" for line in bag.differences.get(type_name, [])]
        if type_name not in bag.differences:
            readable[topic.topic] = check.topic_names[topic.topic]
    errors += _frame_errors(check, node, readable)


def _frame_errors(check: BagCheck, node: CheckedNode, readable: dict[str, str]) -> Iterator[str]:
    """Yield an error for each topic whose first message would be rejected because of its frame_id."""
    expected = {topic: _frame_id(node.config, topic) for topic in readable}
    pending = {readable[topic]: topic for topic, frame in expected.items() if frame}
    for record in check.bag.records(pending) if pending else ():
        topic = pending.pop(record.topic, None)
        if topic is not None:
            frame = record.decode().header.frame_id
            if frame != expected[topic]:
                name = f"{_section(topic)}.frame_id"
                yield (
                    f"{node.place(check.path, name)}: parameter '{name}' = '{expected[topic]}', but "
                    f"topic '{topic}' in {check.bag.path} carries frame_id '{frame}'"
                )
        if not pending:
            break


def _frame_id(config: Any, topic: str) -> str:
    """Return the configured frame_id of an input topic; empty if any frame_id is accepted."""
    if topic == _INS_TOPIC:
        return str(config.ins.frame_id)
    group, *rest = topic.split("/")
    return str(getattr(config, _GROUPS[group])[rest[0]].frame_id) if group in _GROUPS else ""


def _not_configured(check: BagCheck, known: set[str]) -> Iterator[str]:
    """Yield warnings for sensors in the bag that the configuration does not use."""
    found, where = check.topic_names, check.bag.path
    for topic in sorted(found.keys() - known):
        match = _SENSOR_TOPIC.fullmatch(topic)
        if match is None:
            continue
        name, group = match["name"], _GROUPS[match["group"]]
        if not any(name in getattr(config, group, {}) for config in (node.config for node in check.nodes)):
            yield f"{where}: topic '{topic}' has no {group}.{name} in the configuration: not used"
        elif group == "star_sensors" and not any(t.startswith(f"star/{name}/") for t in known & found.keys()):
            yield f"{where}: topic '{topic}' is not used: star_sensors.{name}.input names another output"


def _section(topic: str) -> str:
    """Return the dotted name of the parameter section of an input topic."""
    group, *rest = topic.split("/")
    return f"{_GROUPS[group]}.{rest[0]}" if group in _GROUPS else group


def check_rates(check: BagCheck) -> None:
    """Compare the gaps between messages of a bag with the parameters, and estimate the load from the rates."""
    input_topics = {topic.topic for node in check.nodes for topic in node.adapter.inputs} & check.topic_names.keys()
    times = {topic: MessageTimes() for topic in input_topics}
    relative_names = {check.topic_names[topic]: topic for topic in input_topics}
    for record in check.bag.records(relative_names) if input_topics else ():
        times[relative_names[record.topic]].add(record)
    for node in check.nodes:
        for excess in exceeded_limits(node.config, times, str(check.bag.path)):
            check.report(excess.is_most_of_the_time, f"{node.place(check.path, excess.limit.parameter)}: {excess.text}")
    rates_hz = {topic: found.arrivals.rate_hz for topic, found in times.items()}
    if any(rates_hz.values()):
        found = node_loads([node.adapter for node in check.nodes], rates_hz, measured_slowness())
        check.findings.notes.append(load_text(found))
        check.findings.warnings += load_warnings(found, len(os.sched_getaffinity(0)))

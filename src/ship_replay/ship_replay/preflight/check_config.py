"""Check of a suite configuration by itself, and the common basis of all checks against a bag."""

import copy
import dataclasses
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.parameter_yaml import ParameterFile, full_name, in_any_namespace
from ship_bags.topic_names import relative_topics, ship_names
from ship_estimation.parameters.schema import ParameterDescription, ParameterError, build, describe
from ship_node.adapters.adapter import Adapter
from ship_node.parameters.machine_resources import MachineResource
from ship_node.parameters.parameter_file import (
    COMPANIONS,
    Companion,
    configured_companions,
    has_section,
    read_node_parameters,
    section_warning,
    unknown_sections,
)
from ship_node.saved_files.saved_document import READ_ONLY
from ship_replay.offline.adapter_chain import nodes_of
from ship_stars.camera.config import MountingConfig
from ship_stars.sky.config import SkyConfig

_NODE_SPECIFIC_SKY_PARAMETERS = ("magnitude_limit", "refraction_time_s", "position_time_s")
"""Sky parameters that may differ between nodes: which stars a node identifies, and time constants of its filter."""

INS_TOPIC = "ins/imu"
"""Relative topic of the INS."""


@dataclass
class Findings:
    """Findings of the checks.

    Attributes:
        errors: reasons for which a node would not start, or would reject data of the bag, one line each.
        unused_inputs: inputs of which more than half would not be used, one line each.
        warnings: settings that are probably not intended, one line each.
        notes: information, one line each.
    """

    errors: list[str] = field(default_factory=list)
    unused_inputs: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass
class CheckedNode:
    """A node of a configuration, with invalid values replaced by allowed ones for the following checks.

    Attributes:
        file: parameters of the node in the file.
        config: configuration of the node.
        adapter: adapter of the node.
        replaced_parameters: dotted names of replaced parameters, which are already reported.
    """

    file: ParameterFile
    config: Any
    adapter: Adapter
    replaced_parameters: frozenset[str] = frozenset()

    def place(self, path: Path, parameter: str) -> str:
        """Return file and line of a parameter or of its nearest group; the file alone if both are missing in it."""
        line = self.file.line_of(parameter)
        return f"{path}:{line}" if line else str(path)


@dataclass
class BagCheck:
    """A suite configuration compared with a bag that was recorded with the same sensors.

    Attributes:
        path: file of the configuration.
        nodes: nodes of the configuration.
        bag: the bag.
        namespace: namespace of the ship in the bag.
        findings: findings, to which the checks append.
    """

    path: Path
    nodes: Sequence[CheckedNode]
    bag: Bag
    namespace: str
    findings: Findings

    @cached_property
    def topic_names(self) -> dict[str, str]:
        """Relative topic → name in the bag."""
        return relative_topics(self.bag.topics, self.namespace)

    @property
    def usable(self) -> dict[str, str]:
        """Relative topic → name in the bag, for topics whose message definition equals the installed definition."""
        return {
            topic: name for topic, name in self.topic_names.items() if self.bag.topics[name] not in self.bag.differences
        }

    def report(self, is_error: bool, text: str) -> None:
        """Add a finding once, even if two nodes share the parameter."""
        lines = self.findings.errors if is_error else self.findings.warnings
        if text not in lines:
            lines.append(text)


def check_file(
    path: Path, adapter_classes: Sequence[type[Adapter]], findings: Findings, namespace: str = ""
) -> list[CheckedNode]:
    """Check all parameters of a file, including those of nodes other than the estimators.

    Args:
        path: the file.
        adapter_classes: known nodes; see :func:`nodes_of`.
        findings: findings, to which the checks append.
        namespace: namespace of the nodes; sections are matched with the full names of the nodes, as in rcl.

    Returns:
        Estimators that can be created from the file, with invalid values replaced.

    Raises:
        BadInput: the file cannot be read, is not a parameter file or has no section for a node of the suite.
    """
    names = {kind: full_name(kind.node_name, namespace) for kind in adapter_classes}
    known = [*names.values(), *(full_name(companion.node_name, namespace) for companion in COMPANIONS)]
    misfits = [problem for name in known for problem in _misfit_lines(path, name)]
    findings.errors += misfits
    strange = unknown_sections(path, known)
    companions = list(configured_companions(path, namespace))
    expected_text = _expected_text(adapter_classes)
    if not (misfits or companions or any(has_section(path, name) for name in names.values())):
        found = ", ".join(f"'{name}'" for name in strange) or "none"
        raise BadInput(f"no section for a node of this suite: {expected_text}, found {found}", file=path)
    if not misfits:
        findings.warnings += [
            f"{path}: section '{name}' fits no node of this suite: {expected_text}" for name in strange
        ]
    named = [kind for kind in nodes_of(path, adapter_classes, namespace) if has_section(path, names[kind])]
    checked = (_check_node(path, kind, names[kind], findings) for kind in named)
    nodes = [node for node in checked if node is not None]
    places = [place for companion in companions for place in _companion_places(path, companion, namespace, findings)]
    findings.errors += list(_place_conflicts(path, places))
    findings.warnings += list(_parameter_conflicts(path, nodes))
    _check_names(path, nodes, findings)
    return nodes


def _check_names(path: Path, nodes: Sequence[CheckedNode], findings: Findings) -> None:
    """Check the entries of the map ``topics``, and that a node uses each input in it."""
    try:
        names = ship_names(path)
    except BadInput as problem:
        findings.errors.append(str(problem))
        return
    taken = {topic.topic for node in nodes for topic in node.adapter.inputs}
    for name in names if nodes else ():
        if name not in taken:
            place = next((n.place(path, f"topics.{name}") for n in nodes if f"topics.{name}" in n.file.lines), path)
            findings.warnings.append(f"{place}: parameter 'topics.{name}': no estimator of this file takes {name}")


def _expected_text(adapter_classes: Sequence[type[Adapter]]) -> str:
    nodes = [kind.node_name for kind in adapter_classes] + [companion.node_name for companion in COMPANIONS]
    names = ", ".join(f"'{in_any_namespace(node)}'" for node in nodes)
    return f"expected one of {names} or '/**'"


def _misfit_lines(path: Path, name: str) -> list[str]:
    """Return the error about a section whose name nearly fits a node, which would not start with this section."""
    try:
        section_warning(path, name)
    except BadInput as problem:
        return [str(problem)]
    return []


def _check_node(path: Path, adapter_class: type[Adapter], name: str, findings: Findings) -> CheckedNode | None:
    file = read_node_parameters(path, name)
    config, replaced = _build_config(file, adapter_class.config_type, findings)
    if config is None:
        return None
    try:
        adapter = adapter_class(config, RosbagsFactory(), READ_ONLY)
        findings.warnings += [f"{path}: {warning}" for warning in adapter.start_warnings]
        return CheckedNode(file, config, adapter, frozenset(replaced))
    except ParameterError as problem:
        # Errors of parameters that were replaced above are already reported.
        if replaced.isdisjoint(problem.parameters):
            findings.errors.append(str(file.error(problem)))
    except BadInput as problem:
        findings.errors.append(f"{path}: {problem}")
    return None


def _companion_places(
    path: Path, companion: Companion, namespace: str, findings: Findings
) -> Iterator[tuple[str, ParameterFile, MachineResource]]:
    """Check the parameters of another node; yield its full name, its parameters and each exclusive resource."""
    try:
        kind = companion.config_type
    except ImportError:
        text = f"{path}: section '{companion.node_name}' is not checked: package {companion.package} is not installed"
        findings.warnings.append(text)
        return
    node = full_name(companion.node_name, namespace)
    file = read_node_parameters(path, node)
    config, replaced = _build_config(file, kind, findings)
    for place in () if replaced else config.places:
        yield node, file, place


def _place_conflicts(path: Path, places: Sequence[tuple[str, ParameterFile, MachineResource]]) -> Iterator[str]:
    """Yield errors for exclusive resources of the machine that two nodes use."""
    for (node, file, place), (other_node, other_file, other) in itertools.combinations(places, 2):
        if node != other_node and place.conflicts_with(other):
            reason = f"parameter '{other.parameter}' = {other.name!r} of {other_node}"
            reason += f": '{place.parameter}' of {node}, line {file.line_of(place.parameter)}, has {place} already"
            line = other_file.line_of(other.parameter)
            yield f"{path}:{line}: {reason}: expected a {place.kind.value} of its own"


def _build_config(file: ParameterFile, kind: type[Any], findings: Findings) -> tuple[Any, set[str]]:
    """Report each invalid value; return the configuration with these values replaced, and the replaced parameters.

    The configuration is None if replacing the values does not make it valid.
    """
    values = copy.deepcopy(file.values)
    descriptions = list(describe(kind))
    replaced: set[str] = set()
    while True:
        try:
            return build(kind, values), replaced
        except ParameterError as problem:  # noqa: PERF203 - each pass replaces another value
            if problem.parameters and problem.parameters[0] in replaced:
                return None, replaced  # the problem is caused by the removal of the value
            findings.errors.append(str(file.error(problem)))
            replaced.update(problem.parameters[:1])
            if not _replace_value(values, problem, descriptions):
                return None, replaced


def _parameter_conflicts(path: Path, nodes: Sequence[CheckedNode]) -> Iterator[str]:
    """Yield warnings for parameters of a sensor's mounting or of the sky that differ between two nodes."""
    for node, other in itertools.combinations(nodes, 2):
        for name, one, two in [*_mountings(node.config, other.config), *_skies(node.config, other.config)]:
            if one != two:
                place, names = other.place(path, name), (other.adapter.node_name, node.adapter.node_name)
                yield f"{place}: parameter '{name}' is {two!r} for {names[0]}, but {one!r} for {names[1]}"


def _mountings(one: Any, other: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield the mounting parameters of sensors common to two nodes, with both values."""
    names = [field.name for field in dataclasses.fields(MountingConfig) if field.name != "frame_id"]
    sensors, others = getattr(one, "star_sensors", {}), getattr(other, "star_sensors", {})
    for id_, name in itertools.product([id_ for id_ in sensors if id_ in others], names):
        yield f"star_sensors.{id_}.{name}", getattr(sensors[id_], name), getattr(others[id_], name)


def _skies(one: Any, other: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield the sky parameters of two nodes that both need the sky, with both values.

    Both nodes must use the same sky parameters. Otherwise errors shared by solutions and other sensors cannot be
    separated.
    """
    if _needs_sky(one) and _needs_sky(other):
        for name in (
            field.name for field in dataclasses.fields(SkyConfig) if field.name not in _NODE_SPECIFIC_SKY_PARAMETERS
        ):
            yield f"sky.{name}", getattr(one.sky, name), getattr(other.sky, name)


def _needs_sky(config: Any) -> bool:
    """True if a node has a star sensor on the deck that needs the sky over the ship, or a camera on the theodolite."""
    on_deck = any(getattr(star, "needs_sky", True) for star in getattr(config, "star_sensors", {}).values())
    return hasattr(config, "sky") and (on_deck or bool(getattr(config, "telescopes", {})))


def _replace_value(values: dict[str, Any], problem: ParameterError, descriptions: list[ParameterDescription]) -> bool:
    """Remove the value named by a problem, and insert an allowed value if the parameter is required.

    Returns:
        True if anything changed; otherwise the same problem would occur again.
    """
    if not problem.parameters:
        return False
    parameter = problem.parameters[0]
    *groups, leaf = parameter.split(".")
    level = values
    for group in groups:
        level = level.setdefault(group, {})
    removed = level.pop(leaf, None) is not None
    for description in descriptions:
        pattern = re.escape(description.name).replace("<id>", r"[^.]+")
        if description.default is None and re.fullmatch(pattern, parameter):
            level[leaf] = _allowed_value(description)
            return True
    return removed


def _allowed_value(description: ParameterDescription) -> Any:
    if description.choices:
        return description.choices[0]
    if description.kind in (int, float):
        low, high = description.minimum, description.maximum
        return description.kind(min(max(0.0, -1e300 if low is None else low), 1e300 if high is None else high))
    return description.kind()

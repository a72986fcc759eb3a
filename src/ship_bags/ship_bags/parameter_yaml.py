"""Reader and writer of ROS 2 parameter files without ROS; each value is read with its line.

A file has sections ``node: {ros__parameters: {...}}``; a plain file has nested parameters only and no sections. Numbers
are read as by rcl: ``1e-3`` is a number and ``1:30`` a text, unlike in plain YAML 1.1.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ship_bags.errors import BadInput
from ship_bags.input_files import check_regular, compose
from ship_bags.topic_names import TOPICS_PARAMETER
from ship_geometry.input_error import InputError

PARAMETERS_KEY = "ros__parameters"

BLACK_BOX_PARAMETER = "black_box"
"""Parameter of every node: path of its black box, empty for no black box."""

BLACK_BOX_PART_PARAMETER = "black_box_part_mb"
"""Parameter of every estimator node: size in MB at which its black box continues in a new file."""

RELIABLE_INPUTS_PARAMETER = "reliable_inputs"
"""Parameter of every node: True if messages lost on the way to the node are sent again."""

RUNTIME_PARAMETERS = (
    "use_sim_time",
    "qos_overrides",
    "start_type_description_service",
    BLACK_BOX_PARAMETER,
    BLACK_BOX_PART_PARAMETER,
    RELIABLE_INPUTS_PARAMETER,
    TOPICS_PARAMETER,
)
"""First parts of the names of parameters that belong to rclpy or the node runtime, not to a configuration."""

ANY_NAMESPACE = "/**/"
"""Prefix of a node name for the node in any namespace."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NULL = re.compile(r"~|null|Null|NULL|$")
_BOOLEAN = re.compile(r"yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF")
_INTEGER = re.compile(r"[-+]?(0x[0-9a-fA-F]+|[0-9]+)")
_LONGEST_INTEGER = 19
_FIRST_TOO_LARGE = 2**63
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class _Dumper(yaml.SafeDumper):
    """YAML dumper with quotes around all texts, because a text for YAML may be a number for ROS."""


_Dumper.add_representer(str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"'))


@dataclass(frozen=True)
class Section:
    """Section of a file for one node.

    Attributes:
        node: full name of the node, ``/NAMESPACE/NAME``, with wildcards as written.
        parameters: value and line (from 1) by dotted name.
        line: line of the section's name.
    """

    node: str
    parameters: dict[str, tuple[Any, int]]
    line: int = 1


@dataclass(frozen=True)
class ParameterFile:
    """Parameters of one node in one file.

    Attributes:
        name: name of the file, for texts.
        values: nested mapping without the parameters of rclpy and the node runtime.
        lines: line (from 1) of every parameter and group by dotted name.
    """

    name: str
    values: dict[str, Any]
    lines: dict[str, int]

    def line_of(self, parameter: str) -> int | None:
        """Return the line of a parameter, or of the nearest group around it; None if the file has neither."""
        while parameter not in self.lines and "." in parameter:
            parameter = parameter.rpartition(".")[0]
        return self.lines.get(parameter)

    def error(self, problem: InputError) -> BadInput:
        """Return a problem with parameters as bad input with this file and the line of the first parameter."""
        line = self.line_of(problem.parameters[0]) if problem.parameters else None
        return BadInput(
            problem.reason, file=self.name, line=line, parameters=problem.parameters, value=problem.value
        )


def is_runtime_parameter(name: str) -> bool:
    """Return True if a dotted name belongs to rclpy or the node runtime."""
    return name.split(".")[0] in RUNTIME_PARAMETERS


def full_name(node_name: str, namespace: str = "") -> str:
    """Return ``/NAMESPACE/NAME`` of a node.

    Args:
        node_name: name without namespace.
        namespace: namespace with or without slashes; empty if the node has no namespace.
    """
    return "/".join(["", *filter(None, namespace.split("/")), node_name])


def in_any_namespace(node_name: str) -> str:
    """Return the pattern that stands, instead of a full name, for a node in any namespace."""
    return ANY_NAMESPACE + node_name


def read_sections(source: Path | str) -> tuple[str, list[Section]]:
    """Return the name of the source for texts, and its sections in order with nested namespaces resolved.

    Args:
        source: path of the file; a ``str`` is the content of the file.

    Raises:
        BadInput: the file cannot be read or is not a parameter file; the error names the file and, if known, the line.
    """
    name, text = _text(source)
    root = compose(name, text)
    if root is None:
        raise BadInput(f"empty: expected a section 'NODE: {{{PARAMETERS_KEY}: ...}}'", file=name)
    _refuse_alias(name, root)
    return name, list(_sections(name, root, ""))


def read_nested_parameters(source: Path | str) -> ParameterFile:
    """Return a file that has only nested parameters, without sections for nodes.

    Raises:
        BadInput: the file cannot be read, has no parameters, or has an invalid entry.
    """
    name, text = _text(source)
    root = compose(name, text)
    if not isinstance(root, yaml.MappingNode):
        raise BadInput("expected 'name: value' entries, but the file contains none", file=name, line=1)
    return merge_sections(name, [Section("", dict(_parameters(name, root, "")))])


def merge_sections(name: str, sections: Sequence[Section]) -> ParameterFile:
    """Merge the sections of a file into one; if a parameter has several values, the last value applies.

    Raises:
        BadInput: a name is a parameter in one place and a group in another.
    """
    file = ParameterFile(name, {}, {})
    for section in sections:
        for parameter, (value, line) in section.parameters.items():
            _put_line(file.lines, parameter, line)
            if not is_runtime_parameter(parameter):
                _put_value(file, parameter, value)
    return file


def sections_text(nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the text of a parameter file for several nodes.

    Args:
        nodes: full name → parameters, by dotted names or nested.
    """
    document = {name: {PARAMETERS_KEY: dict(nodes[name])} for name in sorted(nodes)}
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1_000_000)


def _text(source: Path | str) -> tuple[str, str]:
    # A text, as an attachment of a bag, is never used as a file name, because it could name any file.
    if isinstance(source, str):
        return "configuration", source
    try:
        check_regular(source)
        return str(source), source.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", file=source) from error
    except UnicodeDecodeError as error:
        raise BadInput("is not a text file (UTF-8): expected a ROS 2 parameter file", file=source) from error


def _refuse_alias(name: str, root: yaml.Node) -> None:
    """Refuse a file with aliases, which rcl cannot read."""
    seen, waiting = set(), [root]
    while waiting:
        node = waiting.pop()
        if id(node) in seen:
            reason = "the value here is used again by an alias, which ROS cannot read: write it out"
            raise BadInput(reason, file=name, line=node.start_mark.line + 1)
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            waiting += [part for entry in node.value for part in entry]
        elif isinstance(node, yaml.SequenceNode):
            waiting += node.value


def _sections(name: str, node: yaml.Node, path: str, path_line: int = 1) -> Iterator[Section]:
    has_parameters = False
    for key, line, value in _entries(name, node, path or "the file"):
        if has_parameters:
            reason = f"'{key}' follows '{PARAMETERS_KEY}' of '{path}', where ROS ignores it: put it in front"
            raise BadInput(reason, file=name, line=line)
        if key == PARAMETERS_KEY:
            has_parameters = True
            if not path:
                raise BadInput(f"'{PARAMETERS_KEY}' must be below the name of a node", file=name, line=line)
            yield Section(_node_name(name, path_line, path), dict(_parameters(name, value, "")), path_line)
        else:
            # Names are joined as in rcl: by a slash unless the first name ends with a slash.
            joined = f"{path}{'' if not path or path.endswith('/') else '/'}{key}"
            yield from _sections(name, value, joined, line)


def _node_name(name: str, line: int, path: str) -> str:
    """Return the full name of a section; refuse a name that rcl would not accept."""
    full = path if path.startswith("/") else f"/{path}"
    for part in full[1:].split("/"):
        if part not in ("*", "**") and not _NAME.fullmatch(part):
            raise BadInput(
                f"section '{path}' is not a node name: expected letters, digits and _ between single "
                "slashes, or * for any one part and ** for any number of them",
                file=name, line=line,
            )
    return full


def _parameters(name: str, node: yaml.Node, prefix: str) -> Iterator[tuple[str, tuple[Any, int]]]:
    for key, line, value in _entries(name, node, prefix.rstrip(".") or PARAMETERS_KEY):
        if isinstance(value, yaml.MappingNode):
            if prefix and not value.value:
                # rcl drops an empty group silently, so that a device with only defaults would be missing.
                reason = f"group '{prefix}{key}' is empty: give it a parameter, or remove it"
                raise BadInput(reason, file=name, line=line)
            yield from _parameters(name, value, f"{prefix}{key}.")
        else:
            yield prefix + key, (_value(name, value, prefix + key), line)


def _entries(name: str, node: yaml.Node, what: str) -> Iterator[tuple[str, int, yaml.Node]]:
    """Yield key, line and value of each entry of a mapping."""
    if not isinstance(node, yaml.MappingNode):
        line = node.start_mark.line + 1
        raise BadInput(f"{what}: expected 'name: value' entries, got {_kind(node)}", file=name, line=line)
    seen: dict[str, int] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise BadInput(f"{what}: {_kind(key)} cannot be a name", file=name, line=line)
        if key.value in seen:
            raise BadInput(f"'{key.value}' is given twice, first in line {seen[key.value]}", file=name, line=line)
        seen[key.value] = line
        yield key.value, line, value


def _value(name: str, node: yaml.Node, parameter: str) -> Any:
    def value_error(what: str) -> BadInput:
        line = node.start_mark.line + 1
        return BadInput(f"parameter '{parameter}' {what}", file=name, line=line, parameters=(parameter,))

    if isinstance(node, yaml.SequenceNode):
        elements = [_value(name, element, parameter) for element in node.value]
        kinds = sorted({type(element).__name__ for element in elements})
        if len(kinds) > 1:
            raise value_error(f"mixes {' and '.join(kinds)}: all elements of a list must be of one type")
        if kinds == ["list"]:
            raise value_error("is a list of lists: expected a plain list")
        return elements
    if not isinstance(node, yaml.ScalarNode):
        raise value_error("is a list of groups: expected a plain list")
    if node.style in ("'", '"', "|", ">"):
        return node.value
    text = node.value
    if _NULL.fullmatch(text):
        raise value_error("has no value")
    if _BOOLEAN.fullmatch(text):
        return text.lower() in ("yes", "true", "on")
    if _INTEGER.fullmatch(text):
        value = _integer(text)
        if value is None:
            raise value_error(f"is a number of {len(text.lstrip('+-0x'))} digits: expected one of 64 bits")
        return value
    if _FLOAT.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text


def _integer(text: str) -> int | None:
    """Return a number as an integer of 64 bits; None if it is larger, without converting thousands of digits."""
    digits = text.lstrip("+-0x")
    value = int(text, 16 if "x" in text else 10) if len(digits) <= _LONGEST_INTEGER else _FIRST_TOO_LARGE
    return value if -_FIRST_TOO_LARGE <= value < _FIRST_TOO_LARGE else None


def _kind(node: yaml.Node) -> str:
    if isinstance(node, yaml.ScalarNode):
        return f"a single value ({node.value:.40})" if node.value else "nothing"
    return "a list" if isinstance(node, yaml.SequenceNode) else "a group"


def _put_line(lines: dict[str, int], parameter: str, line: int) -> None:
    """Store the line of a parameter, and of the groups around it if they are new."""
    lines[parameter] = line
    while "." in parameter:
        parameter = parameter.rpartition(".")[0]
        lines.setdefault(parameter, line)


def _put_value(file: ParameterFile, parameter: str, value: Any) -> None:
    level = file.values
    *groups, last = parameter.split(".")
    for group in groups:
        level = level.setdefault(group, {})
        if not isinstance(level, dict):
            reason = f"parameter '{parameter}': '{group}' is a value elsewhere, not a group"
            raise file.error(InputError(reason, parameters=(parameter,), value=value))
    if isinstance(level.get(last), dict):
        reason = f"parameter '{parameter}' is a group elsewhere, not a value"
        raise file.error(InputError(reason, parameters=(parameter,), value=value))
    level[last] = value

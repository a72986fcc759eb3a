"""ROS 2 parameter files read without ROS, with the line of each parameter.

A file holds sections ``node: {ros__parameters: {...}}``. Node names may be written with namespace, nested in
namespaces or with wildcards (``/**``, ``/*/name``); of several that fit, later ones override earlier ones.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ship_estimation.parameters import ParameterError, build
from ship_node.errors import BadInput
from ship_node.parameter_yaml import Section, read_plain_section, read_sections

Config = TypeVar("Config")

BLACK_BOX_PARAMETER = "black_box"
"""Every node's shell has it: path of the box, empty for none."""

SHELL_PARAMETERS = ("use_sim_time", "qos_overrides", "start_type_description_service", BLACK_BOX_PARAMETER)
"""First part of the names of parameters that belong to rclpy or the node's shell and not to a configuration."""


@dataclass(frozen=True)
class ParameterFile:
    """The parameters of one node in one file.

    Attributes:
        name: the file, for messages.
        values: nested mapping, those of rclpy and the node's shell left out.
        lines: line (from 1) of each parameter and group by dotted name, all of them.
    """

    name: str
    values: dict[str, Any]
    lines: dict[str, int]

    def line_of(self, parameter: str) -> int | None:
        """Line of a parameter, or of the nearest group around it; None where the file names none of them."""
        while parameter not in self.lines and "." in parameter:
            parameter = parameter.rpartition(".")[0]
        return self.lines.get(parameter)

    def error(self, text: str) -> BadInput:
        """The bad input of a text that quotes the parameter at fault first, with file and line."""
        line = self.line_of(quoted_parameter(text))
        return BadInput(f"{self.name}:{line}: {text}" if line else f"{self.name}: {text}")


def quoted_parameter(text: str) -> str:
    """The first name in quotes, without an index; empty where there is none."""
    quoted = re.search(r"'([^'\[]+)", text)
    return quoted[1] if quoted else ""


def is_shell_parameter(name: str) -> bool:
    """Whether a dotted name belongs to rclpy or the node's shell."""
    return name.split(".")[0] in SHELL_PARAMETERS


def load(source: Path | str, node_name: str) -> dict[str, Any]:
    """The parameters of a node as nested mapping; see :func:`read`."""
    return read(source, node_name).values


def load_config(kind: type[Config], source: Path | str, node_name: str) -> Config:
    """The checked configuration of a node.

    Raises:
        BadInput: names the file, the line, the parameter and what was expected.
    """
    file = read(source, node_name)
    try:
        return build(kind, file.values)
    except ParameterError as error:
        raise file.error(str(error)) from error


def read(source: Path | str, node_name: str) -> ParameterFile:
    """The parameters of a node with their lines.

    Args:
        source: a path; a ``str`` that holds a line break is the text itself.
        node_name: name without namespace.

    Raises:
        BadInput: the file cannot be read, is no parameter file, has no section for the node, or has sections
            for it in several namespaces.
    """
    name, sections = read_sections(source)
    fitting = [section for section in sections if _fits(section.node, node_name)]
    if not fitting:
        found = ", ".join(f"'{section.node}'" for section in sections) or "none"
        raise BadInput(f"{name}: no section for node '{node_name}': expected '{node_name}' or '/**', found {found}")
    exact = sorted({section.node for section in fitting if "*" not in section.node})
    if len(exact) > 1:
        raise BadInput(f"{name}: sections {' and '.join(exact)} both fit node '{node_name}': keep one in this file")
    return _merged(name, fitting)


def read_whatever_fits(source: Path | str, node_name: str) -> ParameterFile:
    """As :func:`read` for a file that may be about other nodes, or about several of that name.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    name, sections = read_sections(source)
    return _merged(name, [section for section in sections if _fits(section.node, node_name)])


def has_section(source: Path | str, node_name: str, wildcards: bool = True) -> bool:
    """Whether a file speaks of a node: by its name, or, with ``wildcards``, by one for all nodes.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    _, sections = read_sections(source)
    return any(_fits(section.node, node_name) and (wildcards or "*" not in section.node) for section in sections)


def unknown_sections(source: Path | str, node_names: Collection[str]) -> list[str]:
    """Names of a file's sections that fit none of some nodes, without namespace, in order.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    _, sections = read_sections(source)
    strange = [section.node for section in sections if not any(_fits(section.node, name) for name in node_names)]
    return [node.rpartition("/")[2] for node in strange]


def read_plain(source: Path | str) -> ParameterFile:
    """A file that is nothing but nested parameters, without sections for nodes, with their lines.

    Raises:
        BadInput: the file cannot be read or holds no parameters.
    """
    name, section = read_plain_section(source)
    return _merged(name, [section])


def _merged(name: str, sections: list[Section]) -> ParameterFile:
    file = ParameterFile(name, {}, {})
    for section in sections:
        for parameter, (value, line) in section.parameters.items():
            _put_line(file.lines, parameter, line)
            if not is_shell_parameter(parameter):
                _put_value(file, parameter, value)
    return file


def _fits(pattern: str, node_name: str) -> bool:
    """Whether a section's name fits a node of that name in whatever namespace."""
    return pattern.rpartition("/")[2] in (node_name, "*", "**")


def _put_line(lines: dict[str, int], parameter: str, line: int) -> None:
    """The line of a parameter, and of the groups around it where they were not met before."""
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
            raise file.error(f"parameter '{parameter}': '{group}' is a value elsewhere, not a group")
    if isinstance(level.get(last), dict):
        raise file.error(f"parameter '{parameter}' is a group elsewhere, not a value")
    level[last] = value

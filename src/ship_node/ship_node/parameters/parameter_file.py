"""Reader of a node's parameters from a ROS 2 parameter file, and writer of such files, without ROS.

A file has sections ``node: {ros__parameters: {...}}``. Node names may be written with namespace, nested in namespaces
or with wildcards (``/**``, ``/**/name``, ``/*/name``). As in rcl, a section whose name has neither namespace nor
wildcard matches only a node without namespace. Later matching sections override earlier sections.

A suite file may also have sections for nodes that are not estimators (:data:`COMPANIONS`); no replay runs them. The
package of these nodes depends on this package. Therefore the nodes are listed here by name, and their parameters are
imported only if a file has a section for them.
"""

import importlib
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import (
    ANY_NAMESPACE,
    ParameterFile,
    Section,
    full_name,
    in_any_namespace,
    merge_sections,
    read_sections,
    sections_text,
)
from ship_estimation.parameters.schema import ParameterError, build, flatten, nest
from ship_geometry.input_error import InputError

Config = TypeVar("Config")

_MIN_SIMILARITY = 0.8
"""Minimum similarity of two names of which one may be a misspelling of the other.

The similarity of 'ship_attitude' to 'ship_attitude_node' is 0.86, and to 'star_attitude' 0.75.
"""


def load_config(kind: type[Config], source: Path | str, node: str) -> Config:
    """Return the checked configuration of a node; see :func:`read_node_parameters`.

    Raises:
        BadInput: as for :func:`read_node_parameters`, or a parameter is wrong; the text then names the file, the line,
            the parameter and what is expected.
    """
    file = read_node_parameters(source, node)
    try:
        return build(kind, file.values)
    except ParameterError as error:
        raise file.error(error) from error


def parameter_text(node_name: str, config: Any) -> str:
    """Return the text of a parameter file that gives a node this configuration, in any namespace.

    All defaults are written out.

    Args:
        node_name: name without namespace.
        config: a dataclass in the style of :mod:`ship_estimation.parameters.schema`.
    """
    return sections_text({in_any_namespace(node_name): nest(flatten(config))})


def read_node_parameters(source: Path | str, node: str) -> ParameterFile:
    """Return the parameters of a node with their lines.

    Args:
        source: path of the file; a ``str`` is the content of the file.
        node: full name (:func:`ship_bags.parameter_yaml.full_name`), a name alone for a node without namespace, or
            :func:`ship_bags.parameter_yaml.in_any_namespace`.

    Raises:
        BadInput: the file cannot be read, is not a parameter file, has no section that matches the node, or has
            sections for the node in several namespaces.
    """
    name, sections = read_sections(source)
    fitting = _matching_sections(sections, node)
    if not fitting:
        _refuse_similar_sections(name, sections, node)
        expected = f"expected '{in_any_namespace(_base_name(node))}' or '/**', found {_section_names(sections)}"
        raise BadInput(f"no section for node '{_base_name(node)}': {expected}", file=name)
    exact = sorted({section.node for section in fitting if "*" not in section.node})
    if len(exact) > 1:
        reason = f"sections {' and '.join(exact)} both fit node '{_base_name(node)}': keep one in this file"
        raise BadInput(reason, file=name)
    return merge_sections(name, fitting)


def read_matching_sections(source: Path | str, node: str) -> ParameterFile:
    """Return the parameters of a node as :func:`read_node_parameters`, or no parameters if no section matches.

    Raises:
        BadInput: the file cannot be read or is not a parameter file.
    """
    name, sections = read_sections(source)
    return merge_sections(name, _matching_sections(sections, node))


def section_warning(source: Path | str, node: str) -> str:
    """Return a warning about a file whose sections do not match the node; otherwise an empty text.

    The warning also comes if only a wildcard section matches and another section was probably meant for the node.

    Raises:
        BadInput: the file cannot be read or is not a parameter file; or no section matches, but a section of (nearly)
            the same name was probably meant for the node.
    """
    name, sections = read_sections(source)
    fitting = _matching_sections(sections, node)
    if not fitting:
        _refuse_similar_sections(name, sections, node)
        return f"{name}: no section is for node '{node}', its sections are {_section_names(sections)}"
    misfits = _similar_sections(sections, node)
    if misfits and not any(_base_name(section.node) == _base_name(node) for section in fitting):
        return str(_wrong_section_error(name, misfits, node))
    return ""


def section_warnings(sources: Iterable[Path], node: str) -> list[str]:
    """Return the warnings about the files that a node was started with; see :func:`section_warning`.

    Raises:
        BadInput: as for :func:`section_warning`; rcl would silently ignore a section that does not match.
    """
    return [warning for source in sources if (warning := section_warning(source, node))]


def error_with_location(error: InputError, sources: Sequence[Path], node: str) -> BadInput:
    """Return the error with the file and line of its parameter.

    If several files give the parameter, the last of them is named.

    Args:
        error: error about a parameter of the node; any other error keeps its own file and line, if any.
        sources: files that the node was started with.
        node: full name.
    """
    if error.parameters and not error.file:
        parameter = error.parameters[0]
        files = [read_matching_sections(path, node) for path in reversed(sources)]
        naming = [file for file in files if parameter in file.lines] or [f for f in files if f.line_of(parameter)]
        if naming:
            return naming[0].error(error)
    return BadInput(
        error.reason, file=error.file, line=error.line, parameters=error.parameters, value=error.value
    )


def has_section(source: Path | str, node: str, wildcards: bool = True) -> bool:
    """Return True if a section with a node's name or, with ``wildcards``, a section for all nodes matches the node.

    Raises:
        BadInput: the file cannot be read or is not a parameter file.
    """
    _, sections = read_sections(source)
    return any(
        wildcards or _base_name(section.node) == _base_name(node) for section in _matching_sections(sections, node)
    )


def unknown_sections(source: Path | str, nodes: Collection[str]) -> list[str]:
    """Return the names of a file's sections that do not match any of the nodes, in order.

    Raises:
        BadInput: the file cannot be read or is not a parameter file.
    """
    _, sections = read_sections(source)
    return [section.node for section in sections if not any(_matches_node(section.node, node) for node in nodes)]


def _matches_node(pattern: str, node: str) -> bool:
    """Return True if rcl applies a section of that name to a node.

    ``/*`` stands for one part of a name, ``/**`` for any number of parts. For a node in any namespace, only the last
    parts of both names are compared.
    """
    if node.startswith(ANY_NAMESPACE):
        return _base_name(pattern) in (_base_name(node), "*", "**")
    expression = pattern.replace("/*", r"(/\w+)")
    return re.fullmatch(expression, node if node.startswith("/") else f"/{node}", re.ASCII) is not None


def _matching_sections(sections: list[Section], node: str) -> list[Section]:
    return [section for section in sections if _matches_node(section.node, node)]


def _similar_sections(sections: list[Section], node: str) -> list[Section]:
    """Return the sections that do not match a node but have its name, or else nearly its name."""
    others = [section for section in sections if not _matches_node(section.node, node)]
    same = [section for section in others if _base_name(section.node) == _base_name(node)]
    return same or [
        section for section in others if _similarity(_base_name(section.node), _base_name(node)) >= _MIN_SIMILARITY
    ]


def _similarity(one: str, other: str) -> float:
    """Return the similarity of two names: 1 if only capitals and underscores differ, 0 if nothing is common."""
    import difflib  # needed for errors only

    bare_one, bare_other = (name.replace("_", "").lower() for name in (one, other))
    return difflib.SequenceMatcher(None, bare_one, bare_other).ratio()


def _refuse_similar_sections(name: str, sections: list[Section], node: str) -> None:
    misfits = _similar_sections(sections, node)
    if misfits:
        raise _wrong_section_error(name, misfits, node)


def _wrong_section_error(name: str, misfits: list[Section], node: str) -> BadInput:
    """Return the error about a section that was probably meant for a node: both names, and the remedy."""
    first, last = misfits[0], _base_name(node)
    namespace = first.node.rpartition("/")[0]
    advice = f"name it '/**/{last}' to fit in every namespace"
    if _base_name(first.node) == last and "*" not in namespace:
        where = f"-r __ns:={namespace}, of a tool --namespace {namespace[1:]}" if namespace else "give it no namespace"
        advice += f", or run the node in that of the section ({where})"
    full = node if node.startswith("/") else f"/{node}"
    reason = f"section '{first.node}' does not fit node '{full}': {advice}"
    return BadInput(reason, file=name, line=first.line)


def _section_names(sections: list[Section]) -> str:
    return ", ".join(f"'{section.node}'" for section in sections) or "none"


def _base_name(name: str) -> str:
    return name.rpartition("/")[2]


@dataclass(frozen=True)
class Companion:
    """Node of a suite that is not an estimator.

    Attributes:
        node_name: name of the node and of its executable.
        package: package of the node.
        config: dataclass of the node's parameters, as ``"module:class"``.
        feeds: True if the node publishes topics that a played bag contains.
    """

    node_name: str
    package: str
    config: str
    feeds: bool = False

    @property
    def config_type(self) -> type[Any]:
        """Dataclass of the node's parameters.

        Raises:
            ImportError: the node's package is not installed.
        """
        module, _, name = self.config.partition(":")
        return cast(type[Any], getattr(importlib.import_module(module), name))


COMPANIONS = (
    Companion("nmea_in", "ship_nmea", "ship_nmea.instruments.config:NmeaInConfig", feeds=True),
    Companion("nmea_out", "ship_nmea", "ship_nmea.out.config:NmeaOutConfig"),
)


def configured_companions(source: Path | str, namespace: str = "") -> Iterator[Companion]:
    """Yield the companions for which a suite file has sections with their names.

    A section for all nodes (``/**``) does not count.

    Raises:
        BadInput: the file cannot be read or is not a parameter file.
    """
    for companion in COMPANIONS:
        if has_section(source, full_name(companion.node_name, namespace), wildcards=False):
            yield companion

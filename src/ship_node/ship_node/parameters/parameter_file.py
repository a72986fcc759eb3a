"""The parameters of one node out of a ROS 2 parameter file, and a configuration as such a file; without ROS.

A file holds sections ``node: {ros__parameters: {...}}``. Node names may be written with namespace, nested in
namespaces or with wildcards (``/**``, ``/**/name``, ``/*/name``). A section without any fits the node without namespace
alone, as in rcl; of several that fit, later ones override earlier ones.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import ANYWHERE, ParameterFile, Section, anywhere, merged, read_sections, sections_text
from ship_estimation.parameters import ParameterError, build, flatten, nest
from ship_geometry.input_error import InputError

Config = TypeVar("Config")

_NEARLY = 0.8
"""Likeness of two names from which on one may be the other misspelt: 'ship_attitude' and 'ship_attitude_node' have
0.86, 'ship_attitude' and 'star_attitude' 0.75."""


def load_config(kind: type[Config], source: Path | str, node: str) -> Config:
    """The checked configuration of a node; see :func:`read`.

    Raises:
        BadInput: names the file, the line, the parameter and what was expected.
    """
    file = read(source, node)
    try:
        return build(kind, file.values)
    except ParameterError as error:
        raise file.error(error) from error


def parameter_text(node_name: str, config: Any) -> str:
    """The text of a parameter file that gives a node this very configuration, in whatever namespace.

    All defaults are written out.

    Args:
        node_name: name without namespace.
        config: a dataclass in the style of :mod:`ship_estimation.parameters`.
    """
    return sections_text({anywhere(node_name): nest(flatten(config))})


def read(source: Path | str, node: str) -> ParameterFile:
    """The parameters of a node with their lines.

    Args:
        source: a path; a ``str`` is the text itself, whatever it holds.
        node: full name (:func:`full_name`), a name alone for one without namespace, or :func:`anywhere`.

    Raises:
        BadInput: the file cannot be read, is no parameter file, has no section that fits the node, or has sections
            for it in several namespaces.
    """
    name, sections = read_sections(source)
    fitting = _fitting(sections, node)
    if not fitting:
        _refuse_misfits(name, sections, node)
        expected = f"expected '{anywhere(_last(node))}' or '/**'"
        raise BadInput(f"no section for node '{_last(node)}': {expected}, found {_names(sections)}", file=name)
    exact = sorted({section.node for section in fitting if "*" not in section.node})
    if len(exact) > 1:
        reason = f"sections {' and '.join(exact)} both fit node '{_last(node)}': keep one in this file"
        raise BadInput(reason, file=name)
    return merged(name, fitting)


def read_whatever_fits(source: Path | str, node: str) -> ParameterFile:
    """As :func:`read` for a file that may be about other nodes.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    name, sections = read_sections(source)
    return merged(name, _fitting(sections, node))


def misfit(source: Path | str, node: str) -> str:
    """What a node must say about a file that it was started with; empty where a section fits it.

    Raises:
        BadInput: the file cannot be read or is no parameter file; or no section fits the node, but one has (nearly) the
            same name and was hardly meant for another.
    """
    name, sections = read_sections(source)
    fitting = _fitting(sections, node)
    if not fitting:
        _refuse_misfits(name, sections, node)
        return f"{name}: nothing in it is for node '{node}', its sections are {_names(sections)}"
    misfits = _misfits(sections, node)
    if misfits and not any(_last(section.node) == _last(node) for section in fitting):
        return str(_misfit(name, misfits, node))
    return ""


def misfit_warnings(sources: Iterable[Path], node: str) -> list[str]:
    """What a node must say about the files that it was started with; see :func:`misfit`.

    Raises:
        BadInput: see :func:`misfit`: rcl leaves out silently what does not fit.
    """
    return [warning for source in sources if (warning := misfit(source, node))]


def placed(error: InputError, sources: Sequence[Path], node: str) -> BadInput:
    """An error about a parameter with the file that gives it, the last one of several, and its line.

    Args:
        error: about a parameter of the node, or about something else.
        sources: files that the node was started with.
        node: full name.
    """
    if error.parameters and not error.file:
        parameter = error.parameters[0]
        files = [read_whatever_fits(path, node) for path in reversed(sources)]
        naming = [file for file in files if parameter in file.lines] or [f for f in files if f.line_of(parameter)]
        if naming:
            return naming[0].error(error)
    return BadInput(
        error.reason, file=error.file, line=error.line, parameters=error.parameters, value=error.value
    )


def has_section(source: Path | str, node: str, wildcards: bool = True) -> bool:
    """Whether a section fits a node: one of its name, or, with ``wildcards``, one for all nodes.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    _, sections = read_sections(source)
    return any(wildcards or _last(section.node) == _last(node) for section in _fitting(sections, node))


def unknown_sections(source: Path | str, nodes: Collection[str]) -> list[str]:
    """Names of a file's sections that fit none of some nodes, in order.

    Raises:
        BadInput: the file cannot be read or is no parameter file.
    """
    _, sections = read_sections(source)
    return [section.node for section in sections if not any(_fits(section.node, node) for node in nodes)]


def _fits(pattern: str, node: str) -> bool:
    """Whether rcl gives a section of that name to a node: ``/*`` is one part of a name, ``/**`` any number of them."""
    if node.startswith(ANYWHERE):
        return _last(pattern) in (_last(node), "*", "**")
    expression = pattern.replace("/*", r"(/\w+)")
    return re.fullmatch(expression, node if node.startswith("/") else f"/{node}", re.ASCII) is not None


def _fitting(sections: list[Section], node: str) -> list[Section]:
    return [section for section in sections if _fits(section.node, node)]


def _misfits(sections: list[Section], node: str) -> list[Section]:
    """Sections that do not fit a node, but have its name, or else nearly its name."""
    others = [section for section in sections if not _fits(section.node, node)]
    same = [section for section in others if _last(section.node) == _last(node)]
    return same or [section for section in others if _likeness(_last(section.node), _last(node)) >= _NEARLY]


def _likeness(one: str, other: str) -> float:
    """Likeness of two names: 1 where only capitals and underscores differ, 0 where they share nothing."""
    import difflib  # only an error needs it

    bare_one, bare_other = (name.replace("_", "").lower() for name in (one, other))
    return difflib.SequenceMatcher(None, bare_one, bare_other).ratio()


def _refuse_misfits(name: str, sections: list[Section], node: str) -> None:
    misfits = _misfits(sections, node)
    if misfits:
        raise _misfit(name, misfits, node)


def _misfit(name: str, misfits: list[Section], node: str) -> BadInput:
    """A section that was hardly meant for another node: both names, and what to do."""
    first, last = misfits[0], _last(node)
    namespace = first.node.rpartition("/")[0]
    advice = f"name it '/**/{last}' to fit in every namespace"
    if _last(first.node) == last and "*" not in namespace:
        where = f"-r __ns:={namespace}, of a tool --namespace {namespace[1:]}" if namespace else "give it no namespace"
        advice += f", or run the node in that of the section ({where})"
    full = node if node.startswith("/") else f"/{node}"
    reason = f"section '{first.node}' does not fit node '{full}': {advice}"
    return BadInput(reason, file=name, line=first.line)


def _names(sections: list[Section]) -> str:
    return ", ".join(f"'{section.node}'" for section in sections) or "none"


def _last(name: str) -> str:
    return name.rpartition("/")[2]

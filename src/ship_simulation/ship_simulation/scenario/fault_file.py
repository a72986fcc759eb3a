"""Reading of fault files, and checks of faults against the topics of a scenario or a bag."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from ship_bags.message_store import message_store
from ship_bags.parameter_yaml import read_nested_parameters
from ship_estimation.parameters.fields import mapping_of
from ship_estimation.parameters.schema import ParameterError, build
from ship_simulation.scenario.fault import Fault, size_problems
from ship_simulation.scenario.names import FIRST_VALUE, is_applicable

_STEP = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,6}|\*)\])?")
_NO_NUMBERS = ("string", "wstring", "bool")
_NESTED = {Nodetype.ARRAY, Nodetype.SEQUENCE}


@dataclass(frozen=True)
class FaultFile:
    """Content of a file of faults."""

    faults: dict[str, Fault] = mapping_of("faults by name")


def load_faults(source: Path | str, topics: Mapping[str, str], location: str) -> dict[str, Fault]:
    """Return the checked faults of a file.

    Args:
        source: YAML file with a group ``faults`` as in a scenario; a ``str`` is the text itself.
        topics: topic → type of the topics that faults may affect.
        location: words for the location of these topics in an error, as ``in the bag``.

    Raises:
        BadInput: the file is invalid; the error states file, line, key, value and the expected value.
    """
    file = read_nested_parameters(source)
    try:
        faults = build(FaultFile, file.values).faults
        if not faults:
            raise ParameterError("parameter 'faults' must be a group with at least one fault", "faults")
        for problem in fault_problems(faults, topics, location):
            raise problem
    except ParameterError as problem:
        raise file.error(problem) from problem
    return faults


def fault_problems(faults: Mapping[str, Fault], topics: Mapping[str, str], location: str) -> Iterator[ParameterError]:
    """Yield the inconsistencies of faults whose single values are valid."""
    for name, fault in faults.items():
        key = f"faults.{name}"
        yield from size_problems(key, fault)
        if fault.topic not in topics:
            known = ", ".join(topics)
            text = f"'{key}.topic' = {fault.topic} is not {location}: expected one of {known}"
            yield ParameterError(text, f"{key}.topic")
            continue
        type_name = topics[fault.topic]
        if not is_applicable(fault.kind, type_name):
            yield ParameterError(f"'{key}.kind' = {fault.kind} does not apply to {type_name}", f"{key}.kind")
        if "field" in fault.sizes:
            problem = _field_problem(fault, type_name)
            if problem:
                yield ParameterError(f"'{key}.field' = {fault.field}: {problem}", f"{key}.field")


def field_steps(path: str) -> list[tuple[str, str]]:
    """Return (name, index) of each part of a field's path; the index is a number, ``*`` or empty.

    Raises:
        ValueError: the text is not a path.
    """
    parts = [_STEP.fullmatch(part) for part in path.split(".")]
    if any(part is None for part in parts):
        raise ValueError("not a field path such as orientation.x, covariance[4], stars[*].u")
    return [(part[1], part[2] or "") for part in parts if part is not None]


def numeric_fields(type_name: str) -> dict[str, str]:
    """Return path → type (``float64``) of each number in a message; a list or array has its first element only."""
    found: dict[str, str] = {}
    fields: dict[str, Any] = dict(message_store().fielddefs[type_name][1])
    for name, (node, content) in fields.items():
        path = name
        if node in _NESTED:
            (node, content), path = content[0], f"{name}[0]"
        if node == Nodetype.NAME:
            found |= {f"{path}.{inner}": base for inner, base in numeric_fields(content).items()}
        elif content[0] not in _NO_NUMBERS:
            found[path] = content[0]
    return found


def _field_problem(fault: Fault, type_name: str) -> str:
    """Return the reason why a fault's field cannot be set to a number; empty if it can be set."""
    if not fault.field:
        return "" if type_name in FIRST_VALUE else f"must be given for {type_name}"
    try:
        base = _base_type(field_steps(fault.field), type_name)
    except ValueError as problem:
        return str(problem)
    if base.startswith("float"):
        largest = float(np.finfo(base).max)
        fits = abs(fault.value) <= largest
        return "" if fits else f"value = {fault.value:g} is too large: the maximum of {base} is {largest:g}"
    if fault.kind != "corrupt":
        return f"an integer field ({base}) allows no NaN, infinity or offset: use corrupt"
    limits = np.iinfo(base)
    if not (fault.value.is_integer() and limits.min <= fault.value <= limits.max):
        return f"value = {fault.value:g} is out of range: expected an integer from {limits.min} to {limits.max}"
    return ""


def _base_type(steps: list[tuple[str, str]], type_name: str) -> str:
    """Return the type of the number at a path.

    Raises:
        ValueError: there is no number at the path.
    """
    for number, (name, index) in enumerate(steps):
        fields: dict[str, Any] = dict(message_store().fielddefs[type_name][1])
        if name not in fields:
            raise ValueError(f"{type_name} has no field {name}: expected one of {', '.join(fields)}")
        node, content = fields[name]
        if node in _NESTED:
            (node, content), length = content
            if node == Nodetype.BASE and not index:
                raise ValueError(f"{name} has several elements: expected {name}[0] or {name}[*]")
            if index.isdecimal() and 0 < length <= int(index):
                raise ValueError(f"{name} has {length} elements, starting at 0")
        elif index:
            raise ValueError(f"{name} is a single value: expected no [{index}]")
        last = number + 1 == len(steps)
        if node == Nodetype.NAME and not last:
            type_name = content
        elif node == Nodetype.NAME or not last or content[0] in _NO_NUMBERS:
            raise ValueError("not the path of a number")
        else:
            return str(content[0])
    raise ValueError("not the path of a number")

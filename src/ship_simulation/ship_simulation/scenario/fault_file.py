"""Reads files of faults, and checks faults against the topics that they are about, of a scenario or of a bag."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from ship_bags.message_store import message_store
from ship_bags.parameter_yaml import read_plain
from ship_estimation.parameter_fields import mapping_of
from ship_estimation.parameters import ParameterError, build
from ship_simulation.scenario.fault import Fault, size_problems
from ship_simulation.scenario.names import FIRST_VALUE, can_happen

_STEP = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,6}|\*)\])?")
_NO_NUMBERS = ("string", "wstring", "bool")
_NESTED = {Nodetype.ARRAY, Nodetype.SEQUENCE}


@dataclass(frozen=True)
class FaultFile:
    """What a file of faults says."""

    faults: dict[str, Fault] = mapping_of("faults by name")


def load_faults(source: Path | str, topics: Mapping[str, str], place: str) -> dict[str, Fault]:
    """The checked faults of a file.

    Args:
        source: YAML file with a group ``faults`` as a scenario has it; a ``str`` is the text itself.
        topics: topic → type of those that faults may be about.
        place: what has these topics, for the message: ``in the bag``.

    Raises:
        BadInput: names file, line, key, value and what was expected.
    """
    file = read_plain(source)
    try:
        faults = build(FaultFile, file.values).faults
        if not faults:
            raise ParameterError("parameter 'faults' must be a group with at least one fault", "faults")
        for problem in fault_problems(faults, topics, place):
            raise problem
    except ParameterError as problem:
        raise file.error(problem) from problem
    return faults


def fault_problems(faults: Mapping[str, Fault], topics: Mapping[str, str], place: str) -> Iterator[ParameterError]:
    """What is wrong with faults although each value for itself is right."""
    for name, fault in faults.items():
        key = f"faults.{name}"
        yield from size_problems(key, fault)
        if fault.topic not in topics:
            known = ", ".join(topics)
            text = f"'{key}.topic' = {fault.topic} is not {place}: expected one of {known}"
            yield ParameterError(text, f"{key}.topic")
            continue
        type_name = topics[fault.topic]
        if not can_happen(fault.kind, type_name):
            yield ParameterError(f"'{key}.kind' = {fault.kind} cannot happen to {type_name}", f"{key}.kind")
        if "field" in fault.sizes:
            problem = _field_problem(fault, type_name)
            if problem:
                yield ParameterError(f"'{key}.field' = {fault.field}: {problem}", f"{key}.field")


def field_steps(path: str) -> list[tuple[str, str]]:
    """(name, index) of each part of a field's path; the index is a number, ``*`` or empty.

    Raises:
        ValueError: it is no path.
    """
    parts = [_STEP.fullmatch(part) for part in path.split(".")]
    if any(part is None for part in parts):
        raise ValueError("no path of a field such as orientation.x, covariance[4], stars[*].u")
    return [(part[1], part[2] or "") for part in parts if part is not None]


def numeric_fields(type_name: str) -> dict[str, str]:
    """Path → type (``float64``) of each number in a message; of a list of messages, and of an array, the first."""
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
    """Why a fault's field cannot be set to a number; empty where it can."""
    if not fault.field:
        return "" if type_name in FIRST_VALUE else f"must be given for {type_name}"
    try:
        base = _base_type(field_steps(fault.field), type_name)
    except ValueError as problem:
        return str(problem)
    if base.startswith("float"):
        largest = float(np.finfo(base).max)
        fits = abs(fault.value) <= largest
        return "" if fits else f"value = {fault.value:g} does not fit: {base} ends at {largest:g}"
    if fault.kind != "corrupt":
        return f"a whole number ({base}), which has no NaN, no infinity and no offset: corrupt sets it"
    limits = np.iinfo(base)
    if not (fault.value.is_integer() and limits.min <= fault.value <= limits.max):
        return f"value = {fault.value:g} does not fit: expected a whole number from {limits.min} to {limits.max}"
    return ""


def _base_type(steps: list[tuple[str, str]], type_name: str) -> str:
    """The type of the number at a path.

    Raises:
        ValueError: there is none.
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
                raise ValueError(f"{name} has {length} elements, counted from 0")
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

"""Functions to build, check, describe, flatten and change configurations that are frozen dataclasses.

The fields of a configuration are declared by :mod:`ship_estimation.parameters.fields`. Nested dataclasses and
``dict[str, Dataclass]`` (one entry per sensor id) give dotted names such as ``star_sensors.fore.elevation_deg``.
:func:`build` makes a configuration from a nested mapping (a ROS parameter file). :func:`describe` lists every parameter
for the node, for ``check_config`` and for the documentation; :func:`parameter_row` and :func:`wrapped_lines` give the
descriptions as rows of text, for ``--help``.
"""

import dataclasses
import math
import re
import textwrap
import types
import typing
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from ship_geometry.input_error import InputError

Config = TypeVar("Config")

_ID = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_MAX_NAMES = 8
_CLOSEST_COUNT = 3
"""Number of closest names in an error text if there are more than :data:`_MAX_NAMES`."""

_WIDTH = 120

_WIDEST = 24
"""Maximum width of a column between the first and the last; a wider cell does not widen the column."""

_BELOW = " " * 6


class ParameterError(InputError):
    """Error of a parameter, for example an unknown name, a missing parameter or a value out of its range.

    The text names the parameter; ``parameters`` has the dotted names, and ``value`` the refused value.
    """

    def __init__(self, reason: str, *parameters: str, value: Any = None) -> None:
        super().__init__(reason, parameters=parameters, value=value)


@dataclasses.dataclass(frozen=True)
class ParameterDescription:
    """Description of one parameter; in its dotted name ``<id>`` stands for any key of a mapping.

    A default of None means that the parameter must be given.
    """

    name: str
    kind: type
    default: Any
    doc: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    live: bool


def build(kind: type[Config], values: Mapping[str, Any], prefix: str = "", placeholder: str = "") -> Config:
    """Return a checked configuration from a nested mapping.

    Args:
        kind: dataclass of the configuration.
        values: nested mapping.
        prefix: prefix of the names in error texts.
        placeholder: text that is accepted as an id and stands for all ids in a help text.

    Raises:
        ParameterError: a parameter is unknown or missing, or its value is not allowed. The text names the parameter and
            what was expected.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> build(GateConfig, {"conflict_after": 3}).conflict_after
        3
        >>> build(GateConfig, {"conflict_after": 0})
        Traceback (most recent call last):
        ship_estimation.parameters.schema.ParameterError: parameter 'conflict_after' = 0 is out of its range [1, inf]
    """
    if not isinstance(values, Mapping):
        raise ParameterError(
            f"parameter '{prefix.rstrip('.')}' must be a group of parameters, got {values!r}",
            prefix.rstrip("."),
            value=values,
        )
    hints = typing.get_type_hints(kind)
    fields = {_name(field): field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for name in values:
        if name not in fields:
            reason = f"parameter '{prefix}{name}' is unknown: {_expected_names(str(name), fields)}"
            raise ParameterError(reason, f"{prefix}{name}", value=values[name])
    arguments: dict[str, Any] = {}
    for name, field in fields.items():
        full_name, hint = prefix + name, hints[field.name]
        entry = _mapping_entry(hint)
        if entry is not None:
            group = values.get(name, {})
            if not isinstance(group, Mapping):
                reason = f"parameter '{full_name}' must be a group of parameters, got {group!r}"
                raise ParameterError(reason, full_name, value=group)
            arguments[field.name] = {
                key: build(entry, group[key], f"{full_name}.{key}.", placeholder)
                for key in _ids(full_name, group, placeholder)
            }
        elif dataclasses.is_dataclass(hint):
            arguments[field.name] = build(typing.cast(type, hint), values.get(name, {}), full_name + ".", placeholder)
        elif name in values:
            arguments[field.name] = _check_value(full_name, values[name], hint, field.metadata)
        elif field.default is dataclasses.MISSING:
            raise ParameterError(f"parameter '{full_name}' ({field.metadata['doc']}) must be given", full_name)
    return kind(**arguments)


def describe(kind: type, prefix: str = "") -> Iterator[ParameterDescription]:
    """Yield the description of every parameter of a configuration dataclass, in order of declaration.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> [(one.name, one.default) for one in describe(GateConfig)][:2]
        [('probability', 0.9999), ('conflict_after', 10)]
    """
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        name = prefix + _name(field)
        entry = _mapping_entry(hints[field.name])
        if entry is not None:
            yield from describe(entry, name + ".<id>.")
        elif dataclasses.is_dataclass(hints[field.name]):
            yield from describe(typing.cast(type, hints[field.name]), name + ".")
        else:
            default = None if field.default is dataclasses.MISSING else field.default
            yield ParameterDescription(name=name, kind=hints[field.name], default=default, **field.metadata)


def flatten(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return the values of a configuration by dotted name; tuples become lists.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> flatten(GateConfig(), prefix="gate.")["gate.reopen_factor"]
        100.0
    """
    leaves = _leaves(config, prefix)
    return {name: list(value) if isinstance(value, tuple) else value for name, value, _ in leaves}


def with_changes(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return a configuration after changes of live parameters, which are given by dotted name.

    Raises:
        ParameterError: a parameter is unknown, has a value that is not allowed, or can be set only at the start.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> with_changes(GateConfig(), {"probability": 0.999}).probability
        0.999
    """
    flat = flatten(config)
    live = {name for name, _, field in _leaves(config) if field.metadata["live"]}
    for name in changes:
        if name not in flat:
            raise ParameterError(f"parameter '{name}' is unknown: {_suggestion(name, flat)}", name)
        if name not in live:
            raise ParameterError(
                f"parameter '{name}' cannot be changed while the node runs: set it at the start", name
            )
    return build(type(config), nest({**flat, **changes}))


def _name(field: "dataclasses.Field[Any]") -> str:
    """Return the parameter name of a field, without the underscore that follows a Python keyword, as in ``from_``."""
    return field.name.removesuffix("_")


def _leaves(config: Any, prefix: str = "") -> Iterator[tuple[str, Any, "dataclasses.Field[Any]"]]:
    """Yield dotted name, value and field of every parameter of a configuration."""
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), prefix + _name(field)
        if isinstance(value, dict):
            for key, entry in value.items():
                yield from _leaves(entry, f"{name}.{key}.")
        elif dataclasses.is_dataclass(value):
            yield from _leaves(value, name + ".")
        else:
            yield name, value, field


def nest(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested mapping of values that are given by dotted name.

    Raises:
        ParameterError: a name before the last dot already has a value.

    Example:
        >>> nest({"gate.probability": 0.999, "gate.reopen_after": 5})
        {'gate': {'probability': 0.999, 'reopen_after': 5}}
    """
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *groups, leaf = name.split(".")
        level = nested
        for group in groups:
            level = level.setdefault(group, {})
            if not isinstance(level, dict):
                raise ParameterError(f"parameter '{name}': '{group}' is a value, not a group", name, value=value)
        level[leaf] = value
    return nested


def _suggestion(name: str, known: Iterable[str]) -> str:
    """Return the text with the most similar dotted name or, without one, with the command that lists all names."""
    import difflib  # only an error needs it

    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else "see ros2 param list"


def _expected_names(name: str, known: Collection[str]) -> str:
    """Return the text with all expected names, or the closest three of more than eight, and the name probably meant.

    Example:
        >>> _expected_names("colour", ["gate", "lever_m"])
        'expected one of gate, lever_m'
        >>> _expected_names("lagg_s", ["gate", "lag_s", "sky", *(f"other_{number}" for number in range(20))])
        "expected one of lag_s, sky, gate or 20 others; did you mean 'lag_s'?"
    """
    import difflib  # only an error needs it

    near = difflib.get_close_matches(name, known, n=1)
    named, others = sorted(known), len(known) - _CLOSEST_COUNT
    if len(known) > _MAX_NAMES:
        named = sorted(named, key=lambda one: difflib.SequenceMatcher(None, name, one).ratio(), reverse=True)[
            :_CLOSEST_COUNT
        ]
    text = f"expected one of {', '.join(named)}" + (f" or {others} others" if len(known) > _MAX_NAMES else "")
    return text + "".join(f"; did you mean '{meant}'?" for meant in near)


def _ids(name: str, group: Mapping[Any, Any], placeholder: str) -> list[str]:
    """Return the ids of a group of devices, sorted.

    Raises:
        ParameterError: an id cannot be part of a topic name.
    """
    for id_ in group:
        if not (isinstance(id_, str) and (id_ == placeholder or _ID.fullmatch(id_))):
            raise ParameterError(
                f"parameter '{name}.{id_}': {id_!r} cannot be an id: expected letters, digits and _, no digit first, "
                "because it becomes part of topic names",
                f"{name}.{id_}",
                value=id_,
            )
    return sorted(group)


def _mapping_entry(hint: Any) -> type | None:
    """Return the dataclass of a ``dict[str, Dataclass]``, otherwise None."""
    return typing.get_args(hint)[1] if typing.get_origin(hint) is dict else None


def _check_value(name: str, value: Any, hint: Any, metadata: types.MappingProxyType[Any, Any]) -> Any:
    if typing.get_origin(hint) is tuple:
        element = typing.get_args(hint)[0]
        length = None if typing.get_args(hint)[-1] is Ellipsis else len(typing.get_args(hint))
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise ParameterError(f"parameter '{name}' must be a list, got {value!r}", name, value=value)
        elements = tuple(_check_scalar(name, v, element, metadata, f"[{i}]") for i, v in enumerate(value))
        if length is not None and len(elements) != length:
            reason = f"parameter '{name}' must have {length} elements, got {len(elements)}"
            raise ParameterError(reason, name, value=value)
        return elements
    return _check_scalar(name, value, hint, metadata)


def _check_scalar(
    name: str, value: Any, kind: type, metadata: types.MappingProxyType[Any, Any], index: str = ""
) -> Any:
    """Return a value checked for type, range and choices; ``index`` is shown after the name.

    Raises:
        ParameterError: the value is not allowed.
    """
    shown = f"parameter '{name}{index}'"
    wrong_type = isinstance(value, bool) != (kind is bool) or not isinstance(
        value, (int, float) if kind is float else kind
    )
    unit = f" {metadata['unit']}" if metadata["unit"] else ""
    if wrong_type:
        raise ParameterError(f"{shown} must be of type {kind.__name__}, got {value!r}", name, value=value)
    if kind is float:
        value = float(value)
        if not math.isfinite(value):
            raise ParameterError(f"{shown} must be finite, got {value}", name, value=value)
    low, high = metadata["minimum"], metadata["maximum"]
    if (low is not None and value < low) or (high is not None and value > high):
        allowed = f"[{'-inf' if low is None else low}, {'inf' if high is None else high}]{unit}"
        raise ParameterError(f"{shown} = {value}{unit} is out of its range {allowed}", name, value=value)
    if metadata["choices"] and value not in metadata["choices"]:
        raise ParameterError(
            f"{shown} = {value!r} must be one of {', '.join(metadata['choices'])}", name, value=value
        )
    return value


def key_rows(kind: type) -> list[str]:
    """Return the keys of a YAML file with nested groups as lines: name, unit, default, range or choices, description.

    Args:
        kind: dataclass into which the file is read.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> key_rows(GateConfig)[1].split()[:4]
        ['conflict_after*', '-', '10', '[1,']
    """
    return wrapped_lines([parameter_row(description) for description in describe(kind)])


def parameter_row(description: ParameterDescription) -> tuple[str, ...]:
    """Return name, unit, default, range or choices, and description of a parameter; a star marks a live parameter.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> parameter_row(next(iter(describe(GateConfig))))[:4]
        ('probability*', '-', '0.9999', '[0.5, 0.999999999]')
    """
    default = "must be given" if description.default is None else f"{description.default!r}"
    allowed = " | ".join(description.choices)
    if description.minimum is not None or description.maximum is not None:
        low = "-inf" if description.minimum is None else f"{description.minimum:.12g}"
        high = "inf" if description.maximum is None else f"{description.maximum:.12g}"
        allowed = f"[{low}, {high}]"
    live = "*" if description.live else ""
    return description.name + live, description.unit or "-", default, allowed, description.doc


def aligned_lines(rows: list[tuple[str, ...]]) -> list[str]:
    """Return rows of cells as lines of text with aligned columns; the last column is not padded.

    Example:
        >>> aligned_lines([("heading", "deg"), ("sigma", "arcsec")])
        ['  heading  deg', '  sigma    arcsec']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)) for row in rows]
    return ["  " + line.rstrip() for line in lines]


def wrapped_lines(rows: list[tuple[str, ...]]) -> list[str]:
    """Return aligned lines of at most 120 characters; a last cell that does not fit is wrapped on the next lines.

    Example:
        >>> for line in wrapped_lines([("heading", "deg", "true"), ("sigma", "arcsec", "of the heading, " * 7)]):
        ...     print(line[:40])
          heading  deg     true
          sigma    arcsec
              of the heading, of the heading, of
    """
    first, *others = [max(map(len, column)) for column in zip(*rows, strict=True)]
    widths = [first, *(min(width, _WIDEST) for width in others[:-1])]
    lines = []
    for *head, last in rows:
        begin = "  " + "  ".join(f"{cell:{width}}" for cell, width in zip(head, widths, strict=True))
        line = f"{begin}  {last}".rstrip()
        lines += [line] if len(line) <= _WIDTH else [*_wrap(begin, ""), *_wrap(last, _BELOW)]
    return lines


def _wrap(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        text, _WIDTH, initial_indent=indent, subsequent_indent=_BELOW, break_long_words=False, break_on_hyphens=False
    )

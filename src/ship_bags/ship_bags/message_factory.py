"""Messages by the name of their type, so that an adapter needs to know no middleware."""

import array
import functools
import importlib
import re
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

_TYPE_CODES = {
    "double": "d",
    "float": "f",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
}
"""Code of each type of number, the same for array.array and numpy."""

_SCALARS: dict[str, Callable[[Any], Any]] = {"boolean": bool, "octet": lambda level: bytes([level]), "string": str}
_SCALARS |= {name: float if name in ("double", "float") else int for name in _TYPE_CODES}


class MessageFactory(Protocol):
    """Makes messages from field values."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """A message with every field given by keyword.

        Args:
            type_name: as ``"ship_msgs/msg/ShipAttitude"``.
            fields: numbers, texts, 1-D numpy arrays for arrays of numbers, lists of texts, messages made before
                and lists of such; a field of type ``byte`` takes an int.

        Raises:
            TypeError: a field is missing or unknown.
        """
        ...


class RosidlFactory:
    """Makes the messages that rclpy publishes."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """See :meth:`MessageFactory.make`."""
        message_class, converters = _message_plan(type_name)
        if fields.keys() != converters.keys():
            missing, unknown = converters.keys() - fields.keys(), fields.keys() - converters.keys()
            raise TypeError(f"{type_name}: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")
        return message_class(**{name: converters[name](value) for name, value in fields.items()})


def message_class(type_name: str) -> Any:
    """The rosidl class of a message or service.

    Raises:
        ImportError: its package is not installed or holds no such type.
    """
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except AttributeError as error:
        raise ImportError(f"package {package} has no {kind} {name}") from error


@functools.cache
def _message_plan(type_name: str) -> tuple[Any, dict[str, Callable[[Any], Any]]]:
    """Class of a message and, for each field, what turns a plain value into what rosidl accepts."""
    kind = message_class(type_name)
    return kind, {name: _converter(text) for name, text in kind.get_fields_and_field_types().items()}


def _converter(field_type: str) -> Callable[[Any], Any]:
    if field_type in _SCALARS:
        return _SCALARS[field_type]
    if match := re.fullmatch(r"(\w+)\[\d+\]", field_type):
        if match[1] in _TYPE_CODES:
            return functools.partial(np.asarray, dtype=_TYPE_CODES[match[1]])
        return list
    if match := re.fullmatch(r"sequence<([\w/]+)(?:, \d+)?>", field_type):
        if match[1] in _TYPE_CODES:
            return functools.partial(_as_array, _TYPE_CODES[match[1]])
        return list
    return _unchanged


def _as_array(type_code: str, values: Any) -> "array.array[Any]":
    """An array.array, which rosidl takes without looking at each element."""
    return array.array(type_code, np.asarray(values, dtype=type_code).tobytes())


def _unchanged(value: Any) -> Any:
    return value

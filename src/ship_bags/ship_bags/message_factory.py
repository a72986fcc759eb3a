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

_STAMP = "builtin_interfaces/msg/Time"
_NS_PER_S = 1_000_000_000

_SCALARS: dict[str, Callable[[Any], Any]] = {"boolean": bool, "octet": lambda level: bytes([level]), "string": str}
_SCALARS |= {name: float if name in ("double", "float") else int for name in _TYPE_CODES}


class MessageFactory(Protocol):
    """Makes messages from field values."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """A message with every field given by keyword.

        Args:
            type_name: as ``"ship_msgs/msg/ShipAttitude"``.
            fields: numbers, texts, 1-D numpy arrays for arrays of numbers, lists of texts. A field that is a message is
                given as a dict of its own fields, or as a message made before; a list of messages likewise. A stamp is
                given as integer ns of POSIX UTC, a field of type ``byte`` as an int.

        Raises:
            TypeError: a field is missing or unknown.
        """
        ...


class RosidlFactory:
    """Makes the messages that rclpy publishes."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """See :meth:`MessageFactory.make`."""
        return _rosidl_message(type_name, **fields)


def nested(make: Callable[..., Any], type_name: str) -> Callable[[Any], Any]:
    """The converter of a field that is itself a message.

    Args:
        make: as :meth:`MessageFactory.make`.
        type_name: type of the field.

    Returns:
        A function that makes a message of a dict of fields, or of ns where the field is a stamp. A message made before
        is left as it is.
    """

    def convert(value: Any) -> Any:
        if isinstance(value, dict):
            return make(type_name, **value)
        if type_name == _STAMP and isinstance(value, (int, np.integer)):
            sec, nanosec = divmod(value, _NS_PER_S)
            return make(type_name, sec=sec, nanosec=nanosec)
        return value

    return convert


def list_of(convert: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The converter of a field that is a list, each element of which ``convert`` converts."""
    return lambda values: [convert(value) for value in values]


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


def _rosidl_message(type_name: str, **fields: Any) -> Any:
    kind, converters = _message_plan(type_name)
    if fields.keys() != converters.keys():
        missing, unknown = converters.keys() - fields.keys(), fields.keys() - converters.keys()
        raise TypeError(f"{type_name}: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")
    return kind(**{name: converters[name](value) for name, value in fields.items()})


@functools.cache
def _message_plan(type_name: str) -> tuple[Any, dict[str, Callable[[Any], Any]]]:
    """Class of a message and, for each field, what turns a plain value into what rosidl accepts."""
    kind = message_class(type_name)
    return kind, {name: _converter(text) for name, text in kind.get_fields_and_field_types().items()}


def _converter(field_type: str) -> Callable[[Any], Any]:
    if field_type in _SCALARS:
        return _SCALARS[field_type]
    if match := re.fullmatch(r"([\w/]+)\[\d+\]", field_type):
        if match[1] in _TYPE_CODES:
            return functools.partial(np.asarray, dtype=_TYPE_CODES[match[1]])
        return _list_converter(match[1])
    if match := re.fullmatch(r"sequence<([\w/]+)(?:, \d+)?>", field_type):
        if match[1] in _TYPE_CODES:
            return functools.partial(_as_array, _TYPE_CODES[match[1]])
        return _list_converter(match[1])
    return _message_converter(field_type)


def _list_converter(element_type: str) -> Callable[[Any], Any]:
    return list_of(_message_converter(element_type)) if "/" in element_type else list


def _message_converter(field_type: str) -> Callable[[Any], Any]:
    """Of a field that is a message, whose type rosidl writes as ``std_msgs/Header``."""
    return nested(_rosidl_message, field_type.replace("/", "/msg/"))


def _as_array(type_code: str, values: Any) -> "array.array[Any]":
    """An array.array, which rosidl takes without looking at each element."""
    return array.array(type_code, np.asarray(values, dtype=type_code).tobytes())

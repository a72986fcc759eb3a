"""Factories of messages by the name of their type, so that an adapter does not depend on a middleware."""

import abc
import array
import functools
import importlib
import re
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from ship_bags.cdr_encoder import STAMP, CdrEncoder
from ship_bags.cdr_template import CdrMessage, CdrRows, Definition, FieldType

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
"""Code of each numeric type, the same for array.array and numpy."""

_ARRAY_TYPE = re.compile(r"([\w/]+)\[(\d+)\]|sequence<([\w/]+)(?:, \d+)?>")
"""Pattern of an array or a sequence type as rosidl writes it."""

_NS_PER_S = 1_000_000_000

_SCALARS: dict[str, Callable[[Any], Any]] = {"boolean": bool, "octet": lambda level: bytes([level]), "string": str}
_SCALARS |= {name: float if name in ("double", "float") else int for name in _TYPE_CODES}


_ELEMENTS = _TYPE_CODES | {"boolean": "?", "string": "string"}
"""Codes of the elements in templates; a byte has no code, because it is bytes in rclpy and a number in rosbags."""


class MessageFactory(Protocol):
    """Interface of a factory that makes messages from field values."""

    def make(self, type_name: str, **fields: Any) -> Any:
        """Return a message; every field must be given by keyword.

        Args:
            type_name: name of the type, as ``"ship_msgs/msg/ShipAttitude"``.
            fields: numbers, texts, 1-D numpy arrays for arrays of numbers, lists of texts. A field that is a message is
                given as a dict of its fields, or as a message made before. A list of messages is given as a list of
                such values. A stamp is given as integer ns of POSIX UTC, a field of type ``byte`` as an int.

        Raises:
            TypeError: a field is missing or unknown.
        """
        ...

    def encode(self, type_name: str, **fields: Any) -> CdrMessage:
        """Return an encoded message from the fields of :meth:`make`; a nested message is given as a dict.

        This takes a fraction of the time of :meth:`make`, because no message object is made.

        Raises:
            TypeError: a field is missing, unknown or of a type without template, or an array has the wrong length.
        """
        ...

    def encode_rows(self, type_name: str, count: int, **fields: Any) -> CdrRows:
        """Return ``count`` encoded messages from the fields of :meth:`encode`.

        Texts and lengths of sequences are the same in all messages. A number or a stamp is given as an array with one
        value per message. An array of n numbers is given with shape (n, count). A value that is the same in all
        messages may be given once.

        Raises:
            TypeError: as for :meth:`encode`.
        """
        ...


Converters = dict[str, Callable[[Any], Any] | None]
"""Field name → converter of a plain value to a value that the message class accepts; None if none is needed."""


class PlannedFactory(abc.ABC):
    """Factory that determines the class and the field converters of each type once.

    See :class:`MessageFactory`.
    """

    def __init__(self) -> None:
        self._plans: dict[str, tuple[Any, Converters]] = {}
        self._encoder = CdrEncoder(self.definition)

    def make(self, type_name: str, **fields: Any) -> Any:
        """See :meth:`MessageFactory.make`."""
        plan = self._plans.get(type_name)
        if plan is None:
            plan = self._plans[type_name] = self.plan(type_name)
        kind, converters = plan
        if fields.keys() != converters.keys():
            missing, unknown = converters.keys() - fields.keys(), fields.keys() - converters.keys()
            raise TypeError(f"{type_name}: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")
        for name, convert in converters.items():
            if convert is not None:
                fields[name] = convert(fields[name])
        return kind(**fields)

    def encode(self, type_name: str, **fields: Any) -> CdrMessage:
        """See :meth:`MessageFactory.encode`."""
        return self._encoder.encode(type_name, fields)

    def encode_rows(self, type_name: str, count: int, **fields: Any) -> CdrRows:
        """See :meth:`MessageFactory.encode_rows`."""
        return self._encoder.encode_rows(type_name, count, fields)

    @abc.abstractmethod
    def definition(self, type_name: str) -> Definition:
        """Return the fields of a type, in order.

        Raises:
            TypeError: a field has a type without template.
        """

    @abc.abstractmethod
    def plan(self, type_name: str) -> tuple[Any, Converters]:
        """Return the class of a message type and the converters of its fields."""

    def message_converter(self, type_name: str) -> Callable[[Any], Any]:
        """Return the converter of a field that is a message or a stamp. A message made before is not converted."""

        def convert(value: Any) -> Any:
            if isinstance(value, dict):
                return self.make(type_name, **value)
            if type_name == STAMP and isinstance(value, (int, np.integer)):
                sec, nanosec = divmod(value, _NS_PER_S)
                return self.make(type_name, sec=sec, nanosec=nanosec)
            return value

        return convert

    def list_converter(self, type_name: str) -> Callable[[Any], Any]:
        """Return the converter of a field that is a list of messages."""
        convert = self.message_converter(type_name)
        return lambda values: [convert(value) for value in values]


class RosidlFactory(PlannedFactory):
    """Factory of the messages that rclpy publishes."""

    def plan(self, type_name: str) -> tuple[Any, Converters]:
        """See :meth:`PlannedFactory.plan`."""
        kind = message_class(type_name)
        return kind, {name: self._converter(text) for name, text in kind.get_fields_and_field_types().items()}

    def definition(self, type_name: str) -> Definition:
        """See :meth:`PlannedFactory.definition`."""
        texts = message_class(type_name).get_fields_and_field_types()
        return {name: _field_type(text) for name, text in texts.items()}

    def _converter(self, field_type: str) -> Callable[[Any], Any]:
        """Return the converter of a field type as rosidl writes it.

        Examples are ``double[9]``, ``sequence<string>``, ``std_msgs/Header``.
        """
        if field_type in _SCALARS:
            return _SCALARS[field_type]
        if match := _ARRAY_TYPE.fullmatch(field_type):
            fixed, _, dynamic = match.groups()
            if fixed in _TYPE_CODES:
                return functools.partial(np.asarray, dtype=_TYPE_CODES[fixed])
            if dynamic in _TYPE_CODES:
                return functools.partial(_as_array, _TYPE_CODES[dynamic])
            element = fixed or dynamic
            return self.list_converter(element.replace("/", "/msg/")) if "/" in element else list
        return self.message_converter(field_type.replace("/", "/msg/"))


def _field_type(text: str) -> FieldType:
    """Return the field type that a text of rosidl describes."""
    match = _ARRAY_TYPE.fullmatch(text)
    fixed, count, dynamic = match.groups() if match else (text, None, None)
    name = str(fixed or dynamic)
    element = name.replace("/", "/msg/") if "/" in name else _ELEMENTS.get(name)
    if element is None:
        raise TypeError(f"there is no template for a field of type {text}")
    return FieldType(element, int(count) if count else None, dynamic is not None)


def message_class(type_name: str) -> Any:
    """Return the rosidl class of a message or service.

    Raises:
        ImportError: the package is not installed or has no such type.
    """
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except AttributeError as error:
        raise ImportError(f"package {package} has no {kind} {name}") from error


def _as_array(type_code: str, values: Any) -> "array.array[Any]":
    """Return an array.array, which rosidl accepts without checking each element."""
    return array.array(type_code, np.asarray(values, dtype=type_code).tobytes())

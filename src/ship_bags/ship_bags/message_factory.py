"""Messages by the name of their type: factories for objects of a middleware or CDR bytes, and a reader of CDR bytes.

An adapter takes a factory, so that it does not depend on a middleware. The reader uses templates
(:class:`ship_bags.cdr_template.CdrTemplate`).
"""

import abc
import array
import functools
import importlib
import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from ship_bags.cdr_template import (
    STAMP,
    CdrEncoder,
    CdrMessage,
    CdrTemplate,
    Definition,
    Definitions,
    FieldType,
    field_error,
)
from ship_bags.stamps import NS_PER_S

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

_SCALARS: dict[str, Callable[[Any], Any]] = {"boolean": bool, "octet": lambda level: bytes([level]), "string": str}
_SCALARS |= {name: float if name in ("double", "float") else int for name in _TYPE_CODES}

_ELEMENTS = _TYPE_CODES | {"boolean": "?", "string": "string"}
"""Codes of the elements in templates; a byte has no code, because it is bytes in rclpy and a number in rosbags."""

Converters = dict[str, Callable[[Any], Any] | None]
"""Field name → converter of a plain value to a value that the message class accepts; None if none is needed."""


class MessageFactory(CdrEncoder):
    """Factory that makes messages from field values; classes, converters and layouts are determined once."""

    def __init__(self) -> None:
        super().__init__()
        self._plans: dict[str, tuple[Any, Converters]] = {}

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
        plan = self._plans.get(type_name)
        if plan is None:
            plan = self._plans[type_name] = self.plan(type_name)
        kind, converters = plan
        if fields.keys() != converters.keys():
            raise field_error(type_name, converters.keys(), fields.keys())
        for name, convert in converters.items():
            if convert is not None:
                fields[name] = convert(fields[name])
        return kind(**fields)

    @abc.abstractmethod
    def plan(self, type_name: str) -> tuple[Any, Converters]:
        """Return the class of a message type and the converters of its fields."""

    def message_converter(self, type_name: str) -> Callable[[Any], Any]:
        """Return the converter of a field that is a message or a stamp. A message made before is not converted."""

        def convert(value: Any) -> Any:
            if isinstance(value, dict):
                return self.make(type_name, **value)
            if type_name == STAMP and isinstance(value, (int, np.integer)):
                sec, nanosec = divmod(value, NS_PER_S)
                return self.make(type_name, sec=sec, nanosec=nanosec)
            return value

        return convert

    def list_converter(self, type_name: str) -> Callable[[Any], Any]:
        """Return the converter of a field that is a list of messages."""
        convert = self.message_converter(type_name)
        return lambda values: [convert(value) for value in values]


class RosidlFactory(MessageFactory):
    """Factory of the messages that rclpy publishes."""

    def plan(self, type_name: str) -> tuple[Any, Converters]:
        """See :meth:`MessageFactory.plan`."""
        kind = message_class(type_name)
        return kind, {name: self._converter(text) for name, text in kind.get_fields_and_field_types().items()}

    def definition(self, type_name: str) -> Definition:
        """See :meth:`MessageFactory.definition`."""
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


@functools.lru_cache(maxsize=4096)
def cdr_text(text: str) -> bytes:
    r"""Return the encoding of a text at an offset divisible by four, padded to the next such offset.

    Example:
        >>> cdr_text("deck")
        b'\x05\x00\x00\x00deck\x00\x00\x00\x00'
    """
    data = text.encode()
    return struct.pack("<I", len(data) + 1) + data + bytes(4 - len(data) % 4)


class CdrReader:
    """Reads the messages of a topic by templates, one for each message length.

    Args:
        type_name: the type.
        definitions: returns the definition of this type, or of a type that it refers to.
    """

    _MAX_TEMPLATES = 16
    """Maximum number of message lengths with a template, so that changing texts do not fill the memory."""

    def __init__(self, type_name: str, definitions: Definitions) -> None:
        self._type_name = type_name
        self._definitions = definitions
        self._is_fixed = _is_fixed(type_name, definitions)
        self._templates: dict[int, CdrTemplate] = {}

    def message(self, data: bytes) -> CdrMessage | None:
        """Return the message; None if no template fits.

        A template does not fit if the encapsulation differs, the message is damaged, or its texts differ from those in
        the first message of the same length. Types with sequences have no template, because their layout changes from
        message to message.
        """
        template = self._templates.get(len(data)) or self._add_template(data)
        return template.message(data) if template is not None and template.matches(data) else None

    def _add_template(self, data: bytes) -> CdrTemplate | None:
        """Return a template for all messages of a length, made from the first such message."""
        if not self._is_fixed or len(self._templates) >= self._MAX_TEMPLATES:
            return None
        try:
            template = CdrTemplate.of_message(self._type_name, self._definitions, data)
        except ValueError:
            return None
        self._templates[len(data)] = template
        return template


def _is_fixed(type_name: str, definitions: Definitions) -> bool:
    """True if messages of a type differ only in numbers and texts, and all their fields have templates."""
    try:
        fields = definitions(type_name).values()
    except TypeError:
        return False
    return not any(
        field.is_sequence or ("/" in field.element and not _is_fixed(field.element, definitions)) for field in fields
    )

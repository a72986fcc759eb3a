"""Factories of messages by the name of their type: as objects of a middleware, or as CDR bytes from plain values.

An adapter takes a factory, so that it does not depend on a middleware. The bytes are made without message objects: the
values of a message are split into its numbers, which are packed, and its texts and sequence lengths, which select the
template.
"""

import abc
import array
import functools
import importlib
import re
import struct
from collections.abc import Callable, Mapping, Set
from typing import Any

import numpy as np

from ship_bags.cdr_template import TEXT, CdrMessage, CdrRows, CdrTemplate, Definition, Definitions, FieldType, Variable

STAMP = "builtin_interfaces/msg/Time"
_NS_PER_S = 1_000_000_000

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


class MessageFactory(abc.ABC):
    """Factory that makes messages from field values; classes, converters and layouts are determined once."""

    _MAX_TEMPLATES = 1000
    """Maximum number of cached layouts, so that changing texts do not fill the memory."""

    def __init__(self) -> None:
        self._plans: dict[str, tuple[Any, Converters]] = {}
        self._flatteners: dict[tuple[str, bool], _Flattener] = {}
        self._templates: dict[tuple[Variable, ...], CdrTemplate] = {}

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
            raise _field_error(type_name, converters.keys(), fields.keys())
        for name, convert in converters.items():
            if convert is not None:
                fields[name] = convert(fields[name])
        return kind(**fields)

    def encode(self, type_name: str, **fields: Any) -> CdrMessage:
        """Return an encoded message from the fields of :meth:`make`; a nested message is given as a dict.

        This takes a fraction of the time of :meth:`make`, because no message object is made.

        Raises:
            TypeError: a field is missing, unknown or of a type without template, or an array has the wrong length.
        """
        numbers: list[Any] = []
        template = self._flatten(type_name, fields, numbers, many=False)
        return template.message(template.pack(numbers))

    def encode_rows(self, type_name: str, count: int, **fields: Any) -> CdrRows:
        """Return ``count`` encoded messages from the fields of :meth:`encode`.

        Texts and lengths of sequences are the same in all messages. A number or a stamp is given as an array with one
        value per message. An array of n numbers is given with shape (n, count). A value that is the same in all
        messages may be given once.

        Raises:
            TypeError: as for :meth:`encode`.
        """
        columns: list[Any] = []
        template = self._flatten(type_name, fields, columns, many=True)
        return CdrRows(template, template.encode_many(columns, count))

    def _flatten(self, type_name: str, fields: Mapping[str, Any], numbers: list[Any], many: bool) -> CdrTemplate:
        """Append the numbers of one or many messages to ``numbers``, and return the template of the messages."""
        flattener = self._flatteners.get((type_name, many))
        if flattener is None:
            flattener = self._flatteners[type_name, many] = _Flattener(type_name, self.definition, many)
        variables: list[Variable] = []
        flattener.add(fields, numbers, variables)
        layout = (type_name, *variables)
        if layout not in self._templates:
            if len(self._templates) >= self._MAX_TEMPLATES:
                self._templates.clear()
            self._templates[layout] = CdrTemplate(type_name, self.definition, tuple(variables))
        return self._templates[layout]

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


class _Flattener:
    """Splits the fields of a type into the numbers, and the texts and lengths that determine the layout.

    Args:
        type_name: the type.
        definitions: returns the definition of this type, or of a type that it refers to.
        many: True if the numbers are columns for many messages with the same texts.
    """

    def __init__(self, type_name: str, definitions: Definitions, many: bool) -> None:
        self._type_name = type_name
        fields = definitions(type_name)
        self._names = frozenset(fields)
        self._steps = [(name, _step(field, definitions, many)) for name, field in fields.items()]

    def add(self, fields: Mapping[str, Any], numbers: list[Any], variables: list[Variable]) -> None:
        """Append the parts of a message.

        Raises:
            TypeError: a field is missing or unknown, or an array has the wrong length.
        """
        if fields.keys() != self._names:
            raise _field_error(self._type_name, self._names, fields.keys())
        for name, step in self._steps:
            if step is None:
                numbers.append(fields[name])
            else:
                step(fields[name], numbers, variables)


_Step = Callable[[Any, list[Any], list[Variable]], None]


def _step(field: FieldType, definitions: Definitions, many: bool) -> _Step | None:
    """Return the function that splits a field; None if the field is one number."""
    add_element = _element_step(field.element, definitions, many)
    if field.length is None and not field.is_sequence:
        return add_element

    def add_all(values: Any, numbers: list[Any], variables: list[Variable]) -> None:
        if field.is_sequence:
            variables.append(len(values))
        elif len(values) != field.length:
            raise TypeError(f"{len(values)} elements: expected {field.length}")
        if add_element is None and many:
            # An array of n numbers is one column of width n.
            numbers.append(np.transpose(values))
        elif add_element is None:
            numbers.extend(values.tolist() if isinstance(values, np.ndarray) else values)
        elif field.element == TEXT:
            variables.extend(values)
        else:
            for value in values:
                add_element(value, numbers, variables)

    return add_all


def _element_step(element: str, definitions: Definitions, many: bool) -> _Step | None:
    if len(element) == 1:
        return None
    if element == TEXT:
        return lambda text, _numbers, variables: variables.append(text)
    flattener = _Flattener(element, definitions, many)
    if element == STAMP:
        return lambda time_ns, numbers, _variables: numbers.extend(divmod(time_ns, _NS_PER_S))
    return flattener.add


def _field_error(type_name: str, expected: Set[str], given: Set[str]) -> TypeError:
    missing, unknown = sorted(expected - given), sorted(given - expected)
    return TypeError(f"{type_name}: missing fields {missing}, unknown fields {unknown}")

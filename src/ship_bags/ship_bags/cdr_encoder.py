"""Encoder of messages as CDR bytes from plain values, without message objects.

The values of a message are split into its numbers, which are packed, and its texts and sequence lengths, which select
the template.
"""

import functools
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ship_bags.cdr_template import TEXT, CdrMessage, CdrRows, CdrTemplate, Definitions, FieldType, Variable

STAMP = "builtin_interfaces/msg/Time"

_NS_PER_S = 1_000_000_000


@functools.lru_cache(maxsize=4096)
def cdr_text(text: str) -> bytes:
    r"""Return the encoding of a text at an offset divisible by four, padded to the next such offset.

    Example:
        >>> cdr_text("deck")
        b'\x05\x00\x00\x00deck\x00\x00\x00\x00'
    """
    data = text.encode()
    return struct.pack("<I", len(data) + 1) + data + bytes(4 - len(data) % 4)


class CdrEncoder:
    """Encoder of messages of any types; each layout is computed once.

    Args:
        definitions: returns the definition of a type.
    """

    _MAX_TEMPLATES = 1000
    """Maximum number of cached layouts, so that changing texts do not fill the memory."""

    def __init__(self, definitions: Definitions) -> None:
        self._definitions = definitions
        self._flatteners: dict[tuple[str, bool], _Flattener] = {}
        self._templates: dict[tuple[Variable, ...], CdrTemplate] = {}

    def encode(self, type_name: str, fields: Mapping[str, Any]) -> CdrMessage:
        """Return a message; see :meth:`ship_bags.message_factory.MessageFactory.encode`."""
        numbers: list[Any] = []
        template = self._flatten(type_name, fields, numbers, many=False)
        return template.message(template.pack(numbers))

    def encode_rows(self, type_name: str, count: int, fields: Mapping[str, Any]) -> CdrRows:
        """Return messages; see :meth:`ship_bags.message_factory.MessageFactory.encode_rows`."""
        columns: list[Any] = []
        template = self._flatten(type_name, fields, columns, many=True)
        return CdrRows(template, template.encode_many(columns, count))

    def _flatten(
        self, type_name: str, fields: Mapping[str, Any], numbers: list[Any], many: bool
    ) -> CdrTemplate:
        """Append the numbers of one or many messages to ``numbers``, and return the template of the messages."""
        flattener = self._flatteners.get((type_name, many))
        if flattener is None:
            flattener = self._flatteners[type_name, many] = _Flattener(type_name, self._definitions, many)
        variables: list[Variable] = []
        flattener.add(fields, numbers, variables)
        return self._template(type_name, tuple(variables))

    def _template(self, type_name: str, variables: tuple[Variable, ...]) -> CdrTemplate:
        layout = (type_name, *variables)
        if layout not in self._templates:
            if len(self._templates) >= self._MAX_TEMPLATES:
                self._templates.clear()
            self._templates[layout] = CdrTemplate(type_name, self._definitions, variables)
        return self._templates[layout]


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
            missing, unknown = self._names - fields.keys(), fields.keys() - self._names
            raise TypeError(f"{self._type_name}: missing fields {sorted(missing)}, unknown fields {sorted(unknown)}")
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

"""Messages as CDR bytes without message objects: a template for each layout of a type, and the encoder of messages.

If the texts of a message and the lengths of its sequences are known, every number has a known offset. A
:class:`CdrTemplate` computes these offsets once, from the definition; then all numbers are packed and read at once. A
message with other texts or lengths has another template. The encoding is plain CDR (XCDR1), little endian.

:class:`CdrEncoder` encodes messages by templates. :class:`ship_bags.message_factory.CdrReader` reads the messages of a
topic that differ only in numbers.
"""

import abc
import struct
from collections.abc import Callable, Mapping, Sequence, Set
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ship_bags.stamps import NS_PER_S

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header of plain CDR, little endian. Numbers are aligned relative to its end."""

TEXT = "string"
STAMP = "builtin_interfaces/msg/Time"
_LENGTH_BYTES = 4


class FieldType(NamedTuple):
    """Type of a field: one element, an array of fixed length, or a sequence.

    Attributes:
        element: code of a number for struct and numpy, ``"string"``, or the name of a message type.
        length: number of elements of an array; None if it is not an array.
        is_sequence: True if the message contains the number of elements.
    """

    element: str
    length: int | None = None
    is_sequence: bool = False


Definition = Mapping[str, FieldType]
"""Field name → type of the field, in order."""

Definitions = Callable[[str], Definition]
"""Function that returns the definition of a message type by its name."""

Variable = str | int
"""Text of a message, or length of one of its sequences."""


class CdrMessage:
    """Message kept as bytes; a field is decoded when its attribute is read.

    Texts are str. Arrays and sequences of numbers are read-only numpy arrays, all other arrays and sequences are lists.
    A nested message is decoded as a whole. Attributes that are not fields begin with an underscore; no field does.

    Attributes:
        __msgtype__: name of the type, as in the message objects of rosbags.
        __cdr__: the bytes.
    """

    __slots__ = ("__cdr__", "__msgtype__", "_readers")

    def __init__(self, type_name: str, data: bytes, readers: "dict[str, _Reader]") -> None:
        self.__msgtype__ = type_name
        self.__cdr__ = data
        self._readers = readers

    def __getattr__(self, name: str) -> Any:
        reader = None if name.startswith("_") else self._readers.get(name)
        if reader is None:
            raise AttributeError(f"a message has no field {name!r}")
        return reader(self.__cdr__)


_Reader = Callable[[bytes], Any]
_VariablePart = Callable[[FieldType, int], Variable]
"""Function that returns the text or the sequence length at an offset."""


class CdrTemplate:
    """Layout of a message type for given texts and sequence lengths.

    Attributes:
        type_name: the type.
        size: bytes of a message, including the encapsulation header.
        dtype: numpy type for the numbers of a message by dotted names, as ``orientation.x`` or
            ``transforms.0.header.stamp.sec``.

    Args:
        type_name: the type.
        definitions: returns the definition of this type, or of a type that it refers to.
        variables: texts and sequence lengths of the messages, in order of the definition.

    Raises:
        ValueError: the number of variables does not match the definition.
    """

    def __init__(self, type_name: str, definitions: Definitions, variables: tuple[Variable, ...]) -> None:
        rest = list(reversed(variables))
        try:
            self._lay_out(type_name, definitions, lambda _field, _at: rest.pop())
        except IndexError:
            raise ValueError(f"{type_name} has more texts and sequences than {variables}") from None
        if rest:
            raise ValueError(f"{type_name} has fewer texts and sequences than {variables}")

    @classmethod
    def of_message(cls, type_name: str, definitions: Definitions, data: bytes) -> "CdrTemplate":
        """Return the template of a given message.

        Raises:
            ValueError: the bytes are not a message of this type, or have another encapsulation.
        """
        template = cls.__new__(cls)
        try:
            template._lay_out(type_name, definitions, lambda field, at: _variable_at(data, field, at))
        except struct.error as problem:
            raise ValueError(f"no {type_name}: it ends too early") from problem
        if not template.matches(data):
            raise ValueError(f"no {type_name} of {template.size} bytes")
        return template

    def _lay_out(self, type_name: str, definitions: Definitions, variable: "_VariablePart") -> None:
        walk = _LayoutBuilder(definitions, variable)
        self.type_name = type_name
        self._readers = walk.message(type_name, "")
        self.size = walk.end
        self.dtype = np.dtype(
            {"names": walk.names, "formats": walk.formats, "offsets": walk.offsets, "itemsize": walk.end}
        )
        self._constants = [(0, HEADER), *walk.constants]
        self._arguments = walk.arguments
        self._pack = struct.Struct("<" + "".join(walk.codes)).pack

    def message_of(self, numbers: list[Any]) -> CdrMessage:
        """Return the message of all its numbers in order of the definition; the list is changed."""
        for place, constant in self._arguments:
            numbers.insert(place, constant)
        return self.message(self._pack(*numbers))

    def encode_many(self, columns: Sequence[Any], count: int) -> np.ndarray:
        """Return the bytes of many messages, shape (count, size), uint8.

        Args:
            columns: for each name in :attr:`dtype` the values of all messages along the first axis, or one value for
                all messages.
            count: number of messages.

        Raises:
            ValueError: the number of columns differs from the number of names.
        """
        rows = np.zeros((count, self.size), dtype=np.uint8)
        for start, constant in self._constants:
            rows[:, start : start + len(constant)] = np.frombuffer(constant, dtype=np.uint8)
        messages = rows.view(self.dtype)[:, 0]
        for name, column in zip(self.dtype.names or (), columns, strict=True):
            messages[name] = column
        return rows

    def matching_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return True for each row, shape (count, size), that has this layout; the result has shape (count,)."""
        fitting = np.ones(len(rows), dtype=bool)
        for start, constant in self._constants:
            fitting &= (rows[:, start : start + len(constant)] == np.frombuffer(constant, dtype=np.uint8)).all(axis=1)
        return fitting

    def matches(self, data: bytes) -> bool:
        """Return True if a message has this layout: the same length, texts and sequence lengths."""
        if len(data) != self.size:
            return False
        return all(data.startswith(constant, start) for start, constant in self._constants)

    def message(self, data: bytes) -> CdrMessage:
        """Return the message of bytes with this layout."""
        return CdrMessage(self.type_name, data, self._readers)


class CdrRows(NamedTuple):
    """Messages of one layout.

    Attributes:
        template: layout of the messages.
        rows: bytes of the messages, shape (count, size), uint8.
    """

    template: CdrTemplate
    rows: np.ndarray

    @property
    def type_name(self) -> str:
        """Type of the messages."""
        return self.template.type_name

    @property
    def numbers(self) -> np.ndarray:
        """Numbers of all messages by their names in the template, shape (count,)."""
        return self.rows.view(self.template.dtype)[:, 0]

    def message_bytes(self) -> list[bytes]:
        """Return the bytes of each message."""
        content, size = self.rows.tobytes(), self.template.size
        return [content[start : start + size] for start in range(0, len(content), size)]

    def subset(self, which: slice) -> "CdrRows":
        """Return some of the messages."""
        return CdrRows(self.template, self.rows[which])

    def message(self, number: int) -> CdrMessage:
        """Return one message."""
        return self.template.message(self.rows[number].tobytes())


class _LayoutBuilder:
    """Builder of the layout of a message, field by field.

    Attributes:
        end: offset of the end of the fields so far, bytes.
        names, formats, offsets: names, formats and offsets of the numbers, for numpy.
        codes: codes of all parts, for struct.
        constants: offset and bytes of texts and lengths.
        arguments: for the header and each text and length, its index among the arguments of struct and its bytes.
    """

    def __init__(self, definitions: Definitions, variable: "_VariablePart") -> None:
        self._definitions = definitions
        self._variable = variable
        self.end = 0
        self.names: list[str] = []
        self.formats: list[Any] = []
        self.offsets: list[int] = []
        self.codes: list[str] = []
        self.constants: list[tuple[int, bytes]] = []
        self.arguments: list[tuple[int, bytes]] = []
        self._argument_count = 0
        self._add_constant(HEADER)
        self.constants.clear()

    def message(self, type_name: str, prefix: str) -> dict[str, _Reader]:
        """Add a message; return field name → reader."""
        return {name: self._field(field, prefix + name) for name, field in self._definitions(type_name).items()}

    def _field(self, field: FieldType, name: str) -> _Reader:
        if field.length is None and not field.is_sequence:
            return self._element(field.element, name)
        count = field.length
        if field.is_sequence:
            count = int(self._variable(field, self._aligned_offset(_LENGTH_BYTES)))
            self._add_constant(struct.pack("<I", count), _LENGTH_BYTES)
        assert count is not None
        if len(field.element) == 1:
            return self._numbers(field.element, name, count)
        readers = [self._element(field.element, f"{name}.{index}") for index in range(count)]
        return lambda data: [reader(data) for reader in readers]

    def _element(self, element: str, name: str) -> _Reader:
        if len(element) == 1:
            offset, unpack = self._add_numbers(element, name, 1), struct.Struct("<" + element).unpack_from
            return lambda data: unpack(data, offset)[0]
        if element == TEXT:
            text = str(self._variable(FieldType(TEXT), self._aligned_offset(_LENGTH_BYTES)))
            content = text.encode() + b"\x00"
            self._add_constant(struct.pack("<I", len(content)) + content, _LENGTH_BYTES)
            return lambda _data: text
        readers = list(self.message(element, name + ".").items())
        # Code that reads one component of a vector usually reads all components.
        return lambda data: SimpleNamespace(**{field: read(data) for field, read in readers})

    def _numbers(self, code: str, name: str, count: int) -> _Reader:
        if count == 0:
            # An empty sequence has no alignment.
            return lambda _data: np.empty(0, dtype="<" + code)
        offset, dtype = self._add_numbers(code, name, count), np.dtype("<" + code)
        return lambda data: np.frombuffer(data, dtype, count, offset)

    def _add_numbers(self, code: str, name: str, count: int) -> int:
        """Add contiguous numbers; return their offset."""
        size = struct.calcsize("<" + code)
        self._skip_to(self._aligned_offset(size))
        offset = self.end
        self.names.append(name)
        self.formats.append("<" + code if count == 1 else ("<" + code, (count,)))
        self.offsets.append(offset)
        self.codes.append(f"{count}{code}")
        self._argument_count += count
        self.end += count * size
        return offset

    def _add_constant(self, content: bytes, alignment: int = 1) -> None:
        self._skip_to(self._aligned_offset(alignment))
        self.constants.append((self.end, content))
        self.arguments.append((self._argument_count, content))
        self.codes.append(f"{len(content)}s")
        self._argument_count += 1
        self.end += len(content)

    def _aligned_offset(self, size: int) -> int:
        return self.end + (len(HEADER) - self.end) % size

    def _skip_to(self, offset: int) -> None:
        if offset > self.end:
            self.codes.append(f"{offset - self.end}x")
            self.end = offset


def _variable_at(data: bytes, field: FieldType, offset: int) -> Variable:
    """Return the text, or the sequence length, at an offset of a message."""
    (length,) = struct.unpack_from("<I", data, offset)
    start, end = offset + _LENGTH_BYTES, offset + _LENGTH_BYTES + length
    if length > len(data):
        raise ValueError(f"a length of {length} in {len(data)} bytes")
    if field.is_sequence:
        return int(length)
    if b"\x00" in data[start : end - 1]:
        raise ValueError("a text ends before its end")
    return data[start : end - 1].decode()


class CdrEncoder(abc.ABC):
    """Encoder of messages from plain values, without message objects; layouts are determined once.

    The values of a message are split into its numbers, which are packed, and its texts and sequence lengths, which
    select the template.
    """

    _MAX_TEMPLATES = 1000
    """Maximum number of cached layouts, so that changing texts do not fill the memory."""

    def __init__(self) -> None:
        self._steps: dict[tuple[str, bool], _Step] = {}
        self._templates: dict[tuple[Variable, ...], CdrTemplate] = {}

    @abc.abstractmethod
    def definition(self, type_name: str) -> Definition:
        """Return the fields of a type, in order.

        Raises:
            TypeError: a field has a type without template.
        """

    def encode(self, type_name: str, **fields: Any) -> CdrMessage:
        """Return an encoded message from plain values; every field must be given by keyword.

        Args:
            type_name: name of the type, as ``"ship_msgs/msg/ShipAttitude"``.
            fields: numbers, texts, 1-D numpy arrays for arrays of numbers, lists of texts, dicts of fields for nested
                messages. A stamp is given as integer ns of POSIX UTC.

        Raises:
            TypeError: a field is missing, unknown or of a type without template, or an array has the wrong length.
        """
        numbers: list[Any] = []
        return self._split(type_name, fields, numbers, many=False).message_of(numbers)

    def encode_rows(self, type_name: str, count: int, **fields: Any) -> CdrRows:
        """Return ``count`` encoded messages from the fields of :meth:`encode`.

        Texts and lengths of sequences are the same in all messages. A number or a stamp is given as an array with one
        value per message. An array of n numbers is given with shape (n, count). A value that is the same in all
        messages may be given once.

        Raises:
            TypeError: as for :meth:`encode`.
        """
        columns: list[Any] = []
        template = self._split(type_name, fields, columns, many=True)
        return CdrRows(template, template.encode_many(columns, count))

    def _split(self, type_name: str, fields: Mapping[str, Any], numbers: list[Any], many: bool) -> CdrTemplate:
        """Append the numbers of one or many messages to ``numbers``, and return the template of the messages."""
        add = self._steps.get((type_name, many))
        if add is None:
            add = self._steps[type_name, many] = _message_step(type_name, self.definition, many)
        variables: list[Variable] = []
        add(fields, numbers, variables)
        layout = (type_name, *variables)
        if layout not in self._templates:
            if len(self._templates) >= self._MAX_TEMPLATES:
                self._templates.clear()
            self._templates[layout] = CdrTemplate(type_name, self.definition, tuple(variables))
        return self._templates[layout]


_Step = Callable[[Any, list[Any], list[Variable]], None]
"""Function that appends a value's numbers, and the texts and lengths that determine the layout."""


def _message_step(type_name: str, definitions: Definitions, many: bool) -> _Step:
    """Return the function that splits the fields of a message.

    Args:
        type_name: the type.
        definitions: returns the definition of this type, or of a type that it refers to.
        many: True if the numbers are columns for many messages with the same texts.
    """
    steps = {name: _field_step(field, definitions, many) for name, field in definitions(type_name).items()}

    def add(fields: Mapping[str, Any], numbers: list[Any], variables: list[Variable]) -> None:
        if fields.keys() != steps.keys():
            raise field_error(type_name, steps.keys(), fields.keys())
        for name, step in steps.items():
            if step is None:
                numbers.append(fields[name])
            else:
                step(fields[name], numbers, variables)

    return add


def _field_step(field: FieldType, definitions: Definitions, many: bool) -> _Step | None:
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
    if element == STAMP:
        return lambda time_ns, numbers, _variables: numbers.extend(divmod(time_ns, NS_PER_S))
    return _message_step(element, definitions, many)


def field_error(type_name: str, expected: Set[str], given: Set[str]) -> TypeError:
    """Return the exception about missing and unknown fields of a message."""
    missing, unknown = sorted(expected - given), sorted(given - expected)
    return TypeError(f"{type_name}: missing fields {missing}, unknown fields {unknown}")

"""Messages as CDR bytes without message objects: a template for each layout that a type takes.

Where the texts of a message and the lengths of its sequences are known, every number stands at a known place. A
:class:`CdrTemplate` walks these places once, from the definition; then its numbers are packed and read in one go. A
message whose texts or lengths are others has another template. The encoding is plain CDR (XCDR1), little endian.

Messages are made by templates in :mod:`ship_bags.cdr_encoder` and read in :mod:`ship_bags.cdr_reader`.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation of plain CDR, little endian. Numbers are aligned from behind it on."""

TEXT = "string"
_LENGTH_BYTES = 4


class FieldType(NamedTuple):
    """Type of a field: one element, an array of a fixed number of them, or a sequence.

    Attributes:
        element: code of a number as struct and numpy know it, ``"string"``, or the name of a message type.
        length: elements of an array; None for one element, which is no array.
        is_sequence: whether the message itself says how many there are.
    """

    element: str
    length: int | None = None
    is_sequence: bool = False


Definition = Mapping[str, FieldType]
"""Field name → its type, in order."""

Definitions = Callable[[str], Definition]
"""The definition of a message type by its name."""

Variable = str | int
"""A text of a message, or the length of one of its sequences."""


class CdrMessage:
    """A message as its bytes, whose fields are read where somebody asks for them, as attributes.

    Texts are str, arrays of numbers read-only numpy arrays, sequences and arrays of others lists; a message in it is
    read whole. Every other name begins with an underscore, as no field's does.

    Attributes:
        __msgtype__: name of the type, as the message objects of rosbags have it.
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
"""Gives the text or the length of a sequence that stands at an offset."""


class CdrTemplate:
    """One layout of a message type.

    Attributes:
        type_name: the type.
        size: bytes of a message, encapsulation included.
        dtype: the numbers of a message by dotted names, as ``orientation.x`` or ``transforms.0.header.stamp.sec``.

    Args:
        type_name: the type.
        definitions: gives its definition, and those of all that it refers to.
        variables: its texts and the lengths of its sequences in order of the definition.

    Raises:
        ValueError: there are more or fewer of these than the definition has.
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
        """The template by which a message is laid out, as the message itself says.

        Raises:
            ValueError: the bytes are no such message, or of another encapsulation.
        """
        template = cls.__new__(cls)
        try:
            template._lay_out(type_name, definitions, lambda field, at: _variable_at(data, field, at))
        except struct.error as problem:
            raise ValueError(f"no {type_name}: it ends too early") from problem
        if not template.fits(data):
            raise ValueError(f"no {type_name} of {template.size} bytes")
        return template

    def _lay_out(self, type_name: str, definitions: Definitions, variable: "_VariablePart") -> None:
        walk = _Walk(definitions, variable)
        self.type_name = type_name
        self._readers = walk.message(type_name, "")
        self.size = walk.end
        self.dtype = np.dtype(
            {"names": walk.names, "formats": walk.formats, "offsets": walk.offsets, "itemsize": walk.end}
        )
        self._constants = [(0, HEADER), *walk.constants]
        self._arguments = walk.arguments
        self._pack = struct.Struct("<" + "".join(walk.codes)).pack

    def pack(self, numbers: list[Any]) -> bytes:
        """The bytes of a message, by all its numbers in order of the definition; the list is changed."""
        for place, constant in self._arguments:
            numbers.insert(place, constant)
        return self._pack(*numbers)

    def encode_many(self, columns: Sequence[Any], count: int) -> np.ndarray:
        """The bytes of many messages, shape (count, size), uint8.

        Args:
            columns: for each name in :attr:`dtype` the values of all messages, the first axis counts them; or one value
                for all.
            count: number of messages.

        Raises:
            ValueError: there are more or fewer columns than names.
        """
        rows = np.zeros((count, self.size), dtype=np.uint8)
        for start, constant in self._constants:
            rows[:, start : start + len(constant)] = np.frombuffer(constant, dtype=np.uint8)
        messages = rows.view(self.dtype)[:, 0]
        for name, column in zip(self.dtype.names or (), columns, strict=True):
            messages[name] = column
        return rows

    def decode_many(self, data: Any) -> np.ndarray:
        """The numbers of many messages, shape (count,), of :attr:`dtype`: a view of bytes that stand in a row.

        Raises:
            ValueError: the bytes are no whole number of messages, or one is laid out otherwise.
        """
        rows = np.frombuffer(data, dtype=np.uint8).reshape(-1, self.size)
        others = np.flatnonzero(~self.fitting(rows))
        if others.size:
            raise ValueError(f"message {others[0]} is no {self.type_name} of this layout")
        return rows.view(self.dtype)[:, 0]

    def fitting(self, rows: np.ndarray) -> np.ndarray:
        """Of messages of the right length, shape (count, size), which are laid out by this template, shape (count,)."""
        fitting = np.ones(len(rows), dtype=bool)
        for start, constant in self._constants:
            fitting &= (rows[:, start : start + len(constant)] == np.frombuffer(constant, dtype=np.uint8)).all(axis=1)
        return fitting

    def fits(self, data: bytes) -> bool:
        """Whether a message is laid out by this template: its length, texts, and lengths of sequences are the same."""
        if len(data) != self.size:
            return False
        return all(data.startswith(constant, start) for start, constant in self._constants)

    def message(self, data: bytes) -> CdrMessage:
        """The message of bytes that fit."""
        return CdrMessage(self.type_name, data, self._readers)


class CdrRows(NamedTuple):
    """Messages of one layout.

    Attributes:
        template: their layout.
        rows: their bytes, shape (count, size), uint8.
    """

    template: CdrTemplate
    rows: np.ndarray

    @property
    def type_name(self) -> str:
        """The type of the messages."""
        return self.template.type_name

    @property
    def numbers(self) -> np.ndarray:
        """The numbers of all of them by their names in the template, shape (count,)."""
        return self.rows.view(self.template.dtype)[:, 0]

    def each(self) -> list[bytes]:
        """The bytes of each of them."""
        content, size = self.rows.tobytes(), self.template.size
        return [content[start : start + size] for start in range(0, len(content), size)]

    def some(self, which: slice) -> "CdrRows":
        """Some of them."""
        return CdrRows(self.template, self.rows[which])

    def message(self, number: int) -> CdrMessage:
        """One of them."""
        return self.template.message(self.rows[number].tobytes())


class _Walk:
    """Walks through a message, field by field.

    Attributes:
        end: offset behind what was walked, bytes.
        names, formats, offsets: of the numbers, for numpy.
        codes: of everything, for struct.
        constants: offset and bytes of texts and lengths.
        arguments: the same by their places among the arguments of struct.
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
        self._constant(HEADER)
        self.constants.clear()

    def message(self, type_name: str, prefix: str) -> dict[str, _Reader]:
        """Walk a message; field name → what reads it."""
        return {name: self._field(field, prefix + name) for name, field in self._definitions(type_name).items()}

    def _field(self, field: FieldType, name: str) -> _Reader:
        if field.length is None and not field.is_sequence:
            return self._element(field.element, name)
        count = field.length
        if field.is_sequence:
            count = int(self._variable(field, self._aligned(_LENGTH_BYTES)))
            self._constant(struct.pack("<I", count), _LENGTH_BYTES)
        assert count is not None
        if len(field.element) == 1:
            return self._numbers(field.element, name, count)
        readers = [self._element(field.element, f"{name}.{index}") for index in range(count)]
        return lambda data: [reader(data) for reader in readers]

    def _element(self, element: str, name: str) -> _Reader:
        if len(element) == 1:
            return self._number(element, name)
        if element == TEXT:
            text = str(self._variable(FieldType(TEXT), self._aligned(_LENGTH_BYTES)))
            content = text.encode() + b"\x00"
            self._constant(struct.pack("<I", len(content)) + content, _LENGTH_BYTES)
            return lambda _data: text
        readers = list(self.message(element, name + ".").items())
        # Who asks for a part of a vector asks for all of them.
        return lambda data: SimpleNamespace(**{field: read(data) for field, read in readers})

    def _number(self, code: str, name: str) -> _Reader:
        offset = self._place(code, name, 1)
        unpack = struct.Struct("<" + code).unpack_from
        return lambda data: unpack(data, offset)[0]

    def _numbers(self, code: str, name: str, count: int) -> _Reader:
        if count == 0:
            # Nothing is aligned for elements that are not there.
            return lambda _data: np.empty(0, dtype="<" + code)
        offset, dtype = self._place(code, name, count), np.dtype("<" + code)
        return lambda data: np.frombuffer(data, dtype, count, offset)

    def _place(self, code: str, name: str, count: int) -> int:
        """Offset of numbers that stand one behind the other."""
        size = struct.calcsize("<" + code)
        self._skip_to(self._aligned(size))
        offset = self.end
        self.names.append(name)
        self.formats.append("<" + code if count == 1 else ("<" + code, (count,)))
        self.offsets.append(offset)
        self.codes.append(f"{count}{code}")
        self._argument_count += count
        self.end += count * size
        return offset

    def _constant(self, content: bytes, alignment: int = 1) -> None:
        self._skip_to(self._aligned(alignment))
        self.constants.append((self.end, content))
        self.arguments.append((self._argument_count, content))
        self.codes.append(f"{len(content)}s")
        self._argument_count += 1
        self.end += len(content)

    def _aligned(self, size: int) -> int:
        return self.end + (len(HEADER) - self.end) % size

    def _skip_to(self, offset: int) -> None:
        if offset > self.end:
            self.codes.append(f"{offset - self.end}x")
            self.end = offset


def _variable_at(data: bytes, field: FieldType, offset: int) -> Variable:
    """The text, or the length of the sequence, that stands in a message."""
    (length,) = struct.unpack_from("<I", data, offset)
    start, end = offset + _LENGTH_BYTES, offset + _LENGTH_BYTES + length
    if length > len(data):
        raise ValueError(f"a length of {length} in {len(data)} bytes")
    if field.is_sequence:
        return int(length)
    if b"\x00" in data[start : end - 1]:
        raise ValueError("a text ends before its end")
    return data[start : end - 1].decode()

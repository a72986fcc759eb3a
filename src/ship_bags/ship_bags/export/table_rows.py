"""Messages of one type as rows of tables: one table of the messages, and one of each array whose length varies.

A nested message becomes columns with its name in front, an array of fixed length numbered columns. An array of variable
length becomes a table of its own with a row per element: of which message, at which place, and what stands there.
The table of the messages says how many there are. Arrays in the same order share a table; where one of them is shorter,
None stands behind its end.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, count, zip_longest
from operator import attrgetter
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ship_bags.errors import BadInput
from ship_bags.export.units import NANOSECONDS, Unit, standard_name, unit_of
from ship_bags.stamps import ns_from_stamp

LOG_TIME = "log_time_ns"
STAMP = "stamp_ns"
TEXT = "text"

MOST_COLUMNS = 2000
"""A definition with more is a mistake or means harm."""

MOST_TABLES = 100
"""Of one topic: arrays within arrays that have no end are a mistake or mean harm, too."""

_MOST_NUMBERED = 64
"""A fixed array that is longer becomes a table of its own: nobody reads a thousand columns."""

_DEEPEST = 16
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_RESERVED = {"time", "row"}
"""Names of the axes of a NetCDF file."""

_KINDS = {
    "bool": "bool", "byte": "uint8", "octet": "uint8", "char": "uint8", "string": TEXT, "wstring": TEXT,
    **{name: name for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")},
    "float32": "float32", "float64": "float64",
}
_BYTES = ("uint8", "byte", "octet")
_NO_FIELD = "structure_needs_at_least_one_member"
"""Stands in the definition of a message without fields."""

_TOGETHER: dict[str, tuple[dict[str, int], ...]] = {
    "ship_msgs/msg/AlignmentState": ({"names": 1, "values": 1, "units": 1},),
    "ship_msgs/msg/TheodoliteCalibration": ({"names": 1, "values": 1, "units": 1},),
    "ship_msgs/msg/ErrorBudget": ({"sources": 1, "covariances": 9},),
    "ship_msgs/msg/Innovation": ({"components": 1, "residual": 1, "sigma": 1},),
    "ship_msgs/msg/InputHealth": ({"reasons": 1, "reason_counts": 1},),
    "ship_msgs/msg/Integrity": (
        {"quantities": 1, "protection_level": 1, "alert_limit": 1},
        {"hypotheses": 1, "statistic": 1, "threshold": 1},
        {"excluded": 1, "excluded_for_s": 1},
    ),
    "sensor_msgs/msg/JointState": ({"name": 1, "position": 1, "velocity": 1, "effort": 1},),
}
"""Type → arrays that are in the same order, as its definition says, and how many elements of each belong together."""

Path = tuple[str | int, ...]
Get = Callable[[Any], Any]
Put = Callable[[list[Any], Any], None]


@dataclass(frozen=True)
class Column:
    """A column: its name, the numpy name of its numbers or TEXT, its unit, and where its values stand in a message."""

    name: str
    kind: str
    unit: Unit | None
    origin: str
    standard_name: str | None = None


class _MessageField(NamedTuple):
    """A number, text or array in a message: its place and type, what its numbers mean, the array or type it is in."""

    path: Path
    node: Nodetype
    content: Any
    unit: Unit | None = None
    standard_name: str | None = None
    array: str = ""
    owner: str = ""

    @property
    def base(self) -> str:
        """Its place as the beginning of a column's name; of a header the stamp and the frame need no more."""
        if self.array:
            return self.array
        inner = self.path[1:] if self.path in (("header", "stamp"), ("header", "frame_id")) else self.path
        return "_".join(map(str, inner))

    @property
    def origin(self) -> str:
        """Its place as a program writes it."""
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in self.path)
        return place.removeprefix(".") or self.array


class MessageTable:
    """A table that fills up: rows are added message by message, and taken out column by column.

    Args:
        name: empty for the messages themselves, else the names of the arrays down to this one, joined by "-".
        keys: columns whose values :meth:`add` is given.
        fields: what a message or an element holds.
        store: the definitions.
        made: the tables of the topic so far; this one and those of its arrays are added.

    Attributes:
        columns: in their order.
        arrays: what takes the elements of an array out of a message, and their table.

    Raises:
        BadInput: there would be more columns than MOST_COLUMNS or more tables than MOST_TABLES, a field is of an
            unknown kind, or messages within messages have no end.
    """

    def __init__(
        self,
        name: str,
        keys: list[Column],
        fields: Iterable[_MessageField],
        store: Typestore,
        made: "list[MessageTable]",
    ) -> None:
        if len(made) >= MOST_TABLES:
            raise BadInput(f"it would be more than {MOST_TABLES} tables")
        made.append(self)
        self.name = name
        self.columns = list(keys)
        self._rows: list[list[Any]] = []
        self._puts: list[tuple[Get, Put]] = []
        varying = []
        for number, field in enumerate(fields):
            if max(number, len(self.columns)) >= MOST_COLUMNS:
                raise BadInput(f"a table of it would have more than {MOST_COLUMNS} columns")
            if field.path[-1:] != (_NO_FIELD,) and not self._take(field):
                varying.append(field)
        stamps = [place for place, column in enumerate(self.columns) if column.name == STAMP]
        # The columns by which the rows of its arrays are told apart.
        self._identity = sorted({*range(len(keys)), *stamps})
        own_keys = [self.columns[place] for place in self._identity]
        self.arrays = [
            (_elements(group), _array_table(name, own_keys, group, store, made)) for group in _groups(varying)
        ]

    @property
    def row_count(self) -> int:
        """Rows that are not yet taken."""
        return len(self._rows)

    def add(self, keys: list[Any], message: Any) -> None:
        """Add the row of a message or an element, and those of its arrays."""
        row = list(keys)
        for get, put in self._puts:
            put(row, get(message))
        self._rows.append(row)
        for elements, table in self.arrays:
            outer = [row[place] for place in self._identity]
            for place, element in enumerate(elements(message)):
                table.add([*outer, place], element)

    def take_columns(self) -> list[list[Any]]:
        """The values of each column; no row is left."""
        taken = [list(values) for values in zip(*self._rows, strict=True)]
        self._rows = []
        return taken or [[] for _ in self.columns]

    def _take(self, field: _MessageField) -> bool:
        """Make the columns of a field; of an array of variable length only that of its length, and say False."""
        get = _getter(field.path)
        if field.node == Nodetype.NAME:
            self._add_column(field.base, Column("", "int64", NANOSECONDS, field.origin))
            self._puts.append((get, _put_time))
        elif field.node == Nodetype.BASE:
            self._add_column(field.base, _value_column(field, field.content[0], field.origin))
            self._puts.append((get, _put_byte if field.content[0] in _BYTES else _put_value))
        elif _is_numbered(field):
            for place in range(field.content[1]):
                column = _value_column(field, field.content[0][1][0], f"{field.origin}[{place}]")
                self._add_column(field.base, column, f"_{place}")
            self._puts.append((get, partial(_put_array, field.content[1])))
        elif _is_bytes(field):
            self._add_column(f"{field.base}_hex", Column("", TEXT, None, f"{field.origin}, two digits a byte"))
            self._puts.append((get, _put_hex))
        else:
            self._add_column(f"{field.base}_count", Column("", "int32", None, f"length of {field.origin}"))
            self._puts.append((get, _put_length))
            return False
        return True

    def _add_column(self, base: str, column: Column, number: str = "") -> None:
        """Add a column, named by its base, its unit and its number; where that is taken, with a further number."""
        suffix = "" if column.unit is None or not column.unit.suffix else f"_{column.unit.suffix}"
        wanted = f"{base.removesuffix(suffix)}{suffix}{number}"
        self.columns.append(replace(column, name=_free_name(wanted, self.columns)))


class TopicRows:
    """Turns the messages of a topic into rows.

    Args:
        type_name: of the messages.
        store: the definitions.

    Attributes:
        tables: that of the messages first.

    Raises:
        BadInput: see :class:`MessageTable`.
    """

    def __init__(self, type_name: str, store: Typestore) -> None:
        keys = [
            Column(LOG_TIME, "int64", NANOSECONDS, "log time in the bag"),
            Column("message_index", "int32", None, "number of the message, from 0"),
        ]
        self.tables: list[MessageTable] = []
        self._messages = MessageTable("", keys, _fields(type_name, store), store, self.tables)
        self._message_count = 0

    def add(self, message: Any, log_time_ns: int) -> None:
        """Add the rows of one message."""
        self._messages.add([log_time_ns, self._message_count], message)
        self._message_count += 1


def _fields(
    type_name: str, store: Typestore, path: Path = (), inherited: Unit | None = None
) -> Iterator[_MessageField]:
    """All that a message holds, down to numbers, texts, times and arrays that become no single columns."""
    if len(path) > _DEEPEST:
        raise BadInput(f"{type_name}: messages within messages are more than {_DEEPEST} deep")
    for name, (node, content) in store.fielddefs[type_name][1]:
        unit = unit_of(type_name, name) or inherited
        cf_name = standard_name(type_name, name)
        yield from _parts(_MessageField((*path, name), node, content, unit, cf_name, owner=type_name), store)


def _parts(field: _MessageField, store: Typestore) -> Iterator[_MessageField]:
    """The field itself, or where it is a message or a short array of messages, what stands in it."""
    if field.node == Nodetype.NAME and field.content not in _TIMES:
        yield from _fields(field.content, store, field.path, field.unit)
    elif field.node == Nodetype.ARRAY and field.content[0][0] == Nodetype.NAME and field.content[1] <= _MOST_NUMBERED:
        (node, content), length = field.content
        for place in range(length):
            yield from _parts(_MessageField((*field.path, place), node, content, field.unit), store)
    else:
        yield field


def _groups(fields: list[_MessageField]) -> list[dict[_MessageField, int]]:
    """Arrays that share a table, each with the number of its elements in a row."""
    groups: dict[tuple[Path, str], dict[_MessageField, int]] = {}
    for field in fields:
        known = next((group for group in _TOGETHER.get(field.owner, ()) if field.path[-1] in group), {})
        alone = not known or field.content[0][0] != Nodetype.BASE
        key = (field.path, "") if alone else (field.path[:-1], next(iter(known)))
        groups.setdefault(key, {})[field] = 1 if alone else known[str(field.path[-1])]
    return list(groups.values())


def _elements(group: dict[_MessageField, int]) -> Callable[[Any], Iterable[Any]]:
    """What takes the elements for the rows of a table out of a message; of several arrays, one or more of each."""
    gets = [(_getter(field.path), width) for field, width in group.items()]
    if len(gets) == 1:
        get, _ = gets[0]
        return lambda message: _plain(get(message))
    return lambda message: zip_longest(*(_in_rows(_plain(get(message)), width) for get, width in gets))


def _in_rows(elements: list[Any], width: int) -> list[Any]:
    """The elements, or where several belong together, lists of them."""
    return elements if width == 1 else [elements[place : place + width] for place in range(0, len(elements), width)]


def _array_table(
    outer_name: str,
    outer_keys: list[Column],
    group: dict[_MessageField, int],
    store: Typestore,
    made: list[MessageTable],
) -> MessageTable:
    """The table of an array, a row per element, or of several arrays that are in the same order."""
    field = next(iter(group))
    index = _free_name(f"{field.base}_index", outer_keys)
    keys = [*outer_keys, Column(index, "int32", None, f"place in {field.origin}, from 0")]
    node, content = field.content[0]
    fields: Iterable[_MessageField]
    if len(group) > 1:
        fields = [
            _MessageField((place,), *_type_in_row(each, width), each.unit, None, each.base)
            for place, (each, width) in enumerate(group.items())
        ]
    elif node == Nodetype.NAME and content not in _TIMES:
        fields = _fields(content, store, inherited=field.unit)
    else:
        fields = [_MessageField((), node, content, field.unit, None, field.base)]
    return MessageTable(f"{outer_name}-{field.base}".lstrip("-"), keys, fields, store, made)


def _type_in_row(array: _MessageField, width: int) -> tuple[Nodetype, Any]:
    """The type of what stands in a row: an element, or an array of some."""
    return array.content[0] if width == 1 else (Nodetype.ARRAY, (array.content[0], width))


def _free_name(wanted: str, columns: list[Column]) -> str:
    """The name, or where a column bears it, one with a number behind it."""
    taken = {known.name for known in columns} | _RESERVED
    names = chain([wanted], (f"{wanted}_{again}" for again in count(2)))
    return next(name for name in names if name not in taken)


def _value_column(field: _MessageField, base_type: str, origin: str) -> Column:
    """The column of a number or text, without its name."""
    kind = _KINDS.get(base_type)
    if kind is None:
        raise BadInput(f"field {field.origin}: numbers of type {base_type} are unknown here")
    return Column("", kind, None if kind in (TEXT, "bool") else field.unit, origin, field.standard_name)


def _is_numbered(field: _MessageField) -> bool:
    """Whether it is a short array of fixed length of numbers or texts."""
    return field.node == Nodetype.ARRAY and field.content[1] <= _MOST_NUMBERED and field.content[0][0] == Nodetype.BASE


def _is_bytes(field: _MessageField) -> bool:
    node, content = field.content[0]
    return bool(node == Nodetype.BASE and content[0] in _BYTES)


def _getter(path: Path) -> Get:
    """What takes the value at a place out of a message; at the empty place that is the message itself."""
    if not path:
        return lambda message: message
    if all(isinstance(part, str) for part in path):
        return attrgetter(".".join(map(str, path)))

    def get(message: Any) -> Any:
        for part in path:
            message = message[part] if isinstance(part, int) else getattr(message, part)
        return message

    return get


def _plain(array: Any) -> list[Any]:
    """The elements of a numpy array or a list, as Python has them."""
    return array.tolist() if hasattr(array, "tolist") else array  # type: ignore[no-any-return]


def _put_value(row: list[Any], value: Any) -> None:
    row.append(value)


def _put_byte(row: list[Any], value: Any) -> None:
    # rosbags reads a byte with a sign.
    row.append(value & 0xFF)


def _put_time(row: list[Any], value: Any) -> None:
    row.append(ns_from_stamp(value))


def _put_array(length: int, row: list[Any], value: Any) -> None:
    # None where an array is shorter than another of the same order.
    values = [] if value is None else _plain(value)
    row.extend(values)
    row.extend([None] * (length - len(values)))


def _put_hex(row: list[Any], value: Any) -> None:
    row.append(bytes(value).hex())


def _put_length(row: list[Any], value: Any) -> None:
    row.append(len(value))

"""Messages of one type as rows of tables: one table of the messages, and one per array of variable or great length.

A nested message becomes columns with its name as prefix; a short array of fixed length becomes numbered columns. Other
arrays of bytes become a column of hexadecimal text. Any other array of variable or great length becomes a table of its
own with a row per element: log time, stamp, indices of message and element, values. The table of the messages has the
lengths of the arrays. Arrays whose elements belong together share a table; beyond the end of a shorter array the values
are None.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, count
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ship_bags.errors import BadInput
from ship_bags.export.message_fields import (
    BYTES,
    NANOSECONDS,
    NO_FIELD,
    TIMES,
    Get,
    MessageField,
    Unit,
    as_list,
    elements_of,
    fields_of,
    getter,
    groups_of,
    is_bytes,
    is_numbered,
    type_in_row,
)
from ship_bags.stamps import ns_from_stamp

LOG_TIME = "log_time_ns"
STAMP = "stamp_ns"
TEXT = "text"

MAX_COLUMNS = 2000
"""Maximum number of columns; a definition with more columns is a mistake or malicious."""

MAX_TABLES = 100
"""Maximum number of tables of one topic; more nested arrays are a mistake or malicious, too."""

_RESERVED = {"time", "row"}
"""Names of the axes of a NetCDF file."""

_KINDS = {
    "bool": "bool", "byte": "uint8", "octet": "uint8", "char": "uint8", "string": TEXT, "wstring": TEXT,
    **{name: name for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")},
    "float32": "float32", "float64": "float64",
}

Put = Callable[[list[Any], Any], None]


@dataclass(frozen=True)
class Column:
    """Column of a table: name, numpy type of its numbers or TEXT, unit, and origin of its values in a message.

    ``value_names`` are as in :class:`MessageField`.
    """

    name: str
    kind: str
    unit: Unit | None
    origin: str
    standard_name: str | None = None
    value_names: tuple[tuple[str, int], ...] = ()


class MessageTable:
    """Table being filled: rows are added message by message, and taken out column by column.

    Args:
        name: empty for the table of the messages, else the names of the arrays down to this table's array, joined by
            "-".
        keys: columns whose values are given to :meth:`add`.
        fields: fields of a message or an element.
        store: the definitions.
        made: the tables of the topic so far; this table and the tables of its arrays are added.

    Attributes:
        columns: columns in order.
        arrays: for each array, the getter of its elements from a message and the table of these elements.

    Raises:
        BadInput: there would be more columns than MAX_COLUMNS or more tables than MAX_TABLES, a field is of an unknown
            kind, or messages are nested too deeply.
    """

    def __init__(
        self,
        name: str,
        keys: list[Column],
        fields: Iterable[MessageField],
        store: Typestore,
        made: "list[MessageTable]",
    ) -> None:
        if len(made) >= MAX_TABLES:
            raise BadInput(f"the topic would have more than {MAX_TABLES} tables")
        made.append(self)
        self.name = name
        self.columns = list(keys)
        self._rows: list[list[Any]] = []
        self._puts: list[tuple[Get, Put]] = []
        varying = []
        for number, field in enumerate(fields):
            if max(number, len(self.columns)) >= MAX_COLUMNS:
                raise BadInput(f"a table of the topic would have more than {MAX_COLUMNS} columns")
            if field.path[-1:] != (NO_FIELD,) and not self._add_field(field):
                varying.append(field)
        stamps = [place for place, column in enumerate(self.columns) if column.name == STAMP]
        # These columns identify a row of this table in the tables of its arrays.
        self._identity = sorted({*range(len(keys)), *stamps})
        own_keys = [self.columns[place] for place in self._identity]
        self.arrays = [
            (elements_of(group), _array_table(name, own_keys, group, store, made)) for group in groups_of(varying)
        ]

    @property
    def row_count(self) -> int:
        """Number of rows that are not taken yet."""
        return len(self._rows)

    def add(self, keys: list[Any], message: Any) -> None:
        """Add the row of a message or an element, and the rows of its arrays."""
        row = list(keys)
        for get, put in self._puts:
            put(row, get(message))
        self._rows.append(row)
        for elements, table in self.arrays:
            outer = [row[place] for place in self._identity]
            for place, element in enumerate(elements(message)):
                table.add([*outer, place], element)

    def take_columns(self) -> list[list[Any]]:
        """Return the values of each column and remove all rows."""
        taken = [list(values) for values in zip(*self._rows, strict=True)]
        self._rows = []
        return taken or [[] for _ in self.columns]

    def _add_field(self, field: MessageField) -> bool:
        """Add the columns of a field; for an array that needs its own table, add only its length and return False."""
        get = getter(field.path)
        if field.node == Nodetype.NAME:
            self._add_column(field.base, Column("", "int64", NANOSECONDS, field.origin))
            self._puts.append((get, lambda row, value: row.append(ns_from_stamp(value))))
        elif field.node == Nodetype.BASE:
            self._add_column(field.base, _value_column(field, field.content[0], field.origin))
            # rosbags reads a byte with a sign.
            is_byte = field.content[0] in BYTES
            self._puts.append((get, (lambda row, value: row.append(value & 0xFF)) if is_byte else list.append))
        elif is_numbered(field):
            for place in range(field.content[1]):
                column = _value_column(field, field.content[0][1][0], f"{field.origin}[{place}]")
                self._add_column(field.base, column, f"_{place}")
            self._puts.append((get, partial(_put_array, field.content[1])))
        elif is_bytes(field):
            self._add_column(f"{field.base}_hex", Column("", TEXT, None, f"{field.origin}, two digits a byte"))
            self._puts.append((get, lambda row, value: row.append(bytes(value).hex())))
        else:
            self._add_column(f"{field.base}_count", Column("", "int32", None, f"length of {field.origin}"))
            self._puts.append((get, lambda row, value: row.append(len(value))))
            return False
        return True

    def _add_column(self, base: str, column: Column, number: str = "") -> None:
        """Add a column, named by its base, its unit and its number; a further number makes the name unique."""
        suffix = "" if column.unit is None or not column.unit.suffix else f"_{column.unit.suffix}"
        wanted = f"{base.removesuffix(suffix)}{suffix}{number}"
        self.columns.append(replace(column, name=_free_name(wanted, self.columns)))


class TopicRows:
    """Conversion of the messages of a topic to rows.

    Args:
        type_name: type of the messages.
        store: the definitions.

    Attributes:
        tables: tables of the topic; the table of the messages comes first.

    Raises:
        BadInput: see :class:`MessageTable`.
    """

    def __init__(self, type_name: str, store: Typestore) -> None:
        keys = [
            Column(LOG_TIME, "int64", NANOSECONDS, "log time in the bag"),
            Column("message_index", "int32", None, "number of the message, from 0"),
        ]
        self.tables: list[MessageTable] = []
        self._messages = MessageTable("", keys, fields_of(type_name, store), store, self.tables)
        self._message_count = 0

    def add(self, message: Any, log_time_ns: int) -> None:
        """Add the rows of one message."""
        self._messages.add([log_time_ns, self._message_count], message)
        self._message_count += 1


def _array_table(
    outer_name: str,
    outer_keys: list[Column],
    group: dict[MessageField, int],
    store: Typestore,
    made: list[MessageTable],
) -> MessageTable:
    """Return the table of an array, or of several arrays whose elements belong together, with a row per element."""
    field = next(iter(group))
    index = _free_name(f"{field.base}_index", outer_keys)
    keys = [*outer_keys, Column(index, "int32", None, f"place in {field.origin}, from 0")]
    node, content = field.content[0]
    fields: Iterable[MessageField]
    if len(group) > 1:
        fields = [
            MessageField((place,), *type_in_row(each, width), each.unit, None, each.base)
            for place, (each, width) in enumerate(group.items())
        ]
    elif node == Nodetype.NAME and content not in TIMES:
        fields = fields_of(content, store, inherited=field.unit)
    else:
        fields = [MessageField((), node, content, field.unit, None, field.base)]
    name = _unique_name(f"{outer_name}-{field.base}".lstrip("-"), {table.name.lower() for table in made})
    return MessageTable(name, keys, fields, store, made)


def _free_name(wanted: str, columns: list[Column]) -> str:
    """Return the name, with a number added if a column or an axis of a NetCDF file has this name."""
    return _unique_name(wanted, {known.name for known in columns} | _RESERVED)


def _unique_name(wanted: str, taken: set[str]) -> str:
    """Return the name, with a number added if the name, or the name in small letters, is taken."""
    names = chain([wanted], (f"{wanted}_{again}" for again in count(2)))
    return next(name for name in names if name not in taken and name.lower() not in taken)


def _value_column(field: MessageField, base_type: str, origin: str) -> Column:
    """Return the column of a number or text, without its name."""
    kind = _KINDS.get(base_type)
    if kind is None:
        raise BadInput(f"field {field.origin}: numbers of type {base_type} are unknown here")
    unit = None if kind in (TEXT, "bool") else field.unit
    return Column("", kind, unit, origin, field.standard_name, field.value_names)


def _put_array(length: int, row: list[Any], value: Any) -> None:
    # The value is None beyond the end of an array that shares a table with a longer array.
    values = [] if value is None else as_list(value)
    row.extend(values)
    row.extend([None] * (length - len(values)))

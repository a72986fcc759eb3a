"""Tables written as NetCDF-3 with the CF conventions: a record per row, a variable per column.

A column of 64-bit integers has two variables. The header is made by scipy. The records follow row by row, as the format
defines, so that a table of any length needs little memory. The width of a text column is known only after the last row;
until then the rows are in a temporary file.
"""

import io
import math
import pickle
import struct
import tempfile
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import netcdf_file

from ship_bags.errors import BadInput
from ship_bags.export.message_fields import cf_units, standard_name_on
from ship_bags.export.table_files import TableFile, TableHead
from ship_bags.export.table_rows import LOG_TIME, STAMP, TEXT, Column
from ship_bags.stamps import NS_PER_S

MAX_TEXT_BYTES = 32_768
"""Maximum length of a text, bytes; every row takes the size of the longest text of its column."""

ROW, TIME = "row", "time"

_CONVENTIONS = "CF-1.8"
_RECORD_COUNT = struct.Struct(">I")
_RECORD_COUNT_PLACE = 4
_MAX_RECORDS = 2**31 - 1
_WORD = 4
"""Alignment of the variables in a record, bytes."""

_CODES = {
    "float64": "d", "float32": "f", "int32": "i", "int16": "h", "int8": "b",
    # NetCDF-3 has no unsigned integers: the next wider type is used.
    "bool": "b", "uint8": "h", "uint16": "i", "uint32": "d",
    # NetCDF-3 has no 64-bit integers either: the nearest double is used, and a second variable with the remainder.
    "int64": "d", "uint64": "d",
}
_SPLIT = ("int64", "uint64")
_DTYPES = {"d": ">f8", "f": ">f4", "i": ">i4", "h": ">i2", "b": ">i1"}
_REMAINDER = "_remainder"
_COMMENT = (
    "int64 and uint64 numbers are two variables: the number is the first, as an integer, plus the one of the same name "
    "with _remainder. time is in seconds of POSIX UTC, in which leap seconds do not count; stamp_ns and log_time_ns "
    "count nanoseconds since 1970-01-01."
)


class _Variable(NamedTuple):
    """Variable of the file: name, type code and attributes."""

    name: str
    code: str
    attributes: dict[str, Any]


class NetcdfFile(TableFile):
    """NetCDF-3 file with the CF conventions; see the module."""

    suffix = ".nc"

    def __init__(self, path: Path, head: TableHead, columns: list[Column]) -> None:
        self._waiting = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115 - closed by discard
        super().__init__(path, head, columns)
        self._names = [column.name for column in columns]
        self._time_column = self._names.index(STAMP if STAMP in self._names else LOG_TIME)
        self._variables = self._all_variables()
        self._widths = [_WORD if variable.code == "c" else 0 for variable in self._variables]

    def _write(self, values: list[list[Any]]) -> None:
        arrays = [self._times(values[self._time_column])]
        for column, given in zip(self.columns, values, strict=True):
            of_column = _fill_missing(column, given)
            if column.kind == TEXT:
                arrays.append(np.array(self._encode(column, of_column)))
            elif column.kind in _SPLIT:
                nearest = [float(value) for value in of_column]
                arrays.append(np.array(nearest))
                rests = [value - int(near) for value, near in zip(of_column, nearest, strict=True)]
                arrays.append(np.array(rests, np.int32))
            else:
                arrays.append(np.array(of_column, _DTYPES[_CODES[column.kind]]))
        for place, array in enumerate(arrays):
            if self._widths[place]:
                self._widths[place] = max(self._widths[place], -(-array.itemsize // _WORD) * _WORD)
        pickle.dump(arrays, self._waiting, protocol=pickle.HIGHEST_PROTOCOL)
        self._waiting.flush()

    def _end(self) -> None:
        if self.row_count > _MAX_RECORDS:
            raise BadInput(f"more than {_MAX_RECORDS} rows: use --format csv or parquet", file=self.path)
        self._stream.write(self._header())
        record = self._record()
        self._waiting.seek(0)
        written = 0
        while written < self.row_count:
            arrays = pickle.load(self._waiting)
            rows = np.zeros(len(arrays[0]), record)
            for variable, array in zip(self._variables, arrays, strict=True):
                rows[variable.name] = array
            self._stream.write(rows.tobytes())
            written += len(rows)
        self._waiting.close()

    def discard(self) -> None:
        """See :meth:`TableFile.discard`."""
        self._waiting.close()
        super().discard()

    def _times(self, stamps_ns: list[int]) -> Any:
        """Return seconds since the epoch, each as the nearest double."""
        return np.array([(stamp_ns - self.head.epoch_ns) / NS_PER_S for stamp_ns in stamps_ns], np.float64)

    def _encode(self, column: Column, texts: list[str]) -> list[bytes]:
        encoded = [text.encode() for text in texts]
        longest = max(map(len, encoded), default=0)
        if longest > MAX_TEXT_BYTES:
            raise BadInput(
                f"topic '{self.head.topic}': a {column.name} of {longest} bytes; the limit for NetCDF is "
                f"{MAX_TEXT_BYTES}: use --format csv or parquet",
            )
        if any(text.endswith(b"\0") for text in encoded):
            raise BadInput(
                f"topic '{self.head.topic}': a {column.name} ends with the character NUL, which NetCDF cannot "
                "keep: use --format csv or parquet",
            )
        return encoded

    def _all_variables(self) -> list[_Variable]:
        time_origin = self.columns[self._time_column].origin
        variables = [_Variable(TIME, "d", _time_attributes(time_origin, self.head.epoch_ns))]
        for column in self.columns:
            code = "c" if column.kind == TEXT else _CODES[column.kind]
            variables.append(_Variable(column.name, code, _attributes(column, self.head.topic)))
            if column.kind in _SPLIT:
                rest = {"long_name": f"remainder of {column.name}", "coordinates": TIME}
                if column.unit is not None:
                    rest["units"] = column.unit.symbol
                variables.append(_Variable(self._free_name(f"{column.name}{_REMAINDER}"), "i", rest))
        return variables

    def _free_name(self, name: str) -> str:
        """Return the name, with underscores added if a column has this name."""
        while name in self._names:
            name += "_"
        return name

    def _record(self) -> np.dtype[Any]:
        """Return the layout of a row in the file."""
        formats = [
            f"S{width}" if width else _DTYPES[variable.code]
            for variable, width in zip(self._variables, self._widths, strict=True)
        ]
        places, end = [], 0
        for each in formats:
            places.append(end)
            end += -(-np.dtype(each).itemsize // _WORD) * _WORD
        names = [variable.name for variable in self._variables]
        return np.dtype({"names": names, "formats": formats, "offsets": places, "itemsize": end})

    def _header(self) -> bytes:
        """Return the part before the first row."""
        buffer = io.BytesIO()
        file = netcdf_file(buffer, "w")
        file.Conventions = _CONVENTIONS
        file.title = _ascii(self.head.title)
        file.source = _ascii(f"topic {self.head.topic} of type {self.head.type_name}")
        file.history = _ascii(f"ship_bags export of {self.head.bag}")
        file.comment = _COMMENT
        file.createDimension(ROW, None)
        for width in sorted({width for width in self._widths if width}):
            file.createDimension(f"characters_{width}", width)
        for variable, width in zip(self._variables, self._widths, strict=True):
            dimensions = (ROW, f"characters_{width}") if width else (ROW,)
            made = file.createVariable(variable.name, variable.code, dimensions)
            for name, value in variable.attributes.items():
                setattr(made, name, _ascii(value) if isinstance(value, str) else value)
            # The library derives sizes and offsets from one record, which is removed below.
            made[0] = b" " * width if width else 0
        file.flush()
        one_row = buffer.getvalue()
        file.close()
        head = bytearray(one_row[: len(one_row) - self._record().itemsize])
        _RECORD_COUNT.pack_into(head, _RECORD_COUNT_PLACE, self.row_count)
        return bytes(head)


def midnight_before(start_ns: int) -> int:
    """Return the midnight before a time; seconds since midnight, as doubles, have a resolution of 0.01 ns."""
    day_ns = 86_400 * NS_PER_S
    return start_ns // day_ns * day_ns


def _time_attributes(origin: str, epoch_ns: int) -> dict[str, str]:
    epoch = datetime.fromtimestamp(epoch_ns // NS_PER_S, tz=timezone.utc)
    return {
        "standard_name": "time",
        "long_name": f"time, {origin}",
        "units": f"seconds since {epoch:%Y-%m-%d %H:%M:%S}",
        "calendar": "standard",
        "axis": "T",
    }


def _attributes(column: Column, topic: str) -> dict[str, Any]:
    attributes: dict[str, Any] = {"long_name": column.origin, "coordinates": TIME}
    name = column.standard_name or standard_name_on(topic, column.origin)
    if column.unit is not None:
        attributes["units"] = cf_units(column.unit, name)
    if name is not None:
        attributes["standard_name"] = name
    if column.kind == TEXT:
        attributes["_Encoding"] = "utf-8"
    return attributes | _flags(column)


def _flags(column: Column) -> dict[str, Any]:
    """Return the attributes with the meanings of an enumeration's values, by the CF conventions."""
    if not column.kind.startswith(("int", "uint")) or column.kind in _SPLIT:
        return {}
    bounds = np.iinfo(column.kind)
    # The constants of a bag are untrusted.
    named = [(name, value) for name, value in column.value_names if bounds.min <= value <= bounds.max]
    if not named:
        return {}
    names, values = zip(*named, strict=True)
    return {"flag_values": np.array(values, _DTYPES[_CODES[column.kind]]), "flag_meanings": " ".join(names)}


def _fill_missing(column: Column, values: list[Any]) -> list[Any]:
    """Return the values, with an empty text, NaN or 0 for None, which NetCDF-3 cannot represent."""
    if not any(value is None for value in values):
        return values
    nothing: Any = "" if column.kind == TEXT else math.nan if column.kind.startswith("float") else 0
    return [nothing if value is None else value for value in values]


def _ascii(text: str) -> str:
    """Return a text for an attribute; characters outside ASCII become backslash escapes."""
    return text.encode("ascii", "backslashreplace").decode("ascii")

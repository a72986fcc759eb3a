"""Tables written as CSV and Parquet, in batches of rows; a file is renamed to its final name when it is complete."""

import csv
import io
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.export.table_rows import TEXT, Column
from ship_bags.output_files import csv_text, file_in_errors, open_new, part_path

_ROW_GROUP_BYTES = 8_000_000
"""Size of a row group of a Parquet table, bytes; readers are slow with many small groups."""


class TableHead(NamedTuple):
    """Description of a table: file name of the bag, topic, message type, array (empty for the table of the messages).

    ``epoch_ns`` is the zero of the time axis of a NetCDF file.
    """

    bag: str
    topic: str
    type_name: str
    array: str
    epoch_ns: int

    @property
    def title(self) -> str:
        """Title of the table for the user, one line."""
        of = f"{self.array} of " if self.array else ""
        return f"{of}topic {self.topic} ({self.type_name}) of {self.bag}"


class TableFile:
    """Table being written; the kinds of file differ in :meth:`_write` and :meth:`_end`.

    Args:
        path: file to write.
        head: description of the table.
        columns: columns of the table.

    Raises:
        OSError: the file cannot be created.
    """

    suffix = ""

    def __init__(self, path: Path, head: TableHead, columns: list[Column]) -> None:
        self.path = path
        self.head = head
        self.columns = columns
        self.row_count = 0
        self._part = part_path(path)
        with file_in_errors(self.path):
            self._stream = open_new(self._part)

    def append(self, values: list[list[Any]]) -> None:
        """Add rows, given column by column.

        Raises:
            BadInput: the format cannot represent the rows.
            OSError: the disk is full, or the like.
        """
        with file_in_errors(self.path):
            self._write(values)
        self.row_count += len(values[0])

    def finish(self) -> None:
        """Write the rest to the disk; the file does not have its final name yet.

        Raises:
            BadInput: the format cannot represent so many rows.
            OSError: the disk is full, or the like.
        """
        with file_in_errors(self.path):
            self._end()
            self._stream.flush()
            os.fsync(self._stream.fileno())

    def publish(self) -> None:
        """Rename the finished file to its final name.

        Raises:
            OSError: the name is now a folder, or the like.
        """
        with file_in_errors(self.path):
            self._part.replace(self.path)
            self._stream.close()

    def discard(self) -> None:
        """Remove the file unless it has its final name."""
        if not self._stream.closed:
            self._part.unlink(missing_ok=True)
            # Closing flushes the buffer, which fails again on a full disk.
            with suppress(OSError):
                self._stream.close()

    def _write(self, values: list[list[Any]]) -> None:
        raise NotImplementedError

    def _end(self) -> None:
        """Write the part after the last row."""


class CsvFile(TableFile):
    """CSV by RFC 4180 in UTF-8; numbers have the fewest digits that give the same number, truth values are 0 and 1.

    A text that a spreadsheet would take for a formula has ``'`` in front.
    """

    suffix = ".csv"

    def _write(self, values: list[list[Any]]) -> None:
        if self.row_count == 0:
            self._write_names()
        self._write_lines(zip(*map(_csv_values, self.columns, values), strict=True))

    def _end(self) -> None:
        if self.row_count == 0:
            self._write_names()

    def _write_names(self) -> None:
        self._write_lines([[column.name for column in self.columns]])

    def _write_lines(self, lines: Iterable[Iterable[Any]]) -> None:
        text = io.StringIO()
        csv.writer(text).writerows(lines)
        self._stream.write(text.getvalue().encode())


class ParquetFile(TableFile):
    """Parquet by pyarrow; unit and field of a column are in its metadata.

    Raises:
        BadInput: pyarrow is not installed.
    """

    suffix = ".parquet"

    def __init__(self, path: Path, head: TableHead, columns: list[Column]) -> None:
        pyarrow, parquet = _pyarrow()
        super().__init__(path, head, columns)
        self._pyarrow = pyarrow
        self._schema = pyarrow.schema(
            [
                pyarrow.field(
                    column.name,
                    "string" if column.kind == TEXT else column.kind,
                    metadata={"field": column.origin} | ({"unit": column.unit.symbol} if column.unit else {}),
                )
                for column in columns
            ],
            metadata={"title": head.title, "topic": head.topic, "type": head.type_name},
        )
        self._pending_batches: list[Any] = []
        self._writer = parquet.ParquetWriter(self._stream, self._schema)

    def _write(self, values: list[list[Any]]) -> None:
        arrays = [self._pyarrow.array(column, kind) for column, kind in zip(values, self._schema.types, strict=True)]
        self._pending_batches.append(self._pyarrow.record_batch(arrays, schema=self._schema))
        if sum(batch.nbytes for batch in self._pending_batches) > _ROW_GROUP_BYTES:
            self._write_group()

    def _end(self) -> None:
        self._write_group()
        self._writer.close()

    def _write_group(self) -> None:
        if self._pending_batches:
            self._writer.write_table(self._pyarrow.Table.from_batches(self._pending_batches, self._schema))
            self._pending_batches = []

    def discard(self) -> None:
        """See :meth:`TableFile.discard`."""
        # Otherwise the writer would write its footer at its deletion, into a closed file.
        with suppress(OSError, ValueError):
            self._writer.close()
        super().discard()


def check_parquet() -> None:
    """Check that Parquet can be written.

    Raises:
        BadInput: pyarrow is not installed.
    """
    _pyarrow()


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as problem:
        raise BadInput(
            "--format parquet needs the package pyarrow, which is not installed: make setup-all, or pip install "
            "pyarrow, or take --format csv or netcdf"
        ) from problem
    return pyarrow, pyarrow.parquet


def _csv_values(column: Column, values: list[Any]) -> Iterable[Any]:
    """Return the values of a column for csv; single-precision numbers become texts with the fewest digits needed."""
    if column.kind == "float32":
        return ["" if value is None else str(np.float32(value)) for value in values]
    if column.kind == "bool":
        return ["" if value is None else int(value) for value in values]
    if column.kind == TEXT:
        return ["" if value is None else csv_text(value) for value in values]
    return values

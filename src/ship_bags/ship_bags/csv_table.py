"""One table as a CSV file. Its column names carry the units."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.part_file import write_whole


def write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> Path:
    """Write a table; returns its path."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_text(value) for value in row] for row in rows)
    write_whole(path, table.getvalue())
    return path


def _text(value: Any) -> Any:
    """Five decimals hide no digit that counts, and make the same table the same file on every machine."""
    if not isinstance(value, (float, np.floating)):
        return value
    # A rounding to zero keeps no sign.
    return "" if np.isnan(value) else f"{round(float(value), 5) + 0.0:.5f}"

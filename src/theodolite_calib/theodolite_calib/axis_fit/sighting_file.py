"""Sightings from a file: a CSV table, or YAML with the same names under ``sightings``.

Whatever else sightings may come from ends in the same struct: :func:`read_sightings` chooses by the file's name.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_node.errors import BadInput
from ship_node.yaml_text import plain_data
from theodolite_calib.axis_fit.sightings import Sightings, directions

COLUMNS = {
    "encoder_azimuth_deg": "azimuth encoder, clockwise seen from above",
    "encoder_elevation_deg": "elevation encoder, up positive; over 90 where the telescope is plunged",
    "azimuth_offset_deg": "true azimuth minus encoder, not multiplied by cos E",
    "elevation_offset_deg": "true elevation minus encoder",
}
"""Columns that must be there, with their meaning."""

LABEL_COLUMN = "observation"
"""Column with the user's own numbers, optional; without it the rows are numbered from 1."""

_ELEVATIONS_DEG = (-90.0, 270.0)
_YAML_KEY = "sightings"

# Where a row stands, for messages, and its values by column.
_Row = tuple[str, Mapping[str, Any]]


def read_sightings(path: Path) -> Sightings:
    """The sightings of a file.

    Raises:
        BadInput: names the file, the row, the column and what was expected.
        OSError: the file cannot be read.
    """
    readers = {".csv": _csv_rows, ".yaml": _yaml_rows, ".yml": _yaml_rows}
    if path.suffix.lower() not in readers:
        hint = "; `ship_replay axis_sightings` makes a table of a bag" if path.suffix.lower() == ".mcap" else ""
        raise BadInput(f"{path}: sightings are read from .csv, .yaml or .yml{hint}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not a text in UTF-8: {error.reason} at byte {error.start}") from error
    rows = list(readers[path.suffix.lower()](path, text))
    if not rows:
        raise BadInput(f"{path}: no sightings")
    labels = tuple(str(values.get(LABEL_COLUMN, number)) for number, (_, values) in enumerate(rows, start=1))
    numbers = np.array([[_number(place, values, column) for column in COLUMNS] for place, values in rows])
    _refuse_radians(path, numbers)
    azimuth, elevation, azimuth_offset, elevation_offset = np.deg2rad(numbers.T)
    return Sightings(labels, azimuth, elevation, directions(azimuth + azimuth_offset, elevation + elevation_offset))


def _csv_rows(path: Path, text: str) -> Iterator[_Row]:
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True, strict=True)
    try:
        _refuse_missing(str(path), reader.fieldnames or [])
        for values in reader:
            place = f"{path}:{reader.line_num}"
            if None in values or None in values.values():
                raise BadInput(f"{place}: expected {len(reader.fieldnames or [])} values as in the first line")
            yield place, values
    except csv.Error as error:
        raise BadInput(f"{path}:{reader.reader.line_num}: {error}") from error


def _yaml_rows(path: Path, text: str) -> Iterator[_Row]:
    document = plain_data(str(path), text)
    rows = document.get(_YAML_KEY) if isinstance(document, dict) else None
    if not isinstance(rows, list):
        raise BadInput(f"{path}: expected '{_YAML_KEY}:' with a list of sightings")
    for number, values in enumerate(rows, start=1):
        place = f"{path}: sighting {number}"
        if not isinstance(values, dict):
            raise BadInput(f"{place}: expected {', '.join(COLUMNS)}, got {values!r:.40}")
        _refuse_missing(place, values)
        yield place, values


def _refuse_missing(place: str, found: Any) -> None:
    missing = [column for column in COLUMNS if column not in found]
    if missing:
        listed = ", ".join(map(str, found)) or "nothing"
        raise BadInput(f"{place}: columns missing: {', '.join(missing)} (degrees); found: {listed}")


def _number(place: str, values: Mapping[str, Any], column: str) -> float:
    value = values[column]
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"{place}: {column} is {value!r:.40}: expected a finite number of degrees")
    low, high = _ELEVATIONS_DEG
    if column == "encoder_elevation_deg" and not low <= number <= high:
        raise BadInput(f"{place}: {column} = {number:g} is out of its range [{low:g}, {high:g}] degrees")
    return number


def _refuse_radians(path: Path, numbers: np.ndarray) -> None:
    """Angles that all look like radians: in degrees they would be sightings of one spot near the horizon."""
    azimuths, elevations = np.abs(numbers[:, 0]), np.abs(numbers[:, 1])
    if np.max(azimuths) <= 2.0 * np.pi and np.max(elevations) <= np.pi:
        raise BadInput(
            f"{path}: encoder_azimuth_deg is at most {np.max(azimuths):.3g}, encoder_elevation_deg at most "
            f"{np.max(elevations):.3g}: these look like radians, expected degrees"
        )

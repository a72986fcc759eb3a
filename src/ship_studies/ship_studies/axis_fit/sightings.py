"""Sightings of known directions: residuals of an axis model, common errors, coverage of the sky, and their file.

A common error is a Gauss-Markov process in time, or a constant if its correlation time is infinite. One sigma of the
error shifts the direction of a sighting by the stated effect, so that two sightings have the covariance

    sum over the errors of  effect_i effect_jᵀ exp(-|t_i - t_j| / T)

:meth:`Sightings.correlated_map` is a root of this covariance. Each column of the root belongs to a further unknown of
the fit, with the prior variance 1.

:func:`read_sightings` reads a CSV table, or YAML with the same names under ``sightings``. Further columns state the
common errors. ``slow_right_arcsec:NAME:T`` and ``slow_up_arcsec:NAME:T`` are the effect of one sigma of the error NAME
on each sighting. T is the correlation time of NAME in seconds, ``inf`` for a constant error. All sightings of one
``group`` have a common rotation error of the base about each of its axes, with the sigma ``group_sigma_arcsec``.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.input_files import plain_data
from ship_geometry.mount.axes import (
    AxisErrors,
    direction_change,
    encoder_angles,
    main_axis,
    main_axis_rotation,
)
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, wrap_pi

MAX_SIGHTINGS = 1000
"""Maximum number of sightings with errors correlated in time, whose joint covariance is decomposed as a whole."""

_MIN_EFFECT_RAD = 0.1 * ARCSEC
"""Maximum joint effect of the columns that the map omits, rad RMS.

So small an effect cannot be separated from the sightings' own errors.
"""

COLUMNS = {
    "encoder_azimuth_deg": "azimuth encoder, clockwise seen from above",
    "encoder_elevation_deg": "elevation encoder, up positive; over 90 where the telescope is plunged",
    "azimuth_offset_deg": "true azimuth minus encoder, not multiplied by cos E",
    "elevation_offset_deg": "true elevation minus encoder",
}
"""Required columns, with their meaning."""

LABEL_COLUMN = "observation"
"""Column with the user's own numbers, optional; without this column the rows are numbered from 1."""

TIME_COLUMN = "time_s"
"""Column with the time of the sighting, UTC as POSIX time, required only for errors correlated in time."""

GROUP_COLUMNS = ("group", "group_sigma_arcsec")

_SIDES = ("slow_right_arcsec", "slow_up_arcsec")
_ELEVATIONS_DEG = (-90.0, 270.0)
_YAML_KEY = "sightings"


@dataclass(frozen=True)
class SharedError:
    """Error common to several sightings.

    Attributes:
        name: name of the error.
        time_s: correlation time, s; infinite for a constant.
        effect: effect of one sigma on each sighting, to the right and up, shape (n, 2), rad.
    """

    name: str
    time_s: float
    effect: FloatArray


def _covariance(time_correlated: list[SharedError], time_s: FloatArray) -> FloatArray:
    """Return the covariance of the sightings due to time-correlated errors, right and up in turn, (2 n, 2 n), rad²."""
    interval_s = np.abs(np.subtract.outer(time_s, time_s))
    covariance = np.zeros((2 * len(time_s), 2 * len(time_s)))
    for correlation_s, errors in groupby(time_correlated, key=lambda error: error.time_s):
        effects = np.stack([error.effect.ravel() for error in errors], axis=-1)
        # An error with a correlation time of zero is white: independent at each time.
        correlation = np.exp(-interval_s / correlation_s) if correlation_s > 0.0 else (interval_s == 0.0).astype(float)
        covariance += (effects @ effects.T) * np.repeat(np.repeat(correlation, 2, axis=0), 2, axis=1)
    return covariance


def _root(covariance: FloatArray) -> FloatArray:
    """Return a root of the covariance, without negligible columns, shape (2 n, q)."""
    values, vectors = np.linalg.eigh(covariance)
    # Eigenvalues are in ascending order. The first eigenvalues, with a negligible joint effect, are omitted.
    is_significant = np.cumsum(np.maximum(values, 0.0)) > _MIN_EFFECT_RAD**2 * len(values)
    root: FloatArray = vectors[:, is_significant] * np.sqrt(values[is_significant])
    return root


@dataclass(frozen=True)
class Sightings:
    """Encoder readings for known directions of the optical axis.

    Attributes:
        labels: label of each sighting from the table; the row number if the table has no labels.
        azimuth: reading of the azimuth encoder, rad, shape (n,).
        elevation: reading of the elevation encoder, beyond the zenith if the telescope is plunged, rad, shape (n,).
        direction_d: true direction of the optical axis, unit vectors in the base's frame, shape (n, 3).
        time_s: time of each sighting, s, UTC as POSIX time or from any other start, shape (n,); None if unknown.
        correlated_errors: errors that are common to several sightings.
        repeated: for each row that repeats a sighting and is not used, its label and that of the first: ``5 (as 3)``.
    """

    labels: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    direction_d: FloatArray
    time_s: FloatArray | None = None
    correlated_errors: tuple[SharedError, ...] = ()
    repeated: tuple[str, ...] = ()

    def correlated_map(self) -> FloatArray:
        """Return the effects of independent errors of variance 1 on the sightings, shape (n, 2, q), rad."""
        errors, count = sorted(self.correlated_errors, key=lambda error: error.time_s), len(self.labels)
        columns = [error.effect.reshape(2 * count, 1) for error in errors if np.isinf(error.time_s)]
        time_correlated = [error for error in errors if not np.isinf(error.time_s)]
        if time_correlated:
            assert self.time_s is not None
            columns.append(_root(_covariance(time_correlated, self.time_s)))
        return np.hstack([np.zeros((2 * count, 0)), *columns]).reshape(count, 2, -1)

    def offsets(self) -> tuple[FloatArray, FloatArray]:
        """Return true direction minus reading in azimuth and elevation, on the face of the reading, (n,), rad."""
        plain, over = (encoder_angles(AxisErrors(), self.direction_d, plunged=plunged) for plunged in (False, True))
        is_over = np.cos(self.elevation) < 0.0
        azimuth, elevation = (np.where(is_over, *pair) for pair in zip(over, plain, strict=True))
        return wrap_pi(azimuth - self.azimuth), wrap_pi(elevation - self.elevation)

    def residuals(self, errors: AxisErrors) -> FloatArray:
        """Return true minus modelled direction, as angles to the right and up on the sky, shape (n, 2), rad."""
        model_d = main_axis_rotation(errors, self.azimuth, self.elevation)[..., 0]
        return _sky_angles(self.direction_d, model_d)

    def linearise(self, errors: AxisErrors) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n, 2), and the derivative of the modelled direction per axis error, shape (n, 2, 7)."""
        axis = main_axis(errors, self.azimuth, self.elevation)
        model_d = axis.rotation_dm[..., 0]
        change = right_and_up(self.direction_d) @ direction_change(model_d, axis.by_error)
        return _sky_angles(self.direction_d, model_d), change


def directions(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return unit vectors (bow, up, starboard) from azimuth and elevation, shape (..., 3)."""
    return main_axis_rotation(AxisErrors(), azimuth, elevation)[..., 0]


def _sky_angles(true_d: FloatArray, model_d: FloatArray) -> FloatArray:
    """Return the angle from the modelled to the true direction, resolved to the right and up."""
    sines = -(right_and_up(true_d) @ model_d[..., None])[..., 0]
    sine = np.linalg.norm(sines, axis=-1)
    angle = angle_between(true_d, model_d)
    return sines * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)[..., None]


def right_and_up(direction_d: FloatArray) -> FloatArray:
    """Return unit vectors to the right (horizontal) and up, perpendicular to a direction, shape (..., 2, 3)."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0])
    zero = np.zeros_like(azimuth)
    right = np.stack([-np.sin(azimuth), zero, np.cos(azimuth)], axis=-1)
    return np.stack([right, np.cross(right, direction_d)], axis=-2)


@dataclass(frozen=True)
class Coverage:
    """Coverage of the sky by the sightings.

    Attributes:
        count: number of sightings.
        plunged: number of sightings with the telescope beyond the zenith.
        elevations: least and greatest true elevation, rad.
        azimuth_gap: widest range of azimuth without a sighting, (from, to) clockwise, rad.
    """

    count: int
    plunged: int
    elevations: tuple[float, float]
    azimuth_gap: tuple[float, float]

    @property
    def azimuth_gap_width(self) -> float:
        """Width of the gap, in (0, 2 pi], rad; the full circle if all sightings have one azimuth."""
        width = (self.azimuth_gap[1] - self.azimuth_gap[0]) % (2.0 * np.pi)
        return width if width > 0.0 else 2.0 * np.pi


def coverage(sightings: Sightings) -> Coverage:
    """Return the coverage of the sky by one or more sightings."""
    azimuth, elevation = azimuth_and_elevation(sightings.direction_d)
    ordered = np.sort(azimuth)
    following = np.roll(ordered, -1)
    widest = int(np.argmax((following - ordered) % (2.0 * np.pi)))
    return Coverage(
        count=len(sightings.labels),
        plunged=int(np.sum(np.cos(sightings.elevation) < 0.0)),
        elevations=(float(elevation.min()), float(elevation.max())),
        azimuth_gap=(float(ordered[widest]), float(following[widest])),
    )


def azimuth_and_elevation(direction_d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in [0, 2 pi) and elevation of unit vectors, shape (n,), rad."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0]) % (2.0 * np.pi)
    return azimuth, np.arctan2(direction_d[..., 1], np.hypot(direction_d[..., 0], direction_d[..., 2]))


class _Place(NamedTuple):
    """Place of values: the file, the line if known, and the name of the entry in the file."""

    file: Path
    line: int | None = None
    entry: str = ""

    def error(self, reason: str, value: Any = None) -> BadInput:
        """Return the error for values at this place."""
        reason = f"{self.entry}: {reason}" if self.entry else reason
        return BadInput(reason, file=self.file, line=self.line, value=value)


_Row = tuple[_Place, Mapping[str, Any]]
"""Place of a row, and its values by column."""


def read_sightings(path: Path) -> Sightings:
    """Return the sightings of a file.

    Raises:
        BadInput: the content of the file is wrong; the error names the place as closely as it is known.
        OSError: the file cannot be read.
    """
    readers = {".csv": _csv_rows, ".yaml": _yaml_rows, ".yml": _yaml_rows}
    if path.suffix.lower() not in readers:
        hint = "; `ship_studies axis_sightings` makes a table of a bag" if path.suffix.lower() == ".mcap" else ""
        raise BadInput(f"sightings are read from .csv, .yaml or .yml{hint}", file=path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"not a text in UTF-8: {error.reason} at byte {error.start}", file=path) from error
    rows = list(readers[path.suffix.lower()](path, text))
    if not rows:
        raise BadInput("no sightings", file=path)
    numbered, repeated = _without_repeats(rows)
    labels = tuple(str(values.get(LABEL_COLUMN, number)) for number, (_, values) in numbered)
    table = [row for _, row in numbered]
    numbers = np.array([[_number(place, values, column, "degrees") for column in COLUMNS] for place, values in table])
    _refuse_radians(path, numbers)
    azimuth, elevation, azimuth_offset, elevation_offset = np.deg2rad(numbers.T)
    direction_d = directions(azimuth + azimuth_offset, elevation + elevation_offset)
    time_s = _column(table, TIME_COLUMN, "seconds") if TIME_COLUMN in table[0][1] else None
    correlated = (*_correlated_errors(path, table), *_group_errors(table, direction_d))
    if time_s is None and not all(np.isinf(error.time_s) for error in correlated):
        raise BadInput(f"columns missing: {TIME_COLUMN}: required for errors correlated in time", file=path)
    return Sightings(labels, azimuth, elevation, direction_d, time_s, correlated, repeated)


def correlated_column(side: int, name: str, time_s: float) -> str:
    """Return the name of the column with the effect of a correlated error to the right (0) or up (1)."""
    return f"{_SIDES[side]}:{name}:{time_s:g}"


def _without_repeats(rows: list[_Row]) -> tuple[list[tuple[int, _Row]], tuple[str, ...]]:
    """Return the numbered rows, each sighting once, and the labels of the rows that repeat a sighting."""
    kept: dict[tuple[str, ...], tuple[int, _Row]] = {}
    repeated = []
    for number, (place, values) in enumerate(rows, start=1):
        # Two rows with the same angles and the same time are one sighting, whatever their labels.
        key = tuple(str(values.get(column)).strip() for column in (*COLUMNS, TIME_COLUMN))
        if key in kept:
            first = kept[key][1][1]
            repeated.append(f"{values.get(LABEL_COLUMN, number)} (as {first.get(LABEL_COLUMN, kept[key][0])})")
        else:
            kept[key] = (number, (place, values))
    return list(kept.values()), tuple(repeated)


def _column(table: list[_Row], column: str, unit: str) -> np.ndarray:
    return np.array([_number(place, values, column, unit) for place, values in table])


def _correlated_errors(path: Path, table: list[_Row]) -> Iterator[SharedError]:
    """Yield the errors from pairs of columns ``slow_right_arcsec:NAME:T``, ``slow_up_arcsec:NAME:T``."""
    names = [column for column in table[0][1] if str(column).startswith(tuple(f"{side}:" for side in _SIDES))]
    for key in dict.fromkeys(column.split(":", 1)[1] for column in names):
        name, _, time = key.rpartition(":")
        pair = [f"{side}:{key}" for side in _SIDES]
        if not name or any(column not in names for column in pair):
            expected = f"{_SIDES[0]}:NAME:T and {_SIDES[1]}:NAME:T"
            raise BadInput(f"slow error '{key}': expected columns {expected}", file=path)
        try:
            time_s = float(time)
        except ValueError:
            time_s = math.nan
        if not time_s >= 0.0:
            reason = f"slow error '{key}': correlation time '{time}': expected seconds, or inf"
            raise BadInput(reason, file=path, value=time)
        effect = np.stack([_column(table, column, "arcsec") for column in pair], axis=-1)
        yield SharedError(name, time_s, ARCSEC * effect)


def _group_errors(table: list[_Row], direction_d: np.ndarray) -> Iterator[SharedError]:
    """Yield the errors from the group columns: for each group, rotations of the base about its three axes."""
    group, sigma = GROUP_COLUMNS
    if group not in table[0][1]:
        return
    for place, values in table:
        if group not in values or sigma not in values:
            raise place.error(f"columns missing: {', '.join(GROUP_COLUMNS)} belong together")
    sigmas = ARCSEC * _column(table, sigma, "arcsec")
    turned = right_and_up(direction_d) @ direction_change(direction_d, np.eye(3))
    groups = np.array([str(values[group]).strip() for _, values in table])
    for name in dict.fromkeys(groups.tolist()):
        inside = np.where(groups == name, sigmas, 0.0)[:, None]
        for axis in range(3):
            yield SharedError(f"{group} {name}.{axis + 1}", math.inf, inside * turned[..., axis])


def _csv_rows(path: Path, text: str) -> Iterator[_Row]:
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True, strict=True)
    try:
        _refuse_missing(_Place(path), reader.fieldnames or [])
        for values in reader:
            place = _Place(path, reader.line_num)
            if None in values or None in values.values():
                raise place.error(f"expected {len(reader.fieldnames or [])} values as in the first line")
            yield place, values
    except csv.Error as error:
        raise BadInput(str(error), file=path, line=reader.reader.line_num) from error


def _yaml_rows(path: Path, text: str) -> Iterator[_Row]:
    document = plain_data(str(path), text)
    rows = document.get(_YAML_KEY) if isinstance(document, dict) else None
    if not isinstance(rows, list):
        raise BadInput(f"expected '{_YAML_KEY}:' with a list of sightings", file=path)
    for number, values in enumerate(rows, start=1):
        place = _Place(path, entry=f"sighting {number}")
        if not isinstance(values, dict):
            raise place.error(f"expected {', '.join(COLUMNS)}, got {values!r:.40}", values)
        _refuse_missing(place, values)
        yield place, values


def _refuse_missing(place: _Place, found: Any) -> None:
    missing = [column for column in COLUMNS if column not in found]
    if missing:
        listed = ", ".join(map(str, found)) or "nothing"
        raise place.error(f"columns missing: {', '.join(missing)} (degrees); found: {listed}")


def _number(place: _Place, values: Mapping[str, Any], column: str, unit: str) -> float:
    value: Any = values.get(column)
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise place.error(f"{column} is {value!r:.40}: expected a finite number of {unit}", value)
    low, high = _ELEVATIONS_DEG
    if column == "encoder_elevation_deg" and not low <= number <= high:
        raise place.error(f"{column} = {number:g} is out of its range [{low:g}, {high:g}] degrees", number)
    return number


def _refuse_radians(path: Path, numbers: np.ndarray) -> None:
    """Refuse angles that are all in the range of radians; in degrees this would be one point near the horizon."""
    azimuths, elevations = np.abs(numbers[:, 0]), np.abs(numbers[:, 1])
    if np.max(azimuths) <= 2.0 * np.pi and np.max(elevations) <= np.pi:
        raise BadInput(
            f"encoder_azimuth_deg is at most {np.max(azimuths):.3g}, encoder_elevation_deg at most "
            f"{np.max(elevations):.3g}: these look like radians, expected degrees",
            file=path,
        )

"""What plots show: ring buffers of the last minutes, filled by :class:`ship_watch.watch.Watch`.

Every series is a bounded queue of points in the order of their times. A plot takes from it what is newer than the last
point that it has.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_watch.names import has_room
from ship_watch.picture import Safety

KEPT_S = 600.0
"""Length of the buffers, s."""

_KEPT_NS = round(KEPT_S * 1e9)

MOST_KEPT = 30_000
"""Points of a buffer, whatever their times: 50 a second."""


@dataclass(frozen=True)
class InnovationPoint:
    """One measurement of a source: the mean of its residuals along each axis, rad or m, and whether it was accepted.

    ``sigma`` is the root mean square of the stated sigmas of what the mean is over: parts share much of their error, so
    that it is not divided by the root of their number. ``parts`` are the residuals of its single stars or lights along
    the same axes, shape (n, axes), ``part_names`` what its components call them ("HIP 85355", "a"); of an attitude or
    an encoder there is one part, without a name.
    """

    utc_ns: int
    axes: tuple[str, ...]
    mean: FloatArray
    sigma: FloatArray
    parts: FloatArray
    nis: float
    gate: float
    is_accepted: bool
    reason: str
    part_names: tuple[str, ...] = ()


@dataclass(frozen=True)
class ErrorPoint:
    """Error against truth (NaN without) and sigma of each channel of an ``error_arcsec`` topic, arcsec."""

    utc_ns: int
    error: Mapping[str, float]
    sigma: Mapping[str, float]


@dataclass(frozen=True)
class BudgetPoint:
    """Variance of each source of error about East, North and Up, rad², shape (3,) each; ``total`` of all.

    ``by_angle`` are the variances of the same sources in each angle that is shown, rad², as
    :func:`ship_watch.budget.angle_variances` makes them: heading, pitch and roll, or azimuth times the cosine of the
    elevation, and elevation.
    """

    utc_ns: int
    variances: Mapping[str, FloatArray]
    total: FloatArray
    by_angle: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class SafetyPoint:
    """The worst word of each angle within one second; None where the angle was not told."""

    utc_ns: int
    words: Mapping[str, Safety | None]


@dataclass(frozen=True)
class LightPoint:
    """A light on the detector, m along right and up, and its residual on the sky, rad, NaN where unknown."""

    utc_ns: int
    x: float
    z: float
    x_residual: float
    z_residual: float
    is_used: bool


@dataclass(frozen=True)
class StarsSeen:
    """The last exposure of a star sensor, as (n,) arrays.

    Attributes:
        utc_ns: middle of the exposure.
        u: columns, pixel.
        v: rows, pixel.
        is_accepted: whether the filter took the solution.
        star_count: stars used; ``rejected_count``: left out.
        azimuth: of the sensor's boresight in the horizon frame, rad; NaN where no solution is told.
        elevation: likewise, rad.
        residual_right: measured minus predicted place of each star along the sensor's right, rad, in the order of
            ``u``; NaN where none is told for a star, which was then not used; empty where none is told at all.
        residual_up: likewise along its up.
    """

    utc_ns: int
    u: FloatArray
    v: FloatArray
    is_accepted: bool
    star_count: int
    rejected_count: int
    azimuth: float
    elevation: float
    residual_right: FloatArray = field(default_factory=lambda: np.empty(0))
    residual_up: FloatArray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class ParameterShown:
    """An alignment or calibration state, its sigma and its nominal value, in ``unit`` (rad, s, m, px, 1).

    States that are errors are nominally zero. Of installation angles and of a focal length the nominal value stands in
    the configuration, which no topic tells: then it is the value that was heard first; NaN where none was.
    """

    name: str
    value: float
    sigma: float
    unit: str
    is_observable: bool
    nominal: float = math.nan


@dataclass
class History:
    """All that plots draw.

    Attributes:
        innovations: by source, as ``star.bow``.
        errors: by the topic that tells them, as ``ship/error_arcsec``, though they may be made here.
        budgets: by topic, as ``ship/error_budget``.
        ribbons: one point a second.
        lights: by beacon.
        stars: by source, as ``star.bow``.
        alignment: the states of ``ship/alignment``, as told last.
        calibration: the parameters of ``theodolite/calibration``, as told last.
        position: geodetic latitude and longitude of the last fix, rad; None before the first.
    """

    innovations: dict[str, deque[InnovationPoint]] = field(default_factory=dict)
    errors: dict[str, deque[ErrorPoint]] = field(default_factory=dict)
    budgets: dict[str, deque[BudgetPoint]] = field(default_factory=dict)
    ribbons: deque[SafetyPoint] = field(default_factory=deque)
    lights: dict[str, deque[LightPoint]] = field(default_factory=dict)
    stars: dict[str, StarsSeen] = field(default_factory=dict)
    alignment: tuple[ParameterShown, ...] = ()
    calibration: tuple[ParameterShown, ...] = ()
    position: tuple[float, float] | None = None


class Timed(Protocol):
    """A point of a buffer."""

    @property
    def utc_ns(self) -> int:
        """Its time."""
        ...


Point = TypeVar("Point", bound=Timed)


def append(buffers: dict[str, deque[Point]], name: str, point: Point) -> None:
    """Add a point to the buffer of a name; one that is older than the last takes its place among them."""
    buffer = buffers.get(name)
    if buffer is None:
        if not has_room(buffers, name, "plotted name"):
            return
        buffer = buffers[name] = deque(maxlen=MOST_KEPT)
    append_point(buffer, point)


def append_point(buffer: deque[Point], point: Point) -> None:
    """Add a point to a buffer, in the order of times, and forget those that are too old."""
    place = len(buffer)
    while place and buffer[place - 1].utc_ns > point.utc_ns:
        place -= 1
    if place == len(buffer):
        buffer.append(point)
    elif len(buffer) < MOST_KEPT:
        buffer.insert(place, point)
    while buffer[-1].utc_ns - buffer[0].utc_ns > _KEPT_NS:
        buffer.popleft()


def place_in_order(buffers: dict[str, deque[Point]], name: str, point: Point) -> None:
    """Put a point in the place of the one of the same time, where there is one; add it otherwise."""
    buffer = buffers.get(name, deque())
    for place in range(len(buffer) - 1, -1, -1):
        if buffer[place].utc_ns == point.utc_ns:
            buffer[place] = point
            return
        if buffer[place].utc_ns < point.utc_ns:
            break
    append(buffers, name, point)


def newer(points: Sequence[Point], taken_ns: int | None) -> list[Point]:
    """The points after a time, in their order; all where it is None.

    Args:
        points: in the order of their times.
        taken_ns: time of the last one that a plot has, ns.
    """
    if taken_ns is None:
        return list(points)
    # From the end, since a buffer holds ten minutes of which little is new.
    return list(takewhile(lambda point: point.utc_ns > taken_ns, reversed(points)))[::-1]


def extremes(values: FloatArray, starts: Sequence[int]) -> NDArray[np.intp]:
    """Rows that a line of few points keeps: of each stretch the least and the largest of each column, in their order.

    Args:
        values: shape (n, columns); what is not finite is neither, but a stretch of nothing else keeps its first row, so
            that a gap stays.
        starts: first rows of the stretches, rising from 0; the last ends with the rows.
    """
    kept: list[int] = []
    for start, end in pairwise([*starts, len(values)]):
        found = set()
        for column in values[start:end].T:
            known = np.flatnonzero(np.isfinite(column))
            if len(known):
                found |= {start + int(known[np.argmin(column[known])]), start + int(known[np.argmax(column[known])])}
        kept += sorted(found) or [start]
    return np.array(kept, np.intp)

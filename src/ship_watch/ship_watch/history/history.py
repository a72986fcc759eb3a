"""Data of the plots: ring buffers of the last minutes, and detected stars and lights joined with their innovations.

:class:`ship_watch.suite_monitor.SuiteMonitor` fills the buffers. Every series is a bounded queue of points in the order
of their times. A plot reads the points after its last point. Detections arrive in one message, decision and residuals
in another message with the same stamp. Either message may arrive first.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import FloatArray
from ship_watch.suite_state import Safety
from ship_watch.topics import has_room

HISTORY_S = 600.0
"""Length of the buffers, s."""

_HISTORY_NS = round(HISTORY_S * 1e9)

MAX_POINTS = 30_000
"""Maximum number of points of a buffer: 50 a second."""

_PENDING_MESSAGES = 8
"""Maximum number of exposures of a sensor, and of innovations, that wait for their counterpart."""

_INNOVATION_TIMEOUT_NS = 3_000_000_000
"""Time without an innovation after which lights are shown without residuals, ns."""

_NO_VALUES = np.empty(0)


@dataclass(frozen=True)
class InnovationPoint:
    """Innovation of one measurement of a source.

    Attributes:
        utc_ns: time of the measurement, UTC as POSIX time.
        axes: names of the axes of the residuals.
        mean: mean of the residuals along each axis, rad or m, shape (axes,).
        sigma: root mean square of the stated sigmas of the residuals, shape (axes,). This value is not divided by the
            root of the number of residuals, because the residuals share much of their error.
        is_accepted: True if the measurement was accepted.
    """

    utc_ns: int
    axes: tuple[str, ...]
    mean: FloatArray
    sigma: FloatArray
    is_accepted: bool


@dataclass(frozen=True)
class ErrorPoint:
    """Error against truth (NaN without truth) and sigma of each channel of an ``error_arcsec`` topic, arcsec."""

    utc_ns: int
    error: Mapping[str, float]
    sigma: Mapping[str, float]


@dataclass(frozen=True)
class BudgetPoint:
    """Error budget at one time.

    Attributes:
        utc_ns: time of the budget, UTC as POSIX time.
        by_angle: angle → source of error → variance, rad²
            (:func:`ship_watch.history.history_recorder.angle_variances`): heading, pitch and roll, or azimuth times the
            cosine of the elevation, and elevation.
    """

    utc_ns: int
    by_angle: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class SafetyPoint:
    """Worst safety of each angle within one second; None if the angle was not published."""

    utc_ns: int
    safety: Mapping[str, Safety | None]


@dataclass(frozen=True)
class BeaconPoint:
    """Position of a light on the detector along right and up, m, and its residual on the sky, rad, NaN if unknown."""

    utc_ns: int
    x: float
    z: float
    x_residual: float
    z_residual: float
    is_used: bool


@dataclass(frozen=True)
class ExposurePoint:
    """Last exposure of a star sensor, with arrays of shape (n,) for its stars.

    Attributes:
        utc_ns: middle of the exposure, UTC as POSIX time.
        u: columns of the stars on the detector, pixel.
        v: rows of the stars on the detector, pixel.
        is_accepted: True if the filter accepted the solution.
        star_count: number of used stars.
        rejected_count: number of rejected stars.
        azimuth: azimuth of the sensor's boresight in the horizon frame, rad; NaN without a solution.
        elevation: elevation of the boresight, rad; NaN without a solution.
        residual_right: measured minus predicted position of each star along the sensor's right axis, rad, in the order
            of ``u``. NaN for a star that was not used; empty if the innovation contains no stars.
        residual_up: residuals along the sensor's up axis, in the form of ``residual_right``.
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
class ParameterEstimate:
    """An estimated alignment or calibration state, its sigma and its nominal value, in ``unit`` (rad, s, m, px, 1).

    States that are errors are nominally zero. The nominal values of installation angles and focal lengths are in the
    configuration, which is not published. The first received value is used instead, or NaN before the first value.
    """

    name: str
    value: float
    sigma: float
    unit: str
    is_observable: bool
    nominal: float = math.nan


@dataclass
class History:
    """Data of all plots.

    Attributes:
        innovations: source (``star.bow``) → innovations of its measurements.
        errors: topic (``ship/error_arcsec``) → errors from this topic, or computed against the truth.
        budgets: topic (``ship/error_budget``) → error budgets.
        safety: worst safety of each angle, one point a second.
        beacons: id of a light → its positions on the detector.
        star_exposures: source (``star.bow``) → last exposure.
        alignment: the states of the last ``ship/alignment``.
        calibration: the parameters of the last ``theodolite/calibration``.
        position: geodetic latitude and longitude of the last fix, rad; None before the first fix.
    """

    innovations: dict[str, deque[InnovationPoint]] = field(default_factory=dict)
    errors: dict[str, deque[ErrorPoint]] = field(default_factory=dict)
    budgets: dict[str, deque[BudgetPoint]] = field(default_factory=dict)
    safety: deque[SafetyPoint] = field(default_factory=deque)
    beacons: dict[str, deque[BeaconPoint]] = field(default_factory=dict)
    star_exposures: dict[str, ExposurePoint] = field(default_factory=dict)
    alignment: tuple[ParameterEstimate, ...] = ()
    calibration: tuple[ParameterEstimate, ...] = ()
    position: tuple[float, float] | None = None


class Timed(Protocol):
    """A point of a buffer."""

    @property
    def utc_ns(self) -> int:
        """Time of the point, UTC as POSIX time."""


Point = TypeVar("Point", bound=Timed)


def append(buffers: dict[str, deque[Point]], name: str, point: Point) -> None:
    """Add a point to the buffer of a name, in the order of times; further names are ignored if there are too many."""
    buffer = buffers.get(name)
    if buffer is None:
        if not has_room(buffers, name, "plotted name"):
            return
        buffer = buffers[name] = deque(maxlen=MAX_POINTS)
    append_point(buffer, point)


def append_point(buffer: deque[Point], point: Point) -> None:
    """Add a point to a buffer, in the order of times, and remove points that are too old."""
    place = len(buffer)
    while place and buffer[place - 1].utc_ns > point.utc_ns:
        place -= 1
    if place == len(buffer):
        buffer.append(point)
    elif len(buffer) < MAX_POINTS:
        buffer.insert(place, point)
    while buffer[-1].utc_ns - buffer[0].utc_ns > _HISTORY_NS:
        buffer.popleft()


def replace_or_append(buffers: dict[str, deque[Point]], name: str, point: Point) -> None:
    """Replace the point of the same time; add the point if no point has this time."""
    buffer = buffers.get(name, deque())
    for place in range(len(buffer) - 1, -1, -1):
        if buffer[place].utc_ns == point.utc_ns:
            buffer[place] = point
            return
        if buffer[place].utc_ns < point.utc_ns:
            break
    append(buffers, name, point)


def points_after(points: Sequence[Point], after_ns: int | None) -> list[Point]:
    """Return the points after a time, in their order; all points for None.

    Args:
        points: points in the order of their times.
        after_ns: time of the last point that a plot has, ns.
    """
    if after_ns is None:
        return list(points)
    # The points are read from the end, because only a few are new.
    return list(takewhile(lambda point: point.utc_ns > after_ns, reversed(points)))[::-1]


def extreme_rows(values: FloatArray, starts: Sequence[int]) -> NDArray[np.intp]:
    """Return the rows with the minimum and maximum of each column in each section, to draw a line with few points.

    Args:
        values: table of shape (n, columns). Non-finite values are ignored, but a section without finite values keeps
            its first row, so that a gap stays.
        starts: first rows of the sections, rising from 0; the last section ends with the last row.
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


class StarExposures:
    """Last exposure of each star sensor, stored in ``History.star_exposures`` by source."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._exposures: dict[str, deque[Any]] = {}
        self._innovations: dict[str, deque[Any]] = {}
        self._solutions: dict[str, Any] = {}

    def add_exposure(self, source: str, message: Any) -> None:
        """Add a StarObservationArray."""
        self._exposures.setdefault(source, deque(maxlen=_PENDING_MESSAGES)).append(message)
        self._join(source)

    def add_solution(self, source: str, message: Any) -> None:
        """Add a StarHorizonAttitude."""
        self._solutions[source] = message

    def add_innovation(self, source: str, message: Any) -> None:
        """Add the Innovation of a measurement of a star sensor."""
        self._innovations.setdefault(source, deque(maxlen=_PENDING_MESSAGES)).append(message)
        self._join(source)

    def _join(self, source: str) -> None:
        """Store the newest exposure that has an innovation, or the newest innovation of a sensor without exposures."""
        innovations, exposures = self._innovations.get(source, ()), self._exposures.get(source)
        if not innovations:
            return
        if exposures is None:
            self._store(source, innovations[-1], None)
            return
        by_stamp = {ns_from_stamp(innovation.header.stamp): innovation for innovation in innovations}
        for exposure in reversed(exposures):
            if verdict := by_stamp.get(ns_from_stamp(exposure.header.stamp)):
                self._store(source, verdict, exposure)
                return

    def _store(self, source: str, innovation: Any, exposure: Any) -> None:
        utc_ns, solution = ns_from_stamp(innovation.header.stamp), self._solutions.get(source)
        known = self._history.star_exposures.get(source)
        if known is not None and known.utc_ns > utc_ns:
            return
        stars = exposure.stars if exposure is not None else ()
        names = [f"HIP {star.catalogue_id}" for star in stars]
        residuals = _residuals_by_object(innovation)
        used = sum(1 for name in residuals if name)
        if not used and solution is not None:
            used = int(solution.star_count)
        excluded = len(names) - used if names else int(solution.rejected_count) if solution is not None else 0
        self._history.star_exposures[source] = ExposurePoint(
            utc_ns=utc_ns,
            u=np.array([star.u for star in stars], dtype=float),
            v=np.array([star.v for star in stars], dtype=float),
            is_accepted=bool(innovation.accepted),
            star_count=used,
            rejected_count=max(excluded, 0),
            azimuth=float(solution.azimuth) if solution is not None else math.nan,
            elevation=float(solution.elevation) if solution is not None else math.nan,
            residual_right=_star_residuals(names, residuals, "right"),
            residual_up=_star_residuals(names, residuals, "up"),
        )


class BeaconDetections:
    """Lights of each image on the detector, stored in :attr:`ship_watch.history.history.History.beacons` by beacon."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._images: deque[tuple[int, int, Any]] = deque()
        self._innovations: deque[tuple[int, Any]] = deque(maxlen=_PENDING_MESSAGES)

    def add_image(self, message: Any, now_ns: int) -> None:
        """Add a BeaconImage."""
        self._images.append((ns_from_stamp(message.header.stamp), now_ns, message))
        self._join(now_ns)

    def add_innovation(self, message: Any, now_ns: int) -> None:
        """Add the Innovation of the lights of an image."""
        self._innovations.append((ns_from_stamp(message.header.stamp), message))
        self._join(now_ns)

    def _join(self, now_ns: int) -> None:
        by_stamp = dict(self._innovations)
        while self._images:
            utc_ns, came_ns, image = self._images[0]
            innovation = by_stamp.get(utc_ns)
            later = any(verdict_ns > utc_ns for verdict_ns in by_stamp)
            if innovation is None and not later and now_ns - came_ns < _INNOVATION_TIMEOUT_NS:
                return
            self._images.popleft()
            residuals = _residuals_by_object(innovation) if innovation is not None else {}
            for light in image.beacons:
                name = str(light.beacon_id)
                known = residuals.get(name, {})
                point = BeaconPoint(
                    utc_ns,
                    float(light.x),
                    float(light.z),
                    known.get("x", math.nan),
                    known.get("z", math.nan),
                    bool(known) and innovation is not None and bool(innovation.accepted),
                )
                append(self._history.beacons, name, point)


def _residuals_by_object(innovation: Any) -> Mapping[str, dict[str, float]]:
    """Return star or light → axis → residual, rad; the last word of a component's name is its axis."""
    found: dict[str, dict[str, float]] = {}
    for name, residual in zip(innovation.components, innovation.residual, strict=False):
        part, _, axis = str(name).rpartition(" ")
        found.setdefault(part, {})[axis] = float(residual)
    return found


def _star_residuals(names: list[str], residuals: Mapping[str, dict[str, float]], axis: str) -> FloatArray:
    """Return the residuals of stars along an axis, rad: NaN for a star without residual, empty if all are without."""
    if not any(name in residuals for name in names):
        return _NO_VALUES
    return np.array([residuals.get(name, {}).get(axis, math.nan) for name in names])

"""What plots show: ring buffers of the last minutes, filled by :class:`ship_watch.watch.Watch`.

Every series is a bounded queue of points in the order of their times. A plot takes from it what is newer than the last
point that it has.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from ship_geometry.rotations import FloatArray
from ship_watch.picture import Safety

KEPT_S = 600.0
"""Length of the buffers, s."""


@dataclass(frozen=True)
class InnovationPoint:
    """One measurement of a source: the mean of its residuals along each axis, rad or m, and whether it was accepted.

    ``parts`` are the residuals of its single stars or lights along the same axes, shape (n, axes).
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


@dataclass(frozen=True)
class ErrorPoint:
    """Error against truth (NaN without) and sigma of each channel of an ``error_arcsec`` topic, arcsec."""

    utc_ns: int
    error: Mapping[str, float]
    sigma: Mapping[str, float]


@dataclass(frozen=True)
class BudgetPoint:
    """Variance of each source of error about East, North and Up, rad², shape (3,) each; ``total`` of all."""

    utc_ns: int
    variances: Mapping[str, FloatArray]
    total: FloatArray


@dataclass(frozen=True)
class SafetyPoint:
    """The worst word of each angle within one second; None where the angle was not told."""

    utc_ns: int
    words: Mapping[str, Safety | None]


@dataclass(frozen=True)
class LightPoint:
    """A light on the detector, m along right and up, and its residual, NaN where unknown."""

    utc_ns: int
    x: float
    z: float
    residual_x: float
    residual_z: float
    is_used: bool


@dataclass(frozen=True)
class StarsSeen:
    """The last exposure of a star sensor, as (n,) arrays; residuals are empty where none is told.

    Attributes:
        utc_ns: middle of the exposure.
        u: columns, pixel.
        v: rows, pixel.
        is_accepted: whether the filter took the solution.
        star_count: stars used; ``rejected_count``: left out.
        azimuth: of the sensor's boresight in the horizon frame, rad; NaN where no solution is told.
        elevation: likewise, rad.
    """

    utc_ns: int
    u: FloatArray
    v: FloatArray
    is_accepted: bool
    star_count: int
    rejected_count: int
    azimuth: float
    elevation: float


@dataclass(frozen=True)
class ParameterShown:
    """An alignment or calibration state: estimate, 2 sigma, nominal value (NaN unknown), in ``unit`` (rad, s, m)."""

    name: str
    value: float
    sigma: float
    unit: str
    is_observable: bool


@dataclass
class History:
    """All that plots draw. Keys are names of sources, channels' topics, beacons and sensors."""

    innovations: dict[str, deque[InnovationPoint]] = field(default_factory=dict)
    errors: dict[str, deque[ErrorPoint]] = field(default_factory=dict)
    budgets: dict[str, deque[BudgetPoint]] = field(default_factory=dict)
    ribbons: deque[SafetyPoint] = field(default_factory=deque)
    lights: dict[str, deque[LightPoint]] = field(default_factory=dict)
    stars: dict[str, StarsSeen] = field(default_factory=dict)
    alignment: tuple[ParameterShown, ...] = ()
    calibration: tuple[ParameterShown, ...] = ()
    position: tuple[float, float] | None = None
    """Geodetic latitude and longitude of the last fix, rad."""

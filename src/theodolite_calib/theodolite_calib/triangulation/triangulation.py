"""Position of a target from directions of several theodolites: weighted least squares, and its parameters.

The position is in the common frame: (North, Up, East) from a stated origin, m. Each theodolite's directions are in its
local horizon. On the curved Earth the horizons of two theodolites differ by 1.6" at 50 m and by 32" at 1 km. Refraction
raises each direction by k · (horizontal distance) / (2 R), as in :mod:`ship_geometry.mount.line_of_sight`.

Errors of the theodolites' directions and positions are assumed to be independent; the error of k is common to all
directions. Theodolites that use one ship's attitude share its error, which the residuals do not show.

The theodolites must be fixed to the Earth. On a moving ship their positions change together, which the residuals do not
show.

The command ``triangulate`` and the node ``triangulation`` use the parameters under the same names.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.parameters.fields import HorizonFrame, mapping_of, parameter, section, sources_off, stamp_age
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.mount.image import unit_vector_jacobian
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import FloatArray

DIRECTION_TOPIC = "theodolite/target_direction"

_RELATIVE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

_STEPS = 20
_SMALL_STEP_M = 1e-5
_LEAST_ANGLE = 1e-4
"""Minimum angle between two directions, rad; directions with a smaller angle count as parallel."""
_WORST_DISTANCE = 0.15
"""Maximum ratio of the standard deviation of a distance to the distance.

Beyond it the position is not normally distributed, because the distance is inversely proportional to the uncertain
angle between the lines of sight.
"""


@dataclass(frozen=True)
class Station:
    """Position of a theodolite.

    Attributes:
        name: name of the theodolite.
        position: position of the theodolite's centre on WGS 84.
        sigma_m: standard deviation of the position, each axis.
    """

    name: str
    position: GeodeticPosition
    sigma_m: float


@dataclass(frozen=True, kw_only=True)
class PositionConfig:
    """Position on WGS 84."""

    latitude_deg: float = parameter(doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(doc="height over the ellipsoid WGS 84", unit="m", minimum=-500.0, maximum=9000.0)

    @property
    def position(self) -> GeodeticPosition:
        """Geodetic position."""
        latitude, longitude = np.deg2rad([self.latitude_deg, self.longitude_deg]).tolist()
        return GeodeticPosition(latitude, longitude, self.height_m)


@dataclass(frozen=True, kw_only=True)
class StationPositionConfig(PositionConfig):
    """Position of a theodolite's centre, and its error. The theodolite is fixed to the Earth."""

    sigma_m: float = parameter(0.05, doc="error of the position, each axis", unit="m", minimum=0.0, maximum=1000.0)

    def station(self, name: str) -> Station:
        """Return the theodolite with a name at this position."""
        return Station(name, self.position, self.sigma_m)


@dataclass(frozen=True, kw_only=True)
class RefractionConfig:
    """Refraction on the path to the target; the target's direction is raised by k · (horizontal distance) / (2 R)."""

    coefficient: float = parameter(
        0.13, doc="coefficient k of terrestrial refraction", minimum=-5.0, maximum=5.0, live=True
    )
    sigma: float = parameter(0.06, doc="error of k, common to all theodolites", minimum=0.0, maximum=5.0, live=True)


@dataclass(frozen=True, kw_only=True)
class PositioningConfig:
    """Parameters common to the command and the node, except the theodolites."""

    origin: PositionConfig = parameter(doc="origin of the common frame: East, North, Up there")
    refraction: RefractionConfig = section(RefractionConfig)
    max_gap_s: float = parameter(
        1.0, doc="directions further apart in time are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )
    gate_probability: float = parameter(
        0.999, doc="probability that consistent directions are accepted", minimum=0.5, maximum=0.999999, live=True
    )


@dataclass(frozen=True, kw_only=True)
class LiveStationConfig(StationPositionConfig):
    """One theodolite of the node."""

    topic: str = parameter("", doc=f"relative name of the topic of its directions; empty for <id>/{DIRECTION_TOPIC}")


@dataclass(frozen=True, kw_only=True)
class TriangulationConfig(PositioningConfig):
    """All parameters of the node ``triangulation``."""

    stations: dict[str, LiveStationConfig] = mapping_of("theodolites fixed to the Earth, by name")
    lag_s: float = parameter(
        2.0,
        doc="directions wait for the next report of each theodolite until it is overdue by this time",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )
    frames: HorizonFrame = section(HorizonFrame)
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of health topics and diagnostics", unit="s", minimum=0.1, maximum=60.0
    )

    def __post_init__(self) -> None:
        """Check that each theodolite has a topic of its own, with a relative name.

        Raises:
            ParameterError: the check fails; the text names the parameter.
        """
        station_by_topic: dict[str, str] = {}
        for name, station in self.stations.items():
            parameter_name = f"stations.{name}.topic"
            if station.topic and not _RELATIVE_NAME.fullmatch(station.topic):
                raise ParameterError(
                    f"parameter '{parameter_name}' = {station.topic}: expected a relative name, such as "
                    f"west/{DIRECTION_TOPIC}; remap it at the start if it differs",
                    parameter_name,
                    value=station.topic,
                )
            topic = self.topic_of(name)
            if topic in station_by_topic:
                raise ParameterError(
                    f"parameter '{parameter_name}': {topic} is already used by '{station_by_topic[topic]}': "
                    "each theodolite needs "
                    "its own",
                    parameter_name,
                    value=station.topic,
                )
            station_by_topic[topic] = name

    def topic_of(self, name: str) -> str:
        """Return the topic of a theodolite's directions."""
        return self.stations[name].topic or f"{name}/{DIRECTION_TOPIC}"


@dataclass(frozen=True)
class StationDirection:
    """Direction of a target from one theodolite.

    Attributes:
        station: the theodolite.
        direction_n: unit vector in the horizon of the theodolite, shape (3,).
        covariance_n: covariance of the direction's total error, rad², zero along the direction, shape (3, 3).
    """

    station: Station
    direction_n: FloatArray
    covariance_n: FloatArray


@dataclass(frozen=True)
class TriangulatedPosition:
    """Position of a target.

    Attributes:
        position_n: position in the common frame, m, shape (3,).
        covariance_n: covariance of the position's total error, m², shape (3, 3).
        residual: residuals, two across each direction, measured minus predicted, rad, shape (2 N,).
        sigma: predicted standard deviations of the residuals without the error of the fit, rad, shape (2 N,).
        chi_square: chi-square of all residuals together.
        gate: threshold of the chi-square.
        rejection: reason if the directions are inconsistent; None if they are consistent.
    """

    position_n: FloatArray
    covariance_n: FloatArray
    residual: FloatArray
    sigma: FloatArray
    chi_square: float
    gate: float
    rejection: Rejection | None


def triangulate(
    origin: GeodeticPosition,
    directions: Sequence[StationDirection],
    air: RefractionConfig,
    gate_probability: float = 0.999,
) -> TriangulatedPosition | Rejection:
    """Triangulate a target from the directions of two theodolites or more.

    Args:
        origin: origin of the common frame.
        directions: simultaneous directions.
        air: refraction on the path to the target.
        gate_probability: probability that consistent directions pass the test of their residuals.

    Returns:
        Position, with its ``rejection`` set if the directions are inconsistent. Only a rejection is returned for fewer
            than two directions, for numbers that are not finite, for directions that are nearly parallel or meet behind
            a theodolite, and for a too uncertain distance.
    """
    if len(directions) < 2:
        return Rejection(Reason.GAP, f"theodolites that see the target: {len(directions)}, two or more are needed")
    numbers = [value for each in directions for value in (*each.direction_n, *each.covariance_n.ravel())]
    if not np.all(np.isfinite(numbers)):
        return Rejection(Reason.NON_FINITE, "a direction contains NaN or infinity")
    rotation_ne = rotation_horizon_from_ecef(float(origin.latitude), float(origin.longitude))
    origin_m = ecef_from_geodetic(origin)
    lines = [_Line.from_direction(each, rotation_ne, origin_m) for each in directions]
    position_n = _nearest_point(lines)
    if position_n is None:
        names = ", ".join(line.name for line in lines)
        return Rejection(Reason.GATE, f"the directions of {names} are parallel: no intersection")
    for _ in range(_STEPS):
        behind = [line.name for line in lines if not line.measured_n @ (position_n - line.foot_n) > 0.0]
        if behind:
            return Rejection(Reason.GATE, f"the directions meet behind {', '.join(behind)}")
        residual, jacobian, noise = _residuals(lines, position_n, air)
        weighted = np.linalg.solve(noise, jacobian)
        covariance_n = np.linalg.inv(jacobian.T @ weighted)
        step_n = covariance_n @ weighted.T @ residual
        position_n = position_n + step_n
        if np.linalg.norm(step_n) < _SMALL_STEP_M:
            break
    unknown = _distance_rejection(lines, position_n, covariance_n)
    if unknown is not None:
        return unknown
    residual, _, noise = _residuals(lines, position_n, air)
    chi_square = float(residual @ np.linalg.solve(noise, residual))
    gate = chi_square_gate(gate_probability, len(residual) - 3)
    rejection = None
    if not chi_square <= gate:
        text = f"the directions are inconsistent: chi-square {chi_square:.1f} exceeds {gate:.1f}"
        rejection = Rejection(Reason.GATE, text)
    sigma = np.sqrt(np.diagonal(noise))
    return TriangulatedPosition(position_n, covariance_n, residual, sigma, chi_square, gate, rejection)


@dataclass(frozen=True)
class _Line:
    """Direction in the common frame, with the theodolite's position and Up, and two axes across the direction."""

    name: str
    foot_n: FloatArray
    measured_n: FloatArray
    up_n: FloatArray
    across: FloatArray
    covariance: FloatArray
    foot_sigma_m: float

    @classmethod
    def from_direction(cls, direction: StationDirection, rotation_ne: FloatArray, origin_m: FloatArray) -> "_Line":
        place = direction.station.position
        to_common = rotation_ne @ rotation_horizon_from_ecef(float(place.latitude), float(place.longitude)).T
        measured_n = to_common @ direction.direction_n
        across = np.linalg.svd(measured_n[None])[2][1:]
        return cls(
            name=direction.station.name,
            foot_n=rotation_ne @ (ecef_from_geodetic(place) - origin_m),
            measured_n=measured_n,
            up_n=to_common[:, 1],
            across=across,
            covariance=across @ to_common @ direction.covariance_n @ to_common.T @ across.T,
            foot_sigma_m=direction.station.sigma_m,
        )

    def direction_to(self, position_n: FloatArray, coefficient: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the apparent direction to a position, with its derivatives: position (3, 3) and coefficient k (3,)."""
        path_n = position_n - self.foot_n
        distance_m = float(np.linalg.norm(path_n))
        # The angle k h / (2 R), with the horizontal distance h, is the part of k d / (2 R) · Up across the line.
        per_k = distance_m / (2.0 * EARTH_RADIUS_M) * self.up_n
        raised_n = path_n / distance_m + coefficient * per_k
        more_raised_n = coefficient / (2.0 * EARTH_RADIUS_M) * np.outer(self.up_n, path_n / distance_m)
        by_raised_n = unit_vector_jacobian(raised_n)
        by_path_n = by_raised_n @ (unit_vector_jacobian(path_n) + more_raised_n)
        return raised_n / np.linalg.norm(raised_n), by_path_n, by_raised_n @ per_k


def _nearest_point(lines: Sequence[_Line]) -> FloatArray | None:
    """Return the point nearest to all lines; None if they are parallel."""
    normal = sum(line.across.T @ line.across for line in lines)
    values = np.linalg.eigvalsh(normal)
    if not values[0] > len(lines) * (0.5 * _LEAST_ANGLE) ** 2:
        return None
    nearest: FloatArray = np.linalg.solve(normal, sum(line.across.T @ line.across @ line.foot_n for line in lines))
    return nearest


def _distance_rejection(lines: Sequence[_Line], position_n: FloatArray, covariance_n: FloatArray) -> Rejection | None:
    """Return the rejection of a position if its distance from a theodolite is too uncertain; None otherwise."""
    for line in lines:
        path_n = position_n - line.foot_n
        distance_m = float(np.linalg.norm(path_n))
        variance_m2 = float(path_n @ covariance_n @ path_n) / distance_m**2
        if not variance_m2 <= (_WORST_DISTANCE * distance_m) ** 2:
            sigma_m = float(np.sqrt(variance_m2)) if variance_m2 >= 0.0 else float("nan")
            text = f"the distance from {line.name}, {distance_m:.3g} m, has sigma {sigma_m:.2g} m, more than "
            text += f"{_WORST_DISTANCE:g} of it: set the theodolites further apart, or measure a range"
            return Rejection(Reason.GATE, text)
    return None


def _residuals(
    lines: Sequence[_Line], position_n: FloatArray, air: RefractionConfig
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (2 N,), their derivative with respect to the position (2 N, 3) and covariance (2 N, 2 N)."""
    residuals, jacobians, by_k = [], [], []
    noise = np.zeros((2 * len(lines), 2 * len(lines)))
    for number, line in enumerate(lines):
        seen_n, by_path_n, by_coefficient_n = line.direction_to(position_n, air.coefficient)
        rows = slice(2 * number, 2 * number + 2)
        jacobian = line.across @ by_path_n
        residuals.append(line.across @ (line.measured_n - seen_n))
        jacobians.append(jacobian)
        by_k.append(line.across @ by_coefficient_n)
        noise[rows, rows] = line.covariance + line.foot_sigma_m**2 * jacobian @ jacobian.T
    common = np.concatenate(by_k)
    return np.concatenate(residuals), np.concatenate(jacobians), noise + air.sigma**2 * np.outer(common, common)

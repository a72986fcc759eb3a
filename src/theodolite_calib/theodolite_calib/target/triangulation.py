"""The place of a target by the directions in which several theodolites see it at one moment: weighted least squares.

The place is in the common frame: (North, Up, East) from a stated origin, m. Each theodolite's directions are in the
horizon of its own place, which on the curved Earth is another one: 50 m apart 1.6", 1 km apart 32". Each direction is
raised by the air, k · (horizontal distance) / (2 R), as :mod:`theodolite_calib.lights.line_of_sight` has it.

The errors of the theodolites' directions and places are taken as independent of one another, that of k as common to
all. Theodolites that share one attitude of a ship share its error, which no residual shows.

The theodolites stand still on the Earth. On a ship under way their places are others at each moment: she carries all of
them along, and no residual shows that.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_estimation.gates import chi_square_gate
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.rotations import FloatArray
from theodolite_calib.lights.image import unit_vector_jacobian
from theodolite_calib.lights.line_of_sight import EARTH_RADIUS_M

_STEPS = 20
_SMALL_STEP_M = 1e-5
_LEAST_ANGLE = 1e-4
"""Directions that are parallel within this, rad, meet nowhere: the place would be known to a ten thousandth at best."""
_WORST_DISTANCE = 0.15
"""Standard deviation of a distance over it: beyond, the place is no longer normally distributed as its covariance says,
for its distance goes as one over the angle between the lines of sight, which is too uncertain."""


@dataclass(frozen=True)
class Station:
    """Where a theodolite stands.

    Attributes:
        name: of the theodolite.
        place: of its centre, on WGS 84.
        sigma_m: error of the place, each axis.
    """

    name: str
    place: GeodeticPosition
    sigma_m: float


@dataclass(frozen=True)
class StationDirection:
    """A target as one theodolite sees it.

    Attributes:
        station: the theodolite.
        direction_n: unit vector in the horizon of its place, shape (3,).
        covariance_n: of its total error, rad², zero along it, shape (3, 3).
    """

    station: Station
    direction_n: FloatArray
    covariance_n: FloatArray


@dataclass(frozen=True)
class Air:
    """The coefficient k of terrestrial refraction, and its standard deviation, common to all directions."""

    coefficient: float
    sigma: float


@dataclass(frozen=True)
class TriangulatedPlace:
    """The place of a target.

    Attributes:
        position_n: in the common frame, m, shape (3,).
        covariance_n: of its total error, m², shape (3, 3).
        residual: measured minus seen from there, across each direction (two for each theodolite), rad, shape (2 N,).
        sigma: their predicted standard deviations by the directions' own errors, rad, shape (2 N,).
        chi_square: of all residuals together.
        gate: that it must not exceed.
        refusal: why the directions do not fit one another; None where they do.
    """

    position_n: FloatArray
    covariance_n: FloatArray
    residual: FloatArray
    sigma: FloatArray
    chi_square: float
    gate: float
    refusal: Refusal | None


def triangulated(
    origin: GeodeticPosition, directions: Sequence[StationDirection], air: Air, gate_probability: float = 0.999
) -> TriangulatedPlace | Refusal:
    """The place of a target by the directions of two theodolites or more.

    Args:
        origin: of the common frame.
        directions: of one moment.
        air: on the way to the target.
        gate_probability: share of right sets of directions that pass the test of their residuals.

    Returns:
        The place, with a refusal in it where the directions do not fit one another; or the refusal where they give no
        place at all: fewer than two, parallel ones, lines that meet behind a theodolite, or so nearly parallel ones
        that they do not tell how far the place is.
    """
    if len(directions) < 2:
        return Refusal(Reason.GAP, f"{len(directions)} theodolite sees the target: a place takes two or more")
    numbers = [value for each in directions for value in (*each.direction_n, *each.covariance_n.ravel())]
    if not np.all(np.isfinite(numbers)):
        return Refusal(Reason.NON_FINITE, "a direction holds NaN or infinity")
    rotation_ne = rotation_horizon_from_ecef(float(origin.latitude), float(origin.longitude))
    origin_m = ecef_from_geodetic(origin)
    lines = [_Line.of(each, rotation_ne, origin_m) for each in directions]
    found = _nearest(lines)
    if found is None:
        names = ", ".join(line.name for line in lines)
        return Refusal(Reason.GATE, f"the directions of {names} are parallel: they meet nowhere")
    for _ in range(_STEPS):
        behind = [line.name for line in lines if not line.measured_n @ (found - line.foot_n) > 0.0]
        if behind:
            return Refusal(Reason.GATE, f"the directions meet behind {', '.join(behind)}")
        residual, jacobian, noise = _compared(lines, found, air)
        weighted = np.linalg.solve(noise, jacobian)
        covariance_n = np.linalg.inv(jacobian.T @ weighted)
        step_n = covariance_n @ weighted.T @ residual
        found = found + step_n
        if np.linalg.norm(step_n) < _SMALL_STEP_M:
            break
    unknown = _unknown_distance(lines, found, covariance_n)
    if unknown is not None:
        return unknown
    residual, _, noise = _compared(lines, found, air)
    chi_square = float(residual @ np.linalg.solve(noise, residual))
    gate = chi_square_gate(gate_probability, len(residual) - 3)
    refusal = None
    if not chi_square <= gate:
        text = f"the directions do not fit one another: chi-square {chi_square:.1f}, {gate:.1f} at most"
        refusal = Refusal(Reason.GATE, text)
    sigma = np.sqrt(np.diagonal(noise))
    return TriangulatedPlace(found, covariance_n, residual, sigma, chi_square, gate, refusal)


@dataclass(frozen=True)
class _Line:
    """A direction in the common frame: from the theodolite's foot, with two axes across it and its own Up."""

    name: str
    foot_n: FloatArray
    measured_n: FloatArray
    up_n: FloatArray
    across: FloatArray
    covariance: FloatArray
    foot_sigma_m: float

    @classmethod
    def of(cls, seen: StationDirection, rotation_ne: FloatArray, origin_m: FloatArray) -> "_Line":
        place = seen.station.place
        to_common = rotation_ne @ rotation_horizon_from_ecef(float(place.latitude), float(place.longitude)).T
        measured_n = to_common @ seen.direction_n
        across = np.linalg.svd(measured_n[None])[2][1:]
        return cls(
            name=seen.station.name,
            foot_n=rotation_ne @ (ecef_from_geodetic(place) - origin_m),
            measured_n=measured_n,
            up_n=to_common[:, 1],
            across=across,
            covariance=across @ to_common @ seen.covariance_n @ to_common.T @ across.T,
            foot_sigma_m=seen.station.sigma_m,
        )

    def seen_from(self, place_n: FloatArray, coefficient: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where a place is seen, unit vector, with its change by the place (3, 3) and by k (3,)."""
        path_n = place_n - self.foot_n
        distance_m = float(np.linalg.norm(path_n))
        # Raised by k h / (2 R) with h the horizontal distance: that is k d / (2 R) times Up, across the line.
        per_k = distance_m / (2.0 * EARTH_RADIUS_M) * self.up_n
        raised_n = path_n / distance_m + coefficient * per_k
        more_raised_n = coefficient / (2.0 * EARTH_RADIUS_M) * np.outer(self.up_n, path_n / distance_m)
        by_raised_n = unit_vector_jacobian(raised_n)
        by_path_n = by_raised_n @ (unit_vector_jacobian(path_n) + more_raised_n)
        return raised_n / np.linalg.norm(raised_n), by_path_n, by_raised_n @ per_k


def _nearest(lines: Sequence[_Line]) -> FloatArray | None:
    """The place nearest to all lines; None where they are parallel."""
    normal = sum(line.across.T @ line.across for line in lines)
    values = np.linalg.eigvalsh(normal)
    if not values[0] > len(lines) * (0.5 * _LEAST_ANGLE) ** 2:
        return None
    nearest: FloatArray = np.linalg.solve(normal, sum(line.across.T @ line.across @ line.foot_n for line in lines))
    return nearest


def _unknown_distance(lines: Sequence[_Line], place_n: FloatArray, covariance_n: FloatArray) -> Refusal | None:
    """Why a place is not told, where its distance from a theodolite is hardly known; None where it is."""
    for line in lines:
        path_n = place_n - line.foot_n
        distance_m = float(np.linalg.norm(path_n))
        variance_m2 = float(path_n @ covariance_n @ path_n) / distance_m**2
        if not variance_m2 <= (_WORST_DISTANCE * distance_m) ** 2:
            sigma_m = float(np.sqrt(variance_m2)) if variance_m2 >= 0.0 else float("nan")
            text = f"the distance from {line.name}, {distance_m:.3g} m, is told to {sigma_m:.2g} m (1 sigma), "
            text += f"{_WORST_DISTANCE:g} of it at most: set the theodolites further apart, or measure a range"
            return Refusal(Reason.GATE, text)
    return None


def _compared(lines: Sequence[_Line], place_n: FloatArray, air: Air) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (2 N,), their change by the place (2 N, 3) and their covariance (2 N, 2 N)."""
    residuals, jacobians, by_k = [], [], []
    noise = np.zeros((2 * len(lines), 2 * len(lines)))
    for number, line in enumerate(lines):
        seen_n, by_path_n, by_coefficient_n = line.seen_from(place_n, air.coefficient)
        rows = slice(2 * number, 2 * number + 2)
        jacobian = line.across @ by_path_n
        residuals.append(line.across @ (line.measured_n - seen_n))
        jacobians.append(jacobian)
        by_k.append(line.across @ by_coefficient_n)
        noise[rows, rows] = line.covariance + line.foot_sigma_m**2 * jacobian @ jacobian.T
    common = np.concatenate(by_k)
    return np.concatenate(residuals), np.concatenate(jacobians), noise + air.sigma**2 * np.outer(common, common)

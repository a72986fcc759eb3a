"""Methods with which [P15] is compared, as described in its §1: the peers of star vectors.

[6] of [P15] combines two boresights: each sensor solves its attitude, and the two boresights give the ship's attitude.
[5] of [P15] corrects the observations for refraction: it solves an attitude without air, computes elevations from this
attitude, lowers the observed vectors, and repeats. Directions are from ERFA's ``atco13``, attitudes from scipy; of the
suite only the tables of the catalogue and of Earth orientation are used.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone

import erfa
import numpy as np
from scipy.spatial.transform import Rotation

from ship_geometry.air.refraction import Weather
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import StarPositions
from ship_geometry.rotations import FloatArray

MIN_STARS = 4
"""[P15] §1: a sensor determines its boresight by four identified stars or more."""

MIN_STARS_BY_GEOMETRY = 2
"""Minimum number of stars: the rotation about a single one is undetermined."""

CONVERGED_RAD = np.deg2rad(0.001 / 3600.0)
MAX_ITERATIONS = 20
WAVELENGTH_UM = 0.55


@dataclass(frozen=True)
class SensorView:
    """Stars of a sensor.

    Attributes:
        measured_s: directions in the sensor frame (forward, up, right), shape (k, 3).
        stars: identities of the stars, J2000.0.
        rotation_ds: nominal mounting, deck from sensor, shape (3, 3).
    """

    measured_s: FloatArray
    stars: StarPositions
    rotation_ds: FloatArray

    def __len__(self) -> int:
        return len(self.measured_s)


@dataclass(frozen=True)
class ErfaSky:
    """Sky of a ship at rest at a time and a position; without air if ``weather`` is None."""

    time_ns: int
    position: GeodeticPosition
    weather: Weather | None

    def directions(self, stars: StarPositions) -> FloatArray:
        """Return unit vectors (North, Up, East), shape (k, 3)."""
        utc_time = datetime.fromtimestamp(self.time_ns // 1_000_000_000, tz=timezone.utc)
        seconds = utc_time.second + (self.time_ns % 1_000_000_000) * 1e-9
        utc = erfa.dtf2d("UTC", utc_time.year, utc_time.month, utc_time.day, utc_time.hour, utc_time.minute, seconds)
        orientation, place = earth_orientation_table().at(self.time_ns), self.position
        azimuth, zenith, *_ = erfa.atco13(
            stars.right_ascension, stars.declination, stars.pm_right_ascension, stars.pm_declination,
            stars.parallax_arcsec, 0.0, *utc, orientation.ut1_minus_utc_s,
            place.longitude, place.latitude, place.height_m,
            orientation.pole_x, orientation.pole_y, *self._air(),
        )  # fmt: skip
        return np.stack([np.cos(azimuth) * np.sin(zenith), np.cos(zenith), np.sin(azimuth) * np.sin(zenith)], axis=-1)

    def without_air(self) -> "ErfaSky":
        """Return the same sky without air."""
        return replace(self, weather=None)

    def without_refraction(self, seen_n: FloatArray) -> FloatArray:
        """Return directions observed through the air with refraction removed, shape (k, 3)."""
        tangent = np.hypot(seen_n[:, 0], seen_n[:, 2]) / seen_n[:, 1]
        first, third = erfa.refco(*self._air())
        zenith = np.arctan(tangent) + first * tangent + third * tangent**3
        flat = seen_n[:, [0, 2]] / np.hypot(seen_n[:, 0], seen_n[:, 2])[:, None] * np.sin(zenith)[:, None]
        return np.stack([flat[:, 0], np.cos(zenith), flat[:, 1]], axis=-1)

    def _air(self) -> tuple[float, float, float, float]:
        air = self.weather
        if air is None:
            return 0.0, 0.0, 0.0, WAVELENGTH_UM
        return air.pressure_hpa, air.temperature_c, air.relative_humidity, WAVELENGTH_UM


def refraction_on_reference(view: SensorView, sky: ErfaSky, fewest: int = MIN_STARS) -> FloatArray | None:
    """Return horizon from sensor by one sensor's stars, refraction added to the references; None with too few stars."""
    return _wahba(sky.directions(view.stars), view.measured_s) if len(view) >= fewest else None


def refraction_on_observed(
    view: SensorView, sky: ErfaSky, fewest: int = MIN_STARS
) -> tuple[FloatArray, int] | None:
    """Return horizon from sensor by the stars of one sensor, refraction removed from the observations, by [5].

    Returns:
        The attitude, and the number of rounds to convergence after the first attitude; None with too few stars or
        without convergence.
    """
    if len(view) < fewest:
        return None
    reference_n = sky.without_air().directions(view.stars)
    rotation_ns = _wahba(reference_n, view.measured_s)
    for round_ in range(1, MAX_ITERATIONS + 1):
        before_ns = rotation_ns
        lowered_s = sky.without_refraction(view.measured_s @ before_ns.T) @ before_ns
        rotation_ns = _wahba(reference_n, lowered_s)
        if Rotation.from_matrix(rotation_ns @ before_ns.T).magnitude() < CONVERGED_RAD:
            return rotation_ns, round_
    return None


def attitude_from_boresights(rotation_ns: Sequence[FloatArray], rotation_ds: Sequence[FloatArray]) -> FloatArray:
    """Return horizon from deck by the boresights of two sensors and their mountings, by [6]."""
    return _wahba(np.array([one[:, 0] for one in rotation_ns]), np.array([one[:, 0] for one in rotation_ds]))


def two_boresights(views: Sequence[SensorView], sky: ErfaSky, fewest: int = MIN_STARS) -> FloatArray | None:
    """Return horizon from deck by [6], refraction added to the references; None if a sensor has too few stars."""
    found = [refraction_on_reference(view, sky, fewest) for view in views]
    solved = [one for one in found if one is not None]
    return attitude_from_boresights(solved, [view.rotation_ds for view in views]) if len(solved) == len(views) else None


def two_boresights_by_iteration(
    views: Sequence[SensorView], sky: ErfaSky, fewest: int = MIN_STARS
) -> FloatArray | None:
    """Return horizon from deck by [5] and [6], the method before [P15]; None if [5] fails for a sensor."""
    found = [refraction_on_observed(view, sky, fewest) for view in views]
    solved = [one[0] for one in found if one is not None]
    return attitude_from_boresights(solved, [view.rotation_ds for view in views]) if len(solved) == len(views) else None


def _wahba(reference_n: FloatArray, measured: FloatArray) -> FloatArray:
    rotation, _ = Rotation.align_vectors(reference_n, measured)
    return np.asarray(rotation.as_matrix(), dtype=float)

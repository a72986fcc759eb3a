"""Where stars are seen from the ship, in the horizon frame and with air, and what all of them have wrong together.

The errors that stars share do not average: refraction, Earth rotation (UT1) and the ship's position. Each star's
direction is given with its displacement by one standard deviation of each of them (models.md §2).
"""

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.sky.surroundings import Air, Place
from ship_attitude_star.stars.star_config import SkyConfig
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.earth_orientation import EarthOrientationTable
from ship_geometry.geodetic import horizon_radii_m
from ship_geometry.refraction import (
    LOWEST_ELEVATION,
    ModelName,
    elevation_of,
    lifted,
    refraction,
    refraction_slopes,
)
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from ship_geometry.star_directions import RefreshedSky, StarPositions, fixed_stars

SHARED_TERMS = ("refraction", "earth_rotation", "ship_position", "ship_position")
"""Error source of each column of :attr:`ApparentStars.shared_n`: of two for the position, one is north."""

_TINY = 1e-300

EARTH_ROTATION_RATE = 15.041 * ARCSEC
"""Angle by which the sky turns in a second of UT1, rad."""


@dataclass(frozen=True)
class ApparentStars:
    """Stars as seen from the ship at one moment.

    Attributes:
        direction_n: unit vectors with refraction, shape (k, 3); NaN below the lowest elevation.
        shared_n: displacement of each direction by one sigma of each shared error, rad, shape (k, 3, 4).
        elevation: without air, rad, shape (k,).
        visible: False where the star is lower than the refraction model holds, shape (k,).
    """

    direction_n: FloatArray
    shared_n: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]


class Sky:
    """The sky over the ship.

    Args:
        config: refraction model and wavelength.
        table: Earth orientation.
    """

    def __init__(self, config: SkyConfig, table: EarthOrientationTable) -> None:
        self._model: ModelName = "almanac" if config.refraction_model == "almanac" else "erfa"
        self._wavelength_um = config.wavelength_um
        self._table = table
        self._refreshed = RefreshedSky(table)

    def reason_against(self, time_ns: int) -> Refusal | None:
        """Why no star can be placed at a moment; None where it can."""
        reason = self._table.reason_against(time_ns)
        return None if reason is None else Refusal(Reason.NO_EARTH_ORIENTATION, reason)

    def too_low(self, elevation: float) -> Refusal:
        """The refusal of a star at an elevation (rad, without air) that is not ``visible``."""
        text = f"elevation {np.rad2deg(elevation):.1f}°"
        if elevation < 0.0:
            text += ", below the horizon: look at gnss/fix, the clock and the identity"
        else:
            lowest_deg = np.rad2deg(LOWEST_ELEVATION[self._model])
            text += f": refraction model '{self._model}' holds from {lowest_deg:.0f}°"
        return Refusal(Reason.BELOW_HORIZON, text)

    def apparent(self, stars: StarPositions, time_ns: int, place: Place, air: Air) -> ApparentStars:
        """Directions of stars, with refraction.

        Args:
            stars: shape (k,).
            time_ns: a moment that :meth:`reason_against` has nothing against.
            place: of the ship.
            air: there.
        """
        without_air = self._refreshed.directions(stars, time_ns, place.observer)
        elevation = elevation_of(without_air)
        bent = refraction(self._model, elevation, air.weather, self._wavelength_um)
        direction_n = lifted(without_air, bent.angle)
        shared_n = np.empty((*direction_n.shape, len(SHARED_TERMS)))
        bent_sigma = bent.sigma(air.pressure_sigma_hpa, air.temperature_sigma_k)
        shared_n[..., 0] = _upward(direction_n) * bent_sigma[..., None]
        # turn × direction for all three turns in one product.
        across = skew(self.turns(time_ns, place)).transpose(2, 1, 0).reshape(3, 9)
        shared_n[..., 1:] = (direction_n @ across).reshape(*direction_n.shape, 3)
        return ApparentStars(direction_n, shared_n, elevation, np.isfinite(bent_sigma))

    def rotation_horizon_from_icrs(self, time_ns: int, place: Place) -> FloatArray:
        """The horizon's axes from those of the ICRS, shape (3, 3): how bodies turn, without aberration and air."""
        return self._refreshed.rotation_horizon_from_icrs(time_ns, place.observer.position)

    def refraction_at(self, elevation: float, air: Air) -> tuple[float, float]:
        """Refraction at an elevation without air and its standard deviation, rad; NaN where the model does not hold."""
        bent = refraction(self._model, elevation, air.weather, self._wavelength_um)
        return float(bent.angle), float(bent.sigma(air.pressure_sigma_hpa, air.temperature_sigma_k))

    def refraction_slopes_at(self, elevation: float, air: Air) -> tuple[float, float]:
        """First and second derivative of refraction by elevation, rad/rad and rad/rad²."""
        return refraction_slopes(self._model, elevation, air.weather, self._wavelength_um)

    def aberration_at(self, direction_n: FloatArray, time_ns: int, place: Place) -> FloatArray:
        """Displacement of a star in a direction (N, U, E) by aberration, without air, rad, shape (3,)."""
        rotation_nc = self.rotation_horizon_from_icrs(time_ns, place)
        star = fixed_stars(*erfa.c2s(rotation_nc.T @ direction_n))
        seen_n = self._refreshed.directions(star, time_ns, place.observer)
        displacement: FloatArray = seen_n - direction_n
        return displacement

    def turns(self, time_ns: int, place: Place) -> FloatArray:
        """Turn of the whole sky by one sigma of Earth rotation and of position, rotation vectors, rad, shape (3, 3)."""
        turns_n = np.empty((3, 3))
        latitude = place.observer.position.latitude
        turn = EARTH_ROTATION_RATE * self._refreshed.orientation(time_ns).ut1_sigma_s
        turns_n[0] = turn * np.cos(latitude), turn * np.sin(latitude), 0.0
        turns_n[1:] = position_turns(place)
        return turns_n


def position_turns(place: Place) -> FloatArray:
    """Turn of the sky in the horizon frame by each of two independent errors of one sigma, rad, shape (2, 3).

    A ship that is farther north than it thinks sees the sky turned about East, one farther east about the Earth's
    axis: 31 m are 1″. The first error is north and what goes with it east, the second the rest of east: a filter may
    keep them as states.
    """
    position, covariance_m2 = place.observer.position, place.covariance_m2
    radius_north_m, radius_east_m = horizon_radii_m(position)
    # The horizon turns by +latitude about -East and by +longitude about the pole, the sky in it the other way.
    per_north = np.array([0.0, 0.0, 1.0]) / radius_north_m
    per_east = -np.array([1.0, np.tan(position.latitude), 0.0]) / radius_east_m
    north_m = np.sqrt(max(covariance_m2[0, 0], 0.0))
    east_with_north_m = covariance_m2[0, 2] / north_m if north_m > 0.0 else 0.0
    east_m = np.sqrt(max(covariance_m2[2, 2] - east_with_north_m**2, 0.0))
    return np.stack([north_m * per_north + east_with_north_m * per_east, east_m * per_east])


def _upward(direction_n: FloatArray) -> FloatArray:
    """Unit vectors across directions in which elevation grows, shape (..., 3)."""
    horizontal = np.hypot(direction_n[..., 0], direction_n[..., 2])
    # At the zenith itself elevation grows nowhere: the vector is the little that is horizontal, and not NaN.
    upward = direction_n * (-direction_n[..., 1] / np.maximum(horizontal, _TINY))[..., None]
    upward[..., 1] = horizontal
    return upward

"""Apparent directions of stars from the ship at any time, and the errors that all directions share.

:class:`SkyModel` returns a :class:`LocalSky` for a time, from position fixes and air readings. The :class:`LocalSky`
computes directions of stars in the horizon frame (North, Up, East), with refraction (SOFA's observed places). Errors of
refraction, Earth rotation (UT1) and the ship's position are common to all stars and do not average. Each direction
therefore has its displacement by one standard deviation of each of these errors (docs/explanation/stars.md). The errors
are states of the filters (:func:`sky_blocks`).

An error of UTC rotates the sky like an error of UT1, but has another cause and is therefore a separate term. The term
is absent if the clocks are taken as exact (``sky.utc_sigma_s`` is 0).
"""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import StateBlock, block
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.air.refraction import LOWEST_ELEVATION, ModelName, refraction, seen_through_air
from ship_geometry.earth.earth_orientation import EarthOrientationTable, earth_orientation_table
from ship_geometry.earth.star_directions import RefreshedSky, StarPositions, fixed_stars
from ship_geometry.late_libraries import erfa
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.sky.catalogue import StarCatalogue, hipparcos
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.position_from_fixes import ShipPosition
from ship_stars.sky.surroundings import Air, Surroundings

UTC = "utc"
SHARED_TERMS = ("refraction", "earth_rotation", "ship_position", "ship_position", UTC)
"""Error source of each column of :attr:`ApparentStars.shared_n`; the last is absent if UTC is taken as exact.

The ship's position has two columns, one for each of the independent errors of :meth:`LocalSky.sky_rotations`.
"""

EARTH_ROTATION_RATE = 15.041 * ARCSEC
"""Rotation of the sky per second of UT1, rad."""

_MAX_CACHED_TIMES = 256
_MAX_CACHED_STAR_SETS = 4
"""Number of star sets cached per time; sensors that expose at the same time share one :class:`LocalSky`."""


@dataclass(frozen=True)
class ApparentStars:
    """Apparent directions of stars from the ship at one time.

    Attributes:
        direction_n: unit vectors with refraction, shape (k, 3); NaN below the model's lowest elevation.
        shared_n: displacement of each direction by one sigma of each of SHARED_TERMS, rad, shape (k, 3, n_shared).
        elevation: elevation without refraction, rad, shape (k,).
        visible: True for each star within the elevation range of the refraction model, shape (k,).
    """

    direction_n: FloatArray
    shared_n: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]


@dataclass(frozen=True)
class BrightStars:
    """Candidate stars for detections without an identity.

    Attributes:
        catalogue: catalogue of all stars.
        rows: rows of the candidates in the catalogue, in ascending order, shape (m,).
        directions_c: ICRS unit vectors of the candidates, in the order of ``rows``, shape (m, 3).
        magnitudes: magnitudes of all candidates in ascending order, not in the order of ``rows``, shape (m,).
    """

    catalogue: StarCatalogue
    rows: NDArray[np.int64]
    directions_c: FloatArray
    magnitudes: FloatArray

    def density(self, magnitude: FloatArray, tolerance: float) -> FloatArray:
        """Return the number of candidates per steradian within a magnitude tolerance.

        A magnitude of NaN matches all candidates. One candidate is added, so that the density is never zero.
        """
        faintest = np.where(np.isfinite(magnitude), magnitude + tolerance, np.inf)
        brightest = np.where(np.isfinite(magnitude), magnitude - tolerance, -np.inf)
        count = np.searchsorted(self.magnitudes, faintest, "right") - np.searchsorted(self.magnitudes, brightest)
        density: FloatArray = np.asarray((count + 1.0) / (4.0 * np.pi), dtype=float)
        return density


@dataclass(frozen=True)
class LocalSky:
    """The sky over the ship at one time; created by :meth:`SkyModel.sky_at`.

    Results are cached, so that an exposure that is applied again has the same arrays.

    Attributes:
        time_ns: time of the directions.
        position: ship's position at this time.
        air: air at the ship at this time.
        airless_sky: sky without refraction.
        model: refraction model.
        wavelength_um: effective wavelength of the sensors' light.
        utc_sigma_s: standard deviation of the UTC error that all stamps share.
        bright: candidate stars for unidentified detections.
    """

    time_ns: int
    position: ShipPosition
    air: Air
    airless_sky: RefreshedSky
    model: ModelName
    wavelength_um: float
    utc_sigma_s: float
    bright: BrightStars
    _cache: dict[int, tuple[StarPositions, ApparentStars]] = field(default_factory=dict, repr=False, compare=False)

    def apparent_stars(self, stars: StarPositions) -> ApparentStars:
        """Return apparent directions of stars; ``stars`` has shape (k,). The arrays are read-only."""
        # The cache contains references to the stars, so no other object can have their id.
        cached = self._cache.get(id(stars))
        if cached is not None:
            return cached[1]
        without_air = self.airless_sky.directions(stars, self.time_ns, self.position.observer)
        air = self.air
        weather_sigma = air.pressure_sigma_hpa, air.temperature_sigma_k
        seen = seen_through_air(
            self.model, without_air, air.weather, self.wavelength_um, weather_sigma, self.sky_rotations()
        )
        visible = np.isfinite(seen.direction_n[:, 1])
        for array in (seen.direction_n, seen.shared_n, seen.elevation, visible):
            array.flags.writeable = False
        found = ApparentStars(seen.direction_n, seen.shared_n, seen.elevation, visible)
        self._cache[id(stars)] = stars, found
        if len(self._cache) > _MAX_CACHED_STAR_SETS:
            del self._cache[next(iter(self._cache))]
        return found

    def low_elevation_rejection(self, elevation: float) -> Rejection:
        """Return the rejection of a star whose elevation (rad, without refraction) is outside the model's range."""
        text = f"elevation {np.rad2deg(elevation):.1f}°"
        if elevation < 0.0:
            text += ", below the horizon: check gnss/fix, the clock and the identity"
        else:
            lowest_deg = np.rad2deg(LOWEST_ELEVATION[self.model])
            text += f": refraction model '{self.model}' is valid from {lowest_deg:.0f}°"
        return Rejection(Reason.BELOW_HORIZON, text)

    def rotation_horizon_from_icrs(self) -> FloatArray:
        """Return the rotation "horizon from ICRS", without aberration and refraction, shape (3, 3)."""
        return self.airless_sky.rotation_horizon_from_icrs(self.time_ns, self.position.observer.position)

    def bright_rows_around(self, centre_n: FloatArray, radius: float) -> NDArray[np.int64]:
        """Return the catalogue rows of the bright stars within a radius (rad) of a direction (N, U, E), shape (3,)."""
        centre_c = self.rotation_horizon_from_icrs().T @ centre_n
        rows: NDArray[np.int64] = self.bright.rows[self.bright.directions_c @ centre_c > np.cos(radius)]
        return rows

    def refraction_at(self, elevation: float) -> tuple[float, float]:
        """Return refraction and its sigma at an elevation without refraction, rad; NaN outside the model's range."""
        found = refraction(self.model, elevation, self.air.weather, self.wavelength_um)
        return float(found.angle), float(found.sigma(self.air.pressure_sigma_hpa, self.air.temperature_sigma_k))

    def aberration_at(self, direction_n: FloatArray) -> FloatArray:
        """Return the displacement of a star by aberration and light deflection, rad, shape (3,).

        Args:
            direction_n: geometric direction (N, U, E) without aberration and refraction, shape (3,).
        """
        rotation_nc = self.rotation_horizon_from_icrs()
        star = fixed_stars(*erfa.c2s(rotation_nc.T @ direction_n))
        aberrated_n = self.airless_sky.directions(star, self.time_ns, self.position.observer)
        return np.asarray(aberrated_n - direction_n)

    def sky_rotations(self) -> FloatArray:
        """Return the rotation vectors of the sky by one sigma of SHARED_TERMS except refraction, rad, shape (n, 3).

        If the ship is farther north than assumed, the sky is rotated about East. If she is farther east, the sky is
        rotated about the Earth's axis. 31 m correspond to 1″. The position has two independent errors, which may be two
        states of a filter: the error north with the correlated part of the error east, and the rest of the error east.
        """
        position, ut1_sigma_s = self.position, float(self.airless_sky.orientation(self.time_ns).ut1_sigma_s)
        covariance_m2, latitude = position.covariance_m2, float(position.observer.position.latitude)
        radius_north_m, radius_east_m = map(float, position.horizon_radii_m)
        north_m = math.sqrt(max(float(covariance_m2[0, 0]), 0.0))
        east_with_north_m = float(covariance_m2[0, 2]) / north_m if north_m > 0.0 else 0.0
        east_m = math.sqrt(max(float(covariance_m2[2, 2]) - east_with_north_m**2, 0.0))
        # With a change of position the horizon rotates by +latitude about -East and by +longitude about the pole.
        # Relative to the horizon the sky rotates in the opposite sense.
        by_north, by_east = north_m / radius_north_m, east_m / radius_east_m
        with_north, tangent = east_with_north_m / radius_east_m, math.tan(latitude)
        turns = [
            _polar_rotation_vector(EARTH_ROTATION_RATE * ut1_sigma_s, latitude),
            [-with_north, -with_north * tangent, by_north],
            [-by_east, -by_east * tangent, 0.0],
        ]
        if self.utc_sigma_s > 0.0:
            turns.append(_polar_rotation_vector(EARTH_ROTATION_RATE * self.utc_sigma_s, latitude))
        return np.array(turns)


class SkyModel:
    """Apparent star directions for any time, from position fixes and readings of the air.

    Args:
        config: parameters of the sky model.
        table: table of Earth orientation parameters.
        catalogue: star catalogue.

    Attributes:
        catalogue: star catalogue.
        surroundings: position fixes and readings of the air.
    """

    def __init__(self, config: SkyConfig, table: EarthOrientationTable, catalogue: StarCatalogue) -> None:
        self._config = config
        # The parameter allows only names of models.
        self._model = cast(ModelName, config.refraction_model)
        self._table = table
        self._refreshed = RefreshedSky(table)
        self.catalogue = catalogue
        rows = catalogue.rows_brighter_than(config.magnitude_limit)
        bright = catalogue.at_j2000[rows]
        directions_c = erfa.s2c(bright.right_ascension, bright.declination)
        self._bright = BrightStars(catalogue, rows, directions_c, np.sort(catalogue.magnitude[rows]))
        self.reset()

    def reset(self) -> None:
        """Drop all fixes and readings of the air."""
        self.surroundings = Surroundings(self._config)
        self._sky_by_time: dict[int, LocalSky] = {}

    def clone(self, with_surroundings: bool) -> "SkyModel":
        """Return the same model for another estimator.

        Args:
            with_surroundings: True to copy the position fixes and air readings; False for a model without them.
        """
        clone = copy.copy(self)
        clone.reset()
        if with_surroundings:
            clone.surroundings = copy.deepcopy(self.surroundings)
        return clone

    def step_time_base(self, step_ns: int) -> None:
        """Shift the stamps of recent fixes and air readings by a step of the clocks; drop the others."""
        self.surroundings.step_time_base(step_ns)
        self._sky_by_time.clear()

    def sky_at(self, time_ns: int) -> LocalSky | Rejection:
        """Return the sky at a time, or the rejection: NO_EARTH_ORIENTATION or NO_FIX."""
        found, known = self.surroundings.position_and_air_at(time_ns), self._sky_by_time.get(time_ns)
        if (
            known is not None
            and not isinstance(found, Rejection)
            and known.position is found[0]
            and known.air is found[1]
        ):
            return known
        reason = self._table.unavailable_text(time_ns)
        if reason is not None:
            return Rejection(Reason.NO_EARTH_ORIENTATION, reason)
        if isinstance(found, Rejection):
            return found
        place, air = found
        local_sky = self._sky_by_time[time_ns] = LocalSky(
            time_ns=time_ns,
            position=place,
            air=air,
            airless_sky=self._refreshed,
            model=self._model,
            wavelength_um=self._config.wavelength_um,
            utc_sigma_s=self._config.utc_sigma_s,
            bright=self._bright,
        )
        if len(self._sky_by_time) > _MAX_CACHED_TIMES:
            del self._sky_by_time[next(iter(self._sky_by_time))]
        return local_sky


def load_sky_model(config: SkyConfig) -> SkyModel:
    """Load the sky model with the installed catalogue and Earth orientation, which takes a second or two at first."""
    return SkyModel(config, earth_orientation_table(), hipparcos())


def _polar_rotation_vector(turn: float, latitude: float) -> list[float]:
    """Return the rotation vector (North, Up, East) of a rotation about the Earth's axis, rad."""
    return [turn * math.cos(latitude), turn * math.sin(latitude), 0.0]


def sky_blocks(sky: SkyConfig) -> list[StateBlock]:
    """Return the state blocks, in the order of :data:`SHARED_TERMS`.

    The states are in units of sigma, because the sigmas differ between exposures. The error of UT1 is constant for
    days, and so is the error of an unsynchronised clock.
    """
    blocks = [
        block("sky.refraction", [1.0], "refraction", time_s=sky.refraction_time_s),
        block("sky.earth_rotation", [1.0], "earth_rotation"),
        block("sky.position", [1.0, 1.0], "ship_position", time_s=sky.position_time_s),
    ]
    if sky.utc_sigma_s > 0.0:
        blocks.append(block("sky.utc", [1.0], UTC))
    return blocks


def sky_slice(slices: Mapping[str, slice]) -> slice:
    """Return the slice of the states of :func:`sky_blocks` in a filter; empty without such states.

    Args:
        slices: slice of the filter's states for each block.
    """
    if "sky.refraction" not in slices:
        return slice(0, 0)
    return slice(slices["sky.refraction"].start, slices.get("sky.utc", slices["sky.position"]).stop)

"""The sky over the ship at any moment: where stars are seen from her, and what is wrong with all of them together.

:class:`SkyWatch` is asked for the sky at a moment, once the ship's surroundings are told. The answer is a
:class:`SkyMoment`, which places stars in the horizon frame (North, Up, East), with air. The errors that stars share do
not average: refraction, Earth rotation (UT1) and the ship's position. Each direction therefore comes with its
displacement by one standard deviation of each of them (docs/explanation/stars.md).

An error of UTC turns the sky as one of UT1 does. It is a term of its own, because its cause is another: where the
clocks are taken to be right (``sky.utc_sigma_s`` 0), there is no such term.
"""

import copy
import math
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.sky.catalogue import StarCatalogue, hipparcos
from ship_attitude_star.sky.config import SkyConfig
from ship_attitude_star.sky.place_by_fixes import Place
from ship_attitude_star.sky.surroundings import Air, Surroundings
from ship_estimation.refusals import Reason, Refusal
from ship_geometry import late_erfa as erfa
from ship_geometry.earth_orientation import EarthOrientationTable, earth_orientation_table
from ship_geometry.refraction import LOWEST_ELEVATION, ModelName, refraction, refraction_slopes, seen_through_air
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.star_directions import RefreshedSky, StarPositions, fixed_stars

UTC = "utc"
SHARED_TERMS = ("refraction", "earth_rotation", "ship_position", "ship_position", UTC)
"""Error source of each column of :attr:`ApparentStars.shared_n`; the last is missing where UTC is taken to be right.

The ship's position has two columns, one for each of the independent errors of :func:`_turns`.
"""

EARTH_ROTATION_RATE = 15.041 * ARCSEC
"""Angle by which the sky turns in a second of UT1, rad."""

_MOMENTS_KEPT = 256
_STARS_KEPT = 4
"""Sets of stars whose places are kept with a moment: sensors that expose together share it."""


@dataclass(frozen=True)
class ApparentStars:
    """Stars as they are seen from the ship at one moment.

    Attributes:
        direction_n: unit vectors with refraction, shape (k, 3); NaN below the lowest elevation.
        shared_n: displacement of each direction by one sigma of each of SHARED_TERMS, rad, shape (k, 3, n_shared).
        elevation: without air, rad, shape (k,).
        visible: False where a star is lower than the refraction model holds, shape (k,).
    """

    direction_n: FloatArray
    shared_n: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]


@dataclass(frozen=True)
class BrightStars:
    """The stars that a detection without an identity may be, by their magnitude.

    Attributes:
        catalogue: all stars.
        rows: of the catalogue, shape (m,).
        directions_c: ICRS unit vectors of the stars of these rows, shape (m, 3).
        magnitudes: of these stars, increasing, shape (m,).
    """

    catalogue: StarCatalogue
    rows: NDArray[np.int64]
    directions_c: FloatArray
    magnitudes: FloatArray

    def density(self, magnitude: FloatArray, tolerance: float) -> FloatArray:
        """How many of them have a magnitude, give or take a tolerance, per steradian; all where it is NaN."""
        faintest = np.where(np.isfinite(magnitude), magnitude + tolerance, np.inf)
        brightest = np.where(np.isfinite(magnitude), magnitude - tolerance, -np.inf)
        count = np.searchsorted(self.magnitudes, faintest, "right") - np.searchsorted(self.magnitudes, brightest)
        density: FloatArray = np.asarray((count + 1.0) / (4.0 * np.pi), dtype=float)
        return density


@dataclass(frozen=True)
class SkyMoment:
    """The sky over the ship at one moment. :meth:`SkyWatch.at` makes it.

    It keeps what it was asked: an exposure that is applied again has the same stars in the same sky.

    Attributes:
        time_ns: the moment.
        place: the ship's place then.
        air: the air around her then.
        refreshed: directions of stars without air.
        model: refraction model.
        wavelength_um: effective wavelength of the sensors' light.
        utc_sigma_s: error of the clocks that all stamps come from.
        bright: stars that a detection may be.
    """

    time_ns: int
    place: Place
    air: Air
    refreshed: RefreshedSky
    model: ModelName
    wavelength_um: float
    utc_sigma_s: float
    bright: BrightStars
    _kept: dict[int, tuple[StarPositions, ApparentStars]] = field(default_factory=dict, repr=False, compare=False)

    def apparent(self, stars: StarPositions) -> ApparentStars:
        """Directions of stars, with refraction; ``stars`` has shape (k,). The arrays are read-only."""
        # What is kept holds the stars, so that no others can have their identity.
        kept = self._kept.get(id(stars))
        if kept is not None:
            return kept[1]
        found = self._apparent(stars)
        for array in (found.direction_n, found.shared_n, found.elevation, found.visible):
            array.flags.writeable = False
        self._kept[id(stars)] = stars, found
        if len(self._kept) > _STARS_KEPT:
            del self._kept[next(iter(self._kept))]
        return found

    def _apparent(self, stars: StarPositions) -> ApparentStars:
        without_air = self.refreshed.directions(stars, self.time_ns, self.place.observer)
        air = self.air
        weather_sigma = air.pressure_sigma_hpa, air.temperature_sigma_k
        seen = seen_through_air(self.model, without_air, air.weather, self.wavelength_um, weather_sigma, self.turns())
        return ApparentStars(seen.direction_n, seen.shared_n, seen.elevation, np.isfinite(seen.direction_n[:, 1]))

    def too_low(self, elevation: float) -> Refusal:
        """The refusal of a star at an elevation (rad, without air) where the refraction model does not hold."""
        text = f"elevation {np.rad2deg(elevation):.1f}°"
        if elevation < 0.0:
            text += ", below the horizon: look at gnss/fix, the clock and the identity"
        else:
            lowest_deg = np.rad2deg(LOWEST_ELEVATION[self.model])
            text += f": refraction model '{self.model}' holds from {lowest_deg:.0f}°"
        return Refusal(Reason.BELOW_HORIZON, text)

    def rotation_horizon_from_icrs(self) -> FloatArray:
        """The horizon's axes from those of the ICRS, shape (3, 3): how bodies turn, without aberration and air."""
        return self.refreshed.rotation_horizon_from_icrs(self.time_ns, self.place.observer.position)

    def bright_rows_around(self, centre_n: FloatArray, radius: float) -> NDArray[np.int64]:
        """Rows of the catalogue with the bright stars within a radius (rad) of a direction (N, U, E), shape (3,)."""
        centre_c = self.rotation_horizon_from_icrs().T @ centre_n
        rows: NDArray[np.int64] = self.bright.rows[self.bright.directions_c @ centre_c > np.cos(radius)]
        return rows

    def refraction_at(self, elevation: float) -> tuple[float, float]:
        """Refraction at an elevation without air and its standard deviation, rad; NaN where the model does not hold."""
        bent = refraction(self.model, elevation, self.air.weather, self.wavelength_um)
        return float(bent.angle), float(bent.sigma(self.air.pressure_sigma_hpa, self.air.temperature_sigma_k))

    def refraction_slopes_at(self, elevation: float) -> tuple[float, float]:
        """First and second derivative of refraction by elevation, rad/rad and rad/rad²."""
        return refraction_slopes(self.model, elevation, self.air.weather, self.wavelength_um)

    def aberration_at(self, direction_n: FloatArray) -> FloatArray:
        """Displacement by aberration of a star in a direction (N, U, E), without air, rad, shape (3,)."""
        rotation_nc = self.rotation_horizon_from_icrs()
        star = fixed_stars(*erfa.c2s(rotation_nc.T @ direction_n))
        seen_n = self.refreshed.directions(star, self.time_ns, self.place.observer)
        displacement: FloatArray = seen_n - direction_n
        return displacement

    def turns(self) -> FloatArray:
        """Turn of the whole sky by one sigma of each of SHARED_TERMS but refraction: rotation vectors, rad, (n, 3)."""
        return _turns(self.place, float(self.refreshed.orientation(self.time_ns).ut1_sigma_s), self.utc_sigma_s)


class SkyWatch:
    """Keeps what tells the sky over the ship, and gives it for any moment.

    Args:
        config: refraction, and how long fixes and readings of the air hold.
        table: Earth orientation.
        catalogue: the stars.

    Attributes:
        catalogue: the stars.
        surroundings: takes the position fixes and the readings of the air that tell the sky.
    """

    def __init__(self, config: SkyConfig, table: EarthOrientationTable, catalogue: StarCatalogue) -> None:
        self._config = config
        # The parameter has no other choices.
        self._model = cast(ModelName, config.refraction_model)
        self._table = table
        self._refreshed = RefreshedSky(table)
        self.catalogue = catalogue
        rows = catalogue.brighter_than(config.magnitude_limit)
        bright = catalogue.at_j2000[rows]
        directions_c = erfa.s2c(bright.right_ascension, bright.declination)
        self._bright = BrightStars(catalogue, rows, directions_c, np.sort(catalogue.magnitude[rows]))
        self.reset()

    def reset(self) -> None:
        """Forget fixes and readings of the air."""
        self.surroundings = Surroundings(self._config)
        self._moments: dict[int, SkyMoment] = {}

    def twin(self, with_surroundings: bool) -> "SkyWatch":
        """Return the same sky for another estimator, with a copy of the surroundings or without any."""
        twin = copy.copy(self)
        twin.reset()
        if with_surroundings:
            twin.surroundings = copy.deepcopy(self.surroundings)
        return twin

    def step_time_base(self, step_ns: int) -> None:
        """Carry fixes and readings of the air over a step of their clocks."""
        self.surroundings.step_time_base(step_ns)
        self._moments.clear()

    def at(self, time_ns: int) -> SkyMoment | Refusal:
        """The sky at a moment, or why no star can be placed then: NO_EARTH_ORIENTATION or NO_FIX."""
        found, known = self.surroundings.at(time_ns), self._moments.get(time_ns)
        if known is not None and not isinstance(found, Refusal) and known.place is found[0] and known.air is found[1]:
            return known
        reason = self._table.reason_against(time_ns)
        if reason is not None:
            return Refusal(Reason.NO_EARTH_ORIENTATION, reason)
        if isinstance(found, Refusal):
            return found
        place, air = found
        moment = self._moments[time_ns] = SkyMoment(
            time_ns=time_ns,
            place=place,
            air=air,
            refreshed=self._refreshed,
            model=self._model,
            wavelength_um=self._config.wavelength_um,
            utc_sigma_s=self._config.utc_sigma_s,
            bright=self._bright,
        )
        if len(self._moments) > _MOMENTS_KEPT:
            del self._moments[next(iter(self._moments))]
        return moment


def installed_sky(config: SkyConfig) -> SkyWatch:
    """The sky by the installed catalogue and Earth orientation; reading them takes a second or two, once."""
    return SkyWatch(config, earth_orientation_table(), hipparcos())


def _turns(place: Place, ut1_sigma_s: float, utc_sigma_s: float) -> FloatArray:
    """Turn of the sky in the horizon frame by one sigma of UT1, position and UTC, rotation vectors, rad, shape (n, 3).

    A ship that is farther north than assumed sees the sky turned about East. A ship that is farther east sees it turned
    about the Earth's axis. 31 m make 1″. The first error of position is that of north with the part of east that goes
    with it, the second is the rest of east, so that a filter may keep the two as separate states.
    """
    covariance_m2, latitude = place.covariance_m2, float(place.observer.position.latitude)
    radius_north_m, radius_east_m = map(float, place.horizon_radii_m)
    north_m = math.sqrt(max(float(covariance_m2[0, 0]), 0.0))
    east_with_north_m = float(covariance_m2[0, 2]) / north_m if north_m > 0.0 else 0.0
    east_m = math.sqrt(max(float(covariance_m2[2, 2]) - east_with_north_m**2, 0.0))
    # The horizon turns by +latitude about -East and by +longitude about the pole, the sky in it the other way.
    by_north, with_north, by_east = north_m / radius_north_m, east_with_north_m / radius_east_m, east_m / radius_east_m
    tangent = math.tan(latitude)
    turns = [
        _about_the_axis(EARTH_ROTATION_RATE * ut1_sigma_s, latitude),
        [-with_north, -with_north * tangent, by_north],
        [-by_east, -by_east * tangent, 0.0],
    ]
    if utc_sigma_s > 0.0:
        turns.append(_about_the_axis(EARTH_ROTATION_RATE * utc_sigma_s, latitude))
    return np.array(turns)


def _about_the_axis(turn: float, latitude: float) -> list[float]:
    """Rotation vector (North, Up, East) of a turn about the Earth's axis, rad."""
    return [turn * math.cos(latitude), turn * math.sin(latitude), 0.0]

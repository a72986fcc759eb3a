"""The true sky over the ship: air, Earth rotation and star positions, each with an error relative to the known values.

The sky is drawn once per run. The true air differs from the weather station's values, the true Earth rotation from the
table, and each true star position from the catalogue. Directions are computed by ERFA's exact algorithm at every time;
the estimator's algorithm, which refreshes parts periodically, is not used here.
"""

import dataclasses
from dataclasses import dataclass
from typing import cast

import erfa
import numpy as np

from ship_geometry.air.refraction import ModelName, Weather, elevation_of, raised_directions, refraction
from ship_geometry.earth.earth_orientation import EarthOrientation, earth_orientation_table
from ship_geometry.earth.geodetic import rotation_horizon_from_ecef
from ship_geometry.earth.star_directions import Observer, StarPositions, directions, fixed_stars
from ship_geometry.earth.time_scales import SECOND_NS, julian_date, tt_julian_date
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.scenario import Scenario, WeatherStation
from ship_simulation.ship.ship_track import ShipTrack
from ship_stars.sky.catalogue import StarCatalogue, hipparcos

_J2000, _JULIAN_YEAR_D = 2_451_545.0, 365.25
_MINUTE_NS = 60 * SECOND_NS

# Number of iterations from apparent to geometric elevation: each step reduces the error to 3 % at 5°.
_STEPS = 8


@dataclass(frozen=True)
class TrueSky:
    """The sky over a ship.

    Attributes:
        track: the ship's position.
        model: model of refraction.
        weather: the true air at the ship.
        ut1_error_s: true UT1 − UTC minus the tabulated value.
        catalogue: the star catalogue.
        positions: true positions of the catalogue's stars, J2000.0, one row each.
    """

    track: ShipTrack
    model: ModelName
    weather: Weather
    ut1_error_s: float
    catalogue: StarCatalogue
    positions: StarPositions

    def orientation(self, time_ns: np.ndarray) -> EarthOrientation:
        """Return the true orientation of the Earth at times in ns."""
        tabulated = earth_orientation_table().at(time_ns)
        return dataclasses.replace(tabulated, ut1_minus_utc_s=tabulated.ut1_minus_utc_s + self.ut1_error_s)

    def directions(self, stars: StarPositions, time_ns: np.ndarray) -> FloatArray:
        """Return unit vectors (N, U, E) with refraction, shape (..., 3); NaN below the range of the refraction model.

        Args:
            stars: true positions, broadcast against the times.
            time_ns: times.
        """
        observer = Observer(self.track.position_at(time_ns), self.track.velocity_n_m_per_s)
        without_air = directions(stars, time_ns, observer, self.orientation(time_ns))
        return raised_directions(without_air, refraction(self.model, elevation_of(without_air), self.weather).angle)

    def rotation_horizon_from_icrs(self, time_ns: np.ndarray) -> FloatArray:
        """Return the rotation "horizon from ICRS", without aberration, shape (n, 3, 3)."""
        orientation, position = self.orientation(time_ns), self.track.position_at(time_ns)
        ut1 = julian_date(time_ns, orientation.ut1_minus_utc_s)
        rotation_ec = erfa.c2t06a(*tt_julian_date(time_ns), *ut1, orientation.pole_x, orientation.pole_y)
        rotation_ne: FloatArray = rotation_horizon_from_ecef(position.latitude, position.longitude) @ rotation_ec
        return rotation_ne

    def refraction_rotation(self, direction_n: FloatArray) -> FloatArray:
        """Return the rotations due to refraction, shape (..., 3, 3), at apparent directions (N, U, E), shape (..., 3).

        The axis of each rotation is horizontal and perpendicular to the direction. The rotation is NaN below the range
        of the refraction model.
        """
        with_air = elevation_of(direction_n)
        angle = np.zeros_like(with_air)
        for _ in range(_STEPS):
            angle = refraction(self.model, with_air - angle, self.weather).angle
        north, _, east = np.moveaxis(direction_n, -1, 0)
        azimuth = np.arctan2(east, north)
        axis_n = np.stack([-np.sin(azimuth), np.zeros_like(azimuth), np.cos(azimuth)], axis=-1)
        turn: FloatArray = exp_rotation(angle[..., None] * axis_n)
        return turn

    def sun_elevation(self, time_ns: np.ndarray) -> FloatArray:
        """Return the elevation of the Sun's centre without refraction, rad, shape (n,).

        The elevation is interpolated between whole minutes, with an error below an arcsecond at the horizon.
        """
        minutes = np.unique(np.concatenate([time_ns // _MINUTE_NS, time_ns // _MINUTE_NS + 1]))
        to_sun_i = -erfa.epv00(*tt_julian_date(minutes * _MINUTE_NS))[0]["p"]
        to_sun_n = (self.rotation_horizon_from_icrs(minutes * _MINUTE_NS) @ to_sun_i[..., None])[..., 0]
        return np.interp(time_ns / _MINUTE_NS, minutes, elevation_of(to_sun_n))


def draw_sky(scenario: Scenario, track: ShipTrack, seed: int) -> TrueSky:
    """Return the sky of a run; its errors are drawn with sigmas of the scenario, the UT1 table and the catalogue."""
    tabulated = earth_orientation_table().at(track.start_ns)
    ut1_sigma_s = scenario.earth_rotation_sigma_s or float(tabulated.ut1_sigma_s)
    catalogue = hipparcos()
    return TrueSky(
        track=track,
        model=cast(ModelName, scenario.weather.refraction_model),
        weather=_true_air(scenario.weather, seed),
        ut1_error_s=ut1_sigma_s * random_stream(seed, "sky.earth_rotation").standard_normal(),
        catalogue=catalogue,
        positions=_draw_true_positions(catalogue, julian_year(track.start_ns), random_stream(seed, "sky.catalogue")),
    )


def julian_year(time_ns: int) -> float:
    """Return the Julian year of a time, such as 2014.5."""
    whole, fraction = julian_date(time_ns)
    return float(2000.0 + (whole - _J2000 + fraction) / _JULIAN_YEAR_D)


def position_of_date(stars: StarPositions, time_ns: int) -> StarPositions:
    """Return the ICRS positions of stars at a time, with proper motion and parallax applied."""
    tt = tt_julian_date(time_ns)
    earth_au = erfa.epv00(*tt)[1]["p"]
    place = stars.right_ascension, stars.declination
    motion = stars.pm_right_ascension, stars.pm_declination, stars.parallax_arcsec
    since_years = (tt[0] - _J2000 + tt[1]) / _JULIAN_YEAR_D
    # The radial velocity is 0, because the catalogue has none.
    direction_c = erfa.pmpx(*place, *motion, 0.0, since_years, earth_au)
    right_ascension, declination = erfa.c2s(direction_c)
    return fixed_stars(np.mod(right_ascension, 2.0 * np.pi), declination)


def _true_air(station: WeatherStation, seed: int) -> Weather:
    """Return the station's air plus its errors, within the range of the refraction models."""
    pressure, temperature = random_stream(seed, "sky.weather").standard_normal(2)
    return Weather(
        pressure_hpa=float(np.clip(station.pressure_hpa + station.pressure_sigma_hpa * pressure, 800.0, 1100.0)),
        temperature_c=float(np.clip(station.temperature_c + station.temperature_sigma_k * temperature, -60.0, 60.0)),
        relative_humidity=0.01 * station.humidity_percent,
    )


def _draw_true_positions(catalogue: StarCatalogue, year: float, rng: np.random.Generator) -> StarPositions:
    """Return the catalogue's positions, each with an error drawn with its standard deviation at a Julian year."""
    stars = catalogue.at_j2000
    east, north = catalogue.position_sigma_at(np.arange(len(catalogue.hip)), year) * rng.standard_normal(
        (2, len(catalogue.hip))
    )
    return dataclasses.replace(
        stars,
        right_ascension=stars.right_ascension + east / np.cos(stars.declination),
        declination=stars.declination + north,
    )

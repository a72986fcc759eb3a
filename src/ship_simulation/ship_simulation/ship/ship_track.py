"""The ship's true position, the fixes of its satellite receiver, and the deflection of the vertical along the track.

A part of the deflection is known from maps.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.random_draws import Draws, Stretch, random_stream
from ship_simulation.scenario.scenario import Gravity, Position, Scenario, start_time_ns

_EARTH_RADIUS_M = 6_371_000.0
"""Mean radius, accurate enough to convert the noise of a fix to degrees."""

# Minimum cosine of the latitude. It limits the longitude error near the poles, where this error is irrelevant.
_LEAST_COSINE = 1e-3

_UNKNOWN = "gravity.unknown"


@dataclass(frozen=True)
class ShipTrack:
    """A ship on a steady course: latitude and longitude change at the rates of its velocity at the start.

    Attributes:
        position: position at the start, course and speed.
        start_ns: time of the start.
    """

    position: Position
    start_ns: int

    @property
    def velocity_n_m_per_s(self) -> FloatArray:
        """Velocity over ground in (North, Up, East), shape (3,)."""
        course = np.deg2rad(self.position.course_deg)
        return self.position.speed_m_per_s * np.array([np.cos(course), 0.0, np.sin(course)])

    def latitude_longitude_deg(self, time_ns: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return latitude and longitude at times, deg."""
        place = self.position
        latitude = np.deg2rad(place.latitude_deg)
        radius_north_m, radius_east_m = horizon_radii_m(GeodeticPosition(latitude, 0.0, place.height_m))
        north_m_per_s, _, east_m_per_s = self.velocity_n_m_per_s
        since_start_s = (time_ns - self.start_ns) / SECOND_NS
        latitude_rate = north_m_per_s / radius_north_m
        longitude_rate = east_m_per_s / (radius_east_m * max(np.cos(latitude), _LEAST_COSINE))
        return (
            place.latitude_deg + np.rad2deg(latitude_rate) * since_start_s,
            place.longitude_deg + np.rad2deg(longitude_rate) * since_start_s,
        )

    def position_at(self, time_ns: np.ndarray) -> GeodeticPosition:
        """Return the position at times."""
        latitude_deg, longitude_deg = self.latitude_longitude_deg(time_ns)
        height_m = np.full(np.shape(time_ns), self.position.height_m)
        return GeodeticPosition(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), height_m)


@dataclass(frozen=True)
class FixSamples:
    """The fixes of the satellite receiver, which arrive at their stamps.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        latitude_deg: geodetic latitudes, shape (n,).
        longitude_deg: longitudes, shape (n,).
        height_m: heights above the ellipsoid, shape (n,).
        covariance_m2: covariance of the total error of each fix in (North, Up, East), shape (3, 3).
    """

    time_ns: np.ndarray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    height_m: FloatArray
    covariance_m2: FloatArray

    @property
    def log_time_ns(self) -> np.ndarray:
        """Arrival times, shape (n,)."""
        return self.time_ns

    def position(self, index: int) -> GeodeticPosition:
        """Return the position of a fix."""
        latitude, longitude = np.deg2rad([self.latitude_deg[index], self.longitude_deg[index]])
        return GeodeticPosition(float(latitude), float(longitude), float(self.height_m[index]))


def simulate_fixes(scenario: Scenario, track: ShipTrack, stretch: Stretch, draws: Draws) -> FixSamples:
    """Return fixes along the track, each with a white and a correlated error."""
    place = scenario.position
    time_ns = stretch.stamps(place.rate_hz, 0.0)
    white_m = place.sigma_m * draws.stream("gnss.white").standard_normal((time_ns.size, 3))
    sigma_m, time_s = np.full(3, place.slow_sigma_m), np.full(3, place.slow_time_s)
    slow_m = draws.gauss_markov("gnss.slow", time_ns.size, 1.0 / place.rate_hz, sigma_m, time_s)
    # The order is north, east, up.
    error_m = white_m + slow_m
    north_deg, east_deg = np.rad2deg(error_m[:, :2] / _EARTH_RADIUS_M).T
    latitude_deg, longitude_deg = track.latitude_longitude_deg(time_ns)
    return FixSamples(
        time_ns=time_ns,
        latitude_deg=np.clip(latitude_deg + north_deg, -90.0, 90.0),
        longitude_deg=longitude_deg + east_deg / max(np.cos(np.deg2rad(place.latitude_deg)), _LEAST_COSINE),
        height_m=place.height_m + error_m[:, 2],
        covariance_m2=np.diag(np.full(3, place.sigma_m**2 + place.slow_sigma_m**2)),
    )


class Deflection:
    """The deflection (xi, eta): gravity's zenith is Up + xi North + eta East.

    Args:
        scenario: parameters of gravity, and the duration.
        track: the ship's position.
        draws: random draws of the run.
    """

    def __init__(self, scenario: Scenario, track: ShipTrack, draws: Draws) -> None:
        self._gravity, self._track, self._draws = scenario.gravity, track, draws
        self._duration_s = scenario.duration_s

    def deflection_at(self, since_start_s: FloatArray) -> FloatArray:
        """Return the true deflection at times, rad, shape (n, 2)."""
        gravity, speed = self._gravity, self._track.position.speed_m_per_s
        known = known_deflection(gravity, speed * since_start_s)
        if not gravity.sigma_arcsec:
            return known
        sigma = np.full(2, gravity.sigma_arcsec * ARCSEC)
        if not speed:
            return known + sigma * random_stream(self._draws.seed, _UNKNOWN).standard_normal(2)
        time_s = gravity.correlation_length_m / speed
        return known + self._draws.correlated_error(_UNKNOWN, self._duration_s, sigma, time_s).values_at(since_start_s)

    def horizon_rotation_n(self, since_start_s: FloatArray) -> FloatArray:
        """Return the rotation vectors a (North, Up, East) between the horizons at times, rad, shape (n, 3).

        The attitude relative to the geodetic horizon is R_geodetic = exp(a) R_gravity.
        """
        xi, eta = self.deflection_at(since_start_s).T
        time_ns = self._track.start_ns + np.rint(since_start_s * SECOND_NS).astype(np.int64)
        latitude_deg, _ = self._track.latitude_longitude_deg(time_ns)
        return np.column_stack([eta, eta * np.tan(np.deg2rad(latitude_deg)), -xi])


@dataclass(frozen=True)
class DeflectionSamples:
    """The deflection published on a topic; messages arrive at their stamps.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        deflection: (xi, eta) known from maps, rad, shape (n, 2).
        covariance: covariance of the error of each deflection, rad², shape (2, 2).
    """

    time_ns: np.ndarray
    deflection: FloatArray
    covariance: FloatArray


def simulate_deflections(scenario: Scenario, stretch: Stretch) -> DeflectionSamples:
    """Return the deflection known from maps at the ship's position, at regular stamps."""
    gravity = scenario.gravity
    time_ns = stretch.stamps(gravity.rate_hz, 0.0)
    distance_m = scenario.position.speed_m_per_s * (time_ns - stretch.start_ns) / SECOND_NS
    covariance = (gravity.sigma_arcsec * ARCSEC) ** 2 * np.eye(2)
    return DeflectionSamples(time_ns, known_deflection(gravity, distance_m), covariance)


def known_deflection(gravity: Gravity, distance_m: FloatArray) -> FloatArray:
    """Return the deflection known from maps at distances along the track, rad, shape (n, 2)."""
    along = np.clip((np.asarray(distance_m) - gravity.change_start_m) / gravity.change_length_m, 0.0, 1.0)
    share = 0.5 * (1.0 - np.cos(np.pi * along))
    change_arcsec = np.array([gravity.change_xi_arcsec, gravity.change_eta_arcsec])
    known: FloatArray = ARCSEC * (np.array([gravity.xi_arcsec, gravity.eta_arcsec]) + share[..., None] * change_arcsec)
    return known


def deflection_table(scenario: Scenario) -> dict[str, list[float]]:
    """Return the table of the deflection known from maps; keys are the names of the parameters in ``gravity``."""
    gravity, track = scenario.gravity, ShipTrack(scenario.position, start_time_ns(scenario.start_utc))
    speed = scenario.position.speed_m_per_s
    end_m = speed * scenario.duration_s
    distance_m = np.linspace(0.0, end_m, max(int(np.ceil(end_m / gravity.table_step_m)), 1) + 1)
    since_start_s = distance_m / speed if speed else np.array([0.0, scenario.duration_s])
    latitude_deg, longitude_deg = track.latitude_longitude_deg(
        track.start_ns + np.rint(since_start_s * SECOND_NS).astype(np.int64)
    )
    xi_arcsec, eta_arcsec = known_deflection(gravity, distance_m).T / ARCSEC
    columns = {
        "table_latitude_deg": latitude_deg,
        "table_longitude_deg": longitude_deg,
        "table_xi_arcsec": xi_arcsec,
        "table_eta_arcsec": eta_arcsec,
    }
    return {name: np.round(column, 9).tolist() for name, column in columns.items()}

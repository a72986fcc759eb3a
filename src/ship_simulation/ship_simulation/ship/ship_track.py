"""The ship's true position, and the fixes of its satellite receiver."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.geodetic import GeodeticPosition, horizon_radii_m
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.scenario import Position, Scenario

_EARTH_RADIUS_M = 6_371_000.0
"""Mean radius, accurate enough to convert the noise of a fix to degrees."""

# Minimum cosine of the latitude. It limits the longitude error near the poles, where this error is irrelevant.
_LEAST_COSINE = 1e-3


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

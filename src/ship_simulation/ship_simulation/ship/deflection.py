"""The true deflection of the vertical along the ship's track, and its part known from maps."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.draws.noise import random_stream
from ship_simulation.draws.stretch import Draws, Stretch
from ship_simulation.scenario.scenario import Gravity, Scenario, start_time_ns
from ship_simulation.ship.ship_track import ShipTrack

_UNKNOWN = "gravity.unknown"


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

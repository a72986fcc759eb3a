"""The attitude error of a simulated free-running INS due to its gyroscopes and accelerometers.

The error is drawn second by second. Each step is exact for a constant latitude: matrix exponentials give the transition
and the covariance of the process noise (C. F. Van Loan, Computing integrals involving the matrix exponential, 1978).
The equations are independent of the estimator's implementation.
"""

import math

import numpy as np
from scipy.linalg import expm

from ship_geometry.earth.geodetic import EARTH_RATE_RAD_PER_S, GeodeticPosition, horizon_radii_m, normal_gravity
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.scenario import Scenario, start_time_ns
from ship_simulation.ship.ship_track import Deflection, ShipTrack

_STEP_S = 1.0
_STEPS_PER_LATITUDE = 300
"""Number of steps computed with the same latitude. In five minutes a ship moves only a few miles."""

_STATES = 11
"""Number of states.

Attitude (north, up, east), velocity (north, east), latitude, drift of the gyroscopes (3), bias of the accelerometers
(2).
"""


class SchulerError:
    """The error of the INS's attitude, drawn up to the latest requested time and linear between whole seconds.

    Args:
        rng: source of all draws.
        scenario: the INS, and the ship's track.
        sigma: standard deviation of the attitude error at the start, about (North, Up, East), rad, shape (3,).
        deflection: deflection of the vertical; None if gravity is everywhere normal to the ellipsoid.
    """

    def __init__(
        self, rng: np.random.Generator, scenario: Scenario, sigma: FloatArray, deflection: Deflection | None
    ) -> None:
        self._rng, self._config, self._deflection = rng, scenario.ins.schuler, deflection
        self._track = ShipTrack(scenario.position, start_time_ns(scenario.start_utc))
        course = math.radians(scenario.position.course_deg)
        speed = scenario.position.speed_m_per_s
        self._velocity = speed * math.cos(course), speed * math.sin(course)
        config = self._config
        start = np.concatenate(
            [
                sigma,
                np.full(2, config.velocity_sigma_m_per_s),
                [config.latitude_sigma],
                np.full(3, config.gyro_drift),
                np.full(2, config.accelerometer_bias_sigma_m_per_s2),
            ]
        )
        self._state = start * rng.standard_normal(_STATES)
        if deflection is not None:
            self._state[:3] += deflection.horizon_rotation_n(np.zeros(1))[0]
        self._first = 0
        self._values = self._state[None, :3]
        self._step: tuple[FloatArray, FloatArray, FloatArray]

    def errors_at(self, since_start_s: FloatArray) -> FloatArray:
        """Return the error at times, rad, shape (n, 3)."""
        if np.size(since_start_s):
            self._extend_to(math.ceil(float(np.max(since_start_s)) / _STEP_S))
        moments_s = _STEP_S * (self._first + np.arange(len(self._values)))
        return np.stack([np.interp(since_start_s, moments_s, column) for column in self._values.T], axis=-1)

    def drop_before(self, before_s: float) -> None:
        """Drop the part before a time; earlier times may not be requested any more."""
        first = min(math.floor(before_s / _STEP_S), self._first + len(self._values) - 1)
        if first > self._first:
            self._values, self._first = self._values[first - self._first :].copy(), first

    def _extend_to(self, last: int) -> None:
        done = self._first + len(self._values) - 1
        deflections = np.zeros((max(last - done, 0), 2))
        if self._deflection is not None and len(deflections):
            deflections = self._deflection.deflection_at(_STEP_S * np.arange(done + 0.5, last, dtype=np.float64))
        more = []
        for number, pull in zip(range(done, last), deflections, strict=True):
            if number % _STEPS_PER_LATITUDE == 0:
                self._step = self._step_at(number * _STEP_S)
            transition, by_deflection, root = self._step
            fresh = root @ self._rng.standard_normal(_STATES)
            self._state = transition @ self._state + by_deflection @ pull + fresh
            more.append(self._state[:3])
        if more:
            self._values = np.concatenate([self._values, more])

    def _step_at(self, since_start_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the transition of one second, the effect of the deflection, and a root of the noise covariance."""
        latitude_deg, _ = self._track.latitude_longitude_deg(
            np.array([self._track.start_ns + round(since_start_s * SECOND_NS)])
        )
        latitude = math.radians(float(latitude_deg[0]))
        rates = np.column_stack([self._state_derivative(column, latitude) for column in np.eye(_STATES + 2)])
        whole = np.vstack([rates, np.zeros((2, _STATES + 2))])
        moved = expm(_STEP_S * whole)
        own, config = rates[:, :_STATES], self._config
        density = np.diag(
            [config.angle_walk**2] * 3
            + [config.velocity_walk**2] * 2
            + [0.0]
            + [2.0 * config.gyro_drift**2 / config.gyro_drift_time_s] * 3
            + [2.0 * config.accelerometer_bias_sigma_m_per_s2**2 / config.accelerometer_bias_time_s] * 2
        )
        van_loan = expm(_STEP_S * np.block([[-own, density], [np.zeros_like(own), own.T]]))
        transition = moved[:_STATES, :_STATES]
        covariance = transition @ van_loan[:_STATES, _STATES:]
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        return transition, moved[:_STATES, _STATES:], vectors * np.sqrt(np.maximum(values, 0.0))

    def _state_derivative(self, state: FloatArray, latitude: float) -> FloatArray:
        """Return the derivative of the states, linear in ``state``, whose last two elements are the deflection."""
        tilt, (north, east), own_latitude, drift = state[:3], state[3:5], state[5], state[6:9]
        (bias_north, bias_east), (xi, eta) = state[9:11], state[11:]
        meridian_m, across_m = horizon_radii_m(GeodeticPosition(latitude, 0.0, 0.0))
        gravity, tangent = normal_gravity(latitude), math.tan(latitude)
        of_earth = EARTH_RATE_RAD_PER_S * np.array([math.cos(latitude), math.sin(latitude), 0.0])
        per_m = np.array([[0.0, 1.0 / across_m], [0.0, tangent / across_m], [-1.0 / meridian_m, 0.0]])
        over_ground, wrong_turn = per_m @ self._velocity, per_m @ [north, east]
        # Effect of a latitude error on the Earth rate and on tan L.
        wrong_earth = own_latitude * EARTH_RATE_RAD_PER_S * np.array([-math.sin(latitude), math.cos(latitude), 0.0])
        wrong_way = np.array([0.0, own_latitude * self._velocity[1] / (across_m * math.cos(latitude) ** 2), 0.0])
        sailing = np.array([self._velocity[0], 0.0, self._velocity[1]])
        # (North, Up, East) is right-handed; the specific force opposes gravity: upward, and along the deflection.
        force = np.cross([0.0, gravity, 0.0], tilt) + gravity * np.array([xi, 0.0, eta])
        turned = np.cross(2.0 * of_earth + over_ground, [north, 0.0, east])
        turned += np.cross(2.0 * wrong_earth + wrong_way, sailing)
        free = self._config.is_free
        damped = 0.0 if free else 1.0 / self._config.damping_time_s
        return np.concatenate(
            [
                np.cross(tilt, of_earth + over_ground) + wrong_turn + wrong_earth + wrong_way - drift,
                [force[0] + bias_north - turned[0] - damped * north, force[2] + bias_east - turned[2] - damped * east],
                [north / meridian_m if free else 0.0],
                -drift / self._config.gyro_drift_time_s,
                np.array([-bias_north, -bias_east]) / self._config.accelerometer_bias_time_s,
            ]
        )

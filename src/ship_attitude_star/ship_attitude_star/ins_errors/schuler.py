"""Schuler error process of an INS: errors driven by its gyroscopes and accelerometers.

A tilt error couples gravity into the measured acceleration. This causes a velocity error, which rotates the computed
horizon. The result is an oscillation with a period of 84.4 min. Vectors have the components (North, Up, East); v and b
have North and East only:

    u           attitude error, R_true = exp(u) R_ins
    v, l        errors of velocity and latitude
    e, b        gyroscope drift, accelerometer bias
    (xi, eta)   deflection of the vertical

The equations are

    du/dt = u x w + (v_E / R_E, v_E tan L / R_E, -v_N / R_N) + (-W sin L, W cos L + V_E / (R_E cos² L), 0) l - e
    dv_N/dt =  g u_E + g xi  + b_N - (2 W sin L + V_E tan L / R_E) v_E - c V_E l - v_N / T
    dv_E/dt = -g u_N + g eta + b_E + (2 W sin L + V_E tan L / R_E) v_N + c V_N l - v_E / T
    dl/dt = v_N / R_N                                                 with c = 2 W cos L + V_E / (R_E cos² L)

W is the Earth's rate, w the rotation rate of the horizon by the Earth and the ship velocity V, L the latitude, R_N and
R_E the radii of curvature. The term in 2 W sin L rotates the plane of the oscillation (Foucault); the state l adds a
period of 24 h. T is the time constant with which position aiding damps the velocity error; an INS with position aiding
has no latitude error, l = 0. e and b are Gauss-Markov processes; white noise is added to u and v. The axes of e and b
are those of the horizon, as for an INS with gimbals or sensor rotation: they do not rotate with the hull.

The equations are those of the phi-angle error model (Titterton and Weston, Strapdown Inertial Navigation Technology,
ch. 12; docs/explanation/ins.md).
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ins_errors.process import (
    ATTITUDE_ERROR,
    DEFLECTION,
    Propagation,
    Vertical,
    deflection_change,
    initial_deflection,
)
from ship_attitude_star.vertical.vertical_track import STEP_NS, LocalVertical
from ship_estimation.kalman.kalman_filter import exceeds_model
from ship_estimation.parameters.ship_devices import SchulerConfig
from ship_geometry.earth.geodetic import EARTH_RATE_RAD_PER_S, GeodeticPosition, horizon_radii_m, normal_gravity
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

_VELOCITY, _LATITUDE, _DRIFT, _BIAS = slice(5, 7), 7, slice(8, 11), slice(11, 13)
_ALL = 13

_SERIES_TERMS = 4
"""Highest power of time in the power series over a step of 2 s; accurate if time constants are much longer than 2 s."""

_MAX_CHECKPOINTS = 64
"""Maximum number of stored steps; a late position fix changes only the last few steps."""


class _Checkpoint(NamedTuple):
    """Stored propagation up to a step of the vertical.

    Attributes:
        step: index of the step.
        here: vertical from this step on.
        propagation: propagation up to this step, for one time, without the time axis.
    """

    step: int
    here: LocalVertical
    propagation: Propagation


class SchulerIns:
    """Process of INS attitude, velocity, latitude and sensor errors, and of the deflection if it is modelled.

    Args:
        config: parameters of the INS sensors.
        sigma: prior standard deviation of the attitude about (North, Up, East), rad, shape (3,).
        length_m: correlation length of the deflection over ground, m; None if the deflection is not modelled.
    """

    needs_latitude = True

    def __init__(self, config: SchulerConfig, sigma: FloatArray, length_m: float | None) -> None:
        self._config, self._sigma, self._length_m = config, sigma, length_m
        of_gravity = () if length_m is None else ("gravity.deflection",)
        of_sensors = "ins.gyro_drift", "ins.accelerometer_bias"
        self.blocks = ("ins.attitude", *of_gravity, "ins.velocity", "ins.latitude", *of_sensors)
        self._states = np.delete(np.arange(_ALL), DEFLECTION) if length_m is None else np.arange(_ALL)
        self.size = len(self._states)
        self._density = _noise_density(config)[self._states]
        self._series_cache: tuple[LocalVertical, FloatArray, FloatArray] | None = None
        # Start time, vertical at this time, and propagations from there up to each of the last steps.
        self._cache: tuple[int, LocalVertical, deque[_Checkpoint]] | None = None

    def initial_state(self, here: LocalVertical) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`; initially, the INS is levelled by gravity."""
        mean, covariance = np.zeros(self.size), np.zeros((self.size, self.size))
        if self._length_m is not None:
            mean[:5], covariance[:5, :5] = initial_deflection(here)
        return mean, covariance

    def propagation(
        self, since_ns: int, before: LocalVertical, times_ns: Sequence[int], vertical: Vertical
    ) -> Propagation:
        """See :class:`InsProcess`."""
        found = []
        for time_ns in times_ns:
            checkpoint = self._checkpoint_before(since_ns, before, time_ns, vertical)
            since_checkpoint_ns = time_ns - max(since_ns, checkpoint.step * STEP_NS)
            found.append(self._with_constant_vertical(checkpoint.propagation, checkpoint.here, since_checkpoint_ns))
        return Propagation(*(np.array(column) for column in zip(*found, strict=True)))

    def propagated_means(self, means: FloatArray, before: LocalVertical, propagation: Propagation) -> FloatArray:
        """See :class:`InsProcess`."""
        own = means[:, ATTITUDE_ERROR]
        if self._length_m is not None:
            own = own - means[:, DEFLECTION] @ before.deflection_jacobian.T
        exceeding = np.zeros_like(means)
        exceeding[:, ATTITUDE_ERROR] = np.where(exceeds_model(own, self._sigma), means[:, ATTITUDE_ERROR], 0.0)
        after: FloatArray = (
            (means - exceeding) @ np.swapaxes(propagation.transition, -1, -2) + propagation.shift[:, None] + exceeding
        )
        return after

    # -- stored propagations ------------------------------------------------------------------------------------

    def _checkpoint_before(self, since_ns: int, before: LocalVertical, time_ns: int, vertical: Vertical) -> _Checkpoint:
        """Return the propagation up to the last step at or before a time, or to the start time if no step lies between.

        Propagations are stored. A stored propagation is valid while the vertical at its step is the same object,
        because a change of the vertical at one step creates new objects for all later steps.
        """
        last = time_ns // STEP_NS
        if self._cache is None or self._cache[0] != since_ns or self._cache[1] is not before:
            self._cache = since_ns, before, deque(maxlen=_MAX_CHECKPOINTS)
        checkpoints = self._cache[2]
        while checkpoints and (
            checkpoints[-1].step > last or checkpoints[-1].here is not vertical.at(checkpoints[-1].step * STEP_NS)
        ):
            checkpoints.pop()
        if not checkpoints:
            nothing = np.zeros((self.size, self.size))
            unchanged = Propagation(np.eye(self.size), np.zeros(self.size), nothing, nothing)
            # Within the first step the vertical is that at the start time.
            first = _Checkpoint(since_ns // STEP_NS, before, unchanged)
            if first.step >= last:
                return first
            checkpoints.append(self._next_checkpoint(first, since_ns, vertical))
        while checkpoints[-1].step < last:
            checkpoints.append(self._next_checkpoint(checkpoints[-1], since_ns, vertical))
        return checkpoints[-1]

    def _next_checkpoint(self, checkpoint: _Checkpoint, since_ns: int, vertical: Vertical) -> _Checkpoint:
        """Return the propagation up to the next step, including the change of the deflection there."""
        step = checkpoint.step + 1
        end_ns = step * STEP_NS
        propagation = self._with_constant_vertical(
            checkpoint.propagation, checkpoint.here, end_ns - max(since_ns, checkpoint.step * STEP_NS)
        )
        here = vertical.at(end_ns)
        return _Checkpoint(step, here, self._with_deflection_change(propagation, checkpoint.here, here))

    def _with_constant_vertical(self, propagation: Propagation, here: LocalVertical, time_ns: int) -> Propagation:
        """Extend a propagation by a time of at most one step with a constant vertical."""
        powers = (time_ns / SECOND_NS) ** np.arange(_SERIES_TERMS + 1.0)
        transition, noise = (np.tensordot(powers, terms, 1) for terms in self._power_series(here))
        return Propagation(
            transition @ propagation.transition,
            transition @ propagation.shift,
            transition @ propagation.ins_noise @ transition.T + noise,
            transition @ propagation.deflection_noise @ transition.T,
        )

    def _with_deflection_change(
        self, propagation: Propagation, before: LocalVertical, here: LocalVertical
    ) -> Propagation:
        """Extend a propagation by a change of the deflection at its end, without direct effect on the INS states."""
        if self._length_m is None:
            return propagation
        change = deflection_change(before, here, self._length_m)
        remaining_ratio = np.ones(self.size)
        remaining_ratio[DEFLECTION] = change.remaining_ratio
        shift = remaining_ratio * propagation.shift
        deflection_noise = remaining_ratio[:, None] * propagation.deflection_noise * remaining_ratio
        shift[DEFLECTION] += change.shift
        deflection_noise[DEFLECTION, DEFLECTION] += change.noise
        return Propagation(
            remaining_ratio[:, None] * propagation.transition,
            shift,
            remaining_ratio[:, None] * propagation.ins_noise * remaining_ratio,
            deflection_noise,
        )

    # -- differential equations -----------------------------------------------------------------------------------

    def _power_series(self, here: LocalVertical) -> tuple[FloatArray, FloatArray]:
        """Return the power series in time of the propagation with a constant vertical; the last series is stored.

        Returns:
            Terms of the transition matrix and of the added covariance, shapes (5, n, n).
        """
        if self._series_cache is None or self._series_cache[0] is not here:
            system_matrix = self.system_matrix(here)
            transition, noise = [np.eye(self.size)], [np.zeros((self.size, self.size)), np.diag(self._density)]
            for term in range(1, _SERIES_TERMS + 1):
                transition.append(system_matrix @ transition[-1] / term)
            for term in range(2, _SERIES_TERMS + 1):
                noise.append((system_matrix @ noise[-1] + noise[-1] @ system_matrix.T) / term)
            self._series_cache = here, np.array(transition), np.array(noise)
        return self._series_cache[1:]

    def system_matrix(self, here: LocalVertical) -> FloatArray:
        """Return the system matrix of the differential equations for a vertical, 1/s, shape (n, n)."""
        config, (north_m_per_s, east_m_per_s) = self._config, here.velocity_m_per_s
        latitude = 0.0 if math.isnan(here.latitude) else here.latitude
        radius_north_m, radius_east_m = map(float, horizon_radii_m(GeodeticPosition(latitude, 0.0, 0.0)))
        gravity, tangent = normal_gravity(latitude), math.tan(latitude)
        turn_north = EARTH_RATE_RAD_PER_S * math.cos(latitude) + east_m_per_s / radius_east_m
        turn_up = EARTH_RATE_RAD_PER_S * math.sin(latitude) + east_m_per_s * tangent / radius_east_m
        turn_east = -north_m_per_s / radius_north_m
        coriolis = EARTH_RATE_RAD_PER_S * math.sin(latitude) + turn_up
        up_by_latitude = EARTH_RATE_RAD_PER_S * math.cos(latitude) + east_m_per_s / (
            radius_east_m * math.cos(latitude) ** 2
        )
        coriolis_by_latitude = EARTH_RATE_RAD_PER_S * math.cos(latitude) + up_by_latitude
        rates = np.zeros((_ALL, _ALL))
        rates[ATTITUDE_ERROR, ATTITUDE_ERROR] = [
            [0.0, turn_east, -turn_up],
            [-turn_east, 0.0, turn_north],
            [turn_up, -turn_north, 0.0],
        ]
        rates[ATTITUDE_ERROR, _VELOCITY] = [
            [0.0, 1.0 / radius_east_m],
            [0.0, tangent / radius_east_m],
            [-1.0 / radius_north_m, 0.0],
        ]
        rates[ATTITUDE_ERROR, _LATITUDE] = [-EARTH_RATE_RAD_PER_S * math.sin(latitude), up_by_latitude, 0.0]
        rates[ATTITUDE_ERROR, _DRIFT] = -np.eye(3)
        rates[_VELOCITY, ATTITUDE_ERROR] = [[0.0, 0.0, gravity], [-gravity, 0.0, 0.0]]
        rates[_VELOCITY, DEFLECTION] = gravity * np.eye(2)
        rates[_VELOCITY, _LATITUDE] = [-coriolis_by_latitude * east_m_per_s, coriolis_by_latitude * north_m_per_s]
        damping = 0.0
        if config.is_free:
            rates[_LATITUDE, _VELOCITY] = 1.0 / radius_north_m, 0.0
        else:
            damping = 1.0 / config.damping_time_s
        rates[_VELOCITY, _VELOCITY] = [[-damping, -coriolis], [coriolis, -damping]]
        rates[_VELOCITY, _BIAS] = np.eye(2)
        rates[_DRIFT, _DRIFT] = -np.eye(3) / config.gyro_drift_time_s
        rates[_BIAS, _BIAS] = -np.eye(2) / config.accelerometer_bias_time_s
        return rates[np.ix_(self._states, self._states)]


def _noise_density(config: SchulerConfig) -> FloatArray:
    """Return the spectral density of the noise of each state: variance added per second, shape (13,)."""
    density = np.zeros(_ALL)
    density[ATTITUDE_ERROR] = config.angle_walk**2
    density[_VELOCITY] = config.velocity_walk**2
    density[_DRIFT] = 2.0 * config.gyro_drift**2 / config.gyro_drift_time_s
    density[_BIAS] = 2.0 * config.accelerometer_bias_sigma_m_per_s2**2 / config.accelerometer_bias_time_s
    return density

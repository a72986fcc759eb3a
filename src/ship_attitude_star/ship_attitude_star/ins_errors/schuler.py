"""Schuler error process of an INS: errors driven by its gyroscopes and accelerometers.

A tilt error couples gravity into the measured acceleration, which causes a velocity error, which rotates the computed
horizon: an oscillation with a period of 84.4 min. With u the attitude error (R_true = exp(u) R_ins), v the velocity
error, l the latitude error, e the gyroscope drift, b the accelerometer bias and (xi, eta) the deflection of the
vertical, about (North, Up, East):

    du/dt = u x w + (v_E / R_E, v_E tan L / R_E, -v_N / R_N) + (-W sin L, W cos L + V_E / (R_E cos² L), 0) l - e
    dv_N/dt =  g u_E + g xi  + b_N - (2 W sin L + V_E tan L / R_E) v_E - c V_E l - v_N / T
    dv_E/dt = -g u_N + g eta + b_E + (2 W sin L + V_E tan L / R_E) v_N + c V_N l - v_E / T
    dl/dt = v_N / R_N                                                 with c = 2 W cos L + V_E / (R_E cos² L)

W is the Earth's rate, w the rotation rate of the horizon by the Earth and the ship velocity V, L the latitude, R_N and
R_E the radii of curvature. The term in 2 W sin L rotates the plane of the oscillation (Foucault); l adds a period of
24 h. T is the time constant with which position aiding damps the velocity; such an INS has no latitude error, l = 0.
e and b are Gauss-Markov processes; white noise is added to u and v. The axes of e and b are those of the horizon, as
for an INS with gimbals or sensor rotation: they do not rotate with the hull.

The equations are those of the phi-angle error model (Titterton and Weston, Strapdown Inertial Navigation Technology,
ch. 12; models.md §8).
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ins_errors.config import SchulerConfig
from ship_attitude_star.ins_errors.process import DEFLECTION, WHOLE, Propagation, Vertical, deflection_change
from ship_attitude_star.vertical.vertical_track import STEP_NS, VerticalHere
from ship_estimation.kalman import lasting
from ship_geometry.geodetic import EARTH_RATE_RAD_PER_S, GeodeticPosition, horizon_radii_m, normal_gravity
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

_VELOCITY, _LATITUDE, _DRIFT, _BIAS = slice(5, 7), 7, slice(8, 11), slice(11, 13)
_ALL = 13

_TERMS = 4
"""Number of terms of the power series over a step of 2 s; the next term is 1e-14 of the first."""

_REMEMBERED = 64
"""Number of stored steps before the newest one: a late position fix changes the last few."""


class _Checkpoint(NamedTuple):
    """Stored propagation up to a step of the vertical.

    Attributes:
        step: index of the step.
        here: vertical from this step on.
        propagation: propagation up to this step, for one time, without the time axis.
    """

    step: int
    here: VerticalHere
    propagation: Propagation


class _Way(NamedTuple):
    """Stored propagations from a start time.

    Attributes:
        since_ns: start time.
        before: vertical at the start time.
        checkpoints: the last steps.
    """

    since_ns: int
    before: VerticalHere
    knots: deque[_Checkpoint]


class _Step(NamedTuple):
    """Power series in time of the propagation with a constant vertical.

    Attributes:
        transition: terms of the transition matrix, shape (5, n, n).
        noise: terms of the added covariance, shape (5, n, n); the first is zero.
    """

    transition: FloatArray
    noise: FloatArray


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
        self._kept = np.delete(np.arange(_ALL), DEFLECTION) if length_m is None else np.arange(_ALL)
        self.size = len(self._kept)
        self._density = _noise_density(config)[self._kept]
        self._of_here: tuple[VerticalHere, _Step] | None = None
        self._way: _Way | None = None

    def initial_state(self, here: VerticalHere) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`; the INS is levelled by gravity at that time."""
        mean, covariance = np.zeros(self.size), np.zeros((self.size, self.size))
        if self._length_m is not None:
            moved_by = np.vstack([here.turn, np.eye(2)])
            mean[:5] = moved_by @ (np.zeros(2) if here.given is None else here.given)
            covariance[:5, :5] = moved_by @ here.covariance @ moved_by.T
        return mean, covariance

    def propagation(
        self, since_ns: int, before: VerticalHere, times_ns: Sequence[int], vertical: Vertical
    ) -> Propagation:
        """See :class:`InsProcess`."""
        found = []
        for time_ns in times_ns:
            knot = self._knot_before(since_ns, before, time_ns, vertical)
            since_knot_ns = time_ns - max(since_ns, knot.step * STEP_NS)
            found.append(self._while_still(knot.propagation, knot.here, since_knot_ns))
        return Propagation(*(np.array(column) for column in zip(*found, strict=True)))

    def propagated_means(self, means: FloatArray, before: VerticalHere, propagation: Propagation) -> FloatArray:
        """See :class:`InsProcess`."""
        own = means[:, WHOLE]
        if self._length_m is not None:
            own = own - means[:, DEFLECTION] @ before.turn.T
        stays = np.zeros_like(means)
        stays[:, WHOLE] = np.where(lasting(own, self._sigma), means[:, WHOLE], 0.0)
        after: FloatArray = (means - stays) @ np.swapaxes(propagation.transition, -1, -2) + propagation.shift[:, None] + stays
        return after

    # -- stored propagations ------------------------------------------------------------------------------------

    def _knot_before(self, since_ns: int, before: VerticalHere, time_ns: int, vertical: Vertical) -> _Checkpoint:
        """Return the propagation up to the last step before a time, or up to the start time if that is later.

        Propagations are stored. A stored one is valid while the vertical at its step is the same object, because a
        change of the vertical at one step creates new objects for all later steps.
        """
        last = time_ns // STEP_NS
        if self._way is None or self._way.since_ns != since_ns or self._way.before is not before:
            self._way = _Way(since_ns, before, deque(maxlen=_REMEMBERED))
        knots = self._way.knots
        while knots and (knots[-1].step > last or knots[-1].here is not vertical.at(knots[-1].step * STEP_NS)):
            knots.pop()
        if not knots:
            nothing = np.zeros((self.size, self.size))
            still = Propagation(np.eye(self.size), np.zeros(self.size), nothing, nothing)
            # Within the first step the vertical is that at the start time.
            first = _Checkpoint(since_ns // STEP_NS, before, still)
            if first.step >= last:
                return first
            knots.append(self._next(first, since_ns, vertical))
        while knots[-1].step < last:
            knots.append(self._next(knots[-1], since_ns, vertical))
        return knots[-1]

    def _next(self, knot: _Checkpoint, since_ns: int, vertical: Vertical) -> _Checkpoint:
        """Return the propagation up to the next step, including the change of the deflection there."""
        step = knot.step + 1
        end_ns = step * STEP_NS
        there = self._while_still(knot.propagation, knot.here, end_ns - max(since_ns, knot.step * STEP_NS))
        here = vertical.at(end_ns)
        return _Checkpoint(step, here, self._with_change(there, knot.here, here))

    def _while_still(self, way: Propagation, here: VerticalHere, time_ns: int) -> Propagation:
        """Extend a propagation by a time of at most one step with a constant vertical."""
        motion, powers = self._motion(here), (time_ns / SECOND_NS) ** np.arange(_TERMS + 1.0)
        transition, noise = np.tensordot(powers, motion.transition, 1), np.tensordot(powers, motion.noise, 1)
        return Propagation(
            transition @ way.transition,
            transition @ way.shift,
            transition @ way.ins_noise @ transition.T + noise,
            transition @ way.deflection_noise @ transition.T,
        )

    def _with_change(self, way: Propagation, before: VerticalHere, here: VerticalHere) -> Propagation:
        """Extend a propagation by a change of the deflection at its end, without direct effect on the INS states."""
        if self._length_m is None:
            return way
        change = deflection_change(before, here, self._length_m)
        left = np.ones(self.size)
        left[DEFLECTION] = change.left
        shift, fresh = left * way.shift, left[:, None] * way.deflection_noise * left
        shift[DEFLECTION] += change.shift
        fresh[DEFLECTION, DEFLECTION] += change.noise
        return Propagation(left[:, None] * way.transition, shift, left[:, None] * way.ins_noise * left, fresh)

    # -- differential equations -----------------------------------------------------------------------------------

    def _motion(self, here: VerticalHere) -> _Step:
        """Return the power series for a vertical; the last one is stored."""
        if self._of_here is None or self._of_here[0] is not here:
            rates = self.rates(here)
            transition, noise = [np.eye(self.size)], [np.zeros((self.size, self.size)), np.diag(self._density)]
            for term in range(1, _TERMS + 1):
                transition.append(rates @ transition[-1] / term)
            for term in range(2, _TERMS + 1):
                noise.append((rates @ noise[-1] + noise[-1] @ rates.T) / term)
            self._of_here = here, _Step(np.array(transition), np.array(noise))
        return self._of_here[1]

    def rates(self, here: VerticalHere) -> FloatArray:
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
        rates[WHOLE, WHOLE] = [
            [0.0, turn_east, -turn_up],
            [-turn_east, 0.0, turn_north],
            [turn_up, -turn_north, 0.0],
        ]
        rates[WHOLE, _VELOCITY] = [
            [0.0, 1.0 / radius_east_m],
            [0.0, tangent / radius_east_m],
            [-1.0 / radius_north_m, 0.0],
        ]
        rates[WHOLE, _LATITUDE] = [-EARTH_RATE_RAD_PER_S * math.sin(latitude), up_by_latitude, 0.0]
        rates[WHOLE, _DRIFT] = -np.eye(3)
        rates[_VELOCITY, WHOLE] = [[0.0, 0.0, gravity], [-gravity, 0.0, 0.0]]
        rates[_VELOCITY, DEFLECTION] = gravity * np.eye(2)
        rates[_VELOCITY, _LATITUDE] = [-coriolis_by_latitude * east_m_per_s, coriolis_by_latitude * north_m_per_s]
        damped = 0.0
        if config.is_free:
            rates[_LATITUDE, _VELOCITY] = 1.0 / radius_north_m, 0.0
        else:
            damped = 1.0 / config.damping_time_s
        rates[_VELOCITY, _VELOCITY] = [[-damped, -coriolis], [coriolis, -damped]]
        rates[_VELOCITY, _BIAS] = np.eye(2)
        rates[_DRIFT, _DRIFT] = -np.eye(3) / config.gyro_drift_time_s
        rates[_BIAS, _BIAS] = -np.eye(2) / config.accelerometer_bias_time_s
        return rates[np.ix_(self._kept, self._kept)]


def _noise_density(config: SchulerConfig) -> FloatArray:
    """Return the spectral density of the noise of each state: variance added per second, shape (13,)."""
    density = np.zeros(_ALL)
    density[WHOLE] = config.angle_walk**2
    density[_VELOCITY] = config.velocity_walk**2
    density[_DRIFT] = 2.0 * config.gyro_drift**2 / config.gyro_drift_time_s
    density[_BIAS] = 2.0 * config.accelerometer_bias_sigma_m_per_s2**2 / config.accelerometer_bias_time_s
    return density

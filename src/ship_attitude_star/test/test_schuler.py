"""Schuler error process of the INS compared with scipy's matrix exponential and with a simulated INS.

The simulated INS is not linearised, and shares only the Earth's rate, radii and normal gravity with the process. Its
attitude and velocity are integrated by scipy from the measurements of gyroscopes and accelerometers.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ship_attitude_star.ins_errors.schuler import SchulerIns
from ship_attitude_star.vertical.deflection import GravityConfig
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.parameters.ship_devices import SchulerConfig
from ship_geometry.earth.geodetic import EARTH_RATE_RAD_PER_S, GeodeticPosition, horizon_radii_m, normal_gravity
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_stars.attitude_samples import PositionFix
from ship_stars.sky.config import SkyConfig

LATITUDE = math.radians(40.0)
START_NS = 1_700_000_000_000_000_000
CONFIG = SchulerConfig(damping_time_s=0.0)
SIGMA = np.array([10.0, 72.0, 10.0]) * ARCSEC
LENGTH_M = 30_000.0
BLOCKS = (
    "ins.attitude",
    "gravity.deflection",
    "ins.velocity",
    "ins.latitude",
    "ins.gyro_drift",
    "ins.accelerometer_bias",
)


def ns(second: float) -> int:
    return START_NS + round(second * 1e9)


def at_anchor(seconds: int, **gravity: object) -> VerticalTrack:
    """Return the vertical track of a ship at rest, with a fix each second."""
    track = VerticalTrack(GravityConfig(**gravity), SkyConfig())
    for second in range(-10, seconds + 1):
        place = GeodeticPosition(LATITUDE, math.radians(-66.0), 20.0)
        track.insert(PositionFix(ns(second), place, np.diag([0.01, 0.04, 0.01])))
    return track


def process(config: SchulerConfig = CONFIG, length_m: float | None = LENGTH_M) -> SchulerIns:
    return SchulerIns(config, SIGMA, length_m)


@pytest.mark.parametrize("damping_time_s", [0.0, 1800.0])
def test_two_hours_are_the_matrix_exponential(damping_time_s: float) -> None:
    # The transition is compared with scipy's expm over the whole time, the noise with Van Loan's integral.
    vertical = at_anchor(60, deflection="constant", xi_arcsec=20.0, sigma_arcsec=2.0)
    ins = process(replace(CONFIG, damping_time_s=damping_time_s))
    here, dt_s = vertical.at(ns(1.0)), 7200.7
    propagated = ins.propagation(ns(1.0), here, [ns(1.0 + dt_s)], vertical)
    rates = ins.system_matrix(here)
    np.testing.assert_allclose(propagated.transition[0], expm(rates * dt_s), rtol=1e-8, atol=1e-10)
    config = CONFIG
    density = np.diag(
        [config.angle_walk**2] * 3
        + [0.0] * 2
        + [config.velocity_walk**2] * 2
        + [0.0]
        + [2.0 * config.gyro_drift**2 / config.gyro_drift_time_s] * 3
        + [2.0 * config.accelerometer_bias_sigma_m_per_s2**2 / config.accelerometer_bias_time_s] * 2
    )
    scale = np.diag(1.0 / np.r_[np.full(5, ARCSEC), 0.01, 0.01, 1e-5, np.full(3, 1e-8), 1e-5, 1e-5])
    noise = np.zeros((13, 13))
    # The integral is computed in steps of 60 s: in a single step of hours it would be lost in the rounding
    # of exp(-F t).
    step = expm(60.0 * np.block([[-rates, density], [np.zeros((13, 13)), rates.T]]))
    transition = step[13:, 13:].T
    fresh = transition @ step[:13, 13:]
    for _ in range(120):
        noise = transition @ noise @ transition.T + fresh
    exact = ins.propagation(ns(1.0), here, [ns(7201.0)], vertical).ins_noise[0]
    np.testing.assert_allclose(scale @ exact @ scale, scale @ noise @ scale, rtol=1e-6, atol=1e-6)


def test_undamped_period_is_that_of_schuler() -> None:
    # Foucault's rotation of the plane, W sin L, splits Schuler's frequency symmetrically. The third period is the day.
    here = at_anchor(5).at(ns(1.0))
    rates = process(length_m=None).system_matrix(here)
    found = np.linalg.eigvals(rates).imag
    day, slow, fast = np.sort(found[found > 1e-9])
    assert 2.0 * np.pi / (0.5 * (slow + fast)) / 60.0 == pytest.approx(84.4, abs=0.1)
    assert 0.5 * (fast - slow) == pytest.approx(EARTH_RATE_RAD_PER_S * math.sin(LATITUDE), rel=0.01)
    assert 2.0 * np.pi / day / 3600.0 == pytest.approx(23.93, rel=0.01)


@pytest.mark.parametrize("sailing", [(0.0, 0.0), (8.0, -6.0)])
def test_errors_of_a_simulated_ins_follow_the_process(sailing: tuple[float, float]) -> None:
    ins, hours = process(), 1.5
    state = np.zeros(13)
    state[:3] = np.array([8.0, 40.0, -12.0]) * ARCSEC
    state[3:5] = np.array([15.0, -9.0]) * ARCSEC
    state[5:7] = 0.2, -0.1
    state[7] = 2e-4
    state[8:11] = np.array([0.004, -0.01, 0.006]) * math.pi / 180.0 / 3600.0
    state[11:] = 1e-4, -5e-5
    rates = ins.system_matrix(at_anchor(5).at(ns(1.0))._replace(velocity_m_per_s=sailing))
    # The simulated drift and bias are constant, but those of the process decay with a time constant of ten hours.
    rates[8:, 8:] = 0.0
    expected = expm(3600.0 * hours * rates) @ state
    turn, velocity = computed_ins(state, sailing, 3600.0 * hours)
    # The remaining difference is of second order in the errors.
    np.testing.assert_allclose(turn / ARCSEC, expected[:3] / ARCSEC, atol=0.1)
    np.testing.assert_allclose(velocity, expected[5:7], atol=0.002)


def computed_ins(state: np.ndarray, sailing: tuple[float, float], duration_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the final errors of a simulated INS: rotation from its horizon to the true one, rad; velocity, m/s.

    The latitude is held constant, also for a ship that sails north. The deck is the true horizon, so the attitude of
    the INS is the inverse of the rotation by the attitude error.
    """
    meridian_m, across_m = (float(one) for one in horizon_radii_m(GeodeticPosition(LATITUDE, 0.0, 0.0)))
    gravity, (xi, eta) = normal_gravity(LATITUDE), state[3:5]

    def earth(latitude: float) -> np.ndarray:
        return EARTH_RATE_RAD_PER_S * np.array([math.cos(latitude), math.sin(latitude), 0.0])

    def over_ground(velocity: np.ndarray, latitude: float) -> np.ndarray:
        return np.array(
            [velocity[2] / across_m, velocity[2] * math.tan(latitude) / across_m, -velocity[0] / meridian_m]
        )

    true_velocity = np.array([sailing[0], 0.0, sailing[1]])
    true_turn = earth(LATITUDE) + over_ground(true_velocity, LATITUDE)
    true_gravity = gravity * np.array([-xi, -1.0, -eta])
    felt = np.cross(earth(LATITUDE) + true_turn, true_velocity) - true_gravity
    # Drift and bias are along the axes of the INS horizon.
    drift, bias = state[8:11], np.array([state[11], 0.0, state[12]])

    def change(_time_s: float, x: np.ndarray) -> np.ndarray:
        rotation, velocity, error_of_latitude = x[:9].reshape(3, 3), np.array([x[9], 0.0, x[10]]), x[11]
        measured_turn = true_turn + rotation.T @ drift
        measured_force = felt + rotation.T @ bias
        own_latitude = LATITUDE + error_of_latitude
        turn = earth(own_latitude) + over_ground(velocity, own_latitude)
        force = rotation @ measured_force + np.array([0.0, -gravity, 0.0])
        force -= np.cross(earth(own_latitude) + turn, velocity)
        new = rotation @ skew(measured_turn) - skew(turn) @ rotation
        # This state is only the error of latitude, so the true north velocity is subtracted.
        return np.r_[new.ravel(), force[0], force[2], (velocity[0] - true_velocity[0]) / meridian_m]

    begin = np.r_[exp_rotation(-state[:3]).ravel(), true_velocity[[0, 2]] + state[5:7], state[7]]
    end = solve_ivp(change, (0.0, duration_s), begin, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    return log_rotation(end[:9].reshape(3, 3).T), end[9:11] - true_velocity[[0, 2]]


def skew(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def test_the_order_of_requests_does_not_matter() -> None:
    gravity = {"deflection": "constant", "xi_arcsec": 20.0, "sigma_arcsec": 2.0}
    vertical = at_anchor(400, **gravity)
    before, end_s = vertical.at(ns(1.3)), 301.7
    at_once = process().propagation(ns(1.3), before, [ns(end_s)], vertical)
    requested, more = process(), 0.0
    for more in (1.4, 50.0, 299.9, 120.0, 301.0, end_s):
        last = requested.propagation(ns(1.3), before, [ns(more)], vertical)
        requested.propagation(ns(more), vertical.at(ns(more)), [ns(more + 3.0)], vertical)
    for one, other in zip(at_once, last, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_changing_deflection_drives_the_oscillation() -> None:
    # The deflection steps from 0 to 60″: the tilt swings about the new plumb line, up to twice the step.
    ins = process()
    vertical = at_anchor(5, deflection="constant", sigma_arcsec=0.0)
    here = vertical.at(ns(1.0))
    state = np.zeros(13)
    state[3] = 60.0 * ARCSEC
    half_period_s = 0.5 * 84.4 * 60.0
    propagated = ins.propagation(ns(1.0), here, [ns(1.0 + half_period_s)], vertical)
    (after,) = ins.propagated_means(state[None], here, propagated)[0]
    assert after[2] / ARCSEC == pytest.approx(-120.0, abs=2.0)
    assert after[3] == state[3]


def test_blocks_are_named_in_the_order_of_the_states() -> None:
    assert process().blocks == BLOCKS
    assert process(length_m=None).blocks == tuple(name for name in BLOCKS if name != "gravity.deflection")
    assert (process().size, process(length_m=None).size) == (13, 11)

"""The likelihood of a record compared with an independent computation: the joint density of all measurements.

The joint covariance is assembled pair by pair. The INS's error uses the textbook's exponential, or the filter's own
Schuler process by power series over steps of two seconds. All other states use the blocks of the filter's model.
scipy.stats evaluates the density.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ship_attitude_star.ins_errors.schuler import SchulerIns
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.parameters.ship_devices import SchulerConfig
from ship_geometry.rotations import ARCSEC
from ship_simulation.scenario.motion_scenario import AngleMotion, Wave
from ship_studies.ins_noise.processes import GaussMarkovModel, SchulerModel
from ship_studies.ins_noise.session import NoiseSession, mean_location
from ship_studies.ins_noise.star_record import EpochFilter, star_record
from ship_testing.noise_sessions import STILL, scenario, simulated_noise_session

CORRELATED = {"common_sigma_arcsec": 2.0, "common_time_s": 300.0, "time_offset_sigma_s": 0.001, "phase_s": 0.5}
ROLLING = replace(STILL, roll=AngleMotion(waves={"slow": Wave(amplitude_deg=4.0, period_s=200.0)}))
WALK = 30.0
"""Random walk of the installation, arcsec/√h."""


@pytest.fixture(scope="module")
def session() -> NoiseSession:
    """Return two minutes with nuisance states that are constant, a random walk or Gauss-Markov.

    The stamps of the stars lie between those of the INS samples.
    """
    voyage = scenario(120.0, star=CORRELATED)
    found = simulated_noise_session(replace(voyage, carrier=ROLLING, ins=replace(voyage.ins, rate_hz=1.0)), 1)
    block = found.model.blocks["star.fore.installation"]
    object.__setattr__(block, "walk", np.full(3, WALK * ARCSEC / 60.0))
    return found


class Still:
    """A constant vertical."""

    def __init__(self, here: LocalVertical) -> None:
        self._here = here

    def at(self, _time_ns: int) -> LocalVertical:
        return self._here


def joint_density(session: NoiseSession, of_ins, white_arcsec: float) -> float:
    """Return log p of all comparisons; of_ins(i, j) is the covariance of the INS's error at i with that at j, rad²."""
    model, pairs = session.model, session.comparisons
    attitude, noise = model.slices["ins.attitude"], model.slices["ins.noise"]
    first_ns = pairs[0].time_ns
    sizes = np.cumsum([0, *(len(pair.value) for pair in pairs)])
    whole = np.zeros((sizes[-1], sizes[-1]))
    for i, one in enumerate(pairs):
        for j, other in enumerate(pairs[: i + 1]):
            lag_s, since_s = (one.time_ns - other.time_ns) * 1e-9, (other.time_ns - first_ns) * 1e-9
            block = one.jacobian[:, attitude] @ of_ins(i, j) @ other.jacobian[:, attitude].T
            if one.time_ns == other.time_ns:
                white = (white_arcsec * ARCSEC) ** 2
                block += white * one.jacobian[:, noise] @ other.jacobian[:, noise].T
            for name, of_block in model.blocks.items():
                if name in ("ins.attitude", "ins.noise", "gravity.deflection"):
                    continue
                source = name.removesuffix(".common")
                shared = session.common_n.get(source) if name.endswith(".common") else np.diag(of_block.sigma**2)
                if shared is None:
                    continue
                covariance = shared * np.exp(-lag_s / of_block.time_s) + np.diag(of_block.walk**2) * since_s
                rows = model.slices[name]
                block += one.jacobian[:, rows] @ covariance @ other.jacobian[:, rows].T
            if i == j:
                block += one.noise
            whole[sizes[i] : sizes[i + 1], sizes[j] : sizes[j + 1]] = block
            whole[sizes[j] : sizes[j + 1], sizes[i] : sizes[i + 1]] = block.T
    values = np.concatenate([pair.value for pair in pairs])
    return float(multivariate_normal.logpdf(values, cov=whole))


def test_every_kind_of_nuisance_is_there(session: NoiseSession) -> None:
    kinds = {name.rpartition(".")[2] for name in star_record(session).names}
    assert kinds == {"installation", "common", "time_offset"}
    assert len(session.comparisons) == 24
    # Half-way between two samples the white noise is less by the square root of two.
    np.testing.assert_allclose(star_record(session).white_gain, 0.5, rtol=1e-3)


def test_gauss_markov_is_the_joint_density(session: NoiseSession) -> None:
    record = star_record(session)
    tilt, tilt_s, heading, heading_s, white = 8.0, 100.0, 30.0, 400.0, 1.5
    values = np.array([[2.0 * tilt**2 / tilt_s, tilt_s, 2.0 * heading**2 / heading_s, heading_s, white]])
    model = GaussMarkovModel(session.config.ins)

    def of_ins(i: int, j: int) -> np.ndarray:
        lag_s = (session.comparisons[i].time_ns - session.comparisons[j].time_ns) * 1e-9
        variances = (ARCSEC * np.array([tilt, heading, tilt])) ** 2
        return np.diag(variances * np.exp(-lag_s / np.array([tilt_s, heading_s, tilt_s])))

    expected = joint_density(session, of_ins, white)
    # Parameter sets that are evaluated together do not affect each other.
    found = EpochFilter(record, model.steps(np.vstack([values, 1.3 * values]), record.times_s)).log_likelihoods()
    np.testing.assert_allclose(found[0], expected, rtol=0.0, atol=1e-6)
    assert abs(found[1] - expected) > 0.1


class Sensors(NamedTuple):
    """Parameters of a Schuler process that differ from the defaults."""

    tilt: float = 7.0
    heading: float = 40.0
    velocity: float = 0.4
    drift: float = 0.05
    angle_walk: float = 0.01
    bias: float = 3e-4
    velocity_walk: float = 0.5
    white: float = 1.5


@pytest.mark.parametrize("damping_time_s", [0.0, 100.0])
def test_schuler_is_the_joint_density(session: NoiseSession, damping_time_s: float) -> None:
    sensors, here = Sensors(), mean_location(session.comparisons)
    assert here is not None
    assert here.latitude == pytest.approx(np.deg2rad(40.0), abs=1e-4)
    # The speed is 8 m/s, but unknown at the first of twelve epochs, because a velocity needs two fixes.
    assert np.hypot(*here.velocity_m_per_s) == pytest.approx(8.0 * 11.0 / 12.0, abs=0.1)
    config = SchulerConfig(
        velocity_sigma_m_per_s=sensors.velocity,
        gyro_drift_sigma_deg_per_h=sensors.drift,
        angle_walk_deg_per_sqrt_h=sensors.angle_walk,
        accelerometer_bias_sigma_m_per_s2=sensors.bias,
        velocity_walk_m_per_s_per_sqrt_h=sensors.velocity_walk,
        damping_time_s=damping_time_s,
    )
    sigma = ARCSEC * np.array([sensors.tilt, sensors.heading, sensors.tilt])
    process = SchulerIns(config, sigma, None)
    start = np.concatenate(
        [sigma, [sensors.velocity] * 2, [config.latitude_sigma], [config.gyro_drift] * 3, [sensors.bias] * 2]
    )
    stamps = sorted({pair.time_ns for pair in session.comparisons})

    def way(since_ns: int, until_ns: int) -> tuple[np.ndarray, np.ndarray]:
        propagated = process.propagation(since_ns, here, [until_ns], Still(here))
        return propagated.transition[0], propagated.ins_noise[0]

    at = {stamps[0]: np.diag(start**2)}
    for before, after in itertools.pairwise(stamps):
        transition, noise = way(before, after)
        at[after] = transition @ at[before] @ transition.T + noise
    transitions = {(a, b): way(a, b)[0] for a in stamps for b in stamps if b >= a}

    def of_ins(i: int, j: int) -> np.ndarray:
        before, after = session.comparisons[j].time_ns, session.comparisons[i].time_ns
        return (transitions[before, after] @ at[before])[:3, :3]

    ins = session.config.ins
    configured = type(ins)(**{**vars(ins), "schuler": SchulerConfig(damping_time_s=damping_time_s)})
    model, record = SchulerModel(configured, here), star_record(session)
    assert [parameter.name.split("_")[0].split(".")[-1] for parameter in model.parameters] == [
        *("tilt", "heading", "velocity", "gyro", "angle", "accelerometer", "velocity", "white")
    ]
    found = EpochFilter(record, model.steps(np.array([sensors]), record.times_s)).log_likelihoods()
    np.testing.assert_allclose(found[0], joint_density(session, of_ins, sensors.white), rtol=0.0, atol=1e-5)


def test_a_long_record_is_thinned_with_a_warning() -> None:
    session = simulated_noise_session(scenario(400.0), 2)
    assert star_record(session).epoch_step == 1
    thinned = star_record(session, most_epochs=15)
    assert (thinned.epoch_step, len(thinned.times_s)) == (3, 14)
    np.testing.assert_allclose(np.diff(thinned.times_s), 30.0)

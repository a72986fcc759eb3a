"""Monte Carlo of the joint solution of two sensors whose exposures a noisy INS propagates to one time.

Each seed draws the noise of the centroids, of every INS sample, and the mounting of both sensors. Sky, place and air
are exact. So the errors must match the parts "star_noise" and "installation" of the covariance. The part "installation"
includes the errors of the rotation between the exposures.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.adapters.star_attitude_adapter import read_exposure
from ship_attitude_star.star_attitude.core import StarCore
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_from_stars.solution import SOLUTION_TERMS
from ship_stars.attitude_samples import SkyInput
from ship_stars.camera.camera import tangent_basis
from ship_stars.camera.config import JOINT
from ship_stars.messages.star_messages import ExposingSensor
from ship_stars.messages.surroundings_messages import surroundings_reader
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_testing.adapter_runs import START_NS
from ship_testing.small_voyage import attitude
from ship_testing.star_voyage import (
    CAMERA,
    FIX,
    FORE,
    HEADING_DEG,
    HUMIDITY,
    PRESSURE,
    STARBOARD,
    TEMPERATURE,
    air,
    config,
    fix,
    observations,
    true_deck,
)

SEEDS = 300
INS_PERIOD_NS = 40_000_000
WHITE_SIGMA_ARCSEC = 4.0
"""White noise of the INS; it is large compared with the stars' 1.3″, so that a wrong weight is detected."""

CONFIG = config(
    ins__white_sigma_arcsec=WHITE_SIGMA_ARCSEC, ins__time_offset_sigma_s=0.0, joint__window_s=0.5, joint__wait_s=1.0
)
DRAWN = [SOLUTION_TERMS.index(term) for term in ("star_noise", "installation")]


@functools.cache
def sky() -> SkyModel:
    return load_sky_model(CONFIG.sky)


@functools.cache
def surroundings() -> tuple[SkyInput, ...]:
    """Return the readings of position and air at two times."""
    values = []
    for since_ns in (0, 1_000_000_000):
        for topic in (FIX, PRESSURE, TEMPERATURE, HUMIDITY):
            message = fix(since_ns) if topic == FIX else air(topic, since_ns)
            read = surroundings_reader(topic, CONFIG.sky)(message, receive_ns=START_NS + since_ns)
            values.append(read.value)
    return tuple(values)


@functools.cache
def exact_exposure(topic: str, since_ns: int) -> StarExposure:
    id_ = topic.split("/")[1]
    message = observations(topic, since_ns)
    sensor = CONFIG.star_sensors[id_]
    exposing = ExposingSensor(id_, sensor.frame_id, CAMERA, sensor.camera)
    return read_exposure(message, START_NS + since_ns, exposing, sky().catalogue).value.exposure


@functools.cache
def exact_ins_samples() -> tuple[tuple[int, FloatArray, FloatArray], ...]:
    samples = []
    for since_ns in range(0, 2_000_000_000, INS_PERIOD_NS):
        t_s = 1e-9 * since_ns
        turn = log_rotation(attitude(t_s - 1e-4, HEADING_DEG).T @ attitude(t_s + 1e-4, HEADING_DEG))
        samples.append((START_NS + since_ns, true_deck(since_ns), turn / 2e-4))
    return tuple(samples)


def noisy_exposure(topic: str, since_ns: int, rng: np.random.Generator) -> StarExposure:
    """Return the exposure of a sensor with a mounting error and noise of the centroids."""
    exact = exact_exposure(topic, since_ns)
    sensor = CONFIG.star_sensors[topic.split("/")[1]]
    turned_s = exact.directions_s @ exp_rotation(sensor.installation_sigma_s * rng.standard_normal(3))
    off = exact.sigma[:, None] * rng.standard_normal((len(exact), 2))
    noisy_s = turned_s + np.einsum("kij,ki->kj", tangent_basis(turned_s), off)
    return replace(exact, directions_s=noisy_s / np.linalg.norm(noisy_s, axis=-1, keepdims=True))


def joint_nees(periods: float, seed: int) -> float:
    """Return the NEES of the joint solution of two exposures that are a number of INS periods apart."""
    rng = np.random.default_rng([seed, round(10.0 * periods)])
    # The first exposure has one of 16 times between two INS samples, so that few exact skies are computed.
    first_ns = 800_000_000 + int(rng.integers(16)) * INS_PERIOD_NS // 16
    core = StarCore(CONFIG, sky())
    for value in surroundings():
        assert core.add_surroundings(value) is None
    for time_ns, rotation_nd, rate_d in exact_ins_samples():
        noise = exp_rotation(WHITE_SIGMA_ARCSEC * ARCSEC * rng.standard_normal(3))
        core.add_ins(AttitudeSample(time_ns, noise @ rotation_nd, rate_d))
    solved = []
    for topic, since_ns in ((FORE, first_ns), (STARBOARD, first_ns + round(periods * INS_PERIOD_NS))):
        solved += core.add_exposure(noisy_exposure(topic, since_ns, rng)).solved
    joint = [one for one in solved if one.sensor_id == JOINT]
    assert len(joint) == 1
    assert len(joint[0].sources) == 2
    error_n = log_rotation(true_deck(first_ns) @ joint[0].solution.rotation_nb.T)
    return float(normalized_error_squared(error_n, joint[0].solution.covariance_by_source_n[DRAWN].sum(axis=0)))


@pytest.mark.statistics
@pytest.mark.parametrize("periods", [0.0, 0.3, 1.0, 2.5, 10.0])
def test_the_joint_solution_matches_its_covariance_for_any_time_between_the_exposures(periods: float) -> None:
    low, high = mean_nees_band(SEEDS, 3)
    mean = np.mean([joint_nees(periods, seed) for seed in range(SEEDS)])
    assert low < mean < high

"""Errors of the estimated σ and τ of a Gauss-Markov INS are consistent with their stated sigmas over many records.

In the first test records are drawn with an exponential covariance; :func:`log_likelihoods` computes their likelihood
from the first value and the steps. In the second test records go through the filter and the fit of
``identify_noise``.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from ship_studies.ins_noise.fit import fit, mean_log_time
from ship_studies.ins_noise.processes import GaussMarkovModel
from ship_studies.ins_noise.star_record import star_record
from ship_testing.noise_sessions import GaussMarkovProcess, draw_session, scenario, simulated_noise_session

SEEDS = 200
LOW, HIGH = np.sqrt(chi2.ppf([0.0005, 0.9995], SEEDS) / SEEDS)
"""Bounds of the RMS of ``SEEDS`` normal errors with a probability of 99.9 %: 0.84 and 1.17."""


def root_mean_square(values: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.sqrt(np.mean(np.square(values), axis=0))
    return found


def log_likelihoods(series: np.ndarray, step_s: float, times_s: np.ndarray) -> np.ndarray:
    """Return the log likelihood of k series, shape (k, n), with noise density 2, for each correlation time."""
    found = []
    for time_s in times_s:
        decay = np.exp(-step_s / time_s)
        fresh = time_s * (1.0 - decay**2)
        steps = series[:, 1:] - decay * series[:, :-1]
        squares = np.sum(series[:, 0] ** 2 / time_s + np.sum(steps**2, axis=1) / fresh)
        count = len(series) * (steps.shape[1] * np.log(fresh) + np.log(time_s))
        found.append(-0.5 * (squares + count))
    return np.array(found)


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("times", [6.0, 30.0, 200.0])
def test_the_time_is_known_as_well_as_stated(axes: int, times: float) -> None:
    count, logs, normalised = 400, np.linspace(-7.0, 9.0, 161), []
    step_s = times / count
    if times > 100.0:
        logs = np.linspace(-1.0, 1.0, 161)
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, axes])
        series = rng.standard_normal((axes, count + 1))
        decay = np.exp(-step_s)
        for index in range(count):
            series[:, index + 1] = decay * series[:, index] + np.sqrt(1.0 - decay**2) * series[:, index + 1]
        mean, variance = mean_log_time(logs, log_likelihoods(series, step_s, np.exp(logs)), times)
        normalised.append(mean / np.sqrt(variance))
    assert LOW < root_mean_square(np.array(normalised)) < HIGH


@pytest.mark.statistics
def test_sigma_and_time_are_known_as_well_as_stated_by_identify_noise() -> None:
    process = GaussMarkovProcess(10.0, 1800.0, 72.0, 1800.0, 3.0)
    session = simulated_noise_session(scenario(10_800.0, rate_hz=0.025), 1)
    model = GaussMarkovModel(session.config.ins)
    change = [2.0 * sigma**2 / time_s for sigma, time_s in (process[:2], process[2:4])]
    true = {
        "tilt_sigma_arcsec": process.tilt_arcsec,
        "tilt_time_s": process.tilt_s,
        "heading_sigma_arcsec": process.heading_arcsec,
        "heading_time_s": process.heading_s,
    }
    normalised = []
    for seed in range(SEEDS):
        found = fit(star_record(draw_session(session, seed, process)), model)
        values = {what.name: found.suite_value(what) for what in model.suite_parameters}
        of_process = [np.log(values[name][0] / value) / values[name][1] for name, value in true.items()]
        of_change = np.log(found.values[[0, 2]] / change) / found.log_sigmas[[0, 2]]
        normalised.append([*of_process, *of_change])
    root = root_mean_square(np.array(normalised))
    assert np.all(root > LOW), root
    assert np.all(root < HIGH), root

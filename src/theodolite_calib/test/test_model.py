"""Ship's error at a step of its stated covariance."""

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_testing.simulated_session import config
from theodolite_calib.filter.model import ShipErrorProcess, ShipErrorStep, ship_error_steps, state_model


def covariance(north: float, up: float, east: float) -> np.ndarray:
    return np.diag((ARCSEC * np.array([north, up, east])) ** 2)


def ship_error_step(previous_n: np.ndarray, stated_n: np.ndarray) -> ShipErrorStep | None:
    steps = ship_error_steps(previous_n, stated_n[None])
    return None if steps is None else ShipErrorStep(steps.retained[0], steps.added_n[0])


def test_small_changes_are_left_to_the_process() -> None:
    assert ship_error_step(covariance(1.4, 1.8, 1.4), covariance(1.6, 1.7, 1.9)) is None


def test_variance_decrease_acts_as_a_kalman_update() -> None:
    """Random heading errors are updated by a measurement that reduces their sigma from 72" to 20"."""
    before, after = 72.0, 20.0
    step = ship_error_step(covariance(10.0, before, 10.0), covariance(10.0, after, 10.0))
    assert step is not None
    rng = np.random.default_rng(6)
    error = before * rng.standard_normal(200_000)
    noise_variance = 1.0 / (1.0 / after**2 - 1.0 / before**2)
    gain = before**2 / (before**2 + noise_variance)
    left = (1.0 - gain) * error + gain * np.sqrt(noise_variance) * rng.standard_normal(error.size)
    assert np.std(left) == pytest.approx(after, rel=0.01)
    assert step.retained == pytest.approx([1.0, np.mean(left * error) / before**2, 1.0], rel=0.03)
    new = np.sqrt(np.diagonal(step.added_n)) / ARCSEC
    assert new == pytest.approx([0.0, np.sqrt(after**2 - (step.retained[1] * before) ** 2), 0.0], abs=1e-6)


def test_variance_increase_keeps_the_error_and_adds_to_it() -> None:
    step = ship_error_step(covariance(1.4, 1.8, 1.4), covariance(3.0, 5.0, 1.4))
    assert step is not None
    assert step.retained.tolist() == [1.0, 1.0, 1.0]
    assert np.diagonal(step.added_n) / ARCSEC**2 == pytest.approx([9.0 - 1.96, 25.0 - 3.24, 0.0])


def test_the_first_covariance_is_all_new() -> None:
    step = ship_error_step(np.zeros((3, 3)), covariance(1.4, 1.8, 1.4))
    assert step is not None
    assert step.added_n == pytest.approx(covariance(1.4, 1.8, 1.4), abs=1e-30)


def test_step_of_mean_and_covariance() -> None:
    settings = config()
    model = state_model(settings)
    process, size = ShipErrorProcess(settings, model), len(model.sources)
    previous_n, stated_n = covariance(10.0, 72.0, 10.0), covariance(2.0, 2.0, 2.0)
    root = np.random.default_rng(7).standard_normal((size, model.size, model.size))
    parts, mean = root @ root.transpose(0, 2, 1), np.arange(1.0, model.size + 1.0)
    after, after_mean = parts.copy(), mean.copy()
    step = process.apply_stated_covariance(after_mean, after, np.ones(3), previous_n, stated_n)
    assert step is not None
    columns, keep = process.columns, np.eye(model.size)
    keep[columns, columns] = np.diag(step.retained)
    expected = keep @ parts @ keep
    expected[process.source_index, columns, columns] += step.added_n
    assert after == pytest.approx(expected)
    assert after_mean == pytest.approx(keep @ mean)

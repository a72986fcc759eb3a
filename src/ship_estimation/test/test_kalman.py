"""Kalman steps on a covariance by error source, against the textbook filter with one full covariance."""

from collections.abc import Iterator

import numpy as np
import pytest

from ship_estimation.kalman.kalman_filter import (
    LinearMeasurement,
    StateModel,
    block,
    innovation,
    propagate_covariance,
    update,
)

SOURCES = ["drift", "white", "installation", "star_noise", "reference_noise"]


def ship_like_model() -> StateModel:
    return StateModel(
        [
            block("drift", [10.0, 72.0, 10.0], "drift", time_s=[1800.0, 10800.0, 1800.0]),
            block("white", [1.0, 1.0, 1.0], "white", time_s=0.0),
            block("installation", [20.0, 1.0, 1.0], "installation", walk=0.01),
        ],
        ["star_noise", "reference_noise"],
    )


def random_measurements(model: StateModel, count: int, seed: int) -> Iterator[tuple[float, LinearMeasurement]]:
    """Yield time steps, some of them zero, and measurements of 1 to 3 components with correlated noise."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        size = int(rng.integers(1, 4))
        root = rng.standard_normal((size, size))
        residual, jacobian = rng.standard_normal(size) * 10.0, rng.standard_normal((size, model.size))
        star, reference = model.sources.index("star_noise"), model.sources.index("reference_noise")
        most, rest = (star, reference) if rng.choice([True, False]) else (reference, star)
        noise_by_source = {most: root @ root.T, rest: 0.5 * np.eye(size)}
        measurement = LinearMeasurement(residual, jacobian, noise_by_source)
        yield float(rng.choice([0.0, 0.2, 5.0, 300.0])), measurement


def textbook_update(P: np.ndarray, measurement: LinearMeasurement) -> tuple[np.ndarray, np.ndarray]:
    """Kalman 1960: K = P H' (H P H' + R)^-1, x = K r, P = (I - K H) P."""
    H, R = measurement.jacobian, measurement.noise
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return K @ measurement.residual, (np.eye(len(P)) - K @ H) @ P


def information_update(P: np.ndarray, measurement: LinearMeasurement) -> np.ndarray:
    H, R = measurement.jacobian, measurement.noise
    return np.linalg.inv(np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H)


@pytest.mark.parametrize("seed", range(5))
def test_sum_of_parts_is_the_textbook_filter(seed: int) -> None:
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    P = parts.sum(axis=0)
    for dt_s, measurement in random_measurements(model, 60, seed):
        decay, noise = model.transition(dt_s)
        parts = propagate_covariance(parts, decay, noise, model.source_of)
        F = np.diag(decay)
        P = F @ P @ F.T + np.diag(noise)
        covariance, nis, gain = innovation(parts, measurement)
        expected_covariance = measurement.jacobian @ P @ measurement.jacobian.T + measurement.noise
        np.testing.assert_allclose(covariance, expected_covariance, rtol=0, atol=1e-12 * np.abs(covariance).max())
        expected_nis = measurement.residual @ np.linalg.inv(expected_covariance) @ measurement.residual
        assert nis == pytest.approx(expected_nis, rel=1e-9)
        correction, parts = update(parts, measurement, gain)
        expected_correction, P = textbook_update(P, measurement)
        # 72² is the scale of the initial covariance, and of its rounding.
        np.testing.assert_allclose(parts.sum(axis=0), P, rtol=0, atol=1e-12 * 72.0**2)
        np.testing.assert_allclose(correction, expected_correction, rtol=0, atol=1e-11 * 72.0)


@pytest.mark.parametrize("seed", range(5))
def test_one_update_is_that_of_the_information_form(seed: int) -> None:
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    _, measurement = next(random_measurements(model, 1, seed))
    _, _, gain = innovation(parts, measurement)
    _, updated = update(parts, measurement, gain)
    expected = information_update(parts.sum(axis=0), measurement)
    np.testing.assert_allclose(updated.sum(axis=0), expected, rtol=0, atol=1e-11 * expected.max())


def test_every_part_stays_symmetric_and_positive_semidefinite() -> None:
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    for dt_s, measurement in random_measurements(model, 400, 7):
        decay, noise = model.transition(dt_s)
        parts = propagate_covariance(parts, decay, noise, model.source_of)
        _, _, gain = innovation(parts, measurement)
        _, parts = update(parts, measurement, gain)
        np.testing.assert_array_equal(parts, parts.transpose(0, 2, 1))
        for part in parts:
            eigenvalues = np.linalg.eigvalsh(part)
            assert eigenvalues[0] >= -1e-12 * max(eigenvalues[-1], 1.0)


def test_very_precise_measurement_leaves_a_valid_covariance() -> None:
    """The noise variance is 1e-14 of the prior variance: (I - K H) P alone would not stay positive definite."""
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    for axis in (0, 1, 2, 1):
        jacobian = np.zeros((1, model.size))
        jacobian[0, axis] = jacobian[0, axis + 3] = 1.0
        measurement = LinearMeasurement(np.array([1.0]), jacobian, {3: np.array([[5e-11]])})
        _, _, gain = innovation(parts, measurement)
        _, parts = update(parts, measurement, gain)
        assert np.linalg.eigvalsh(parts.sum(axis=0))[0] > 0.0


def test_covariance_by_source_is_the_variance_of_each_source_alone() -> None:
    """Errors drawn for each source are filtered with the same gains; their sum is the estimation error."""
    model = ship_like_model()
    rng = np.random.default_rng(8)
    draws = 20_000
    parts = model.initial_covariance_by_source()
    rows = (model.source_of == np.arange(len(model.sources))[:, None]).astype(float)
    start_sigma = np.sqrt(np.diagonal(parts, axis1=1, axis2=2))
    # errors[s] is the estimation error with source s only.
    errors = start_sigma[:, None, :] * rng.standard_normal((len(SOURCES), draws, model.size))
    for dt_s, measurement in random_measurements(model, 25, 9):
        decay, noise = model.transition(dt_s)
        parts = propagate_covariance(parts, decay, noise, model.source_of)
        driven = np.sqrt(noise) * rng.standard_normal((draws, model.size))
        errors = decay * errors + rows[:, None, :] * driven
        covariance, _, gain = innovation(parts, measurement)
        H, P = measurement.jacobian, parts.sum(axis=0)
        K = P @ H.T @ np.linalg.inv(covariance)
        errors = errors @ (np.eye(model.size) - K @ H).T
        for source, noise in measurement.noise_by_source.items():
            errors[source] -= rng.multivariate_normal(np.zeros(len(H)), noise, draws) @ K.T
        _, parts = update(parts, measurement, gain)
    assert model.sources == SOURCES
    total = np.diagonal(parts.sum(axis=0))
    for part, error in zip(parts, errors, strict=True):
        # Five standard errors of a variance.
        expected, tolerance = np.diagonal(part), 5 * (2 / draws) ** 0.5
        np.testing.assert_allclose(np.var(error, axis=0), expected, rtol=tolerance, atol=1e-9 * total.max())
    np.testing.assert_allclose(np.var(errors.sum(axis=0), axis=0), total, rtol=5 * (2 / draws) ** 0.5)


def test_useless_measurement_changes_nothing() -> None:
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    measurement = LinearMeasurement(np.array([5.0]), np.zeros((1, model.size)), {3: np.eye(1)})
    _, nis, gain = innovation(parts, measurement)
    correction, updated = update(parts, measurement, gain)
    assert nis == 25.0
    np.testing.assert_array_equal(correction, 0.0)
    np.testing.assert_array_equal(updated, parts)


def test_inputs_are_left_as_they_were() -> None:
    """The time-ordered log keeps states and returns to them: a step must not change them."""
    model = ship_like_model()
    parts = model.initial_covariance_by_source()
    _, measurement = next(random_measurements(model, 1, 1))
    arrays = (parts, measurement.residual, measurement.jacobian, measurement.noise)
    copies = [a.copy() for a in arrays]
    _, _, gain = innovation(parts, measurement)
    gain_before = gain.copy()
    update(parts, measurement, gain)
    decay, noise = model.transition(1.0)
    propagate_covariance(parts, decay, noise, model.source_of)
    for array, copy in zip((*arrays, gain), (*copies, gain_before), strict=True):
        np.testing.assert_array_equal(array, copy)


def test_impossible_innovation_covariance_raises() -> None:
    model = ship_like_model()
    measurement = LinearMeasurement(np.zeros(1), np.zeros((1, model.size)), {3: np.array([[-1.0]])})
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        innovation(model.initial_covariance_by_source(), measurement)

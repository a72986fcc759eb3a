"""The sequential filter equals one least-squares solution of all epochs, which is set up from the definitions."""

import numpy as np

from ship_estimation.kalman.kalman_filter import (
    LinearMeasurement,
    StateModel,
    block,
    innovation,
    propagate_covariance,
    update,
)

TIMES_S = [0.0, 0.0, 3.0, 10.0, 11.0, 60.0, 61.5, 200.0]
DRIFT_SIGMA, DRIFT_TIME_S, WHITE_SIGMA, CONSTANT_SIGMA, WALK_SIGMA, WALK = 4.0, 30.0, 0.7, 6.0, 2.0, 0.3
NOISE = np.array([[1.0, 0.3], [0.3, 2.0]])


def measurement_rows(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Jacobians by (drift, white, constant, walk), shape (k, 2, 4), and measured values, shape (k, 2)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((len(TIMES_S), 2, 4)), 5.0 * rng.standard_normal((len(TIMES_S), 2))


def sequential(jacobians: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    model = StateModel(
        [
            block("drift", [DRIFT_SIGMA], "drift", time_s=DRIFT_TIME_S),
            block("white", [WHITE_SIGMA], "white", time_s=0.0),
            block("constant", [CONSTANT_SIGMA], "constant"),
            block("walk", [WALK_SIGMA], "walk", walk=WALK),
        ],
        ["noise"],
    )
    mean, parts, last_s = np.zeros(4), model.initial_covariance_by_source(), 0.0
    for time_s, jacobian, value in zip(TIMES_S, jacobians, values, strict=True):
        decay, noise = model.transition(time_s - last_s)
        mean, parts, last_s = decay * mean, propagate_covariance(parts, decay, noise, model.source_of), time_s
        measurement = LinearMeasurement(value - jacobian @ mean, jacobian, {model.sources.index("noise"): NOISE})
        _, _, gain = innovation(parts, measurement)
        correction, parts = update(parts, measurement, gain)
        mean = mean + correction
    return mean, parts.sum(axis=0)


def prior_covariance() -> np.ndarray:
    """Return the prior covariance of all states at all epochs, ordered (epoch, state), from autocovariances."""
    t = np.array(TIMES_S)
    lag_s = np.abs(t[:, None] - t)
    covariance = np.zeros((len(t), 4, len(t), 4))
    covariance[:, 0, :, 0] = DRIFT_SIGMA**2 * np.exp(-lag_s / DRIFT_TIME_S)
    covariance[:, 1, :, 1] = WHITE_SIGMA**2 * (lag_s == 0.0)
    covariance[:, 2, :, 2] = CONSTANT_SIGMA**2
    covariance[:, 3, :, 3] = WALK_SIGMA**2 + WALK**2 * np.minimum(t[:, None], t)
    return covariance.reshape(4 * len(t), 4 * len(t))


def batch(jacobians: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return state and covariance at the last epoch, by least squares from all measurements and the prior."""
    epochs = len(TIMES_S)
    design = np.zeros((epochs, 2, epochs, 4))
    for k in range(epochs):
        design[k, :, k] = jacobians[k]
    design = design.reshape(2 * epochs, 4 * epochs)
    prior = prior_covariance()
    weighted = prior @ design.T @ np.linalg.inv(design @ prior @ design.T + np.kron(np.eye(epochs), NOISE))
    mean = weighted @ values.ravel()
    covariance = prior - weighted @ design @ prior
    return mean[-4:], covariance[-4:, -4:]


def test_filter_is_batch_least_squares() -> None:
    for seed in range(10):
        jacobians, values = measurement_rows(seed)
        mean, covariance = sequential(jacobians, values)
        expected_mean, expected_covariance = batch(jacobians, values)
        np.testing.assert_allclose(mean, expected_mean, rtol=0, atol=1e-11)
        np.testing.assert_allclose(covariance, expected_covariance, rtol=0, atol=1e-11)


def test_constant_measured_often_is_the_weighted_mean() -> None:
    """The filter with a negligible prior equals numpy's least squares and the inverse normal matrix."""
    rng = np.random.default_rng(3)
    design, true = rng.standard_normal((50, 3)), np.array([1.0, -2.0, 0.5])
    sigmas = rng.uniform(0.5, 2.0, 50)
    values = design @ true + sigmas * rng.standard_normal(50)
    model = StateModel([block("constant", [1e4] * 3, "constant")], ["noise"])
    mean, parts = np.zeros(3), model.initial_covariance_by_source()
    for row, value, sigma in zip(design, values, sigmas, strict=True):
        measurement = LinearMeasurement(np.array([value - row @ mean]), row[None], {1: np.array([[sigma**2]])})
        _, _, gain = innovation(parts, measurement)
        correction, parts = update(parts, measurement, gain)
        mean = mean + correction
    expected, *_ = np.linalg.lstsq(design / sigmas[:, None], values / sigmas, rcond=None)
    np.testing.assert_allclose(mean, expected, rtol=0, atol=1e-7)
    normal = design.T @ (design / sigmas[:, None] ** 2)
    np.testing.assert_allclose(parts.sum(axis=0), np.linalg.inv(normal), rtol=1e-6)
    # With so wide a prior, all of the remaining covariance belongs to the noise.
    assert np.trace(parts[0]) < 1e-6 * np.trace(parts[1])

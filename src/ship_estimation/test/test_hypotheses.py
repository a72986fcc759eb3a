"""Rows of hypotheses against estimates made one at a time, and by Monte Carlo."""

import numpy as np
import pytest

from ship_estimation.hypotheses import compare_rows, update_rows
from ship_estimation.kalman import LinearMeasurement, innovation, update

STATES, SOURCES = 7, 3


def _row(rng):
    roots = rng.standard_normal((SOURCES, STATES, STATES))
    return roots @ roots.transpose(0, 2, 1)


def _measurement(rng, size=3):
    noise = {source: np.diag(rng.uniform(0.5, 2.0, size)) for source in range(2)}
    return LinearMeasurement(rng.standard_normal(size), rng.standard_normal((size, STATES)), noise)


def test_each_row_is_updated_as_if_it_were_alone():
    rng = np.random.default_rng(1)
    means, parts = rng.standard_normal((4, STATES)), np.stack([_row(rng) for _ in range(4)])
    measured, at_mean = _measurement(rng), rng.standard_normal(STATES)
    compared = compare_rows(means, parts, measured, at_mean, np.eye(3))
    corrections, updated = update_rows(parts, measured, compared, np.ones((4, STATES), dtype=bool))
    for row in range(4):
        residual = measured.residual - measured.jacobian @ (means[row] - at_mean)
        alone = LinearMeasurement(residual, measured.jacobian, measured.noise_by_source)
        covariance, nis = innovation(parts[row], alone)
        correction, after = update(parts[row], alone, covariance)
        assert compared.nis[row] == pytest.approx(nis, rel=1e-10)
        np.testing.assert_allclose(corrections[row], correction, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(updated[row], after, rtol=1e-9, atol=1e-10)


def test_a_row_that_leaves_a_source_out_knows_nothing_of_it_but_its_own_states():
    """Three sources in turn; the states 5 and 6 belong to the first alone. Against an estimate without it."""
    rng = np.random.default_rng(2)
    parts, mean = _row(rng)[None], np.zeros((1, STATES))
    own = np.arange(STATES) >= 5
    parts[:, :, 5:, :5] = parts[:, :, :5, 5:] = 0.0
    without, without_mean = parts.copy(), mean.copy()
    for number in range(12):
        measured, source = _measurement(rng), number % 3
        if source != 0:
            measured.jacobian[:, own] = 0.0
        compared = compare_rows(mean, parts, measured, np.zeros(STATES), np.eye(3))
        learns = own[None] if source == 0 else np.ones((1, STATES), dtype=bool)
        correction, parts = update_rows(parts, measured, compared, learns)
        mean = mean + correction
        if source != 0:
            compared = compare_rows(without_mean, without, measured, np.zeros(STATES), np.eye(3))
            correction, without = update_rows(without, measured, compared, np.ones((1, STATES), dtype=bool))
            without_mean = without_mean + correction
    np.testing.assert_allclose(mean[0, ~own], without_mean[0, ~own], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(parts.sum(1)[0][:5, :5], without.sum(1)[0][:5, :5], rtol=1e-8, atol=1e-9)
    assert np.all(np.linalg.eigvalsh(parts.sum(1)[0]) > 0.0)
    assert np.trace(parts.sum(1)[0][5:, 5:]) < 0.5 * np.trace(without.sum(1)[0][5:, 5:])


def test_whitened_turns_have_unit_covariance_and_the_share_of_the_noise_is_right():
    rng = np.random.default_rng(3)
    parts, measured = _row(rng)[None], _measurement(rng, size=8)
    by_turn = rng.standard_normal((8, 3))
    root, noise_root = np.linalg.cholesky(parts[0].sum(0)), np.linalg.cholesky(measured.noise)
    turns, by_noise = [], []
    for _ in range(2000):
        error, noise = root @ rng.standard_normal(STATES), noise_root @ rng.standard_normal(8)
        for found, residual in ((turns, measured.jacobian @ error + noise), (by_noise, noise)):
            drawn = LinearMeasurement(residual, measured.jacobian, measured.noise_by_source)
            compared = compare_rows(np.zeros((1, STATES)), parts, drawn, np.zeros(STATES), by_turn)
            found.append(compared.turn[0])
    # The sampling error of a variance of 2000 draws is 3 %; 0.12 is 3.8 of it.
    np.testing.assert_allclose(np.cov(np.array(turns).T), np.eye(3), atol=0.12)
    np.testing.assert_allclose(np.cov(np.array(by_noise).T), compared.turn_noise[0], atol=0.12)


def test_a_covariance_that_is_none_is_refused():
    parts = np.zeros((1, 1, 2, 2))
    measured = LinearMeasurement(np.zeros(2), np.eye(2), {0: np.array([[1.0, 2.0], [2.0, 1.0]])})
    with pytest.raises(np.linalg.LinAlgError):
        compare_rows(np.zeros((1, 2)), parts, measured, np.zeros(2), np.eye(2, 3))

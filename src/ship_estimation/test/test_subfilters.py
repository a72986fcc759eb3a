"""Subfilters, compared with single filters and tested by Monte Carlo."""

import numpy as np
import pytest

from ship_estimation.fault_detection.subfilters import (
    are_consistent,
    filter_covariances,
    restart_from_subfilter,
    solution_separations,
    subfilter_innovations,
    update_subfilters,
)
from ship_estimation.integrity.protection_levels import separation_sigma
from ship_estimation.kalman.kalman_filter import LinearMeasurement, innovation, update

STATES, SOURCES = 7, 3


def _measurement(rng, size=3):
    noise = {source: np.diag(rng.uniform(0.5, 2.0, size)) for source in range(2)}
    return LinearMeasurement(rng.standard_normal(size), rng.standard_normal((size, STATES)), noise)


def _stack(rng, filters):
    roots = rng.standard_normal((SOURCES + filters - 1, STATES, STATES))
    return roots @ roots.transpose(0, 2, 1)


def test_each_filter_is_updated_as_if_alone_and_the_main_filter_keeps_its_parts():
    rng = np.random.default_rng(1)
    means, stack = rng.standard_normal((4, STATES)), _stack(rng, 4)
    measured, at_mean = _measurement(rng), rng.standard_normal(STATES)
    compared = subfilter_innovations(means, filter_covariances(stack, 4), measured, at_mean, np.eye(3))
    corrections, updated = update_subfilters(stack, measured, compared, np.ones((4, STATES), dtype=bool))
    for index in range(4):
        residual = measured.residual - measured.jacobian @ (means[index] - at_mean)
        alone = LinearMeasurement(residual, measured.jacobian, measured.noise_by_source)
        parts = (
            stack[:SOURCES] if index == 0 else np.stack([stack[SOURCES + index - 1], *np.zeros((2, STATES, STATES))])
        )
        _, nis, gain = innovation(parts, alone)
        correction, after = update(parts, alone, gain)
        assert compared.nis[index] == pytest.approx(nis, rel=1e-10)
        np.testing.assert_allclose(corrections[index], correction, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(filter_covariances(updated, 4)[index], after.sum(0), rtol=1e-9, atol=1e-10)
        if index == 0:
            np.testing.assert_allclose(updated[:SOURCES], after, rtol=1e-9, atol=1e-10)


def test_subfilter_gets_no_information_from_its_excluded_source():
    """Three sources measure in turn, and only the first source measures states 5 and 6.

    The reference is a filter without the first source.
    """
    rng = np.random.default_rng(2)
    stack, mean = _stack(rng, 1), np.zeros((1, STATES))
    own = np.arange(STATES) >= 5
    stack[:, 5:, :5] = stack[:, :5, 5:] = 0.0
    without, without_mean = stack.copy(), mean.copy()
    everything = np.ones((1, STATES), dtype=bool)
    for number in range(12):
        measured, source = _measurement(rng), number % 3
        if source != 0:
            measured.jacobian[:, own] = 0.0
        compared = subfilter_innovations(mean, filter_covariances(stack, 1), measured, np.zeros(STATES), np.eye(3))
        correction, stack = update_subfilters(stack, measured, compared, own[None] if source == 0 else everything)
        mean = mean + correction
        if source != 0:
            compared = subfilter_innovations(
                without_mean, filter_covariances(without, 1), measured, np.zeros(STATES), np.eye(3)
            )
            correction, without = update_subfilters(without, measured, compared, everything)
            without_mean = without_mean + correction
    np.testing.assert_allclose(mean[0, ~own], without_mean[0, ~own], rtol=1e-8, atol=1e-10)
    after, never_updated = stack.sum(0), without.sum(0)
    np.testing.assert_allclose(after[:5, :5], never_updated[:5, :5], rtol=1e-8, atol=1e-9)
    assert np.all(np.linalg.eigvalsh(after) > 0.0)
    assert np.trace(after[5:, 5:]) < 0.5 * np.trace(never_updated[5:, 5:])


def test_restart_from_a_subfilter_keeps_the_shares_of_the_sources():
    rng = np.random.default_rng(4)
    stack = _stack(rng, 3)
    stack[:, 6] = stack[:, :, 6] = 0.0  # a state that is known exactly
    after = restart_from_subfilter(stack, 3, subfilter=2)
    for index in range(3):
        np.testing.assert_allclose(filter_covariances(after, 3)[index], stack[-1], rtol=1e-8, atol=1e-8)
    assert np.all(np.linalg.eigvalsh(after[:SOURCES]) > -1e-8)
    assert np.all(filter_covariances(after, 3)[:, 6] == 0.0)
    same = np.concatenate([stack[:SOURCES], stack[:SOURCES].sum(0)[None]])
    np.testing.assert_allclose(
        restart_from_subfilter(same, 2, subfilter=1)[:SOURCES], stack[:SOURCES], rtol=1e-6, atol=1e-7
    )


def test_whitened_innovations_have_unit_covariance_and_the_right_noise_part():
    rng = np.random.default_rng(3)
    stack, measured = _stack(rng, 1), _measurement(rng, size=8)
    by_turn = rng.standard_normal((8, 3))
    root, noise_root = np.linalg.cholesky(stack.sum(0)), np.linalg.cholesky(measured.noise)
    turns, by_noise = [], []
    for _ in range(2000):
        error, noise = root @ rng.standard_normal(STATES), noise_root @ rng.standard_normal(8)
        for found, residual in ((turns, measured.jacobian @ error + noise), (by_noise, noise)):
            drawn = LinearMeasurement(residual, measured.jacobian, measured.noise_by_source)
            compared = subfilter_innovations(
                np.zeros((1, STATES)), filter_covariances(stack, 1), drawn, np.zeros(STATES), by_turn
            )
            found.append(compared.whitened_innovation[0])
    # The sampling error of a variance of 2000 draws is 3 %; 0.12 is 3.8 times this error.
    np.testing.assert_allclose(np.cov(np.array(turns).T), np.eye(3), atol=0.12)
    np.testing.assert_allclose(np.cov(np.array(by_noise).T), compared.whitened_noise, atol=0.12)


def test_invalid_innovation_covariance_raises():
    measured = LinearMeasurement(np.zeros(2), np.eye(2), {0: np.array([[1.0, 2.0], [2.0, 1.0]])})
    with pytest.raises(np.linalg.LinAlgError):
        subfilter_innovations(np.zeros((1, 2)), np.zeros((1, 2, 2)), measured, np.zeros(2), np.eye(2, 3))


@pytest.mark.parametrize("wrong", [0.0, np.nan])
def test_solution_separations_in_their_sigmas(wrong: float) -> None:
    """Four filters of five states, the third more accurate than the main filter; numpy gives the expected values."""
    rng = np.random.default_rng(3)
    roots = rng.normal(size=(5, 5, 10))
    stack, means = roots @ roots.transpose(0, 2, 1), rng.normal(size=(4, 5))
    stack[3] *= 0.1
    means[2, 3] += wrong
    separations, statistic = solution_separations(means, stack, slice(1, 4))
    variance = filter_covariances(stack, 4)[:, range(1, 4), range(1, 4)]
    expected = means[:, 1:4] - means[0, 1:4]
    np.testing.assert_array_equal(separations, expected)
    sigma = separation_sigma(variance, variance[0])
    np.testing.assert_allclose(statistic, np.abs(expected / sigma).max(axis=-1), rtol=1e-13)
    with pytest.raises(ValueError, match="do not fit together"):
        solution_separations(means[:, :4].copy(), stack, slice(1, 4))


@pytest.mark.parametrize("moved", [0.0, 3.0, 8.0, np.nan])
def test_filters_are_consistent_up_to_the_threshold(moved: float) -> None:
    rng = np.random.default_rng(7)
    means, stack = rng.standard_normal((4, STATES)), _stack(rng, 4)
    means[2, 3] += moved
    _, sigmas = solution_separations(means, stack, slice(2, 5))
    for most_sigmas in (0.5 * np.max(sigmas), 1.001 * np.max(sigmas)):
        expected = all(one <= most_sigmas for one in sigmas)  # NaN exceeds the threshold
        assert are_consistent(means, stack, slice(2, 5), most_sigmas) is expected

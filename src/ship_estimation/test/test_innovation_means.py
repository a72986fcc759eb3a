"""Windowed innovation means against the same formulas in plain numpy; test_isolation tests their use."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.fault_detection.isolation import (
    CONSISTENT_RATIO,
    INITIAL_MEANS,
    WINDOW_LENGTHS,
    InnovationMeans,
    initial_means,
    updated_mean,
    updated_means,
)
from ship_geometry.earth.time_scales import NEVER_NS

FILTERS, SOURCES, LIMIT = 4, 3, 37.4
WEIGHTS = np.array([2.0 / (count + 1.0) for count in WINDOW_LENGTHS])[:, None]


def numpy_mean(running: np.ndarray, turn: np.ndarray) -> np.ndarray:
    seen = np.ones((*turn.shape[:-1], 1, 5))
    seen[..., 0, :3] = turn
    kept = np.hstack([np.repeat(1.0 - WEIGHTS, 4, axis=1), (1.0 - WEIGHTS) ** 2])
    return kept * running + np.hstack([np.repeat(WEIGHTS, 4, axis=1), WEIGHTS**2]) * seen


def numpy_chi2_with_constant_error(running: np.ndarray, turn_noise: np.ndarray) -> np.ndarray:
    turn, filled, variance = np.split(running[:, :, None], (3, 4), axis=1)
    covariance = (variance - filled**2) * turn_noise + (filled**2 + 1e-9) * np.eye(3)
    return np.sum(turn * np.linalg.solve(covariance, turn), axis=(-2, -1))


def numpy_means(
    means: InnovationMeans,
    sources: list[int],
    turn: np.ndarray,
    accepted: np.ndarray,
    time_ns: int,
    noise: np.ndarray | None,
) -> InnovationMeans:
    largest, size = np.sqrt(0.5 * LIMIT), np.linalg.norm(turn, axis=-1)
    running, excess, rejected = means.running.copy(), means.excess.copy(), means.rejection_counts.copy()
    measured_ns, contradicts_ns = means.last_measured_ns.copy(), means.inconsistent_since_ns.copy()
    rejected[:, sources] = np.where(accepted, 0, rejected[:, sources] + 1)
    now = numpy_mean(running[:, sources], turn * (largest / np.maximum(size, largest))[..., None])
    chi2 = np.sum(now[..., :3] ** 2, axis=-1) / now[..., 4]
    if noise is not None:
        chi2[0] = numpy_chi2_with_constant_error(now[0, 0], noise)
    running[:, sources], excess[:, sources] = now, chi2.max(axis=-1) / LIMIT
    measured_ns[sources] = np.maximum(measured_ns[sources], time_ns)
    well = (excess[0, sources] <= CONSISTENT_RATIO) & (rejected[0, sources] == 0)
    since_ns = np.where(contradicts_ns[sources] == NEVER_NS, time_ns, contradicts_ns[sources])
    contradicts_ns[sources] = np.where(well, NEVER_NS, since_ns)
    return InnovationMeans(running, excess, rejected, measured_ns, contradicts_ns)


def equal(found: InnovationMeans, expected: InnovationMeans) -> None:
    for name in ("rejection_counts", "last_measured_ns", "inconsistent_since_ns"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    np.testing.assert_allclose(found.running, expected.running, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(found.excess, expected.excess, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("sources", [[1], [2, 0]])
@pytest.mark.parametrize("has_noise", [False, True])
def test_innovation_means_equal_numpy(sources: list[int], has_noise: bool) -> None:
    """A hundred measurements with rejections, gross errors and late ones."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    noise = 0.1 * root @ root.T if has_noise and len(sources) == 1 else None
    means, contradicted = initial_means(FILTERS, SOURCES), 0
    for number in range(100):
        turn = rng.normal(scale=0.5 if number % 9 else 20.0, size=(FILTERS, len(sources), 3))
        accepted = rng.uniform(size=(FILTERS, len(sources))) < 0.8
        time_ns = number + int(rng.integers(-3, 3))
        expected = numpy_means(means, sources, turn, accepted, time_ns, noise)
        found = updated_means(means, sources, turn, accepted, time_ns, LIMIT, noise)
        equal(found, expected)
        if len(sources) == 1:
            equal(updated_means(means, sources[0], turn[:, 0], accepted[:, 0], time_ns, LIMIT, noise), expected)
        contradicted += np.count_nonzero(found.inconsistent_since_ns != NEVER_NS)
        means = found
    assert contradicted > 5


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e200])
def test_nan_innovation_counts_as_a_rejection_without_a_mean(wrong: float) -> None:
    means, turn = initial_means(FILTERS, SOURCES), np.zeros((FILTERS, 3))
    turn[2, 1] = wrong
    found = updated_means(means, 1, turn, np.ones(FILTERS, dtype=bool), 5, LIMIT)
    rejected = np.zeros((FILTERS, SOURCES))
    rejected[:, 1] = 1
    np.testing.assert_array_equal(found.rejection_counts, rejected)
    equal(replace(found, rejection_counts=means.rejection_counts), means)


def test_invalid_noise_part_is_inconsistent() -> None:
    found = updated_means(initial_means(1, 1), 0, np.ones((1, 3)), np.array([True]), 5, LIMIT, np.full((3, 3), np.nan))
    assert np.isnan(found.excess[0, 0])
    assert found.inconsistent_since_ns[0] == 5


def test_largest_mean_component_equals_numpy() -> None:
    rng, running, expected = np.random.default_rng(2), INITIAL_MEANS, INITIAL_MEANS
    for _ in range(50):
        turn = rng.normal(size=3)
        (running, farthest), expected = updated_mean(running, turn), numpy_mean(expected, turn)
        np.testing.assert_allclose(running, expected, rtol=1e-13, atol=1e-15)
        sigmas = np.max(np.abs(running[:, :3]).max(axis=-1) / np.sqrt(running[:, 4]))
        assert farthest == pytest.approx(sigmas, rel=1e-14)


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The loops do not check bounds."""
    means, turn, accepted = initial_means(FILTERS, SOURCES), np.zeros((FILTERS, 3)), np.ones(FILTERS, dtype=bool)
    calls = [
        lambda: updated_means(means, SOURCES, turn, accepted, 0, LIMIT),
        lambda: updated_means(means, 0, turn[:2], accepted, 0, LIMIT),
        lambda: updated_means(means, 0, turn, accepted[:2], 0, LIMIT),
        lambda: updated_means(means, 0, turn, accepted, 0, LIMIT, np.eye(2)),
        lambda: updated_mean(INITIAL_MEANS[:2], np.zeros(3)),
        lambda: updated_mean(np.zeros((3, 4)), np.zeros(3)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="do not fit together"):
            call()

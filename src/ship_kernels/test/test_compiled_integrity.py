"""Compiled integrity functions against the same in plain numpy, and with NaN.

"Equal" is 1e-13 relative, to the largest element where differences are taken.
"""

import numpy as np
import pytest

from ship_estimation.integrity.protection_levels import SigmaMultipliers, protection_levels, separation_sigma
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_innovations
from ship_testing.separations import solution_separations

STATES = 7
SOURCES = 3
CHOSEN = np.array([1, 2, 4])


def covariances(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Return positive definite matrices, shape (*shape, n) with n = shape[-1], of variances of about 1e-12 to 1e-8."""
    size = shape[-1]
    roots = rng.standard_normal((*shape, size)) * 10.0 ** rng.uniform(-6.0, -4.0, size)
    found: FloatArray = np.swapaxes(roots, -1, -2) @ roots
    return found


def numpy_separation(distance: FloatArray, variance: FloatArray, variance_0: FloatArray, k: SigmaMultipliers):
    """Return statistic, level and dominant hypothesis."""
    grown = np.maximum(variance, variance_0)
    sigmas = np.sqrt(np.maximum(grown - variance_0, np.maximum(1e-6 * variance_0, 1e-24)))
    levels = k.false_exclusion * sigmas + k.missed_detection[:, None] * np.sqrt(grown)
    levels = np.vstack([k.fault_free * np.sqrt(variance_0), levels])
    dominant = int(np.argmax(np.max(levels, axis=-1))) - 1
    return np.max(np.abs(distance) / sigmas, axis=-1), np.max(levels, axis=0), dominant


@pytest.mark.parametrize("count", [1, 3, 10])
def test_separations_and_levels_by_states_equal_numpy(count: int) -> None:
    rng = np.random.default_rng(1)
    to_components, by_states = rng.standard_normal((2, 3, 3))
    covariance, parts = covariances(rng, 3), covariances(rng, SOURCES, STATES)
    left_out, mean = covariances(rng, count, STATES), 1e-5 * rng.standard_normal(STATES)
    # The subfilters are much less accurate than the main filter, so that differences keep their relative accuracy.
    left_out += 10.0 * parts.sum(axis=0)
    means = mean + 1e-6 * rng.standard_normal((count, STATES))
    k, subfilters = SigmaMultipliers(6.0, 5.1, rng.uniform(0.0, 3.0, count)), np.arange(count)[::2]
    by_output = to_components, by_states, covariance
    found = protection_levels(k, subfilters, CHOSEN, by_output, mean, means, parts, left_out)
    first, without_source = parts.sum(axis=0)[np.ix_(CHOSEN, CHOSEN)], left_out[:, CHOSEN[:, None], CHOSEN]
    of_all = to_components @ covariance @ to_components.T
    without = np.diagonal(of_all + by_states @ (without_source - first) @ by_states.T, axis1=-2, axis2=-1)
    distance, in_question = (
        (means - mean)[:, CHOSEN] @ by_states.T,
        SigmaMultipliers(6.0, 5.1, k.missed_detection[subfilters]),
    )
    statistic, level, dominant = numpy_separation(
        distance[subfilters], without[subfilters], np.diagonal(of_all), in_question
    )
    np.testing.assert_allclose(found.statistic, statistic, rtol=1e-12)
    np.testing.assert_allclose(found.level, level, rtol=1e-13)
    assert found.dominant == dominant
    assert found.largest_sigma == pytest.approx(
        np.sqrt(np.diagonal(without_source[subfilters], axis1=-2, axis2=-1).max()), rel=1e-15
    )


@pytest.mark.parametrize("seed", range(20))
def test_separations_and_levels_equal_numpy(seed: int) -> None:
    rng, count = np.random.default_rng(seed), 1 + seed % 6
    k = SigmaMultipliers(6.0, 5.1, rng.uniform(0.0, 3.0, count))
    variance_0 = 10.0 ** rng.uniform(-12.0, -8.0, 3)
    # Some subfilters have no separation, some have a smaller variance than the main filter.
    variance = variance_0 * rng.choice([0.9, 1.0, 1.0 + 1e-9, 1.3, 4.0], (count, 3))
    distance = 1e-5 * rng.standard_normal((count, 3))
    for subfilters in ([*range(count)], [*range(count)][::2]):
        found = solution_separations(distance, variance, variance_0, k, subfilters)
        in_question = SigmaMultipliers(k.fault_free, k.false_exclusion, k.missed_detection[subfilters])
        statistic, level, dominant = numpy_separation(
            distance[subfilters], variance[subfilters], variance_0, in_question
        )
        np.testing.assert_allclose(found.statistic, statistic, rtol=1e-13)
        np.testing.assert_allclose(found.level, level, rtol=1e-13)
        assert found.dominant == dominant
    sigma = np.sqrt(np.maximum(variance - variance_0, np.maximum(1e-6 * variance_0, 1e-24)))
    np.testing.assert_array_equal(separation_sigma(variance, variance_0), sigma)


@pytest.mark.parametrize("place", ["distance", "variance", "variance_0"])
def test_nan_gives_no_level_and_no_separation(place: str) -> None:
    k, numbers = (
        SigmaMultipliers(6.0, 5.0, np.full(2, 2.0)),
        {"distance": np.ones((2, 3)), "variance": np.full((2, 3), 9.0)},
    )
    numbers["variance_0"] = np.full(3, 4.0)
    numbers[place][..., 1] = np.nan
    found = solution_separations(numbers["distance"], numbers["variance"], numbers["variance_0"], k)
    assert np.isnan(found.statistic).all()
    assert not (found.statistic <= k.false_exclusion).any()
    assert np.isfinite(found.level).tolist() == [place == "distance"] * 3


@pytest.mark.parametrize("seed", range(20))
def test_least_eigenvalue_equals_numpy(seed: int) -> None:
    matrix = covariances(np.random.default_rng(seed), 3)
    expected = np.linalg.eigvalsh(matrix)
    assert abs(compiled_innovations.least_eigenvalue(matrix) - expected[0]) <= 1e-14 * expected[-1]


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_square_root_times_its_transpose_is_the_covariance(rank: int) -> None:
    turns = np.random.default_rng(rank).normal(size=(3, rank))
    covariance = turns @ turns.T
    root = compiled_innovations.square_root(covariance)
    np.testing.assert_allclose(root @ root.T, covariance, rtol=0, atol=1e-14 * max(covariance.max(), 1e-300))


def test_least_eigenvalue_of_equal_and_of_nan_variances() -> None:
    assert compiled_innovations.least_eigenvalue(4.0 * np.eye(3)) == 4.0
    assert compiled_innovations.least_eigenvalue(np.diag([3.0, -2.0, 5.0])) == -2.0
    for place in np.ndindex(3, 3):
        matrix = np.eye(3)
        matrix[place] = matrix[place[::-1]] = np.nan
        assert np.isnan(compiled_innovations.least_eigenvalue(matrix))


def test_arrays_that_do_not_fit_are_refused() -> None:
    k = SigmaMultipliers(6.0, 5.0, np.full(2, 2.0))
    with pytest.raises(ValueError, match="subfilter_covariances"):
        solution_separations(np.zeros((2, 3)), np.ones((2, 3)), np.ones(3), SigmaMultipliers(6.0, 5.0, np.full(3, 2.0)))
    with pytest.raises(ValueError, match="means"):
        solution_separations(np.zeros((2, 4)), np.ones((2, 3)), np.ones(3), k)
    with pytest.raises(ValueError, match="rows"):
        solution_separations(np.zeros((2, 3)), np.ones((2, 3)), np.ones(3), k, subfilter_indices=[2])
    with pytest.raises(ValueError, match="matrix"):
        compiled_innovations.least_eigenvalue(np.eye(2))


@pytest.mark.parametrize("seed", range(20))
def test_outputs_are_covered_up_to_the_first_one_beyond_a_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, published = 12, rng.uniform(-1.0, 1.0, (3, 3))
    times_ns, covariances = 100 * np.arange(count), rng.uniform(0.0, 1.0, (count, 3, 3))
    directions = published + rng.uniform(-0.1, 0.1, (count, 3, 3))
    if seed % 4 == 0:
        covariances[rng.integers(count), 1, 1] = np.nan
    until_ns, variance, turned = int(rng.integers(300, 1500)), rng.uniform(1.5, 3.0), rng.uniform(0.08, 0.101)
    within = (
        (times_ns < until_ns)
        & (covariances.trace(axis1=1, axis2=2) <= variance)
        & (np.abs(directions - published).max(axis=(1, 2)) <= turned)
    )
    expected = count if within.all() else int(np.argmin(within))
    found = compiled_innovations.covered_count(times_ns, covariances, directions, until_ns, variance, published, turned)
    assert found == expected
    assert compiled_innovations.covered_count(times_ns, covariances, directions, 10**6, np.inf, published, np.inf) == (
        count if seed % 4 else int(np.argmax(np.isnan(covariances.trace(axis1=1, axis2=2))))
    )


def test_outputs_of_other_shapes_are_refused() -> None:
    one, three = np.zeros(1, dtype=np.int64), np.zeros((1, 3, 3))
    for outputs in ((one, three[:, :2], three), (one, three, three[:, :2]), (one, three, three[..., :2])):
        with pytest.raises(ValueError, match="shapes"):
            compiled_innovations.covered_count(*outputs, 1, 1.0, np.zeros((3, 3)), 1.0)


def numpy_coverage(level: FloatArray, published: FloatArray, covariance: FloatArray, entering: float):
    """Return True if published levels cover an output, and the bounds of variance and rotation for later outputs."""
    covers = bool(np.all(level <= 1.05 * published) or np.all(np.isnan(level) & np.isnan(published)))
    if not np.isfinite(level).all():
        return covers, np.inf, np.inf
    room = 0.5 * (np.min(1.05 * published / level) - 1.0)
    variance = covariance.trace() + np.linalg.eigvalsh(covariance)[0] * ((1.0 + room) ** 2 - 1.0)
    return covers, variance, room * level.min() / max(entering, 1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_coverage_of_published_levels_equals_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    level, covariance = rng.uniform(1e-5, 1e-4, 3), covariances(rng, 3)
    published = level * rng.uniform(0.93, 1.1, 3)
    if seed % 5 == 0:
        level[seed % 3] = np.nan
    if seed % 10 == 0:
        level[:] = published[:] = np.nan
    entering = 0.0 if seed % 7 == 0 else 1e-4
    found = compiled_innovations.coverage(level, published, covariance, entering, 1.05, 1e-12)
    expected = numpy_coverage(level, published, covariance, entering)
    assert found[0] is expected[0]
    np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-11)

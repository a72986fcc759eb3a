"""Compiled statistics of innovations against the same in plain numpy."""

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_innovations


def covariances(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Return positive definite matrices, shape (*shape, n) with n = shape[-1], of variances of about 1e-12 to 1e-8."""
    size = shape[-1]
    roots = rng.standard_normal((*shape, size)) * 10.0 ** rng.uniform(-6.0, -4.0, size)
    found: FloatArray = np.swapaxes(roots, -1, -2) @ roots
    return found


@pytest.mark.parametrize(("parts", "axes"), [(1, 3), (1, 1), (8, 2), (2, 3)])
def test_innovation_statistics_equal_numpy(parts: int, axes: int) -> None:
    rng, size = np.random.default_rng(parts), parts * axes
    noise = covariances(rng, size)
    covariance, residual = noise + covariances(rng, size), 1e-5 * rng.standard_normal(size)
    part_of, axis_of = np.divmod(np.arange(size), axes)
    squares, own_share, along = compiled_innovations.innovation_statistics(
        residual, covariance, noise, part_of, axis_of, parts, axes
    )
    for part in range(parts):
        rows = np.flatnonzero(part_of == part)
        expected = residual[rows] @ np.linalg.solve(covariance[np.ix_(rows, rows)], residual[rows])
        assert squares[part] == pytest.approx(expected, rel=1e-9)  # to the accuracy of numpy's solution
    assert own_share == pytest.approx(np.trace(np.linalg.solve(covariance, noise)) / size, rel=1e-9)
    sigma = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    for axis in range(axes):
        rows = np.flatnonzero(axis_of == axis)
        mean = np.sum(residual[rows] / sigma[rows]) / np.sqrt(np.sum(correlation[np.ix_(rows, rows)]))
        np.testing.assert_allclose(along[axis], [mean, np.mean(residual[rows])], rtol=1e-12)


def test_well_conditioned_innovation_statistics_equal_numpy_to_rounding() -> None:
    rng = np.random.default_rng(7)
    noise = np.diag(rng.uniform(1.0, 4.0, 6))
    covariance, residual, every = noise + 0.1, rng.standard_normal(6), np.arange(6)
    squares, own_share, _ = compiled_innovations.innovation_statistics(
        residual, covariance, noise, 0 * every, every, 1, 6
    )
    assert squares[0] == pytest.approx(residual @ np.linalg.solve(covariance, residual), rel=1e-13)
    assert own_share == pytest.approx(np.trace(np.linalg.solve(covariance, noise)) / 6.0, rel=1e-13)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_invalid_covariance_or_nan_gives_no_innovation(bad: float) -> None:
    one, every = np.array([0]), np.eye(1)
    assert compiled_innovations.innovation_statistics(np.ones(1), bad * every, every, one, one, 1, 1) is None
    if not np.isfinite(bad):
        assert compiled_innovations.innovation_statistics(np.array([bad]), every, every, one, one, 1, 1) is None


def test_arrays_that_do_not_fit_are_refused() -> None:
    one = np.array([0])
    for covariance, noise in ((np.eye(2), np.eye(1)), (np.eye(1), np.eye(2))):
        with pytest.raises(ValueError, match="shapes"):
            compiled_innovations.innovation_statistics(np.ones(1), covariance, noise, one, one, 1, 1)
    with pytest.raises(ValueError, match="columns"):
        compiled_innovations.part_sizes(np.zeros((2, 7)), 8, 0.5)
    with pytest.raises(ValueError, match="columns"):
        compiled_innovations.axis_statistics(np.zeros((2, 10)), 3, 1, 1.5, 3.0)


def random_innovations(rng: np.random.Generator, count: int, axes: int, parts: int) -> FloatArray:
    """Return innovations as in a table: some without an axis, with fewer parts, with rejected parts, or not used."""
    numbers = np.full((count, 5 + 2 * axes + parts), np.nan)
    numbers[:, 0], numbers[:, 2] = rng.integers(0, 4, count), rng.integers(0, 9, count)
    numbers[:, 1], numbers[:, 3] = rng.chisquare(3, count), rng.uniform(0.3, 1.0, count)
    numbers[:, 4] = rng.random(count) > 0.1
    along, squares = numbers[:, 5 : 5 + 2 * axes], numbers[:, 5 + 2 * axes :]
    along[:] = 0.5 + rng.standard_normal(along.shape)
    along[rng.random(count) < 0.2, :2] = np.nan
    squares[:] = rng.chisquare(2, squares.shape)
    squares[rng.random(squares.shape) < 0.2], squares[rng.random(squares.shape) < 0.05] = np.nan, np.inf
    return numbers


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("count", [0, 1, 40, 301])
def test_part_sizes_equal_numpy(count: int, parts: int) -> None:
    numbers = random_innovations(np.random.default_rng(count), count, 2, parts)
    squares, degrees, own_share, nis, components = compiled_innovations.part_sizes(numbers, 9, 0.5)
    informative = numbers[numbers[:, 3] >= 0.5]
    expected = np.sort(informative[:, 9:], axis=None)
    np.testing.assert_array_equal(squares, expected[~np.isnan(expected)])
    assert degrees == informative[:, 0].max(initial=0)
    assert own_share == pytest.approx(
        np.mean(informative[:, 3]) if len(informative) else np.nan, rel=1e-13, nan_ok=True
    )
    assert nis == pytest.approx(numbers[:, 1].sum(), rel=1e-13)
    assert components == numbers[:, 2].sum()


@pytest.mark.parametrize("count", [0, 20, 41, 300])
def test_axis_statistics_equal_numpy(count: int) -> None:
    numbers = random_innovations(np.random.default_rng(count), count, 3, 2)
    figures, common = compiled_innovations.axis_statistics(numbers, 3, 20, 1.4826, 3.0)
    unused = numbers[numbers[:, 4] == 0.0]
    assert common == (np.max(1.0 - unused[:, 3]) if len(unused) else 0.0)
    for axis, (known, *found) in enumerate(figures):
        values = numbers[:, 5 + 2 * axis]
        values = values[~np.isnan(values)]
        assert known == len(values)
        if known < 20:
            assert np.isnan(found).all()
            continue
        bias = np.median(values)
        spread = max(1.0, 1.4826 * np.median(np.abs(values - bias)))
        around = np.clip(values - bias, -3.0 * spread, 3.0 * spread)
        correlation = np.sum(around[1:] * around[:-1]) / np.sum(around * around)
        assert found[:2] == [bias, spread]
        assert found[2] == pytest.approx(correlation, rel=1e-12)


def test_equal_innovations_are_not_correlated() -> None:
    numbers = np.ones((30, 7))
    figures, _ = compiled_innovations.axis_statistics(numbers, 1, 30, 1.4826, 3.0)
    assert figures.tolist() == [[30.0, 1.0, 1.0, 0.0]]

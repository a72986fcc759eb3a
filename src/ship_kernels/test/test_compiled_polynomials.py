"""Compiled interpolation by Newton's polynomial, and by a cubic with differenced slopes, against numpy."""

import itertools

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.interpolation_error import (
    ANY_DIRECTION,
    MOST_SAMPLES,
    NEXT_TERM_SHARE,
    as_covariance,
    polynomial_errors,
)
from ship_geometry.tracks.sample_track import hermite_weights
from ship_kernels import compiled_tracks

RNG_SEED = 3
TURN = 2.0 * np.pi


def equal(found: FloatArray | float, expected: FloatArray | float) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def divided_differences(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Return coefficients of Newton's polynomial through ``values``, shape (n, k), at ``nodes``, shape (n,)."""
    coefficients = np.array(values)
    for order in range(1, len(nodes)):
        steps = nodes[order:] - nodes[:-order]
        coefficients[order:] = (coefficients[order:] - coefficients[order - 1 : -1]) / steps[:, None]
    return coefficients


def errors(nodes: FloatArray, values: FloatArray, at: float, found: FloatArray) -> FloatArray:
    if len(nodes) == 2:
        return np.array([0.5 * at * (1.0 - at) * (values[1] - values[0])])
    terms = divided_differences(nodes, values) * np.cumprod(np.append(1.0, at - nodes[:-1]))[:, None]
    return np.array([terms.sum(axis=0) - found, (NEXT_TERM_SHARE if len(nodes) == MOST_SAMPLES else 1.0) * terms[-1]])


@pytest.mark.parametrize(("count", "width"), list(itertools.product([3, 4, 5], [1, 2, 3])))
def test_errors_by_a_polynomial_are_those_by_numpy(count: int, width: int) -> None:
    rng = np.random.default_rng(RNG_SEED)
    nodes = np.array([0.0, 1.0, -1.1, 1.9, -2.3])[:count]
    values, found = rng.standard_normal((count, width)), rng.standard_normal(width)
    equal(np.array(polynomial_errors(nodes, values, 0.3, found)), errors(nodes, values, 0.3, found))


def short(step: FloatArray, period: float) -> FloatArray:
    return step if period == np.inf else step - period * np.round(step / period)


@pytest.mark.parametrize(
    ("before", "behind", "period", "width"), list(itertools.product([0, 1, 2], [0, 1], [np.inf, TURN], [1, 2, 3]))
)
def test_a_vector_between_samples_is_that_by_numpy(before: int, behind: int, period: float, width: int) -> None:
    rng = np.random.default_rng(RNG_SEED)
    start_ns = 1_700_000_000_000_000_000
    times_ns = start_ns + np.array([0, 11, 20, 29, 41])[2 - before : 4 + behind] * 10_000_000
    vectors = rng.uniform(-3.0, 3.0, (len(times_ns), width))
    left, time_ns = before, int(times_ns[before]) + 37_000_000
    seconds = (times_ns - times_ns[left]) * 1e-9
    steps = short(np.diff(vectors, axis=0), period)
    changes = np.vstack([np.zeros(width), np.cumsum(steps, axis=0)])
    changes -= changes[left]
    fraction = 0.037 / seconds[left + 1]
    value0, slope0, value1, slope1 = weights = hermite_weights(fraction)
    first, last = max(left - 1, 0), min(left + 2, len(times_ns) - 1)
    of_first, of_last = np.zeros(len(times_ns)), np.zeros(len(times_ns))
    of_first[[first, left + 1]] = np.array([-1.0, 1.0]) * seconds[left + 1] / (seconds[left + 1] - seconds[first])
    of_last[[left, last]] = np.array([-1.0, 1.0]) * seconds[left + 1] / (seconds[last] - seconds[left])
    by_sample = slope0 * of_first + slope1 * of_last
    by_sample[left] += value0
    by_sample[left + 1] += value1
    change = by_sample @ changes
    around = [left, left + 1, *range(left - 1, max(left - 2, -1), -1), *range(left + 2, last + 1)]
    around += [0] if before == 2 else []
    off = errors(seconds[around] / seconds[left + 1], changes[around], fraction, change)
    share = NEXT_TERM_SHARE if len(times_ns) == MOST_SAMPLES else 1.0
    found = compiled_tracks.interpolate_vector(
        times_ns, vectors, left, time_ns, period, *weights, share, ANY_DIRECTION
    )
    equal(found[0], vectors[left] + change)
    equal(found[1], float(by_sample @ by_sample))
    equal(found[2], as_covariance(off))


@pytest.mark.parametrize("left", [-1, 3])
def test_an_interval_that_is_not_there_is_refused(left: int) -> None:
    """The compiled loops do not check bounds, so the function checks the interval."""
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_tracks.interpolate_vector(
            np.arange(4), np.zeros((4, 2)), left, 0, np.inf, *hermite_weights(0.5), NEXT_TERM_SHARE, ANY_DIRECTION
        )


def test_samples_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit together"):
        compiled_tracks.interpolate_vector(
            np.arange(3), np.zeros((4, 2)), 1, 0, np.inf, *hermite_weights(0.5), NEXT_TERM_SHARE, ANY_DIRECTION
        )
    with pytest.raises(ValueError, match="do not fit together"):
        polynomial_errors(np.arange(4.0), np.zeros((3, 2)), 0.5, np.zeros(2))
    with pytest.raises(ValueError, match="do not fit together"):
        polynomial_errors(np.arange(3.0), np.zeros((3, 2)), 0.5, np.zeros(3))

"""Compiled checks of an INS against the same in plain numpy, and single samples against blocks.

"Equal" is 1e-13 relative; a block gives the results of its single samples to the last bit.
"""

import itertools
import math

import numpy as np
import pytest

from ship_geometry.earth.time_scales import SECOND_NS
from ship_kernels import compiled_checks

COUNT = 50


def rates(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (ns) and rates (rad/s) of samples at about 100 Hz; the first sample is before the block."""
    times_ns = np.cumsum(rng.integers(5_000_000, 15_000_000, COUNT + 1))
    return times_ns, 0.1 * rng.standard_normal((COUNT + 1, 3))


def test_rotation_steps_and_their_error_equal_numpy() -> None:
    rng = np.random.default_rng(1)
    (times_ns, rate), drift = rates(rng), 1e-5 * rng.standard_normal(3)
    turns, missed = compiled_checks.rotation_steps(
        times_ns[1:], rate[1:], times_ns[0], rate[0], 0.5, 2.0 * drift, SECOND_NS
    )
    seconds = np.diff(times_ns)[:, None] * 1e-9
    np.testing.assert_allclose(turns, seconds * (0.5 * (rate[1:] + rate[:-1]) - drift), rtol=1e-12)
    # A quarter of the change of the rate, plus the error of the mean rate for a wave with a period of four seconds.
    share = (2.0 * np.pi * seconds / 4.0) ** 2 / 12.0
    change, mean = np.diff(rate, axis=0), 0.5 * (rate[1:] + rate[:-1])
    norms = 0.25 * np.linalg.norm(change, axis=1) + share[:, 0] * np.linalg.norm(mean, axis=1)
    np.testing.assert_allclose(missed, 0.5 + np.cumsum(seconds[:, 0] * norms), rtol=1e-13)


def test_rotation_step_does_not_depend_on_the_block() -> None:
    rng = np.random.default_rng(2)
    (times_ns, rate), zero = rates(rng), np.zeros(3)
    turns, missed = compiled_checks.rotation_steps(times_ns[1:], rate[1:], times_ns[0], rate[0], 0.0, zero, SECOND_NS)
    so_far = 0.0
    for n in range(COUNT):
        one = slice(n + 1, n + 2)
        turn, now = compiled_checks.rotation_steps(
            times_ns[one], rate[one], times_ns[n], rate[n], so_far, zero, SECOND_NS
        )
        assert turn[0].tobytes() == turns[n].tobytes()
        assert now[0] == missed[n]
        so_far = float(now[0])


@pytest.mark.parametrize("fault", ["gap", "back", "nan"])
def test_integration_error_is_infinite_from_a_gap_on(fault: str) -> None:
    times_ns, rate = rates(np.random.default_rng(3))
    if fault == "gap":
        times_ns[21:] += SECOND_NS
    elif fault == "back":
        times_ns[21] = times_ns[20]
    else:
        rate[21, 1] = np.nan
    _, missed = compiled_checks.rotation_steps(
        times_ns[1:], rate[1:], times_ns[0], rate[0], 0.0, np.zeros(3), SECOND_NS
    )
    assert np.isfinite(missed).tolist() == [True] * 20 + [False] * (COUNT - 20)


def test_step_sizes_equal_numpy() -> None:
    rng = np.random.default_rng(4)
    weights, rows = rng.standard_normal((6, 30)), rng.standard_normal((30, 3))
    steps = weights @ rows
    np.testing.assert_allclose(compiled_checks.step_sizes(weights, rows), np.sum(steps * steps, axis=1), rtol=1e-12)


@pytest.mark.parametrize(("learns", "first_rad"), [(40, math.inf), (40, 0.3), (100, math.inf), (300, 0.3)])
def test_bounds_use_the_larger_of_configured_and_estimated_noise(learns: int, first_rad: float) -> None:
    rng = np.random.default_rng(5)
    weights, least, shares = rng.standard_normal((4, 30)), rng.uniform(0.1, 1.0, 4), rng.uniform(0.5, 2.0, 4)
    high, bounds, scaled = rng.uniform(0.0, 0.1, 6) ** 8, np.empty(4), np.empty((4, 30))
    is_first_checked = compiled_checks.set_bounds(
        weights, least, shares, high, learns, 0.01, 0.02, first_rad, bounds, scaled
    )
    expected = np.maximum(least, 3.10 * high[:4] ** 0.125 * shares) + 0.01 + 0.02
    if learns < 64 and first_rad < math.inf:
        expected[0] = max(expected[0], first_rad)
    if learns < 250:
        expected[1 if is_first_checked else 0 :] += 10.0
    assert is_first_checked == (learns >= 64 or first_rad < math.inf)
    np.testing.assert_allclose(bounds, expected, rtol=1e-13)
    np.testing.assert_allclose(scaled, weights / expected[:, None], rtol=1e-13)


@pytest.mark.parametrize("learns", [3, 4000])
def test_statistics_are_means_of_eighth_powers_of_steps(learns: int) -> None:
    rng = np.random.default_rng(6)
    sizes, bounds, high = rng.uniform(0.0, 1.0, (3, 4))
    expected = high + ((sizes * bounds**2) ** 4 - high) / min(learns, 1500)
    compiled_checks.learn(sizes, bounds, learns, high)
    np.testing.assert_allclose(high, expected, rtol=1e-13)


def test_arrays_that_do_not_fit_are_refused() -> None:
    times_ns, rate = rates(np.random.default_rng(5))
    with pytest.raises(ValueError, match="rates"):
        compiled_checks.rotation_steps(times_ns, rate[1:], 0, rate[0], 0.0, np.zeros(3), SECOND_NS)
    with pytest.raises(ValueError, match="rows"):
        compiled_checks.step_sizes(np.ones((2, 5)), np.ones((4, 3)))
    with pytest.raises(ValueError, match="rates"):
        compiled_checks.mean_rate_error(np.zeros(2), np.zeros(3), 1.0)


@pytest.mark.parametrize("rows", [1, 3, 8])
def test_changes_equal_numpy_and_do_not_depend_on_the_block(rows: int) -> None:
    values = np.random.default_rng(rows).standard_normal((COUNT + 1, rows, 3))
    values[7, 0, 1] = np.nan
    found = compiled_checks.changes(values[0], values[1:])
    expected = np.linalg.norm(np.diff(values, axis=0), axis=2).max(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    assert np.isnan(found).tolist() == [number in (6, 7) for number in range(COUNT)]
    alone = [compiled_checks.changes(before, value[None])[0] for before, value in itertools.pairwise(values)]
    np.testing.assert_array_equal(alone, found)
    with pytest.raises(ValueError, match="values"):
        compiled_checks.changes(values[0, :, :2], values)

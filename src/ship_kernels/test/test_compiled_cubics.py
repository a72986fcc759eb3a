"""Compiled least-squares cubics against numpy's pseudoinverse and QR; equal to 1e-11 of about one."""

import numpy as np
import pytest

from ship_kernels import compiled_tracks

BEFORE = 5


def times_before(count: int) -> np.ndarray:
    steps = np.random.default_rng(count).uniform(0.8, 1.2, count)
    return -np.cumsum(steps)[::-1] / steps.sum()


@pytest.mark.parametrize("count", [4, 7, 12])
def test_weights_at_zero(count: int) -> None:
    since = times_before(count)
    expected = np.linalg.pinv(np.vander(since, 4, increasing=True))[0]
    found = compiled_tracks.weights_at_zero(since)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("step_m", [0.0, 0.3])
@pytest.mark.parametrize("count", [8, 14])
def test_the_clearest_step(count: int, step_m: float) -> None:
    rng, since = np.random.default_rng(3), times_before(count)
    values = np.vander(since, 4) @ rng.standard_normal((4, 3)) + 0.01 * rng.standard_normal((count, 3))
    values[6:] += step_m
    smooth = np.linalg.qr(np.vander(since, 4))[0]
    after = np.arange(count)[:, None] >= np.arange(BEFORE, count)
    left, steps = (one - smooth @ (smooth.T @ one) for one in (values, after))
    weight = np.sum(steps**2, axis=0)
    jumps = steps.T @ left / weight[:, None]
    explained = weight * np.sum(jumps**2, axis=1)
    best = int(np.argmax(explained))
    place, jump, of_place, squares = compiled_tracks.clearest_step(since, values, BEFORE)
    assert place == BEFORE + best
    assert not step_m or place == 6
    np.testing.assert_allclose(jump, jumps[best], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose([of_place, squares], [weight[best], np.sum(left**2) - explained[best]], rtol=1e-11)


def test_mismatched_shapes_are_refused() -> None:
    for count, rows in ((8, 7), (5, 5)):
        with pytest.raises(ValueError, match="vectors"):
            compiled_tracks.clearest_step(times_before(count), np.zeros((rows, 3)), BEFORE)
    with pytest.raises(ValueError, match="times"):
        compiled_tracks.weights_at_zero(times_before(3))

"""The compiled axis geometry of a mount on a ship against plain numpy and finite differences.

"Equal" allows a difference of 1e-13, in radians or without a unit; covariances are of unit size.
"""

from typing import Any

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation
from ship_kernels import compiled_pointing

RNG_SEED = 11
X, Y, Z = np.eye(3)
COUNT, SOURCES = 9, 5
SHIP, BENDING, ENCODER, WHITE = 3, 0, 1, 4


def equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def drawn_states(count: int = COUNT) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors of all sizes from none to a few degrees, attitudes, rates, and readings of both faces."""
    rng = np.random.default_rng(RNG_SEED)
    errors = rng.uniform(-0.05, 0.05, (count, 14)) * np.resize([1.0, 0.0, 1e-5, 1e-3], count)[:, None]
    angles = np.stack([rng.uniform(0.0, 6.3, count), rng.uniform(-0.2, 3.3, count)], axis=-1)
    return errors, exp_rotation(rng.uniform(-2.0, 2.0, (count, 3))), rng.standard_normal((count, 3)), angles


def main_frame(errors: FloatArray, rotation: FloatArray, rate: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the main frame in the horizon by the formula in the docstring of ``compiled_pointing``."""
    g, h, c, tilt, beta_x, beta_y, flexure, time_s = errors[6:]
    azimuth, elevation = angles
    axes = exp_rotation(np.array([beta_y, 0.0, -beta_x])) @ exp_rotation(-(azimuth - g) * Y) @ exp_rotation(-tilt * X)
    raised = elevation - h + flexure * np.cos(elevation)
    axes = axes @ exp_rotation(raised * Z) @ exp_rotation(c * Y)
    ship = exp_rotation(errors[:3]) @ rotation @ exp_rotation(-time_s * rate)
    frame: FloatArray = ship @ exp_rotation(errors[3:6]) @ axes
    return frame


def test_axis_geometry_is_the_product_of_its_rotations() -> None:
    rotation_nd, rotation_dm, rotation_nm, _, _ = compiled_pointing.axis_geometries(*drawn_states())
    for number, (errors, rotation, rate, angles) in enumerate(zip(*drawn_states(), strict=True)):
        equal(rotation_nm[number], main_frame(errors, rotation, rate, angles))
        equal(rotation_nd[number], exp_rotation(errors[:3]) @ rotation @ exp_rotation(-errors[13] * rate))
        equal(rotation_nd[number] @ rotation_dm[number], rotation_nm[number])


def test_derivatives_equal_finite_differences() -> None:
    *_, by_error, by_encoder = compiled_pointing.axis_geometries(*drawn_states())
    step = 1e-6
    for number, (errors, rotation, rate, angles) in enumerate(zip(*drawn_states(), strict=True)):
        for column in range(14):
            up, down = errors + step * np.eye(14)[column], errors - step * np.eye(14)[column]
            ends = [main_frame(moved, rotation, rate, angles) for moved in (up, down)]
            expected = log_rotation(ends[0] @ ends[1].T) / (2.0 * step)
            np.testing.assert_allclose(by_error[number, :, column], expected, rtol=0, atol=1e-8)
        for column in range(2):
            up, down = angles + step * np.eye(2)[column], angles - step * np.eye(2)[column]
            ends = [main_frame(errors, rotation, rate, moved) for moved in (up, down)]
            expected = log_rotation(ends[0] @ ends[1].T) / (2.0 * step)
            np.testing.assert_allclose(by_encoder[number, :, column], expected, rtol=0, atol=1e-8)


def readings(size: int) -> tuple[list[FloatArray], tuple[Any, ...]]:
    """Return the arguments of ``pointings``: arrays with one row for each reading, and the values of the estimate."""
    rng = np.random.default_rng(RNG_SEED)
    errors, rotations, rates, angles = drawn_states()
    roots = rng.standard_normal((COUNT, 3, 3))
    of_each = [rng.integers(-(10**8), 2 * 10**9, COUNT), rotations, rates, rng.random(COUNT), angles, rng.random(COUNT)]
    of_each += [rng.uniform(0.3, 1.0, (COUNT, 3)), roots @ roots.swapaxes(1, 2)]
    of_states, of_steady = rng.standard_normal((SOURCES, size, size)), rng.standard_normal((2, 3, 3))
    exceeds_model = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)
    parts, steady = of_states @ of_states.swapaxes(1, 2), of_steady @ of_steady.swapaxes(1, 2)
    time_s = rng.uniform(1.0, 5.0, 6)
    return of_each, (errors[0], exceeds_model, time_s, steady, parts, SHIP, BENDING, ENCODER, WHITE)


@pytest.mark.parametrize("size", [13, 14])
def test_pointings_are_corrected_as_by_numpy(size: int) -> None:
    of_each, estimate = readings(size)
    errors, exceeds_model, time_s, steady, parts, *_ = estimate
    rotation_nm, by_error, found = compiled_pointing.pointings(*of_each, *estimate)
    for number, (since_ns, rotation, rate, white, angles, noise, kept, new) in enumerate(zip(*of_each, strict=True)):
        decay, left = np.ones(size), np.ones(size)
        decay[:6], left[:3] = np.exp(-1e-9 * max(since_ns, 0) / time_s), kept
        now = errors.copy()
        now[:6] *= np.where(exceeds_model, 1.0, decay[:6])
        now[:3] *= kept
        chain = compiled_pointing.axis_geometries(now[None], rotation[None], rate[None], angles[None])
        by_all, by_encoder = chain[3][0][:, :size], chain[4][0]
        equal(rotation_nm[number], chain[2][0])
        equal(by_error[number], by_all)
        propagated = parts * np.outer(decay, decay)
        propagated[SHIP, :3, :3] += (1.0 - np.outer(decay[:3], decay[:3])) * steady[0]
        propagated[BENDING, 3:6, 3:6] += (1.0 - np.outer(decay[3:6], decay[3:6])) * steady[1]
        propagated *= np.outer(left, left)
        propagated[SHIP, :3, :3] += new
        expected = by_all @ propagated @ by_all.T
        expected[ENCODER] += noise * by_encoder @ by_encoder.T
        expected[WHITE] += white * np.eye(3)
        np.testing.assert_allclose(found[number], expected, rtol=1e-13, atol=1e-12)


def test_full_remaining_share_without_added_covariance_changes_nothing() -> None:
    (of_each, estimate), nothing = readings(13), (np.empty((0, 3)), np.empty((0, 3, 3)))
    all_left = compiled_pointing.pointings(*of_each[:6], np.ones((COUNT, 3)), np.zeros((COUNT, 3, 3)), *estimate)
    for found, expected in zip(compiled_pointing.pointings(*of_each[:6], *nothing, *estimate), all_left, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_totals_equal_numpy_with_a_covariance_added_to_one_source() -> None:
    of_each, estimate = readings(14)
    _, by_error, parts = compiled_pointing.pointings(*of_each, *estimate)
    root, added = np.random.default_rng(RNG_SEED).standard_normal((14, 14)), np.arange(COUNT, dtype=np.uint8) % 2
    expected = parts.copy()
    expected[:, 2] += added[:, None, None] * (by_error @ (root @ root.T) @ by_error.swapaxes(1, 2))
    before_expected = parts.sum(axis=1)
    before, after = compiled_pointing.totals(parts, by_error, root @ root.T, added, 2)
    for found, by_numpy in ((before, before_expected), (after, expected.sum(axis=1)), (parts, expected)):
        np.testing.assert_allclose(found, by_numpy, rtol=1e-13, atol=1e-12)
    np.testing.assert_array_equal(before[::2], after[::2])


def test_result_does_not_depend_on_the_block() -> None:
    of_each, estimate = readings(13)
    together = compiled_pointing.pointings(*of_each, *estimate)
    chains = compiled_pointing.axis_geometries(*drawn_states())
    for number in range(COUNT):
        one = slice(number, number + 1)
        alone = compiled_pointing.pointings(*(values[one] for values in of_each), *estimate)
        alone += compiled_pointing.axis_geometries(*(values[one] for values in drawn_states()))
        for single, among_others in zip(alone, (*together, *chains), strict=True):
            np.testing.assert_array_equal(single[0], among_others[number])


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The compiled loops do not check bounds, so the functions check shapes."""
    of_each, estimate = readings(13)
    parts = np.zeros((2, 3, 3, 3))
    calls = [
        lambda: compiled_pointing.axis_geometries(np.zeros((COUNT, 13)), *drawn_states()[1:]),
        lambda: compiled_pointing.axis_geometries(drawn_states()[0][:3], *drawn_states()[1:]),
        lambda: compiled_pointing.pointings(of_each[0][:3], *of_each[1:], *estimate),
        lambda: compiled_pointing.pointings(*of_each, *estimate[:-1], SOURCES),
        lambda: compiled_pointing.pointings(*of_each[:7], np.empty((0, 3, 3)), *estimate),
        lambda: compiled_pointing.pointings(*of_each[:7], np.zeros((COUNT, 3, 2)), *estimate),
        lambda: compiled_pointing.pointings(*of_each, *estimate[:4], np.zeros((SOURCES, 12, 12)), *estimate[5:]),
        lambda: compiled_pointing.totals(parts, np.zeros((2, 3, 4)), np.eye(5), np.zeros(2, dtype=np.uint8), 0),
        lambda: compiled_pointing.totals(parts, np.zeros((2, 3, 4)), np.eye(4), np.zeros(2, dtype=np.uint8), 3),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="do not fit together"):
            call()

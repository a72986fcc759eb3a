"""The compiled single rotations against those of arrays, finite differences and plain numpy.

"Equal" allows a difference of 1e-13, in radians or without a unit. Rounding of a product of a few rotations is a
hundredth of this difference.
"""

import numpy as np
import pytest

from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian, log_rotation
from ship_geometry.tracks.interpolation_error import ANY_DIRECTION, NEXT_TERM_SHARE, as_covariance
from ship_geometry.tracks.sample_track import hermite_weights
from ship_kernels import compiled_rotations

RNG_SEED = 5
SIZES = [0.0, 1e-9, 0.99e-4, 1.01e-4, 0.01, 1.0, 2.5, 3.1]
"""Angles, rad: zero, below 1e-4 (computed by a series), on both sides of 1e-4, above it, and near half a turn."""


def vectors(count: int) -> FloatArray:
    rng = np.random.default_rng(RNG_SEED)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return directions * np.resize(SIZES, count)[:, None]


def equal(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("function", [exp_rotation, left_jacobian])
def test_one_vector_gives_what_an_array_gives(function) -> None:
    found = vectors(40)
    equal(np.array([function(vector) for vector in found]), function(found))


def test_one_matrix_gives_what_an_array_gives() -> None:
    rotations = exp_rotation(vectors(40))
    single = np.array([log_rotation(rotation) for rotation in rotations])
    np.testing.assert_allclose(single, log_rotation(rotations), rtol=0, atol=1e-12)
    np.testing.assert_allclose(single, vectors(40), rtol=0, atol=1e-12)


def test_views_that_are_not_contiguous_are_read_as_they_are() -> None:
    rotation = exp_rotation(np.array([0.3, -0.2, 0.5]))
    equal(log_rotation(rotation.T), -log_rotation(rotation))
    equal(exp_rotation(np.array([0.3, 9.0, -0.2, 9.0, 0.5, 9.0])[::2]), rotation)


def test_composed_attitude_is_the_product_with_derivatives_of_small_steps() -> None:
    """Four links: a base that rotates between two clocks follows the third link; the fourth link has a factor of
    0.7."""
    rng = np.random.default_rng(RNG_SEED)
    links, fixed, base = np.array([9, 3, 0, 6]), exp_rotation(vectors(9)[5:]), exp_rotation(np.array([0.3, -1.0, 0.2]))
    mean, rate, signs, root = np.zeros(14), rng.standard_normal(3), np.array([1.0, -1.0]), rng.standard_normal((3, 3))
    mean[:12] = 0.2 * vectors(4).ravel()
    hull, clocks, error = 2, np.array([13, 12]), root @ root.T

    def product(states: FloatArray) -> FloatArray:
        rotation = np.eye(3)
        for number, (link, left) in enumerate(zip(links, fixed, strict=True)):
            turn = exp_rotation((0.7 if number == 3 else 1.0) * states[link : link + 3])
            rotation = left @ turn @ rotation
            if number == hull:
                rotation = base @ exp_rotation((states[13] - states[12]) * rate) @ rotation
        return rotation

    found = compiled_rotations.composed_attitude(mean, links, fixed, hull, 3, 0.7, clocks, signs, base, rate, error)
    equal(found[0], product(mean))
    step = 1e-6 * np.eye(14)
    small = [log_rotation(product(mean - by).T @ product(mean + by)) / 2e-6 for by in step]
    np.testing.assert_allclose(found[1].T, small, rtol=0, atol=1e-8)
    below = np.eye(3)
    for link, left in zip(links[: hull + 1], fixed, strict=False):
        below = left @ exp_rotation(mean[link : link + 3]) @ below
    equal(found[2], below.T @ error @ below)


def test_the_turn_between_two_attitudes_is_the_logarithm_of_their_quotient() -> None:
    first, second = exp_rotation(np.array([0.3, -1.0, 0.2])), exp_rotation(vectors(16))
    expected = log_rotation(first.T @ second)
    np.testing.assert_allclose([compiled_rotations.turn_between(first, one) for one in second], expected, atol=1e-12)


def test_cumulative_rotations_apply_one_vector_after_another() -> None:
    start, turns = exp_rotation(np.array([0.3, -0.2, 0.5])), vectors(40)
    reached = compiled_rotations.cumulative_rotations(start, turns)
    expected = start
    for turn, found in zip(exp_rotation(turns), reached, strict=True):
        expected = expected @ turn
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    (alone,) = compiled_rotations.cumulative_rotations(reached[6], turns[7:8])
    assert alone.tobytes() == reached[7].tobytes()


def test_differences_are_logarithms() -> None:
    rotations, others = exp_rotation(0.2 * vectors(40)), exp_rotation(0.3 * vectors(45)[5:])
    turn = others[0] @ rotations[0].T
    found = compiled_rotations.differences(rotations, others, turn)
    expected = log_rotation(rotations @ others.swapaxes(1, 2) @ turn)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    alone = [
        compiled_rotations.differences(rotations[n : n + 1], others[n : n + 1], turn)[0] for n in range(len(others))
    ]
    assert np.array(alone).tobytes() == found.tobytes()


@pytest.mark.parametrize("at", [1e-3, 0.3, 0.9])
def test_between_two_attitudes_lies_the_cubic_with_their_rates(at: float) -> None:
    """The reference is Hermite's cubic by numpy; small steps along the cubic give its rate."""
    first, turn, interval_s = exp_rotation(np.array([0.4, -1.0, 0.3])), np.array([0.02, -0.03, 0.05]), 0.2
    start_rate, end_rate = np.array([0.3, -0.1, 0.2]), np.array([0.0, -0.2, 0.4])
    end_slope = np.linalg.solve(left_jacobian(turn).T, end_rate * interval_s)

    def vector(s: float) -> FloatArray:
        by_start, by_end = s * (1.0 - s) ** 2 * interval_s * start_rate, s * s * (s - 1.0) * end_slope
        return by_start + s * s * (3.0 - 2.0 * s) * turn + by_end

    found = compiled_rotations.cubic(first, turn, start_rate, end_rate, interval_s, at)
    step = 1e-4
    ahead, behind = (exp_rotation(vector(at + s)) for s in (step, -step))
    equal(found[0], first @ exp_rotation(vector(at)))
    np.testing.assert_allclose(found[1], log_rotation(behind.T @ ahead) / (2.0 * step * interval_s), rtol=0, atol=1e-7)
    equal(found[2], vector(at))


@pytest.mark.parametrize("at", [1e-3, 0.3, 0.9])
@pytest.mark.parametrize("other_at", [0.0, -0.7])
@pytest.mark.parametrize("largest", [1e-6, 10.0])
def test_error_of_the_cubic_is_estimated(at: float, other_at: float, largest: float) -> None:
    """The error by numpy: the difference at another sample, scaled by t² (1 - t)², and the cubic's third derivative."""
    first, second, other = exp_rotation(np.array([[0.4, -1.0, 0.3], [0.45, -0.9, 0.5], [0.2, -1.1, 0.3]]))
    first_rate, second_rate, interval_s = np.array([0.3, -0.1, 0.2]), np.array([0.0, -0.2, 0.4]), 0.2
    turn, to_other = log_rotation(first.T @ second), log_rotation(first.T @ other)
    start, end = first_rate * interval_s, np.linalg.solve(left_jacobian(turn).T, second_rate * interval_s)
    bound = (6.0 * (start + end) - 12.0 * turn) * (at * (1.0 - at)) ** 2 / 24.0
    _, by_start, by_turn, by_end = hermite_weights(other_at)
    miss = to_other - (by_start * start + by_turn * turn + by_end * end)
    errors = [bound]
    if other_at:
        errors = [miss * (at * (1.0 - at) / (other_at * (1.0 - other_at))) ** 2, 0.5 * NEXT_TERM_SHARE * bound]
    arguments = first, second, other, first_rate, second_rate, interval_s, at, other_at
    found = compiled_rotations.interpolate_attitude(*arguments, NEXT_TERM_SHARE, ANY_DIRECTION, largest)
    rotation, rate, _ = compiled_rotations.cubic(first, turn, first_rate, second_rate, interval_s, at)
    equal(found[0], rotation)
    equal(found[1], rate)
    by_first, _, by_second, _ = hermite_weights(at)
    equal(np.array(found[2]), np.array(by_first**2 + by_second**2))
    equal(found[3], np.array(errors))
    equal(found[4], as_covariance(errors, largest))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_propagation_by_rates_equals_numpy(count: int) -> None:
    """Two to four rates, at uneven steps; docs/explanation/interpolation.md has the formulas."""
    rng = np.random.default_rng(RNG_SEED)
    rotation, rates = exp_rotation(np.array([0.1, 0.7, -0.2])), rng.standard_normal((count, 3))
    steps_s = rng.uniform(0.05, 0.15, count - 1)
    ahead_s, any_direction, largest = -0.07, 0.3, 1e-9
    changes = (rates[:-1] - rates[1:]) / steps_s[:, None]
    jerks = changes / steps_s[0]
    if count > 2:
        jerks = (changes[:-1] - changes[1:]) * (2.0 / (steps_s[:-1] + steps_s[1:]))[:, None]
    rows = (ahead_s**3 / 6.0 + ahead_s**2 * steps_s[0] / 4.0) / np.sqrt(len(jerks)) * jerks
    covariance = rows.T @ rows + any_direction**2 * np.sum(rows**2) * np.eye(3)
    sample = rotation[None], rates[None], steps_s[None], np.array([ahead_s])
    found = [of_one[0] for of_one in compiled_rotations.propagate_by_rates(*sample, any_direction, largest)]
    equal(found[0], rotation @ exp_rotation(ahead_s * rates[0] + 0.5 * ahead_s**2 * changes[0]))
    equal(found[1], rates[0] + ahead_s * changes[0])
    assert np.sum(rows**2) > largest
    equal(found[2] / largest, covariance / np.sum(rows**2))
    equal(compiled_rotations.propagate_by_rates(*sample, any_direction, 1.0)[2][0], covariance)


def test_propagation_does_not_depend_on_the_block() -> None:
    rng = np.random.default_rng(RNG_SEED)
    rates, steps_s, ahead_s = rng.standard_normal((9, 4, 3)), rng.uniform(0.01, 0.1, (9, 3)), rng.normal(size=9)
    samples = exp_rotation(vectors(9)), rates, steps_s, ahead_s
    together = compiled_rotations.propagate_by_rates(*samples, 0.3, 1e-3)
    for number in range(9):
        alone = compiled_rotations.propagate_by_rates(*(values[number : number + 1] for values in samples), 0.3, 1e-3)
        for one, among_others in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], among_others[number])


def test_corrected_attitudes_equal_numpy() -> None:
    """Five estimates correct fifty samples; some error components of the estimates do not decay.

    All values are near one.
    """
    rng = np.random.default_rng(RNG_SEED)
    count, sources, estimates = 50, 4, 5
    by = rng.integers(estimates, size=count)
    since_s, rotations, rates = rng.uniform(0.0, 3.0, count), exp_rotation(vectors(count)), rng.normal(size=(count, 3))
    gains, roots = rng.uniform(0.5, 1.0, count), rng.standard_normal((count, 3, 3))
    own_errors = roots @ roots.transpose(0, 2, 1)
    errors, time_s, steady, white = 0.3 * rng.standard_normal((estimates, 3)), *rng.uniform(1.0, 2.0, (3, 3))
    exceeds_model = rng.integers(2, size=(estimates, 3), dtype=np.uint8)
    parts = rng.standard_normal((estimates, sources, 4, 4))
    parts = parts @ parts.swapaxes(-1, -2)
    found = compiled_rotations.corrected_attitudes(
        by, since_s, rotations, rates, gains, own_errors, errors, exceeds_model, time_s, steady, white, parts, 0, 2, 3
    )
    decay = np.exp(-since_s[:, None] / time_s)
    now = np.where(exceeds_model[by], errors[by], decay * errors[by])
    attitudes = exp_rotation(now) @ rotations
    by_error = left_jacobian(now)
    by_clock = -(attitudes @ rates[..., None])
    by_state = np.concatenate([by_error * decay[:, None], by_clock], axis=-1)[:, None]
    expected = by_state @ parts[by] @ by_state.swapaxes(-1, -2)
    drift = by_error * np.sqrt(steady * (1.0 - decay**2))[:, None]
    expected[:, 0] += drift @ drift.swapaxes(-1, -2)
    noise = exp_rotation(now) * np.sqrt(white * gains[:, None])[:, None]
    expected[:, 2] += noise @ noise.swapaxes(-1, -2)
    expected[:, 3] += attitudes @ own_errors @ attitudes.swapaxes(-1, -2)
    equal(found[0], attitudes)
    np.testing.assert_allclose(found[1], expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def call_composed_attitude(links: FloatArray, fixed: FloatArray, clocks: FloatArray) -> None:
    """Call ``composed_attitude`` with seven states and a base at rest."""
    base, rate = np.eye(3), np.zeros(3)
    compiled_rotations.composed_attitude(np.zeros(7), links, fixed, 0, 0, 1.0, clocks, np.ones(1), base, rate, base)


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The compiled loops do not check bounds, so the functions check shapes."""
    calls = [
        lambda: exp_rotation(np.zeros(2)),
        lambda: left_jacobian(np.zeros(4)),
        lambda: log_rotation(np.eye(2)),
        lambda: call_composed_attitude(np.array([0, 3]), np.zeros((3, 3, 3)), np.array([6])),
        lambda: call_composed_attitude(np.array([0, 5]), np.zeros((2, 3, 3)), np.array([6])),
        lambda: call_composed_attitude(np.array([0, 3]), np.zeros((2, 3, 3)), np.array([7])),
        lambda: compiled_rotations.turn_between(np.eye(3), np.eye(2)),
        lambda: compiled_rotations.propagate_by_rates(
            np.eye(3)[None], np.zeros((1, 1, 3)), np.zeros((1, 0)), np.zeros(1), 0.3, 1.0
        ),
        lambda: compiled_rotations.cubic(np.eye(3), np.zeros(3), np.zeros(2), np.zeros(3), 0.1, 0.5),
        lambda: compiled_rotations.interpolate_attitude(
            np.eye(3), np.eye(3), np.eye(2), np.zeros(3), np.zeros(3), 0.1, 0.5, 0.0, 0.5, 0.3, 1.0
        ),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="do not fit together"):
            call()

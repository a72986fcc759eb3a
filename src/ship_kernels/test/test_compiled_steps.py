"""The compiled steps against the same formulas in plain numpy and LAPACK.

"Equal" is 1e-13 of the largest number of an array. Two orders of summation may differ by this in well-conditioned
cases, as here.
"""

import numpy as np
import pytest

from ship_estimation.fault_detection.subfilters import (
    FilterInnovations,
    add_error,
    filter_covariances,
    subfilter_innovations,
    update_subfilters,
)
from ship_estimation.kalman.kalman_filter import (
    LinearMeasurement,
    StateModel,
    block,
    propagate_correlated_error,
    propagate_covariance,
)
from ship_kernels import compiled_kalman

SHAPES = [(1, 1, 1, 1), (4, 2, 2, 1), (19, 3, 7, 1), (19, 3, 7, 4), (23, 16, 7, 4), (9, 24, 3, 3)]
"""Numbers of states, residuals, sources, filters: two small cases, a ship without and with subfilters, single stars,
many residuals."""


def equal(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * max(np.abs(expected).max(), 1e-300))


def case(
    shape: tuple[int, int, int, int], seed: int = 1
) -> tuple[np.ndarray, np.ndarray, LinearMeasurement, np.ndarray]:
    """A stack, means, a measurement that does not depend on a third of the states, and its rotation Jacobian."""
    states, residuals, sources, filters = shape
    rng = np.random.default_rng(seed)
    roots = rng.standard_normal((sources + filters - 1, states, 2 * states))
    stack = roots @ roots.transpose(0, 2, 1)
    jacobian = rng.standard_normal((residuals, states)) * (np.arange(states) % 3 != 2)
    root = rng.standard_normal((residuals, residuals))
    noise = {0: 20.0 * np.eye(residuals), sources - 1: root @ root.T + np.eye(residuals)}
    measured = LinearMeasurement(rng.standard_normal(residuals), jacobian, noise)
    return stack, rng.standard_normal((filters, states)), measured, rng.standard_normal((residuals, 3))


def numpy_innovations(
    means: np.ndarray, covariance: np.ndarray, measured: LinearMeasurement, at_mean: np.ndarray, by_turn: np.ndarray
) -> FilterInnovations:
    h, noise = measured.jacobian, measured.noise
    residual = measured.residual - (means - at_mean) @ h.T
    cross = covariance @ h.T
    innovation = h @ cross + noise
    gain = np.linalg.solve(innovation, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
    nis = np.einsum("hm,hm->h", residual, np.linalg.solve(innovation, residual[:, :, None])[:, :, 0])
    weighted = np.linalg.solve(innovation, np.broadcast_to(by_turn, (len(means), *by_turn.shape)))
    values, vectors = np.linalg.eigh(by_turn.T @ weighted)
    scale = 1.0 / np.sqrt(np.where(values > 1e-9 * values[:, -1:], values, np.inf))
    root = (vectors * scale[:, None]) @ vectors.transpose(0, 2, 1)
    turn = np.einsum("hij,hmj,hm->hi", root, weighted, residual)
    weights = root[0] @ weighted[0].T
    return FilterInnovations(residual, innovation, nis, gain, turn, weights @ noise @ weights.T, root)


def numpy_update(
    stack: np.ndarray, measured: LinearMeasurement, compared: FilterInnovations, learns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    filters, states = learns.shape
    sources = len(stack) - filters + 1
    updated = np.empty_like(stack)
    gain = compared.gain * learns[:, :, None]
    for index, covariance in enumerate(stack):
        filter_index = max(index - sources + 1, 0)
        keep = np.eye(states) - gain[filter_index] @ measured.jacobian
        noise = measured.noise if filter_index else measured.noise_by_source.get(index, np.zeros_like(measured.noise))
        updated[index] = keep @ covariance @ keep.T + gain[filter_index] @ noise @ gain[filter_index].T
    return np.einsum("hnm,hm->hn", gain, compared.residual), updated


@pytest.mark.parametrize("shape", SHAPES)
def test_predicted_covariances_equal_numpy(shape: tuple[int, int, int, int]) -> None:
    stack, _, _, _ = case(shape)
    states, _, sources, filters = shape
    rng = np.random.default_rng(2)
    decay, noise, source_of = rng.uniform(size=states), rng.uniform(size=states), rng.integers(0, sources, states)
    expected = stack * decay[:, None] * decay
    for state, source in enumerate(source_of):
        expected[[source, *range(sources, len(stack))], state, state] += noise[state]
    equal(propagate_covariance(stack, decay, noise, source_of, filters), expected)
    total = stack[:sources].sum(axis=0)
    equal(filter_covariances(stack, filters), np.concatenate([total[None], stack[sources:]]))
    np.testing.assert_array_equal(compiled_kalman.total(stack, sources), filter_covariances(stack, filters)[0])


@pytest.mark.parametrize("dt_s", [1e-9, 0.2, 3600.0])
def test_propagated_states_equal_numpy(dt_s: float) -> None:
    """Compiled code computes a single time, numpy several; white noise, a random walk and two Gauss–Markov states."""
    slow, white = block("slow", [3.0, 2.0], "a", time_s=[1800.0, 2.0]), block("white", [1.0], "b", time_s=0.0)
    model = StateModel([slow, white, block("walking", [5.0], "a", walk=0.1)], noise_sources=[])
    for found, expected in zip(model.transition(dt_s), model.transition(np.array([dt_s])), strict=True):
        equal(found, expected[0])
    (decay, noise), states = model.transition(dt_s), model.slices["slow"]
    rng = np.random.default_rng(4)
    means, roots = rng.normal(scale=20.0, size=(9, 4)), rng.normal(size=(10, 4, 4))
    stack = roots @ roots.transpose(0, 2, 1)
    expected = decay * means
    expected[:, states] = propagate_correlated_error(means[:, states], decay[states], slow.sigma)
    found = model.propagate(dt_s, means, stack, "slow")
    for one, other in zip(
        found,
        (decay, expected, propagate_covariance(stack, decay, noise, model.source_of, filter_count=9)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("filter_index", [None, 1, 2])
def test_covariance_is_inflated_in_the_right_filters(filter_index: int | None) -> None:
    stack, covariance = case((6, 3, 3, 3))[0], np.arange(4.0).reshape(2, 2)
    found, expected = stack.copy(), stack.copy()
    add_error(found, 3, 1, slice(2, 4), covariance, filter_index)
    for index in (1, 3, 4) if filter_index is None else (2 + filter_index,):
        expected[index, 2:4, 2:4] += covariance
    np.testing.assert_array_equal(found, expected)


def test_projected_variances_equal_numpy() -> None:
    rng = np.random.default_rng(5)
    root, jacobian, weights = rng.normal(size=(7, 9)), rng.normal(size=(3, 7)), np.zeros(7)
    weights[[1, 5]], covariance = (1.0, -2.0), root @ root.T
    equal(np.array(compiled_kalman.variance_along(weights, covariance)), weights @ covariance @ weights)
    others = np.where(weights == 0.0, jacobian, 0.0)
    equal(
        np.array(compiled_kalman.projected_variance(jacobian, covariance, weights)),
        np.trace(others @ covariance @ others.T),
    )


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape[1] >= 3])
def test_innovations_of_all_filters_equal_numpy(shape: tuple[int, int, int, int]) -> None:
    stack, means, measured, by_turn = case(shape)
    at_mean = means[-1] + 0.1
    found = subfilter_innovations(means, stack, measured, at_mean, by_turn)
    expected = numpy_innovations(means, filter_covariances(stack, shape[3]), measured, at_mean, by_turn)
    for name in expected._fields:
        equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.0, 0.7, 1.0])
def test_updates_of_all_filters_equal_numpy(shape: tuple[int, int, int, int], share: float) -> None:
    stack, means, measured, by_turn = case(shape)
    if shape[2] > 1:
        stack[0] = 0.0  # a source that only this measurement contributes
    compared = subfilter_innovations(means, stack, measured, means[0], by_turn)
    learns = np.random.default_rng(3).uniform(size=means.shape) < share
    corrections, updated = update_subfilters(stack, measured, compared, learns)
    expected_corrections, expected = numpy_update(stack, measured, compared, learns)
    equal(corrections, expected_corrections)
    equal(updated, expected)
    np.testing.assert_array_equal(updated, updated.transpose(0, 2, 1))


def test_unobserved_rotation_has_no_whitened_innovation() -> None:
    """The residuals do not depend on a rotation about the third axis."""
    stack, means, measured, by_turn = case((6, 4, 2, 2))
    by_turn[:, 2] = 0.0
    found = subfilter_innovations(means, stack, measured, means[0], by_turn)
    np.testing.assert_array_equal(found.whitened_innovation[:, 2], 0.0)
    np.testing.assert_array_equal(found.whitening_root[:, 2], 0.0)
    equal(
        found.whitened_innovation,
        numpy_innovations(means, filter_covariances(stack, 2), measured, means[0], by_turn).whitened_innovation,
    )


@pytest.mark.parametrize("wrong", [-1e6, np.nan])
def test_invalid_innovation_covariance_raises(wrong: float) -> None:
    stack, means, measured, by_turn = case((6, 4, 2, 2))
    stack[2, 0, 0] = wrong
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        subfilter_innovations(means, stack, measured, means[0], by_turn)


def test_noise_of_any_memory_layout_is_read() -> None:
    """The noise matrices are in Fortran order, as a product of rotations may be."""
    stack, means, measured, by_turn = case((6, 4, 2, 2))
    views = {source: np.asfortranarray(part) for source, part in measured.noise_by_source.items()}
    assert not all(part.flags.c_contiguous for part in views.values())
    others = [measured, LinearMeasurement(measured.residual, measured.jacobian, views)]
    found = [subfilter_innovations(means, stack, one, means[0], by_turn) for one in others]
    everything = np.ones((2, 6), dtype=bool)
    (_, expected), (_, after) = (
        update_subfilters(stack, *each, everything) for each in zip(others, found, strict=True)
    )
    assert found[1].covariance.tobytes() == found[0].covariance.tobytes()
    assert after.tobytes() == expected.tobytes()


def test_shapes_that_do_not_fit_are_refused() -> None:
    """The loops do not check bounds."""
    stack, means, measured, by_turn = case((6, 4, 2, 2))
    arguments = means, stack, measured, means[0], by_turn
    found = subfilter_innovations(*arguments)
    of_five = means[:, :5].copy(), stack[:2, :5, :5].copy()
    for place, wrong in ((0, of_five[0]), (1, stack[:1]), (1, of_five[1]), (3, means[0, :5]), (4, by_turn[:3])):
        with pytest.raises(ValueError, match="do not fit together"):
            subfilter_innovations(*arguments[:place], wrong, *arguments[place + 1 :])
    everything = np.ones((2, 6), dtype=bool)
    for wrong in (everything[:1], everything[:, :5].copy()):
        with pytest.raises(ValueError, match="do not fit together"):
            update_subfilters(stack, measured, found, wrong)
    beyond = LinearMeasurement(measured.residual, measured.jacobian, {2: measured.noise})
    with pytest.raises(ValueError, match="noise_parts"):
        update_subfilters(stack, beyond, found, everything)
    for states, part, filter_index in ((slice(4, 7), 0, None), (slice(0, 3), 2, None), (slice(0, 3), 0, 2)):
        with pytest.raises(ValueError, match="do not fit together"):
            add_error(stack, 2, part, states, np.eye(3), filter_index)
    for call in (
        compiled_kalman.variance_along,
        lambda *of: compiled_kalman.projected_variance(np.ones((3, 6)), *reversed(of)),
    ):
        with pytest.raises(ValueError, match="do not fit together"):
            call(np.ones(5), np.eye(6))
    model = StateModel([block("slow", [1.0] * 6, "a", time_s=1.0)], noise_sources=[])
    for wrong in ((means[:, :5].copy(), stack), (means, stack[:1]), (means, stack[:, :5, :5])):
        with pytest.raises(ValueError, match="do not fit together"):
            model.propagate(1.0, *wrong, "slow")
    with pytest.raises(ValueError, match="stacks"):
        propagate_covariance(stack, np.ones(5), np.ones(6), np.zeros(6, dtype=np.intp), 2)

"""The state vector of named blocks: transition, process noise and covariance by error source."""

import numpy as np
import pytest
from scipy.linalg import expm

from ship_estimation.kalman.kalman_filter import StateModel, block, propagate_covariance

DRIFT, WHITE, CONSTANT, WALK = slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6)


@pytest.fixture
def model() -> StateModel:
    return StateModel(
        [
            block("drift", [2.0, 3.0], "ins", time_s=[30.0, 180.0]),
            block("white", [1.0], "ins_noise", time_s=0.0),
            block("constant", [5.0, 6.0], "installation"),
            block("walk", [0.5], "installation", walk=0.1),
        ],
        ["star_noise", "ins"],
    )


def variance_after(model: StateModel, variance: np.ndarray, *steps_s: float) -> np.ndarray:
    for dt_s in steps_s:
        decay, noise = model.transition(dt_s)
        variance = decay**2 * variance + noise
    return variance


def test_layout(model: StateModel) -> None:
    assert model.size == 6
    assert [model.slices[name] for name in ("drift", "white", "constant", "walk")] == [DRIFT, WHITE, CONSTANT, WALK]
    assert model.sources == ["ins", "ins_noise", "installation", "star_noise"]
    assert model.blocks["walk"].walk.tolist() == [0.1]


@pytest.mark.parametrize("dt_s", [0.01, 1.0, 100.0, 1e5])
def test_transition_is_the_solution_of_the_differential_equation(model: StateModel, dt_s: float) -> None:
    """Van Loan (1978): x' = -x/T + w by a matrix exponential; the walk by its definition."""
    decay, noise = model.transition(dt_s)
    for index, (sigma, time_s) in enumerate([(2.0, 30.0), (3.0, 180.0)]):
        density = 2.0 * sigma**2 / time_s
        # Van Loan's matrix contains exp(+dt/T): propagated in pieces to avoid an overflow.
        pieces = max(1, round(dt_s / time_s))
        van_loan = expm(np.array([[1.0 / time_s, density], [0.0, -1.0 / time_s]]) * dt_s / pieces)
        step_decay = van_loan[1, 1]
        step_noise = step_decay * van_loan[0, 1]
        expected_decay, expected_noise = 1.0, 0.0
        for _ in range(pieces):
            expected_decay, expected_noise = expected_decay * step_decay, step_decay**2 * expected_noise + step_noise
        assert decay[index] == pytest.approx(expected_decay, rel=1e-9, abs=1e-300)
        assert noise[index] == pytest.approx(expected_noise, rel=1e-9)
    np.testing.assert_array_equal(decay[CONSTANT], 1.0)
    np.testing.assert_array_equal(noise[CONSTANT], 0.0)
    assert decay[WALK] == 1.0
    assert noise[WALK] == pytest.approx(0.01 * dt_s, rel=1e-15)
    assert decay[WHITE] == 0.0
    assert noise[WHITE] == 1.0


@pytest.mark.parametrize("split", [(1.0, 2.0, 3.0), (0.1, 5.9), (5.999, 0.001), (6.0, 0.0)])
def test_steps_add_up(model: StateModel, split: tuple[float, ...]) -> None:
    """Semigroup: several steps equal one long step."""
    decay, _ = model.transition(6.0)
    np.testing.assert_allclose(np.prod([model.transition(s)[0] for s in split], axis=0), decay, rtol=1e-14)
    start = np.array([0.0, 100.0, 7.0, 1.0, 2.0, 3.0])
    at_once = variance_after(model, start, 6.0)
    np.testing.assert_allclose(variance_after(model, start, *split), at_once, rtol=1e-13)


def test_steady_state_stays_and_is_found_from_anywhere(model: StateModel) -> None:
    steady = [4.0, 9.0, 1.0]
    start = np.diagonal(model.initial_covariance_by_source().sum(axis=0))
    np.testing.assert_allclose(start[:3], steady)
    np.testing.assert_allclose(variance_after(model, start, *[13.0] * 50)[:3], steady, rtol=1e-14)
    np.testing.assert_allclose(variance_after(model, np.zeros(6), 1e5)[:3], steady, rtol=1e-14)


def test_no_time_no_change_not_even_of_white_noise(model: StateModel) -> None:
    """Two simultaneous measurements share the white error of their common time."""
    decay, noise = model.transition(0.0)
    np.testing.assert_array_equal(decay, 1.0)
    np.testing.assert_array_equal(noise, 0.0)


def test_white_noise_is_new_after_the_least_time(model: StateModel) -> None:
    decay, noise = model.transition(1e-9)
    assert decay[WHITE] == 0.0
    assert noise[WHITE] == 1.0


def test_initial_covariance_belongs_to_the_sources_of_the_blocks(model: StateModel) -> None:
    parts = model.initial_covariance_by_source()
    assert parts.shape == (4, 6, 6)
    diagonals = {source: np.diagonal(part).tolist() for source, part in zip(model.sources, parts, strict=True)}
    assert diagonals == {
        "ins": [4.0, 9.0, 0.0, 0.0, 0.0, 0.0],
        "ins_noise": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        "installation": [0.0, 0.0, 0.0, 25.0, 36.0, 0.25],
        "star_noise": [0.0] * 6,
    }


def test_covariance_by_source_keeps_correlations_within_a_source_and_the_sum(model: StateModel) -> None:
    covariance = np.diag([4.0, 9.0, 1.0, 25.0, 36.0, 0.25])
    covariance[0, 1] = covariance[1, 0] = 3.0
    covariance[3, 5] = covariance[5, 3] = -1.0  # two blocks of one source
    parts = model.covariance_by_source(covariance)
    np.testing.assert_array_equal(parts.sum(axis=0), covariance)
    assert parts[0, 0, 1] == 3.0
    assert parts[2, 3, 5] == -1.0


def test_process_noise_belongs_to_the_sources_of_the_blocks(model: StateModel) -> None:
    decay, noise = model.transition(10.0)
    parts = propagate_covariance(model.initial_covariance_by_source(), decay, noise, model.source_of)
    np.testing.assert_allclose(np.diagonal(parts.sum(axis=0)), [4.0, 9.0, 1.0, 25.0, 36.0, 0.25 + 0.1], rtol=1e-14)
    assert parts[2, 5, 5] == pytest.approx(0.35)
    np.testing.assert_array_equal(parts[3], 0.0)


def test_gauss_markov_draws_have_the_variance_and_correlation_of_the_model() -> None:
    model = StateModel([block("drift", [2.0], "ins", time_s=30.0)], [])
    decay, noise = model.transition(10.0)
    rng = np.random.default_rng(1)
    draws = 200_000
    first = 2.0 * rng.standard_normal(draws)
    second = decay[0] * first + np.sqrt(noise[0]) * rng.standard_normal(draws)
    assert np.var(second) == pytest.approx(4.0, rel=5 * (2 / draws) ** 0.5)
    # exp(-10/30), ± five standard errors.
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(0.716531, abs=5 / draws**0.5)

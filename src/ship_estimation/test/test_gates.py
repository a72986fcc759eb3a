"""Gates against scipy's chi², consistency bands against the values of the design and against draws."""

import numpy as np
import pytest
from scipy.stats import chi2

from ship_estimation.innovations.gates import chi_square_gate, mean_nees_band, normalized_error_squared
from ship_testing.consistency import sigma_ratio_band


@pytest.mark.parametrize("degrees", [1, 2, 3, 6])
@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999, 0.99999, 1.0 - 1e-9])
def test_gate_is_the_quantile_of_chi_square(degrees: int, probability: float) -> None:
    assert chi_square_gate(probability, degrees) == pytest.approx(chi2.ppf(probability, degrees), rel=1e-9)


@pytest.mark.parametrize(("degrees", "table"), [(1, 3.841), (2, 5.991), (3, 7.815)])
def test_gate_at_95_percent_is_that_of_the_printed_tables(degrees: int, table: float) -> None:
    assert chi_square_gate(0.95, degrees) == pytest.approx(table, abs=5e-4)


def test_gate_of_certainty_lets_everything_pass() -> None:
    assert chi_square_gate(1.0, 3) == np.inf


@pytest.mark.parametrize(
    ("samples", "ratio", "nees"),
    [(200, (0.84, 1.17), (2.46, 3.60)), (2000, (0.95, 1.05), (2.82, 3.18))],  # design, reliability.md
)
def test_bands_of_200_and_2000_seeds(samples: int, ratio: tuple[float, float], nees: tuple[float, float]) -> None:
    assert tuple(round(bound, 2) for bound in sigma_ratio_band(samples)) == ratio
    assert tuple(round(bound, 2) for bound in mean_nees_band(samples, 3)) == nees


def test_bands_contain_the_stated_share_of_experiments() -> None:
    """The share is 90 %, which a count can verify: 4000 experiments of 50 draws."""
    rng = np.random.default_rng(1)
    experiments, samples = 4000, 50
    errors = rng.standard_normal((experiments, samples, 3))
    nees = np.mean(np.sum(errors**2, axis=2), axis=1)
    ratio = np.sqrt(np.mean(errors[:, :, 0] ** 2, axis=1))
    for values, (low, high) in (
        (nees, mean_nees_band(samples, 3, 0.9)),
        (ratio, sigma_ratio_band(samples, 0.9)),
    ):
        four_standard_errors = 4 * (0.05 * 0.95 / experiments) ** 0.5
        assert np.mean(values < low) == pytest.approx(0.05, abs=four_standard_errors)
        assert np.mean(values > high) == pytest.approx(0.05, abs=four_standard_errors)


def test_normalized_error_is_the_mahalanobis_distance_of_each() -> None:
    rng = np.random.default_rng(2)
    roots = rng.standard_normal((4, 5, 3, 3))
    covariances = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(3)
    errors = rng.standard_normal((4, 5, 3))
    found = normalized_error_squared(errors, covariances)
    assert found.shape == (4, 5)
    for index in np.ndindex(4, 5):
        expected = errors[index] @ np.linalg.inv(covariances[index]) @ errors[index]
        assert found[index] == pytest.approx(expected, rel=1e-9)
    assert normalized_error_squared(np.array([3.0, 0.0]), np.diag([9.0, 1.0])) == pytest.approx(1.0)

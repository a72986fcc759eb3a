"""χ² in plain floats against scipy's, over the range of gates, fits and protection levels."""

import math

import numpy as np
import pytest
from scipy.special import chdtrc, gammainccinv, gammaincinv, ndtri
from scipy.stats import chi2

from ship_estimation.innovations.gates import (
    chi_square_gate,
    normal_value_above,
    probability_above,
    value_above,
)
from ship_testing.every_case import check_every_case

TAILS = [10.0**-n for n in range(1, 13)]
PROBABILITIES = [*TAILS, 0.25, 0.5, 0.75, *(1.0 - tail for tail in TAILS)]


def test_quantiles_and_tails_are_those_of_scipy() -> None:
    check_every_case([(degrees,) for degrees in range(1, 201)], check_quantiles_and_tails)


def check_quantiles_and_tails(degrees: int) -> None:
    above = np.array([value_above(probability, degrees) for probability in PROBABILITIES])
    below = np.array([chi_square_gate(probability, degrees) for probability in PROBABILITIES])
    np.testing.assert_allclose(above, 2.0 * gammainccinv(0.5 * degrees, PROBABILITIES), rtol=1e-12)
    np.testing.assert_allclose(below, 2.0 * gammaincinv(0.5 * degrees, PROBABILITIES), rtol=1e-12)
    for value in (*above, *below):
        assert probability_above(value, degrees) == pytest.approx(chdtrc(degrees, value), rel=1e-12, abs=0.0)


@pytest.mark.parametrize("degrees", [1_000, 600_000])
def test_bands_of_many_samples_are_those_of_scipy(degrees: int) -> None:
    """The degrees of freedom are those of the mean NEES of a long run."""
    for probability in PROBABILITIES:
        assert value_above(probability, degrees) == pytest.approx(chi2.isf(probability, degrees), rel=1e-12)


@pytest.mark.parametrize("degrees", [1, 2, 29, 200])
def test_far_tails_down_to_the_least_probability(degrees: int) -> None:
    assert value_above(1e-300, degrees) == pytest.approx(2.0 * gammainccinv(0.5 * degrees, 1e-300), rel=1e-12)
    assert chi_square_gate(1e-300, degrees) == pytest.approx(2.0 * gammaincinv(0.5 * degrees, 1e-300), rel=1e-12)
    assert probability_above(1e5, degrees) == chdtrc(degrees, 1e5) == 0.0


def test_normal_quantiles_are_those_of_scipy() -> None:
    for probability in (*TAILS, 1e-40, 0.25):
        assert normal_value_above(probability) == pytest.approx(-ndtri(probability), rel=1e-12)
    assert normal_value_above(0.5) == 0.0


def test_ends_of_the_range() -> None:
    assert (value_above(0.0, 3), value_above(1.0, 3)) == (math.inf, 0.0)
    assert (chi_square_gate(0.0, 3), chi_square_gate(1.0, 3)) == (0.0, math.inf)
    for value, above in ((-1.0, 1.0), (0.0, 1.0), (math.inf, 0.0)):
        assert probability_above(value, 3) == above


def test_nan_stays_nan() -> None:
    """A measurement passes a gate only if ``nis <= gate``, which is false for NaN."""
    for found in (value_above, chi_square_gate, probability_above):
        assert math.isnan(found(math.nan, 3))

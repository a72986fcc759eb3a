"""Consistency of a stated sigma: against chi-square draws, and their quantiles by scipy."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from ship_watch.sources.source_record import BAND_SIGMAS, NisWindow

SECOND = 1_000_000_000


def filled_window(sigma_ratio: float, seed: int, count: int = 300, degrees: int = 3) -> NisWindow:
    window = NisWindow()
    for i, nis in enumerate(np.random.default_rng(seed).chisquare(degrees, count) * sigma_ratio**2):
        window.add(i * SECOND // 5, float(nis), degrees)
    return window


def test_correct_sigmas_are_consistent() -> None:
    # One run in a thousand is outside 3.3 sigma: about 2 of 2000. The probability of more than 9 is 1 in 20 000
    # (Poisson).
    found = [filled_window(1.0, seed, count=60, degrees=15).consistency(12 * SECOND) for seed in range(2000)]
    assert all(one.degrees_of_freedom == 900 for one in found)
    assert 1 <= sum(not one.is_consistent for one in found) <= 9
    stated = next(one for one in found if one.is_consistent)
    assert stated.text == f"σ as stated ({stated.ratio:.2f})"


@pytest.mark.parametrize(("ratio", "text"), [(1.6, "σ optimistic by 1.6"), (0.5, "σ pessimistic by 2.0")])
def test_wrong_sigma_is_reported_with_its_factor(ratio: float, text: str) -> None:
    found = filled_window(ratio, 3, count=299, degrees=100).consistency(60 * SECOND)
    assert not found.is_consistent
    assert found.text == text


@pytest.mark.parametrize("degrees", [30, 300, 3000])
def test_probability_of_the_band(degrees: int) -> None:
    # r = √(χ²/N): the probability to be outside 1 ± 3.3/√(2N), by scipy, is close to that of 3.3 normal sigmas.
    band = BAND_SIGMAS / math.sqrt(2 * degrees)
    outside = chi2.cdf(degrees * (1 - band) ** 2, degrees) + chi2.sf(degrees * (1 + band) ** 2, degrees)
    assert 0.0004 < outside < 0.002


def test_window_is_one_minute() -> None:
    window = filled_window(3.0, 1)
    for i in range(300):
        window.add((61 + i) * SECOND, 3.0, 3)
    found = window.consistency(361 * SECOND)
    assert found.degrees_of_freedom == 60 * 3  # from 301 s to 360 s
    assert found.ratio == pytest.approx(1.0)


def test_too_few_innovations_give_no_text_and_none_gives_nan() -> None:
    window = NisWindow()
    assert math.isnan(window.consistency(0).ratio)
    window.add(0, 90.0, 3)
    assert window.consistency(0).text == ""
    window.add(0, math.nan, 3)
    window.add(0, math.inf, 3)
    assert window.consistency(0).degrees_of_freedom == 3

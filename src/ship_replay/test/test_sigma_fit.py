"""Consistency tests by Monte Carlo: AR(1) errors and χ² innovations, with correct and wrong sigmas, by seed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2

from ship_replay.evaluation.statistics import AcceptedInnovation, AttitudeErrors, SourceInnovations, independent_count
from ship_replay.report.consistency import TOO_FEW_INDEPENDENT_TEXT, TOO_FEW_TEXT, nees_fit, nis_fit
from ship_watch.sources.source_record import NisWindow

RATE_HZ = 10
FIVE_MINUTES = 300 * RATE_HZ
NS = 1_000_000_000


def ar1(seed: int, time_s: float, count: int = FIVE_MINUTES) -> np.ndarray:
    """Return three channels of unit variance, in steady state; the autocorrelation falls to 1/e in ``time_s``."""
    rng = np.random.default_rng(seed)
    kept = math.exp(-1.0 / (time_s * RATE_HZ))
    driven = rng.standard_normal((count, 3)) * math.sqrt(1.0 - kept**2)
    driven[0] = rng.standard_normal(3)
    return lfilter([1.0], [1.0, -kept], driven, axis=0)


def errors(normalised: np.ndarray, sigma_ratio: float = 1.0) -> AttitudeErrors:
    """Return errors with a sigma of 2″ that is stated as 2″ over the ratio."""
    sigmas = np.full_like(normalised, 2.0 / sigma_ratio)
    nees = np.sum((normalised * 2.0 / sigmas) ** 2, axis=1)
    time_ns = np.arange(len(normalised), dtype=np.int64) * NS // RATE_HZ
    return AttitudeErrors("fused", ("heading", "pitch", "roll"), time_ns, normalised * 2.0, sigmas, nees)


def innovations(seed: int, sigma_ratios: list[float], a_minute: int = 300) -> SourceInnovations:
    """Return one minute for each ratio of actual to stated sigma, three degrees of freedom each time."""
    rng = np.random.default_rng(seed)
    part = SourceInnovations()
    for minute, ratio in enumerate(sigma_ratios):
        for index in range(a_minute):
            residual = rng.standard_normal(3) * ratio
            stamp_ns = 60 * NS * minute + 60 * NS * index // a_minute
            part.accepted[stamp_ns] = AcceptedInnovation(
                ("x", "y", "z"), residual, np.ones(3), float(residual @ residual)
            )
    return part


@pytest.mark.parametrize("time_s", [0.5, 3.0, 10.0])
def test_number_of_independent_samples_agrees_with_theory(time_s: float) -> None:
    """The sum of the squared autocorrelation of AR(1) is τ = (1 + a²)/(1 - a²)."""
    kept = math.exp(-1.0 / (time_s * RATE_HZ))
    expected = FIVE_MINUTES * (1.0 - kept**2) / (1.0 + kept**2)
    found = [independent_count(ar1(seed, time_s)) for seed in range(200)]
    assert np.median(found) == pytest.approx(expected, rel=0.12)  # median of 200, each good to 30 % at the slowest


def test_independent_ones_of_white_noise_of_nothing_and_of_a_bias() -> None:
    white = np.random.default_rng(1).standard_normal((5000, 3))
    assert independent_count(white) == pytest.approx(5000, rel=0.05)
    assert independent_count(np.full((5000, 3), 7.0)) < 2.0
    assert independent_count(np.zeros((50, 3))) == 1.0
    assert independent_count(np.empty((0, 3))) == 0.0


@pytest.mark.statistics
@pytest.mark.parametrize("time_s", [0.1, 3.0, 10.0, 30.0])
def test_a_correct_sigma_is_accepted(time_s: float) -> None:
    """One of 1000 consistent runs is outside a 99.9 % band; in one of ten thousand such tests more than 6 are."""
    fits = [nees_fit(errors(ar1(seed, time_s))) for seed in range(1000)]
    rejected = [fit for fit in fits if "optimistic" in fit.words or "pessimistic" in fit.words]
    assert len(rejected) <= binom.ppf(0.9999, 1000, 0.001)
    if time_s <= 10.0:
        assert sum(fit.words == f"σ as stated ({fit.ratio:.2f})" for fit in fits) >= 990


def test_a_band_without_correlation_would_reject_it() -> None:
    """Without the effective number of samples, three of four consistent runs would fail."""
    low, high = chi2.ppf([0.0005, 0.9995], 3 * FIVE_MINUTES) / (3 * FIVE_MINUTES)
    means = np.array([nees_fit(errors(ar1(seed, 10.0))).mean / 3.0 for seed in range(100)])
    assert np.mean((means < low) | (means > high)) > 0.7


@pytest.mark.parametrize(("ratio", "word"), [(1.6, "optimistic"), (0.6, "pessimistic")])
def test_a_false_sigma_is_named(ratio: float, word: str) -> None:
    """The band of the ratio for 100 independent samples is 1 ± 0.13, its sigma 0.04: every run detects 1.6 and 0.6."""
    fits = [nees_fit(errors(ar1(seed, 3.0), ratio)) for seed in range(200)]
    assert all(word in fit.words for fit in fits)
    assert np.median([fit.ratio for fit in fits]) == pytest.approx(ratio, rel=0.02)


def test_errors_correlated_over_the_run_give_no_result() -> None:
    fit = nees_fit(errors(np.full((FIVE_MINUTES, 3), 2.0)))
    assert fit.words == TOO_FEW_INDEPENDENT_TEXT
    assert fit.ratio == pytest.approx(2.0)
    assert fit.independent < 2.0
    texts = [nees_fit(errors(ar1(seed, 100.0))).words for seed in range(100)]
    assert texts.count(TOO_FEW_INDEPENDENT_TEXT) > 90


def test_missing_sigmas_are_reported() -> None:
    complete = errors(ar1(1, 3.0))
    half = replace(complete, nees=np.where(np.arange(FIVE_MINUTES) < 2000, complete.nees, np.nan))
    fit = nees_fit(half)
    assert fit.count == 2000
    assert fit.mean == pytest.approx(np.mean(complete.nees[:2000]))
    none = replace(complete, label="ins", nees=complete.nees * np.nan)
    assert nees_fit(none).words == "no σ stated"


@pytest.mark.statistics
def test_an_hour_of_consistent_innovations_is_as_stated() -> None:
    fits = [nis_fit("star.bow", innovations(seed, [1.0] * 60, 30)) for seed in range(100)]
    # More than two of sixty minutes outside: 3 of 100 000 runs.
    assert all(fit.words == f"σ as stated ({fit.ratio:.2f})" for fit in fits)
    assert all(sum(fit.minutes.values()) == 60 for fit in fits)
    # Of 6000 minutes about 6 are outside, more than 17 in one of ten thousand such tests.
    assert 0 < sum(60 - fit.minutes["as stated"] for fit in fits) <= binom.ppf(0.9999, 6000, 0.001)


def test_three_percent_are_as_stated() -> None:
    """Over an hour the band of all innovations together would be 1 ± 0.01; no sigma is stated so exactly."""
    fit = nis_fit("star.bow", innovations(1, [1.03] * 60))
    assert fit.ratio == pytest.approx(1.03, abs=0.01)
    assert fit.words == f"σ as stated ({fit.ratio:.2f})"


def test_minutes_with_a_false_sigma_are_counted() -> None:
    fit = nis_fit("star.bow", innovations(2, [1.0] * 40 + [1.6] * 15 + [0.5] * 5))
    assert fit.words == "σ optimistic by 1.6 in 15, pessimistic by 2.0 in 5 of 60 minutes"
    assert fit.minutes == {"as stated": 40, "optimistic": 15, "pessimistic": 5}


def test_one_minute_equals_the_live_page() -> None:
    part = innovations(3, [1.6])
    window = NisWindow()
    for stamp_ns, innovation in sorted(part.accepted.items()):
        window.add(stamp_ns, innovation.nis, 3)
    assert nis_fit("star.bow", part).words == f"{window.consistency(60 * NS - 1).text} in 1 of 1 minutes"


def test_few_or_non_finite_innovations_give_no_result() -> None:
    assert nis_fit("reference", innovations(4, [3.0], 5)).words == TOO_FEW_TEXT
    part = innovations(5, [1.0] * 3)
    part.accepted[10 * NS] = AcceptedInnovation(("x",), np.array([1.0]), np.ones(1), math.nan)
    fit = nis_fit("star.bow", part)
    assert math.isfinite(fit.ratio)
    assert fit.count == 900 - (10 * NS in innovations(5, [1.0] * 3).accepted)

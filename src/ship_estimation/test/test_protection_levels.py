"""Protection levels: sigma multipliers for the configured probabilities, and bounds verified by Monte Carlo."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import norm

from ship_estimation.integrity.protection_levels import (
    TESTS_PER_H,
    IntegrityConfig,
    IntegrityState,
    SigmaMultipliers,
    integrity_report,
    joint_prior_per_h,
    separation_inflation,
    sigma_multipliers,
)
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.rotations import ARCSEC
from ship_testing.separations import solution_separations


def test_sigma_multipliers_keep_the_configured_probabilities():
    config, priors = IntegrityConfig(p_hmi=1e-5, false_exclusions_per_h=1e-3), [1e-4, 1e-3]
    found = sigma_multipliers(config, priors)
    share, tests = 1e-5 / 3, 3 * TESTS_PER_H
    # Two-sided for the fault-free case and false exclusions, one-sided for missed detections.
    assert 2 * norm.sf(found.fault_free) * tests == pytest.approx(share)
    assert 2 * norm.sf(found.false_exclusion) * tests * 2 == pytest.approx(0.5 * 1e-3)
    np.testing.assert_allclose(norm.sf(found.missed_detection) * priors, [share, share])


def test_error_under_an_undetected_fault_is_within_the_protection_level():
    """Sensor 0 of three has faults of all sizes; without a detection the level bounds the error."""
    rng = np.random.default_rng(5)
    sigma = np.array([3.0, 3.0, 3.0])
    k = SigmaMultipliers(fault_free=4.0, false_exclusion=4.0, missed_detection=np.full(3, 3.0))
    misleading = 0
    for bias in np.linspace(0.0, 40.0, 400):
        measured = sigma[:, None] * rng.standard_normal((3, 3))
        measured[0] += bias
        estimate_0, left_out = (
            measured.mean(axis=0),
            np.array([np.delete(measured, i, 0).mean(axis=0) for i in range(3)]),
        )
        found = solution_separations(left_out - estimate_0, np.full((3, 3), 4.5), np.full(3, 3.0), k)
        is_detected = found.statistic.max() > k.false_exclusion
        misleading += not is_detected and bool(np.any(np.abs(estimate_0) > found.level))
    assert misleading == 0


def misleading_ratio(sensors, bias, pairs, draws=300, seed=5):
    """Return the probability that two equal faults are not detected and an error exceeds its protection level.

    The estimate has three components and is the mean of the sensors. Each sensor measures each component with a sigma
    of 3: the mean of k sensors has the variance 9/k. The separation of nested estimates has the difference of their
    variances.
    """
    rng, everyone = np.random.default_rng(seed), set(range(sensors))
    left_out = [*itertools.combinations(everyone, 1), *(itertools.combinations(everyone, 2) if pairs else ())]
    uses = [sorted(everyone - set(names)) for names in left_out]
    k = SigmaMultipliers(fault_free=4.0, false_exclusion=5.0, missed_detection=np.full(len(uses), MISSED))
    variances = np.array([[9.0 / len(used)] * 3 for used in uses])
    misleading = 0
    for _ in range(draws):
        measured = 3.0 * rng.standard_normal((sensors, 3))
        measured[:2] += bias
        estimate = measured.mean(axis=0)
        distance = np.array([measured[used].mean(axis=0) for used in uses]) - estimate
        found = solution_separations(distance, variances, np.full(3, 9.0 / sensors), k)
        is_detected = not found.statistic.max() <= k.false_exclusion
        misleading += not is_detected and bool(np.any(np.abs(estimate) > found.level))
    return misleading / draws


MISSED = 2.0
"""K_md: a normal error of one component exceeds two sigmas on one side with a probability of 2.3 %."""


@pytest.mark.parametrize("sensors", [3, 4])
def test_error_under_two_undetected_faults_is_within_the_protection_level_of_pairs(sensors):
    biases = np.linspace(0.0, 40.0, 21)
    # Each of the three components may exceed its level.
    most = 3.0 * norm.sf(MISSED)
    assert max(misleading_ratio(sensors, bias, pairs=True) for bias in biases) <= most
    # The levels for single faults do not guarantee this probability.
    assert max(misleading_ratio(sensors, bias, pairs=False) for bias in biases) > 3.0 * most


def test_prior_of_two_faults_is_the_product_of_their_hourly_probabilities():
    """Faults of two Poisson processes are drawn, and the hours with a fault of both are counted."""
    rng, rates, hours = np.random.default_rng(6), [0.02, 0.05], 400_000
    both = np.sum(np.all(rng.poisson(rates, (hours, 2)) > 0, axis=1)) / hours
    # The probability of 1e-3 gives 400 cases, with a relative sigma of 5 %. Two faults of one source in an hour count
    # as one, which lowers the number by 3.4 %.
    assert joint_prior_per_h(rates) == pytest.approx(1e-3)
    assert both == pytest.approx(joint_prior_per_h(rates), rel=0.2)


def test_improbable_fault_adds_nothing_to_the_threshold():
    found = sigma_multipliers(IntegrityConfig(p_hmi=1e-5), [1e-3, 1e-6, 1e-9])
    assert found.missed_detection[0] > 2.5
    np.testing.assert_array_equal(found.missed_detection[1:], [norm.isf(0.5)] * 2)


def test_the_largest_hypothesis_dominates():
    k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.0, missed_detection=np.array([2.0, 2.0]))
    left_out = np.array([[4.0] * 3, [9.0] * 3])
    found = solution_separations(np.zeros((2, 3)), left_out, np.full(3, 3.0), k)
    assert found.dominant == 1
    np.testing.assert_allclose(found.level, 5.0 * np.sqrt(6.0) + 2.0 * 3.0)
    nothing = solution_separations(np.zeros((2, 3)), np.full((2, 3), 3.0), np.full(3, 3.0), k)
    assert nothing.dominant == -1


def test_limits_are_three_or_none_and_positive():
    assert np.all(np.isnan(IntegrityConfig().alert_limit))
    limit = build(IntegrityConfig, {"alert_limit_arcsec": [30.0, 12.0, 12.0]}).alert_limit
    np.testing.assert_allclose(limit, np.array([30.0, 12.0, 12.0]) * ARCSEC)
    for wrong in ([30.0], [30.0, 12.0, 0.0], [30.0, -1.0, 12.0], [30.0, float("nan"), 12.0]):
        with pytest.raises(ParameterError, match="alert_limit_arcsec"):
            build(IntegrityConfig, {"alert_limit_arcsec": wrong})


@pytest.mark.parametrize("prior", [0.0, -1e-4, float("nan")])
def test_invalid_prior_is_refused_by_name(prior):
    with pytest.raises(ParameterError, match=r"prior_per_h\.star_sensor"):
        build(IntegrityConfig, {"prior_per_h": {"star_sensor": prior}}, prefix="")


@pytest.mark.parametrize("statistic", [5.2, math.nan])
def test_no_level_with_a_separation_above_its_threshold(statistic):
    """The level allows for a separation of K_fa sigma_d, so the level is no bound if the separation is larger."""
    k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.12, missed_detection=np.array([2.0, 2.0]))
    for beyond, state in ((5.0, IntegrityState.NO_LIMIT), (statistic, IntegrityState.UNAVAILABLE)):
        # In the subfilter the sigma is 2 instead of the square root of 3: the separation has a sigma of 1.
        distance = np.array([[0.5] * 3, [beyond] * 3])
        found = solution_separations(distance, np.full((2, 3), 4.0), np.full(3, 3.0), k)
        report = integrity_report(0, IntegrityConfig(), k, ("star.bow", "ins"), found, (), is_checked=True)
        assert report.state is state
        np.testing.assert_allclose(report.statistic, [0.5, beyond])
        assert np.isfinite(report.level).all() == (state is IntegrityState.NO_LIMIT)


def test_excluded_source_does_not_affect_the_level():
    """The subfilter without the excluded source is separated by 41 sigmas, and would give the largest level."""
    k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.12, missed_detection=np.array([2.0, 2.0]))
    distance, variance = np.array([[100.0] * 3, [0.5] * 3]), np.array([[9.0] * 3, [4.0] * 3])
    found = solution_separations(distance, variance, np.full(3, 3.0), k, subfilter_indices=[1])
    report = integrity_report(7, IntegrityConfig(), k, ("ins",), found, (("star.bow", 5),), is_checked=True)
    assert report.largest_sigma == 2.0
    assert (report.hypotheses, report.excluded, report.dominant) == (("ins",), (("star.bow", 5),), "")
    np.testing.assert_allclose(report.level, 6.0 * np.sqrt(3.0))


def test_without_tested_hypotheses_there_is_no_level():
    k, none = SigmaMultipliers(fault_free=6.0, false_exclusion=5.0, missed_detection=np.array([2.0])), []
    found = solution_separations(np.zeros((1, 3)), np.full((1, 3), 9.0), np.full(3, 3.0), k, subfilter_indices=none)
    for limit, state in (((), IntegrityState.NO_LIMIT), ((1e6,) * 3, IntegrityState.EXCEEDED)):
        config = IntegrityConfig(alert_limit_arcsec=limit)
        report = integrity_report(0, config, k, (), found, (), is_checked=True)
        assert (report.state, report.largest_sigma, report.dominant) == (state, 0.0, "")
        assert np.isnan(report.level).all()


def test_separation_inflation_starts_at_three_sigmas_and_ignores_nan():
    distance = ARCSEC * np.array([[10.0, 0.0, 5.0], [np.nan, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 8.0, 0.0]])
    at_the_limit = separation_inflation(distance, np.array([3.0, 9.0, np.nan, 2.0]))
    np.testing.assert_array_equal(at_the_limit, np.zeros((3, 3)))
    np.testing.assert_allclose(
        separation_inflation(distance, np.array([3.001, 9.0, np.nan, 2.0])),
        np.zeros((3, 3)),
        atol=1e-3 * (10.0 * ARCSEC) ** 2,
    )
    both = separation_inflation(distance, np.array([6.0, 9.0, np.nan, np.inf]))
    of_each = 0.75 * np.outer(distance[0], distance[0]) + np.outer(distance[3], distance[3])
    np.testing.assert_allclose(both, of_each, rtol=1e-12)

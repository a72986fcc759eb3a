"""Protection levels: their factors keep the configured probabilities, their bounds hold in a Monte Carlo run."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from ship_estimation.parameters import ParameterError, build
from ship_estimation.protection import (
    TESTS_PER_H,
    Factors,
    IntegrityConfig,
    IntegrityState,
    Separation,
    factors,
    integrity_report,
    separation,
)
from ship_geometry.rotations import ARCSEC


def test_factors_keep_the_configured_probabilities():
    config, priors = IntegrityConfig(p_hmi=1e-5, false_exclusions_per_h=1e-3), [1e-4, 1e-3]
    found = factors(config, priors)
    share, tests = 1e-5 / 3, 3 * TESTS_PER_H
    # Two-sided for what may lie on both sides; on the side of the threshold alone for what is missed.
    assert 2 * norm.sf(found.right) * tests == pytest.approx(share)
    assert 2 * norm.sf(found.false_exclusion) * tests * 2 == pytest.approx(0.5 * 1e-3)
    np.testing.assert_allclose(norm.sf(found.missed) * priors, [share, share])


def test_a_fault_that_is_not_told_stays_within_the_level():
    """Two sensors and a third: sensor 0 is wrong by every size; where no separation tells, the level holds."""
    rng = np.random.default_rng(5)
    sigma = np.array([3.0, 3.0, 3.0])
    k = Factors(right=4.0, false_exclusion=4.0, missed=np.full(3, 3.0))
    misled = 0
    for bias in np.linspace(0.0, 40.0, 400):
        measured = sigma[:, None] * rng.standard_normal((3, 3))
        measured[0] += bias
        estimate_0, left_out = (
            measured.mean(axis=0),
            np.array([np.delete(measured, i, 0).mean(axis=0) for i in range(3)]),
        )
        found = separation(left_out - estimate_0, np.tile(4.5 * np.eye(3), (3, 1, 1)), 3.0 * np.eye(3), k)
        told = found.statistic.max() > k.false_exclusion
        misled += not told and bool(np.any(np.abs(estimate_0) > found.level))
    assert misled == 0


def test_the_largest_hypothesis_dominates():
    k = Factors(right=6.0, false_exclusion=5.0, missed=np.array([2.0, 2.0]))
    left_out = np.stack([4.0 * np.eye(3), 9.0 * np.eye(3)])
    found = separation(np.zeros((2, 3)), left_out, 3.0 * np.eye(3), k)
    assert found.dominant == 1
    np.testing.assert_allclose(found.level, 5.0 * np.sqrt(6.0) + 2.0 * 3.0)
    nothing = separation(np.zeros((2, 3)), np.stack([3.0 * np.eye(3)] * 2), 3.0 * np.eye(3), k)
    assert nothing.dominant == -1


def test_limits_are_three_or_none_and_positive():
    assert np.all(np.isnan(IntegrityConfig().alert_limit))
    limit = build(IntegrityConfig, {"alert_limit_arcsec": [30.0, 12.0, 12.0]}).alert_limit
    np.testing.assert_allclose(limit, np.array([30.0, 12.0, 12.0]) * ARCSEC)
    for wrong in ([30.0], [30.0, 12.0, 0.0], [30.0, -1.0, 12.0], [30.0, float("nan"), 12.0]):
        with pytest.raises(ParameterError, match="alert_limit_arcsec"):
            build(IntegrityConfig, {"alert_limit_arcsec": wrong})


@pytest.mark.parametrize("prior", [0.0, -1e-4, float("nan")])
def test_a_threat_without_a_prior_is_refused_by_name(prior):
    with pytest.raises(ParameterError, match=r"prior_per_h\.star_sensor"):
        build(IntegrityConfig, {"prior_per_h": {"star_sensor": prior}}, prefix="")


@pytest.mark.parametrize("statistic", [5.2, math.nan])
def test_there_is_no_level_where_a_separation_is_beyond_its_threshold(statistic):
    """The level of a source is K_fa sigma_d and more: it bounds nothing where the distance itself is larger."""
    level = np.full(3, 20.0) * ARCSEC
    for beyond, state in ((5.0, IntegrityState.NO_LIMIT), (statistic, IntegrityState.UNAVAILABLE)):
        found = Separation(np.array([0.5, beyond]), level, dominant=1)
        told = integrity_report(0, IntegrityConfig(), ["star.bow", "ins"], found, True, threshold=5.12, excluded=[])
        assert told.state is state
        assert np.isfinite(told.level).all() == (state is IntegrityState.NO_LIMIT)

"""Observability of combinations of installation angles: artificial covariances, expected numbers by hand."""

import numpy as np
import pytest

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_studies.installation.result import DECK_AXES, combinations, observability

LAYOUT = np.array([rotation_from_angles(azimuth, np.deg2rad(45.0), 0.0) for azimuth in np.deg2rad([0.0, 90.0])])
INS = np.array([10.0, 72.0, 10.0]) * ARCSEC
PRIOR = np.full((2, 3), 20.0) * ARCSEC
PRIOR_COVARIANCE = np.diag(PRIOR.ravel() ** 2)


def update_covariance(covariance: np.ndarray, jacobian: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return a covariance after a measurement."""
    return np.linalg.inv(np.linalg.inv(covariance) + jacobian.T @ np.linalg.solve(noise, jacobian))


def against_ins(covariance: np.ndarray, sigma_arcsec: float) -> np.ndarray:
    """Return the covariance after both sensors were compared with one INS at constant heading."""
    noise = np.tile(np.diag(INS**2), (2, 2)) + (sigma_arcsec * ARCSEC) ** 2 * np.eye(6)
    to_deck = np.zeros((6, 6))
    to_deck[:3, :3], to_deck[3:, 3:] = LAYOUT
    return update_covariance(covariance, to_deck, noise)


def find_combinations(covariance: np.ndarray, prior: np.ndarray = PRIOR, layout: np.ndarray = LAYOUT) -> list:
    return combinations(prior, covariance[None], layout, INS)


def test_observability_by_the_ratio_of_sigmas() -> None:
    assert [observability(ratio) for ratio in (0.0, 0.5, 0.51, 0.89, 0.9, 1.1)] == [
        "yes", "yes", "partly", "partly", "no", "no",
    ]  # fmt: skip


def test_nothing_measured_leaves_everything_unobserved() -> None:
    combos = find_combinations(PRIOR_COVARIANCE)
    assert [combo.axis for combo in combos] == [*DECK_AXES, None, None, None]
    assert {combo.observability for combo in combos} == {"no"}
    # Two sensors with a sigma of 20": the sigma of their common rotation is 20" / sqrt 2.
    assert [combo.sigma / ARCSEC for combo in combos[:3]] == pytest.approx([20.0 / np.sqrt(2.0)] * 3)


def test_at_constant_heading_only_the_turn_of_all_is_unobserved() -> None:
    combos = find_combinations(against_ins(PRIOR_COVARIANCE, sigma_arcsec=0.1))
    # 1 / sqrt(2 / 20² + 1 / 10²) and 1 / sqrt(2 / 20² + 1 / 72²): prior and INS, by hand.
    assert [combo.axis for combo in combos] == list(DECK_AXES)
    assert [combo.sigma_before / ARCSEC for combo in combos] == pytest.approx([8.165, 13.877, 8.165], abs=1e-3)
    assert [combo.sigma / combo.sigma_before for combo in combos] == pytest.approx([1.0] * 3, abs=1e-3)
    assert {combo.observability for combo in combos} == {"no"}
    # The common rotation is 13.9" about the deck's up axis: 13.9" / sqrt 2 about each sensor's forward and up axes.
    assert combos[1].rotation_s / ARCSEC == pytest.approx(np.tile([9.81, 9.81, 0.0], (2, 1)), abs=0.02)


def test_one_observation_bounds_a_wide_prior() -> None:
    """The INS alone shows only the sum of INS error and installation, so even a wide prior stays "not observed"."""
    wide = 180.0 * PRIOR
    combos = find_combinations(against_ins(np.diag(wide.ravel() ** 2), sigma_arcsec=0.1), wide)
    assert [combo.sigma / ARCSEC for combo in combos] == pytest.approx([10.0, 72.0, 10.0], rel=1e-3)
    assert {combo.observability for combo in combos} == {"no"}


def test_an_independent_deck_is_observed() -> None:
    fore_on_deck = np.hstack([LAYOUT[0], np.zeros((3, 3))])
    known = update_covariance(against_ins(PRIOR_COVARIANCE, 0.1), fore_on_deck, (0.5 * ARCSEC) ** 2 * np.eye(3))
    assert [(combo.axis, combo.observability) for combo in find_combinations(known)] == [
        (axis, "yes") for axis in DECK_AXES
    ]


def test_an_ins_without_errors_is_the_deck() -> None:
    known = np.diag((0.1 * ARCSEC) ** 2 * np.ones(6))
    combos = combinations(PRIOR, known[None], LAYOUT, np.array([0.0, 72.0, 0.0]) * ARCSEC)
    assert [combo.sigma_before / ARCSEC for combo in combos] == pytest.approx([14.142, 13.877, 14.142], abs=1e-3)
    assert {combo.observability for combo in combos} == {"yes"}


def test_a_boresight_that_was_not_observed_is_named() -> None:
    """All is known except the rotation of the second sensor about its boresight."""
    # 0.1" about five axes; the sixth, forward of the second sensor, not at all.
    measured = np.delete(np.eye(6), 3, axis=0)
    combos = find_combinations(update_covariance(PRIOR_COVARIANCE, measured, (0.1 * ARCSEC) ** 2 * np.eye(5)))
    (unobserved,) = [combo for combo in combos if combo.observability != "yes"]
    assert unobserved.axis is None
    assert np.unravel_index(np.argmax(np.abs(unobserved.rotation_s)), (2, 3)) == (1, 0)


def test_a_single_sensor_has_no_relative_rotation() -> None:
    one = find_combinations(PRIOR_COVARIANCE[:3, :3], PRIOR[:1], LAYOUT[:1])
    assert [combo.axis for combo in one] == list(DECK_AXES)
    assert {combo.observability for combo in one} == {"no"}


def test_shares_are_of_the_remaining_variance() -> None:
    parts = np.array([0.25, 0.75])[:, None, None] * against_ins(PRIOR_COVARIANCE, 0.1)
    for combo in combinations(PRIOR, parts, LAYOUT, INS):
        assert combo.shares == pytest.approx([0.25, 0.75])
        assert combo.sigma == pytest.approx(combo.sigma_before, rel=1e-3)

"""Sums of corrections, against a filter without the measurements of the window and a filter with a common error."""

import numpy as np
import pytest

from ship_estimation.fault_detection.common_error import NO_CORRECTIONS, CorrectionSums, with_common_error
from ship_estimation.fault_detection.subfilters import FilterInnovations
from ship_estimation.integrity.protection_levels import ProtectionLevels, SigmaMultipliers
from ship_geometry.rotations import FloatArray

NOISE, WALK, COUNT = 9.0, 0.2, 40


def run_filter(measured: FloatArray, used_count: int) -> tuple[FloatArray, FloatArray, list[FilterInnovations]]:
    """Filter a random walk of three states with the first measurements only, by plain equations of the Kalman filter.

    Args:
        measured: shape (N, 3).
        used_count: number of measurements that are used.

    Returns:
        Mean and covariance after all N steps, and the innovation of each measurement that is used.
    """
    mean, covariance, found = np.zeros(3), 25.0 * np.eye(3), []
    for number, one in enumerate(measured):
        covariance = covariance + WALK * np.eye(3)
        if number < used_count:
            of_residual = covariance + NOISE * np.eye(3)
            gain, residual = covariance @ np.linalg.inv(of_residual), one - mean
            found.append(
                FilterInnovations(residual[None], of_residual[None], np.ones(1), gain[None], *(np.empty(0),) * 3)
            )
            mean, covariance = mean + gain @ residual, (np.eye(3) - gain) @ covariance
    return mean, covariance, found


def correction_sums(compared: list[FilterInnovations]) -> CorrectionSums:
    found = NO_CORRECTIONS
    for one in compared:
        found = found.with_correction(one, np.eye(3), first=0)
    return found


def window_length(compared: list[FilterInnovations]) -> int:
    """Return the number of measurements in the sums: those of four blocks of half a time constant."""
    for count in range(1, len(compared)):
        if correction_sums(compared[-count:]).variance == pytest.approx(correction_sums(compared).variance):
            return count
    return len(compared)


def test_correction_sum_equals_the_separation_from_a_filter_without_the_window() -> None:
    measured = np.random.default_rng(3).normal(0.0, 3.0, (COUNT, 3))
    mean, covariance, compared = run_filter(measured, COUNT)
    found, window = correction_sums(compared), window_length(compared)
    without, wider, _ = run_filter(measured, COUNT - window)
    assert 0 < window < COUNT
    np.testing.assert_allclose(found.correction_n, mean - without, rtol=1e-9)
    np.testing.assert_allclose(found.variance, np.diagonal(wider - covariance), rtol=1e-9)
    assert found.sigmas == pytest.approx(np.max(np.abs(found.correction_n) / np.sqrt(found.variance)))


def test_absorbed_share_is_the_effect_of_a_common_error_in_the_window() -> None:
    measured = np.random.default_rng(4).normal(0.0, 3.0, (COUNT, 3))
    mean, _, compared = run_filter(measured, COUNT)
    found, window = correction_sums(compared), window_length(compared)
    turned = measured.copy()
    turned[COUNT - window :] += np.array([1.0, -2.0, 4.0])
    by_error = run_filter(turned, COUNT)[0] - mean
    np.testing.assert_allclose(found.absorbed_share * np.array([1.0, -2.0, 4.0]), by_error, rtol=1e-9)
    assert np.all((found.absorbed_share > 0.77) & (found.absorbed_share < 0.88))


def test_restart_clears_the_corrections_but_not_their_variance() -> None:
    found = correction_sums(run_filter(np.full((COUNT, 3), 5.0), COUNT)[2])
    after = found.without_corrections()
    assert after.correction_n.tolist() == [0.0, 0.0, 0.0]
    assert after.error_variance.tolist() == found.error_variance.tolist()
    assert found.sums[:, 0].any()


def test_without_measurements_the_error_variance_is_infinite() -> None:
    others = ProtectionLevels(np.array([1.0]), np.full(3, 8.0), 0, 1.0)
    k, level_of = SigmaMultipliers(6.0, 5.0, np.array([2.0])), np.eye(3) + 0.1
    assert with_common_error(others, k, 1.0, 6.0, NO_CORRECTIONS, level_of, np.eye(3)).level.tolist() == [np.inf] * 3


def test_unresolved_error_is_held_and_the_larger_variance_applies() -> None:
    sums = np.zeros((1, 3, 3))
    sums[0, 1] = 1.0
    sums[0, 0, 1] = 5.0
    large = CorrectionSums(sums, 5.0).with_unresolved_error(0, hold_ns=60)
    assert large.unresolved is not None
    assert large.unresolved.variance.tolist() == [0.0, 4.75, 0.0]
    sums = sums.copy()
    sums[0, 0, 1] = 4.6
    smaller = large._replace(sums=sums, sigmas=4.6).with_unresolved_error(50, hold_ns=60)
    assert smaller.unresolved is not None
    assert (smaller.unresolved.variance.tolist(), smaller.unresolved.until_ns) == ([0.0, 4.75, 0.0], 110)
    assert smaller.without_corrections().with_unresolved_error(109, hold_ns=60).unresolved == smaller.unresolved
    assert smaller.without_corrections().with_unresolved_error(110, hold_ns=60).unresolved is None

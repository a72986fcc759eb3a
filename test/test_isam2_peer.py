"""The ship's filter and GTSAM's iSAM2 on the same runs: the filter's errors are not larger, and both are consistent.

Python 3.10 has no wheel of GTSAM: there these tests are skipped. ``make campaign`` runs more seeds.
"""

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.rotations import ARCSEC
from ship_testing.campaign_cases import case_in_short
from ship_testing.isam2_peer import isam2_error
from ship_testing.trials.monte_carlo import FinalError, final_error

pytest.importorskip("gtsam", reason="GTSAM is not installed: pip install gtsam", exc_type=ImportError)

SEEDS = 20
SAME_DATA = 0.05
"""Allowed RMS difference of the two estimates, sigmas: the filter and iSAM2 interpolate the INS differently."""
NO_LARGER = 1.02
"""Allowed ratio of the filter's RMS error to that of iSAM2: by chance the two differ by 0.3 % over 20 seeds."""


@pytest.fixture(name="runs", scope="module")
def fixture_runs() -> tuple[list[FinalError], list[FinalError]]:
    """Return a minute of the reference case, by the filter and by iSAM2."""
    scenario = case_in_short("paper")
    return [final_error(scenario, seed) for seed in range(SEEDS)], [
        isam2_error(scenario, seed) for seed in range(SEEDS)
    ]


def angles(runs: list[FinalError]) -> np.ndarray:
    """Return errors of heading, pitch, roll, rad, shape (n, 3)."""
    return np.array([run.angles for run in runs])


@pytest.mark.statistics
def test_the_filters_errors_are_no_larger_and_both_are_consistent(runs) -> None:
    rms_arcsec = [np.sqrt(np.mean(angles(of) ** 2, axis=0)) / ARCSEC for of in runs]
    nees = [np.mean([run.nees for run in of]) for of in runs]
    for name, rms, value in zip(("filter", "iSAM2"), rms_arcsec, nees, strict=True):
        print(f"{name}: RMS {np.round(rms, 2)} arcsec, NEES {value:.2f}")
    ours, theirs = rms_arcsec
    assert np.all(ours <= NO_LARGER * theirs)
    low, high = mean_nees_band(SEEDS, 3)
    assert all(low <= value <= high for value in nees)


@pytest.mark.slow
def test_each_run_ends_at_the_same_attitude_with_the_same_sigma(runs) -> None:
    ours, theirs = runs
    sigma = np.array([run.sigma for run in theirs])
    difference = (angles(ours) - angles(theirs)) / sigma
    assert np.all(np.sqrt(np.mean(difference**2, axis=0)) < SAME_DATA)
    # The filter's sigma is larger with an unresolved fault: the median run has none.
    ratio = np.median(np.array([run.sigma for run in ours]) / sigma, axis=0)
    assert ratio == pytest.approx(1.0, abs=0.01)

"""Fifty seeds of each case of ``make campaign``, in short: is the covariance of the fused attitude consistent?

Each seed gives one error, at the end of its run. The bands contain 99.9 %, from chi-square, for the number of seeds.
"""

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band
from ship_geometry.rotations import ARCSEC
from ship_simulation.run import simulate
from ship_simulation.suite_file import suite_configuration
from ship_testing.campaign_cases import WITHOUT_RECORDING, case_at_length, case_in_short
from ship_testing.consistency import sigma_ratio_band
from ship_testing.trials.monte_carlo import final_error

SEEDS = 50


@pytest.mark.statistics
@pytest.mark.parametrize("name", WITHOUT_RECORDING)
def test_errors_fit_their_covariance(name: str) -> None:
    scenario = case_in_short(name)
    results = [final_error(scenario, seed) for seed in range(SEEDS)]
    nees = np.mean([result.nees for result in results])
    ratio = np.sqrt(np.mean([(result.angles / result.sigma) ** 2 for result in results], axis=0))
    print(f"{name}: NEES {nees:.2f}, RMS/sigma {np.round(ratio, 2)}")
    low, high = mean_nees_band(SEEDS, degrees=3)
    assert low <= nees <= high
    low, high = sigma_ratio_band(SEEDS)
    assert np.all((low <= ratio) & (ratio <= high))


def test_the_configuration_of_the_suite_follows_a_cases_changes() -> None:
    bent, clock = (suite_configuration(case_in_short(name)) for name in ("flexure", "poor_clock"))
    for sensor in bent["star_sensors"].values():
        assert (sensor["flexure_sigma_arcsec"], sensor["flexure_time_s"]) == (5.0, 10.0)
    assert clock["ins"]["time_offset_sigma_s"] == 0.02


def test_half_an_hour_of_clouds_leaves_the_ins_drift() -> None:
    # The tilt of the INS has 10" and a correlation time of 30 min: sqrt(1 - exp(-2 1800/1800)) 10" = 9.30" of new
    # error. The noise of the last sample is 1", and exp(-1) of the 1.3" before the clouds is left.
    scenario = case_in_short("outage")
    expected_arcsec = np.sqrt(9.30**2 + 1.0 + (1.3 * np.exp(-1.0)) ** 2)
    assert final_error(scenario, seed=0).sigma[1] == pytest.approx(expected_arcsec * ARCSEC, rel=0.01)


@pytest.mark.parametrize("at", [case_in_short, case_at_length], ids=["in short", "at length"])
def test_a_sky_of_bright_stars_leaves_none_to_three_in_an_exposure(at) -> None:
    run = simulate(at("few_stars"), seed=0)
    counts = np.concatenate([np.diff(sightings.first) for sightings in run.stars.values()])
    assert set(counts.tolist()) == {0, 1, 2, 3}

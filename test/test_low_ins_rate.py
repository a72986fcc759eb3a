"""An INS of one sample a second in a seaway: is the covariance consistent if interpolation is the largest error?

Each seed gives one error, at the end of its run. The bands contain 99.9 %, from chi-square.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.innovations.gates import mean_nees_band
from ship_estimation.parameters.schema import build
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_configuration
from ship_testing.places import SCENARIOS
from ship_testing.trials.monte_carlo import error_at_end, feed_attitude

SEEDS = 30


@pytest.mark.statistics
def test_errors_fit_their_covariance_in_sea_state_5_at_one_sample_a_second() -> None:
    """Ten exposures share one interpolation error of 7" RMS.

    With ten independent errors in the filter, the mean NEES was 4.9 and the largest 33.
    """
    whole = load_scenario(SCENARIOS / "sea_state_5.yaml")
    scenario = replace(whole, ins=replace(whole.ins, rate_hz=1.0))
    configuration = suite_configuration(scenario)
    configuration = {
        **configuration,
        "ins": {**configuration["ins"], "max_gap_s": 1.5, "silence_s": 3.0},
        "coasting_after_s": 4.5,
    }
    config, nees = build(ShipAttitudeConfig, configuration), []
    for seed in range(SEEDS):
        run = simulate(scenario, seed)
        estimate, _ = feed_attitude(ShipAttitudeCore(config), run)
        nees.append(error_at_end(run, seed, estimate.rotation_nd, estimate.covariance_n).nees)
    print(f"NEES {np.mean(nees):.2f}, greatest {max(nees):.1f}")
    low, high = mean_nees_band(SEEDS, 3)
    assert low <= np.mean(nees) <= high
    assert max(nees) <= chi2.ppf(0.999 ** (1.0 / SEEDS), 3)

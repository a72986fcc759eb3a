"""The solution of an exposure: two sensors of eight stars, over scipy's ``align_vectors`` and numpy's 3 x 3 SVD."""

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench_rows import Row, median_us
from ship_attitude_star.sky.sky_watch import installed_sky
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import Mounted, solve_deck, solve_exposure
from ship_attitude_star.stars.solution import SolutionStatus
from ship_estimation.parameters import build
from ship_replay.trials.monte_carlo import sky_input, star_exposure
from ship_simulation.run import SKY_SOURCES, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite.suite import star_attitude_configuration

SCENARIO = Path(__file__).resolve().parents[1] / "bags" / "scenarios" / "paper_stars.yaml"
MOST_SOLUTION_RATIO = 150.0 / 46.0
"""150 us where scipy's align_vectors with sensitivity takes 46 us."""

_SCIPY = "scipy align_vectors with sensitivity"


def star_solution() -> list[Row]:
    """Two sensors of eight real stars: attitude, covariance by source and residuals, full refreshes apart."""
    scenario = dataclasses.replace(load_scenario(SCENARIO), duration_s=1.0)
    run = simulate(scenario, seed=1)
    config = build(StarAttitudeConfig, star_attitude_configuration(scenario))
    watch = installed_sky(config.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            watch.surroundings.insert(sky_input(run, source, index))
    exposures = [star_exposure(run, id_, 0) for id_ in run.stars]
    time_ns = exposures[0].time_ns
    mounted = [
        Mounted(solve_exposure(exposure, (), None, watch)[0], config.star_sensors[id_].rotation_ds)
        for id_, exposure in zip(run.stars, exposures, strict=True)
    ]
    at_once = np.zeros((len(mounted), 3, len(mounted), 3))
    solved = solve_deck(time_ns, mounted, at_once, config.star_sensors, None).solution
    assert solved.status is SolutionStatus.VALID
    stars = [mounted_.placed.stars for mounted_ in mounted]
    reference = np.concatenate([star.reference_n for star in stars])
    measured = reference @ solved.rotation_nb
    deck_us = median_us(lambda: solve_deck(time_ns, mounted, at_once, config.star_sensors, None))
    place_us = median_us(lambda: [watch.at(time_ns).apparent(exposure.positions) for exposure in exposures])
    scipy_us = median_us(lambda: Rotation.align_vectors(reference, measured, return_sensitivity=True))
    svd_us = median_us(lambda: np.linalg.svd(solved.rotation_nb))
    return [
        Row("star solution, 2 x 8 stars, covariance and residuals: median", deck_us, "us"),
        Row("their places in the sky, two exposures: median", place_us, "us"),
        Row("scipy align_vectors with sensitivity, the same stars: median", scipy_us, "us"),
        Row("ratio: solution, errors by source / scipy's", deck_us / scipy_us, "x", MOST_SOLUTION_RATIO, _SCIPY),
        Row("ratio: the same / numpy 3 x 3 SVD", deck_us / svd_us, "x", None, "numpy 3 x 3 SVD"),
    ]

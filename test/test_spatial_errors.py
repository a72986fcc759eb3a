"""Position-dependent errors of a star on the detector: their model in the suite compared with a simulated detector.

The simulated detector has waves over the field and a constant error of each pixel. The suite models the waves as a
polynomial, and the pixel errors by the pixel dwell. The campaign's case ``spatial_errors`` runs the filter with many
seeds.
"""


from dataclasses import replace

import numpy as np
import pytest

from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import solve_exposure
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_geometry.rotations import log_rotation
from ship_simulation.run import SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.suite_file import star_attitude_configuration
from ship_stars.attitude_from_stars.solution import SOLUTION_TERMS, SolutionStatus
from ship_stars.sky.sky_model import load_sky_model
from ship_testing.campaign_cases import case_in_short
from ship_testing.paper_stars import paper_stars, with_sensor
from ship_testing.trials.monte_carlo import attitude_outcomes, core_for, sky_input, star_exposure

LARGE = {"field_spatial_sigma_px": 0.3, "pixel_spatial_sigma_px": 0.2}
"""Spatial errors of 7″ (field) and 5″ (pixels); the noise is 3″."""

def solve_first_exposure(run: SimulatedRun):
    """Return the attitude of the sensor by the first exposure of a run, and the true attitude (horizon from sensor)."""
    config = build(StarAttitudeConfig, star_attitude_configuration(run.scenario))
    sky_model = load_sky_model(config.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            sky_model.surroundings.insert(sky_input(run, source, index))
    _, outcome = solve_exposure(star_exposure(run, "fore", 0), (), None, sky_model)
    return outcome.solution, run.truth.sightings["fore"].rotation_nv[0]


def test_an_attitude_by_one_exposure_has_them_in_its_covariance_by_name():
    """Each of 60 seeds gives one exposure."""
    scenario = with_sensor(paper_stars(duration_s=0.2), camera=LARGE)
    nees, parts = [], []
    for seed in range(60):
        solution, true_nv = solve_first_exposure(simulate(scenario, seed))
        # One in a thousand exposures is inconsistent by chance, and is rejected.
        if solution.status is SolutionStatus.INVALID:
            continue
        nees.append(normalized_error_squared(log_rotation(true_nv @ solution.rotation_nb.T), solution.covariance_n))
        parts.append(solution.covariance_by_source_n)
    assert len(nees) >= 58
    low, high = mean_nees_band(len(nees), 3)
    assert low <= np.mean(nees) <= high
    sigma = np.sqrt(np.trace(np.mean(parts, axis=0), axis1=-2, axis2=-1))
    by_name = dict(zip(SOLUTION_TERMS, sigma, strict=True))
    # The ratio of the pixel errors to the noise is that of 0.2 px to 0.132 px.
    assert by_name["pixel_spatial"] == pytest.approx(by_name["star_noise"] * 0.2 / 0.13222, rel=0.01)
    assert by_name["field_spatial"] > by_name["pixel_spatial"]


def test_stars_are_identified_despite_spatial_errors():
    """The gate of a detection includes the spatial errors: one in a thousand is outside, not one in five.

    A filter that must identify all stars processes two sensors at a quay for a minute. The spatial errors are 7″ and
    5″, the noise is 3″.
    """
    scenario = case_in_short("spatial_errors")
    nameless = {id_: replace(one, identified=False) for id_, one in scenario.star_sensors.items()}
    scenario = replace(scenario, star_sensors=nameless)
    used, left_out = 0, 0
    for seed in range(4):
        run = simulate(scenario, seed)
        for outcome in attitude_outcomes(core_for(scenario), run, set()):
            for decision in outcome.decisions:
                assert decision.accepted, decision.text
                used, left_out = used + len(decision.components) // 2, left_out + len(decision.rejected_parts)
    assert used > 2000
    assert left_out < 0.01 * used

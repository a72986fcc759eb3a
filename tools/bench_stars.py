"""Cost of the solution from two sensors with eight stars each, relative to scipy and numpy; cost of a late sensor."""

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench_filter import ship_steps_us
from bench_rows import Row, alternate, median_ratio, median_us, own_cpu_s
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import solve_deck, solve_exposure
from ship_estimation.parameters.schema import build
from ship_simulation.run import SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import star_attitude_configuration
from ship_stars.attitude_from_stars.solution import SolutionStatus
from ship_stars.sky.sky_model import load_sky_model
from ship_testing.trials.monte_carlo import core_for, feed_attitude, sky_input, star_exposure

SCENARIO = Path(__file__).resolve().parents[1] / "bags" / "scenarios" / "paper_stars.yaml"
MOST_SOLUTION_RATIO = 150.0 / 46.0
"""Maximum ratio of the solution (150 us) to scipy's align_vectors with sensitivity (46 us)."""

YARDSTICK_SVDS = 5
"""Number of singular value decompositions of a matrix (3, 3)."""

MOST_SVD_RATIO = 5.5
"""Maximum ratio of the solution's time to that of YARDSTICK_SVDS decompositions.

The second linearisation, with the optics' errors, takes half of the solution's time."""
LATE_SENSOR_S = 1.9
"""Delay of a late sensor, s; less than the two seconds of ``lag_s``."""

MOST_LATE_RATIO, MOST_STEPS = 2.0, 1.1
STEPS_COUNTED_S = 60.0
ROUNDS, CALLS = 3, 700

_SCIPY = "scipy align_vectors with sensitivity"


def star_solution() -> list[Row]:
    """Measure the solution from two sensors with eight real stars each: attitude, covariance by source, residuals."""
    scenario = dataclasses.replace(load_scenario(SCENARIO), duration_s=1.0)
    run = simulate(scenario, seed=1)
    config = build(StarAttitudeConfig, star_attitude_configuration(scenario))
    watch = load_sky_model(config.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            watch.surroundings.insert(sky_input(run, source, index))
    exposures, sensors = [star_exposure(run, id_, 0) for id_ in run.stars], config.star_sensors
    time_ns = exposures[0].time_ns
    mounted = [
        dataclasses.replace(solve_exposure(exposure, (), None, watch)[0], rotation_ds=sensors[id_].rotation_ds)
        for id_, exposure in zip(run.stars, exposures, strict=True)
    ]
    at_once = np.zeros((len(mounted), 3, len(mounted), 3))
    solved = solve_deck(time_ns, mounted, at_once, config.star_sensors, None).solution
    assert solved.status is SolutionStatus.VALID
    stars = [placed.stars for placed in mounted]
    reference = np.concatenate([star.reference_n for star in stars])
    measured = reference @ solved.rotation_nb
    deck_us, svd_us, scipy_us = alternate(
        ROUNDS,
        lambda: median_us(lambda: solve_deck(time_ns, mounted, at_once, config.star_sensors, None), CALLS),
        lambda: median_us(lambda: [np.linalg.svd(solved.rotation_nb) for _ in range(YARDSTICK_SVDS)], CALLS),
        lambda: median_us(lambda: Rotation.align_vectors(reference, measured, return_sensitivity=True), CALLS),
    )
    # A sky caches its results, so each call has a new sky.
    place_us = median_us(
        lambda: [
            dataclasses.replace(watch.sky_at(time_ns), _cache={}).apparent_stars(one.positions) for one in exposures
        ]
    )
    by_scipy, by_svd = median_ratio(deck_us, scipy_us), median_ratio(deck_us, svd_us)
    return [
        Row("star solution, 2 x 8 stars, covariance and residuals: median", float(np.median(deck_us)), "us"),
        Row("their places in the sky, two exposures: median", place_us, "us"),
        Row("scipy align_vectors with sensitivity, the same stars: median", float(np.median(scipy_us)), "us"),
        Row("ratio: solution, errors by source / scipy's", by_scipy, "x", MOST_SOLUTION_RATIO, _SCIPY),
        Row(f"ratio: the same / {YARDSTICK_SVDS} numpy 3 x 3 SVDs", by_svd, "x", MOST_SVD_RATIO, "numpy 3 x 3 SVD"),
    ]


def late_star_cost() -> list[Row]:
    """Measure the ship's core over ten seconds, alternately with two sensors on time and with one of the sensors late.

    With all sensors on time, each exposure is one step. Only exposures before the first position fix are applied again,
    because later fixes change no exposure.
    """
    scenario = dataclasses.replace(load_scenario(SCENARIO), duration_s=10.0)
    late = dataclasses.replace(scenario.star_sensors["fore"], latency_s=LATE_SENSOR_S)
    late_scenario = dataclasses.replace(scenario, star_sensors={**scenario.star_sensors, "fore": late})
    on_time, delayed = simulate(scenario, seed=1), simulate(late_scenario, seed=1)
    on_time_s, late_s = alternate(ROUNDS, lambda: _core_cpu_s(on_time), lambda: _core_cpu_s(delayed))
    what = "core over two star sensors on time"
    longer = simulate(dataclasses.replace(scenario, duration_s=STEPS_COUNTED_S), seed=1)
    exposures = sum(source.startswith("star.") for _, source, _ in longer.arrivals())
    steps = len(ship_steps_us(longer, ShipFilter)) / exposures
    return [
        Row("filter's steps per exposure, all on time", steps, "x", MOST_STEPS),
        Row(f"{what}, processor time", float(np.median(on_time_s)), "s"),
        Row(f"the same with one of them {LATE_SENSOR_S} s late", float(np.median(late_s)), "s"),
        Row("ratio: a late star sensor", median_ratio(late_s, on_time_s), "x", MOST_LATE_RATIO, what),
    ]


def _core_cpu_s(run: SimulatedRun) -> float:
    """Return the processor time of the ship's core over a run, with an attitude computed only at its end, s."""
    core = core_for(run.scenario)
    return own_cpu_s(lambda: feed_attitude(core, run))

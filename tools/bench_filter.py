"""Cost of the filters' steps, relative to numpy's 3 x 3 SVD (a stable reference) and with and without integrity."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench_rows import Row, alternate, median_ratio, median_us
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_estimation.parameters.schema import build
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import optical_axis_configuration
from ship_stars.sky.sky_model import load_sky_model
from ship_testing.trials.main_filter_only import ShipFilterWithoutSubfilters, SightingStepWithoutSubfilters
from ship_testing.trials.monte_carlo import core_for, feed_attitude, feed_pointing
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.core import OpticalAxisCore

SCENARIOS = Path(__file__).resolve().parents[1] / "bags" / "scenarios"
STEP_ROUNDS = 5
INTEGRITY_PAIRS = 7
MAX_STEP_US = 30.0
MAX_INTEGRITY_RATIO = 1.6
"""Maximum ratio of step times with and without subfilters."""


def step_cost() -> list[Row]:
    """Measure the ship filter's step alternately with numpy's 3 x 3 SVD, and the theodolite's step by stars."""
    run = run_of("paper", 30.0)
    model = core_for(run.scenario).filter.model
    states, parts = model.size, len(model.sources)
    matrix = np.random.default_rng(1).standard_normal((3, 3))
    step_us, svd_us = alternate(
        STEP_ROUNDS,
        lambda: float(np.median(ship_steps_us(run, ShipFilterWithoutSubfilters))),
        lambda: median_us(lambda: np.linalg.svd(matrix)),
    )
    what = f"step of the ship's filter, {states} states x {parts} parts"
    on_mount = run_of("theodolite_night", 30.0)
    stars_us = [np.median(_theodolite_star_steps_us(on_mount)) for _ in range(STEP_ROUNDS)]
    return [
        Row(f"{what}: median", float(np.median(step_us)), "us", MAX_STEP_US),
        Row("numpy 3 x 3 SVD: median", float(np.median(svd_us)), "us"),
        Row(f"ratio: {what} / SVD", median_ratio(step_us, svd_us), "x", None, "numpy 3 x 3 SVD"),
        Row("theodolite's step by stars on the mount: median", float(np.median(stars_us)), "us"),
    ]


class _WithPairs(ShipFilter):
    """Filter whose step also updates the subfilters that exclude a pair of sources."""

    def __init__(self, config: ShipAttitudeConfig) -> None:
        pairs = dataclasses.replace(config.integrity, pairs=True, max_hypotheses=64)
        super().__init__(dataclasses.replace(config, integrity=pairs))


def integrity_cost() -> list[Row]:
    """Measure the filters' steps alternately with and without subfilters."""
    ship, theodolite = run_of("three_sensors", 20.0), run_of("theodolite", 60.0)
    of_ship = "ship's step by three star sensors"
    return [
        *_integrity_rows(of_ship, ship_steps_us, ship, ShipFilterWithoutSubfilters, ShipFilter),
        *_integrity_rows(
            f"{of_ship}, integrity.pairs", ship_steps_us, ship, ShipFilterWithoutSubfilters, _WithPairs, None
        ),
        *_integrity_rows(
            "theodolite's step by two lights",
            _theodolite_steps_us,
            theodolite,
            SightingStepWithoutSubfilters,
            SightingStep,
        ),
    ]


def _integrity_rows(
    what: str,
    steps_us: Callable[[SimulatedRun, Any], list[float]],
    run: SimulatedRun,
    without: type,
    with_: type,
    most: float | None = MAX_INTEGRITY_RATIO,
) -> list[Row]:
    pairs = [(steps_us(run, without), steps_us(run, with_)) for _ in range(INTEGRITY_PAIRS)]
    # The minimum of each step is used, because other load of the machine only increases the times.
    without_us, with_us = np.median(np.min(pairs, axis=0), axis=-1)
    return [
        Row(f"{what}, one estimate: median", without_us, "us"),
        Row("the same with integrity: median", with_us, "us"),
        Row("ratio: integrity", with_us / without_us, "x", most),
    ]


def run_of(scenario: str, duration_s: float) -> SimulatedRun:
    """Simulate some seconds of a scenario of the repository."""
    found = load_scenario(SCENARIOS / f"{scenario}.yaml")
    return simulate(dataclasses.replace(found, duration_s=duration_s), seed=1)


def ship_steps_us(run: SimulatedRun, kind: type[ShipFilter]) -> list[float]:
    """Return the time of each step of a filter over a run, us."""
    core = core_for(run.scenario)
    core.filter = kind(core.config)
    core.reset()
    core.filter.step, times_us = _TimedStep(core.filter.step)  # type: ignore[method-assign]
    feed_attitude(core, run)
    return times_us


def _theodolite_steps_us(run: SimulatedRun, kind: type[SightingStep]) -> list[float]:
    """Return the time of each step over a run, us."""
    config = build(OpticalAxisConfig, optical_axis_configuration(run.scenario))
    core = OpticalAxisCore(config)
    core._step_to, times_us = _TimedStep(kind(config, core.filter))
    feed_pointing(core, run)
    return times_us


def _theodolite_star_steps_us(run: SimulatedRun) -> list[float]:
    """Return the time of each step by an exposure of stars over a run, us."""
    config = build(OpticalAxisConfig, optical_axis_configuration(run.scenario))
    core = OpticalAxisCore(config, sky=load_sky_model(config.sky))
    core._step_to_stars, times_us = _TimedStep(core._step_to_stars)  # type: ignore[arg-type]
    feed_pointing(core, run)
    return times_us


def _TimedStep(step: Callable[..., Any]) -> tuple[Any, list[float]]:
    """Return a step that records the duration of each call, and the list of these durations, us."""
    times_us: list[float] = []

    def measure_step(*arguments: Any) -> Any:
        begin_ns = time.perf_counter_ns()
        result = step(*arguments)
        times_us.append((time.perf_counter_ns() - begin_ns) * 1e-3)
        return result

    return measure_step, times_us

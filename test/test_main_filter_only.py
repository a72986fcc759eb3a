"""The subfilters do not change the main filter: without faults its estimates are equal with and without subfilters.

So integrity does not increase the RMS error. Inconsistent subfilters only increase the covariance.
"""

from dataclasses import replace

import numpy as np

from ship_estimation.parameters.schema import build
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import optical_axis_configuration
from ship_testing.places import ROOT
from ship_testing.trials.main_filter_only import ShipFilterWithoutSubfilters, SightingStepWithoutSubfilters
from ship_testing.trials.monte_carlo import attitude_outcomes, core_for, pointing_outcomes
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.core import OpticalAxisCore


def run_of(scenario: str, duration_s: float) -> SimulatedRun:
    found = load_scenario(ROOT / "bags" / "scenarios" / f"{scenario}.yaml")
    return simulate(replace(found, duration_s=duration_s), seed=1)


def test_the_ships_attitude_is_that_of_the_main_filter_alone() -> None:
    run = run_of("three_sensors", 20.0)
    cores = core_for(run.scenario), core_for(run.scenario)
    cores[1].filter = ShipFilterWithoutSubfilters(cores[1].config)
    cores[1].reset()
    every_ns = set(run.ins.time_ns[::20].tolist())
    runs = [list(attitude_outcomes(core, run, every_ns)) for core in cores]
    with_subfilters, alone = ([one for outcome in outcomes for one in outcome.estimates] for outcomes in runs)
    # Without subfilters there is no gate; with subfilters the gate rejects nothing.
    accepted, all_accepted = ([one.accepted for outcome in outcomes for one in outcome.decisions] for outcomes in runs)
    assert accepted == all_accepted
    assert len(with_subfilters) == len(alone) > 100
    for one, other in zip(with_subfilters, alone, strict=True):
        assert (one.time_ns, one.status, one.sources) == (other.time_ns, other.status, other.sources)
        np.testing.assert_allclose(one.rotation_nd, other.rotation_nd, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(one.covariance_without_separation_n, other.covariance_n, rtol=1e-9)
        wider_n = one.covariance_n - one.covariance_without_separation_n
        assert np.linalg.eigvalsh(wider_n).min() >= -1e-12 * np.trace(one.covariance_n)
        assert wider_n.any() == (one.state.separation_covariance_n is not None)
    assert any(one.state.separation_covariance_n is not None for one in with_subfilters)


def test_the_pointing_is_that_of_the_main_filter_alone() -> None:
    run = run_of("theodolite", 30.0)
    config = build(OpticalAxisConfig, optical_axis_configuration(run.scenario))
    runs = []
    for step in (SightingStep, SightingStepWithoutSubfilters):
        core = OpticalAxisCore(config)
        core._step_to = step(config, core.filter)
        runs.append([one for outcome in pointing_outcomes(core, run) for one in outcome.estimates])
    with_subfilters, alone = runs
    assert len(with_subfilters) == len(alone) > 1000
    for one, other in zip(with_subfilters, alone, strict=True):
        assert (one.time_ns, one.status, one.mode) == (other.time_ns, other.status, other.mode)
        assert one.rotation_nm.tobytes() == other.rotation_nm.tobytes()
        assert one.covariance_without_separation_n.tobytes() == other.covariance_n.tobytes()
    assert any((one.covariance_n != one.covariance_without_separation_n).any() for one in with_subfilters)

"""Observability of states, and predicted effect of a turn, compared with a filter of a ship that turns."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.observability import RecommendedTurn, observability_of, recommended_manoeuvre
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion, Outage, Turn
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_testing.trials.monte_carlo import attitude_outcomes, core_for

SCENARIOS = Path(__file__).parents[3] / "bags" / "scenarios"


def voyage(turn_deg: float, duration_s: float) -> Scenario:
    """Return a scenario without waves, with low rates; the ship turns after five minutes unless ``turn_deg`` is 0."""
    whole = load_scenario(SCENARIOS / "turn.yaml")
    still = AngleMotion(mean_deg=34.4), AngleMotion(mean_deg=0.5), AngleMotion(mean_deg=2.0)
    turn = Turn(start_s=300.0, angle_deg=turn_deg, rate_deg_per_s=1.0, ramp_s=5.0) if turn_deg else Turn()
    carrier = CarrierMotion(kind="sinusoids", heading=still[0], pitch=still[1], roll=still[2], turn=turn)
    sensors = {id_: replace(one, rate_hz=0.5, phase_s=0.0) for id_, one in whole.star_sensors.items()}
    ins = replace(whole.ins, rate_hz=10.0, time_offset_sigma_s=0.0)
    return replace(whole, carrier=carrier, star_sensors=sensors, ins=ins, duration_s=duration_s)


def run_voyage(scenario: Scenario) -> ShipAttitudeCore:
    core, run = core_for(scenario), simulate(scenario, 1)
    for _ in attitude_outcomes(core, run, {int(run.ins.time_ns[-1])}):
        pass
    return core


def sigmas_arcsec(core: ShipAttitudeCore) -> tuple[float, float]:
    rows = core.filter.model.state_indices("ins.attitude")
    north, up, east = core.state.covariance[rows, rows]
    return np.sqrt(up) / ARCSEC, np.sqrt(0.5 * (north + east)) / ARCSEC


def test_at_constant_heading_sums_are_observable_and_combinations_are_not() -> None:
    core = run_voyage(voyage(0.0, 290.0))
    observability = observability_of(core.filter, core.config, core.state)
    # Mounting sigmas are 1″, INS sigmas 10″ and 72″: INS errors are observable, mounting errors hardly.
    assert observability.sigma_ratios["ins.up"] < 0.05
    assert observability.sigma_ratios["star.fore.up"] > 0.5
    assert any("star.fore" in words for words in observability.unobservable_combinations)
    # The other sensor makes the roll about the fore sensor's boresight observable: prior 20″, noise 100″ in each of 145
    # exposures.
    assert observability.sigma_ratios["star.fore.forward"] < 0.5


def test_before_any_star_nothing_is_observed() -> None:
    core = core_for(voyage(0.0, 10.0))
    observability = observability_of(core.filter, core.config, core.state)
    assert set(observability.sigma_ratios.values()) == {1.0}
    assert len(observability.unobservable_combinations) == len(observability.sigma_ratios)


def turn_of(core: ShipAttitudeCore, rotation_nd: FloatArray) -> RecommendedTurn | None:
    return recommended_manoeuvre(core.filter, core.state, rotation_nd, core.recent_sources)


def with_mounting_sigma_5_arcsec(scenario: Scenario) -> Scenario:
    loose = {"installation_sigma_up_arcsec": 5.0, "installation_sigma_right_arcsec": 5.0}
    sensors = {id_: replace(one, **loose) for id_, one in scenario.star_sensors.items()}
    return replace(scenario, star_sensors=sensors)


@pytest.mark.slow
def test_a_turn_improves_the_attitude_as_predicted() -> None:
    # 34.4° of heading, 0.5° of pitch, 2° of roll.
    attitude_nd = rotation_from_angles(*np.deg2rad([34.4, 0.5, 2.0]))
    manoeuvre = turn_of(run_voyage(with_mounting_sigma_5_arcsec(voyage(0.0, 290.0))), attitude_nd)
    assert manoeuvre is not None
    turned = run_voyage(with_mounting_sigma_5_arcsec(voyage(manoeuvre.turn_deg, 1200.0 + manoeuvre.turn_deg)))
    straight = run_voyage(with_mounting_sigma_5_arcsec(voyage(0.0, 1190.0)))
    assert manoeuvre.quantity == "tilt"
    assert sigmas_arcsec(straight)[1] == pytest.approx(manoeuvre.sigma_on_course / ARCSEC, rel=0.03)
    assert sigmas_arcsec(turned)[1] == pytest.approx(manoeuvre.sigma_after_turn / ARCSEC, rel=0.05)
    assert manoeuvre.sigma_after_turn < 0.7 * manoeuvre.sigma_on_course


def test_with_a_well_surveyed_mounting_no_turn_is_recommended() -> None:
    assert turn_of(run_voyage(voyage(0.0, 290.0)), np.eye(3)) is None


def test_without_stars_no_turn_is_recommended() -> None:
    assert turn_of(core_for(voyage(0.0, 10.0)), np.eye(3)) is None


def test_after_one_measurement_no_turn_is_recommended() -> None:
    # Diagnostics are published at any time, also between the first exposure and the second.
    core = run_voyage(with_mounting_sigma_5_arcsec(voyage(0.0, 1.0)))
    assert core.state.last_used_ns
    assert turn_of(core, np.eye(3)) is None


def test_a_timed_out_source_does_not_count() -> None:
    whole = with_mounting_sigma_5_arcsec(voyage(0.0, 290.0))
    fore = replace(whole.star_sensors["fore"], outages={"clouds": Outage(start_s=100.0, end_s=1000.0)})
    gone = run_voyage(replace(whole, star_sensors=whole.star_sensors | {"fore": fore}))
    both = turn_of(run_voyage(whole), np.eye(3))
    manoeuvre = turn_of(gone, np.eye(3))
    # A sensor's noise about the boresight is 100″: the tilt from a single sensor is worse after any turn.
    assert both is not None
    assert manoeuvre is None or manoeuvre.sigma_after_turn > 1.3 * both.sigma_after_turn

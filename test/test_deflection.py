"""Deflection of the vertical, under clouds and alongside: an INS follows gravity, stars refer to the ellipsoid.

The scenario is ``deflection.yaml``, without waves and with fewer samples, which does not change what is tested. The
bands are of 99.9 %, from chi-square, for the number of seeds.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import ParameterError, build
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion, Outage
from ship_simulation.scenario.scenario import Gravity, Reference, Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_configuration
from ship_stars.attitude_samples import AttitudeEstimate, Horizon
from ship_testing.trials.monte_carlo import attitude_outcomes

SCENARIO = Path(__file__).parents[1] / "bags" / "scenarios" / "deflection.yaml"
SEEDS = 6
STILL = CarrierMotion(
    kind="sinusoids", heading=AngleMotion(mean_deg=5.0), pitch=AngleMotion(mean_deg=0.5), roll=AngleMotion(mean_deg=2.0)
)


def voyage(gravity: Gravity | None = None, **changes: Any) -> Scenario:
    """Return the scenario with fewer samples, and other changes."""
    whole = load_scenario(SCENARIO)
    sensors = {id_: replace(one, rate_hz=0.1, phase_s=0.0) for id_, one in whole.star_sensors.items()}
    ins = replace(whole.ins, rate_hz=1.0, time_offset_sigma_s=0.0)
    position = replace(whole.position, rate_hz=0.1)
    gravity = gravity or whole.gravity
    thin = replace(whole, carrier=STILL, ins=ins, star_sensors=sensors, position=position, gravity=gravity)
    return replace(thin, **changes)


def core_of(scenario: Scenario, **parameters: Any) -> ShipAttitudeCore:
    configuration = suite_configuration(scenario)
    return ShipAttitudeCore(build(ShipAttitudeConfig, {**configuration, **parameters}))


def last_estimate(core: ShipAttitudeCore, run: SimulatedRun) -> AttitudeEstimate:
    (estimate,) = (
        estimate
        for outcome in attitude_outcomes(core, run, {int(run.ins.time_ns[-1])})
        for estimate in outcome.estimates[-1:]
        if estimate.time_ns == run.ins.time_ns[-1]
    )
    return estimate


def error_n(run: SimulatedRun, estimate: AttitudeEstimate) -> np.ndarray:
    return log_rotation(run.truth.rotation_nd[-1] @ estimate.rotation_nd.T)


def without_clouds(scenario: Scenario) -> Scenario:
    """Return the scenario without clouds."""
    return replace(scenario, star_sensors={id_: replace(one, outages={}) for id_, one in scenario.star_sensors.items()})


@pytest.mark.statistics
def test_with_the_table_eighty_minutes_of_cloud_cost_three_arcseconds_more() -> None:
    # Issue: with the table, the RMS of the additional tilt error is at most 3 arcseconds, compared with the same seed
    # without deflection. The additional error is the difference of both errors. It is due to the part of the deflection
    # that the table does not contain.
    more = []
    for seed in range(SEEDS):
        errors = []
        for gravity, expected in ((None, Horizon.GEODETIC), (Gravity(), Horizon.GRAVITY)):
            scenario = voyage(gravity)
            run = simulate(scenario, seed)
            estimate = last_estimate(core_of(scenario), run)
            errors.append(error_n(run, estimate)[[0, 2]])
            assert (estimate.horizon, estimate.status) == (expected, Status.COASTING)
        more.append(errors[0] - errors[1])
    assert np.sqrt(np.mean(np.square(more))) < 3.0 * ARCSEC


@pytest.mark.statistics
def test_the_attitude_is_consistent_without_the_table() -> None:
    # The deflection is drawn by the filter's model: 20 arcseconds over 30 km. test_campaign_cases.py tests the table.
    gravity = Gravity(sigma_arcsec=20.0, told="unknown", told_unknown_sigma_arcsec=20.0)
    nees = []
    for seed in range(SEEDS):
        scenario = voyage(gravity)
        run = simulate(scenario, 100 + seed)
        estimate = last_estimate(core_of(scenario), run)
        nees.append(float(normalized_error_squared(error_n(run, estimate), estimate.covariance_n)))
    low, high = mean_nees_band(SEEDS, 3)
    assert low < np.mean(nees) < high


@pytest.mark.slow
def test_alongside_an_hour_of_stars_determines_the_deflection() -> None:
    # Issue: the sigma of the deflection is at most 1.5 arcseconds after an hour if the INS's tilt sigma is 1 arcsecond.
    squares = []
    for seed in range(SEEDS):
        scenario = without_clouds(voyage(Gravity(sigma_arcsec=7.7, told="unknown"), duration_s=3600.0))
        position, ins = replace(scenario.position, speed_m_per_s=0.0), replace(scenario.ins, tilt_sigma_arcsec=1.0)
        scenario = replace(scenario, position=position, ins=ins)
        run, core = simulate(scenario, 200 + seed), core_of(scenario)
        estimate = core.output.deflection(last_estimate(core, run).time_ns)
        assert estimate is not None
        assert estimate.covariance is not None
        assert np.all(np.sqrt(estimate.covariance.diagonal()) < 1.5 * ARCSEC)
        error = estimate.deflection - run.truth.deflection[-1]
        squares.append(float(normalized_error_squared(error, estimate.covariance)))
    low, high = mean_nees_band(SEEDS, 2)
    assert low < np.mean(squares) < high


@pytest.mark.statistics
def test_gravitys_horizon_differs_by_the_deflection_and_is_consistent() -> None:
    nees = []
    for seed in range(SEEDS):
        scenario = without_clouds(voyage(duration_s=2400.0))
        run = simulate(scenario, 300 + seed)
        estimates = [last_estimate(core_of(scenario, horizon=horizon), run) for horizon in ("geodetic", "gravity")]
        geodetic, gravity = estimates
        assert (geodetic.horizon, gravity.horizon) == (Horizon.GEODETIC, Horizon.GRAVITY)
        xi, eta = run.truth.deflection[-1]
        latitude_deg, _ = run.truth.track.latitude_longitude_deg(run.ins.time_ns[-1:])
        turn_n = np.array([eta, eta * np.tan(np.deg2rad(latitude_deg[0])), -xi])
        true_nd = exp_rotation(-turn_n) @ run.truth.rotation_nd[-1]
        error = log_rotation(true_nd @ gravity.rotation_nd.T)
        nees.append(float(normalized_error_squared(error, gravity.covariance_n)))
        # The attitudes differ by the deflection, except the arcsecond that is not in the table.
        between_n = log_rotation(geodetic.rotation_nd @ gravity.rotation_nd.T)
        np.testing.assert_allclose(between_n[[0, 2]], turn_n[[0, 2]], atol=4.0 * ARCSEC)
        np.testing.assert_allclose(gravity.covariance_by_source_n.sum(axis=0), gravity.covariance_n, rtol=1e-9)
    low, high = mean_nees_band(SEEDS, 3)
    assert low < np.mean(nees) < high


def test_a_topic_gives_the_same_as_the_table() -> None:
    scenario = without_clouds(voyage(duration_s=2400.0))
    by_topic = replace(scenario, gravity=replace(scenario.gravity, told="topic"))
    table, topic = (
        last_estimate(core_of(one), simulate(one, 400)) for one in (scenario, by_topic)
    )
    # The topic has a message every ten seconds; in this time the deflection changes by 0.3 arcseconds at most.
    np.testing.assert_allclose(topic.covariance_n, table.covariance_n, rtol=1e-3)
    assert np.linalg.norm(log_rotation(topic.rotation_nd @ table.rotation_nd.T)) < 0.3 * ARCSEC


def test_another_attitude_system_follows_gravity_too() -> None:
    # A reference compared with the ellipsoid would contradict the stars by 51 arcseconds.
    gravity = Gravity(xi_arcsec=-51.0, told="constant", sigma_arcsec=1.0)
    scenario = without_clouds(voyage(gravity, duration_s=600.0))
    reference = Reference(
        installation_sigma_arcsec=1.0,
        sigma_roll_arcsec=2.0,
        sigma_pitch_arcsec=2.0,
        sigma_heading_arcsec=2.0,
        time_offset_sigma_s=0.0,
    )
    scenario = replace(scenario, references={"second": reference})
    run = simulate(scenario, 7)
    decisions = [d for outcome in attitude_outcomes(core_of(scenario), run, ()) for d in outcome.decisions]
    used = [d for d in decisions if d.measurement.source == "reference.second"]
    assert len(used) > 500
    assert sum(not d.accepted for d in used) <= 2


def test_an_ins_alone_is_geodetic_where_the_deflection_is_given() -> None:
    for gravity, expected in (
        (Gravity(xi_arcsec=20.0, told="constant"), Horizon.GEODETIC),
        (Gravity(sigma_arcsec=7.7, told="unknown"), Horizon.GRAVITY),
        (Gravity(xi_arcsec=20.0), Horizon.GRAVITY),
    ):
        scenario = voyage(gravity, star_sensors={}, duration_s=10.0)
        estimate = last_estimate(core_of(scenario), simulate(scenario, 1))
        assert (estimate.horizon, estimate.status) == (expected, Status.DEGRADED)


def test_a_table_with_a_gap_under_the_ship_is_named_and_the_covariance_grows() -> None:
    # The rows from 28 to 46 km are missing. After an hour the ship is in this gap, and has been under clouds for 40
    # minutes.
    scenario = voyage(duration_s=3600.0)
    config = suite_configuration(scenario)
    gravity = config["gravity"]
    keep = [index for index in range(len(gravity["table_xi_arcsec"])) if not 13 < index < 24]
    for column in [name for name in gravity if name.startswith("table_")]:
        gravity[column] = [gravity[column][index] for index in keep]
    core = ShipAttitudeCore(build(ShipAttitudeConfig, {**config, "gravity": {**gravity, "table_reach_m": 5000.0}}))
    run = simulate(scenario, 5)
    estimate = last_estimate(core, run)
    assert core.vertical is not None
    assert "no row of the deflection table near the ship" in core.vertical.missing_data_text(estimate.time_ns)
    whole = last_estimate(core_of(scenario), run)
    assert estimate.covariance_n[2, 2] > whole.covariance_n[2, 2] + (3.0 * ARCSEC) ** 2
    assert estimate.status is Status.COASTING


def test_fixes_in_another_order_end_in_the_same() -> None:
    scenario = voyage(duration_s=300.0)
    run = simulate(scenario, 9)
    ends = []
    for late_s in (0.0, 1.5):
        core = core_of(scenario)
        delayed = [
            (time_ns + (round(late_s * 1e9) if source == "fix" else 0), source, index)
            for time_ns, source, index in run.arrivals()
        ]
        changed = _RearrangedRun(run, sorted(delayed, key=lambda one: one[0]))
        for _ in attitude_outcomes(core, changed, ()):
            pass
        ends.append(core.state)
    np.testing.assert_array_equal(ends[0].means, ends[1].means)
    np.testing.assert_array_equal(ends[0].stack, ends[1].stack)


class _RearrangedRun:
    """Run whose inputs arrive in another order."""

    def __init__(self, run: SimulatedRun, arrivals: list[tuple[int, str, int]]) -> None:
        self._run, self._arrivals = run, arrivals

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def arrivals(self) -> list[tuple[int, str, int]]:
        return self._arrivals


def test_gravitys_horizon_needs_the_deflection() -> None:
    with pytest.raises(ParameterError, match=r"'horizon' = gravity: set gravity\.deflection"):
        build(ShipAttitudeConfig, {"horizon": "gravity"})


def test_outage_of_the_scenario_is_eighty_minutes() -> None:
    scenario = load_scenario(SCENARIO)
    assert {star.outages["clouds"] for star in scenario.star_sensors.values()} == {Outage(1200.0, 6000.0)}

"""Smoothing is consistent: on drawn voyages, over a gap of the stars, across a jump of the INS, with a faulty sensor.

The bands are of 99.9 %, from chi-square, for the number of seeds.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from ship_attitude_star.messages.attitude_messages import SMOOTHED_TOPIC, smoothed_message
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.smoothing import SmoothingCore
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.fields import FRAME_NAMES
from ship_estimation.parameters.schema import build
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_configuration
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeMeasurement
from ship_testing.adapter_runs import FACTORY, SECOND_NS, START_NS, stamp_of
from ship_testing.ins_streams import SWELL, attitudes, stream, with_step
from ship_testing.small_voyage import new_adapter, run_adapter, voyage
from ship_testing.trials.monte_carlo import attitude_outcomes

SCENARIOS = Path(__file__).parents[1] / "bags" / "scenarios"
SEEDS = 16


class EstimatePair(NamedTuple):
    """The attitude of each stamp, filtered and smoothed."""

    filtered: list[AttitudeEstimate]
    smoothed: list[AttitudeEstimate]


# -- drawn voyages ------------------------------------------------------------------------------------------------


def reduced_scenario(name: str, duration_s: float, gap_s: tuple[float, float]) -> Scenario:
    """Return a scenario with fewer samples, and with clouds for a time span."""
    whole, clouds = load_scenario(SCENARIOS / name), {"gap": Outage(*gap_s)}
    sensors = {id_: replace(one, rate_hz=1.0, outages=clouds) for id_, one in whole.star_sensors.items()}
    return replace(whole, duration_s=duration_s, ins=replace(whole.ins, rate_hz=10.0), star_sensors=sensors)


def run_voyage(scenario: Scenario, seed: int, output_times_s: list[float]) -> tuple[EstimatePair, np.ndarray]:
    """Return the outputs at some times, and the true attitudes, shape (n, 3, 3)."""
    run = simulate(scenario, seed)
    stamps = run.ins.time_ns[run.truth.ins_index]
    rows = [int(np.searchsorted(stamps, stamps[0] + round(second * 1e9))) for second in output_times_s]
    core = SmoothingCore(build(ShipAttitudeConfig, suite_configuration(scenario)), None, None)
    pair = EstimatePair([], [])
    for outcome in attitude_outcomes(core, run, set(stamps[rows].tolist())):
        pair.filtered.extend(outcome.estimates)
        assert core.take_smoothed() == []
    pair.smoothed.extend(core.smooth_remaining())
    assert [one.time_ns for one in pair.smoothed] == [one.time_ns for one in pair.filtered] == stamps[rows].tolist()
    return pair, run.truth.rotation_nd[rows]


def nees(estimates: list[AttitudeEstimate], true_nd: np.ndarray) -> list[float]:
    errors = [log_rotation(true @ one.rotation_nd.T) for one, true in zip(estimates, true_nd, strict=True)]
    pairs = zip(errors, estimates, strict=True)
    return [float(normalized_error_squared(error, one.covariance_n)) for error, one in pairs]


def sigmas_arcsec(estimates: list[AttitudeEstimate]) -> np.ndarray:
    return np.array([np.sqrt(one.covariance_n.diagonal()) for one in estimates]) / ARCSEC


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("name", "epochs_s"),
    [
        # Times before and after the first star, in the gap of the stars, after the gap, and at the end.
        ("demo.yaml", [0.0, 3.0, 30.0, 47.0, 59.8]),
        ("deflection.yaml", [3.0, 30.0, 47.0, 59.8]),
        ("schuler.yaml", [3.0, 30.0, 47.0, 59.8]),
    ],
)
def test_smoothed_attitudes_are_consistent(name: str, epochs_s: list[float]) -> None:
    scenario, found, worth = reduced_scenario(name, 60.0, (20.0, 40.0)), [], []
    for seed in range(SEEDS):
        pair, true_nd = run_voyage(scenario, 100 + seed, epochs_s)
        at_once, smoothed = sigmas_arcsec(pair.filtered), sigmas_arcsec(pair.smoothed)
        assert np.all(smoothed <= at_once * (1.0 + 1e-6))
        assert [one.status for one in pair.smoothed] == [one.status for one in pair.filtered]
        worth.append(smoothed / at_once)
        found.append(nees(pair.smoothed, true_nd))
    low, high = mean_nees_band(SEEDS, 3)
    for mean_nees in np.mean(found, axis=0):
        assert low < mean_nees < high
    # The first attitudes gain most; at the end there are no later measurements.
    assert np.all(np.mean(worth, axis=0)[0] < 0.9)
    np.testing.assert_allclose(np.mean(worth, axis=0)[-1], 1.0, atol=0.05)


# -- an INS that jumps, and a sensor that is faulty -----------------------------------------------------------------

SENSORS = {"fore": (0.0, 45.0), "starboard": (90.0, 45.0), "aft": (180.0, 45.0)}
JUMP = 762
"""Number of the first sample after a jump of the INS."""

NOISE = np.array([60.0, 3.0, 3.0]) * ARCSEC
MOUNTED = np.array([20.0, 5.0, 5.0]) * ARCSEC
CONFIG = build(
    ShipAttitudeConfig,
    {
        "ins": {"white_sigma_arcsec": 1.0, "time_offset_sigma_s": 0.005},
        "star_sensors": {
            id_: {
                "azimuth_deg": azimuth_deg,
                "elevation_deg": elevation_deg,
                "installation_sigma_up_arcsec": 5.0,
                "installation_sigma_right_arcsec": 5.0,
            }
            for id_, (azimuth_deg, elevation_deg) in SENSORS.items()
        },
    },
)


def smooth_faulty_voyage(ins: list[AttitudeSample], fault_arcsec: float, seed: int) -> tuple[EstimatePair, np.ndarray]:
    """Return thirty seconds with three sensors, one rotated from 15 s on; smoothed each half second and at JUMP - 1."""
    rng, core, pair, first_ns = (
        np.random.default_rng(seed),
        SmoothingCore(CONFIG, None, None),
        EstimatePair([], []),
        10**18,
    )
    mounted = {id_: exp_rotation(MOUNTED * rng.standard_normal(3)) for id_ in SENSORS}
    epochs_s = []
    for number, sample in enumerate(ins):
        since_s = (sample.time_ns - first_ns) * 1e-9
        if number % 10 == 0:
            for id_, angles_deg in SENSORS.items():
                shift = exp_rotation(np.array([0.0, 0.0, fault_arcsec * ARCSEC * (id_ == "aft" and since_s > 15.0)]))
                sensor = rotation_from_angles(*np.deg2rad([*angles_deg, 0.0])) @ mounted[id_] @ shift
                true_nd = attitudes(np.array([since_s]), SWELL)[0]
                rotation = true_nd @ sensor @ exp_rotation(NOISE * rng.standard_normal(3))
                core.add_measurement(AttitudeMeasurement(f"star.{id_}", sample.time_ns, rotation, np.diag(NOISE**2)))
        outcome = core.ins.add(sample, estimate=number % 25 == 5 or number == JUMP - 1)
        pair.filtered.extend(outcome.estimates)
        epochs_s += [since_s] * len(outcome.estimates)
        core.take_smoothed()
    pair.smoothed.extend(core.smooth_remaining())
    assert len(pair.smoothed) == len(pair.filtered) == 61
    return pair, attitudes(np.array(epochs_s), SWELL)


def slow_error(seed: int) -> tuple[float, float, float]:
    north, up, east = np.array([10.0, 72.0, 10.0]) * np.random.default_rng(1000 + seed).standard_normal(3)
    return north, up, east


@pytest.mark.statistics
def test_smoothing_across_a_jump_of_the_ins_is_consistent() -> None:
    # The heading jumps by 200 arcseconds, which the INS's rates show: the error begins at the jump. The covariance is
    # increased from five sigmas of the INS's clock before the jump on. The sample before the jump still determines the
    # attitudes before it.
    found = []
    for seed in range(SEEDS // 2):
        ins = with_step(stream(30.0, 50.0, seed=seed), 0, slow_error(seed))
        pair, true_nd = smooth_faulty_voyage(with_step(ins, JUMP, (20.0, 200.0, -30.0)), 0.0, seed)
        assert np.all(sigmas_arcsec(pair.smoothed) <= sigmas_arcsec(pair.filtered) * (1.0 + 1e-6))
        found.append(nees(pair.smoothed, true_nd))
    low, high = mean_nees_band(SEEDS // 2, 3)
    before_the_jump = [number for number in range(JUMP) if number % 25 == 5 or number == JUMP - 1].index(JUMP - 1)
    for mean_nees in np.mean(found, axis=0)[[0, 10, 20, 29, before_the_jump, before_the_jump + 1, 40, 50, 60]]:
        assert low < mean_nees < high


def test_an_excluded_sensor_has_no_effect_on_smoothing() -> None:
    # The fault of one arcminute has an effect for a second. The subfilters and the smoother restart after the
    # exclusion.
    ins = with_step(stream(30.0, 50.0), 0, slow_error(0))
    pair, true_nd = smooth_faulty_voyage(ins, 60.0, 0)
    assert any("star.aft" not in one.sources for one in pair.filtered[35:])
    assert [one.status for one in pair.smoothed] == [one.status for one in pair.filtered]
    # Chi-square of three degrees of freedom exceeds 21.1 once in ten thousand.
    assert max(nees(pair.smoothed, true_nd)) < 21.1


# -- with a fixed lag ---------------------------------------------------------------------------------------------


def test_with_a_lag_each_attitude_is_also_published_smoothed_and_nothing_else_changes() -> None:
    arrivals, lag_s = voyage(12.0), 4.0
    run, plain = run_adapter(new_adapter(smoothing_lag_s=lag_s), arrivals), run_adapter(new_adapter(), arrivals)
    assert [result for result in run.results() if result[1] != SMOOTHED_TOPIC] == plain.results()
    assert not plain.messages(SMOOTHED_TOPIC)
    at_once = {stamp_of(message): message for message in run.messages("ship/attitude")}
    smoothed = run.messages(SMOOTHED_TOPIC)
    stamps = [stamp_of(message) for message in smoothed]
    assert stamps == list(at_once)[: len(stamps)]
    assert stamps[-1] >= list(at_once)[-1] - lag_s * SECOND_NS - 0.05 * SECOND_NS
    for now_ns, topic, message in run.published:
        if topic == SMOOTHED_TOPIC:
            assert 0.0 <= (now_ns - stamp_of(message)) / SECOND_NS - lag_s < 0.1
    whole = whole_run(arrivals)
    for message in smoothed:
        stamp_ns = stamp_of(message)
        at_last, variances = whole[stamp_ns], np.diagonal(message.covariance.reshape(3, 3))
        assert message.status == at_once[stamp_ns].status
        assert np.all(variances <= np.diagonal(at_once[stamp_ns].covariance.reshape(3, 3)) * (1.0 + 1e-6))
        # Smoothing with all inputs also uses the data after the lag.
        assert np.all(np.diagonal(at_last.covariance.reshape(3, 3)) <= variances * (1.0 + 1e-6))
    again = run_adapter(new_adapter(smoothing_lag_s=lag_s), arrivals)
    assert again.results() == run.results()


def whole_run(arrivals: tuple) -> dict[int, object]:
    """Return stamp → message, smoothed with all inputs."""
    adapter = new_adapter()
    core = adapter.core = SmoothingCore(adapter.config, None, None)
    adapter.set_parameters({})  # the methods that feed the core are bound again
    run_adapter(adapter, arrivals)
    return {one.time_ns: smoothed_message(FACTORY, one, FRAME_NAMES)[1] for one in core.smooth_remaining()}


def test_a_lag_shorter_than_late_data_waits_for_them() -> None:
    # Data may come 2 s late, and a gap of the INS may be as long as 0.5 s: before that nothing is final.
    run = run_adapter(new_adapter(smoothing_lag_s=0.1), voyage(8.0))
    delays_s = [(now_ns - stamp_of(m)) / SECOND_NS for now_ns, topic, m in run.published if topic == SMOOTHED_TOPIC]
    assert delays_s
    assert min(delays_s) > 2.5


def test_smoothing_continues_after_parameter_changes_and_a_reset() -> None:
    adapter, arrivals = new_adapter(smoothing_lag_s=3.0), voyage(16.0)
    run_adapter(adapter, arrivals[: len(arrivals) // 4])
    adapter.set_parameters({"star_sensors.fore.sigma_up_arcsec": 4.0})
    second = run_adapter(adapter, arrivals[len(arrivals) // 4 : len(arrivals) // 2])
    assert second.messages(SMOOTHED_TOPIC)
    assert adapter.service("reset", second.now_ns).success
    third = run_adapter(adapter, arrivals[len(arrivals) // 2 :])
    assert not third.innovations(Reason.FAILED)
    # Pending attitudes at the reset are not published again.
    stamps = [stamp_of(message) for message in third.messages(SMOOTHED_TOPIC)]
    assert len(stamps) > 50
    assert stamps[0] == stamp_of(third.messages("ship/attitude")[0])


def test_a_failed_smoothing_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    arrivals, adapter = voyage(12.0), new_adapter(smoothing_lag_s=3.0)
    calls = iter([True])

    def fails_once(core: SmoothingCore, time_ns: int) -> list[AttitudeEstimate]:
        if core.state.time_ns is not None and core.state.time_ns > START_NS + 6 * SECOND_NS and next(calls, False):
            raise ArithmeticError("as if")
        return smoothed_until(core, time_ns)

    smoothed_until = SmoothingCore._smoothed_until
    monkeypatch.setattr(SmoothingCore, "_smoothed_until", fails_once)
    run = run_adapter(adapter, arrivals)
    assert [message.source for message in run.innovations(Reason.FAILED)] == [SMOOTHED_TOPIC]
    assert len(run.messages("ship/attitude")) == len(run_adapter(new_adapter(), arrivals).messages("ship/attitude"))
    stamps = [stamp_of(message) for message in run.messages(SMOOTHED_TOPIC)]
    assert stamps == sorted(set(stamps))
    assert max(stamps) > START_NS + 8 * SECOND_NS

"""Smoothed pointings are consistent: on drawn sessions, with the ship smoothed too, over slips and faults, by stars.

The bands are of 99.9 %, from chi-square, for the number of seeds.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.smoothing import SmoothingCore
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_simulation.run import SimulatedRun, simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import optical_axis_configuration, suite_configuration
from ship_stars.sky.sky_model import load_sky_model
from ship_testing.mount_stars import MountSession, anchored_readings, draw_errors, mount_config, mount_sky, random_field
from ship_testing.star_sky import TIME_NS
from ship_testing.theodolite_scenes import SCENARIOS, replace_nested, with_beacons, with_theodolite
from ship_testing.trials.monte_carlo import attitude_outcomes, feed_arrival
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.subfilters import BEACON_PREFIX, ENCODER
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.samples.samples import Mode, PointingEstimate, PointingOutcome, ShipSample
from theodolite_calib.smoothing import SmoothingAxisCore

pytestmark = pytest.mark.slow  # the computations that the tests share take long

SEEDS = 16


class EstimatePair(NamedTuple):
    """Pointing of each reading, filtered and smoothed, the true main axes, shape (N, 3, 3), and excluded sources."""

    filtered: list[PointingEstimate]
    smoothed: list[PointingEstimate]
    true_nm: np.ndarray
    excluded: set[str]

    def place(self, second: float) -> int:
        """Return the number of the pointing nearest to a time after the first one."""
        times_ns = np.array([one.time_ns for one in self.filtered])
        return int(np.argmin(np.abs(times_ns - times_ns[0] - second * 1e9)))


def error_vectors_n(estimates: list[PointingEstimate], true_nm: np.ndarray) -> np.ndarray:
    return log_rotation(true_nm @ np.array([one.rotation_nm for one in estimates]).swapaxes(1, 2))


def covariances(estimates: list[PointingEstimate]) -> np.ndarray:
    return np.array([one.covariance_n for one in estimates])


def nees(estimates: list[PointingEstimate], true_nm: np.ndarray) -> np.ndarray:
    return normalized_error_squared(error_vectors_n(estimates, true_nm), covariances(estimates))


def rms_arcsec(errors_n: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors_n**2, axis=-1)))) / ARCSEC


def smoothed_pointings(core: SmoothingAxisCore, outcomes: Iterator[PointingOutcome], run: SimulatedRun) -> EstimatePair:
    """Return the outputs of a core at the times of the truth."""
    at_once, excluded = [], set()
    for outcome in outcomes:
        at_once += [one for one in outcome.estimates if one.status is not Status.INVALID]
        excluded |= {source for decision in outcome.decisions for source in decision.excluded_sources}
    smoothed = list(core.smooth_remaining())
    assert [one.time_ns for one in smoothed] == [one.time_ns for one in at_once]
    assert [(one.status, one.mode) for one in smoothed] == [(one.status, one.mode) for one in at_once]
    readings, truth = run.theodolite.encoder, run.theodolite.truth
    rows = {int(stamp): row for row, stamp in enumerate(readings.time_ns[truth.encoder_index])}
    at_once, smoothed = ([one for one in all_ if one.time_ns in rows] for all_ in (at_once, smoothed))
    return EstimatePair(at_once, smoothed, truth.mount.rotation_nm[[rows[one.time_ns] for one in at_once]], excluded)


def axis_core(scenario: Scenario) -> SmoothingAxisCore:
    return SmoothingAxisCore(build(OpticalAxisConfig, optical_axis_configuration(scenario)))


# -- drawn sessions with a fused attitude of the ship -----------------------------------------------------------------

FIRST_S, GAP_S, LEAVE_S, END_S = 30.0, (50.0, 65.0), 90.0, 110.0


def session() -> Scenario:
    """Return the sweep at low rates: no lights at first, a gap of the lights, no lights at the end."""
    scenario = with_theodolite(
        load_scenario(SCENARIOS / "theodolite_sweep.yaml"),
        encoder__rate_hz=5.0,
        telescope__phase_s=0.6,
        telescope__rate_hz=1.0,
        programme__azimuth_rate_deg_per_s=6.0,
        programme__elevation_period_s=22.0,
    )
    hidden = {"at first": Outage(0.0, FIRST_S), "gap": Outage(*GAP_S)}
    scenario = with_beacons(scenario, leaves_s=LEAVE_S, hidden=hidden, rtk__rate_hz=5.0, imu__rate_hz=5.0)
    return replace(
        scenario,
        duration_s=END_S,
        ins=replace_nested(scenario.ins, rate_hz=1.0),
        fused_attitude=replace_nested(scenario.fused_attitude, rate_hz=5.0),
    )


def run_core(core: OpticalAxisCore, run: SimulatedRun) -> Iterator[PointingOutcome]:
    for _, source, index in run.pointing_arrivals():
        yield feed_arrival(core, run, source, index)


@pytest.fixture(scope="module")
def sessions() -> list[EstimatePair]:
    scenario, smoothed = session(), []
    for seed in range(SEEDS):
        run, core = simulate(scenario, seed), axis_core(scenario)
        smoothed.append(smoothed_pointings(core, run_core(core, run), run))
    return smoothed


@pytest.mark.statistics
@pytest.mark.parametrize("second", [1.0, 15.0, 29.0, 40.0, 57.0, 64.0, 89.0, 105.0])
def test_smoothed_pointings_are_consistent(sessions: list[EstimatePair], second: float) -> None:
    place = sessions[0].place(second)
    found = [nees(one.smoothed[place : place + 1], one.true_nm[place : place + 1])[0] for one in sessions]
    low, high = mean_nees_band(SEEDS, 3)
    assert low < np.mean(found) < high


def test_no_variance_grows_and_later_measurements_improve_earlier_pointings(sessions: list[EstimatePair]) -> None:
    # Shortly before an exclusion the filtered pointings still depend on the source.
    without_fault = [session for session in sessions if not session.excluded]
    assert len(without_fault) > SEEDS // 2
    for session in without_fault:
        at_once, smoothed = covariances(session.filtered), covariances(session.smoothed)
        scale = np.trace(at_once, axis1=1, axis2=2)
        assert np.all(np.linalg.eigvalsh(at_once - smoothed)[:, 0] > -1e-9 * scale)
    # In the thirty seconds before the first lights, the pointings are by encoders alone.
    before = slice(sessions[0].place(0.0), sessions[0].place(FIRST_S))
    assert {one.mode for one in sessions[0].filtered[before]} == {Mode.ENCODER}
    errors = {
        name: rms_arcsec(
            np.array([error_vectors_n(getattr(session, name)[before], session.true_nm[before]) for session in sessions])
        )
        for name in ("filtered", "smoothed")
    }
    texts = [f"{name} {error:.1f} arcsec" for name, error in errors.items()]
    print(f"before the first lights: {', '.join(texts)}")
    assert errors["filtered"] > 40.0
    assert errors["smoothed"] < 0.25 * errors["filtered"]
    # After the last lights there are no further measurements.
    last = sessions[0]
    np.testing.assert_allclose(
        covariances(last.smoothed)[last.place(LEAVE_S + 5.0) :],
        covariances(last.filtered)[last.place(LEAVE_S + 5.0) :],
        rtol=1e-9,
        atol=1e-6 * ARCSEC**2,
    )


def test_filtered_pointings_are_the_same_to_the_last_bit(sessions: list[EstimatePair]) -> None:
    scenario = session()
    core = OpticalAxisCore(build(OpticalAxisConfig, optical_axis_configuration(scenario)))
    plain = [one for outcome in run_core(core, simulate(scenario, 0)) for one in outcome.estimates]
    for one, other in zip(plain, sessions[0].filtered, strict=True):
        for name in ("rotation_nm", "covariance_n", "covariance_by_source_n", "rotation_nt", "by_error_n"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert (one.time_ns, one.status, one.text) == (other.time_ns, other.status, other.text)


# -- faulty sources ---------------------------------------------------------------------------------------------------

FAULT_S = 58.0


@pytest.mark.statistics
def test_smoothing_before_a_slip_of_the_encoders_is_consistent() -> None:
    # The encoders slip by two degrees in the gap of the lights, further than a mount could turn between two readings:
    # the error begins at that time.
    scenario, found, gained = replace(with_theodolite(session(), encoder__rate_hz=20.0), duration_s=75.0), [], []
    for seed in range(6):
        run, core = simulate(scenario, seed), axis_core(scenario)
        readings = run.theodolite.encoder
        late = readings.time_ns > run.start_ns + round(FAULT_S * 1e9)
        slipped = replace(readings, azimuth=np.mod(readings.azimuth + np.deg2rad(2.0) * late, 2.0 * np.pi))
        run = replace(run, theodolite=replace(run.theodolite, encoder=slipped))
        result = smoothed_pointings(core, run_core(core, run), run)
        places = [result.place(second) for second in (5.0, 25.0, 40.0, 55.0, FAULT_S)]
        found.append(nees([result.smoothed[place] for place in places], result.true_nm[places]))
        variances = [
            np.trace(covariances(all_), axis1=1, axis2=2)[places] for all_ in (result.filtered, result.smoothed)
        ]
        gained.append(np.sqrt(variances[1] / variances[0]))
    low, high = mean_nees_band(6, 3)
    for mean_nees in np.mean(found, axis=0):
        assert low < mean_nees < high
    # Measurements after the slip also improve the axes before it.
    worth = np.mean(gained, axis=0)
    assert np.all(worth[:2] < 0.3)
    assert np.all(worth[3:5] < 0.99)


def test_an_excluded_drone_has_no_effect_on_smoothing() -> None:
    scenario = session()
    run, core = simulate(scenario, 0), axis_core(scenario)
    baselines = dict(run.theodolite.baselines)
    late = baselines["a"].time_ns > run.start_ns + round(40.0 * 1e9)
    baseline_n = baselines["a"].baseline_n + np.array([0.6, -0.4, 0.5]) * late[:, None]
    baselines["a"] = replace(baselines["a"], baseline_n=baseline_n)
    run = replace(run, theodolite=replace(run.theodolite, baselines=baselines))
    result = smoothed_pointings(core, run_core(core, run), run)
    assert result.excluded == {BEACON_PREFIX + "a"}
    # Chi-square of three degrees of freedom exceeds 21.1 once in ten thousand.
    assert np.max(nees(result.smoothed, result.true_nm)) < 21.1
    # The other drone's lights continue to improve the pointings, but not those before the exclusion: after the
    # exclusion the estimate is another one.
    assert is_unchanged(result, 40.0, 40.5)
    assert not is_unchanged(result, 45.0, 80.0)


def test_excluded_encoders_change_no_smoothed_pointing() -> None:
    # A mount can make a step of half a degree, so only the lights detect the slip.
    scenario = session()
    run, core = simulate(scenario, 0), axis_core(scenario)
    readings = run.theodolite.encoder
    late = readings.time_ns > run.start_ns + round(FAULT_S * 1e9)
    slipped = replace(readings, azimuth=np.mod(readings.azimuth + np.deg2rad(0.5) * late, 2.0 * np.pi))
    run = replace(run, theodolite=replace(run.theodolite, encoder=slipped))
    result = smoothed_pointings(core, run_core(core, run), run)
    assert result.excluded == {ENCODER}
    assert np.max(nees(result.smoothed, result.true_nm)) < 21.1
    # Pointings are unchanged from the last lights before the slip on, and later, where each sighting is independent.
    assert not is_unchanged(result, 45.0, 49.0)
    assert is_unchanged(result, 50.0, FAULT_S)
    assert is_unchanged(result, 70.0, 88.0)


def is_unchanged(estimates: EstimatePair, start_s: float, end_s: float) -> bool:
    """True if the smoothed pointings of a time span equal the filtered ones to rounding."""
    some = slice(estimates.place(start_s), estimates.place(end_s))
    at_once, smoothed = (covariances(all_)[some] for all_ in (estimates.filtered, estimates.smoothed))
    return bool(np.all(np.abs(smoothed - at_once) <= 1e-6 * np.trace(at_once, axis1=1, axis2=2)[:, None, None]))


# -- voyages, with the ship's attitude smoothed first -----------------------------------------------------------------


def voyage() -> Scenario:
    """Return a ship with stars that clouds hide for a time, and with lights that start late and have a gap."""
    whole, clouds = load_scenario(SCENARIOS / "demo.yaml"), {"clouds": Outage(30.0, 48.0)}
    sensors = {id_: replace(one, rate_hz=2.0, outages=clouds) for id_, one in whole.star_sensors.items()}
    hidden = {"at first": Outage(0.0, 15.0), "gap": Outage(36.0, 60.0)}
    lights = with_beacons(session(), leaves_s=1e6, hidden=hidden)
    return replace(
        whole,
        duration_s=75.0,
        ins=replace(whole.ins, rate_hz=5.0, time_offset_sigma_s=0.0),
        star_sensors=sensors,
        theodolite=replace_nested(lights.theodolite, deformation__sigma_arcsec=5.0),
        beacons=lights.beacons,
    )


def run_voyage(seed: int) -> EstimatePair:
    scenario = voyage()
    run = simulate(scenario, seed)
    ship = SmoothingCore(build(ShipAttitudeConfig, suite_configuration(scenario)), None, None)
    for _ in attitude_outcomes(ship, run, set(run.ins.time_ns.tolist())):
        ship.take_smoothed()
    core = axis_core(scenario)
    white_n = (core.config.ship.white_sigma_arcsec * ARCSEC) ** 2 * np.eye(3)
    samples = {
        one.time_ns: ShipSample(one.time_ns, one.rotation_nd, one.rate_d, one.covariance_n - white_n, one.status)
        for one in ship.smooth_remaining()
    }

    def outcomes() -> Iterator[PointingOutcome]:
        for _, source, index in run.pointing_arrivals():
            given = samples.get(int(run.ins.time_ns[index])) if source == "ins" else None
            yield feed_arrival(core, run, source, index) if given is None else core.pointings.add_ship(given)

    return smoothed_pointings(core, outcomes(), run)


@pytest.mark.statistics
def test_smoothing_with_the_smoothed_ship_attitude_is_consistent() -> None:
    found = []
    for seed in range(SEEDS // 2):
        result = run_voyage(seed)
        # Two times before the first lights; then with all, without stars, without stars and lights, without lights, at
        # the end.
        places = [result.place(second) for second in (2.0, 14.0, 28.0, 34.0, 42.0, 55.0, 74.0)]
        found.append(nees([result.smoothed[place] for place in places], result.true_nm[places]))
    low, high = mean_nees_band(SEEDS // 2, 3)
    for mean_nees in np.mean(found, axis=0):
        assert low < mean_nees < high


# -- stars on the mount -----------------------------------------------------------------------------------------------


def test_later_stars_improve_earlier_pointings() -> None:
    settings = mount_config(axes__flexure_sigma_arcsec=6.0)
    found, errors = [], {"at_once": [], "smoothed": []}
    for seed in range(SEEDS // 2):
        rng = np.random.default_rng(seed)
        session = MountSession(settings, draw_errors(settings, rng), mount_sky(settings), rng)
        core, filtered, true_nm = SmoothingAxisCore(settings, load_sky_model(settings.sky)), [], []
        for given in anchored_readings():
            core.add_surroundings(given)
        for number in range(80):
            time_ns = TIME_NS + number * 250_000_000
            ship = session.ship()
            core.pointings.add_ship(ShipSample(time_ns, ship.rotation_nd, ship.rate_d, ship.correlated_covariance_n))
            # The field changes every five seconds; there are stars from the second field on.
            if number % 20 == 0:
                field = random_field(rng)
            if number >= 20 and number % 4 == 2:
                core.add_exposure(session.exposure(field, 6, time_ns))
            estimates = core.pointings.add_encoder(session.reading(field, time_ns)).estimates
            filtered += estimates
            true_nm += [session.main_axis(field)] * len(estimates)
        smoothed = list(core.smooth_remaining())
        assert len(smoothed) == len(filtered)
        first = slice(2, 12)
        assert {one.mode for one in filtered[first]} == {Mode.ENCODER}
        for name, estimates in (("at_once", filtered), ("smoothed", smoothed)):
            errors[name].append(error_vectors_n(estimates[first], np.array(true_nm[first])))
        places = [5, 30, 50, len(filtered) - 2]
        found.append(nees([smoothed[place] for place in places], np.array(true_nm)[places]))
    low, high = mean_nees_band(SEEDS // 2, 3)
    for mean_nees in np.mean(found, axis=0):
        assert low < mean_nees < high
    assert rms_arcsec(np.array(errors["smoothed"])) < 0.6 * rms_arcsec(np.array(errors["at_once"]))

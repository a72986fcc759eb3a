"""Monitoring of a voyage with faults names the right source, soon, and no others.

Times are seconds after the first message of the bag. The faults are a heading step of the INS of 100″, a star sensor
displaced by 50″, an RTK baseline that is only FLOAT, exchanged names of lights, and missing data of an instrument. They
occur one after another, with an end, and two at a time.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import ns_from_stamp
from ship_testing.monitored_voyages import BAGS, MonitoredVoyage, monitor_voyage, records, replay_with_faults
from ship_watch.alerts.alert_conditions import conditions
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Presence, Safety

MOUNTING_SHIFT = "knock: {topic: star/starboard/horizon_attitude, kind: knock, start_s: 30.0, right_arcsec: 50.0"
ONE_BY_ONE = (
    MOUNTING_SHIFT + ", end_s: 35.0}, step: {topic: ins/imu, kind: bias, start_s: 55.0, up_arcsec: 100.0}, "
    "silent: {topic: star/fore/horizon_attitude, kind: drop, start_s: 100.0, end_s: 108.0}"
)
TOGETHER = MOUNTING_SHIFT + "}, step: {topic: ins/imu, kind: bias, start_s: 31.0, up_arcsec: 100.0}"
THEODOLITE = (
    "float: {topic: beacon/a/baseline, kind: corrupt, field: fix, value: 3, start_s: 10.0, end_s: 16.0}, "
    "swap: {topic: theodolite/beacons, kind: swap, start_s: 25.0, end_s: 33.0}, "
    "silent: {topic: theodolite/encoder, kind: drop, start_s: 60.0, end_s: 66.0}"
)
CLOUDS = (69.9, 91.5)
"""Period without stars in bags/demo.mcap, with a margin, s."""


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> MonitoredVoyage:
    return monitor_voyage(replay_with_faults(tmp_path_factory.mktemp("one"), "demo", ONE_BY_ONE)[1])


@pytest.fixture(scope="module")
def theodolite(tmp_path_factory: pytest.TempPathFactory) -> MonitoredVoyage:
    return monitor_voyage(*replay_with_faults(tmp_path_factory.mktemp("theodolite"), "theodolite", THEODOLITE))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return replay_with_faults(tmp_path_factory.mktemp("clean"), "demo")


@pytest.mark.slow
def test_a_displaced_star_sensor_is_out_and_its_direction_is_reported(one_by_one: MonitoredVoyage) -> None:
    first_s = 30.117  # its first exposure after the mounting shift
    assert first_s < one_by_one.out_s["star.starboard"][0] <= first_s + 2.0
    starboard = one_by_one.shown_sources["star.starboard"][0]
    assert starboard.reason == "excluded"
    _, size, sense = starboard.disagreement.split(" ")
    assert sense == "high"
    # 50″, with the noise of three exposures: a sigma of 3.2″ each
    assert float(size.rstrip("″")) == pytest.approx(50.0, abs=6.0)
    assert starboard.out_since_ns - one_by_one.start_ns == pytest.approx(30.117e9, abs=0.6e9)


@pytest.mark.slow
def test_an_ins_that_steps_is_out_and_returns(one_by_one: MonitoredVoyage) -> None:
    assert 55.0 < one_by_one.out_s["ins"][0] <= 57.0
    assert one_by_one.shown_sources["ins"][0].reason == "5 rejected in a row"
    assert one_by_one.back_s["ins"] == [pytest.approx(57.1, abs=1.1)]
    assert len(one_by_one.out_s["ins"]) == 1
    words = [text for time_s, text in one_by_one.events("state") if 55.0 < time_s < 55.3]
    assert "heading CAUTION → UNSAFE, ins rejected" in words


def test_a_star_sensor_without_data_is_out_within_two_seconds_of_the_first_missing_message(
    one_by_one: MonitoredVoyage,
) -> None:
    clouds_s, no_data_s = one_by_one.out_s["star.fore"]
    assert CLOUDS[0] < clouds_s < CLOUDS[1]
    assert 101.9 <= no_data_s <= 100.033 + 0.2 + 2.0  # 5 Hz; the last exposure, at 99.833, arrives 0.1 s later
    assert one_by_one.shown_sources["star.fore"][1].reason == "no data"
    assert one_by_one.back_s["star.fore"] == [pytest.approx(91.0, abs=1.0), pytest.approx(109.0, abs=1.0)]


def test_no_other_source_is_named(one_by_one: MonitoredVoyage) -> None:
    causes = [name for time_s, name in one_by_one.root_causes if not CLOUDS[0] < time_s < CLOUDS[1]]
    assert causes == ["star.starboard", "ins", "star.fore"]


@pytest.mark.slow
def test_two_simultaneous_faults_are_distinguished(tmp_path: Path) -> None:
    seen = monitor_voyage(replay_with_faults(tmp_path, "demo", TOGETHER)[1])
    assert [name for time_s, name in seen.root_causes if time_s < CLOUDS[0]] == ["star.starboard", "ins"]
    assert seen.out_s["star.starboard"][0] <= 32.2
    assert seen.out_s["ins"][0] <= 33.0
    assert seen.back_s["ins"][0] < 35.0
    picture = seen.last_state()
    assert [source.name for source in picture.sources if source.presence is Presence.OUT] == ["star.starboard"]


@pytest.mark.slow
def test_a_source_that_only_degrades_is_not_named_for_a_missing_output(tmp_path: Path) -> None:
    """A FLOAT baseline, and then no encoder: no source is named before the encoder's timeout, then the encoder."""
    faults = (
        "float: {topic: beacon/a/baseline, kind: corrupt, field: fix, value: 3, start_s: 12.0, end_s: 25.0}, "
        "quiet: {topic: theodolite/encoder, kind: drop, start_s: 20.0, end_s: 25.0}"
    )
    seen = monitor_voyage(replay_with_faults(tmp_path, "theodolite", faults)[1])
    azimuth = {second: next(a for a in seen.state_at[second].angles if a.name == "azimuth") for second in (18.0, 23.0)}
    assert (azimuth[18.0].safety, azimuth[18.0].reason) == (Safety.CAUTION, "a (baselines) rejected: not fixed")
    assert (azimuth[23.0].safety, azimuth[23.0].reason) == (Safety.UNSAFE, "no data from encoder")
    became = [text for time_s, text in seen.events("state") if 20.0 < time_s < 22.0 and "azimuth" in text]
    assert len(became) == 1
    assert "baselines" not in became[0]


@pytest.mark.slow
def test_a_float_baseline_is_out_and_lights_only_need_it(theodolite: MonitoredVoyage) -> None:
    assert 10.0 < theodolite.out_s["baselines"][0] <= 12.0
    assert theodolite.shown_sources["baselines"][0].reason == "a: 5 rejected in a row: not fixed"
    assert theodolite.shown_sources["lights"][0].because_of == "baselines"
    assert theodolite.back_s["baselines"][0] == pytest.approx(17.5, abs=1.0)
    assert [name for time_s, name in theodolite.root_causes if time_s < 40.0] == ["baselines"]


@pytest.mark.slow
def test_exchanged_light_names_are_reported_although_corrected(theodolite: MonitoredVoyage) -> None:
    texts = [(time_s, text) for time_s, text in theodolite.events("source") if "lights" in text]
    exchanged = [time_s for time_s, text in texts if text == "lights IN, names exchanged"]
    assert len(exchanged) == 1
    assert 25.0 < exchanged[0] <= 27.0
    (alert,) = (found for found in conditions(theodolite.state_at[28.0], Limits()) if found.source == "lights")
    assert alert.text == "lights: names exchanged, corrected"
    assert safety_between(theodolite, 26.0, 33.0) == {Safety.SAFE}


def test_an_encoder_without_data_is_out_and_the_pointing_names_it(theodolite: MonitoredVoyage) -> None:
    assert 61.9 < theodolite.out_s["encoder"][0] <= 60.002 + 2.0 + 1e-6
    assert "needs encoder" in [source.reason for source in theodolite.shown_sources["lights"]]
    assert theodolite.back_s["encoder"][0] == pytest.approx(66.2, abs=0.5)
    causes = [name for time_s, name in theodolite.root_causes if 40.0 < time_s < 79.0]
    assert causes == ["encoder"]  # no source is named for an output that returns later


def test_a_good_voyage_is_safe_and_no_source_is_out(clean: tuple[Path, Path]) -> None:
    seen = monitor_voyage(clean[1])
    assert [name for time_s, name in seen.root_causes if not CLOUDS[0] < time_s < CLOUDS[1]] == []
    picture = seen.last_state()
    assert [angle.safety for angle in picture.angles] == [Safety.SAFE] * 3
    with read_bag(clean[1]) as bag:
        last = [record.decode() for record in bag.records(["ship/attitude"])][-1]
    heading = picture.angles[0]
    assert heading.value == last.heading
    assert heading.accuracy_95 == pytest.approx(1.96 * math.sqrt(last.covariance[0]))
    assert picture.ages_s["stars"] == min(each.age_s for each in picture.sources if each.name.startswith("star."))
    # Two star sensors with consistent sigmas: estimated with 600 degrees of freedom each.
    consistencies = {source.name: source.nis_consistency for source in picture.sources if source.nis_consistency}
    assert {name: consistency.is_consistent for name, consistency in consistencies.items() if consistency} == {
        "star.fore": True, "star.starboard": True
    }  # fmt: skip


def test_a_recording_shows_the_same_as_live(clean: tuple[Path, Path]) -> None:
    """Live arrival times are those of a monotonic clock with another start, and states are computed at intervals."""
    recorded, live, shift_ns = SuiteMonitor(), SuiteMonitor(), -1_404_906_000_123_456_700_000
    end_ns = 0
    for number, (time_ns, topic, message) in enumerate(records(clean[1])):
        recorded.process_message(topic, message, time_ns)
        live.process_message(topic, message, time_ns + shift_ns)
        if number % 1000 == 0:
            live.current_state(time_ns + shift_ns)
        end_ns = time_ns
    there, here = recorded.current_state(end_ns), live.current_state(end_ns + shift_ns)
    assert here.angles[0].value == there.angles[0].value
    assert [(a.safety, a.reason, a.age_s) for a in here.angles] == [(a.safety, a.reason, a.age_s) for a in there.angles]
    assert [(s.name, s.presence, s.reason) for s in here.sources] == [
        (s.name, s.presence, s.reason) for s in there.sources
    ]
    # States are evaluated at whole tenths of a second of either clock.
    assert [e.text for e in here.events] == [e.text for e in there.events]
    assert all(abs(a.utc_ns - b.utc_ns) <= 1e8 for a, b in zip(here.events, there.events, strict=True))


def test_missing_errors_against_truth_are_computed(clean: tuple[Path, Path]) -> None:
    """The monitor computes from the truth, in place of NaN, the errors that a replay writes to ship/error_arcsec."""
    with read_bag(clean[1]) as bag:
        filled = {ns_from_stamp(m.header.stamp): m for r in bag.records(["ship/error_arcsec"]) if (m := r.decode())}
    live, nan = SuiteMonitor(), math.nan
    for time_ns, topic, message in records(*clean):
        if topic == "ship/error_arcsec":
            message.error_heading, message.error_pitch, message.error_roll = nan, nan, nan
        # The truth has other stamps than these attitudes, so that the truth is interpolated.
        if topic != "ship/attitude" or ns_from_stamp(message.header.stamp) in filled:
            live.process_message(topic, message, time_ns)
    points = live.history.errors["ship/error_arcsec"]
    assert len(points) >= 110
    for point in points:
        same = filled[point.utc_ns]
        for name in ("heading", "pitch", "roll"):
            assert point.error[name] == pytest.approx(getattr(same, f"error_{name}"), abs=1e-3)
            assert point.sigma[name] == pytest.approx(getattr(same, f"sigma_{name}"), rel=1e-6)


def test_history_has_the_data_of_plots(theodolite: MonitoredVoyage) -> None:
    history = theodolite.monitor.history
    assert set(history.beacons) == {"a", "b"}
    used = [point for point in history.beacons["b"] if point.is_used]
    assert len(used) > 300
    assert all(math.isfinite(point.x_residual) for point in used)
    assert all(abs(point.x) < 0.02 and abs(point.z) < 0.02 for point in used)
    assert [point.utc_ns for point in used] == sorted(point.utc_ns for point in used)
    assert len(history.safety) == pytest.approx(120, abs=2)
    assert safety_between(theodolite, 62.0, 65.0) == {Safety.UNSAFE}
    budget = history.budgets["theodolite/error_budget"][-1]
    assert set(budget.by_angle) == {"azimuth", "elevation"}
    assert {state.name for state in history.calibration} >= {"g", "h", "c", "I"}
    assert history.position == pytest.approx(np.radians(_first_fix()), abs=1e-3)


def safety_between(voyage: MonitoredVoyage, start_s: float, end_s: float) -> set[Safety | None]:
    """Return the safety states of the azimuth in the history of a time span."""
    points = [
        point for point in voyage.monitor.history.safety if start_s <= (point.utc_ns - voyage.start_ns) * 1e-9 < end_s
    ]
    return {point.safety["azimuth"] for point in points}


def _first_fix() -> tuple[float, float]:
    with read_bag(BAGS / "theodolite.mcap") as bag:
        fix = next(iter(bag.records(["gnss/fix"]))).decode()
    return fix.latitude, fix.longitude

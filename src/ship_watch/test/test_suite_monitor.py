"""Monitor of a suite with hand-made messages: old data, missing data, resets."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC
from ship_watch.alerts.alert_conditions import conditions
from ship_watch.alerts.alerts import AlertList
from ship_watch.published_state import STATE_TYPE, suite_state_fields
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import ANGLES, Presence, Safety
from ship_watch.topics import TOPICS, monitored_topic, source_of_name, source_of_topic

SECOND = 1_000_000_000
UTC = 1_404_906_607 * SECOND


def stamp(ns: int) -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=ns // SECOND, nanosec=ns % SECOND), frame_id="")


def attitude(ns: int, sigma_arcsec: float = 1.0, status: int = 0, **other: Any) -> SimpleNamespace:
    values = {"heading": 0.6, "pitch": 0.01, "roll": -0.02, "horizon": 0, "star_age_s": 0.1} | other
    covariance = np.diag([(sigma_arcsec * ARCSEC) ** 2] * 3).ravel()
    return SimpleNamespace(
        header=stamp(ns), covariance=covariance, status=status, sources=["ins", "star.bow"], **values
    )


def integrity(ns: int, state: int = 0, excluded: tuple[str, ...] = ()) -> SimpleNamespace:
    return SimpleNamespace(
        header=stamp(ns),
        quantities=["heading", "pitch", "roll"],
        protection_level=np.full(3, 20.0 * ARCSEC),
        alert_limit=np.full(3, 30.0 * ARCSEC),
        state=state,
        excluded=list(excluded),
    )


def health(ns: int, topic: str, received: int, rate_hz: float = 5.0, age_s: float = 0.2) -> SimpleNamespace:
    return SimpleNamespace(
        header=stamp(ns), topic=topic, received=received, accepted=received, rejected=0, rate_hz=rate_hz,
        latency_s=0.1, age_s=age_s, level=0, reasons=[], reason_counts=[],
    )  # fmt: skip


def monitor_after(until_s: float, start_s: float = 0.0, **of_attitude: Any) -> SuiteMonitor:
    """Return a monitor that has received a suite without faults for some seconds at 10 Hz; times count from 1000 s."""
    monitor = SuiteMonitor()
    feed(monitor, start_s, until_s, **of_attitude)
    return monitor


def feed(monitor: SuiteMonitor, start_s: float, until_s: float, **of_attitude: Any) -> None:
    for tenth in range(round(start_s * 10), round(until_s * 10) + 1):
        ns = tenth * SECOND // 10
        now = 1000 * SECOND + ns
        if tenth % 10 == 0:
            monitor.process_message("ship/integrity", integrity(UTC + ns), now)
            monitor.process_message("input_health", health(UTC + ns, "ins/imu", 10 + tenth * 10, 100.0, 0.1), now)
            monitor.process_message("input_health", health(UTC + ns, "star/bow/solution", 1 + tenth // 2), now)
        monitor.process_message("ship/attitude", attitude(UTC + ns, **of_attitude), now)


def at(seconds: float) -> int:
    return 1000 * SECOND + round(seconds * SECOND)


def test_missing_output_is_named_before_the_first_message() -> None:
    picture = SuiteMonitor().current_state(5 * SECOND)
    assert [angle.name for angle in picture.angles] == list(ANGLES[:3])
    assert all(angle.safety is Safety.UNSAFE and angle.is_old for angle in picture.angles)
    assert {angle.reason for angle in picture.angles} == {"waiting for ship/attitude"}
    assert picture.waiting_for == "ship/attitude"
    assert picture.utc_ns == 0
    assert picture.alerts is None


def test_good_suite_is_safe_and_has_its_time() -> None:
    picture = monitor_after(10.0).current_state(at(10.3))
    assert [angle.safety for angle in picture.angles] == [Safety.SAFE] * 3
    heading = picture.angles[0]
    assert heading.accuracy_95 == pytest.approx(1.96 * ARCSEC)
    assert heading.limit == pytest.approx(6.0 * ARCSEC)
    assert heading.age_s == pytest.approx(0.3)
    assert heading.stamp_ns == UTC + 10 * SECOND
    assert picture.utc_ns == UTC + 10 * SECOND + 3 * SECOND // 10
    listed = {source.name: source.age_s for source in picture.sources}
    assert (picture.ages_s["stars"], picture.ages_s["ins"]) == (listed["star.bow"], listed["ins"])
    assert {source.name: source.presence for source in picture.sources} == {
        "ins": Presence.IN, "star.bow": Presence.IN, "gnss": Presence.OFF, "weather": Presence.OFF
    }  # fmt: skip


def test_old_output_is_unsafe() -> None:
    monitor = monitor_after(10.0)
    assert not monitor.current_state(at(10.9)).angles[0].is_old
    old = monitor.current_state(at(11.0)).angles[0]
    assert old.is_old
    assert (old.safety, old.reason) == (Safety.UNSAFE, "no data on ship/attitude")
    much_later = monitor.current_state(at(3600.0))
    assert much_later.angles[0].age_s == pytest.approx(3590.0)
    assert all(source.presence is not Presence.IN for source in much_later.sources)
    assert {source.reason for source in much_later.sources if source.presence is Presence.OUT} == {"not reported"}


def test_repeated_output_gets_old() -> None:
    monitor = monitor_after(10.0)
    for tenth in range(1, 21):
        monitor.process_message("ship/attitude", attitude(UTC + 10 * SECOND), at(10.0 + tenth / 10))
    assert monitor.current_state(at(12.0)).angles[0].is_old


def test_old_output_recovers_after_five_seconds() -> None:
    monitor = monitor_after(10.0)
    monitor.current_state(at(12.0))
    feed(monitor, 12.5, 17.0)
    held = monitor.current_state(at(17.0)).angles[0]
    assert held.safety is Safety.UNSAFE
    assert not held.is_old
    feed(monitor, 17.1, 18.0)
    assert monitor.current_state(at(18.0)).angles[0].safety is Safety.SAFE


@pytest.mark.parametrize(
    ("seconds", "every", "alerts"),
    [
        (0.1, 1, []),
        (4.0, 1, []),
        (6.0, 1, ["attitude.degraded"]),
        (8.0, 9, ["attitude.degraded"]),
        (8.0, 11, []),
    ],
)
def test_brief_excess_of_a_limit_is_displayed_and_no_alert(seconds: float, every: int, alerts: list[str]) -> None:
    """The safety follows at once; an alert needs five seconds over the limit, including dips shorter than a second."""
    monitor, alert_list, shown = SuiteMonitor(), AlertList(Limits().alerts), set()
    for tenth in range(300):
        second, is_over = tenth / 10, 200 <= tenth < 200 + 10 * seconds and tenth % every == 0
        feed(monitor, second, second, sigma_arcsec=3.0 if is_over else 1.0)
        picture = monitor.current_state(at(second))
        shown |= {angle.safety for angle in picture.angles if second > 15}
        alert_list.update(conditions(picture, Limits()), at(second), picture.utc_ns)
    assert shown == {Safety.SAFE, Safety.CAUTION}
    assert [alert.id for alert in alert_list.alerts] == alerts


def test_nan_is_unsafe_in_each_angle() -> None:
    monitor = monitor_after(10.0)
    monitor.process_message("ship/attitude", attitude(UTC + 10_500_000_000, pitch=math.nan), at(10.5))
    words = {angle.name: angle.safety for angle in monitor.current_state(at(10.5)).angles}
    assert words == {"heading": Safety.SAFE, "pitch": Safety.UNSAFE, "roll": Safety.SAFE}


def pointing(ns: int, covariance: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=stamp(ns), azimuth=0.5, elevation=0.1, covariance=covariance, status=0, mode=0, light_count=0
    )


def test_covariance_of_zeros_means_unknown_accuracy() -> None:
    """The rule is that of sensor_msgs: "If the covariance is unknown, all elements are 0"."""
    monitor = monitor_after(10.0)
    monitor.process_message("ship/attitude", attitude(UTC + 10_500_000_000, sigma_arcsec=0.0), at(10.5))
    monitor.process_message("theodolite/pointing", pointing(UTC + 10_500_000_000, np.zeros(9)), at(10.5))
    angles = monitor.current_state(at(10.5)).angles
    assert len(angles) == 5
    assert all(math.isnan(angle.accuracy_95) for angle in angles)
    assert {(angle.safety, angle.reason) for angle in angles} == {(Safety.UNSAFE, "accuracy unknown")}


def test_error_against_truth_has_no_sigma_without_a_covariance() -> None:
    monitor = SuiteMonitor()
    for tenth in range(4):
        monitor.process_message("truth/attitude", attitude(UTC + tenth * SECOND // 10), at(tenth / 10))
        monitor.process_message("ship/attitude", attitude(UTC + tenth * SECOND // 10, sigma_arcsec=0.0), at(tenth / 10))
    (point,) = monitor.history.errors["ship/error_arcsec"]
    assert point.error == pytest.approx({"heading": 0.0, "pitch": 0.0, "roll": 0.0}, abs=1e-6)
    assert all(math.isnan(sigma) for sigma in point.sigma.values())


@pytest.mark.parametrize("heading", [math.inf, -math.inf, math.nan])
def test_orientation_not_finite_is_not_compared_with_the_truth(heading: float) -> None:
    """Truths and outputs with values that are not finite are not used in any computation."""
    monitor = SuiteMonitor()
    with np.errstate(all="raise"):
        for tenth in range(6):
            ns, no_number = UTC + tenth * SECOND // 5, {} if tenth % 2 == 0 else {"heading": heading}
            monitor.process_message("truth/attitude", attitude(ns + 1, **no_number), at(tenth / 5))
            monitor.process_message("truth/attitude", attitude(ns), at(tenth / 5))
            monitor.process_message("ship/attitude", attitude(ns, **no_number), at(tenth / 5))
    points = monitor.history.errors["ship/error_arcsec"]
    assert points
    assert all(abs(error) < 1e-6 for point in points for error in point.error.values())


def test_variance_of_zero_means_unknown_accuracy() -> None:
    monitor = monitor_after(10.0)
    message = attitude(UTC + 10_500_000_000)
    message.covariance[4] = 0.0
    monitor.process_message("ship/attitude", message, at(10.5))
    assert [angle.safety for angle in monitor.current_state(at(10.5)).angles] == [
        Safety.SAFE,
        Safety.UNSAFE,
        Safety.SAFE,
    ]


def test_old_or_missing_integrity_is_no_integrity_data() -> None:
    monitor = monitor_after(10.0)
    for tenth in range(101, 140):
        monitor.process_message("ship/attitude", attitude(UTC + tenth * SECOND // 10), at(tenth / 10))
        angle = monitor.current_state(at(tenth / 10)).angles[0]
        assert (angle.safety, angle.reason) == ((0, "") if tenth <= 130 else (1, "no integrity data"))
    monitor = SuiteMonitor()
    monitor.process_message("ship/attitude", attitude(UTC), at(0.0))
    assert monitor.current_state(at(0.1)).angles[0].safety is Safety.CAUTION


def test_source_without_data_is_out_after_two_seconds_and_named_by_the_angle() -> None:
    monitor = monitor_after(10.0)
    for tenth in range(101, 131):
        ns = UTC + tenth * SECOND // 10
        monitor.process_message("ship/attitude", attitude(ns, status=1, star_age_s=tenth / 10 - 10.0), at(tenth / 10))
        if tenth % 10 == 0:
            monitor.process_message("ship/integrity", integrity(ns), at(tenth / 10))
            monitor.process_message("input_health", health(ns, "ins/imu", 10 + tenth * 10, 100.0, 0.1), at(tenth / 10))
            monitor.process_message(
                "input_health", health(ns, "star/bow/solution", 51, 4.0, tenth / 10 - 9.8), at(tenth / 10)
            )
    early = {source.name: source for source in monitor.current_state(at(11.8)).sources}
    assert early["star.bow"].presence is Presence.IN
    picture = monitor.current_state(at(13.0))
    assert [(source.name, source.reason) for source in picture.sources if source.presence is Presence.OUT] == [
        ("star.bow", "no data")
    ]
    assert picture.angles[0].reason == "no data from star.bow"
    assert picture.sources[0].out_since_ns == pytest.approx(UTC + 9.9 * SECOND, abs=1e6)


def test_stars_are_not_the_cause_if_all_messages_stop() -> None:
    """All messages stop, as at the end of a bag: no cause is named for three seconds, then the missing reports."""
    monitor = monitor_after(10.0)
    message = rejection(UTC + 10 * SECOND, "star.bow", Reason.NONE)
    message.accepted, message.components, message.residual, message.sigma, message.nis = (
        True,
        ["up"],
        [1e-6],
        [1e-6],
        1.0,
    )
    monitor.process_message("ship/innovation", message, at(10.0))
    reasons = set()
    for tenth in range(100, 200):
        picture = monitor.current_state(at(tenth / 10))
        reasons |= {source.reason for source in picture.sources if source.presence is Presence.OUT}
        reasons |= {angle.reason for angle in picture.angles}
    assert reasons == {"", "no data on ship/attitude", "not reported"}


def test_excluded_source_is_out_and_in_again() -> None:
    monitor = monitor_after(10.0)
    monitor.process_message("ship/integrity", integrity(UTC + 10 * SECOND, 2, ("star.bow",)), at(10.05))
    source = monitor.current_state(at(10.1)).sources[0]
    assert (source.name, source.presence, source.reason) == ("star.bow", Presence.OUT, "excluded")
    monitor.process_message("ship/integrity", integrity(UTC + 11 * SECOND), at(10.5))
    assert all(source.presence is not Presence.OUT for source in monitor.current_state(at(10.6)).sources)
    assert [event.text for event in monitor.current_state(at(10.7)).events if event.kind == "source"] == [
        "star.bow IN", "star.bow OUT, excluded"
    ]  # fmt: skip


def test_events_do_not_depend_on_requests() -> None:
    looked_at, left_alone = SuiteMonitor(), SuiteMonitor()
    for seconds in range(30):
        for monitor in (looked_at, left_alone):
            feed(monitor, float(seconds), seconds + 0.9, sigma_arcsec=9.0 if seconds % 13 == 5 else 1.0)
        for tenth in range(9):
            looked_at.current_state(at(seconds + 0.9 + tenth / 100))
    assert looked_at.current_state(at(40.0)) == left_alone.current_state(at(40.0))
    assert any("CAUTION" in event.text or "UNSAFE" in event.text for event in left_alone.current_state(at(40.0)).events)


def test_restart_of_a_bag_resets_the_history() -> None:
    monitor = monitor_after(30.0)
    for tenth in range(200):
        monitor.process_message("ship/attitude", attitude(UTC + tenth * SECOND // 10), at(31.0 + tenth / 10))
    picture = monitor.current_state(at(50.9))
    assert picture.utc_ns == UTC + 19_900_000_000
    assert not any(angle.is_old for angle in picture.angles)
    assert picture.events[-1].text == "time went back: history cleared"


def test_limits_of_the_ship_are_used() -> None:
    monitor = SuiteMonitor(Limits(heading_arcsec=1.5))
    feed(monitor, 0.0, 3.0)
    words = [(angle.safety, angle.reason) for angle in monitor.current_state(at(3.0)).angles]
    assert words == [(Safety.CAUTION, "over the limit"), (Safety.SAFE, ""), (Safety.SAFE, "")]


def test_reason_of_a_caution_is_current_at_any_time() -> None:
    """An accuracy over its limit for 2 s, then below it: the reason states the time until the safety gets better."""
    monitor = SuiteMonitor(Limits(tilt_arcsec=4.0))
    feed(monitor, 0.0, 10.0)
    feed(monitor, 10.1, 12.0, sigma_arcsec=2.1)
    assert {(angle.safety, angle.reason) for angle in monitor.current_state(at(12.0)).angles[1:]} == {
        (Safety.CAUTION, "over the limit")
    }
    for tenth in range(121, 170):
        feed(monitor, tenth / 10, tenth / 10)
        (pitch,) = (angle for angle in monitor.current_state(at(tenth / 10)).angles if angle.name == "pitch")
        left_s = math.ceil(round(17.1 - tenth / 10, 6))  # the safety is evaluated before the message of the same time
        assert (pitch.safety, pitch.reason) == (Safety.CAUTION, f"within 4″ again; SAFE in {left_s} s")
    feed(monitor, 17.0, 17.2)
    assert monitor.current_state(at(17.2)).angles[1].safety is Safety.SAFE
    events = [event.text for event in monitor.current_state(at(17.2)).events if event.subject == "pitch"]
    assert events[:2] == ["pitch CAUTION → SAFE", "pitch SAFE → CAUTION, over the limit"]


def test_topics_are_monitored_only_with_their_type() -> None:
    for row in TOPICS:
        assert monitored_topic(row.pattern.replace("<id>", "bow"), row.type_name) is row
        assert monitored_topic(row.pattern.replace("<id>", "bow"), "std_msgs/msg/String") is None
    assert monitored_topic("ins/imu") is None


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("ins", "ins"), ("star.bow", "star.bow"), ("reference.gyro", "reference.gyro"), ("light.a", "lights"),
        ("lights", "lights"), ("telescope", "lights"), ("encoder", "encoder"), ("ship", "ship_attitude"),
        ("ship_attitude", "ship_attitude"), ("baseline.a", "baselines"), ("drone.a", "baselines"),
        ("beacon.a", "baselines"), ("gnss/fix", "gnss"), ("met/pressure", "weather"), ("ship/attitude", ""),
        ("slow topics", ""),
    ],
)  # fmt: skip
def test_source_of_names_in_messages(name: str, source: str) -> None:
    assert source_of_name(name) == source


@pytest.mark.parametrize(
    ("topic", "source"),
    [
        ("ins/imu", "ins"), ("star/bow/observations", "star.bow"), ("star/joint/solution", ""),
        ("reference/gyro/imu", "reference.gyro"), ("theodolite/beacons", "lights"), ("theodolite/encoder", "encoder"),
        ("beacon/a/baseline", "baselines"), ("beacon/a/imu", "baselines"), ("gnss/fix", "gnss"),
        ("met/humidity", "weather"), ("ship/attitude", "ship_attitude"), ("truth/attitude", ""),
    ],
)  # fmt: skip
def test_source_of_topics(topic: str, source: str) -> None:
    assert source_of_topic(topic) == source


def rejection(ns: int, source: str, reason: Reason) -> SimpleNamespace:
    return SimpleNamespace(
        header=stamp(ns), source=source, components=[], residual=[], sigma=[], nis=math.nan, gate=math.nan,
        accepted=False, reason=int(reason), reason_text="",
    )  # fmt: skip


def solution(ns: int, status: int) -> SimpleNamespace:
    return SimpleNamespace(
        header=stamp(ns), sensor_id="bow", azimuth=1.0, elevation=0.8, status=status, star_count=6, rejected_count=2
    )


@pytest.mark.parametrize(("status", "presence"), [(0, Presence.IN), (1, Presence.IN), (3, Presence.OUT)])
def test_rejected_stars_keep_a_sensor_with_solutions_in(status: int, presence: Presence) -> None:
    monitor = monitor_after(10.0)
    for fifth in range(51, 80):
        ns = UTC + fifth * SECOND // 5
        for _ in range(2):
            monitor.process_message("star/innovation", rejection(ns, "star.bow", Reason.MISIDENTIFIED), at(fifth / 5))
        monitor.process_message("star/innovation", rejection(ns, "star.joint", Reason.MISIDENTIFIED), at(fifth / 5))
        monitor.process_message("star/bow/solution", solution(ns, status), at(fifth / 5))
    sources = {source.name: source for source in monitor.current_state(at(15.9)).sources}
    assert sources["star.bow"].presence is presence
    assert sources["star.bow"].reason == ("" if presence is Presence.IN else "29 rejected in a row: too few stars")
    assert "star.joint" not in sources


def test_consequence_keeps_its_cause_until_it_is_in_again() -> None:
    monitor = monitor_after(10.0)
    for fifth in range(51, 70):
        ns, now = UTC + fifth * SECOND // 5, at(fifth / 5)
        monitor.process_message("input_health", health(ns, "ins/imu", 20 * fifth, 100.0, 0.1), now)
        monitor.process_message("input_health", health(ns, "star/bow/solution", fifth + 1), now)
        if fifth <= 60:
            monitor.process_message("ship/integrity", integrity(ns, 2, ("ins",)), now)
            monitor.process_message("ship/innovation", rejection(ns, "star.bow", Reason.GAP), now)
    picture = monitor.current_state(at(12.1))
    assert [(source.name, source.reason, source.because_of) for source in picture.sources[:2]] == [
        ("ins", "excluded", ""), ("star.bow", "needs ins", "ins")
    ]  # fmt: skip
    monitor.process_message("ship/integrity", integrity(UTC + 13 * SECOND), at(12.2))
    source = monitor.current_state(at(12.3)).sources[0]
    assert (source.name, source.presence, source.because_of) == ("star.bow", Presence.OUT, "ins")
    for fifth in range(70, 80):
        used_ns = UTC + fifth * SECOND // 5
        used = rejection(used_ns, "star.bow", Reason.NONE)
        used.accepted = True
        monitor.process_message("ship/innovation", used, at(fifth / 5))
        monitor.process_message("input_health", health(used_ns, "star/bow/solution", fifth + 1), at(fifth / 5))
        monitor.process_message("input_health", health(used_ns, "ins/imu", 20 * fifth, 100.0, 0.1), at(fifth / 5))
    outs = [(s.name, s.reason) for s in monitor.current_state(at(15.7)).sources if s.presence is Presence.OUT]
    assert outs == []


def test_restart_of_a_node_is_one_event() -> None:
    monitor = monitor_after(10.0)
    for second in range(11, 15):
        for topic in ("star/bow/solution", "reference/gyro/imu", "star/stern/solution"):
            monitor.process_message("input_health", health(UTC + second * SECOND, topic, 5 * (second - 11)), at(second))
    events = [event.text for event in monitor.current_state(at(15.0)).events if event.kind == "node"]
    assert events == ["ship_attitude started"]


def alert(state: int, priority: int = 1, raised_s: int = 0) -> SimpleNamespace:
    time = stamp(UTC + raised_s * SECOND).stamp
    return SimpleNamespace(
        id=f"star.bow.{priority}", source="star.bow", text="star.bow out", unit="", instance=1, priority=priority,
        state=state, value=math.nan, limit=math.nan, raised=time, changed=time,
    )  # fmt: skip


def test_alerts_are_sorted_and_survive_a_reset() -> None:
    monitor = monitor_after(1.0)
    array = SimpleNamespace(header=stamp(UTC), alerts=[alert(3, 0), alert(3, 2), alert(1, 1), alert(1, 2, 5)])
    monitor.process_message("ship/alerts", array, at(1.0))
    shown = monitor.current_state(at(1.1)).alerts or ()
    assert [(one.priority, one.state) for one in shown] == [(2, 1), (1, 1), (2, 3), (0, 3)]
    monitor.reset()
    assert monitor.current_state(at(2.0)).alerts == shown
    monitor.process_message("ship/alerts", SimpleNamespace(header=stamp(UTC), alerts=[]), at(2.0))
    assert monitor.current_state(at(2.1)).alerts == ()
    texts = [event.text for event in monitor.current_state(at(2.1)).events if event.kind == "alert"]
    assert "star.bow.2 is over" in texts


def test_buffers_are_bounded_by_ten_minutes() -> None:
    monitor = SuiteMonitor()
    for second in range(1500):
        ns = UTC + second * SECOND
        monitor.process_message("ship/attitude", attitude(ns), at(second))
        message = rejection(ns, "star.bow", Reason.NONE)
        message.accepted, message.components, message.residual, message.sigma, message.nis = (
            True,
            ["up"],
            [1e-6],
            [1e-6],
            1.0,
        )
        monitor.process_message("ship/innovation", message, at(second))
    points = monitor.history.innovations["star.bow"]
    assert (len(points), points[0].utc_ns) == (601, UTC + 899 * SECOND)
    assert len(monitor.history.safety) == 601
    assert len(monitor.current_state(at(1500)).events) <= 200


def test_single_stamp_of_another_year_sets_the_time_only_briefly() -> None:
    monitor = monitor_after(10.0)
    monitor.process_message("input_health", health(UTC + 10**17, "ins/imu", 1000, 100.0, 0.1), at(10.05))
    feed(monitor, 10.1, 17.0)
    assert monitor.current_state(at(17.0)).utc_ns == UTC + 17 * SECOND


def overload_report(ns: int, node: str, text: str) -> SimpleNamespace:
    message = rejection(ns, node, Reason.BEHIND)
    message.reason_text = text
    return message


def test_overloaded_node_is_the_cause_until_the_source_is_in_again() -> None:
    """`ship_attitude` is INVALID, and measurements are rejected because of messages that the node dropped."""
    text = "ship_attitude is 3.2 s behind: the computer is too slow (2 cores, load 12)"
    monitor = monitor_after(10.0)
    for fifth in range(51, 70):
        ns, now = UTC + fifth * SECOND // 5, at(fifth / 5)
        monitor.process_message("input_health", health(ns, "ins/imu", 20 * fifth, 100.0, 0.1), now)
        monitor.process_message("input_health", health(ns, "star/bow/solution", fifth + 1), now)
        monitor.process_message("ship/innovation", rejection(ns, "star.bow", Reason.GAP), now)
        if fifth % 5 == 0:
            monitor.process_message("ship/attitude", attitude(ns, status=3, heading=math.nan), now)
            monitor.process_message("ship/innovation", overload_report(ns, "ins", f"320 messages dropped: {text}"), now)
            monitor.process_message("ship/innovation", overload_report(ns, "ship_attitude", text), now)
    picture = monitor.current_state(at(13.9))
    (heading, *_), (star, ins, *_) = picture.angles, picture.sources
    assert (heading.safety, heading.reason, heading.because_of) == (Safety.UNSAFE, text, "")
    assert (star.name, star.presence, star.reason) == ("star.bow", Presence.OUT, "ship_attitude is behind")
    assert (star.because_of, ins.presence) == ("ship_attitude", Presence.IN)
    (alert,) = conditions(picture, Limits())
    assert alert.id == "attitude.degraded"
    still = "ship_attitude is behind: the computer is too slow (2 cores)"
    assert alert.text == f"Heading and tilt lost: {still}"
    # The node is no longer overloaded; the sensor is IN again after ten measurements.
    monitor.process_message("ship/attitude", attitude(UTC + 14 * SECOND), at(14.0))
    picture = monitor.current_state(at(14.1))
    assert picture.sources[0].because_of == "ship_attitude"
    feed(monitor, 14.2, 21.0)
    picture = monitor.current_state(at(21.0))
    assert all(source.presence is not Presence.OUT for source in picture.sources)
    assert {angle.safety for angle in picture.angles} == {Safety.SAFE}


def test_source_out_before_an_overload_keeps_its_own_fault() -> None:
    monitor = monitor_after(10.0)
    for second in range(10, 18):
        ns = UTC + second * SECOND
        monitor.process_message("ship/integrity", integrity(ns, 2, ("star.bow",)), at(second))
        monitor.process_message("input_health", health(ns, "star/bow/solution", 5 * second), at(second))
        monitor.process_message("ship/attitude", attitude(ns, status=2), at(second))
    monitor.process_message(
        "ship/innovation",
        overload_report(UTC + 17 * SECOND, "ship_attitude", "ship_attitude is 3.2 s behind"),
        at(17.1),
    )
    picture = monitor.current_state(at(17.2))
    (star, *_) = picture.sources
    assert (star.name, star.reason, star.because_of) == ("star.bow", "excluded", "")
    assert {angle.unheld_safety for angle in picture.angles[:3]} == {(Safety.CAUTION, "ship_attitude is 3.2 s behind")}
    assert {angle.because_of for angle in picture.angles[:3]} == {""}  # the cause is a node


def published_message(monitor: SuiteMonitor, seconds: float) -> SimpleNamespace:
    """Return the SuiteState message of a monitor, as published by the alert node."""
    return RosidlFactory().make(STATE_TYPE, **suite_state_fields(monitor.current_state(at(seconds))))


def test_published_state_replaces_the_own_one_while_it_is_current() -> None:
    """While the state of another monitor is published, the angles and events of that state are shown."""
    other, monitor = monitor_after(20.0, sigma_arcsec=4.0), monitor_after(20.0)
    assert {angle.safety for angle in monitor.current_state(at(20.0)).angles} == {Safety.SAFE}
    monitor.process_suite_state(published_message(other, 20.0), at(20.1))
    shown = monitor.current_state(at(20.3))
    assert [(angle.safety, angle.reason, angle.since_ns) for angle in shown.angles] == [
        (angle.safety, angle.reason, angle.since_ns) for angle in other.current_state(at(20.0)).angles
    ]
    events = [event.text for event in shown.events if event.kind == "state"]
    assert "heading SAFE → CAUTION, over the limit" in events
    assert monitor.history.safety[-1].safety["heading"] is Safety.SAFE  # recorded in the second before
    feed(monitor, 20.2, 22.0)
    assert {angle.safety for angle in monitor.current_state(at(22.0)).angles} == {Safety.CAUTION}
    # After two seconds without a published state, the monitor's own safety is shown again at once.
    feed(monitor, 22.1, 22.5)
    assert {angle.safety for angle in monitor.current_state(at(22.5)).angles} == {Safety.SAFE}
    # The state is published again and displayed; after the end of the alert node the state is no longer used.
    monitor.process_suite_state(published_message(other, 20.0), at(22.6))
    assert {angle.safety for angle in monitor.current_state(at(22.6)).angles} == {Safety.CAUTION}
    monitor.clear_alerts()
    assert {angle.safety for angle in monitor.current_state(at(22.7)).angles} == {Safety.SAFE}


def test_output_that_stops_with_its_node_has_no_source_as_cause() -> None:
    """A sensor was never received and the INS gave the attitude; then the node ends: no source is the cause."""
    monitor = SuiteMonitor()
    for tenth in range(100):
        ns = tenth * SECOND // 10
        if tenth % 10 == 0:
            missing = health(UTC + ns, "star/bow/solution", 0, math.nan, math.nan)
            missing.level = 1
            monitor.process_message("input_health", missing, at(ns / SECOND))
            monitor.process_message(
                "input_health", health(UTC + ns, "ins/imu", 10 + tenth * 10, 100.0, 0.1), at(ns / SECOND)
            )
        monitor.process_message("ship/attitude", attitude(UTC + ns, 100.0), at(ns / SECOND))
    assert {angle.reason for angle in monitor.current_state(at(10.0)).angles} == {"star.bow never received"}
    assert {angle.reason for angle in monitor.current_state(at(20.0)).angles} == {"no data on ship/attitude"}

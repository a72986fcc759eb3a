import math

import pytest

from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import duration_text
from ship_estimation.rejection_rules import Reason, Rejection
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages.common_messages import Level
from ship_node.messages.inputs_outputs import InputTopic

MS = 1_000_000
S = 1_000_000_000
START_NS = 1_400_000_000 * S
IMU, STAR = "ins/imu", "star/fore/horizon_attitude"


@pytest.fixture
def health():
    """Return a monitor of a required INS and an optional star sensor."""
    return InputHealthMonitor(
        [
            InputTopic(IMU, "sensor_msgs/msg/Imu", required=True, depth=100),
            InputTopic(STAR, "ship_msgs/msg/StarHorizonAttitude", required=False, depth=10),
        ]
    )


def feed(health, count, *, start_ns=START_NS, period_ns=10 * MS, latency_ns=5 * MS):
    """Add accepted INS samples; return the time of the last arrival, ns."""
    for i in range(count):
        receive_ns = start_ns + i * period_ns
        health.record_arrival(IMU, receive_ns)
        health.record_accepted(IMU, receive_ns - latency_ns, receive_ns)
    return receive_ns


def reject(health, count, reason, *, start_ns=START_NS, period_ns=10 * MS):
    for i in range(count):
        receive_ns = start_ns + i * period_ns
        health.record_arrival(IMU, receive_ns)
        health.record_rejected(IMU, Rejection(reason, f"text {i}"), receive_ns)
    return receive_ns


def statuses_of(health, now_ns):
    return health.messages_and_statuses(RosidlFactory(), now_ns, now_ns)[1]


def imu_status(health, now_ns):
    return {status.name: status for status in statuses_of(health, now_ns)}[f"input {IMU}"]


def imu_message(health, now_ns):
    return {message.topic: message for message in health.messages(RosidlFactory(), now_ns)}[IMU]


def test_good_data_is_ok_with_rate_latency_and_age(health):
    last_ns = feed(health, 200)
    status = imu_status(health, last_ns + 10 * MS)
    assert (status.level, status.message) == (Level.OK, "100.0 Hz, latency 0.005 s")
    message = imu_message(health, last_ns + 10 * MS)
    assert (message.received, message.accepted, message.rejected, message.level) == (200, 200, 0, 0)
    # The messages are 10 ms apart with a latency of 5 ms; the status is taken 10 ms after the last arrival.
    assert (message.rate_hz, message.latency_s, message.age_s) == pytest.approx((100.0, 0.005, 0.015))


def test_before_the_first_message_values_are_nan_and_level_ok(health):
    statuses_of(health, START_NS)
    message = imu_message(health, START_NS + 4_999 * MS)
    assert (message.received, message.level) == (0, 0)
    assert all(math.isnan(value) for value in (message.rate_hz, message.latency_s, message.age_s))


def test_required_topic_without_messages_is_an_error_after_five_seconds(health):
    statuses_of(health, START_NS)
    statuses = statuses_of(health, START_NS + 5 * S)
    assert [status.level for status in statuses] == [Level.ERROR, Level.OK]
    assert statuses[0].message == "required input: no message for 5 s since the start"
    assert statuses[1].message == "no message yet"


def test_first_message_timeout_text_depends_on_the_publishers(health):
    statuses_of(health, START_NS)
    health.set_publisher_count(IMU, 0)
    health.set_publisher_count(STAR, 2)
    imu, star = statuses_of(health, START_NS + 6 * S)
    assert imu.message.endswith(": no publisher, start the driver or check the topic name")
    assert star.level is Level.WARN
    assert star.message == "no message for 6 s from 2 publisher(s): QoS mismatch, or none is sent"


def test_a_configured_device_without_messages_is_a_warning():
    """The topic of the device has no publisher, as after a mistyped id."""
    monitor = InputHealthMonitor(
        [InputTopic(STAR, "ship_msgs/msg/StarHorizonAttitude", False, depth=10, is_configured=True)]
    )
    statuses_of(monitor, START_NS)
    monitor.set_publisher_count(STAR, 0)
    (early,), (late,) = statuses_of(monitor, START_NS + 4 * S), statuses_of(monitor, START_NS + 5 * S)
    assert (early.level, early.message) == (Level.OK, "no message yet")
    assert late.level is Level.WARN
    assert late.message.startswith("no message for 5 s since the start: no publisher, ")


def test_one_message_has_no_rate(health):
    imu, _ = statuses_of(health, feed(health, 1))
    assert imu.message == "messages: 1, latency 0.005 s"


@pytest.mark.parametrize(("timeout_ms", "level"), [(100, Level.OK), (101, Level.WARN), (1001, Level.ERROR)])
def test_timeout_of_a_required_fast_topic(health, timeout_ms, level):
    last_ns = feed(health, 100)
    assert imu_status(health, last_ns + timeout_ms * MS).level is level


@pytest.mark.parametrize(("timeout_ms", "level"), [(600, Level.OK), (601, Level.WARN), (5000, Level.WARN)])
def test_timeout_of_an_optional_slow_topic_is_three_periods(health, timeout_ms, level):
    for i in range(20):
        health.record_arrival(STAR, START_NS + i * 200 * MS)
        health.record_accepted(STAR, START_NS + i * 200 * MS, START_NS + i * 200 * MS)
    status = statuses_of(health, START_NS + (19 * 200 + timeout_ms) * MS)[1]
    assert status.level is level
    assert ("no data for" in status.message) == (level is Level.WARN)


def test_one_gap_does_not_hide_the_next(health):
    last_ns = feed(health, 30)
    last_ns = feed(health, 5, start_ns=last_ns + 60 * S)
    assert imu_status(health, last_ns + 200 * MS).message == "no data for 0.2 s"


def test_timeout_after_a_single_message(health):
    last_ns = feed(health, 1)
    assert imu_status(health, last_ns + 5 * S).level is Level.OK
    assert imu_status(health, last_ns + 5 * S + 1).level is Level.ERROR


def test_rate_decreases_without_messages(health):
    last_ns = feed(health, 51)
    # 50 intervals in 0.5 s, then 4.5 s of nothing.
    assert imu_message(health, last_ns + 4_500 * MS).rate_hz == pytest.approx(10.0)


def test_single_rejection_is_a_warning_for_two_seconds_with_reason_and_count(health):
    feed(health, 50)
    rejected_ns = reject(health, 1, Reason.BAD_QUATERNION, start_ns=START_NS + 500 * MS)
    feed(health, 300, start_ns=rejected_ns + 10 * MS)
    status = imu_status(health, rejected_ns + 1_100 * MS)
    assert (status.level, status.message) == (Level.WARN, "rejected, bad_quaternion: text 0")
    assert status.values["reason bad_quaternion"] == "1"
    message = imu_message(health, rejected_ns + 1_100 * MS)
    assert (message.rejected, message.reasons, list(message.reason_counts)) == (1, ["bad_quaternion"], [1])
    assert imu_status(health, rejected_ns + 2_001 * MS).level is Level.OK


def test_single_gate_rejection_is_no_warning_but_several_in_a_row_are(health):
    last_ns = reject(health, 4, Reason.GATE, start_ns=feed(health, 50) + 10 * MS)
    assert imu_status(health, last_ns).level is Level.OK
    last_ns = reject(health, 1, Reason.GATE, start_ns=last_ns + 10 * MS)
    assert imu_status(health, last_ns).message == "5 rejected in a row, last gate: text 0"


@pytest.mark.parametrize(("count", "level"), [(5, Level.WARN), (19, Level.WARN), (20, Level.ERROR)])
def test_consecutive_rejections(health, count, level):
    status = imu_status(health, reject(health, count, Reason.BAD_COVARIANCE))
    assert (status.level, status.message.split(",")[0]) == (level, f"{count} rejected in a row")


def test_accepted_message_ends_consecutive_rejections(health):
    last_ns = feed(health, 1, start_ns=reject(health, 30, Reason.UNITS) + 10 * MS)
    assert imu_status(health, last_ns + 2 * S + 10 * MS).message.startswith("no data")
    reject(health, 4, Reason.UNITS, start_ns=last_ns + 10 * MS)
    assert "in a row" not in imu_status(health, last_ns + 50 * MS).message


def test_ten_consecutive_future_stamps_are_a_clock_offset(health):
    last_ns = reject(health, 9, Reason.FUTURE)
    assert imu_status(health, last_ns).level is Level.WARN
    last_ns = reject(health, 1, Reason.FUTURE, start_ns=last_ns + 10 * MS)
    status = imu_status(health, last_ns)
    assert status.level is Level.ERROR
    assert status.message.startswith("clock offset: 10 stamps in a row in the future")


def test_another_rejection_in_between_is_no_clock_offset(health):
    last_ns = reject(health, 9, Reason.FUTURE)
    last_ns = reject(health, 1, Reason.FRAME, start_ns=last_ns + 10 * MS)
    last_ns = reject(health, 9, Reason.FUTURE, start_ns=last_ns + 10 * MS)
    assert "clock offset" not in imu_status(health, last_ns).message


def test_delays_of_late_messages_are_kept(health):
    for delay_ms in (500, 2_500, 4_000, 90_000):
        health.record_arrival(IMU, START_NS)
        health.record_rejected(IMU, Rejection(Reason.LATE, "older than the lag"), START_NS, START_NS - delay_ms * MS)
    values = imu_status(health, START_NS).values
    late = {key: value for key, value in values.items() if key.startswith("late ")}
    assert late == {"late up to 1 s": "1", "late up to 5 s": "2", "late above 60 s": "1"}


def test_noted_reason_is_counted_and_the_message_accepted(health):
    last_ns = feed(health, 3)
    health.record_note(IMU, Reason.COVARIANCE_UNKNOWN)
    message = imu_message(health, last_ns)
    assert (message.accepted, message.rejected, message.level) == (3, 0, 0)
    assert (message.reasons, list(message.reason_counts)) == (["covariance_unknown"], [1])


def test_incompatible_qos_is_an_error_until_the_publisher_goes(health):
    last_ns = feed(health, 10)
    health.record_incompatible_qos(IMU, "RELIABILITY")
    assert imu_status(health, last_ns).message == "incompatible QoS: RELIABILITY"
    assert imu_status(health, last_ns).level is Level.ERROR
    health.set_publisher_count(IMU, 0)
    assert imu_status(health, last_ns).level is Level.OK


def test_restart_keeps_counts_and_resets_times(health):
    feed(health, 50)
    reject(health, 30, Reason.FUTURE, start_ns=START_NS + 500 * MS)
    early_ns = START_NS - 3600 * S
    health.restart()
    message = imu_message(health, early_ns + 1 * S)
    assert (message.received, message.rejected, message.level) == (80, 30, 0)
    assert math.isnan(message.rate_hz)
    assert math.isnan(message.age_s)
    assert imu_status(health, early_ns + 6 * S).level is Level.ERROR


def test_late_sample_does_not_make_the_data_older(health):
    health.record_arrival(IMU, START_NS)
    health.record_accepted(IMU, START_NS - 1 * S, START_NS)
    health.record_arrival(IMU, START_NS)
    health.record_accepted(IMU, START_NS - 2 * S, START_NS)
    assert imu_message(health, START_NS).age_s == pytest.approx(1.0)


def test_lost_messages_are_shown(health):
    health.record_lost(IMU, 3)
    health.record_lost(IMU, 4)
    assert imu_status(health, START_NS).values["lost by the middleware"] == "7"


def test_too_old_stamps_are_an_error(health):
    last_ns = feed(health, 20, latency_ns=26_790_201 * S)
    status = imu_status(health, last_ns)
    assert (status.level, status.values["accepted"], status.values["reason clock"]) == (Level.ERROR, "20", "20")
    assert status.message == "stamps 310 days before the node's clock: set the clocks, or play a bag with /clock"
    assert health.stale_stamps_text() == f"{IMU}: {status.message}"
    rejected, noted = health.rejection_and_note_counts()[IMU]
    assert (rejected.total(), dict(noted)) == (0, {Reason.CLOCK: 20})
    health.set_clock_unused(True)
    assert imu_status(health, last_ns).message.endswith(": /clock is published: start the node with use_sim_time:=true")
    message = imu_message(health, last_ns)
    assert (message.level, message.accepted, message.rejected) == (2, 20, 0)
    # The error ends with the first recent stamp.
    last_ns = feed(health, 1, start_ns=last_ns + 10 * MS)
    assert imu_status(health, last_ns).level == Level.OK
    assert health.stale_stamps_text() == ""


def test_maximum_age_of_stamps():
    monitor = InputHealthMonitor([InputTopic(IMU, "sensor_msgs/msg/Imu", required=True, depth=100)], max_age_s=10.0)
    assert imu_status(monitor, feed(monitor, 3, latency_ns=10 * S)).level == Level.OK
    assert imu_status(monitor, feed(monitor, 3, latency_ns=10 * S + 1)).level == Level.ERROR


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0051, "0.005 s"),
        (119.9, "119.900 s"),
        (120, "2 minutes"),
        (7200, "2 hours"),
        (172_800, "2 days"),
        (26_790_201.462, "310 days"),
        (1.4e9, "44 years"),
        (-300, "5 minutes"),
    ],
)
def test_duration_texts(seconds, text):
    assert duration_text(round(seconds * S)) == text


def test_occasional_topics_have_no_timeout():
    target = "theodolite/target"
    monitor = InputHealthMonitor(
        [InputTopic(target, "ship_msgs/msg/TargetImage", required=False, depth=10, is_occasional=True)]
    )
    statuses_of(monitor, START_NS)
    monitor.set_publisher_count(target, 1)
    (status,) = statuses_of(monitor, START_NS + 60 * S)
    assert (status.level, status.message) == (Level.OK, "no message yet")
    for i in range(10):
        monitor.record_arrival(target, START_NS + i * 100 * MS)
        monitor.record_accepted(target, START_NS + i * 100 * MS, START_NS + i * 100 * MS)
    (gone,) = statuses_of(monitor, START_NS + 120 * S)
    assert gone.level is Level.OK

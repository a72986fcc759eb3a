"""Reports of nodes on a topic: age of its last message, timeout, rejections, restarts of nodes."""

import math
from types import SimpleNamespace

import pytest

from ship_watch.sources.reports import TopicReports

SECOND = 1_000_000_000
UTC = 1_404_906_607 * SECOND


def report(
    second: float, received: int, age_s: float = 0.2, rate_hz: float = 5.0, rejected: int = 0, **reasons: int
) -> SimpleNamespace:
    ns = UTC + round(second * SECOND)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=ns // SECOND, nanosec=ns % SECOND)),
        topic="star/bow/solution", received=received, accepted=received - rejected, rejected=rejected,
        rate_hz=rate_hz, latency_s=0.1, age_s=age_s, level=0,
        reasons=list(reasons), reason_counts=list(reasons.values()),
    )  # fmt: skip


def at(second: float) -> int:
    return round(second * SECOND)


def received_reports(seconds: int, longest_s: float = 0.0, **of_report: float) -> TopicReports:
    reports = TopicReports("star/bow/solution", longest_s)
    for second in range(seconds + 1):
        reports.record_report(report(second, 5 * second, **of_report), at(second))  # type: ignore[arg-type]
    return reports


def test_age_counts_from_arrival_not_from_the_stamp() -> None:
    reports = received_reports(10)
    # The last message was stamped 0.2 s ago and arrived 0.1 s after its stamp.
    assert reports.age_s(at(10.0)) == pytest.approx(0.1)
    assert reports.age_s(at(10.9)) == pytest.approx(0.1)  # the next report is not due
    assert reports.age_s(at(12.0)) == pytest.approx(2.1)


def test_stamps_of_another_time_are_no_timeout() -> None:
    reports = TopicReports("ins/imu")
    for second in range(11):
        message = report(second, 100 * second, age_s=26_784_000.01, rate_hz=100.0)
        message.latency_s = 26_784_000.0
        reports.record_report(message, at(second))
    assert reports.age_s(at(10.0)) == pytest.approx(0.01, abs=1e-6)
    assert not reports.is_timed_out(at(10.9))


def test_timeout_after_two_seconds_or_three_periods() -> None:
    reports = received_reports(10)
    reports.record_report(report(11, 50, age_s=1.2), at(11))
    assert not reports.is_timed_out(at(11.8))
    assert reports.is_timed_out(at(11.9))
    slow = TopicReports("met/pressure")
    for second in range(42):
        slow.record_report(report(second, 1 + second // 4, age_s=0.1 + second % 4, rate_hz=0.25), at(second))
    assert not slow.is_timed_out(at(51.9))
    assert slow.is_timed_out(at(52.1))


def test_late_report_is_no_timeout_of_the_topic() -> None:
    """After a report with new messages, a timeout needs the next report, or a long time without one."""
    reports = received_reports(10)
    assert not reports.is_timed_out(at(12.9))
    assert not reports.is_report_overdue(at(12.9))
    reports.record_report(report(12.9, 64), at(12.9))
    assert not reports.is_timed_out(at(15.8))
    assert reports.is_timed_out(at(30.0))
    assert reports.is_report_overdue(at(30.0))


def test_timeout_can_be_configured() -> None:
    reports = received_reports(10, longest_s=30.0)
    assert not reports.is_timed_out(at(20.0))
    assert reports.is_timed_out(at(40.0))


def test_decreasing_mean_rate_does_not_lengthen_the_timeout() -> None:
    reports = received_reports(10)
    for second in range(11, 15):
        reports.record_report(report(second, 50, age_s=second - 9.8, rate_hz=5.0 * (20 - second) / 20), at(second))
    assert reports.period_ns == pytest.approx(0.2e9)
    assert reports.is_timed_out(at(11.9))


def test_rejected_messages_count_as_arrived() -> None:
    reports = received_reports(10)
    for second in range(11, 31):
        received = report(
            second, 5 * second, age_s=second - 9.8, rejected=5 * (second - 10), excluded=5 * (second - 10)
        )
        reports.record_report(received, at(second))
        assert not reports.is_timed_out(at(second + 0.9))
    assert reports.input_state(at(30.5)).rejected_60s == 100
    assert reports.input_state(at(30.5)).reasons == {"excluded": 100}
    assert reports.input_state(at(89.0)).rejected_60s == pytest.approx(10, abs=5)  # those of the last two seconds


def test_two_nodes_on_one_topic_are_no_restarts() -> None:
    reports, started = TopicReports("ins/imu"), []
    for second in range(60):
        # The second node started 30 s after the first, and reports 0.4 s later; both reject one message a second.
        first = report(second, 5 * (second + 30), rejected=second, gate=second)
        other = report(second + 0.4, 5 * second, rejected=second, gate=second)
        started += [reports.record_report(first, at(second)), reports.record_report(other, at(second + 0.4))]
    assert not any(started[2:])
    assert reports.input_state(at(59.4)).rejected_60s == 59
    assert reports.input_state(at(59.4)).reasons == {"gate": 59}


def test_restart_of_a_node_is_reported_once() -> None:
    reports = received_reports(10)
    started = [reports.record_report(report(second, 5 * (second - 12)), at(second)) for second in range(13, 20)]
    assert started == [True, False, False, False, False, False, False]
    assert reports.input_state(at(19.0)).rejected_60s == 0


def test_timeout_is_longer_before_the_rate_is_known() -> None:
    reports = TopicReports("met/pressure")
    reports.record_report(report(0, 1, age_s=0.1, rate_hz=math.nan), at(0))
    assert not reports.is_timed_out(at(4.9))
    assert reports.is_timed_out(at(5.1))


def test_topic_that_was_never_received() -> None:
    reports = TopicReports("gnss/fix")
    reports.record_report(report(0, 0, age_s=math.nan, rate_hz=math.nan), at(0))
    assert math.isinf(reports.age_s(at(1.0)))
    assert not reports.is_timed_out(at(100.0))
    assert not reports.is_never_received
    missing = report(6, 0, age_s=math.nan, rate_hz=math.nan)
    missing.level = 2
    reports.record_report(missing, at(6))
    assert reports.is_never_received
    # The monitor may receive a topic that the node does not, because of another quality of service.
    reports.record_arrival(at(6.5))
    assert reports.is_never_received
    came = report(7, 3, age_s=0.1)
    reports.record_report(came, at(7))
    assert not reports.is_never_received

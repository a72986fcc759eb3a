"""Status of the attitude while inputs fail together, are late or wrong."""

import functools
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from ship_estimation.time_order.outcome import Status
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, change_where, hand_over, sort_by_arrival, stamp_of
from ship_testing.ship_observations import run_new_adapter
from ship_testing.small_voyage import (
    FORE,
    INS,
    STARBOARD,
    Run,
    assert_consistent,
    fault_free_run,
    new_adapter,
    remove_interval,
    run_adapter,
    voyage,
)
from ship_testing.star_voyage import FIX, without_topics
from ship_testing.star_voyage import voyage as voyage_of_stars

ATTITUDE = "ship/attitude"
BUDGETS = ("ship/error_budget", "ship/error_arcsec")


def at(s: float) -> int:
    return START_NS + round(s * SECOND_NS)


def published_attitudes(run: Run) -> list[Any]:
    return [m for m in run.messages(ATTITUDE) if m.status != Status.INVALID]


def attitudes_by_time(run: Run) -> list[tuple[int, Any]]:
    """Return (time, attitude) of the published attitudes that are not INVALID."""
    return [(ns, m) for ns, topic, m in run.published if topic == ATTITUDE and m.status != Status.INVALID]


def invalid_times_ns(run: Run) -> list[int]:
    """Return the times of INVALID, except at the start."""
    return [ns for ns, topic, m in run.published if topic == ATTITUDE and m.status == Status.INVALID and ns > at(0.5)]


def assert_in_order(run: Run) -> None:
    assert all(stamp_of(earlier) < stamp_of(later) for earlier, later in pairwise(published_attitudes(run)))


def assert_invalid_once_a_second(run: Run, from_s: float, until_s: float) -> None:
    """Assert that INVALID is published each second from 1.1 s after ``from_s`` on, without budgets and other statuses.
    """
    times_ns = [ns for ns in invalid_times_ns(run) if at(from_s) <= ns < at(until_s)]
    assert times_ns[0] <= at(from_s + 1.1)
    assert all(SECOND_NS <= later - earlier <= 1.1 * SECOND_NS for earlier, later in pairwise(times_ns))
    assert until_s - (times_ns[-1] - START_NS) / SECOND_NS <= 1.2
    assert [topic for ns, topic, _ in run.published if topic in BUDGETS and times_ns[0] < ns < at(until_s)] == []
    statuses = run.diagnostics("attitude", times_ns[0], at(until_s))
    assert {(level, text.partition(":")[0]) for level, text in statuses} == {(2, "INVALID")}


def one_star(message: Any) -> None:
    message.stars = message.stars[:1]


def wrong_frame(message: Any) -> None:
    message.header.frame_id = "radar"


def test_exposures_with_one_star_do_not_hide_an_ins_timeout() -> None:
    stars = [a for a in voyage_of_stars(6.0) if a.topic != INS or a.stamp_ns < at(3.0)]
    stars = change_where(stars, lambda a: a.topic.endswith("observations") and a.stamp_ns > at(2.5), one_star)
    assert_invalid_once_a_second(run_new_adapter(stars), 3.0, 6.0)


def test_exposures_without_a_fix_do_not_hide_an_ins_timeout() -> None:
    stars = [a for a in voyage_of_stars(6.0) if a.topic != INS or a.stamp_ns < at(3.0)]
    run = run_new_adapter(without_topics(stars, FIX))
    assert {m.status for m in published_attitudes(run)} == {Status.DEGRADED}
    assert_invalid_once_a_second(run, 3.0, 6.0)


def test_rejected_ins_samples_give_no_attitude() -> None:
    """INS samples arrive at the full rate, in order, and are not usable; no star sensor works."""
    arrivals = remove_interval(voyage(8.0), 3.0, 8.0, FORE, STARBOARD)
    run = run_adapter(
        new_adapter(), change_where(arrivals, lambda a: a.topic == INS and at(3.0) < a.stamp_ns, wrong_frame)
    )
    assert_invalid_once_a_second(run, 3.0, 8.0)


def test_attitudes_come_from_stars_while_the_ins_is_rejected() -> None:
    arrivals = change_where(voyage(8.0), lambda a: a.topic == INS and at(3.0) < a.stamp_ns < at(6.0), wrong_frame)
    run = run_adapter(new_adapter(), arrivals)
    by_stars = [m for m in published_attitudes(run) if at(4.0) < stamp_of(m) < at(6.0)]
    assert len(by_stars) == 20
    assert {m.status for m in by_stars} == {Status.DEGRADED}
    assert [ns for ns in invalid_times_ns(run) if ns > at(4.0)] == []
    assert_in_order(run)


def test_attitudes_come_from_stars_while_no_ins_sample_has_a_rate() -> None:
    """From 3 s on the INS samples are 0.9 s apart, too far to interpolate, and have no rates."""

    def without_rates(message: Any) -> None:
        message.angular_velocity_covariance = [-1.0] + 8 * [0.0]

    def is_kept(arrival: Arrival) -> bool:
        sparse = (arrival.stamp_ns - START_NS) % (9 * SECOND_NS // 10) == 0
        return arrival.topic != INS or arrival.stamp_ns < at(3.0) or sparse

    arrivals = change_where([a for a in voyage(8.0) if is_kept(a)], lambda a: a.topic == INS, without_rates)
    run = run_adapter(new_adapter(), arrivals)
    by_stars = [m for m in published_attitudes(run) if at(4.2) < stamp_of(m) < at(7.5)]
    assert {m.status for m in by_stars} == {Status.DEGRADED}
    assert len(by_stars) > 25
    assert [ns for ns in invalid_times_ns(run) if ns > at(4.2)] == []
    assert_in_order(run)


def test_ins_and_stars_stop_and_come_back() -> None:
    """The INS stops, then the stars too; the stars come back, then the INS."""
    arrivals = remove_interval(remove_interval(voyage(14.0), 3.0, 9.0, INS), 5.0, 7.0, FORE, STARBOARD)
    run = run_adapter(new_adapter(), arrivals)
    by_second = {second: set() for second in range(14)}
    for ns, topic, message in run.published:
        if topic == ATTITUDE:
            by_second[(ns - START_NS) // SECOND_NS].add(Status(message.status).name)
    assert by_second[4] == by_second[8] == {"DEGRADED"}
    assert by_second[6] == {"INVALID"}
    assert by_second[10] == by_second[13] == {"VALID"}
    assert_in_order(run)
    for message in published_attitudes(run):
        assert_consistent(message)


def test_no_error_budget_is_published_twice() -> None:
    run = run_adapter(
        new_adapter(slow_topics_period_s=0.1), remove_interval(voyage(8.0), 3.0, 6.0, INS, FORE, STARBOARD)
    )
    for topic in BUDGETS:
        stamps = [stamp_of(m) for m in run.messages(topic)]
        assert len(stamps) == len(set(stamps)) > 40
        assert all(ns <= at(3.2) or ns > at(6.0) for ns, name, _ in run.published if name == topic)


# -- late data, and corrected clocks --------------------------------------------------------------------------


def with_latency(arrivals: Iterable[Arrival], latency_s: Callable[[str], float]) -> tuple[Arrival, ...]:
    return sort_by_arrival(
        replace(a, receive_ns=a.receive_ns + round(latency_s(a.topic) * SECOND_NS)) for a in arrivals
    )


@pytest.mark.parametrize(
    "latency_s", [lambda topic: 1.05 if topic == INS else 0.0, lambda topic: 1.5, lambda topic: 9.0]
)
def test_old_stamps_are_no_timeout(latency_s: Callable[[str], float]) -> None:
    """The INS is late by less than the lag, or all inputs are late."""
    run = run_adapter(new_adapter(), with_latency(voyage(), latency_s))
    by_ins, expected = (
        [stamp_of(m) for m in published_attitudes(r) if "ins" in m.sources] for r in (run, fault_free_run())
    )
    # Stars that arrived before the first INS sample gave attitudes first.
    assert by_ins == [ns for ns in expected if latency_s(FORE) or ns > at(0.877)]
    assert [ns for ns in invalid_times_ns(run) if ns > at(latency_s(INS) + 0.1)] == []
    assert_in_order(run)
    assert run.state() == fault_free_run().state()
    assert run.messages(ATTITUDE)[-1].status == Status.VALID
    assert run.diagnostics("attitude", at(3.0 + latency_s(INS)), run.now_ns)[-1] == (0, "VALID: INS and stars")


@pytest.mark.parametrize("step_s", [-0.04, 1.0, 5.0, 3600.0])
def test_a_corrected_clock_is_no_timeout(step_s: float) -> None:
    """The node's clock jumps while data and ticks continue: the attitudes and their publication times are the same."""
    run = Run(new_adapter())
    hand_over(run, voyage(), node_ns=lambda ns: ns + (round(step_s * SECOND_NS) if ns > at(2.5) else 0))
    by_the_clock = "ship/alignment", "/tf_static"  # these have the node's time
    expected = [result for result in fault_free_run().results() if result[1] not in by_the_clock]
    assert [result for result in run.results() if result[1] not in by_the_clock] == expected


def test_a_leap_second_costs_attitudes_only_until_it_is_detected() -> None:
    """One second of stamps is repeated; the clocks of the node continue. All inputs show the step within 0.4 s."""

    def set_back(message: Any) -> None:
        message.header.stamp.sec -= 1

    arrivals = voyage(17.0)
    run = run_adapter(new_adapter(), change_where(arrivals, lambda a: a.stamp_ns >= at(3.0), set_back))
    assert invalid_times_ns(run) == []
    before = [m for ns, m in attitudes_by_time(run) if ns < at(3.0)]
    after = [m for ns, m in attitudes_by_time(run) if ns >= at(3.0)]
    for one in (before, after):
        assert all(stamp_of(earlier) < stamp_of(later) for earlier, later in pairwise(one))
    stamps = [a.stamp_ns for a in arrivals if a.topic == INS]
    assert [stamp_of(m) for m in after] == [ns - SECOND_NS for ns in stamps if ns >= at(3.32)]
    assert {m.status for m in after} == {Status.VALID}


@functools.cache
def run_with_stopped_node(from_s: float, until_s: float) -> Run:
    """Messages received while the node was stopped are processed when it continues, after the ticks of the stop."""
    arrivals = [replace(a, receive_ns=at(until_s)) if at(from_s) < a.receive_ns < at(until_s) else a for a in voyage()]
    return run_adapter(new_adapter(), arrivals)


def test_data_received_during_a_stop_are_published_after_it() -> None:
    run = run_with_stopped_node(2.5, 3.7)
    assert len(invalid_times_ns(run)) == 1
    assert [stamp_of(m) for m in published_attitudes(run)] == [
        stamp_of(m) for m in published_attitudes(fault_free_run())
    ]
    assert run.state() == fault_free_run().state()


def test_invalid_has_the_time_of_the_tick_and_delays_nothing() -> None:
    run = run_with_stopped_node(2.5, 3.7)
    (invalid,) = [m for ns, topic, m in run.published if topic == ATTITUDE and ns in invalid_times_ns(run)]
    assert stamp_of(invalid) == invalid_times_ns(run)[0]
    index = run.messages(ATTITUDE).index(invalid)
    assert stamp_of(run.messages(ATTITUDE)[index + 1]) < stamp_of(invalid)


def test_with_a_frozen_clock_invalid_is_published_at_its_time() -> None:
    run = Run(new_adapter())
    arrivals = [a for a in voyage() if a.receive_ns <= at(3.0)]
    hand_over(run, arrivals, until_ns=at(6.0), node_ns=lambda ns: min(ns, at(3.0)))
    assert_invalid_once_a_second(run, 3.0, 6.0)
    invalid = [m for m in run.messages(ATTITUDE) if m.status == Status.INVALID]
    assert {stamp_of(m) for m in invalid[-2:]} == {at(3.0)}


def test_attitudes_come_from_stars_while_the_ins_is_too_late() -> None:
    """INS samples arrive at the full rate, each 3 s old: more than the lag behind the stars."""
    run = run_adapter(new_adapter(), with_latency(voyage(8.0), lambda topic: 3.0 if topic == INS else 0.0))
    assert run.reasons(INS)["late"] > 100
    by_stars = [m for m in published_attitudes(run) if "ins" not in m.sources]
    assert {m.status for m in by_stars} == {Status.DEGRADED}
    assert len(by_stars) > 60
    assert [ns for ns in invalid_times_ns(run) if ns < at(9.0)] == []
    assert_in_order(run)

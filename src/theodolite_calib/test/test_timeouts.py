"""Pointing while inputs fail together or are late: published pointings are final."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from ship_estimation.time_order.outcome import Status
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, hand_over, sort_by_arrival, stamp_of
from ship_testing.small_session import BEACONS, ENCODER, SHIP, Run, fault_free_run, new_adapter, run_adapter, session

POINTING = "theodolite/pointing"
BUDGETS = ("theodolite/error_budget", "theodolite/error_arcsec")
FROM_S = 2.0


def time_at(s: float) -> int:
    return START_NS + round(s * SECOND_NS)


def claimed_pointings(run: Run) -> list[Any]:
    return [m for m in run.pointings if m.status != Status.INVALID]


def invalid_times(run: Run) -> list[int]:
    """Return the times of INVALID outputs, except at the start."""
    return [
        ns for ns, topic, m in run.published if topic == POINTING and m.status == Status.INVALID and ns > time_at(0.5)
    ]


def assert_in_order(run: Run) -> None:
    assert all(stamp_of(earlier) < stamp_of(later) for earlier, later in pairwise(claimed_pointings(run)))


def arrivals_until(arrivals: Iterable[Arrival], s: float, *topics: str) -> list[Arrival]:
    return [a for a in arrivals if a.topic not in topics or a.stamp_ns < time_at(s)]


@pytest.mark.parametrize(
    ("dead", "missing"),
    [
        ((SHIP,), "no attitude on ship/attitude"),
        ((ENCODER,), "no usable reading of the encoders"),
        ((ENCODER, SHIP), "no usable reading of the encoders"),
    ],
)
def test_published_pointing_is_final(dead: tuple[str, ...], missing: str) -> None:
    """The beacons continue all the time."""
    run = run_adapter(
        new_adapter(slow_topics_period_s=0.2), arrivals_until(session(), FROM_S, *dead), until_ns=time_at(5.0)
    )
    times_ns = invalid_times(run)
    assert time_at(FROM_S + 0.9) < times_ns[0] <= time_at(FROM_S + 1.2)
    assert all(SECOND_NS <= later - earlier <= 1.1 * SECOND_NS for earlier, later in pairwise(times_ns))
    assert len(times_ns) == 3
    assert [topic for ns, topic, _ in run.published if topic in BUDGETS and ns > times_ns[0]] == []
    assert set(run.diagnostics("pointing", times_ns[0], run.now_ns)) == {(2, f"INVALID: {missing}")}
    for topic in BUDGETS:
        stamps = [stamp_of(m) for m in run.messages(topic)]
        assert len(stamps) == len(set(stamps)) > 5


def test_encoder_and_ship_time_out_and_return() -> None:
    """First the ship's attitude ends, then both; the encoder returns first."""
    gaps = {SHIP: (1.0, 3.5), ENCODER: (1.6, 3.0)}
    spans = {topic: range(*map(time_at, gap)) for topic, gap in gaps.items()}
    arrivals = [a for a in session() if a.stamp_ns not in spans.get(a.topic, ())]
    run = run_adapter(new_adapter(), arrivals)
    assert len(invalid_times(run)) in (1, 2)
    assert_in_order(run)
    back = [m for m in claimed_pointings(run) if stamp_of(m) >= time_at(3.6)]
    assert [stamp_of(m) for m in back] == [
        stamp_of(m) for m in claimed_pointings(fault_free_run()) if stamp_of(m) >= time_at(3.6)
    ]
    assert back[-1].status == Status.VALID


def delay_arrivals(arrivals: Iterable[Arrival], latency_s: Callable[[str], float]) -> tuple[Arrival, ...]:
    return sort_by_arrival(
        replace(a, receive_ns=a.receive_ns + round(latency_s(a.topic) * SECOND_NS)) for a in arrivals
    )


@pytest.mark.parametrize("late", [(SHIP,), (ENCODER, SHIP), (ENCODER, SHIP, BEACONS)])
def test_old_stamps_are_no_timeout(late: tuple[str, ...]) -> None:
    run = run_adapter(new_adapter(), delay_arrivals(session(), lambda topic: 1.3 if topic in late else 0.0))
    assert [stamp_of(m) for m in claimed_pointings(run)] == [stamp_of(m) for m in claimed_pointings(fault_free_run())]
    assert [ns for ns in invalid_times(run) if ns > time_at(1.4)] == []


@pytest.mark.parametrize("step_s", [-0.04, 1.0, 5.0])
def test_corrected_clock_is_no_timeout(step_s: float) -> None:
    run = Run(new_adapter())
    hand_over(run, session(), node_ns=lambda ns: ns + (round(step_s * SECOND_NS) if ns > time_at(2.0) else 0))
    expected = [result for result in fault_free_run().results() if result[1] != "theodolite/calibration"]
    assert [result for result in run.results() if result[1] != "theodolite/calibration"] == expected


def test_data_received_during_a_stop_are_published_after_it() -> None:
    arrivals = [
        replace(a, receive_ns=time_at(3.4)) if time_at(2.2) < a.receive_ns < time_at(3.4) else a for a in session()
    ]
    run = run_adapter(new_adapter(), arrivals)
    assert len(invalid_times(run)) == 1
    assert [stamp_of(m) for m in claimed_pointings(run)] == [stamp_of(m) for m in claimed_pointings(fault_free_run())]
    assert run.state() == fault_free_run().state()

"""``ship_attitude`` and ``star_attitude`` during a step of all clocks aboard: VALID within two seconds, and correct.

Stars then verify UTC: if UTC is wrong before or after the step, the sky is rotated by the step.
"""

import functools
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import log_rotation
from ship_node.health.time_base import TimeBase
from ship_testing.adapter_runs import (
    FACTORY,
    SECOND_NS,
    START_NS,
    AdapterRun,
    Arrival,
    changed_copy,
    hand_over,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.one_message import process_message
from ship_testing.ship_observations import config as observing
from ship_testing.small_voyage import FORE, INS, Run, attitude, new_adapter, remove_interval, rotation_of, voyage
from ship_testing.star_voyage import new_adapter as new_star_attitude
from ship_testing.star_voyage import voyage as voyage_of_stars
from ship_testing.star_voyage import without_topics

ATTITUDE = "ship/attitude"
Clock = Callable[[int], int]
SIGMAS = 5.0


def clock(*steps: tuple[float, float]) -> Clock:
    """Return the offset of all clocks, ns, as a function of time, ns; ``steps`` are (start, offset), s."""

    def off_ns(time_ns: int) -> int:
        off_s = [far_s for since_s, far_s in steps if time_ns >= START_NS + round(since_s * SECOND_NS)]
        return round(off_s[-1] * SECOND_NS) if off_s else 0

    return off_ns


def shift_stamps(arrivals: Iterable[Arrival], off_ns: Clock) -> tuple[Arrival, ...]:
    """Return the messages with stamps shifted by the offset of the clocks."""

    def by_clock(arrival: Arrival) -> Arrival:
        ns = arrival.stamp_ns + off_ns(arrival.stamp_ns)

        def change(message: Any) -> None:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, SECOND_NS)

        return changed_copy(arrival, change) if ns != arrival.stamp_ns else arrival

    return tuple(map(by_clock, arrivals))


def run_with_clocks(
    adapter: Any, arrivals: Iterable[Arrival], off_ns: Clock, live: bool = False, node_off_ns: Clock | None = None
) -> Run:
    """Run with clocks off by ``off_ns``, the node's by ``node_off_ns`` if given; a ``live`` node reports its steps."""
    run, last_ns, node_off_ns = Run(adapter), 0, node_off_ns or off_ns
    for arrival in shift_stamps(arrivals, off_ns):
        now_off_ns = node_off_ns(arrival.receive_ns)
        if live and now_off_ns != last_ns:
            adapter.clock_stepped(now_off_ns - last_ns, arrival.receive_ns + now_off_ns, arrival.receive_ns)
        last_ns = now_off_ns
        _hand_over_one(run, arrival, node_off_ns)
    return run


def _hand_over_one(run: Run, arrival: Arrival, off_ns: Clock) -> None:
    """Give one message to the adapter, after the ticks that precede it on the grid of :func:`hand_over`."""
    if not hasattr(run, "grid_ns"):
        run.grid_ns = arrival.receive_ns // 100_000_000
    while (run.grid_ns + 1) * 100_000_000 <= arrival.receive_ns:
        run.grid_ns += 1
        tick_ns = run.grid_ns * 100_000_000
        run.published += [(tick_ns, *item) for item in run.adapter.tick(tick_ns + off_ns(tick_ns), tick_ns)]
    receive_ns = arrival.receive_ns
    node_ns = receive_ns + off_ns(receive_ns)
    published = process_message(run.adapter, arrival.topic, arrival.message, node_ns, receive_ns)
    run.published += [(receive_ns, *item) for item in published]
    run.now_ns = receive_ns


def not_valid_s(run: AdapterRun, since_s: float, topic: str = ATTITUDE) -> float:
    """Return the time from ``since_s`` to the last status other than VALID, s; 0 if all are VALID."""
    since_ns = START_NS + round(since_s * SECOND_NS)
    bad = [ns for ns, name, m in run.published if name == topic and ns >= since_ns and m.status != Status.VALID]
    return (bad[-1] - since_ns) / SECOND_NS if bad else 0.0


def sigmas(message: Any, true_ns: int) -> float:
    """Return the largest error of an attitude, valid at ``true_ns``, in standard deviations."""
    true_nd = attitude((true_ns - START_NS) / SECOND_NS, 34.4)
    error_n = log_rotation(true_nd @ rotation_of(message).T)
    sigma_n = np.sqrt(np.diagonal(np.reshape(message.rotation_covariance, (3, 3)))[[1, 2, 0]])
    return float(np.max(np.abs(error_n) / sigma_n))


def assert_attitudes_correct(run: Run, off_ns: Clock) -> None:
    """Assert that all attitudes are consistent with their covariance and that their true times increase strictly."""
    claimed = [(ns, m) for ns, topic, m in run.published if topic == ATTITUDE and m.status != Status.INVALID]
    true_ns = [stamp_of(m) - off_ns(ns - 5_000_000) for ns, m in claimed]
    assert all(earlier < later for earlier, later in pairwise(true_ns))
    worst = max(sigmas(m, ns) for ns, (_, m) in zip(true_ns, claimed, strict=True))
    assert worst < SIGMAS


def attitudes(run: AdapterRun) -> list[tuple[float, Any]]:
    """Return (seconds since the start, message) of the published attitudes that are not INVALID."""
    claimed = [(ns, m) for ns, topic, m in run.published if topic == ATTITUDE and m.status != Status.INVALID]
    return [((ns - START_NS) / SECOND_NS, message) for ns, message in claimed]


def steps(run: AdapterRun) -> list[str]:
    return [text for text in run.adapter.notices if text.startswith("time base")]


CLOCK_STEPS = {
    "back 300 s": [(20.0, -300.0)],
    "back 900 s": [(20.0, -900.0)],
    "ahead 900 s for 30 s": [(20.0, 900.0), (50.0, 0.0)],
    "a second repeated": [(20.0, -1.0)],
    "two steps within a minute": [(20.0, -300.0), (45.0, -310.0)],
    "a step and back within two seconds": [(20.0, -300.0), (22.0, 0.0)],
}


@functools.cache
def long_voyage() -> tuple[Arrival, ...]:
    return voyage(60.0)


@pytest.mark.slow
@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("case", CLOCK_STEPS)
def test_all_clocks_step_and_the_attitude_is_valid_within_two_seconds(case: str, live: bool) -> None:
    off_ns = clock(*CLOCK_STEPS[case])
    run = run_with_clocks(new_adapter(), long_voyage(), off_ns, live)
    for since_s, _ in CLOCK_STEPS[case]:
        until_s = min([s for s, _ in CLOCK_STEPS[case] if s > since_s], default=60.0)
        between = AdapterRun(run.adapter, [p for p in run.published if p[0] < START_NS + until_s * SECOND_NS])
        assert not_valid_s(between, since_s) < 2.0
    assert_attitudes_correct(run, off_ns)
    assert len(steps(run)) == len(CLOCK_STEPS[case])
    assert steps(run)[0].endswith(" s: reset, mountings and calibration kept")


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-300.0, 900.0, -1.0])
@pytest.mark.parametrize("computer_at_s", [15.0, 25.0])
def test_the_computers_clock_is_set_five_seconds_before_or_after_the_devices(
    step_s: float, computer_at_s: float
) -> None:
    """Stamps that are ahead of the node's clock are not used meanwhile."""
    off_ns = clock((20.0, step_s))
    run = run_with_clocks(
        new_adapter(), long_voyage(), off_ns, live=True, node_off_ns=clock((computer_at_s, step_s))
    )
    assert not_valid_s(run, max(20.0, computer_at_s)) < 2.0
    assert_attitudes_correct(run, off_ns)


@pytest.mark.slow
def test_estimated_ins_errors_are_kept() -> None:
    """The INS heading is off by 60″. The covariance after the step is that before the step plus a second of drift."""
    run = run_with_clocks(new_adapter(), long_voyage(), clock((20.0, -300.0)), live=True)

    def heading_sigma(since_s: float) -> float:
        since_ns = START_NS + round(since_s * SECOND_NS)
        first = next(m for ns, topic, m in run.published if topic == ATTITUDE and ns >= since_ns)
        return float(np.sqrt(np.reshape(first.rotation_covariance, (3, 3))[2, 2]))

    assert heading_sigma(20.0) == pytest.approx(heading_sigma(19.9), rel=0.05)
    state, calm = run.adapter.core.state, run_with_clocks(new_adapter(), long_voyage(), clock()).adapter.core.state
    assert state.mean == pytest.approx(calm.mean, abs=3e-6)
    reports = dict(run.diagnostics("time base", START_NS, run.now_ns))
    assert reports == {1: "stepped by -300.000 s: reset, mountings and calibration kept"}


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-300.0, -1.0])
def test_a_step_while_a_star_sensor_is_out(step_s: float) -> None:
    off_ns = clock((20.0, step_s))
    run = run_with_clocks(new_adapter(), remove_interval(long_voyage(), 15.0, 30.0, FORE), off_ns)
    assert not_valid_s(run, 20.0) < 2.0
    assert_attitudes_correct(run, off_ns)


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-300.0, 900.0])
def test_a_step_during_an_ins_timeout(step_s: float) -> None:
    off_ns = clock((20.0, step_s))
    run = run_with_clocks(new_adapter(), remove_interval(long_voyage(), 18.0, 25.0, INS), off_ns)
    assert not_valid_s(run, 25.0) < 2.0
    assert len(steps(run)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("alone", [INS, FORE])
@pytest.mark.parametrize("until_s", [15.0, 80.0])
def test_one_clock_alone_comes_back_by_itself(alone: str, until_s: float) -> None:
    arrivals = voyage(until_s + 10.0)
    stepped = shift_stamps([a for a in arrivals if a.topic == alone], clock((5.0, -300.0), (until_s, 0.0)))
    run = Run(new_adapter())
    hand_over(run, sort_by_arrival([*stepped, *(a for a in arrivals if a.topic != alone)]))
    assert steps(run) == []
    assert run.reasons(alone)["late"] >= 50
    assert not_valid_s(run, until_s) < 2.0


# -- UTC ----------------------------------------------------------------------------------------------------


@functools.cache
def observation_voyage(duration_s: float = 40.0) -> tuple[Arrival, ...]:
    """Single stars, position fixes and weather with the INS."""
    ins = [arrival for arrival in voyage(duration_s) if arrival.topic == INS]
    return sort_by_arrival([*without_topics(voyage_of_stars(duration_s), INS), *ins])


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-300.0, 900.0, -1.0])
def test_utc_that_is_wrong_after_a_step_is_named_until_it_is_right(step_s: float) -> None:
    """The true sky does not step: the clocks are wrong from 10 to 25 s."""
    off_ns = clock((10.0, step_s), (25.0, 0.0))
    run = run_with_clocks(ShipAttitudeAdapter(observing(), FACTORY), observation_voyage(), off_ns, live=True)
    wrong = [
        (ns, m) for ns, topic, m in run.published if topic == ATTITUDE and 11.5 <= (ns - START_NS) / SECOND_NS < 25.0
    ]
    assert {m.status for _, m in wrong} == {Status.DEGRADED}
    (text,) = {text for _, text in run.diagnostics("attitude", START_NS + 12 * SECOND_NS, START_NS + 25 * SECOND_NS)}
    assert text.startswith(f"DEGRADED: UTC differs by {step_s:+.1f} s: ")
    assert_attitudes_correct(run, off_ns)
    # The covariance covers a UTC error of the size of the step.
    sigma_up = np.sqrt(np.reshape(wrong[-1][1].rotation_covariance, (3, 3))[2, 2])
    assert sigma_up == pytest.approx(np.deg2rad(abs(step_s) * 15.041 / 3600.0) * np.sin(np.deg2rad(31.9)), rel=0.3)
    assert not_valid_s(run, 25.0) < 2.0
    assert len(steps(run)) == 2


def constant_clock_error(time_ns: int) -> int:
    """Return the offset of clocks that are 300 s ahead until 10 s after the start, also before the start."""
    return clock((0.0, 300.0), (10.0, 0.0))(max(time_ns, START_NS))


@pytest.mark.slow
def test_correct_utc_after_a_step_does_not_exclude_the_stars() -> None:
    """The stars contradicted the INS from the start on, by more than the INS error may be, and were not used."""
    run = run_with_clocks(ShipAttitudeAdapter(observing(), FACTORY), observation_voyage(), constant_clock_error)
    assert {m.status for ns, m in attitudes(run) if 3.0 < ns < 10.0} == {Status.DEGRADED}
    assert not_valid_s(run, 10.0) < 2.0
    assert_attitudes_correct(run, constant_clock_error)


@pytest.mark.slow
def test_wrong_utc_before_the_step_needs_a_reset() -> None:
    """An INS with errors of degrees was aligned by the stars of another time."""
    wide = {"frame_id": "ins", "tilt_sigma_arcsec": 20_000.0, "heading_sigma_arcsec": 20_000.0}
    adapter = ShipAttitudeAdapter(observing(ins=wide), FACTORY)
    before = [arrival for arrival in observation_voyage() if arrival.receive_ns < START_NS + 25 * SECOND_NS]
    run = run_with_clocks(adapter, before, constant_clock_error)
    since_ns = START_NS + 12 * SECOND_NS
    assert {m.status for since_s, m in attitudes(run) if since_s > 12.0} == {Status.DEGRADED}
    assert all("UTC differs by -300.0 s" in text for _, text in run.diagnostics("attitude", since_ns, run.now_ns))
    assert "call ~/reset" in run.diagnostics("attitude", since_ns, run.now_ns)[-1][1]
    # The covariance holds the error.
    _, last = attitudes(run)[-1]
    assert sigmas(last, stamp_of(last)) < SIGMAS
    adapter.service("reset", run.now_ns)
    after = run_with_clocks(
        adapter, [a for a in observation_voyage() if a.receive_ns >= START_NS + 25 * SECOND_NS], constant_clock_error
    )
    assert not_valid_s(after, 27.0) == 0.0
    _, last = attitudes(after)[-1]
    assert sigmas(last, stamp_of(last)) < SIGMAS


@pytest.mark.slow
def test_an_ins_that_drifted_until_stars_return_cannot_verify_utc() -> None:
    """Stars are missing from the step on for 25 s, in which the INS may have drifted by more than the sky rotation."""
    drifting = {"frame_id": "ins", "tilt_time_s": 60.0, "heading_time_s": 60.0}
    off_ns = clock((10.0, -1.0))
    dark = remove_interval(observation_voyage(), 9.5, 35.0, "star/fore/observations", "star/starboard/observations")
    run = run_with_clocks(ShipAttitudeAdapter(observing(ins=drifting), FACTORY), dark, off_ns, live=True)
    assert run.adapter.core.state.utc_step is None
    assert not_valid_s(run, 35.0) < 2.0


def test_duplicate_publishers_of_a_sensor_are_kept_after_a_step() -> None:
    off_ns = clock((10.0, -300.0))
    adapter = new_adapter()
    run_with_clocks(adapter, [a for a in voyage(15.0) if a.receive_ns < START_NS + 5 * SECOND_NS], off_ns)
    adapter.set_duplicate_publishers(FORE, "two publishers send")
    run = run_with_clocks(adapter, [a for a in voyage(15.0) if a.receive_ns >= START_NS + 5 * SECOND_NS], off_ns)
    assert {m.status for since_s, m in attitudes(run) if since_s > 6.0} == {Status.DEGRADED}
    assert steps(run) != []
    adapter.set_duplicate_publishers(FORE, "")
    assert not_valid_s(run, 15.0) == 0.0


def test_a_message_ahead_of_the_others_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    counted, count = [], TimeBase.add_arrival

    def add_arrival(self: TimeBase, topic: str, *times_ns: int) -> int | None:
        counted.append((topic, *times_ns))
        return count(self, topic, *times_ns)

    monkeypatch.setattr(TimeBase, "add_arrival", add_arrival)
    run = run_with_clocks(new_adapter(), voyage(8.0), clock((5.0, 900.0)))
    assert len(steps(run)) == 1
    assert run.innovations(Reason.FUTURE) != []
    assert len(counted) == len(set(counted))


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [-300.0, 900.0])
def test_star_attitude_continues_after_a_step(step_s: float) -> None:
    off_ns = clock((10.0, step_s))
    run = AdapterRun(new_star_attitude())
    hand_over(run, shift_stamps(observation_voyage(), off_ns), node_ns=lambda ns: ns + off_ns(ns))
    topic = "star/fore/solution"
    solved_s = [(ns - START_NS) / SECOND_NS for ns, name, m in run.published if name == topic and m.status == 0]
    assert max(later - earlier for earlier, later in pairwise(solved_s)) < 2.0
    assert solved_s[-1] > 39.0
    assert len(steps(run)) == 1

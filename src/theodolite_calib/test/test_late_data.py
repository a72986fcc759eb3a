"""Late and reordered messages: within the lag the final state is equal to the bit, and outputs never go back."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_testing.adapter_runs import (
    SECOND_NS,
    START_NS,
    Arrival,
    assert_flood_costs_little,
    changed_copy,
    delay_arrivals,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.small_session import (
    ALL_TOPICS,
    BASELINE,
    BEACONS,
    ENCODER,
    IMU,
    SHIP,
    Run,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
)
from theodolite_calib.optical_axis.calibration import calibration_from_state
from theodolite_calib.optical_axis.core import OpticalAxisCore

LAG_S = 2.0
ALPHA = BASELINE["alpha"]
ALL = ALL_TOPICS


def shuffle_arrivals(seed: int, topics: tuple[str, ...]) -> tuple[Arrival, ...]:
    """Return the session with random delays over the whole lag for these topics, and 5 ms for the others."""
    rng = np.random.default_rng(seed)
    late = np.array([a.topic in topics for a in session()])
    return delay_arrivals(session(), np.where(late, rng.uniform(0.0, LAG_S - 0.001, late.size), 0.005))


SHUFFLES = [
    (seed, topics)
    for seed, topics in enumerate(
        [(BEACONS,), (ENCODER,), (SHIP,), (ALPHA, IMU["bravo"]), (BEACONS, SHIP), ALL, ALL, ALL], start=1
    )
]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "topics"), SHUFFLES)
def test_any_order_within_the_lag_ends_in_the_same_state(seed: int, topics: tuple[str, ...]) -> None:
    run = run_adapter(new_adapter(), shuffle_arrivals(seed, topics))
    assert run.state() == fault_free_run().state()
    for topic in ALL:
        # An exposure may be rejected first if the data around it came late; in the end it is used.
        assert set(run.reasons(topic)) <= {"gap", "revised"}
    # INVALID outputs may be out of order.
    stamps = [stamp_of(m) for m in run.pointings if m.status != Status.INVALID]
    assert all(earlier < later for earlier, later in pairwise(stamps))
    cores = run.adapter.core, fault_free_run().adapter.core
    one, other = (calibration_from_state(core.filter, core.config, core.state) for core in cores)
    assert one.values.tobytes() == other.values.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()
    assert one.unobservable == other.unobservable


def test_the_shuffles_do_shuffle() -> None:
    stamps = np.array([a.stamp_ns for a in shuffle_arrivals(8, ALL)])
    assert np.mean(np.diff(stamps) < 0) > 0.4
    assert np.max(np.maximum.accumulate(stamps) - stamps) > 1.8 * SECOND_NS


@pytest.mark.slow
@pytest.mark.parametrize("topic", ALL)
@pytest.mark.parametrize("late_s", [0.5, 1.0, LAG_S])
def test_one_late_message_is_applied_at_its_own_time(topic: str, late_s: float) -> None:
    """The message arrives just before a stamp that is more than ``late_s`` newer."""
    index = index_at(session(), topic, 2.6)
    limit_ns = session()[index].stamp_ns + round(late_s * SECOND_NS)
    too_new = next(a for a in session() if a.stamp_ns > limit_ns)
    run = run_adapter(new_adapter(), replace_message(session(), index, lambda message: None, too_new.receive_ns - 1))
    assert run.state() == fault_free_run().state()
    assert run.health(topic).rejected == 0


@pytest.mark.parametrize("topic", ALL)
def test_data_later_than_the_lag_are_rejected_and_counted(topic: str) -> None:
    index = index_at(session(), topic, 2.6)
    late_ns = session()[index].receive_ns + round((LAG_S + 0.3) * SECOND_NS)
    run = run_adapter(new_adapter(), replace_message(session(), index, lambda message: None, late_ns))
    assert run.reasons(topic) == {"late": 1}
    assert len(run.innovations(Reason.LATE)) == 1


def test_a_pointing_waits_for_the_ship_and_comes_with_it() -> None:
    """Encoder readings come first, the ship's attitude of the same time 0.3 s later."""
    late = delay_arrivals(session(), np.array([0.3 if a.topic == SHIP else 0.003 for a in session()]))
    run = run_adapter(new_adapter(), late)
    times = [(ns - stamp_of(m)) * 1e-9 for ns, topic, m in run.published if topic == "theodolite/pointing"]
    assert 0.3 <= np.median(times) < 0.36
    # The first tick published INVALID.
    assert len(run.pointings) >= len(fault_free_run().pointings) - 1


def test_clock_jump_back_resets_once() -> None:
    adapter = new_adapter()
    first = run_adapter(adapter, session())
    adapter.clock_jumped_back(session()[0].receive_ns)
    second = run_adapter(adapter, session())
    assert second.state() == first.state() == fault_free_run().state()
    assert [stamp_of(m) for m in second.pointings] == [stamp_of(m) for m in fault_free_run().pointings]
    status = next(s for s in second.messages("/diagnostics")[-1].status if s.name == "optical_axis: pointing")
    assert next(v.value for v in status.values if v.key == "clock jumps back") == "1"


@pytest.mark.slow
def test_flood_of_random_stamps_costs_few_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Exposures at 2 Hz; without a bound, each message of the flood would cost some hundred steps."""
    assert_flood_costs_little(
        monkeypatch, OpticalAxisCore, lambda a: run_adapter(new_adapter(), a), session(3.0), BEACONS, "lights"
    )


def repeat_times(topics: tuple[str, ...]) -> tuple[Arrival, ...]:
    """Return a session in which some sources repeat the stamps 2.0 s to 2.3 s with data of one second later."""

    def again(message: Any) -> None:
        ns = stamp_of(message) - SECOND_NS
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, SECOND_NS)

    begin_ns, end_ns = START_NS + 3 * SECOND_NS, START_NS + 33 * SECOND_NS // 10
    twice = [a for a in session(16.0) if a.topic in topics and begin_ns <= a.stamp_ns < end_ns]
    return sort_by_arrival([*session(16.0), *(changed_copy(a, again) for a in twice)])


def lights_used(run: Run) -> list[float]:
    """Return the stamps of accepted beacons, s after the start."""
    accepted = [m for m in run.messages("theodolite/innovation") if m.source == "lights" and m.accepted]
    return sorted({(stamp_of(m) - START_NS) / SECOND_NS for m in accepted})


def test_beacons_are_rejected_while_encoders_and_ship_repeat_times() -> None:
    run = run_adapter(new_adapter(), repeat_times((ENCODER, SHIP)))
    core = run.adapter.core
    assert not core.state.fault_state.excluded
    assert run.pointings[-1].status == Status.VALID
    used = lights_used(run)
    assert not [s for s in used if 2.3 < s < 12.2]
    assert [s for s in used if s > 12.4]


def test_repeated_times_reject_beacons_in_any_order() -> None:
    arrivals = repeat_times((ENCODER, SHIP))
    one = run_adapter(new_adapter(), arrivals)
    rng = np.random.default_rng(7)
    slow = np.array([a.topic in (BEACONS, ALPHA) for a in arrivals])
    other = run_adapter(
        new_adapter(), delay_arrivals(arrivals, np.where(slow, rng.uniform(0.0, LAG_S - 0.001, slow.size), 0.005))
    )
    assert other.state() == one.state()


def test_beacons_are_used_while_one_source_repeats_times() -> None:
    used = lights_used(run_adapter(new_adapter(), repeat_times((SHIP,))))
    assert len([s for s in used if 3.5 < s < 12.0]) == 17  # all: there are two a second

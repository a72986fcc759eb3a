"""Late messages in any order: within the lag the final state is bit-identical, and outputs never go back."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_estimation.rejection_rules import Reason
from ship_testing.adapter_runs import (
    SECOND_NS,
    START_NS,
    Arrival,
    assert_flood_costs_little,
    delay_arrivals,
    exact_value,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.small_voyage import FORE, INS, STARBOARD, fault_free_run, new_adapter, run_adapter, voyage

LAG_S = 2.0


def shuffle(seed: int, topics: tuple[str, ...]) -> tuple[Arrival, ...]:
    """Return the voyage with random delays up to the lag for ``topics``, and 5 ms for the others."""
    rng = np.random.default_rng(seed)
    late = np.array([a.topic in topics for a in voyage()])
    return delay_arrivals(voyage(), np.where(late, rng.uniform(0.0, LAG_S - 0.001, late.size), 0.005))


SHUFFLES = [
    (seed, topics)
    for seed, topics in enumerate([(FORE, STARBOARD), (INS,), (FORE, INS), *[(INS, FORE, STARBOARD)] * 4], start=1)
]


@pytest.mark.parametrize(("seed", "topics"), SHUFFLES)
def test_any_order_within_the_lag_ends_in_the_same_state(seed: int, topics: tuple[str, ...]) -> None:
    run = run_adapter(new_adapter(), shuffle(seed, topics))
    clean = fault_free_run()
    assert run.state() == clean.state()
    assert run.health(INS).rejected == 0
    for topic in (FORE, STARBOARD):
        # A measurement between late INS samples is rejected first and used in the end.
        assert set(run.reasons(topic)) <= {"gap", "revised"}
    assert INS in topics or run.reasons(FORE) == run.reasons(STARBOARD) == {}
    stamps = [stamp_of(m) for m in run.messages("ship/attitude")]
    assert all(earlier < later for earlier, later in pairwise(stamps))
    one, other = (
        current_alignment(each.filter, each.config, each.state) for each in (run.adapter.core, clean.adapter.core)
    )
    assert one.values.tobytes() == other.values.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_the_shuffled_order_differs() -> None:
    stamps = np.array([a.stamp_ns for a in shuffle(4, (INS, FORE, STARBOARD))])
    assert np.mean(np.diff(stamps) < 0) > 0.4
    assert np.max(np.maximum.accumulate(stamps) - stamps) > 1.8 * SECOND_NS


@pytest.mark.parametrize(("topic", "since_s"), [(INS, 2.60), (INS, 2.64), (FORE, 2.6)])
@pytest.mark.parametrize("late_s", [0.5, 1.0, LAG_S])
def test_one_late_message_is_applied_at_its_own_time(topic: str, since_s: float, late_s: float) -> None:
    """The message arrives just before the first message with a stamp more than ``late_s`` later."""
    index = index_at(voyage(), topic, since_s)
    limit_ns = voyage()[index].stamp_ns + round(late_s * SECOND_NS)
    too_new = next(a for a in voyage() if a.stamp_ns > limit_ns)
    run = run_adapter(new_adapter(), replace_message(voyage(), index, lambda message: None, too_new.receive_ns - 1))
    assert run.state() == fault_free_run().state()
    assert run.health(topic).rejected == 0


def test_a_late_star_changes_the_attitude_only_from_its_arrival_on() -> None:
    index = index_at(voyage(), FORE, 2.0)
    arrives_ns = START_NS + 3 * SECOND_NS
    late = run_adapter(new_adapter(), replace_message(voyage(), index, lambda message: None, arrives_ns))

    def attitudes(run: Any, from_ns: int, until_ns: int) -> list[Any]:
        return [
            exact_value(m) for ns, topic, m in run.published if topic == "ship/attitude" and from_ns <= ns < until_ns
        ]

    usual_ns = voyage()[index].receive_ns
    assert attitudes(late, 0, usual_ns) == attitudes(fault_free_run(), 0, usual_ns)
    assert attitudes(late, usual_ns, arrives_ns) != attitudes(fault_free_run(), usual_ns, arrives_ns)
    assert attitudes(late, arrives_ns, late.now_ns) == attitudes(fault_free_run(), arrives_ns, late.now_ns)


def test_a_late_star_that_changes_an_earlier_decision_marks_it_revised() -> None:
    """A measurement 150″ off arrives first and passes the gate; it is rejected after correct ones with earlier stamps.

    The INS heading has a sigma of 72″, so 150″ is within the gate. After measurements of two sensors 150″ is far
    outside.
    """

    def shift_azimuth(message: Any) -> None:
        message.azimuth += 150.0 * np.pi / (180 * 3600)

    wrong = index_at(voyage(), STARBOARD, 1.6)
    moved = replace_message(voyage(), wrong, shift_azimuth)
    good = [a for a in moved if a.topic != INS and a.stamp_ns < moved[wrong].stamp_ns]
    late = sort_by_arrival(
        replace(a, receive_ns=START_NS + 1_900_000_000) if a in good else a
        for a in moved
        if a.topic == INS or a.stamp_ns <= moved[wrong].stamp_ns
    )
    run = run_adapter(new_adapter(star_sensors__starboard__sigma_forward_arcsec=3.0), late)
    revised = run.innovations(Reason.REVISED)
    assert [m.source for m in revised] == ["star.starboard"]
    assert not revised[0].accepted
    assert "now rejected" in revised[0].reason_text
    assert run.reasons(STARBOARD) == {"revised": 1}


def test_without_a_lag_only_what_comes_in_order_is_used() -> None:
    run = run_adapter(new_adapter(lag_s=0.0), voyage())
    assert set(run.reasons(FORE)) == {"late"}  # stars arrive 120 ms after the INS samples of their time
    assert run.health(FORE).accepted == 0
    assert run.health(INS).rejected == 0


def test_a_flood_with_random_stamps_costs_few_steps_and_rejections_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The attitudes come at 5 Hz; without limits, each message of the flood would cause some three hundred steps."""
    others = sum(a.topic == STARBOARD for a in voyage())
    assert_flood_costs_little(
        monkeypatch, ShipAttitudeCore, lambda a: run_adapter(new_adapter(), a), voyage(), FORE, "star.fore", others
    )

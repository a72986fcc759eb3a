"""Values ordered by stamp, with rejection of jumps: limits, confirmation, and any order of arrival."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_stars.sky.stamped_values import JumpLimits, StampedValues

SECOND_NS = 1_000_000_000
LIMITS = JumpLimits(max_step=10.0, max_rate=2.0, confirmation_s=60.0, unit="m")


@dataclass(frozen=True)
class Reading:
    """A number with its error."""

    value: float
    sigma: float = 0.0

    def distance_to(self, other: "Reading") -> float:
        return abs(self.value - other.value)

    def content(self) -> bytes:
        return np.array([self.value, self.sigma]).tobytes()


def ns(since_s: float) -> int:
    return round(since_s * SECOND_NS)


def insert_all(*stamped: tuple[float, float], sigma: float = 0.0) -> tuple[StampedValues[Reading], list[float]]:
    """Return the values after all have arrived, and the times of those rejected."""
    values, rejected = StampedValues[Reading](LIMITS), []
    for since_s, value in stamped:
        if values.rejection(ns(since_s), Reading(value, sigma)) is not None:
            rejected.append(since_s)
        values.insert(ns(since_s), Reading(value, sigma))
    return values, rejected


def accepted_values(values: StampedValues[Reading]) -> list[tuple[int, float, bool]]:
    return [(t, v.value, a) for t, v, a in zip(values.times, values.values, values.follows_jump, strict=True)]


STEADY = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 1e-9), (4.0, 0.0)]
"""At rest, but not constant to the last bit."""


def test_a_value_within_its_limit_is_accepted() -> None:
    # One second later: 10 + 2 + five sigmas of the difference, 10 + 2 + 5·sqrt(2) = 19.07.
    assert insert_all(*STEADY, (5.0, 19.0), sigma=1.0)[1] == []
    assert insert_all(*STEADY, (5.0, 19.1), sigma=1.0)[1] == [5.0]


def test_a_jump_is_rejected_with_a_reason_and_the_last_value_is_kept() -> None:
    values, rejected = insert_all(*STEADY, (5.0, 100.0), (6.0, 101.0))
    assert rejected == [5.0, 6.0]
    assert accepted_values(values)[-1] == (ns(4), 0.0, False)
    rejection = values.rejection(ns(7), Reading(102.0))
    assert rejection.reason is Reason.JUMP
    assert rejection.text == (
        "jump by 102 m from the last accepted value, 3.0 s earlier, limit 16 m; "
        "accepted once the jump has lasted for 60 s"
    )


def test_a_return_is_accepted_within_the_limit_since_the_last_accepted_value() -> None:
    jumped = [(float(t), 500.0) for t in range(5, 25)]
    # 21 s after the last accepted value: 10 + 2·21.
    assert insert_all(*STEADY, *jumped, (25.0, 52.0))[1] == [t for t, _ in jumped]
    assert insert_all(*STEADY, *jumped, (25.0, 52.1))[1] == [*(t for t, _ in jumped), 25.0]


def test_values_consistent_with_a_jump_have_no_time_dependent_limit() -> None:
    # 30 is within 10 + 2·t of zero from 10 s on, but it was reached by a jump.
    values, rejected = insert_all(*STEADY, *((float(t), 30.0) for t in range(5, 60)))
    assert rejected == [float(t) for t in range(5, 60)]
    rejection = values.rejection(ns(60), Reading(30.0))
    assert "consistent with other values that jumped" in rejection.text
    # A value that has returned to within one step is accepted: 12 within a second.
    assert insert_all(*STEADY, (5.0, 22.0), (6.0, 12.1), (7.0, 12.0))[1] == [5.0, 6.0]


def test_a_jump_is_accepted_after_the_confirmation_time() -> None:
    values, rejected = insert_all(*STEADY, *((float(t), 500.0) for t in range(5, 68)))
    assert rejected == [float(t) for t in range(5, 65)]
    assert accepted_values(values)[4:7] == [(ns(4), 0.0, False), (ns(65), 500.0, True), (ns(66), 500.0, False)]


def test_inconsistent_values_are_never_accepted() -> None:
    wild = [(float(t), 500.0 + 100.0 * (t % 2)) for t in range(5, 200)]
    assert insert_all(*STEADY, *wild)[1] == [t for t, _ in wild]


def test_two_values_that_contradict_a_first_one_are_accepted() -> None:
    values, rejected = insert_all((0.0, 500.0), (1.0, 0.0), (2.0, 1.0), (3.0, 2.0))
    assert rejected == [1.0]
    assert accepted_values(values) == [(0, 500.0, False), (ns(2), 1.0, True), (ns(3), 2.0, False)]
    # A first value that another one confirms is established.
    assert insert_all((0.0, 500.0), (1.0, 500.0), (2.0, 0.0), (3.0, 1.0))[1] == [2.0, 3.0]


def test_a_frozen_value_widens_the_limit_by_the_frozen_time() -> None:
    # The value is frozen from 4 s to 24 s while the truth moves at 2 per second, by 40 in total.
    moving = [(float(t), 2.0 * t) for t in range(5)]
    frozen = [(float(t), 8.0) for t in range(5, 25)]
    assert insert_all(*moving, *frozen, (25.0, 50.0), (26.0, 52.0))[1] == []
    # The limit is 8 + 10 + 2·21 = 60; the frozen time counts up to one minute.
    assert insert_all(*moving, *frozen, (25.0, 60.0))[1] == []
    assert insert_all(*moving, *frozen, (25.0, 60.1))[1] == [25.0]
    long = [(float(t), 8.0) for t in range(5, 505)]
    assert insert_all(*moving, *long, (505.0, 8.0 + 10.0 + 2.0 * 61.0))[1] == []
    assert insert_all(*moving, *long, (505.0, 8.0 + 10.0 + 2.0 * 61.0 + 0.1))[1] == [505.0]
    # A jump that is then constant does not widen the limit.
    assert insert_all(*moving, *((float(t), 40.0) for t in range(5, 60)))[1] == [float(t) for t in range(5, 60)]


def test_nan_is_rejected() -> None:
    assert insert_all(*STEADY, (5.0, float("nan")), (6.0, float("nan")), (7.0, 0.0))[1] == [5.0, 6.0]


def test_a_good_source_is_not_rejected() -> None:
    # Ten hours at 1 Hz with noise as stated. The limits of step and rate are 0, so the limit is five sigmas of a
    # difference. The probability of exceeding five sigmas is 5.7e-7, or 0.02 cases in 36 000.
    rng = np.random.default_rng(20260301)
    values, rejected = StampedValues[Reading](JumpLimits(0.0, 0.0, 60.0, "m")), 0
    for number, value in enumerate(rng.standard_normal(36_000).tolist()):
        rejected += values.rejection(ns(number), Reading(value, 1.0)) is not None
        values.insert(ns(number), Reading(value, 1.0))
        values.drop_before(ns(number - 3))
    assert rejected == 0


BRIEF = JumpLimits(max_step=10.0, max_rate=2.0, confirmation_s=8.0, unit="m")


def draw_readings(rng: np.random.Generator) -> list[tuple[int, Reading]]:
    """Return values with jumps, some of them permanent, with gaps, and with conflicting values of one stamp."""
    times_ns = np.cumsum(rng.integers(1, 4, 40)) * SECOND_NS
    places = rng.choice([0.0, 0.0, 0.0, 15.0, 25.0, 400.0], 8)
    stamped = [
        (int(time_ns), Reading(places[number // 5] + rng.normal(), float(rng.integers(0, 2))))
        for number, time_ns in enumerate(times_ns)
    ]
    return stamped + [(time_ns, Reading(reading.value + 300.0)) for time_ns, reading in stamped[::9]]


def insert_in_order(stamped: list[tuple[int, Reading]], order: Iterable[int]) -> StampedValues[Reading]:
    values = StampedValues[Reading](BRIEF)
    for index in order:
        values.insert(*stamped[index])
    return values


def test_the_drawn_values_have_rejected_and_accepted_jumps() -> None:
    runs = [
        insert_in_order(stamped, range(len(stamped)))
        for stamped in map(draw_readings, map(np.random.default_rng, range(40)))
    ]
    assert sum(len(values.times) < 35 for values in runs) > 20
    assert sum(any(values.follows_jump) for values in runs) > 10


@pytest.mark.parametrize("seed", range(40))
def test_any_order_of_arrival_gives_the_same_values(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamped = sorted(draw_readings(rng), key=lambda one: one[0])
    expected = accepted_values(insert_in_order(stamped, range(len(stamped))))
    assert accepted_values(insert_in_order(stamped, rng.permutation(len(stamped)))) == expected
    # Up to 10 s late; older values are dropped.
    late, newest_ns, discarded = StampedValues[Reading](BRIEF), 0, []
    for index in np.argsort([time_ns + rng.uniform(0.0, ns(10)) for time_ns, _ in stamped]):
        late.insert(*stamped[index])
        newest_ns = max(newest_ns, stamped[index][0])
        before = accepted_values(late)
        late.drop_before(newest_ns - ns(10), keep=2)
        discarded += before[: len(before) - len(late.times)]
    assert discarded + accepted_values(late) == expected


@pytest.mark.parametrize("seed", range(40))
def test_accepted_values_before_the_returned_stamp_are_unchanged(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamped, values = draw_readings(rng), StampedValues[Reading](BRIEF)
    for index in rng.permutation(len(stamped)):
        before = accepted_values(values)
        changed_ns = values.insert(*stamped[index])
        after = accepted_values(values)
        if changed_ns is None:
            assert after == before
        else:
            differing = min(set(before) ^ set(after), key=lambda one: one[0])
            assert differing[0] == changed_ns


def test_a_long_jump_takes_limited_memory_and_older_values_are_late() -> None:
    values = StampedValues[Reading](JumpLimits(10.0, 2.0, 1e6, "m"))
    values.insert(0, Reading(0.0))
    values.insert(ns(1), Reading(0.0))
    for number in range(1000):
        values.insert(ns(2 + number), Reading(500.0))
        values.drop_before(ns(number - 2), keep=2)
    assert len(values._stamps) < 110
    assert values.rejection(ns(500), Reading(500.0)).reason is Reason.LATE
    assert values.insert(ns(500), Reading(500.0)) is None
    assert values.rejection(ns(1002), Reading(500.0)).reason is Reason.JUMP
    assert values.rejection(ns(1002), Reading(0.0)) is None


SETTLES = JumpLimits(max_step=10.0, max_rate=2.0, confirmation_s=60.0, unit="m", min_consistent=4)


def provisional_results(*stamped: tuple[float, float]) -> tuple[list[float], list[bool]]:
    """Return the times of the rejected values, and after each value True if provisional values are in conflict."""
    values, rejected, conflicts = StampedValues[Reading](SETTLES), [], []
    for since_s, value in stamped:
        if values.rejection(ns(since_s), Reading(value)) is not None:
            rejected.append(since_s)
        values.insert(ns(since_s), Reading(value))
        conflicts.append(values.has_conflict_at(ns(since_s)))
    return rejected, conflicts


GOOD = [(float(t), 1000.0 + t) for t in range(5, 15)]


def test_a_provisional_value_is_replaced_by_the_minimum_number_even_if_repeated() -> None:
    for count in (2, 5):
        rejected, conflicts = provisional_results(*((float(t), 0.0) for t in range(count)), *GOOD)
        assert rejected == [5.0, 6.0, 7.0]
        assert conflicts == [False] * count + [True] * 3 + [False] * 7


def test_two_values_contradict_several_provisional_ones() -> None:
    rejected, conflicts = provisional_results((2.0, 0.0), (3.0, 1.0), (4.0, 2.0), *GOOD)
    assert rejected == [5.0, 6.0, 7.0]
    assert conflicts == [False] * 4 + [True, True] + [False] * 7


def test_an_established_value_is_replaced_only_after_the_confirmation_time() -> None:
    settled = [(0.1 * t, float(t)) for t in range(4)]
    rejected, conflicts = provisional_results(*settled, *((float(t), 1000.0) for t in range(5, 70)))
    assert rejected == [float(t) for t in range(5, 65)]
    assert not any(conflicts)


def test_a_step_of_the_clocks_keeps_values_established_or_provisional() -> None:
    """Values arrive every five seconds, so that two of them are kept over the step."""
    for count, is_settled in ((3, False), (4, True)):
        values = StampedValues[Reading](SETTLES)
        for number in range(count):
            values.insert(ns(5.0 * number), Reading(float(number)))
        shifted = values.with_shifted_stamps(ns(-300.0) - ns(0.0))
        for number in range(2):
            shifted.insert(ns(5.0 * (count + number) - 300.0), Reading(1000.0))
        assert shifted.has_conflict_at(ns(0.0)) is not is_settled


def test_inconsistent_rejected_values_replace_nothing() -> None:
    rejected, conflicts = provisional_results(
        (0.0, 0.0), (1.0, 0.0), *((float(t), 500.0 * (t % 3)) for t in range(2, 60))
    )
    assert rejected == [float(t) for t in range(2, 60) if t % 3]
    assert conflicts[2]
    assert not conflicts[3]


@pytest.mark.parametrize("seed", range(40))
def test_any_order_of_arrival_gives_the_same_conflicts(seed: int) -> None:
    rng, limits = np.random.default_rng(seed), replace(BRIEF, min_consistent=6)
    stamped = sorted(draw_readings(rng), key=lambda one: one[0])
    in_order = StampedValues[Reading](limits)
    for one in stamped:
        in_order.insert(*one)
    shuffled, times_ns = StampedValues[Reading](limits), [ns(t) for t in range(100)]
    for index in rng.permutation(len(stamped)):
        before = [shuffled.has_conflict_at(time_ns) for time_ns in times_ns]
        shuffled.insert(*stamped[index])
        changed = [t for t, was in zip(times_ns, before, strict=True) if shuffled.has_conflict_at(t) != was]
        since_ns = shuffled.conflict_changed_ns
        assert not changed or (since_ns is not None and since_ns <= changed[0])
    assert accepted_values(shuffled) == accepted_values(in_order)
    assert [shuffled.has_conflict_at(t) for t in times_ns] == [in_order.has_conflict_at(t) for t in times_ns]

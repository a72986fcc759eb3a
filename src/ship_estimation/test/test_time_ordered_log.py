"""The time-ordered log: for any order of arrival, the state is that of the measurements in time order.

The step of these tests is not associative and rounds, so any difference in order or repetition shows in the state.
"""

import math

import hypothesis.strategies as st
from hypothesis import given, settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from ship_estimation.time_order.time_ordered_log import MOST_REPEATS_AT_ONCE, MOST_REPEATS_PER_S, Key, TimeOrderedLog

# Fixed examples, nothing kept between runs.
repeatable = settings(derandomize=True, database=None, deadline=None, max_examples=200)

State = tuple[int, float]
"""Number of measurements so far, and a value that depends on their order."""
Decision = tuple[int, float]
"""Time of the measurement and the state before it."""
Log = TimeOrderedLog[State, tuple[int, float], Decision]

START: State = (0, 0.1)

keys = st.tuples(st.integers(0, 40), st.sampled_from(["ins", "star.abeam", "star.fore"]))
values = st.floats(-1.0, 1.0, allow_nan=False)
measurements = st.dictionaries(keys, values, min_size=1, max_size=25)


def step(state: State, measurement: tuple[int, float]) -> tuple[State, Decision]:
    time_ns, value = measurement
    return (state[0] + 1, math.cos(1.7 * state[1]) + value / 3.0), (time_ns, state[1])


def failed_decision(measurement: tuple[int, float], error: Exception) -> Decision:
    raise error


def in_own_order(known: dict[Key, float], start: State = START) -> tuple[State, list[Decision]]:
    state, decisions = start, []
    for key in sorted(known):
        state, decision = step(state, (key[0], known[key]))
        decisions.append(decision)
    return state, decisions


def insert(log: Log, key: Key, value: float) -> None:
    log.insert(key, (key[0], value))


@repeatable
@given(known=measurements, data=st.data())
def test_any_order_of_arrival_and_any_pauses_give_the_same_state_and_decisions(
    known: dict[Key, float], data: st.DataObject
) -> None:
    log = Log(START)
    latest: list[Decision] = []
    for key in data.draw(st.permutations(sorted(known))):
        insert(log, key, known[key])
        if data.draw(st.booleans()):
            for decision, previous in log.apply(step, failed_decision):
                if previous is not None:
                    latest.remove(previous)
                latest.append(decision)
    for decision, previous in log.apply(step, failed_decision):
        if previous is not None:
            latest.remove(previous)
        latest.append(decision)
    state, decisions = in_own_order(known)
    assert log.state == state
    assert sorted(latest) == sorted(decisions)
    assert log.pending_count == 0


@repeatable
@given(known=measurements, data=st.data())
def test_repeated_key_replaces_the_measurement(known: dict[Key, float], data: st.DataObject) -> None:
    log = Log(START)
    for key, value in known.items():
        insert(log, key, value)
    log.apply(step, failed_decision)
    key = data.draw(st.sampled_from(sorted(known)))
    insert(log, key, 0.123)
    assert log.get(key) == (key[0], 0.123)
    assert log.pending_count == sum(other >= key for other in known)
    replaced = log.apply(step, failed_decision)
    assert all(previous is not None for _, previous in replaced)
    assert log.state == in_own_order({**known, key: 0.123})[0]


@repeatable
@given(known=measurements, ready_ns=st.lists(st.integers(0, 45), max_size=6))
def test_measurements_wait_for_their_data(known: dict[Key, float], ready_ns: list[int]) -> None:
    log = Log(START)
    for key, value in known.items():
        insert(log, key, value)
    reached = 0
    for limit_ns in ready_ns:
        reached = max(reached, limit_ns)
        log.apply(lambda state, m, limit_ns=limit_ns: step(state, m) if m[0] < limit_ns else None, failed_decision)
        before = {key: value for key, value in known.items() if key[0] < reached}
        assert log.state == in_own_order(before)[0]
        assert log.pending_count == len(known) - len(before)


@repeatable
@given(known=measurements, since_ns=st.integers(0, 45))
def test_rewinding_applies_again_from_the_first_affected(known: dict[Key, float], since_ns: int) -> None:
    """The samples of the INS, on which the step also depends, have changed."""
    log = Log(START)
    for key, value in known.items():
        insert(log, key, value)
    log.apply(lambda state, m: step(state, (m[0], m[1] + (0.5 if m[0] > since_ns else 0.0))), failed_decision)
    log.rewind_to_first(lambda decision: decision[0] > since_ns)
    again = log.apply(step, failed_decision)
    assert len(again) == sum(key[0] > since_ns for key in known)
    assert all(previous is not None for _, previous in again)
    assert log.state == in_own_order(known)[0]


@repeatable
@given(known=measurements, late=measurements, oldest_ns=st.integers(0, 45))
def test_committed_measurements_stay_in_the_state(
    known: dict[Key, float], late: dict[Key, float], oldest_ns: int
) -> None:
    log = Log(START)
    for key, value in known.items():
        insert(log, key, value)
    log.apply(step, failed_decision)
    log.commit_before(oldest_ns)
    assert log.state == in_own_order(known)[0]
    dropped = {key: value for key, value in known.items() if key[0] < oldest_ns}
    assert all(log.get(key) is None for key in dropped)
    within = {key: value for key, value in late.items() if key[0] >= oldest_ns}
    for key, value in within.items():
        insert(log, key, value)
    log.apply(step, failed_decision)
    kept = {key: value for key, value in known.items() if key not in dropped}
    assert log.state == in_own_order({**kept, **within}, in_own_order(dropped)[0])[0]


@repeatable
@given(known=measurements, oldest_ns=st.integers(0, 45))
def test_pending_measurements_are_not_committed(known: dict[Key, float], oldest_ns: int) -> None:
    log = Log(START)
    for key, value in known.items():
        insert(log, key, value)
    log.commit_before(oldest_ns)
    assert log.pending_count == len(known)
    log.apply(step, failed_decision)
    assert log.state == in_own_order(known)[0]


def test_decisions_are_returned_with_the_replaced_ones() -> None:
    log = Log(START)
    insert(log, (2, "b"), 0.5)
    assert log.apply(step, failed_decision) == [((2, 0.1), None)]
    assert log.apply(step, failed_decision) == []
    insert(log, (1, "a"), -0.5)
    state_1, _ = step(START, (1, -0.5))
    assert log.apply(step, failed_decision) == [((1, 0.1), None), ((2, state_1[1]), (2, 0.1))]


def test_tie_breaker_orders_measurements_of_one_time() -> None:
    forth, back = Log(START), Log(START)
    for log, order in ((forth, ("a", "b", "c")), (back, ("c", "b", "a"))):
        for name in order:
            insert(log, (5, name), float(ord(name)))
            log.apply(step, failed_decision)
    assert forth.state == back.state
    assert forth.get((5, "b")) == (5, 98.0)
    assert forth.get((5, "d")) is None
    assert forth.get((4, "a")) is None


def failing(state: State, measurement: tuple[int, float]) -> tuple[State, Decision]:
    """A step that raises at even times for negative values."""
    if measurement[0] % 2 == 0 and measurement[1] < 0.0:
        raise ArithmeticError("singular")
    return step(state, measurement)


@repeatable
@given(known=measurements, data=st.data())
def test_exception_in_a_step_keeps_the_state_and_delays_nothing(
    known: dict[Key, float], data: st.DataObject
) -> None:
    log, raised = Log(START), []

    def failed_decision(measurement: tuple[int, float], error: Exception) -> Decision:
        assert str(error) == "singular"
        raised.append(measurement)
        return measurement[0], math.nan

    for key in data.draw(st.permutations(sorted(known))):
        insert(log, key, known[key])
        log.apply(failing, failed_decision)
        assert log.pending_count == 0
    good = {key: value for key, value in known.items() if key[0] % 2 or not value < 0.0}
    assert log.state == in_own_order(good)[0]
    assert set(raised) == {(key[0], value) for key, value in known.items() if key not in good}


def test_failed_measurement_is_applied_again_to_another_state() -> None:
    log = Log(START)
    insert(log, (2, "a"), -0.2)
    assert log.apply(failing, lambda measurement, error: (measurement[0], -1.0)) == [((2, -1.0), None)]
    insert(log, (1, "a"), 0.1)
    state_1, first = step(START, (1, 0.1))
    assert log.apply(step, failed_decision) == [(first, None), ((2, state_1[1]), (2, -1.0))]


class LogAgainstSorting(RuleBasedStateMachine):
    """Any mixture of arrivals, replacements, rewinds and commits gives the state of the sorted measurements."""

    @initialize()
    def start(self) -> None:
        self.log = Log(START)
        self.known: dict[Key, float] = {}
        self.bias: dict[int, float] = {}
        self.base, self.closed_ns = START, 0

    def biased_step(self, state: State, measurement: tuple[int, float]) -> tuple[State, Decision]:
        time_ns, value = measurement
        return step(state, (time_ns, value + self.bias.get(time_ns, 0.0)))

    def in_order(self) -> State:
        biased = {key: value + self.bias.get(key[0], 0.0) for key, value in self.known.items()}
        return in_own_order(biased, self.base)[0]

    @rule(key=keys, value=values)
    def insert_measurement(self, key: Key, value: float) -> None:
        if key[0] >= self.closed_ns:
            self.known[key] = value
            insert(self.log, key, value)

    @rule(time_ns=st.integers(0, 40), value=values)
    def change_data_at_a_time(self, time_ns: int, value: float) -> None:
        if time_ns >= self.closed_ns:
            self.bias[time_ns] = value
            self.log.rewind_to_first(lambda decision: decision[0] == time_ns)

    @rule()
    def apply_pending(self) -> None:
        self.log.apply(self.biased_step, failed_decision)
        assert self.log.pending_count == 0
        assert self.log.state == self.in_order()

    @precondition(lambda self: self.log.pending_count == 0)
    @rule(oldest_ns=st.integers(0, 40))
    def commit(self, oldest_ns: int) -> None:
        self.log.commit_before(oldest_ns)
        old = {key: value + self.bias.get(key[0], 0.0) for key, value in self.known.items() if key[0] < oldest_ns}
        self.base = in_own_order(old, self.base)[0]
        self.known = {key: value for key, value in self.known.items() if key not in old}
        self.closed_ns = max(self.closed_ns, oldest_ns)

    @invariant()
    def measurements_are_found(self) -> None:
        assert all(self.log.get(key) == (key[0], value) for key, value in self.known.items())


TestLogAgainstSorting = LogAgainstSorting.TestCase
TestLogAgainstSorting.settings = settings(repeatable, max_examples=100, stateful_step_count=30)


def test_flood_of_late_measurements_is_rate_limited_and_gives_the_same_state() -> None:
    """Half of the measurements are a second late: without limits each would repeat all steps of this second."""
    ms, lag_ns, log = 1_000_000, 2_000_000_000, Log(START)
    known: dict[Key, float] = {}
    repeats_by_second, most_at_once, most_waiting = [0] * 8, 0, 0
    for number in range(1, 3000):
        newest_ns = number * 2 * ms
        late = (newest_ns - 1_000_000_000 + 1, "late")
        for key in ((newest_ns, "prompt"), *([late] if newest_ns > 1_000_000_000 else [])):
            known[key] = math.sin(number)
            insert(log, key, known[key])
            decisions = log.apply(step, failed_decision, (newest_ns - lag_ns, newest_ns))
            repeats = sum(previous is not None for _, previous in decisions)
            repeats_by_second[newest_ns // 1_000_000_000] += repeats
            most_at_once = max(most_at_once, repeats)
        log.commit_before(newest_ns - lag_ns)
        most_waiting = max(most_waiting, log.pending_count)
    # Without limits, 500 late measurements a second would each repeat about 500 steps. Each measurement is applied once
    # more when the window closes.
    assert max(repeats_by_second) <= 2 * MOST_REPEATS_PER_S + 1000
    assert most_at_once <= MOST_REPEATS_AT_ONCE + 2
    assert most_waiting <= 3 * 1000
    log.apply(step, failed_decision)
    assert log.state == in_own_order(known)[0]


def test_few_late_measurements_are_applied_at_once() -> None:
    log = Log(START)
    known = {(time_ns, "star.fore"): 0.1 * time_ns for time_ns in range(1, 21)}
    for key, value in sorted(known.items(), reverse=True):
        insert(log, key, value)
        log.apply(step, failed_decision, (0, 20))
        assert log.pending_count == 0
    assert log.state == in_own_order(known)[0]

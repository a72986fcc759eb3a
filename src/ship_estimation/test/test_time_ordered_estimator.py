"""The time-ordered estimator with a toy model whose steps do not commute: any wrong order changes the state."""

import math
from dataclasses import dataclass

import hypothesis.strategies as st
import numpy as np
from hypothesis import given, settings

from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import MeasurementDecision, Outcome
from ship_estimation.time_order.time_ordered_estimator import (
    EstimatorModel,
    LagWindow,
    OutputSequence,
    TimeOrderedEstimator,
)
from ship_estimation.time_order.time_ordered_log import MOST_OVERTAKEN_PER_S, MOST_REPEATS_AT_ONCE, MOST_REPEATS_PER_S
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.tracks.sample_track import VectorSample, VectorTrack

# Fixed examples, nothing kept between runs.
repeatable = settings(derandomize=True, database=None, deadline=None, max_examples=100)

MS = 1_000_000
LAG_S = 2.0
START = 0.1


@dataclass(frozen=True)
class Toy:
    """A measurement; one with a negative value is rejected, and the step raises for NaN."""

    time_ns: int
    value: float
    source: str = "toy"
    covariance_known: bool = True
    reach_ns: int = 0

    def content(self) -> bytes:
        return np.float64(self.value).tobytes()


Shell = TimeOrderedEstimator[float, Toy, MeasurementDecision[Toy], float, float]
ToyOutcome = Outcome[MeasurementDecision[Toy], float]


class Estimator:
    """An estimator whose state depends on each measurement and on the last track sample before each measurement."""

    def __init__(self) -> None:
        self.track: VectorTrack[VectorSample] = VectorTrack(SECOND_NS)
        self.waits = False
        self.decided: list[MeasurementDecision[Toy]] = []
        self.claimed: list[int] = []
        model: EstimatorModel[float, Toy, MeasurementDecision[Toy], float] = EstimatorModel(
            step=self.step,
            inflate=self.inflate,
            failure_decision=lambda toy, rejection: MeasurementDecision(toy, rejection.reason, text=rejection.text),
            until_ns=lambda decision: decision.measurement.time_ns,
            drop_before=self.track.drop_before,
            on_decision=self.decided.append,
        )
        self.outputs = OutputSequence()
        self.shell: Shell = TimeOrderedEstimator(model, START, LAG_S, SECOND_NS)

    def inflate(self, state: float, jump: float) -> float:
        if math.isnan(jump):
            raise ArithmeticError("no size")
        return math.cos(state) + jump

    def step(self, state: float, toy: Toy, may_wait: bool) -> tuple[float, MeasurementDecision[Toy]] | None:
        if math.isnan(toy.value):
            raise ArithmeticError("singular")
        if may_wait and self.waits and not self.track.is_final_at(toy.time_ns):
            return None
        if toy.value < 0.0:
            return state, MeasurementDecision(toy, Reason.GATE)
        before = self.track.last_before(toy.time_ns)
        added = 0.0 if before is None else float(before.vector[0])
        return math.cos(1.7 * state) + toy.value / 3.0 + added, MeasurementDecision(toy, Reason.NONE, accepted=True)

    def add(self, toy: Toy) -> ToyOutcome:
        outcome = ToyOutcome(self.shell.window.late_rejection(toy.time_ns))
        if outcome.rejection is None:
            self.shell.add(toy, outcome)
        return outcome

    def add_sample(self, time_ms: int, value: float) -> ToyOutcome:
        outcome = ToyOutcome()
        self.shell.add_sample("track", self.track, VectorSample(time_ms * MS, np.array([value])), outcome)
        return outcome


def toy(time_ms: int, value: float = 0.5, source: str = "toy") -> Toy:
    return Toy(time_ms * MS, value, source)


def test_late_measurement_is_rejected_with_its_lag() -> None:
    window = LagWindow(LAG_S)
    window.advance_to(5 * SECOND_NS)
    window.advance_to(4 * SECOND_NS)
    assert window.late_rejection(3 * SECOND_NS) is None
    late = window.late_rejection(3 * SECOND_NS - MS)
    assert late == Rejection(Reason.LATE, "2.001 s behind the newest data: more than lag_s = 2")


def test_duplicate_is_rejected_and_of_conflicting_ones_the_first_in_byte_order_is_kept() -> None:
    first, second = toy(10, 0.5), toy(10, 0.25)
    states = []
    for order in ((first, second), (second, first), (first, first, second), (second, first, second)):
        estimator = Estimator()
        reasons = [outcome.rejection and outcome.rejection.reason for outcome in map(estimator.add, order)]
        assert reasons[0] is None
        expected = [Reason.DUPLICATE if same == order[0] else Reason.CONFLICT for same in order[1:]]
        assert reasons[1:2] == expected[:1]
        states.append(estimator.shell.state)
    assert len(set(states)) == 1
    kept = min(first, second, key=Toy.content)
    alone = Estimator()
    alone.add(kept)
    assert states[0] == alone.shell.state


def test_late_measurement_is_inserted_and_later_ones_are_applied_again() -> None:
    in_order, late = Estimator(), Estimator()
    for time_ms in (10, 20, 30):
        in_order.add(toy(time_ms, 0.01 * time_ms))
    for time_ms in (20, 30, 10):
        outcome = late.add(toy(time_ms, 0.01 * time_ms))
    assert late.shell.state == in_order.shell.state
    # Only the new decision is reported: the others are unchanged. ``on_decision`` receives all decisions.
    assert [decision.measurement.time_ns for decision in outcome.decisions] == [10 * MS]
    assert [decision.measurement.time_ns // MS for decision in late.decided] == [20, 30, 10, 20, 30]


def test_changed_decision_is_reported_as_revised() -> None:
    gate = {"open": True}

    def step(state: float, measurement: Toy, may_wait: bool) -> tuple[float, MeasurementDecision[Toy]]:
        return state, MeasurementDecision(measurement, Reason.NONE if gate["open"] else Reason.GATE, gate["open"])

    shell: Shell = TimeOrderedEstimator(
        EstimatorModel(
            step=step,
            inflate=lambda state, jump: state,
            failure_decision=lambda toy, rejection: MeasurementDecision(toy, rejection.reason),
            until_ns=lambda decision: decision.measurement.time_ns,
            drop_before=lambda time_ns: None,
        ),
        START,
        LAG_S,
        0,
    )
    shell.add(toy(20), ToyOutcome())
    gate["open"] = False
    outcome = ToyOutcome()
    shell.rewind_after(15 * MS)
    shell.apply(outcome)
    assert [(decision.revised, decision.accepted) for decision in outcome.decisions] == [(True, False)]
    outcome = ToyOutcome()
    shell.rewind_after(20 * MS)
    shell.apply(outcome)
    assert outcome.decisions == []


def test_late_sample_applies_dependent_measurements_again() -> None:
    late, prompt = Estimator(), Estimator()
    for estimator, order in ((prompt, "stm"), (late, "mst")):
        for what in order:
            if what == "m":
                estimator.add(toy(30))
            else:
                estimator.add_sample(10 if what == "s" else 20, 0.3 if what == "s" else 0.4)
    assert late.shell.state != START
    assert [decision.measurement.time_ns // MS for decision in prompt.decided] == [30]
    # A sample after all others changes no final value; a sample between others does.
    late.add_sample(15, 0.9)
    prompt.add_sample(15, 0.9)
    late.add_sample(40, 0.9)
    late.shell.rewind_after(0)
    late.shell.apply(ToyOutcome())
    assert late.shell.state == prompt.shell.state


def test_measurement_waits_for_its_data_up_to_the_lag() -> None:
    estimator = Estimator()
    estimator.waits = True
    estimator.add_sample(0, 0.1)
    assert estimator.add(toy(10)).decisions == []
    assert estimator.add(toy(20)).decisions == []
    decisions = estimator.add_sample(15, 0.1).decisions
    assert decisions == []  # a differenced rate needs one more sample
    decisions = estimator.add_sample(18, 0.1).decisions
    assert [decision.measurement.time_ns // MS for decision in decisions] == [10]
    outcome = estimator.add(toy(2021))
    assert [decision.measurement.time_ns // MS for decision in outcome.decisions] == [20]


def test_exception_in_a_step_is_reported_and_keeps_the_state() -> None:
    estimator, without = Estimator(), Estimator()
    for time_ms, value in ((10, 0.5), (20, math.nan), (30, 0.25)):
        outcome = estimator.add(toy(time_ms, value))
        (decision,) = outcome.decisions
        assert decision.reason is (Reason.FAILED if time_ms == 20 else Reason.NONE)
        if not math.isnan(value):
            without.add(toy(time_ms, value))
    assert estimator.shell.state == without.shell.state
    assert "singular" in estimator.decided[1].text
    assert "test_time_ordered_estimator.py" in estimator.decided[1].text


def test_failed_inflation_is_reported_once() -> None:
    estimator, outcome = Estimator(), ToyOutcome()
    estimator.shell.add(toy(100), outcome)
    before = estimator.shell.state
    estimator.shell.add_jump(120 * MS, "toy", math.nan)
    estimator.shell.apply(outcome)
    ((time_ns, rejection),) = outcome.failures
    assert (time_ns, rejection.reason) == (120 * MS, Reason.FAILED)
    assert "no size" in rejection.text
    assert estimator.shell.state == before
    # When the jump is applied again, the failure is not reported again, and the steps after the jump follow.
    estimator.shell.add(toy(110), outcome)
    estimator.shell.add(toy(130), outcome)
    assert len(outcome.failures) == 1
    assert len(outcome.decisions) == 3


def test_jump_inflates_outputs_at_once_and_the_state_at_its_time() -> None:
    estimator = Estimator()
    estimator.add(toy(10))
    before = estimator.shell.state
    estimator.waits = True
    estimator.add(toy(20))
    estimator.shell.add_jump(25 * MS, "ins", 0.5)
    assert estimator.shell.state == before
    assert estimator.shell.state_now == math.cos(before) + 0.5
    estimator.waits = False
    outcome = ToyOutcome()
    estimator.shell.apply(outcome)
    assert [decision.measurement.time_ns // MS for decision in outcome.decisions] == [20]
    assert estimator.shell.state == estimator.shell.state_now
    in_order = Estimator()
    in_order.add(toy(10))
    in_order.add(toy(20))
    in_order.shell.add_jump(25 * MS, "ins", 0.5)
    in_order.shell.apply(ToyOutcome())
    assert in_order.shell.state == estimator.shell.state


@repeatable
@given(data=st.data())
def test_any_order_of_arrival_gives_the_same_state_with_all_faults_combined(data: st.DataObject) -> None:
    """Rejected and failing measurements, duplicates, conflicts, jumps and late samples, shuffled within the lag."""
    toys = [
        toy(time_ms, value, source)
        for time_ms, value, source in data.draw(
            st.lists(
                st.tuples(
                    st.integers(1, 40),
                    st.sampled_from([0.1, 0.7, -0.2, math.nan]),
                    st.sampled_from(["star.abeam", "star.fore"]),
                ),
                min_size=1,
                max_size=12,
            )
        )
    ]
    samples = data.draw(st.dictionaries(st.integers(1, 40), st.floats(0.0, 1.0), max_size=6))
    jumps = data.draw(st.dictionaries(st.integers(1, 40), st.floats(0.0, 1.0), max_size=2))
    events = [("toy", one) for one in toys]
    events += [("sample", one) for one in samples.items()]
    events += [("jump", one) for one in jumps.items()]
    states = []
    for arrivals in (events, data.draw(st.permutations(events)), data.draw(st.permutations(events))):
        estimator = Estimator()
        for number, (kind, what) in enumerate(arrivals):
            if kind == "toy":
                estimator.add(what)
            elif kind == "sample":
                estimator.add_sample(*what)
            else:
                estimator.shell.add_jump(what[0] * MS, "ins", what[1])
            add_one_output(estimator, number)
        # Unlike a real model, the toy model does not wait for the next sample, and a newest sample repeats no step.
        estimator.shell.rewind_after(0)
        estimator.shell.apply(ToyOutcome())
        assert estimator.claimed == sorted(set(estimator.claimed))
        states.append(estimator.shell.state)
    assert states[0] == states[1] == states[2]


def add_one_output(estimator: Estimator, number: int) -> None:
    """Add an output after each arrival, at times that go forth and back; each fourth one cannot be computed."""
    time_ns, outcome = (3 * number + 3) % 7 * MS + number * MS, ToyOutcome()

    def estimate() -> float:
        if number % 4 == 3:
            raise ArithmeticError("no root")
        return estimator.shell.state_now

    estimator.outputs.add(outcome, time_ns, number, estimate)
    assert len(outcome.estimates) + len(outcome.failures) <= 1
    assert all(rejection.reason is Reason.FAILED for _, rejection in outcome.failures)
    estimator.claimed += [time_ns] * len(outcome.estimates)


def test_a_reset_starts_from_a_state() -> None:
    estimator = Estimator()
    estimator.add(toy(10))
    estimator.shell.reset(START)
    assert estimator.shell.state == START
    assert estimator.add(toy(10)).rejection is None


def test_the_window_closes_behind_the_lag_and_the_reach() -> None:
    estimator = Estimator()
    for time_ms in range(0, 8000, 100):
        estimator.add_sample(time_ms, 0.1)
    # 8 samples, and those of the last second, are always kept.
    assert len(estimator.track) <= 35
    late = estimator.add(toy(5000))
    assert late.rejection is not None
    assert late.rejection.reason is Reason.LATE


def flood(rng: np.random.Generator, count: int, seconds: float) -> list[Toy]:
    """Return measurements of one source, evenly in time, each stamped up to the lag earlier."""
    arrival_ns = np.linspace(0.0, seconds * SECOND_NS, count)
    stamps_ns = (arrival_ns + (10.0 - rng.uniform(0.0, LAG_S, count)) * SECOND_NS).astype(int)
    return [Toy(*one) for one in zip(stamps_ns.tolist(), rng.random(count).tolist(), strict=True)]


def test_flood_with_random_stamps_is_limited_by_overflow() -> None:
    """One source sends 100 measurements a second, 50 times as many as a sensor at 2 Hz; another source sends in order.

    Without limits each measurement would cause about 100 repeats.
    """
    seconds, estimator = 30.0, Estimator()
    reasons, texts, at_once = [], [], []
    flooded = flood(np.random.default_rng(7), 3000, seconds)
    in_order = [toy(10_000 + 100 * number, source="prompt") for number in range(300)]
    for number, late in enumerate(flooded):
        for one in [late, *([in_order[number // 10]] if number % 10 == 0 else [])]:
            steps = len(estimator.decided)
            outcome = estimator.add(one)
            at_once.append(len(estimator.decided) - steps)
            if one is late:
                reasons.append(outcome.rejection and outcome.rejection.reason)
                texts.append(outcome.rejection.text if outcome.rejection else "")
            else:
                assert outcome.rejection is None
    taken, late = reasons.count(None), reasons.count(Reason.LATE)
    assert late < 20
    assert reasons.count(Reason.OVERFLOW) == 3000 - taken - late > 1800
    # Each measurement is applied once, and once more when the window closes. The repeats of each second are added, and
    # those of one second in reserve.
    assert len(estimator.decided) < 2 * (taken + len(in_order)) + MOST_REPEATS_PER_S * (seconds + LAG_S + 1.0)
    assert max(at_once) < MOST_REPEATS_AT_ONCE + 20
    report = next(text for text in texts if "source" in text)
    assert report.endswith(f"later ones of their source: {MOST_OVERTAKEN_PER_S} such pairs a second are accepted")


def test_overflow_does_not_change_the_state() -> None:
    estimator, without = Estimator(), Estimator()
    for number, late in enumerate(flood(np.random.default_rng(8), 1000, 10.0)):
        outcome = estimator.add(late)
        if outcome.rejection is None or outcome.rejection.reason is not Reason.OVERFLOW:
            assert without.add(late).rejection == outcome.rejection
        assert estimator.shell.state == without.shell.state, number
    decisions, decisions_without = ([(d.measurement, d.accepted) for d in e.decided] for e in (estimator, without))
    assert decisions == decisions_without


def test_flood_of_late_samples_is_rate_limited_and_gives_the_same_state() -> None:
    """Samples at 100 Hz are up to two seconds late; each one would repeat up to forty measurements at 20 Hz."""
    rng, seconds, estimator, in_order = np.random.default_rng(9), 20.0, Estimator(), Estimator()
    estimator.waits = in_order.waits = True
    stamps_ms = np.arange(10_000, 10_000 + round(1000 * seconds), 10)
    by_arrival = [(ms + rng.uniform(0.0, 1990.0), "sample", ms, 0.001 * (ms % 7)) for ms in stamps_ms.tolist()]
    by_arrival += [(ms + 1.0, "toy", ms, 0.5) for ms in stamps_ms[::5].tolist()]
    for _, kind, ms, value in sorted(by_arrival):
        steps = len(estimator.decided)
        if kind == "toy":
            estimator.add(toy(ms, value))
        else:
            estimator.add_sample(ms, value)
        assert len(estimator.decided) - steps <= MOST_REPEATS_AT_ONCE + 20
    assert len(estimator.decided) < 2 * len(stamps_ms[::5]) + MOST_REPEATS_PER_S * (seconds + LAG_S + 1.0)
    # Without further inputs, ticks apply the rest.
    ticks = 0
    while estimator.shell.is_behind:
        ticks += 1
        estimator.shell.tick((32_000 + 100 * ticks) * MS, ToyOutcome())
    assert 0 < ticks < 10 * LAG_S
    for number, ms in enumerate(stamps_ms.tolist()):
        in_order.add_sample(ms, 0.001 * (ms % 7))
        if number % 5 == 0:
            in_order.add(toy(ms))
    assert estimator.shell.state == in_order.shell.state

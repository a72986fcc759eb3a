"""Order of outputs by their stamps, and INVALID after a timeout."""

import math

import pytest

from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import MeasurementDecision, Outcome
from ship_estimation.time_order.time_ordered_estimator import OutputSequence
from ship_geometry.earth.time_scales import SECOND_NS

MS = 1_000_000
ToyOutcome = Outcome[MeasurementDecision, float]


def test_outputs_strictly_increase_and_a_failure_is_reported() -> None:
    outputs, outcome = OutputSequence(), ToyOutcome()
    for time_ms in (10, 10, 5, 20):
        outputs.add(outcome, time_ms * MS, 0, lambda time_ms=time_ms: float(time_ms))
    assert outcome.estimates == [10.0, 20.0]

    def fails() -> float:
        raise ArithmeticError("no root")

    outputs.add(outcome, 30 * MS, 0, fails)
    outputs.add(outcome, 31 * MS, 0, lambda: None)
    outputs.add(outcome, 30 * MS, 0, lambda: 30.0)
    assert outcome.estimates == [10.0, 20.0, 30.0]
    ((time_ns, rejection),) = outcome.failures
    assert (time_ns, rejection.reason) == (30 * MS, Reason.FAILED)


@pytest.mark.parametrize("timeout_s", [0.05, 1.0, 3.0])
def test_invalid_is_reported_once_a_second_after_the_timeout_for_any_stamps(timeout_s: float) -> None:
    outputs = OutputSequence()
    timeout_ns = round(timeout_s * SECOND_NS)
    outcome = ToyOutcome()
    outputs.add(outcome, 10**18, 0, lambda: 1.0, timeout_ns)
    reported_ns = []
    for waiting_ns in range(0, 8 * SECOND_NS, 100 * MS):
        outcome = ToyOutcome()
        outputs.report_invalid(outcome, waiting_ns, lambda: math.nan)
        if outcome.estimates:
            reported_ns.append(waiting_ns)
    first_ns = max(timeout_ns, SECOND_NS) + 100 * MS
    assert reported_ns == list(range(first_ns, 8 * SECOND_NS, SECOND_NS))


def test_earlier_outputs_may_follow_a_clock_jump_but_not_a_step_of_the_time_base() -> None:
    outputs = OutputSequence()
    outputs.record(10 * MS, 0)
    assert not outputs.can_publish(5 * MS)
    outputs.step_time_base(20 * MS)
    assert not outputs.can_publish(30 * MS)
    assert outputs.can_publish(31 * MS)
    outputs.reset()
    assert outputs.can_publish(5 * MS)


def test_invalid_is_due_at_once_before_the_first_output() -> None:
    outputs, counts = OutputSequence(), []
    for waiting_ns in (0, SECOND_NS - 1, SECOND_NS):
        outcome = ToyOutcome()
        outputs.report_invalid(outcome, waiting_ns, lambda: math.nan)
        counts.append(len(outcome.estimates))
    assert counts == [1, 0, 1]

"""If the software fails on one message, the failure is reported, and all other results are as without the message."""

from collections.abc import Callable
from typing import Any

import pytest

from ship_attitude_star.adapters import ship_attitude_adapter
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.star_attitude import core as star_core
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_testing import star_voyage
from ship_testing.adapter_runs import SECOND_NS, START_NS, AdapterRun, exact_value, index_at, stamp_of, without
from ship_testing.small_voyage import FORE, STARBOARD, fault_free_run, new_adapter, remove_interval, run_adapter, voyage
from ship_testing.star_bad_input import FORE_SOLUTION

FAILURE_S = 2.5
DEFECT = "ArithmeticError: a defect ("


def failing_where(bad: Callable[..., bool], function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a wrapper of `function` that raises an ArithmeticError if `bad` is true for the arguments."""

    def call(*arguments: Any) -> Any:
        if bad(*arguments):
            raise ArithmeticError("a defect")
        return function(*arguments)

    return call


def assert_reported(run: AdapterRun, source: str, time_ns: int) -> None:
    """Assert that the failure is in one innovation message, and once in the log."""
    (innovation,) = run.innovations(Reason.FAILED)
    assert (innovation.source, stamp_of(innovation), innovation.accepted) == (source, time_ns, False)
    assert innovation.reason_text.startswith(DEFECT)
    assert "test_failures.py:" in innovation.reason_text
    (text,) = run.adapter.health.take_failures()
    assert text.endswith(innovation.reason_text)
    assert run.adapter.health.take_failures() == []


def test_a_measurement_on_which_the_filter_raises_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    index = index_at(voyage(), FORE, FAILURE_S)
    bad_ns = voyage()[index].stamp_ns
    bad = failing_where(lambda _, state, m, *rest: (m.source, m.time_ns) == ("star.fore", bad_ns), ShipFilter.step)
    with monkeypatch.context() as patch:
        patch.setattr(ShipFilter, "step", bad)
        run = run_adapter(new_adapter(), voyage())
    expected = run_adapter(new_adapter(), without(voyage(), index))
    assert run.results() == expected.results()
    assert run.state() == expected.state()
    assert run.reasons(FORE) == {"failed": 1}
    assert_reported(run, "star.fore", bad_ns)


def test_a_measurement_that_raised_is_used_where_it_no_longer_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first attempt raises; then a late INS sample causes later-stamped measurements to be applied again."""
    clean, index = fault_free_run(), index_at(voyage(), FORE, FAILURE_S)
    bad_ns, failures = voyage()[index].stamp_ns, [True]
    bad = failing_where(
        lambda _, state, m, *rest: (m.source, m.time_ns) == ("star.fore", bad_ns) and bool(failures and failures.pop()),
        ShipFilter.step,
    )
    late = index_at(voyage(), "ins/imu", FAILURE_S - 0.1)
    arrivals = [*without(voyage(), late)[: index + 40], voyage()[late], *without(voyage(), late)[index + 40 :]]
    monkeypatch.setattr(ShipFilter, "step", bad)
    run = run_adapter(new_adapter(), arrivals)
    assert not failures
    assert run.state() == clean.state()
    assert run.reasons(FORE) == {"failed": 1, "revised": 1}


def test_an_attitude_that_cannot_be_computed_is_the_only_one_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    clean, bad_ns = fault_free_run(), voyage()[index_at(voyage(), "ins/imu", FAILURE_S)].stamp_ns
    bad = failing_where(lambda _, time_ns, *rest: time_ns == bad_ns, CorrectedIns.estimate)
    monkeypatch.setattr(CorrectedIns, "estimate", bad)
    run = run_adapter(new_adapter(), voyage())
    stamped = [m for topic in ("ship/attitude", "ship/imu", "ship/attitude_deg") for m in clean.messages(topic)]
    lost = [m for m in stamped if stamp_of(m) == bad_ns]
    lost += [m for m in clean.messages("/tf") if stamp_of(m.transforms[0]) == bad_ns]
    assert len(lost) == 4
    missing = [exact_value(m) for m in lost]
    assert run.results() == [result for result in clean.results() if result[2] not in missing]
    assert_reported(run, "ship/attitude", bad_ns)


def test_a_failed_budget_does_not_suppress_invalid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ship_attitude_adapter, "alignment_state", failing_where(lambda *arguments: True, None))
    run = run_adapter(
        new_adapter(),
        remove_interval(voyage(), 2.0, 5.0, "ins/imu", FORE, STARBOARD),
        until_ns=START_NS + 5 * SECOND_NS,
    )
    invalid = [m for m in run.messages("ship/attitude") if m.status == Status.INVALID]
    assert [stamp_of(m) - START_NS for m in invalid[-3:]] == [3_000_000_000, 4_000_000_000, 5_000_000_000]
    assert {m.source for m in run.innovations(Reason.FAILED)} == {"slow topics"}


def test_exposures_go_on_after_one_that_cannot_be_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    index = index_at(star_voyage.voyage(), star_voyage.FORE, 1.5)
    clean, bad_ns = star_voyage.fault_free_run(), star_voyage.voyage()[index].stamp_ns
    bad = failing_where(
        lambda exposure, *rest: (exposure.source, exposure.time_ns) == ("star.fore", bad_ns), star_core.solve_exposure
    )
    monkeypatch.setattr(star_core, "solve_exposure", bad)
    run = star_voyage.run_new_adapter(star_voyage.voyage())
    solutions = [[exact_value(m) for m in r.messages(FORE_SOLUTION) if stamp_of(m) != bad_ns] for r in (run, clean)]
    assert solutions[0] == solutions[1]
    assert run.reasons(star_voyage.FORE) == {"failed": 1}
    assert_reported(run, "star.fore", bad_ns)


def test_joint_solutions_go_on_after_one_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    joint = "star/joint/solution"
    clean = star_voyage.fault_free_run()
    bad_ns = stamp_of(clean.messages(joint)[3])
    monkeypatch.setattr(
        star_core, "solve_deck", failing_where(lambda time_ns, *rest: time_ns == bad_ns, star_core.solve_deck)
    )
    run = star_voyage.run_new_adapter(star_voyage.voyage())
    assert [stamp_of(m) for m in run.messages(joint)] == [stamp_of(m) for m in clean.messages(joint)]
    assert [exact_value(m) for m in run.messages(joint)[4:]] == [exact_value(m) for m in clean.messages(joint)[4:]]
    assert_reported(run, "star.joint", bad_ns)

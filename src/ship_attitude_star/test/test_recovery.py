"""Recovery of ``ship_attitude``: a second estimator gets the same inputs and may replace the first estimator.

The tests replace the filter state by wrong errors with a small covariance, from which the filter does not recover.
``make returns`` measures how soon all outputs are VALID after each fault of an input.
"""

import functools
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.messages.input_messages import star_measurement
from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.recovery import memory_residual
from ship_bags.stamps import ns_from_stamp, stamp_fields
from ship_estimation.fault_detection.exclusion import with_changes
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.recovery.recovery import MEMORY_SIGMAS
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, changed_copy, stamp_of
from ship_testing.one_message import process_message
from ship_testing.overconfident_filter import make_overconfident
from ship_testing.small_voyage import (
    FORE,
    INS,
    STARBOARD,
    Run,
    assert_consistent,
    new_adapter,
    run_adapter,
    since_start_s,
    turn_star_messages,
    voyage,
)

ATTITUDE = "ship/attitude"
FAULTY_S, LENGTH_S = 40.0, 130.0
NEVER_S = 1e6
CONFIRMED_S = 70.0
"""Time after a fault until the second estimator has been VALID for ``recovery.confirm_s``, a minute; s."""


@functools.cache
def calm() -> tuple[Arrival, ...]:
    return voyage(LENGTH_S)


def run_voyage(
    arrivals: Iterable[Arrival],
    faulty_s: float = FAULTY_S,
    then: Callable[[Run, float], None] | None = None,
    process: Callable[..., Any] = process_message,
    **changes: Any,
) -> Run:
    """Run a voyage whose filter state is replaced; call ``then`` after each arrival with the time since the start.

    ``process`` passes a message to the adapter.
    """
    run, is_faulty = Run(new_adapter(**changes)), False
    grid_ns = 100_000_000
    tick_ns = START_NS // grid_ns * grid_ns
    for arrival in arrivals:
        while tick_ns + grid_ns <= arrival.receive_ns:
            tick_ns += grid_ns
            run.published += [(tick_ns, *item) for item in run.adapter.tick(tick_ns)]
        since_s = (arrival.receive_ns - START_NS) / SECOND_NS
        if since_s >= faulty_s and not is_faulty:
            is_faulty = True
            make_overconfident(run.adapter)
        run.published += [
            (arrival.receive_ns, *item)
            for item in process(run.adapter, arrival.topic, arrival.message, arrival.receive_ns)
        ]
        run.now_ns = arrival.receive_ns
        if then is not None:
            then(run, since_s)
    return run


@functools.cache
def recovered_run() -> Run:
    return run_voyage(calm())


def statuses(run: Run, from_s: float, until_s: float = np.inf) -> set[int]:
    return {m.status for m in run.messages(ATTITUDE) if from_s <= since_start_s(m) < until_s}


def test_a_filter_with_a_wrong_small_covariance_recovers() -> None:
    run = recovered_run()
    assert statuses(run, FAULTY_S + 2.0, FAULTY_S + 60.0) == {Status.DEGRADED}
    assert statuses(run, FAULTY_S + CONFIRMED_S) == {Status.VALID}
    assert (run.adapter.recovery.started, run.adapter.recovery.adopted) == (1, 1)
    for message in run.messages(ATTITUDE):
        if since_start_s(message) > FAULTY_S + CONFIRMED_S:
            assert_consistent(message)


def test_without_a_second_estimator_it_does_not_recover() -> None:
    run = run_voyage(calm(), recovery__after_s=NEVER_S)
    assert Status.VALID not in statuses(run, FAULTY_S + 2.0)
    assert run.adapter.recovery.started == 0


def test_stamps_continue_to_increase_after_an_adoption() -> None:
    claimed = [stamp_of(m) for m in recovered_run().messages(ATTITUDE) if m.status != Status.INVALID]
    assert all(earlier < later for earlier, later in pairwise(claimed))


class _SufficientLevels(PublishedLevels):
    """Published levels that cover every output."""

    def needs_update(self, *_: Any, **__: Any) -> bool:
        return False


def test_levels_of_an_adopted_estimator_are_published_whatever_was_published_before() -> None:
    def cover_all(run: Run, since_s: float) -> None:
        if since_s > FAULTY_S + 50.0 and not run.adapter.recovery.adopted:
            run.adapter.published_levels = _SufficientLevels()

    run = run_voyage(calm(), then=cover_all)
    both = [(topic, m) for _, topic, m in run.published if topic in (ATTITUDE, "ship/integrity")]
    late = [number for number, (_, m) in enumerate(both) if since_start_s(m) > FAULTY_S + 60.0]
    first = next(number for number in late if both[number][0] == ATTITUDE and both[number][1].status == Status.VALID)
    assert both[first - 1][0] == "ship/integrity"


def test_estimated_mountings_are_kept() -> None:
    cores = (run.adapter.core for run in (recovered_run(), run_adapter(new_adapter(), calm())))
    found, expected = (current_alignment(core.filter, core.config, core.state) for core in cores)
    stars = [number for number, name in enumerate(expected.names) if name.startswith("star.")]
    sigmas = np.sqrt(expected.covariance.diagonal())[stars]
    assert np.all(np.abs(found.values - expected.values)[stars] <= 3.0 * sigmas)


def test_recovery_is_reported_and_counted() -> None:
    run = recovered_run()
    reports = run.diagnostics("recovery", START_NS, run.now_ns)
    texts = [text for _, text in reports]
    assert any(text.startswith("a second estimator runs: ") for text in texts)
    assert texts[-1].startswith("no second estimator runs; the last one was adopted after 6")
    (notice,) = [text for text in run.adapter.notices if "recovered" in text]
    assert notice.startswith("recovered after 6")
    counts = [
        {value.key: value.value for value in status.values}
        for _, topic, report in run.published
        if topic == "/diagnostics"
        for status in report.status
        if status.name == "ship_attitude: alignment"
    ]
    assert counts[-1]["second estimators adopted"] == "1"


def test_nothing_is_saved_in_trouble(tmp_path: Any) -> None:
    path, answers = tmp_path / "alignment.yaml", []

    def save(run: Run, since_s: float) -> None:
        if len(answers) < len(times := (FAULTY_S - 1.0, FAULTY_S + 20.0, FAULTY_S + CONFIRMED_S + 1.0)) and (
            since_s >= times[len(answers)]
        ):
            answers.append(run.adapter.service("save_alignment", run.now_ns))

    run_voyage(calm(), then=save, alignment_file=str(path))
    assert [answer.success for answer in answers] == [True, False, True]
    assert answers[1].message.startswith("not saved: a second estimator runs, because ")


UP = np.array([0.0, 60.0 * ARCSEC, 0.0])


def remount_sensors(arrivals: Iterable[Arrival], from_s: float) -> list[Arrival]:
    """Return the arrivals with both sensors rotated from ``from_s`` on, each by another rotation."""
    fore_n, starboard_n = np.array([200.0, 0.0, 100.0]) * ARCSEC, np.array([-100.0, 0.0, 250.0]) * ARCSEC
    return [turn_star_messages([one], fore_n if one.topic == FORE else starboard_n, from_s)[0] for one in arrivals]


def set_clocks_back(arrivals: Iterable[Arrival], from_s: float, *topics: str) -> list[Arrival]:
    """Return the arrivals with the clocks of ``topics`` set back by 0.1 s from ``from_s`` on."""

    def change(message: Any) -> None:
        ns = ns_from_stamp(message.header.stamp) - SECOND_NS // 10
        message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(ns)

    def is_behind(one: Arrival) -> bool:
        return one.topic in topics and one.receive_ns >= START_NS + from_s * SECOND_NS

    return [changed_copy(one, change) if is_behind(one) else one for one in arrivals]


@pytest.mark.parametrize(
    ("change", "moved"),
    [
        (lambda arrivals: turn_star_messages(arrivals, UP, FAULTY_S), "6"),
        (lambda arrivals: remount_sensors(arrivals, FAULTY_S), "2"),
        (lambda arrivals: set_clocks_back(arrivals, FAULTY_S, INS), "1"),
        (lambda arrivals: set_clocks_back(arrivals, FAULTY_S, FORE, STARBOARD), "1"),
    ],
    ids=["all turned by 60″", "both remounted", "INS's clock", "clock of both sensors"],
)
def test_a_constant_rotation_of_all_stars_is_not_adopted(change: Callable[..., Any], moved: str) -> None:
    """Rotations: 60″; 224″ and 269″; up to 1800″ (0.1 s at 5°/s). ``moved`` is the first digit in the text."""
    run = run_voyage(change(calm()), faulty_s=np.inf)
    assert statuses(run, FAULTY_S + 2.0) == {Status.DEGRADED}
    assert (run.adapter.recovery.started, run.adapter.recovery.adopted) == (1, 0)
    _, text = run.diagnostics("recovery", START_NS, run.now_ns)[-1]
    assert f"shifted: all together by {moved}" in text
    assert "~/reset" in text
    assert "time_offset_s" in text


def test_a_sensor_with_a_constant_clock_error_is_named() -> None:
    run = run_voyage(set_clocks_back(calm(), FAULTY_S, FORE), faulty_s=np.inf)
    assert statuses(run, FAULTY_S) == {Status.VALID}
    assert set(run.adapter.core.state.excluded) == {"star.fore"}
    _, text = run.diagnostics("recovery", START_NS, run.now_ns)[-1]
    assert "star_sensors.fore.time_offset_s" in text


def test_a_constant_rotation_is_not_adopted_if_the_stored_state_is_too_uncertain() -> None:
    """The INS heading may drift by 72″ in ten minutes: the propagated stored state is consistent with 60″."""
    run = run_voyage(turn_star_messages(voyage(190.0), UP, FAULTY_S), faulty_s=np.inf, ins__heading_time_s=600.0)
    recovery = run.adapter.recovery
    core = recovery.candidate.core
    assert (recovery.started, recovery.adopted) == (1, 0)
    assert core.consistency.largest_difference_sigmas(core.state, recovery._reference) < MEMORY_SIGMAS
    assert recovery.candidate.valid_since_ns is not None
    assert statuses(run, FAULTY_S + 2.0) == {Status.DEGRADED}


def test_a_nan_covariance_is_consistent_with_no_stored_state() -> None:
    core = run_adapter(new_adapter(), voyage(20.0)).adapter.core
    assert core.consistency.largest_difference_sigmas(core.state, core.state) == 0.0
    parts = core.state.stack.copy()
    parts[0, 0, 0] = np.nan
    unknown = with_changes(core.state, stack=parts)
    assert not core.consistency.largest_difference_sigmas(core.state, unknown) <= MEMORY_SIGMAS


def test_a_fault_from_the_start_leaves_no_stored_state() -> None:
    """A node that starts with all stars rotated has no stored state from before; it must recover after the rotation."""
    run = run_voyage(turn_star_messages(calm(), UP, -1.0, 15.0), faulty_s=np.inf)
    assert run.adapter.recovery.adopted == 1
    assert statuses(run, 15.0 + CONFIRMED_S) == {Status.VALID}


def test_reset_after_remounting_ends_recovery_at_once() -> None:
    resets = []

    def reset(run: Run, since_s: float) -> None:
        if since_s >= 80.0 and not resets:
            resets.append(run.adapter.service("reset", run.now_ns))

    run = run_voyage(turn_star_messages(calm(), UP, FAULTY_S), faulty_s=np.inf, then=reset)
    assert statuses(run, 82.0) == {Status.VALID}
    assert not run.adapter.recovery.is_in_trouble


def test_a_temporary_rotation_of_all_stars_ends_although_they_are_not_reinstated() -> None:
    """Stars are not reinstated, since ``integrity.return_after_s`` is an hour, but a second estimator is adopted."""
    arrivals = turn_star_messages(voyage(145.0), UP, FAULTY_S, 70.0)
    run = run_voyage(arrivals, faulty_s=np.inf, integrity__return_after_s=3600.0)
    assert statuses(run, FAULTY_S + 2.0, 130.0) == {Status.DEGRADED}
    assert statuses(run, 70.0 + CONFIRMED_S) == {Status.VALID}
    assert run.adapter.recovery.adopted == 1
    assert not run.adapter.core.state.excluded


def test_a_sensor_with_a_mounting_shift_stays_excluded_and_does_not_prevent_the_adoption() -> None:
    def shift_mounting(arrival: Arrival) -> Arrival:
        is_hit = arrival.topic == FORE and arrival.stamp_ns >= START_NS + 35 * SECOND_NS
        return turn_star_messages([arrival], 60.0 * UP, 0.0)[0] if is_hit else arrival

    run = run_voyage(list(map(shift_mounting, voyage(150.0))))
    assert run.adapter.recovery.adopted == 1
    assert statuses(run, 140.0) == {Status.VALID}
    assert set(run.adapter.core.state.excluded) == {"star.fore"}


def test_without_a_fault_no_second_estimator_starts_and_the_outputs_are_those_without_recovery() -> None:
    plain, without = run_voyage(calm(), faulty_s=np.inf), run_voyage(calm(), faulty_s=np.inf, recovery__after_s=NEVER_S)
    assert plain.adapter.recovery.started == 0
    assert plain.results() == without.results()


def test_parameters_set_in_trouble_are_those_of_the_estimator_that_is_adopted() -> None:
    changed = []

    def change(run: Run, since_s: float) -> None:
        if since_s >= FAULTY_S + 20.0 and not changed:
            changed.append(run.adapter.set_parameters({"ins.white_sigma_arcsec": 2.5}))

    run = run_voyage(calm(), then=change)
    assert run.adapter.recovery.adopted == 1
    assert run.adapter.core.config.ins.white_sigma_arcsec == 2.5


def test_an_exception_of_the_second_estimator_does_not_prevent_new_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = []

    def change(run: Run, since_s: float) -> None:
        if since_s >= FAULTY_S + 20.0 and not changed:
            monkeypatch.setattr(run.adapter.recovery.candidate.core, "reconfigure", lambda _config: 1 / 0)
            changed.append(run.adapter.set_parameters({"ins.white_sigma_arcsec": 2.5}))

    run = run_voyage(voyage(150.0), then=change)
    assert run.adapter.recovery.adopted == 1
    assert run.adapter.core.config.ins.white_sigma_arcsec == 2.5
    (report,) = [one for one in run.innovations(Reason.FAILED) if one.source == "recovery"]
    assert "ZeroDivisionError" in report.reason_text


def test_the_second_estimator_gets_new_parameters_although_the_first_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = []

    def change(run: Run, since_s: float) -> None:
        if since_s >= FAULTY_S + 20.0 and not seconds:
            seconds.append(run.adapter.recovery.candidate.core)
            with monkeypatch.context() as first:
                first.setattr(run.adapter.core, "reconfigure", lambda _config: 1 / 0)
                with pytest.raises(ZeroDivisionError):
                    run.adapter.set_parameters({"ins.white_sigma_arcsec": 2.5})

    run = run_voyage(calm(), then=change)
    assert run.adapter.core is seconds[0]
    assert run.adapter.core.config.ins.white_sigma_arcsec == 2.5


def test_the_second_estimator_gets_each_input_although_the_first_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, started_s = [], FAULTY_S + 30.0

    def raise_for_a_while(run: Run, since_s: float) -> None:
        candidate = run.adapter.recovery.candidate
        if since_s >= started_s and not calls and candidate is not None:
            calls.append("start")
            add = candidate.core.add_measurement
            candidate.core.add_measurement = lambda *given: calls.append("second") or add(*given)
            run.adapter.core.add_measurement = fail
            run.adapter.bind()
        if since_s >= started_s + 5.0 and "end" not in calls:
            calls.append("end")
            del run.adapter.core.add_measurement
            run.adapter.bind()

    def fail(*_: Any) -> Any:
        calls.append("first")
        raise ArithmeticError

    def process(adapter: Any, topic: str, *given: Any) -> Any:
        try:
            return process_message(adapter, topic, *given)
        except ArithmeticError:  # the node runtime reports it
            return []

    run = run_voyage(calm(), then=raise_for_a_while, process=process)
    during = calls[1 : calls.index("end")]
    assert len(during) > 20
    assert during == ["first", "second"] * (len(during) // 2)
    assert run.adapter.recovery.adopted == 1


def test_an_exception_before_the_adoption_does_not_prevent_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ShipAttitudeAdapter, "before_adoption", lambda _adapter: 1 / 0)
    run = run_voyage(calm())
    assert run.adapter.recovery.adopted == 1
    assert statuses(run, FAULTY_S + CONFIRMED_S) == {Status.VALID}
    (report,) = [one for one in run.innovations(Reason.FAILED) if one.source == "recovery"]
    assert "ZeroDivisionError" in report.reason_text


def test_a_step_of_all_clocks_in_trouble() -> None:
    """The second estimator continues with the new stamps; its stored state is propagated."""
    step_s, from_s = 600, 60.0

    def by_clock(arrival: Arrival) -> Arrival:
        def change(message: Any) -> None:
            message.header.stamp.sec += step_s

        return changed_copy(arrival, change) if arrival.receive_ns >= START_NS + from_s * SECOND_NS else arrival

    adapter = new_adapter(recovery__confirm_s=30.0)
    run, is_faulty = Run(adapter), False
    tick_ns, grid_ns = START_NS // 100_000_000 * 100_000_000, 100_000_000
    for arrival in map(by_clock, calm()):
        since_s = (arrival.receive_ns - START_NS) / SECOND_NS
        off_ns = round(step_s * SECOND_NS) if since_s >= from_s else 0
        while tick_ns + grid_ns <= arrival.receive_ns:
            tick_ns += grid_ns
            run.published += [(tick_ns, *item) for item in adapter.tick(tick_ns + off_ns, tick_ns)]
        if since_s >= FAULTY_S and not is_faulty:
            is_faulty = True
            make_overconfident(adapter)
        receive_ns = arrival.receive_ns
        handled = process_message(adapter, arrival.topic, arrival.message, receive_ns + off_ns, receive_ns)
        run.published += [(receive_ns, *item) for item in handled]
    last = [m for ns, topic, m in run.published if topic == ATTITUDE and ns > START_NS + 120 * SECOND_NS]
    assert {m.status for m in last} == {Status.VALID}


def test_memory_residual_is_the_rotation_of_the_stars_with_its_noise() -> None:
    """The residual is the injected rotation with the noise of the messages: 3″ across, 100″ about the boresight."""
    turn_n, memory = np.array([10.0, 60.0, -20.0]) * ARCSEC, None
    arrivals = turn_star_messages(voyage(20.0), turn_n, 19.0)

    def remember(run: Run, since_s: float) -> None:
        nonlocal memory
        memory = run.adapter.core.state if since_s < 19.0 else memory

    adapter = run_voyage(arrivals, faulty_s=np.inf, then=remember).adapter
    last = [one for one in arrivals if one.topic == FORE and 19.2 < (one.stamp_ns - START_NS) / SECOND_NS < 19.6]
    assert last
    for one in last:
        config = adapter.config.star_sensors["fore"]
        reading = star_measurement(one.message, receive_ns=one.receive_ns, sensor_id="fore", config=config)
        core = adapter.core
        residual = memory_residual(core.filter, memory, reading.value, core.ins.track, None)
        assert residual is not None
        sigmas = np.sqrt(np.linalg.eigvalsh(residual.noise)) / ARCSEC
        np.testing.assert_allclose(sigmas, [3.0, 3.0, 100.0], rtol=0.05)
        error = residual.turn - turn_n
        assert error @ np.linalg.solve(residual.noise + residual.expected, error) < chi2.ppf(0.999, 3)


def test_an_exception_in_the_second_estimator_costs_no_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the exception another second estimator starts and is adopted."""
    start, failing = ShipAttitudeCore.make_second, []

    def make_second(core: ShipAttitudeCore, memory: Any) -> ShipAttitudeCore:
        found = start(core, memory)
        if not failing:
            failing.append(found)
            monkeypatch.setattr(found.ins, "add", lambda *_: 1 / 0)
        return found

    monkeypatch.setattr(ShipAttitudeCore, "make_second", make_second)
    run = run_voyage(calm())
    assert len(run.messages(ATTITUDE)) == len(recovered_run().messages(ATTITUDE))
    assert (len(failing), run.adapter.recovery.adopted) == (1, 1)
    (report,) = [one for one in run.innovations(Reason.FAILED) if one.source == "recovery"]
    assert "ZeroDivisionError" in report.reason_text


def test_smoothed_attitudes_continue_after_an_adoption() -> None:
    run = run_voyage(calm(), smoothing_lag_s=5.0)
    assert run.adapter.recovery.adopted == 1
    stamps_s = [since_start_s(m) for m in run.messages("ship/attitude_smoothed")]
    assert all(earlier < later for earlier, later in pairwise(stamps_s))
    assert stamps_s[-1] > LENGTH_S - 8.0

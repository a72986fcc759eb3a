"""Faults of an INS with well-formed samples: jumps, frozen values, wrong rates; single and combined."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation
from ship_testing.adapter_runs import (
    SECOND_NS,
    START_NS,
    Arrival,
    Arrivals,
    change_where,
    index_at,
    replace_message,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.small_voyage import (
    FORE,
    INS,
    STARBOARD,
    Run,
    attitude,
    new_adapter,
    quaternion_message,
    run_adapter,
    voyage,
)

Change = Callable[[Any], None]
AXES = "xyz"


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def rotation_of(message: Any) -> np.ndarray:
    q = message.orientation
    return rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))


def error_and_covariance(message: Any) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector of the error in (North, Up, East), rad, and its covariance."""
    order = [1, 2, 0]
    covariance_n = np.reshape(message.rotation_covariance, (3, 3))[np.ix_(order, order)]
    return log_rotation(attitude(seconds(message), 34.4) @ rotation_of(message).T), covariance_n


def nees(run: Run, from_s: float = 0.0) -> np.ndarray:
    """Return the NEES of all VALID attitudes from a time on."""
    valid = [m for m in run.messages("ship/attitude") if m.status == Status.VALID and seconds(m) >= from_s]
    assert valid
    return np.array([e @ np.linalg.solve(p, e) for e, p in map(error_and_covariance, valid)])


def assert_consistent(run: Run) -> None:
    """No VALID attitude is off by more than five standard deviations about any axis."""
    for message in run.messages("ship/attitude"):
        if message.status == Status.VALID:
            error_n, covariance_n = error_and_covariance(message)
            sigma_n = np.sqrt(np.diagonal(covariance_n))
            assert np.all(np.abs(error_n) < 5.0 * sigma_n), (seconds(message), error_n / ARCSEC, sigma_n / ARCSEC)


def of_ins(from_s: float = -1.0, until_s: float = 1e9) -> Callable[[Arrival], bool]:
    return lambda a: a.topic == INS and from_s <= (a.stamp_ns - START_NS) * 1e-9 < until_s


def scale_rates(factor: float) -> Change:
    """Return a change that scales the rates: to another unit, or to zero."""

    def change(message: Any) -> None:
        for axis in AXES:
            setattr(message.angular_velocity, axis, factor * getattr(message.angular_velocity, axis))

    return change


def turn_attitude(*arcsec_n: float) -> Change:
    """Return a change that rotates the attitude about North, Up, East."""

    def change(message: Any) -> None:
        message.orientation = quaternion_message(exp_rotation(np.array(arcsec_n) * ARCSEC) @ rotation_of(message))

    return change


def hold_values(arrivals: Arrivals, from_s: float) -> Change:
    value = arrivals[index_at(arrivals, INS, from_s)].message.orientation

    def change(message: Any) -> None:
        message.orientation = value

    return change


def negate_w(message: Any) -> None:
    message.orientation.w = -message.orientation.w


def only_gaps(run: Run) -> int:
    """Return the largest number of rejected measurements of a star sensor; assert that all are for an INS gap."""
    reasons = [run.reasons(topic) for topic in (FORE, STARBOARD)]
    assert all(counts.keys() <= {"gap"} for counts in reasons)
    return max(counts.get("gap", 0) for counts in reasons)


def thin_out(arrivals: Arrivals, keep: int) -> Arrivals:
    """Return the arrivals with only every ``keep``-th sample of the INS."""
    numbers = {id(a): n for n, a in enumerate(a for a in arrivals if a.topic == INS)}
    return tuple(a for a in arrivals if a.topic != INS or numbers[id(a)] % keep == 0)


# -- one wrong sample -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("zero_rates", [False, True])
def test_one_wrong_sample_is_rejected_and_changes_nothing(zero_rates: bool) -> None:
    """A quaternion with ``orientation.w`` negated has unit norm, but is more than 90° from the ship's attitude."""
    arrivals = change_where(voyage(), of_ins(), scale_rates(0.0)) if zero_rates else voyage()
    index = index_at(arrivals, INS, 3.0)
    run = run_adapter(new_adapter(), replace_message(arrivals, index, negate_w))
    without = run_adapter(new_adapter(), (*arrivals[:index], *arrivals[index + 1 :]))
    assert run.reasons(INS) == {"gate": 1}
    assert "from its prediction by earlier samples" in run.innovations(Reason.GATE)[0].reason_text
    assert run.results() == without.results()
    assert run.state() == without.state()


def test_a_late_wrong_sample_is_rejected_too() -> None:
    index = index_at(voyage(), INS, 3.0)
    run = run_adapter(
        new_adapter(), replace_message(voyage(), index, negate_w, voyage()[index].receive_ns + SECOND_NS // 2)
    )
    assert run.reasons(INS) == {"gate": 1}
    assert_consistent(run)


@pytest.mark.parametrize("size_arcsec", [100.0, 3600.0, 90.0 * 3600.0])
def test_a_permanent_jump_inflates_the_covariance_until_stars_are_consistent(size_arcsec: float) -> None:
    """Five samples are rejected.

    From the sixth on the attitude is DEGRADED with a sigma as large as the jump, until stars confirm the attitude.
    """
    jumped = change_where(voyage(8.0), of_ins(3.0), turn_attitude(0.0, size_arcsec, 0.0))
    run = run_adapter(new_adapter(), jumped)
    assert run.reasons(INS) == {"gate": 5}
    after = [m for m in run.messages("ship/attitude") if seconds(m) >= 3.0]
    assert seconds(after[0]) == pytest.approx(3.2)
    degraded = [m for m in after if m.status == Status.DEGRADED]
    assert degraded[0] is after[0]
    assert 1 <= len(degraded) <= 10
    assert {m.status for m in after[len(degraded) :]} == {Status.VALID}
    error_n, covariance_n = error_and_covariance(after[0])
    assert np.abs(error_n[1]) < 1.5 * np.sqrt(covariance_n[1, 1])
    assert_consistent(run)
    # All stars except one in the gap are used: the jump is estimated as an INS error.
    assert only_gaps(run) <= 1


def test_without_stars_a_jump_stays_degraded() -> None:
    arrivals = [a for a in voyage(8.0) if a.topic == INS or a.stamp_ns < START_NS + 3 * SECOND_NS]
    run = run_adapter(
        new_adapter(coasting_after_s=100.0), change_where(arrivals, of_ins(4.0), turn_attitude(0.0, 3600.0, 0.0))
    )
    after = [m for m in run.messages("ship/attitude") if seconds(m) >= 4.0]
    assert {m.status for m in after} == {Status.DEGRADED}
    text = run.diagnostics("attitude", run.now_ns - SECOND_NS, run.now_ns)[-1][1]
    assert text.endswith("confirmation by stars of two different times is pending")


def test_the_number_of_rejected_samples_is_a_live_parameter() -> None:
    jumped = change_where(voyage(), of_ins(3.0), turn_attitude(0.0, 3600.0, 0.0))
    assert run_adapter(new_adapter(ins__jump_samples=2), jumped).reasons(INS) == {"gate": 2}
    adapter = run_adapter(new_adapter(), [a for a in jumped if a.stamp_ns < START_NS + 2 * SECOND_NS]).adapter
    adapter.set_parameters({"ins.jump_samples": 3})
    run = run_adapter(adapter, [a for a in jumped if a.stamp_ns >= START_NS + 2 * SECOND_NS])
    assert run.reasons(INS) == {"gate": 3}


def test_a_late_star_from_before_a_jump_is_compared_with_the_attitude_before_it() -> None:
    jumped = change_where(voyage(), of_ins(3.0), turn_attitude(0.0, 3600.0, 0.0))
    late = replace_message(jumped, index_at(jumped, FORE, 2.8), lambda message: None, START_NS + 4 * SECOND_NS)
    assert run_adapter(new_adapter(), late).state() == run_adapter(new_adapter(), jumped).state()


# -- wrong rates --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("keep", [1, 2])
def test_zero_rates_are_not_used_and_the_attitude_is_consistent(keep: int) -> None:
    run = run_adapter(new_adapter(), change_where(thin_out(voyage(20.0), keep), of_ins(), scale_rates(0.0)))
    assert run.reasons(INS).keys() <= {"rate_not_measured"}
    assert_consistent(run)
    # The errors of one voyage hardly change in a second. The limit is therefore a 99.9 % chi-square limit for few
    # draws.
    assert np.mean(nees(run, 2.0)) < 12.0
    reports = run.diagnostics("ins rates", START_NS + SECOND_NS, run.now_ns)
    assert {level for level, _ in reports} == {1}
    assert "not used" in reports[0][1]
    assert_same_attitudes(
        run, run_adapter(new_adapter(), change_where(thin_out(voyage(20.0), keep), of_ins(), no_rate))
    )


def test_a_sigma_of_the_ins_that_contradicts_the_configured_one_is_reported() -> None:
    """The message states a heading sigma of 0.1°, 72″ are configured; this changes no attitude."""

    def states(message: Any) -> None:
        message.orientation_covariance = np.diag(np.deg2rad([0.002, 0.002, 0.1]) ** 2).ravel()

    run = run_adapter(new_adapter(), change_where(voyage(), of_ins(), states))
    reports = run.diagnostics("ins noise", START_NS + SECOND_NS, run.now_ns)
    text = "ins/imu states a sigma of 360 arcsec in heading, ins.heading_sigma_arcsec is "
    assert {(level, found.startswith(text)) for level, found in reports} == {(1, True)}
    assert_same_attitudes(run, run_adapter(new_adapter(), voyage()))
    reports = run_adapter(new_adapter(), voyage()).diagnostics("ins noise", START_NS + SECOND_NS, run.now_ns)
    assert {level for level, _ in reports} == {0}


def no_rate(message: Any) -> None:
    """Mark the rates of an Imu message as not measured."""
    message.angular_velocity_covariance[0] = -1.0


def assert_same_attitudes(one: Run, other: Run) -> None:
    """Assert that the attitudes of two runs are equal to the last bit after the first half second."""
    attitudes = [
        {stamp_of(m): rotation_of(m).tobytes() for m in run.messages("ship/attitude") if seconds(m) > 0.5}
        for run in (one, other)
    ]
    assert attitudes[0] == attitudes[1]


def test_failing_rates_cost_half_a_second_and_no_star() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(12.0), of_ins(4.0, 9.0), scale_rates(0.0)))
    rejected = run.reasons(INS)["gate"]
    assert 1 <= rejected <= 16
    assert_consistent(run)
    assert only_gaps(run) <= 3
    # The covariance is not inflated: the estimated INS errors are kept.
    sigma = [np.sqrt(m.covariance[0]) for m in run.messages("ship/attitude") if seconds(m) > 5.0]
    assert max(sigma) < 20.0 * ARCSEC


def test_at_rest_the_result_of_the_rate_check_is_kept() -> None:
    """An INS with rates in deg/s stays unused while the ship is at rest for ten seconds, and afterwards."""
    arrivals = change_where(voyage(22.0), of_ins(0.0, 22.0), scale_rates(np.rad2deg(1.0)))
    first = arrivals[index_at(arrivals, INS, 8.0)].message

    def set_at_rest(message: Any) -> None:
        message.orientation = first.orientation
        for axis in AXES:
            setattr(message.angular_velocity, axis, 0.0)

    run = run_adapter(new_adapter(), change_where(arrivals, of_ins(8.0, 18.0), set_at_rest))
    used = {m.sources[0] for m in run.messages("ship/attitude") if seconds(m) > 6.0 and m.status != Status.INVALID}
    assert "ins" not in used
    assert set(run.reasons(INS)) <= {"units", "gate", "stuck", "rate_not_measured"}


def test_five_seconds_of_rates_in_degrees_have_no_later_effect() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(30.0), of_ins(6.0, 11.5), scale_rates(np.rad2deg(1.0))))
    assert run.reasons(INS).keys() >= {"gate", "units"}
    assert_consistent(run)
    assert run.messages("ship/attitude")[-1].status == Status.VALID
    alignment = current_alignment(run.adapter.core.filter, run.adapter.core.config, run.adapter.core.state)
    index = alignment.names.index("ins.time_offset")
    sigma_s = np.sqrt(alignment.covariance[index, index])
    assert abs(alignment.values[index] - 0.003) < 4.0 * sigma_s
    assert sigma_s < 0.001


def test_rates_in_degrees_from_the_start_have_no_later_effect() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(20.0), of_ins(0.0, 5.0), scale_rates(np.rad2deg(1.0))))
    assert_consistent(run)
    assert run.messages("ship/attitude")[-1].status == Status.VALID


# -- combined -------------------------------------------------------------------------------------------------------


def test_a_frozen_ins_and_a_frozen_star_are_detected_by_the_other_star_and_the_rates() -> None:
    arrivals = voyage(16.0)
    star = arrivals[index_at(arrivals, FORE, 4.0)].message

    def freeze(message: Any) -> None:
        message.azimuth, message.elevation, message.roll = star.azimuth, star.elevation, star.roll

    def of_fore(arrival: Arrival) -> bool:
        return arrival.topic == FORE and 4.0 <= (arrival.stamp_ns - START_NS) * 1e-9 < 8.0

    faulty = change_where(change_where(arrivals, of_ins(4.0, 9.0), hold_values(arrivals, 4.0)), of_fore, freeze)
    run = run_adapter(new_adapter(), faulty)
    for source in ("ins", "star.fore"):
        detected_s = [seconds(m) for m in run.innovations(Reason.STUCK) if m.source == source]
        assert 4.0 < detected_s[0] < 6.0
    assert max(seconds(m) for m in run.innovations(Reason.STUCK)) < 9.0
    assert_consistent(run)
    assert run.messages("ship/attitude")[-1].status == Status.VALID


def test_a_jump_with_rates_in_degrees_and_back() -> None:
    faulty = change_where(voyage(25.0), of_ins(5.0, 12.0), scale_rates(np.rad2deg(1.0)))
    run = run_adapter(new_adapter(), change_where(faulty, of_ins(5.0), turn_attitude(600.0, 3600.0, 0.0)))
    assert_consistent(run)
    assert run.messages("ship/attitude")[-1].status == Status.VALID


def test_a_wrong_sample_while_frozen_is_rejected() -> None:
    frozen = change_where(voyage(10.0), of_ins(3.0, 6.0), hold_values(voyage(10.0), 3.0))
    run = run_adapter(
        new_adapter(), replace_message(frozen, index_at(frozen, INS, 5.0), turn_attitude(0.0, 3600.0, 0.0))
    )
    rejected = run.reasons(INS)
    assert rejected["gate"] + rejected["stuck"] == 74
    assert_consistent(run)
    assert run.messages("ship/attitude")[-1].status == Status.VALID


def test_without_order_a_jump_is_never_valid_and_wrong() -> None:
    """Samples and stars arrive up to a second late, in any order, around a jump."""
    rng = np.random.default_rng(3)
    jumped = change_where(voyage(8.0), of_ins(3.0), turn_attitude(0.0, 3600.0, 0.0))
    late = sort_by_arrival(
        Arrival(a.topic, a.message, a.receive_ns + round(rng.uniform(0.0, 1.0) * SECOND_NS)) for a in jumped
    )
    assert_consistent(run_adapter(new_adapter(), late))

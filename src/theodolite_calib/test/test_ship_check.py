"""The INS alone as the ship's attitude: well-formed wrong samples, alone and with other faults."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import quaternion_from_rotation, rotation_from_quaternion
from ship_geometry.rotations import exp_rotation
from ship_testing.adapter_runs import (
    SECOND_NS,
    START_NS,
    Arrival,
    change_where,
    index_at,
    replace_message,
    sort_by_arrival,
    without,
)
from ship_testing.small_session import (
    BEACONS,
    ENCODER,
    INS,
    Run,
    error_in_sigmas,
    new_adapter,
    run_adapter,
    session_with_ins_only,
    stamp_of,
)
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

Change = Callable[[Any], None]
ZERO, TRUE, DEGREES = 0.0, 1.0, np.rad2deg(1.0)


def adapter(**changes: Any) -> OpticalAxisAdapter:
    # The time offset of 5 ms alone is 36" at 2°/s.
    return new_adapter(**{"ship__source": INS, "ins__time_offset_sigma_s": 0.0, **changes})


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def of_topic(topic: str, from_s: float = -1.0, until_s: float = 1e9) -> Callable[[Arrival], bool]:
    return lambda a: a.topic == topic and from_s <= (a.stamp_ns - START_NS) * 1e-9 < until_s


def scale_rates(factor: float) -> Change:
    def change(message: Any) -> None:
        for axis in "xyz":
            setattr(message.angular_velocity, axis, factor * getattr(message.angular_velocity, axis))

    return change


def turn_attitude(*degrees_n: float) -> Change:
    """Return a change that rotates the attitude about North, Up, East."""

    def change(message: Any) -> None:
        q = message.orientation
        rotation_nd = rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))
        rotation_nd = exp_rotation(np.deg2rad(degrees_n)) @ rotation_nd
        q.x, q.y, q.z, q.w = quaternion_from_rotation(rotation_nd).tolist()

    return change


def negate_w(message: Any) -> None:
    message.orientation.w = -message.orientation.w


def is_within_covariance(run: Run) -> bool:
    claimed = [m for m in run.pointings if m.status in (Status.VALID, Status.COASTING)]
    return bool(claimed) and max(error_in_sigmas(m) for m in claimed) < 6.0


@pytest.mark.parametrize("factor", [TRUE, ZERO])
@pytest.mark.parametrize("wrong", [negate_w, turn_attitude(0.0, 1.0, 0.0)])
def test_one_wrong_sample_is_rejected_without_effect(wrong: Change, factor: float) -> None:
    arrivals = change_where(session_with_ins_only(), of_topic(INS), scale_rates(factor))
    index = index_at(arrivals, INS, 3.017)
    run = run_adapter(adapter(), replace_message(arrivals, index, wrong))
    assert run.reasons(INS) == {"gate": 1}
    assert "from its prediction by earlier samples" in run.innovations(Reason.GATE)[0].reason_text
    assert run.results() == run_adapter(adapter(), without(arrivals, index)).results()


def test_late_wrong_sample_is_rejected() -> None:
    """The late sample has an error of a degree, which only the rates of its neighbours contradict."""
    arrivals = session_with_ins_only()
    index = index_at(arrivals, INS, 3.017)
    faulty = replace_message(arrivals, index, turn_attitude(1.0, 0.0, 0.0))
    late = Arrival(INS, faulty[index].message, faulty[index].receive_ns + SECOND_NS // 2)
    run = run_adapter(adapter(), sort_by_arrival([*without(arrivals, index), late]))
    assert run.reasons(INS) == {"gate": 1}
    assert run.results() == run_adapter(adapter(), without(arrivals, index)).results()


@pytest.mark.parametrize("degrees_n", [(0.3, 0.0, 0.0), (0.0, 0.5, 0.3)])
@pytest.mark.parametrize("offset_s", [0.0, 0.02])
def test_permanent_jump_inflates_the_covariance_until_beacons_agree(
    degrees_n: tuple[float, ...], offset_s: float
) -> None:
    def set_earlier_stamp(message: Any) -> None:
        # The clock lags by the configured offset.
        stamp_ns = stamp_of(message) - round(offset_s * SECOND_NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND_NS)

    arrivals = change_where(session_with_ins_only(10.0), of_topic(INS, 3.0), turn_attitude(*degrees_n))
    run = run_adapter(adapter(ins__time_offset_s=offset_s), change_where(arrivals, of_topic(INS), set_earlier_stamp))
    assert run.reasons(INS) == {"gate": 5}
    after = [m for m in run.pointings if seconds(m) >= 3.0 and m.status != Status.INVALID]
    degraded = [m for m in after if m.status == Status.DEGRADED]
    assert degraded[0] is after[0]
    assert 3.2 < seconds(degraded[0]) < 3.4
    assert seconds(degraded[-1]) < 4.5
    assert max(error_in_sigmas(m) for m in degraded) < 4.0
    assert {m.status for m in after[len(degraded) :]} == {Status.VALID}
    assert is_within_covariance(run)
    assert run.reasons(BEACONS).keys() <= {"gap"}


def test_jump_without_beacons_stays_degraded() -> None:
    dark = [a for a in session_with_ins_only(10.0) if a.topic != BEACONS or seconds(a.message) < 3.0]
    run = run_adapter(adapter(), change_where(dark, of_topic(INS, 4.0), turn_attitude(0.0, 2.0, 0.0)))
    after = [m for m in run.pointings if seconds(m) >= 4.1]
    assert {m.status for m in after} == {Status.DEGRADED}
    assert max(error_in_sigmas(m) for m in after) < 3.0
    assert run.adapter.core.state.time_ns is not None


def test_beacons_before_a_jump_do_not_confirm_it() -> None:
    """Beacons stamped from 2.6 s on are late by 0.9 s and arrive after the jump at 3 s has been accepted."""
    arrivals = [
        Arrival(a.topic, a.message, a.receive_ns + 900_000_000 * of_topic(BEACONS, 2.6)(a))
        for a in session_with_ins_only(5.0)
        if not of_topic(BEACONS, 3.0)(a)
    ]
    run = run_adapter(
        adapter(), change_where(sort_by_arrival(arrivals), of_topic(INS, 3.0), turn_attitude(0.0, 0.5, 0.0))
    )
    after = [m for m in run.pointings if seconds(m) >= 3.1]
    assert {m.status for m in after} == {Status.DEGRADED}
    assert max(error_in_sigmas(m) for m in after) < 3.0


def test_simultaneous_encoder_slip_and_ins_jump() -> None:
    def slip(message: Any) -> None:
        message.azimuth = (message.azimuth + np.deg2rad(0.4)) % (2.0 * np.pi)

    arrivals = change_where(session_with_ins_only(10.0), of_topic(INS, 3.0), turn_attitude(0.0, 0.3, 0.2))
    run = run_adapter(adapter(), change_where(arrivals, of_topic(ENCODER, 3.1), slip))
    assert (run.reasons(INS), run.reasons(ENCODER)) == ({"gate": 5}, {"gate": 5})
    assert is_within_covariance(run)
    assert run.pointings[-1].status == Status.VALID


def test_number_of_rejections_is_a_live_parameter() -> None:
    jumped = change_where(session_with_ins_only(), of_topic(INS, 3.0), turn_attitude(0.0, 0.5, 0.0))
    assert run_adapter(adapter(ins__jump_samples=2), jumped).reasons(INS) == {"gate": 2}
    half = index_at(jumped, ENCODER, 2.0)
    changed = run_adapter(adapter(), jumped[:half]).adapter
    changed.set_parameters({"ins.jump_samples": 9})
    assert run_adapter(changed, jumped[half:]).reasons(INS) == {"gate": 9}


@pytest.mark.parametrize(("sigma_arcsec", "rejected"), [(1.0, 1), (100.0, 0)])
def test_live_noise_change_reaches_the_check(sigma_arcsec: float, rejected: int) -> None:
    arrivals = session_with_ins_only()
    faulty = replace_message(arrivals, index_at(arrivals, INS, 4.017), turn_attitude(0.0, 0.1, 0.0))
    half = index_at(faulty, ENCODER, 2.0)
    changed = run_adapter(adapter(), faulty[:half]).adapter
    changed.set_parameters({"ins.white_sigma_arcsec": sigma_arcsec})
    assert run_adapter(changed, faulty[half:]).reasons(INS).get("gate", 0) == rejected


@pytest.mark.parametrize("factor", [ZERO, -1.0, 2.0])
def test_invalid_rates_change_no_pointing(factor: float) -> None:
    true = run_adapter(adapter(), session_with_ins_only())
    run = run_adapter(adapter(), change_where(session_with_ins_only(), of_topic(INS), scale_rates(factor)))
    assert run.reasons(INS) == {}
    assert run.results() == true.results()
    assert is_within_covariance(run)


def test_rates_in_degrees_are_reported_and_the_ins_rejected() -> None:
    run = run_adapter(adapter(), change_where(session_with_ins_only(10.0), of_topic(INS), scale_rates(DEGREES)))
    assert run.reasons(INS).keys() == {"units"}
    assert "degrees instead of radians?" in run.innovations(Reason.UNITS)[0].reason_text
    detected_s = min(seconds(m) for m in run.innovations(Reason.UNITS))
    assert 5.0 < detected_s < 7.0
    assert {m.status for m in run.pointings if seconds(m) > detected_s + 0.1} == {Status.INVALID}
    assert is_within_covariance(run)


def test_stuck_ins_is_detected_by_its_own_rates() -> None:
    arrivals = session_with_ins_only(8.0)
    held = arrivals[index_at(arrivals, INS, 3.017)].message.orientation

    def freeze(message: Any) -> None:
        message.orientation = held

    run = run_adapter(adapter(), change_where(arrivals, of_topic(INS, 3.0, 5.0), freeze))
    assert run.reasons(INS).keys() <= {"stuck", "gate"}
    rejected_s = [seconds(m) for m in run.innovations(Reason.STUCK)]
    assert rejected_s
    assert max(rejected_s) < 5.0
    assert is_within_covariance(run)
    assert run.pointings[-1].status == Status.VALID

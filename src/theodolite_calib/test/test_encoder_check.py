"""Check of the encoders: at rest, stopped, stuck, in degrees, single wrong readings, slips; by motion and beacons."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.sample_track import VectorTrack
from ship_testing.adapter_runs import START_NS, Arrival, change_where, index_at, replace_message, without
from ship_testing.small_session import (
    BEACONS,
    ENCODER,
    Run,
    error_in_sigmas,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
    stamp_of,
)
from theodolite_calib.samples.encoder_check import EncoderCheck
from theodolite_calib.samples.samples import EncoderSample

PERIOD_NS = 10_000_000
FREE = 1e9
"""Maximum acceleration that limits no motion, rad/s²."""


def reading(number: int, azimuth: float, elevation: float = 0.5) -> EncoderSample:
    return EncoderSample(number * PERIOD_NS, np.array([azimuth, elevation]), ARCSEC)


def check_reading(encoder_check: EncoderCheck, sample: EncoderSample) -> Rejection | None:
    return encoder_check.check(sample, VectorTrack(PERIOD_NS)).rejection


def give_beacon_attitude(encoder_check: EncoderCheck, number: int, azimuth: float) -> None:
    encoder_check.record_beacon_attitude(number * PERIOD_NS, rotation_from_angles(azimuth, 0.5, 0.0), 3.0 * ARCSEC)


def stop_in_motion(rate: float = 0.02) -> tuple[EncoderCheck, int]:
    """Return a check after ten readings at ``rate``, rad/s, and one equal to the last; and the last number."""
    check = EncoderCheck(ARCSEC, FREE)
    for number in range(10):
        assert check_reading(check, reading(number, 1.0 + rate * number * 0.01)) is None
        assert not check.unconfirmed_reason
    check_reading(check, reading(10, 1.0 + rate * 0.09))
    return check, 10


def test_stopped_readings_are_unconfirmed_until_beacons_confirm() -> None:
    check, number = stop_in_motion()
    assert check.unconfirmed_reason
    check.confirm((number - 3) * PERIOD_NS)  # before the readings stopped
    assert check.unconfirmed_reason
    check.confirm((number + 1) * PERIOD_NS)
    assert not check.unconfirmed_reason


def test_encoder_jump_is_confirmed_by_beacons_at_two_times() -> None:
    """The first beacons are consistent with any inflated estimate, even if stuck readings hide a rotation of the
    axis."""
    check = EncoderCheck(ARCSEC, max_acceleration=1.0)
    for number in range(10):
        check_reading(check, reading(number, 1.0 + 2e-4 * number))
    jumped = next(n for n in range(10, 40) if check_reading(check, reading(n, 1.3 + 2e-4 * n)) is None)
    assert check.unconfirmed_reason
    check.confirm((jumped - 20) * PERIOD_NS)  # before the jump
    for _ in range(2):  # the same beacons twice are one time
        check.confirm((jumped + 1) * PERIOD_NS)
        assert check.unconfirmed_reason
    check.confirm((jumped + 2) * PERIOD_NS)
    assert not check.unconfirmed_reason


def test_slowly_stopping_readings_are_confirmed() -> None:
    check, _ = stop_in_motion(rate=4.0 * ARCSEC / 0.01)  # less than five sigmas a reading
    assert not check.unconfirmed_reason


def test_motion_across_the_wrap_is_no_jump() -> None:
    check = EncoderCheck(ARCSEC, FREE)
    for number, azimuth in enumerate([2 * np.pi - 1e-4, 2 * np.pi - 5e-5, 1e-9, 1e-9 + 1e-6]):
        assert check_reading(check, reading(number, azimuth)) is None
    assert not check.unconfirmed_reason


def test_a_mount_at_rest_is_never_stuck() -> None:
    check, number = stop_in_motion()
    for later in range(number + 1, number + 200):
        assert check_reading(check, reading(later, 1.0 + 0.02 * 0.09)) is None
        if later % 10 == 0:
            give_beacon_attitude(check, later, 1.0 + 0.02 * 0.09)


def test_beacons_before_the_stop_are_no_reference() -> None:
    check = EncoderCheck(ARCSEC, FREE)
    for number in range(10):
        check_reading(check, reading(number, 1.0 + 0.01 * number))
    # The beacon attitude of reading 5 is received only now; meanwhile the mount has come to rest.
    give_beacon_attitude(check, 5, 1.05)
    for number in range(10, 60):
        assert check_reading(check, reading(number, 1.09)) is None
        if number == 30:
            give_beacon_attitude(check, number, 1.09)


def test_stuck_detection_and_recovery() -> None:
    check, number = stop_in_motion()
    rejections = []
    for later in range(number + 1, number + 60):
        give_beacon_attitude(check, later, 1.0 + 0.001 * later)
        rejections.append(check_reading(check, reading(later, 1.0 + 0.02 * 0.09)))
    # Half a second is not checked: the last changed reading, the unchanged one after it, and forty-eight of these.
    assert [r is not None for r in rejections] == [False] * 48 + [True] * 11
    assert rejections[-1].reason is Reason.STUCK
    assert [check_reading(check, reading(number + 60 + k, 1.1 + 0.001 * k)) for k in range(25)] == [None] * 25


def test_angles_are_taken_modulo_a_turn() -> None:
    check = EncoderCheck(ARCSEC, FREE)
    # The mount counts on past a full turn, and its zero is set back by two turns at reading 50.
    turns = [6.2 + 0.01 * number - (4.0 * np.pi if number >= 50 else 0.0) for number in range(100)]
    rejections = [
        check_reading(check, reading(number, azimuth, 0.5 + 2.0 * np.pi)) for number, azimuth in enumerate(turns)
    ]
    assert rejections == [None] * 100
    assert check.unconfirmed_reason == ""
    # Plunged, the elevation goes up to three quarters of a turn.
    assert check_reading(EncoderCheck(ARCSEC, FREE), reading(0, 1.0, 4.7)) is None


def test_degrees_are_rejected_until_radians_persist() -> None:
    check = EncoderCheck(ARCSEC, FREE)
    assert check_reading(check, reading(0, 6.2, 0.5)) is None
    assert check_reading(check, reading(1, 355.0, 28.6)).reason is Reason.UNITS
    assert check_reading(check, reading(2, 6.2, 0.5)) is None
    for number in range(3, 23):
        assert check_reading(check, reading(number, 355.0, 28.6)).reason is Reason.UNITS
    # A reading of nine is below the limit of 3π rad and could be in radians.
    rejections = [check_reading(check, reading(30 + number, 355.0, 9.0)) for number in range(19)]
    assert all(rejection.reason is Reason.UNITS for rejection in rejections)
    assert check_reading(check, reading(60, 6.2, 0.5)) is None


# -- in a whole session -------------------------------------------------------------------------------------


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def replace_reading(azimuth_deg: float, elevation_deg: float = 0.0) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.azimuth = (message.azimuth + np.deg2rad(azimuth_deg)) % (2.0 * np.pi)
        message.elevation += np.deg2rad(elevation_deg)

    return change


def encoder_from(from_s: float, until_s: float = 1e9) -> Callable[[Arrival], bool]:
    return lambda a: a.topic == ENCODER and from_s <= (a.stamp_ns - START_NS) * 1e-9 < until_s


def is_within_covariance(run: Run) -> bool:
    claimed = [m for m in run.pointings if m.status in (Status.VALID, Status.COASTING)]
    return max(error_in_sigmas(message) for message in claimed) < 6.0


@pytest.mark.parametrize("off_deg", [1.0, 18.0, -170.0])
def test_one_wrong_reading_is_rejected_without_effect(off_deg: float) -> None:
    index = index_at(session(), ENCODER, 3.0)
    run = run_adapter(new_adapter(), replace_message(session(), index, replace_reading(off_deg, 0.5)))
    assert run.reasons(ENCODER) == {"gate": 1}
    assert "the mount can reach" in run.innovations(Reason.GATE)[0].reason_text
    assert run.results() == run_adapter(new_adapter(), without(session(), index)).results()


@pytest.mark.parametrize("off_deg", [0.3, 0.5])
def test_permanent_slip_inflates_the_zero_points_until_beacons_agree(off_deg: float) -> None:
    run = run_adapter(new_adapter(), change_where(session(10.0), encoder_from(3.0), replace_reading(off_deg, -0.3)))
    assert run.reasons(ENCODER) == {"gate": 5}
    after = [m for m in run.pointings if seconds(m) >= 3.0 and m.status != Status.INVALID]
    degraded = [m for m in after if m.status == Status.DEGRADED]
    assert degraded[0] is after[0]
    assert seconds(degraded[-1]) < 4.5
    assert error_in_sigmas(after[0]) < 3.0
    assert {m.status for m in after[len(degraded) :]} == {Status.VALID}
    assert is_within_covariance(run)
    assert run.reasons(BEACONS).keys() <= {"gap"}


def test_slip_without_beacons_stays_degraded() -> None:
    dark = [a for a in session(10.0) if a.topic != BEACONS or seconds(a.message) < 3.0]
    run = run_adapter(new_adapter(), change_where(dark, encoder_from(4.0), replace_reading(2.0)))
    after = [m for m in run.pointings if seconds(m) >= 4.0]
    assert {m.status for m in after} == {Status.DEGRADED}
    assert max(error_in_sigmas(m) for m in after) < 3.0


def test_readings_after_a_stuck_encoder_are_unconfirmed() -> None:
    held = session()[index_at(session(), ENCODER, 2.0)].message

    def freeze(message: Any) -> None:
        message.azimuth, message.elevation = held.azimuth, held.elevation

    frozen = change_where(session(10.0), encoder_from(2.0, 5.0), freeze)
    adapter = new_adapter(integrity__return_after_s=1.0)
    run = run_adapter(adapter, replace_message(frozen, index_at(frozen, ENCODER, 4.0), replace_reading(20.0)))
    assert is_within_covariance(run)
    (wrong,) = [m for m in run.pointings if seconds(m) == 4.0]
    assert wrong.status == Status.DEGRADED
    assert run.pointings[-1].status == Status.VALID


def test_live_changes_reach_the_encoder_check() -> None:
    """One reading has an error of 0.1°, which a mount of 100°/s² can reach within 50 ms and a mount of 10°/s²
    cannot."""
    arrivals = replace_message(session(), index_at(session(), ENCODER, 4.0), replace_reading(0.1))
    half = index_at(arrivals, ENCODER, 3.0)
    for changes, rejected in (
        ({}, 0),
        ({"encoder.max_acceleration_deg_per_s2": 10.0}, 1),
        ({"encoder.max_acceleration_deg_per_s2": 10.0, "encoder.sigma_arcsec": 100.0}, 0),
    ):
        adapter = run_adapter(new_adapter(), arrivals[:half]).adapter
        adapter.set_parameters(changes)
        assert run_adapter(adapter, arrivals[half:]).reasons(ENCODER).get("gate", 0) == rejected


def test_slip_of_degrees_is_never_valid() -> None:
    """Zero-point errors of this size are outside the linear range: beacons are rejected, and a reset is needed."""
    run = run_adapter(new_adapter(), change_where(session(10.0), encoder_from(3.0), replace_reading(5.0)))
    assert {m.status for m in run.pointings if seconds(m) >= 3.0} == {Status.DEGRADED}


def test_no_reading_is_rejected_without_slips() -> None:
    assert fault_free_run().reasons(ENCODER) == {}

"""Encoders that read wrong once, or have slipped: told by what a mount can be accelerated, and by the lights."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_estimation.outcome import Status
from ship_estimation.refusals import Reason
from ship_testing.adapter_runs import START_NS, Arrival, changed_where, index_at, replaced, without
from ship_testing.small_session import (
    BEACONS,
    ENCODER,
    Run,
    clean_run,
    drive,
    error_in_sigmas,
    new_adapter,
    session,
    stamp_of,
)


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def read_off(azimuth_deg: float, elevation_deg: float = 0.0) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.azimuth = (message.azimuth + np.deg2rad(azimuth_deg)) % (2.0 * np.pi)
        message.elevation += np.deg2rad(elevation_deg)

    return change


def encoder_from(from_s: float, until_s: float = 1e9) -> Callable[[Arrival], bool]:
    return lambda a: a.topic == ENCODER and from_s <= (a.stamp_ns - START_NS) * 1e-9 < until_s


def never_wrong(run: Run) -> bool:
    claimed = [m for m in run.pointings if m.status in (Status.VALID, Status.COASTING)]
    return max(error_in_sigmas(message) for message in claimed) < 6.0


@pytest.mark.parametrize("off_deg", [1.0, 18.0, -170.0])
def test_mend_10_one_wrong_reading_is_refused_and_changes_nothing(off_deg: float) -> None:
    index = index_at(session(), ENCODER, 3.0)
    run = drive(new_adapter(), replaced(session(), index, read_off(off_deg, 0.5)))
    assert run.reasons(ENCODER) == {"gate": 1}
    assert "which the mount can reach" in run.innovations(Reason.GATE)[0].reason_text
    assert run.results() == drive(new_adapter(), without(session(), index)).results()


@pytest.mark.parametrize("off_deg", [0.3, 0.5])
def test_mend_10_a_slip_for_good_opens_the_zero_points_until_lights_agree(off_deg: float) -> None:
    run = drive(new_adapter(), changed_where(session(10.0), encoder_from(3.0), read_off(off_deg, -0.3)))
    assert run.reasons(ENCODER) == {"gate": 5}
    after = [m for m in run.pointings if seconds(m) >= 3.0 and m.status != Status.INVALID]
    degraded = [m for m in after if m.status == Status.DEGRADED]
    assert degraded[0] is after[0]
    assert seconds(degraded[-1]) < 4.5
    assert error_in_sigmas(after[0]) < 3.0
    assert {m.status for m in after[len(degraded) :]} == {Status.VALID}
    assert never_wrong(run)
    assert run.reasons(BEACONS).keys() <= {"gap"}


def test_mend_10_a_slip_without_lights_stays_degraded() -> None:
    dark = [a for a in session(10.0) if a.topic != BEACONS or seconds(a.message) < 3.0]
    run = drive(new_adapter(), changed_where(dark, encoder_from(4.0), read_off(2.0)))
    after = [m for m in run.pointings if seconds(m) >= 4.0]
    assert {m.status for m in after} == {Status.DEGRADED}
    assert max(error_in_sigmas(m) for m in after) < 3.0


def test_mend_10_after_a_stuck_encoder_no_reading_is_trusted_until_lights_agree() -> None:
    held = session()[index_at(session(), ENCODER, 2.0)].message

    def freeze(message: Any) -> None:
        message.azimuth, message.elevation = held.azimuth, held.elevation

    frozen = changed_where(session(10.0), encoder_from(2.0, 5.0), freeze)
    run = drive(new_adapter(), replaced(frozen, index_at(frozen, ENCODER, 4.0), read_off(20.0)))
    assert never_wrong(run)
    (wrong,) = [m for m in run.pointings if seconds(m) == 4.0]
    assert wrong.status == Status.DEGRADED
    assert run.pointings[-1].status == Status.VALID


def test_mend_07_live_changes_reach_what_watches_the_encoders() -> None:
    """One reading is off by 0.1°, which a mount of 100°/s² can reach within 50 ms and one of 10°/s² cannot."""
    spoilt = replaced(session(), index_at(session(), ENCODER, 4.0), read_off(0.1))
    half = index_at(spoilt, ENCODER, 3.0)
    for changes, refused in (
        ({}, 0),
        ({"encoder.max_acceleration_deg_per_s2": 10.0}, 1),
        ({"encoder.max_acceleration_deg_per_s2": 10.0, "encoder.sigma_arcsec": 100.0}, 0),
    ):
        adapter = drive(new_adapter(), spoilt[:half]).adapter
        adapter.set_parameters(changes)
        assert drive(adapter, spoilt[half:]).reasons(ENCODER).get("gate", 0) == refused


def test_mend_10_a_slip_of_degrees_is_never_valid() -> None:
    """What lights say of zero points so far off is not linear, and they do not fit any more: a reset is needed."""
    run = drive(new_adapter(), changed_where(session(10.0), encoder_from(3.0), read_off(5.0)))
    assert {m.status for m in run.pointings if seconds(m) >= 3.0} == {Status.DEGRADED}


def test_without_slips_no_reading_is_refused() -> None:
    assert clean_run().reasons(ENCODER) == {}

"""Mode and status of the pointing: a coasting ship, the INS alone."""

import numpy as np

from ship_estimation.time_order.outcome import Status
from ship_msgs.msg import OpticalAxisPointing, ShipAttitude
from ship_testing.adapter_runs import change_where
from ship_testing.small_session import (
    BEACONS,
    SHIP,
    error_in_sigmas,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
    session_with_ins_only,
)
from theodolite_calib.samples.samples import Mode

# The time offset of 5 ms alone is 36" at 2°/s.
INS = {"ship__source": "ins/imu", "ins__time_offset_sigma_s": 0.0}


def test_modes_and_statuses_are_those_of_the_messages() -> None:
    for mode in Mode:
        assert getattr(OpticalAxisPointing, mode.name) == mode
    for status in Status:
        assert getattr(OpticalAxisPointing, status.name) == getattr(ShipAttitude, status.name) == status


def test_a_ship_that_coasts_or_is_degraded() -> None:
    def status(value: int):
        return lambda message: setattr(message, "status", value)

    coasting = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic == SHIP, status(1)))
    assert {m.status for m in coasting.pointings[20:]} == {Status.VALID}  # the lights determine the pointing
    degraded = run_adapter(new_adapter(), change_where(session(), lambda a: a.topic == SHIP, status(2)))
    assert {m.status for m in degraded.pointings[20:]} == {Status.DEGRADED}
    assert degraded.state() == coasting.state() == fault_free_run().state()
    # A degraded attitude does not show that its source is present.
    assert "ship_attitude" in coasting.adapter.last_usable_ns
    assert "ship_attitude" not in degraded.adapter.last_usable_ns


def test_without_a_fused_attitude_the_ins_serves_with_its_configured_errors() -> None:
    run = run_adapter(new_adapter(**INS), session_with_ins_only())
    assert run.pointings[-1].status == Status.VALID
    assert run.health("ins/imu").accepted == 120
    assert max(error_in_sigmas(m) for m in run.pointings[20:]) < 4.0
    dark = tuple(a for a in session_with_ins_only() if a.topic != BEACONS)
    alone = run_adapter(new_adapter(**INS), dark).pointings[-1]
    fused = run_adapter(new_adapter(), tuple(a for a in session() if a.topic != BEACONS)).pointings[-1]
    # The INS alone adds 72" in heading and 10" in each tilt.
    added = np.trace(np.reshape(alone.rotation_covariance, (3, 3)) - np.reshape(fused.rotation_covariance, (3, 3)))
    arcsec = np.pi / (180.0 * 3600.0)
    assert 70.0 < np.sqrt(added) / arcsec < 78.0


def test_telescope_attitude_is_published_with_beacons() -> None:
    pointing = fault_free_run().pointings[-1]
    # The telescope is parallel to the main axis here.
    assert abs(pointing.telescope_azimuth - pointing.azimuth) < 1e-9
    assert abs(pointing.telescope_elevation - pointing.elevation) < 1e-9
    assert pointing.header.frame_id == "theodolite_main"
    assert pointing.light_count == 2

"""Status of the attitude while inputs stop and return and clocks jump."""

import functools
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from scipy import stats
from scipy.spatial.transform import Rotation

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.message_factory import RosidlFactory
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import FRD_FROM_DEVICE, NED_FROM_HORIZON, angles_from_rotation
from ship_geometry.rotations import ARCSEC, exp_rotation, log_rotation, wrap_pi
from ship_msgs.msg import Innovation, ShipAttitude
from ship_stars.attitude_samples import Horizon
from ship_testing.adapter_runs import SECOND_NS, START_NS, change_where, stamp_of
from ship_testing.small_voyage import (
    FORE,
    INS,
    STARBOARD,
    Run,
    assert_consistent,
    fault_free_run,
    new_adapter,
    quaternion_message,
    remove_interval,
    rotation_of,
    run_adapter,
    since_start_s,
    voyage,
)


def outputs(run: Run, from_s: float = -1.0, until_s: float = 1e6) -> list[Any]:
    """Return the attitudes with stamps in [from_s, until_s) after the start."""
    return [m for m in run.messages("ship/attitude") if from_s <= since_start_s(m) < until_s]


def assert_strictly_increasing(run: Run) -> None:
    """Assert that the stamps of INVALID attitudes increase, and separately the stamps of all other attitudes."""
    for claimed in (True, False):
        stamps = [stamp_of(m) for m in run.messages("ship/attitude") if (m.status != Status.INVALID) == claimed]
        assert all(earlier < later for earlier, later in pairwise(stamps))


@pytest.mark.parametrize(
    ("enum", "message", "others"),
    [(Reason, Innovation, ()), (Status, ShipAttitude, Horizon), (Horizon, ShipAttitude, Status)],
)
def test_the_numbers_are_those_of_the_messages(enum: Any, message: Any, others: Any) -> None:
    constants = {name: getattr(message, name) for name in dir(message) if name.isupper()}
    del constants["SLOT_TYPES"]
    for other in others:
        del constants[other.name]
    assert {member.name: member.value for member in enum} == constants


def test_before_the_first_star_the_ins_passes_through() -> None:
    first = outputs(fault_free_run(), until_s=0.013)
    ins = next(a.message for a in voyage() if a.topic == INS)
    assert len(first) == 1
    assert (first[0].status, first[0].horizon) == (Status.DEGRADED, Horizon.GRAVITY)
    assert first[0].sources == ["ins"]
    assert np.isnan(first[0].star_age_s)
    turn = log_rotation(rotation_of(ins).T @ rotation_of(first[0]))
    assert np.allclose(turn, 0.0, atol=1e-15)
    assert_consistent(first[0])
    early = fault_free_run().diagnostics("attitude", START_NS, START_NS + SECOND_NS)
    assert early[0] == (1, "DEGRADED: INS alone, no star yet")


def test_with_stars_the_attitude_is_valid_and_right() -> None:
    run = fault_free_run()
    assert_strictly_increasing(run)
    assert len(outputs(run)) == sum(a.topic == INS for a in voyage())
    for message in outputs(run, from_s=0.5):
        assert (message.status, message.horizon) == (Status.VALID, Horizon.GEODETIC)
        assert message.sources == ["ins", "star.fore", "star.starboard"]
        assert 0.0 <= message.star_age_s < 0.4
        assert_consistent(message)
    last = outputs(run)[-1]
    sigma_arcsec = np.sqrt(np.reshape(last.covariance, (3, 3)).diagonal()) / ARCSEC
    # Each sensor was measured 24 times: sigma is a few arcseconds in place of 72" in heading.
    assert np.all(sigma_arcsec < 3.0)
    assert run.diagnostics("attitude", START_NS + 3 * SECOND_NS, run.now_ns)[-1] == (0, "VALID: INS and stars")


def test_angles_quaternion_and_imu_are_one_attitude() -> None:
    run = fault_free_run()
    imus = {stamp_of(m): m for m in run.messages("ship/imu")}
    for message in outputs(run):
        angles = angles_from_rotation(rotation_of(message))
        assert np.allclose(wrap_pi(angles - [message.heading, message.pitch, message.roll]), 0.0, atol=1e-14)
        imu = imus[stamp_of(message)]
        assert imu.orientation == message.orientation
        assert np.array_equal(imu.orientation_covariance, message.rotation_covariance)


@pytest.mark.parametrize("sigma_arcsec_per_s", [0.0, 20.0])
def test_the_imu_states_the_configured_noise_of_the_rates(sigma_arcsec_per_s: float) -> None:
    """A sigma of zero is not configured: the covariance is then zero, which means unknown in Imu.msg."""
    run = run_adapter(new_adapter(ins__rate_sigma_arcsec_per_s=sigma_arcsec_per_s), voyage())
    stated = np.array([m.angular_velocity_covariance for m in run.messages("ship/imu")])
    assert len(stated) == len(outputs(run))
    expected = np.diag(np.full(3, (sigma_arcsec_per_s / 206_264.806) ** 2)).ravel()
    np.testing.assert_allclose(stated, np.broadcast_to(expected, stated.shape), rtol=1e-8, atol=0.0)


def test_a_changed_noise_of_the_rates_is_stated_from_then_on() -> None:
    adapter = new_adapter(ins__rate_sigma_arcsec_per_s=20.0)
    half = len(voyage()) // 2
    before = run_adapter(adapter, voyage()[:half])
    adapter.set_parameters({"ins.rate_sigma_arcsec_per_s": 10.0})
    after = run_adapter(adapter, voyage()[half:])
    first, last = (run.messages("ship/imu")[-1].angular_velocity_covariance[0] for run in (before, after))
    assert first == pytest.approx((20.0 * ARCSEC) ** 2, rel=1e-12)
    assert last == pytest.approx((10.0 * ARCSEC) ** 2, rel=1e-12)


def test_the_stated_noise_of_the_rates_is_that_of_their_errors() -> None:
    """Rates with the configured noise are compared with rates without noise; interpolation averages the noise."""
    sigma, rng = 20.0 * ARCSEC, np.random.default_rng(36)

    def noisy(message: Any) -> None:
        for axis, noise in zip("xyz", sigma * rng.standard_normal(3), strict=True):
            setattr(message.angular_velocity, axis, getattr(message.angular_velocity, axis) + float(noise))

    fixed = {"ins__rate_sigma_arcsec_per_s": 20.0, "ins__time_offset_sigma_s": 0.0}
    clean, run = (
        run_adapter(new_adapter(**fixed), arrivals)
        for arrivals in (voyage(), change_where(voyage(), lambda a: a.topic == INS, noisy))
    )
    rates, true_rates = (
        np.array([[getattr(m.angular_velocity, axis) for axis in "xyz"] for m in one.messages("ship/imu")])
        for one in (run, clean)
    )
    variances = np.array([m.angular_velocity_covariance[0] for m in run.messages("ship/imu")])
    chi2 = np.sum((rates - true_rates) ** 2 / variances[:, None])
    low, high = stats.chi2.ppf([0.0005, 0.9995], rates.size)
    assert low < chi2 < high


def test_the_error_budget_is_the_covariance() -> None:
    run = fault_free_run()
    attitudes = {stamp_of(m): m for m in outputs(run)}
    budgets = run.messages("ship/error_budget")
    assert len(budgets) >= 4
    for budget in budgets:
        parts = np.reshape(budget.covariances, (len(budget.sources), 9))
        total = attitudes[stamp_of(budget)].rotation_covariance
        scale = np.max(np.abs(total))
        assert np.allclose(parts.sum(axis=0), total, rtol=1e-9, atol=1e-9 * scale)
        assert np.allclose(budget.total, total, rtol=1e-9, atol=1e-9 * scale)
        for part in parts.reshape(-1, 3, 3):
            assert np.linalg.eigvalsh(part)[0] > -1e-9 * scale


def test_without_stars_the_ins_coasts_with_growing_covariance() -> None:
    run = run_adapter(new_adapter(), remove_interval(voyage(9.0), 3.0, 9.0, FORE, STARBOARD))
    coasting = outputs(run, from_s=5.0)
    assert len(coasting) == 100
    assert {(m.status, m.horizon) for m in coasting} == {(Status.COASTING, Horizon.GEODETIC)}
    assert {m.status for m in outputs(run, 3.0, 4.8)} == {Status.VALID}
    assert coasting[-1].sources == ["ins"]
    assert coasting[-1].star_age_s == pytest.approx(8.96 - 2.877, abs=1e-6)
    traces = [np.reshape(m.rotation_covariance, (3, 3)).trace() for m in outputs(run, from_s=3.0)]
    assert traces[-1] > traces[-25] > traces[0]
    for message in coasting:
        assert_consistent(message)
    level, text = run.diagnostics("attitude", START_NS + 6 * SECOND_NS, run.now_ns)[-1]
    assert (level, text.split(":")[0]) == (1, "COASTING")


@functools.cache
def run_without_ins_for_four_seconds() -> Run:
    return run_adapter(new_adapter(), remove_interval(voyage(10.0), 3.0, 7.0, INS))


def test_an_ins_timeout_is_reported_after_three_periods() -> None:
    run = run_without_ins_for_four_seconds()
    last_ns = START_NS + 2_960_000_000
    reports = run.diagnostics(f"input {INS}", last_ns + 3 * 40_000_000, last_ns + 1_100_000_000)
    assert any(level >= 1 and "no data" in text for level, text in reports)
    assert any(
        level == 2 and "no data" in text
        for level, text in run.diagnostics(f"input {INS}", last_ns + SECOND_NS, last_ns + 2_100_000_000)
    )


def test_after_an_ins_timeout_attitudes_come_from_stars_at_their_rate() -> None:
    run = run_without_ins_for_four_seconds()
    gone_ns, back_ns = (START_NS + round(s * SECOND_NS) for s in (2.965 + 1.0, 7.005))
    published = [(ns, m) for ns, topic, m in run.published if topic == "ship/attitude"]
    assert [m for ns, m in published if (ns - START_NS) * 1e-9 > 2.97 and ns <= gone_ns] == []  # never a frozen value
    alone = [m for ns, m in published if gone_ns < ns < back_ns and m.status != Status.INVALID]
    arrived = [a for a in voyage(10.0) if a.topic in (FORE, STARBOARD) and gone_ns < a.receive_ns < back_ns]
    assert [stamp_of(m) for m in alone] == [a.stamp_ns for a in arrived]
    for message in alone:
        assert (message.status, message.horizon) == (Status.DEGRADED, Horizon.GEODETIC)
        assert len(message.sources) == 1
        assert message.sources[0].startswith("star.")
        assert np.isnan(message.angular_velocity.x)
        assert_consistent(message)
    level, text = run.diagnostics("attitude", START_NS + 5 * SECOND_NS, START_NS + 7 * SECOND_NS)[-1]
    assert (level, text) == (1, "DEGRADED: no INS data, stars alone")


def test_when_the_ins_comes_back_all_is_as_before() -> None:
    run = run_without_ins_for_four_seconds()
    back = outputs(run, from_s=7.5)
    assert {m.status for m in back} == {Status.VALID}
    assert back[-1].sources == ["ins", "star.fore", "star.starboard"]
    for message in outputs(run, from_s=7.0):
        assert_consistent(message)
    assert_strictly_increasing(run)
    # Measurements during the timeout could not be evaluated: all are rejected with a reason, none is pending.
    in_gap = [m for m in run.messages("ship/innovation") if 3.0 <= since_start_s(m) < 6.9]
    assert {m.reason for m in in_gap} == {Reason.GAP}
    assert run.health(FORE).received == run.health(FORE).accepted + run.health(FORE).rejected
    assert run.reasons(FORE) == {"gap": 20}


def test_without_ins_and_stars_the_attitude_is_invalid_until_they_return() -> None:
    run = run_adapter(new_adapter(), remove_interval(voyage(10.0), 3.0, 8.0, INS, FORE, STARBOARD))
    invalid = outputs(run, 2.961, 8.0)
    assert {m.status for m in invalid} == {Status.INVALID}
    assert 1.0 < since_start_s(invalid[0]) - 2.965 <= 1.1  # the last INS sample came at 2.965 s
    intervals = np.diff([since_start_s(m) for m in invalid])
    assert np.all(intervals <= 1.1)
    for message in invalid:
        assert_no_attitude(message)
    imus = [m for m in run.messages("ship/imu") if 2.961 <= since_start_s(m) < 8.0]
    assert imus == []
    level, text = run.diagnostics("attitude", START_NS + 5 * SECOND_NS, START_NS + 8 * SECOND_NS)[-1]
    assert (level, text.split(":")[0]) == (2, "INVALID")
    assert {m.status for m in outputs(run, from_s=8.5)} == {Status.VALID}
    assert_consistent(outputs(run)[-1])
    assert_strictly_increasing(run)


def assert_no_attitude(message: Any) -> None:
    q, rate = message.orientation, message.angular_velocity
    numbers = [message.heading, message.pitch, message.roll, q.x, q.y, q.z, q.w, rate.x, rate.y, rate.z]
    assert np.all(np.isnan([*numbers, *message.covariance, *message.rotation_covariance]))
    assert list(message.sources) == []


def test_without_ins_a_star_timeout_is_reported_within_a_second() -> None:
    arrivals = remove_interval(remove_interval(voyage(8.0), 3.0, 8.0, INS), 5.0, 8.0, FORE, STARBOARD)
    run = run_adapter(new_adapter(), arrivals, until_ns=START_NS + 8 * SECOND_NS)
    propagated = [m for m in outputs(run) if m.status == Status.DEGRADED]
    first_invalid = next(m for m in outputs(run) if m.status == Status.INVALID)
    assert since_start_s(propagated[-1]) == pytest.approx(4.877)
    assert 1.0 < since_start_s(first_invalid) - 4.997 <= 1.1  # the last star arrives at 4.997 s
    assert_strictly_increasing(run)


def test_stars_alone_from_the_start_give_the_attitude() -> None:
    run = run_adapter(new_adapter(), remove_interval(voyage(), 0.0, 5.0, INS))
    published = [m for m in outputs(run) if m.status != Status.INVALID]
    assert {m.status for m in published} == {Status.DEGRADED}
    assert len(published) == sum(a.topic != INS for a in voyage())
    for message in published:
        assert_consistent(message)


def test_without_any_input_invalid_is_published() -> None:
    run = Run(new_adapter())
    for now_ns in range(START_NS, START_NS + 6 * SECOND_NS, SECOND_NS // 10):
        run.published += [(now_ns, *item) for item in run.adapter.tick(now_ns)]
    assert {m.status for m in outputs(run)} == {Status.INVALID}
    assert run.diagnostics(f"input {INS}", START_NS, START_NS + 6 * SECOND_NS)[-1][0] == 2


def test_without_any_sensor_the_ins_passes_through_and_the_diagnostics_report_it() -> None:
    run = run_adapter(
        ShipAttitudeAdapter(ShipAttitudeConfig(), RosidlFactory()), [a for a in voyage() if a.topic == INS]
    )
    assert len(outputs(run)) > 100
    assert {(m.status, m.horizon) for m in outputs(run)} == {(Status.DEGRADED, Horizon.GRAVITY)}
    for message in outputs(run)[::20]:
        assert_consistent(message)
    lacking = "no star_sensors, no references and no ship_baseline are configured"
    lacking += ": the attitude is that of the INS alone, DEGRADED, horizon GRAVITY"
    assert run.adapter.start_warnings == (lacking,)
    level, text = run.diagnostics("attitude", START_NS, START_NS + 5 * SECOND_NS)[-1]
    assert (level, text) == (1, f"DEGRADED: {lacking}")


# -- clocks -------------------------------------------------------------------------------------------------


def test_a_clock_that_jumps_back_resets_once_and_cleanly() -> None:
    adapter = run_adapter(new_adapter(), voyage()).adapter
    assert adapter.clock_jumped_back(START_NS) == []
    again = run_adapter(adapter, voyage())
    assert again.results() == fault_free_run().results()
    assert again.state() == fault_free_run().state()
    assert again.health(INS).received == 2 * fault_free_run().health(INS).received  # counts stay
    (values,) = {
        tuple((v.key, v.value) for v in status.values if v.key == "clock jumps back")
        for report in again.messages("/diagnostics")
        for status in report.status
        if status.name == "ship_attitude: attitude"
    }
    assert values == (("clock jumps back", "1"),)


def test_a_reset_restarts_the_filter_without_earlier_stamps() -> None:
    adapter = run_adapter(new_adapter(), voyage()).adapter
    assert adapter.service("reset", START_NS + 5 * SECOND_NS).success
    assert adapter.core.state.time_ns is None
    again = run_adapter(adapter, voyage(8.0)[len(voyage()) :])
    assert since_start_s(outputs(again)[0]) >= 5.0
    assert outputs(again)[0].status == Status.DEGRADED
    assert outputs(again)[-1].status == Status.VALID


# -- conflicts ----------------------------------------------------------------------------------------------


def convert_to_ned_frd(message: Any) -> None:
    """Convert a message to that of a driver configured for NED <- FRD, whose yaw is the heading itself."""
    rotation_nd = rotation_of(message)
    x, y, z, w = Rotation.from_matrix(NED_FROM_HORIZON @ rotation_nd @ FRD_FROM_DEVICE.T).as_quat().tolist()
    message.orientation = Quaternion(x=x, y=y, z=z, w=w)
    rate = message.angular_velocity
    rate.y, rate.z = -rate.y, -rate.z


@pytest.mark.parametrize("heading_deg", [1.0, 80.0, 91.0, 136.0, 181.0, 200.0, 314.0])
def test_heading_given_as_yaw_is_a_conflict_with_a_hint(heading_deg: float) -> None:
    """ENU yaw = 90° - heading; a driver that sends the heading itself is detected at any heading."""
    arrivals = change_where(voyage(4.0, heading_deg), lambda a: a.topic == INS, convert_to_ned_frd)
    run = run_adapter(new_adapter(), arrivals)
    conflicts = run.innovations(Reason.ATTITUDE_CONFLICT)
    assert {m.source for m in conflicts} == {"star.fore", "star.starboard"}
    assert all("yaw (90° - heading): check ins.convention" in m.reason_text for m in conflicts)
    assert run.health(FORE).accepted == 0
    # Ten rejections of a sensor at 5 Hz take two seconds.
    raised_ns = stamp_of(conflicts[0]) + 120_000_000
    assert since_start_s(conflicts[0]) == pytest.approx(1.813)
    reports = run.diagnostics("conflict star.fore", raised_ns, raised_ns + 1_100_000_000)
    assert any(level == 2 and "ins.convention" in text for level, text in reports)


def test_the_same_data_with_the_right_convention_are_the_same_attitude() -> None:
    run = run_adapter(
        new_adapter(ins__convention="ned_frd"), change_where(voyage(), lambda a: a.topic == INS, convert_to_ned_frd)
    )
    for one, other in zip(outputs(run), outputs(fault_free_run()), strict=True):
        assert np.allclose(rotation_of(one), rotation_of(other), atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"star_sensors__fore__azimuth_deg": 90.0}, "about 90° in heading"),
        ({"star_sensors__fore__azimuth_deg": 180.0}, "about 180° in heading"),
        ({"star_sensors__fore__azimuth_deg": 30.0}, "disagree"),
    ],
)
def test_a_sensor_at_another_azimuth_is_the_only_one_in_conflict(changes: dict[str, Any], text: str) -> None:
    run = run_adapter(new_adapter(**changes), voyage())
    conflicts = run.innovations(Reason.ATTITUDE_CONFLICT)
    assert {m.source for m in conflicts} == {"star.fore"}
    assert all(text in m.reason_text for m in conflicts)
    assert ("in heading" in conflicts[0].reason_text) == ("heading" in text)
    # The other sensor determines the attitude, as if this one did not exist.
    assert outputs(run)[-1].sources == ["ins", "star.starboard"]
    assert_consistent(outputs(run)[-1])


def test_a_sensor_against_the_ins_and_another_sensor_is_named_in_the_diagnostics() -> None:
    run = run_adapter(new_adapter(star_sensors__fore__azimuth_deg=0.5), voyage())
    last_ns = run.now_ns
    ((_, text),) = run.diagnostics("conflict star.fore", last_ns - SECOND_NS, last_ns)[-1:]
    assert text.endswith("; only star.fore differs, star.starboard agrees with the INS")
    assert "yaw" not in text


def test_an_ins_against_all_sensors_is_named_in_the_diagnostics() -> None:
    run = run_adapter(new_adapter(), change_where(voyage(), lambda a: a.topic == INS, add_heading_error))
    for source in ("star.fore", "star.starboard"):
        _, text = run.diagnostics(f"conflict {source}", run.now_ns - SECOND_NS, run.now_ns)[-1]
        assert "only the INS differs, star.fore, star.starboard disagree with the INS equally" in text


@pytest.mark.parametrize("heading_deg", [45.0, 225.0, 44.0])
def test_half_a_degree_near_45_is_not_called_yaw(heading_deg: float) -> None:
    run = run_adapter(
        new_adapter(), change_where(voyage(4.0, heading_deg), lambda a: a.topic == INS, add_heading_error)
    )
    conflicts = run.innovations(Reason.ATTITUDE_CONFLICT)
    assert conflicts
    assert not any("yaw" in m.reason_text for m in conflicts)


def add_heading_error(message: Any) -> None:
    """Add 0.5° to the heading, 25 times the configured INS sigma."""
    message.orientation = quaternion_message(exp_rotation(np.array([0.0, np.deg2rad(0.5), 0.0])) @ rotation_of(message))


def test_a_conflict_does_not_change_the_estimate_unless_configured() -> None:
    arrivals = change_where(voyage(), lambda a: a.topic == INS, add_heading_error)
    run = run_adapter(new_adapter(), arrivals)
    assert run.health(FORE).accepted == 0
    assert {m.status for m in outputs(run)} == {Status.DEGRADED}
    assert run.diagnostics("conflict star.fore", run.now_ns - SECOND_NS, run.now_ns)[-1][0] == 2


def test_with_reopen_after_the_covariance_is_inflated_and_stars_are_accepted() -> None:
    arrivals = change_where(voyage(8.0), lambda a: a.topic == INS, add_heading_error)
    run = run_adapter(new_adapter(gate__reopen_after=10), arrivals)
    inflations = [m for m in run.messages("ship/innovation") if "covariance inflated" in m.reason_text]
    assert 1 <= len(inflations) <= 4
    assert outputs(run)[-1].status == Status.VALID
    assert_consistent(outputs(run)[-1])
    assert run.diagnostics("conflict star.fore", run.now_ns - SECOND_NS, run.now_ns) == []  # and the conflict ends


def test_a_star_in_conflict_gives_no_attitude_after_an_ins_timeout() -> None:
    """Sensor fore is mounted at another azimuth than configured; after an INS timeout only starboard is used."""
    run = run_adapter(new_adapter(star_sensors__fore__azimuth_deg=30.0), remove_interval(voyage(6.0), 3.0, 6.0, INS))
    alone = outputs(run, from_s=3.96)
    assert {tuple(m.sources) for m in alone} == {("star.starboard",)}
    both_gone = remove_interval(remove_interval(voyage(6.0), 3.0, 6.0, INS), 3.0, 6.0, STARBOARD)
    run = run_adapter(new_adapter(star_sensors__fore__azimuth_deg=30.0), both_gone)
    assert {m.status for m in outputs(run, from_s=2.961)} == {Status.INVALID}

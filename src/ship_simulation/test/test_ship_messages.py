"""Messages of a run: axes, covariances, units, order."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import ns_from_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import ENU_FROM_HORIZON, angles_from_rotation, rotation_from_angles, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import AngleMotion
from ship_simulation.scenario.scenario import Reference, StarSensor
from ship_simulation.scenario.scenario_file import load_scenario

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"
FORE = "star/fore/horizon_attitude"


def short_run(duration_s=3.0, **changes):
    scenario = load_scenario(SCENARIOS / "paper.yaml")
    changes = {"ins": dataclasses.replace(scenario.ins, rate_hz=20.0), **changes}
    return simulate(dataclasses.replace(scenario, duration_s=duration_s, **changes), seed=1)


def entries_of(run, topic):
    return [(message, log) for name, message, log in generate_messages([run], RosbagsFactory()) if name == topic]


def quaternion(message):
    q = message.orientation
    return np.array([q.x, q.y, q.z, q.w])


def vector(value):
    return np.array([value.x, value.y, value.z])


def test_entries_come_in_order_of_log_time_with_every_topic():
    run = short_run(references={"gyro": Reference()})
    entries = list(generate_messages([run], RosbagsFactory()))
    logs = [log for _, _, log in entries]
    assert logs == sorted(logs)
    counts = {topic: sum(name == topic for name, _, _ in entries) for topic, _, _ in entries}
    assert counts == {
        "truth/attitude": 31,
        "truth/alignment": 4,
        "ins/imu": 61,
        FORE: 16,
        "star/starboard/horizon_attitude": 16,
        "reference/gyro/imu": 4,
        "gnss/fix": 4,
        "met/pressure": 2,
        "met/temperature": 2,
        "met/humidity": 2,
    }


def test_imu_uses_enu_and_forward_left_up():
    run = short_run(duration_s=1.0)
    message, log = entries_of(run, "ins/imu")[7]
    assert ns_from_stamp(message.header.stamp) == run.ins.time_ns[7]
    assert log == run.ins.log_time_ns[7]
    assert message.header.frame_id == "ins"
    # By hand, without ros_axes: ENU yaw is 90° - heading, ROS pitch is positive bow down, ROS roll starboard down.
    heading, pitch, roll = angles_from_rotation(run.ins.rotation_nd[7])
    yaw = np.pi / 2.0 - heading
    half = 0.5 * np.array([yaw, -pitch, roll])
    (cy, cp, cr), (sy, sp, sr) = np.cos(half), np.sin(half)
    expected = [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
    np.testing.assert_allclose(quaternion(message), expected, rtol=0.0, atol=1e-12)
    bow, up, starboard = run.ins.rate_d[7]
    np.testing.assert_allclose(vector(message.angular_velocity), [bow, -starboard, up], rtol=0.0, atol=1e-15)
    variance = np.array([10.0**2 + 1.0, 10.0**2 + 1.0, 72.0**2 + 1.0]) * ARCSEC**2
    np.testing.assert_allclose(message.orientation_covariance, np.diag(variance).ravel(), rtol=1e-12)
    assert not message.angular_velocity_covariance.any()
    assert message.linear_acceleration_covariance[0] == -1.0


def test_star_message_carries_angles_and_both_covariances():
    sensor = StarSensor(azimuth_deg=120.0, elevation_deg=50.0, roll_deg=20.0, common_sigma_arcsec=2.0, star_count=9)
    run = short_run(duration_s=1.0, star_sensors={"fore": sensor})
    message, log = entries_of(run, FORE)[3]
    rotation_nv = run.stars["fore"].rotation_nv[3]
    assert log - ns_from_stamp(message.header.stamp) == SECOND_NS // 10
    assert (message.sensor_id, message.header.frame_id) == ("fore", "star_fore")
    assert (message.star_count, message.rejected_count, message.status) == (9, 0, message.VALID)
    rebuilt = rotation_from_angles(message.azimuth, message.elevation, message.roll)
    np.testing.assert_allclose(rebuilt, rotation_nv, rtol=0.0, atol=1e-14)
    noise_enu = message.noise_covariance.reshape(3, 3)
    total_enu = message.rotation_covariance.reshape(3, 3)
    axes_enu = ENU_FROM_HORIZON @ rotation_nv
    expected = np.diag([100.0**2, 3.0**2, 3.0**2]) * ARCSEC**2
    np.testing.assert_allclose(axes_enu.T @ noise_enu @ axes_enu, expected, rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(total_enu - noise_enu, (2.0 * ARCSEC) ** 2 * np.eye(3), rtol=0.0, atol=1e-18)
    # The covariance of the angles by numerical differentiation: angles of attitudes turned by small vectors.
    step = 1e-6
    columns = [
        angles_from_rotation(exp_rotation(step * axis) @ rotation_nv)
        - angles_from_rotation(exp_rotation(-step * axis) @ rotation_nv)
        for axis in np.eye(3)
    ]
    jacobian = np.stack(columns, axis=1) / (2.0 * step)
    total_n = ENU_FROM_HORIZON.T @ total_enu @ ENU_FROM_HORIZON
    covariance = message.covariance.reshape(3, 3)
    np.testing.assert_allclose(covariance, jacobian @ total_n @ jacobian.T, rtol=0.0, atol=1e-6 * covariance.max())


def test_star_message_at_the_zenith_has_status_angles_singular():
    scenario = load_scenario(SCENARIOS / "paper.yaml")
    still = dataclasses.replace(scenario.carrier, pitch=AngleMotion(), roll=AngleMotion())
    zenith = StarSensor(azimuth_deg=0.0, elevation_deg=90.0)
    message, _ = entries_of(short_run(duration_s=1.0, carrier=still, star_sensors={"fore": zenith}), FORE)[0]
    assert message.status == message.ANGLES_SINGULAR
    assert np.isnan(message.covariance).all()
    assert np.isfinite(message.rotation_covariance).all()


def test_truth_messages_contain_the_attitude_and_every_state():
    reference = Reference(heading_deg=-0.8, installation_sigma_arcsec=0.0, time_offset_s=0.1, time_offset_sigma_s=0.0)
    run = short_run(duration_s=2.0, references={"s330": reference})
    attitude, log = entries_of(run, "truth/attitude")[5]
    stamp_ns = ns_from_stamp(attitude.header.stamp)
    assert log == stamp_ns == run.ins.time_ns[run.truth.ins_index[5]]
    expected = angles_from_rotation(run.truth.rotation_nd[5])
    # Single attitudes and arrays use different routines, whose last bits may differ.
    np.testing.assert_allclose([attitude.heading, attitude.pitch, attitude.roll], expected, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion(attitude)), run.truth.rotation_nd[5], rtol=0.0, atol=1e-14
    )
    alignment, _ = entries_of(run, "truth/alignment")[1]
    values = dict(zip(alignment.names, alignment.values, strict=True))
    sample = int(np.flatnonzero(run.ins.time_ns == ns_from_stamp(alignment.header.stamp))[0])
    errors = [values["ins.north"], values["ins.up"], values["ins.east"]]
    np.testing.assert_array_equal(errors, run.truth.ins.attitude_error_n[sample])
    assert values["ins.time_offset"] == run.truth.ins.time_offset_s
    angles = [values["star.starboard.azimuth"], values["star.starboard.elevation"], values["star.starboard.roll"]]
    np.testing.assert_allclose(
        rotation_from_angles(*angles), run.truth.stars["starboard"].rotation_dv, rtol=0.0, atol=1e-15
    )
    assert values["reference.s330.heading"] == pytest.approx(np.deg2rad(-0.8), abs=1e-12)
    assert values["reference.s330.time_offset"] == 0.1
    units = dict(zip(alignment.names, alignment.units, strict=True))
    assert {name for name, unit in units.items() if unit == "s"} == {n for n in units if n.endswith("time_offset")}


def test_position_and_weather_are_in_the_units_of_ros():
    run = short_run(duration_s=4.0)
    fix, _ = entries_of(run, "gnss/fix")[0]
    # Two metres are 1.8e-5 degrees of latitude.
    assert fix.latitude == pytest.approx(31.945213, abs=1e-4)
    assert fix.longitude == pytest.approx(120.293086, abs=1e-4)
    assert fix.position_covariance[0] == 4.0
    assert entries_of(run, "met/pressure")[0][0].fluid_pressure == pytest.approx(100_830.0)
    assert entries_of(run, "met/temperature")[0][0].temperature == 28.2
    assert entries_of(run, "met/humidity")[0][0].relative_humidity == 0.5

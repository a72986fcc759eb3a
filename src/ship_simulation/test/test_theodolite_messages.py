"""Messages of a theodolite in a bag: units, axes, names, truth; and effects of faults."""

import dataclasses
import hashlib

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory, serialize
from ship_bags.stamps import ns_from_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import angles_from_rotation
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.motion_scenario import Outage
from ship_simulation.scenario.scenario import Fault
from ship_simulation.simulate_command import main
from ship_testing.theodolite_scenes import SCENARIOS, bag_scenario, with_beacons, with_theodolite

ENCODER, IMAGE, BASELINE, DRONE = "theodolite/encoder", "theodolite/beacons", "beacon/a/baseline", "beacon/a/imu"


@pytest.fixture(scope="module")
def run():
    return simulate(with_theodolite(bag_scenario(duration_s=3.0), telescope__exposure_s=0.01), seed=1)


def entries_of(run, topic):
    return [(message, log) for name, message, log in generate_messages([run], RosbagsFactory()) if name == topic]


def test_every_topic_is_there_in_order_of_arrival(run):
    entries = list(generate_messages([run], RosbagsFactory()))
    assert [log for _, _, log in entries] == sorted(log for _, _, log in entries)
    counts = {topic: sum(name == topic for name, _, _ in entries) for topic, _, _ in entries}
    drones = {f"beacon/{key}/{what}": 31 for key in "ab" for what in ("baseline", "imu")}
    pointing = {ENCODER: 151, IMAGE: 13, "ship/attitude": 61, "truth/pointing": 31, "truth/calibration": 4}
    assert {topic: counts.get(topic) for topic in drones | pointing} == drones | pointing


def test_encoder_and_image_messages_contain_the_measurements(run):
    encoder, images = run.theodolite.encoder, run.theodolite.images
    message, log = entries_of(run, ENCODER)[7]
    assert (ns_from_stamp(message.header.stamp), log) == (encoder.time_ns[7], encoder.log_time_ns[7])
    assert (message.azimuth, message.elevation) == (encoder.azimuth[7], encoder.elevation[7])
    assert message.sigma == pytest.approx(1.0 * ARCSEC, rel=1e-6)
    assert (message.status, message.header.frame_id) == (message.VALID, "theodolite")
    message, _ = entries_of(run, IMAGE)[2]
    assert (ns_from_stamp(message.header.stamp), message.telescope_id) == (images.time_ns[2], "calibration")
    assert message.exposure_s == pytest.approx(0.01)
    assert [(light.beacon_id, (light.x, light.z)) for light in message.beacons] == [
        (name, tuple(point)) for name, point in images.sightings(2)
    ]
    assert message.beacons[0].sigma == pytest.approx(6.5e-7, rel=1e-6)


def test_baselines_are_east_north_up_and_drones_have_their_attitude(run):
    samples = run.theodolite.baselines["a"]
    message, log = entries_of(run, BASELINE)[0]
    north, up, east = samples.baseline_n[0]
    assert (message.enu.x, message.enu.y, message.enu.z) == (east, north, up)
    assert log - ns_from_stamp(message.header.stamp) == SECOND_NS // 10
    assert (message.base_id, message.rover_id, message.fix) == ("ship", "a", message.FIXED)
    np.testing.assert_allclose(message.covariance.reshape(3, 3), 0.02**2 * np.eye(3))
    # By hand: two kilometres at 10° + 2° of elevation, 3° east of North, and the lever of the ship's antenna.
    assert up == pytest.approx(2000.0 * np.sin(np.deg2rad(12.0)), abs=15.0)
    assert east == pytest.approx(2000.0 * np.sin(np.deg2rad(3.0)), abs=15.0)
    message, _ = entries_of(run, DRONE)[5]
    q = message.orientation
    yaw_deg = np.rad2deg(np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2)))
    # The drone's nose is 20° east of North, with 2° of sway and 1° of error; ROS yaw counts from East,
    # counterclockwise.
    assert yaw_deg == pytest.approx(70.0, abs=4.0)
    east_var, north_var, up_var = np.diag(message.orientation_covariance.reshape(3, 3))
    assert east_var == north_var == pytest.approx(np.deg2rad(0.3) ** 2 + np.deg2rad(0.05) ** 2)
    assert up_var == pytest.approx(np.deg2rad(1.0) ** 2 + np.deg2rad(0.05) ** 2)


def test_a_baseline_without_solution_is_nan():
    scenario = with_beacons(bag_scenario(duration_s=3.0), rtk__no_solution_times={"x": Outage(1.0, 2.0)})
    found = entries_of(simulate(scenario, seed=1), BASELINE)
    none = [message for message, _ in found if message.fix == message.NONE]
    assert len(none) == 10
    assert all(np.isnan([m.enu.x, m.enu.y, m.enu.z]).all() and np.isnan(m.covariance).all() for m in none)


def test_the_fused_attitude_has_its_covariance(run):
    message, _ = entries_of(run, "ship/attitude")[20]
    np.testing.assert_allclose(
        [message.heading, message.pitch, message.roll], angles_from_rotation(run.fused.rotation_nd[20]), atol=1e-12
    )
    sigma = np.sqrt(np.diag(message.rotation_covariance.reshape(3, 3))) / ARCSEC
    np.testing.assert_allclose(sigma, np.hypot([1.45, 1.45, 1.75], 1.0))
    assert np.sqrt(message.covariance[0]) / ARCSEC == pytest.approx(np.hypot(1.75, 1.0), rel=0.01)
    assert (message.status, message.horizon) == (message.VALID, message.GEODETIC)


def test_truth_is_published_at_encoder_stamps(run):
    truth, stamps = run.theodolite.truth, set(run.theodolite.encoder.time_ns.tolist())
    found = entries_of(run, "truth/pointing")
    assert all(ns_from_stamp(message.header.stamp) == log and log in stamps for message, log in found)
    message = found[10][0]
    angles = angles_from_rotation(truth.mount.rotation_nm[10])
    np.testing.assert_allclose([message.azimuth, message.elevation, message.image_rotation], angles, atol=1e-12)
    telescope = [message.telescope_azimuth, message.telescope_elevation, message.telescope_rotation]
    np.testing.assert_allclose(telescope, angles_from_rotation(truth.rotation_nt[10]), atol=1e-12)
    assert (message.mode, message.light_count) == (message.TWO_LIGHTS, 2)
    calibration, _ = entries_of(run, "truth/calibration")[1]
    values = dict(zip(calibration.names, calibration.values, strict=True))
    constants = truth.scene.theodolite
    assert [values[name] for name in NAMES] == constants.axis_errors.vector().tolist()
    assert values["focal_length"] == constants.focal_length_m
    deformation = [values[f"deformation_{axis}"] for axis in ("bow", "up", "starboard")]
    assert deformation == truth.mount.deformation_d[10].tolist()
    assert [unit for name, unit in zip(calibration.names, calibration.units, strict=True) if unit == "m"] == ["m"]


def test_truth_states_when_the_lights_are_gone_or_hidden():
    scenario = with_beacons(bag_scenario(duration_s=6.0), leaves_s=4.0)
    hidden = dataclasses.replace(scenario.beacons["b"], hidden={"x": Outage(1.0, 2.0)})
    found = entries_of(
        simulate(dataclasses.replace(scenario, beacons=scenario.beacons | {"b": hidden}), seed=1), "truth/pointing"
    )
    modes = np.array([message.mode for message, _ in found])
    np.testing.assert_array_equal(modes, np.repeat([0, 1, 0, 2], [10, 10, 20, 21]))


def faulty(topic, kind, **changes):
    """Return the messages of a topic without and with a fault from 1 s to 2 s."""
    scenario = bag_scenario(duration_s=3.0)
    fault = Fault(topic=topic, kind=kind, start_s=1.0, end_s=2.0, **changes)
    clean = entries_of(simulate(scenario, seed=1), topic)
    return clean, entries_of(simulate(dataclasses.replace(scenario, faults={"f": fault}), seed=1), topic)


def changed_entries(clean, changed):
    """Check that exactly the messages from 1 s to 2 s differ; return these as pairs (clean, faulty)."""
    assert len(clean) == len(changed)
    start_ns = 1_404_906_607_800_000_000
    pairs = []
    for (before, _), (after, _) in zip(clean, changed, strict=True):
        inside = SECOND_NS <= ns_from_stamp(before.header.stamp) - start_ns < 2 * SECOND_NS
        assert inside == (serialize(before) != serialize(after))
        if inside:
            pairs.append((before, after))
    return pairs


def test_a_stuck_encoder_has_new_stamps_and_the_old_angles():
    clean, stuck = faulty(ENCODER, "freeze")
    pairs = [(before, after) for (before, _), (after, _) in zip(clean, stuck, strict=True)]
    window = [after for before, after in pairs if serialize(before) != serialize(after)]
    # The window contains fifty messages, of which the first is unchanged.
    assert len(window) == 49
    assert len({ns_from_stamp(message.header.stamp) for message in window}) == 49
    angles = {(message.azimuth, message.elevation) for message in window}
    assert angles == {(clean[50][0].azimuth, clean[50][0].elevation)}


def test_encoders_in_degrees():
    pairs = changed_entries(*faulty(ENCODER, "angles_in_degrees"))
    assert len(pairs) == 50
    for before, after in pairs:
        assert after.elevation == pytest.approx(np.rad2deg(before.elevation))
        assert after.azimuth == pytest.approx(np.rad2deg(before.azimuth))


def test_swapped_lights_keep_their_points():
    for before, after in changed_entries(*faulty(IMAGE, "swap")):
        assert [light.beacon_id for light in after.beacons] == ["b", "a"]
        assert [(light.x, light.z) for light in after.beacons] == [(light.x, light.z) for light in before.beacons]


def test_a_hidden_light_is_missing():
    for _, after in changed_entries(*faulty(IMAGE, "hide")):
        assert [light.beacon_id for light in after.beacons] == ["b"]


def test_a_wrong_id_in_the_image_and_in_the_baseline():
    for _, after in changed_entries(*faulty(IMAGE, "wrong_id")):
        assert [light.beacon_id for light in after.beacons] == ["a_other", "b"]
    for before, after in changed_entries(*faulty(BASELINE, "wrong_id")):
        assert (before.rover_id, after.rover_id) == ("a", "a_other")


def test_a_late_baseline_keeps_its_stamp_and_a_late_stamp_its_arrival():
    clean, late = faulty(BASELINE, "delay", delay_s=1.0)
    waits_ns = sorted(log - ns_from_stamp(m.header.stamp) for m, log in late)
    assert waits_ns == [SECOND_NS // 10] * 21 + [1_100_000_000] * 10
    assert {serialize(m) for m, _ in clean} == {serialize(m) for m, _ in late}
    clean, stamped = faulty(BASELINE, "stamp_late", delay_s=1.0)
    assert [log for _, log in clean] == [log for _, log in stamped]
    for before, after in changed_entries(clean, stamped):
        assert ns_from_stamp(after.header.stamp) - ns_from_stamp(before.header.stamp) == SECOND_NS
        assert after.enu == before.enu


@pytest.mark.parametrize(
    ("topic", "value"),
    [
        (ENCODER, lambda m: m.azimuth),
        (IMAGE, lambda m: m.beacons[0].x),
        (BASELINE, lambda m: m.enu.x),
        (DRONE, lambda m: m.orientation.x),
        ("ship/attitude", lambda m: m.heading),
    ],
)
def test_nan_and_frame_reach_every_topic(topic, value):
    for before, after in changed_entries(*faulty(topic, "nan")):
        assert np.isnan(value(after))
        assert not np.isnan(value(before))
    for before, after in changed_entries(*faulty(topic, "frame")):
        assert after.header.frame_id == before.header.frame_id + "_other"


@pytest.mark.parametrize("topic", [BASELINE, "ship/attitude"])
def test_covariances_unknown_and_negative(topic):
    for _, after in changed_entries(*faulty(topic, "covariance_unknown")):
        assert not after.covariance.any()
    for before, after in changed_entries(*faulty(topic, "covariance_negative")):
        assert after.covariance[4] == -before.covariance[4] < 0.0


def test_the_same_seed_gives_the_same_bag_and_the_scenario_is_in_it(tmp_path):
    scenario = tmp_path / "short.yaml"
    text = (SCENARIOS / "theodolite.yaml").read_text(encoding="utf-8").replace("duration_s: 120.0", "duration_s: 5.0")
    scenario.write_text(text, encoding="utf-8")
    digests = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert main([str(scenario), "--out", str(tmp_path / f"{name}.mcap"), "--seed", str(seed)]) == 0
        digests.append(hashlib.sha256((tmp_path / f"{name}.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]
    with read_bag(tmp_path / "a.mcap") as bag:
        assert bag.topics["truth/pointing"] == "ship_msgs/msg/OpticalAxisPointing"
        assert bag.attachments["scenario.yaml"].decode() == text


STARS_BROKEN = {
    "no detector": (
        "    focal_length_m: 1.5\n",
        "",
        "'theodolite.main_detector.focal_length_m' must be given where there are targets",
    ),
    "the telescope of the lights": (
        "\n  night: ",
        "\n  calibration: ",
        "'telescopes.calibration' is reserved for the telescope for lights: choose another id for a star camera",
    ),
    "no field": ("      width_px: 2200\n", "", "'telescopes.night.camera.width_px' and"),
    "no mounting": ("    roll_deg: 3.0\n", "", "roll_deg"),
    "window": (
        "hidden: {cloud: {start_s: 30.0, end_s: 33.0}}",
        "hidden: {cloud: {start_s: 30.0, end_s: 3.0}}",
        "'targets.balloon.hidden.cloud.end_s' = 3.0 s must be after start_s = 30.0 s",
    ),
    "other course": (
        "course: {kind: escort",
        "course: {kind: hover",
        "'targets.balloon.course.escort' is not used by a course of kind hover: expected hover",
    ),
}


BROKEN = {
    "not aboard": ("aboard: true", "aboard: false", "'theodolite' is not used without 'theodolite.aboard: true'"),
    "other flight": (
        "flight: {kind: escort, escort: {right_deg: 3.0",
        "flight: {kind: orbit, escort: {right_deg: 3.0",
        "'beacons.a.flight.escort' is not used by a course of kind orbit: expected orbit",
    ),
    "no legs": (
        "flight: {kind: escort, escort: {right_deg: 3.0, up_deg: 2.0, distance_m: 2000.0}",
        "flight: {kind: legs",
        "'beacons.a.flight.waypoints' must contain two or more with different time_s, got []",
    ),
    "window": (
        "hidden: {cloud: {start_s: 40.0, end_s: 50.0}}",
        "hidden: {cloud: {start_s: 40.0, end_s: 30.0}}",
        "'beacons.a.hidden.cloud.end_s' = 30.0 s must be after start_s = 40.0 s",
    ),
    "elevations": (
        "greatest_elevation_deg: 70.0",
        "greatest_elevation_deg: 5.0",
        "'theodolite.programme.greatest_elevation_deg' = 5.0 deg must not be less than least_elevation_deg = 10.0 deg",
    ),
    "focal length in mm": ("focal_length_m: 0.1", "focal_length_m: 100.0", "out of its range [0.01, 10.0] m"),
    "fault of another topic": (
        "position:",
        "faults: {f: {topic: theodolite/encoder, kind: swap, start_s: 1.0, end_s: 2.0}}\nposition:",
        "'faults.f.kind' = swap does not apply to ship_msgs/msg/TheodoliteEncoder",
    ),
    "delay of another kind": (
        "position:",
        "faults: {f: {topic: theodolite/beacons, kind: swap, start_s: 1.0, end_s: 2.0, delay_s: 1.0}}\nposition:",
        "'faults.f.delay_s' is not used by kind swap: it belongs to delay and reorder and stamp_late",
    ),
}


@pytest.mark.parametrize("case", STARS_BROKEN)
def test_a_broken_star_scenario_is_one_line_with_file_line_and_key(case, tmp_path, capsys):
    assert_refused("theodolite_night.yaml", STARS_BROKEN[case], tmp_path, capsys)


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_scenario_is_one_line_with_file_line_and_key(case, tmp_path, capsys):
    assert_refused("theodolite.yaml", BROKEN[case], tmp_path, capsys)


def assert_refused(name, case, tmp_path, capsys):
    before, after, expected = case
    text = (SCENARIOS / name).read_text(encoding="utf-8")
    assert before in text
    path = tmp_path / "broken.yaml"
    path.write_text(text.replace(before, after, 1), encoding="utf-8")
    assert main([str(path), "--out", str(tmp_path / "x.mcap")]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"{path}:" in line
    assert expected in line

"""The command ``inject``: effect of each kind inside its time and nowhere else; one line for bad input."""

import dataclasses
import math
from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.stamps import ns_from_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import celestial_rotation_from_quaternion, rotation_from_angles, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC, angle_between, log_rotation
from ship_simulation.inject_command import main
from ship_simulation.scenario.fault import KINDS
from ship_simulation.scenario.scenario_file import field_steps, load_scenario, numeric_fields
from ship_simulation.simulate_command import write_bag
from ship_stars.camera.config import CameraConfig
from ship_testing.places import ROOT

LENGTH_S = 5.0
INS, STARS, TRACKER = "ins/imu", "star/starboard/observations", "star/port/inertial_attitude"
BOW = "star/bow/horizon_attitude"
ENCODER, LIGHTS, BASELINE, GYRO = "theodolite/encoder", "theodolite/beacons", "beacon/a/baseline", "reference/gyro/imu"
SHIP, FIX = "ship/attitude", "gnss/fix"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return a bag of five seconds with every device, and with the fused attitude."""
    scenario = load_scenario(ROOT / "bags" / "scenarios" / "everything.yaml")
    fused = dataclasses.replace(scenario.fused_attitude, written=True)
    scenario = dataclasses.replace(scenario, duration_s=LENGTH_S, fused_attitude=fused)
    path = tmp_path_factory.mktemp("bag") / "everything.mcap"
    write_bag(scenario, 3, path, b"scenario: here\n")
    return path


def inject(bag, folder, faults, seed=1, *more):
    """Return the bag with faults given as text in flow style."""
    file = folder / "faults.yaml"
    file.write_text("faults:\n" + "".join(f"  f{i}: {{{fault}}}\n" for i, fault in enumerate(faults)))
    out = folder / f"out_{seed}.mcap"
    code = main([str(bag), "--faults", str(file), "--out", str(out), "--seed", str(seed), "--force", *more])
    assert code == 0
    return out


def records_of(path, topic=None):
    with read_bag(path) as bag:
        return [record for record in bag.records() if topic in (None, record.topic)]


def pairs(bag, out, topic, start_s=2.0, end_s=3.0):
    """Return (before, after) of a topic's messages stamped in the fault's time; others must be equal to the byte."""
    before, after = records_of(bag), records_of(out)
    assert len(before) == len(after)
    start_ns = before[0].log_time_ns
    found = []
    for one, other in zip(before, after, strict=True):
        assert (one.topic, one.log_time_ns) == (other.topic, other.log_time_ns)
        message = one.decode()
        if not hasattr(message, "header"):
            assert one.data == other.data
            continue
        since_s = (ns_from_stamp(message.header.stamp) - start_ns) / SECOND_NS
        if one.topic == topic and start_s <= since_s < end_s:
            # A drift starts at zero.
            assert one.data != other.data or not found
            found.append((message, other.decode()))
        else:
            assert (one.data, one.sequence) == (other.data, other.sequence) or (
                one.topic == topic and one.data == other.data
            )
    assert found
    return found


WINDOW = "start_s: 2.0, end_s: 3.0"


def only(bag, folder, topic, kind, sizes=""):
    out = inject(bag, folder, [f"topic: {topic}, kind: {kind}, {WINDOW}{', ' if sizes else ''}{sizes}"])
    return pairs(bag, out, topic)


def quaternion(message):
    q = message.orientation
    return np.array([q.x, q.y, q.z, q.w])


def rotation(message):
    """Return "parent from device" (forward, up, right) of a message with an attitude."""
    if message.__msgtype__.endswith("StarHorizonAttitude"):
        return rotation_from_angles(message.azimuth, message.elevation, message.roll)
    if message.__msgtype__.endswith("StarInertialAttitude"):
        return celestial_rotation_from_quaternion(quaternion(message))
    return rotation_from_quaternion(quaternion(message))


def xyz(vector):
    return np.array([vector.x, vector.y, vector.z])


@pytest.mark.parametrize("topic", [INS, GYRO, SHIP, BOW, TRACKER])
def test_a_mounting_shift_rotates_an_attitude_in_the_device_frame(bag, tmp_path, topic):
    for before, after in only(bag, tmp_path, topic, "knock", "forward_arcsec: 30, up_arcsec: 20, right_arcsec: -10"):
        turn = log_rotation(rotation(before).T @ rotation(after)) / ARCSEC
        np.testing.assert_allclose(turn, [30.0, 20.0, -10.0], atol=1e-6)
        if topic == SHIP:
            angles = rotation_from_angles(after.heading, after.pitch, after.roll)
            np.testing.assert_allclose(angles, rotation(after), atol=1e-12)


def test_a_mounting_shift_rotates_the_measured_star_directions(bag, tmp_path):
    """The sensor sees a fixed star at exp(-t) s after a rotation R' = R exp(t), computed here with scipy."""
    scenario = load_scenario(ROOT / "bags" / "scenarios" / "everything.yaml")
    camera = scenario.star_sensors["starboard"].camera.camera("")
    turn = Rotation.from_rotvec(np.array([40.0, 25.0, -15.0]) * ARCSEC)
    for before, after in only(bag, tmp_path, STARS, "knock", "forward_arcsec: 40, up_arcsec: 25, right_arcsec: -15"):
        seen, moved = (camera.directions(np.array([[s.u, s.v] for s in m.stars])) for m in (before, after))
        np.testing.assert_allclose(angle_between(turn.inv().apply(seen), moved) / ARCSEC, 0.0, atol=1e-6)
        assert [s.catalogue_id for s in before.stars] == [s.catalogue_id for s in after.stars]


def test_a_mounting_shift_of_the_telescope_moves_all_lights_equally(bag, tmp_path):
    """After a rotation by 20″ to the right about up, the lights move left in the scene: right, x > 0, in the image."""
    for before, after in only(bag, tmp_path, LIGHTS, "knock", "up_arcsec: -20"):
        for one, other in zip(before.beacons, after.beacons, strict=True):
            x_m, z_m = one.x - 2.0e-4, one.z + 3.0e-4
            # A rotation to the right by a changes the image angle to angle + a; the height in the image is proportional
            # to the cosine.
            angle = math.atan2(x_m, 0.1) + 20.0 * ARCSEC
            np.testing.assert_allclose(other.x - 2.0e-4, 0.1 * math.tan(angle), atol=1e-12)
            assert other.z + 3.0e-4 == pytest.approx(z_m, rel=2e-5)


def test_drifts_of_devices_and_encoders_start_at_zero(bag, tmp_path):
    found = only(bag, tmp_path, INS, "drift", "up_arcsec_per_min: 60")
    turns = [log_rotation(rotation(before).T @ rotation(after))[1] / ARCSEC for before, after in found[1:]]
    # 1″ per second, at 50 Hz.
    np.testing.assert_allclose(turns, np.arange(1, 50) / 50.0, atol=1e-6)
    found = only(bag, tmp_path, ENCODER, "drift", "elevation_arcsec_per_min: -120")
    turns = [(after.elevation - before.elevation) / ARCSEC for before, after in found]
    # 2″ per second, at 20 Hz.
    np.testing.assert_allclose(turns, -0.1 * np.arange(len(turns)), atol=1e-6)
    assert all(after.azimuth == before.azimuth for before, after in found)


@pytest.mark.parametrize("topic", [INS, SHIP, BOW])
def test_a_bias_turns_about_the_horizons_axes_and_leaves_the_rates(bag, tmp_path, topic):
    for before, after in only(bag, tmp_path, topic, "bias", "north_arcsec: 5, up_arcsec: 30, east_arcsec: -7"):
        turn = log_rotation(rotation(after) @ rotation(before).T) / ARCSEC
        np.testing.assert_allclose(turn, [5.0, 30.0, -7.0], atol=1e-6)
        if topic != BOW:
            assert after.angular_velocity == before.angular_velocity


def test_other_axes_are_those_of_wrong_drivers(bag, tmp_path):
    for before, after in only(bag, tmp_path, INS, "axes", "axes: ned_frd"):
        # North-east-down from forward-right-down is the same attitude, read by the other convention.
        np.testing.assert_allclose(rotation_from_quaternion(quaternion(after), "ned_frd"), rotation(before), atol=1e-12)
        np.testing.assert_array_equal(xyz(after.angular_velocity), xyz(before.angular_velocity) * [1, -1, -1])
    for before, after in only(bag, tmp_path, INS, "axes", "axes: exchanged"):
        np.testing.assert_array_equal(quaternion(after), quaternion(before)[[1, 0, 2, 3]])
    for before, after in only(bag, tmp_path, BASELINE, "axes", "axes: ned_frd"):
        np.testing.assert_array_equal(xyz(after.enu), xyz(before.enu)[[1, 0, 2]] * [1, 1, -1])
    for before, after in only(bag, tmp_path, TRACKER, "axes", "axes: ned_frd"):
        frd, flu = Rotation.from_quat(quaternion(after)).as_matrix(), Rotation.from_quat(quaternion(before)).as_matrix()
        np.testing.assert_allclose(frd, flu * [1.0, -1.0, -1.0], atol=1e-12)


def test_slips_wrong_fixes_and_position_offsets_have_the_configured_size(bag, tmp_path):
    for before, after in only(bag, tmp_path, ENCODER, "slip", "azimuth_arcsec: 100, elevation_arcsec: -50"):
        assert (after.azimuth - before.azimuth) / ARCSEC == pytest.approx(100.0, abs=1e-6)
        assert (after.elevation - before.elevation) / ARCSEC == pytest.approx(-50.0, abs=1e-6)
    for before, after in only(bag, tmp_path, BASELINE, "wrong_fix", "east_m: 0.3, up_m: -0.2"):
        np.testing.assert_allclose(xyz(after.enu) - xyz(before.enu), [0.3, 0.0, -0.2], atol=1e-9)
        assert after.fix == 4
    for before, after in only(bag, tmp_path, FIX, "position_off", "north_m: 1000, east_m: 2000, up_m: 5"):
        # A sphere of 6371 km; the ellipsoid differs by less than 1 %.
        assert (after.latitude - before.latitude) * 111_195.0 == pytest.approx(1000.0, rel=1e-3)
        east_m = (after.longitude - before.longitude) * 111_195.0 * math.cos(math.radians(before.latitude))
        assert east_m == pytest.approx(2000.0, rel=1e-3)
        assert after.altitude - before.altitude == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("topic", "sizes", "holds"),
    [
        (INS, "field: orientation.x, value: 0.25", lambda b, a: a.orientation.x == 0.25),
        (INS, "field: 'orientation_covariance[4]', value: 7.0", lambda b, a: a.orientation_covariance[4] == 7.0),
        (INS, "field: 'orientation_covariance[*]', value: 2.0", lambda b, a: set(a.orientation_covariance) == {2.0}),
        (STARS, "field: 'stars[1].u', value: -3.0", lambda b, a: a.stars[1].u == -3.0 and a.stars[0].u == b.stars[0].u),
        (STARS, "field: 'stars[*].magnitude', value: 9.0", lambda b, a: {s.magnitude for s in a.stars} == {9.0}),
        (STARS, "field: stars.catalogue_id, value: 5", lambda b, a: a.stars[0].catalogue_id == 5),
        (BASELINE, "field: fix, value: 3", lambda b, a: a.fix == 3 and isinstance(a.fix, int)),
        (FIX, "field: status.status, value: -1", lambda b, a: a.status.status == -1),
        (BOW, "field: header.stamp.sec, value: 1", lambda b, a: a.header.stamp.sec == 1),
    ],
)
def test_corrupt_sets_any_number_by_its_path(bag, tmp_path, topic, sizes, holds):
    for before, after in only(bag, tmp_path, topic, "corrupt", sizes):
        assert holds(before, after)


@pytest.mark.parametrize("topic", [INS, STARS, BOW, TRACKER, SHIP, ENCODER, LIGHTS, BASELINE, FIX, "met/humidity"])
def test_every_number_of_a_message_can_be_corrupted(bag, tmp_path, topic):
    """All numbers are set at once; each is read back from the bytes, those of 32 bits with their precision."""
    with read_bag(bag) as whole:
        paths = numeric_fields(whole.topics[topic])
    assert "header.stamp.nanosec" in paths
    faults = [f"topic: {topic}, kind: corrupt, {WINDOW}, field: '{path}', value: 3" for path in paths]
    for _, after in pairs(bag, inject(bag, tmp_path, faults), topic):
        for path in paths:
            value = after
            for name, index in field_steps(path):
                value = getattr(value, name)
                value = value[int(index)] if index else value
            assert value == 3, path


def test_offset_nan_and_infinity_in_a_field(bag, tmp_path):
    for before, after in only(bag, tmp_path, "met/pressure", "offset", "field: fluid_pressure, value: -1000"):
        assert after.fluid_pressure == pytest.approx(before.fluid_pressure - 1000.0)
    for _, after in only(bag, tmp_path, BASELINE, "nan", "field: enu.z"):
        assert math.isnan(after.enu.z)
        assert math.isfinite(after.enu.x)
    for _, after in only(bag, tmp_path, BASELINE, "infinite"):
        assert after.enu.x == math.inf


@pytest.mark.parametrize(
    ("topic", "value", "factor", "offset"),
    [
        (INS, lambda m: m.angular_velocity.y, 180.0 / math.pi, 0.0),
        (SHIP, lambda m: m.pitch, 180.0 / math.pi, 0.0),
        (BOW, lambda m: m.elevation, 180.0 / math.pi, 0.0),
        (ENCODER, lambda m: m.azimuth, 180.0 / math.pi, 0.0),
        (BASELINE, lambda m: m.enu.y, 1000.0, 0.0),
        (LIGHTS, lambda m: m.beacons[1].z, 1000.0, 0.0),
        (FIX, lambda m: m.longitude, math.pi / 180.0, 0.0),
        ("met/pressure", lambda m: m.fluid_pressure, 0.01, 0.0),
        ("met/temperature", lambda m: m.temperature, 1.0, 273.15),
        ("met/humidity", lambda m: m.relative_humidity, 100.0, 0.0),
    ],
)
def test_wrong_units_of_every_type(bag, tmp_path, topic, value, factor, offset):
    for before, after in only(bag, tmp_path, topic, "units"):
        assert value(after) == pytest.approx(value(before) * factor + offset, rel=1e-12)


def test_a_clock_step_moves_stamps_and_not_arrivals(bag, tmp_path):
    for before, after in only(bag, tmp_path, BOW, "clock_step", "step_s: -0.5"):
        assert ns_from_stamp(after.header.stamp) - ns_from_stamp(before.header.stamp) == -SECOND_NS // 2


@pytest.mark.parametrize("step_s", [-1e9, 1e9])
def test_a_clock_step_beyond_what_a_stamp_can_hold_ends_there(bag, tmp_path, step_s):
    """From 2014 a step of 1e9 s leads to 2046; the seconds of a stamp end in 2038."""
    for before, after in only(bag, tmp_path, BOW, "clock_step", f"step_s: {step_s:.1f}"):
        expected_ns = ns_from_stamp(before.header.stamp) + round(step_s * SECOND_NS)
        assert ns_from_stamp(after.header.stamp) == min(expected_ns, 2**31 * SECOND_NS - 1)


def test_false_stars_have_numbers_where_stars_have_them(bag, tmp_path):
    for before, after in only(bag, tmp_path, STARS, "false_stars", "count: 3"):
        # Compared as texts, because their directions are NaN.
        assert repr(after.stars[: len(before.stars)]) == repr(before.stars)
        false = after.stars[len(before.stars) :]
        assert len(false) == 3
        assert all(star.catalogue_id > 0 for star in false)
        assert all(0.0 <= star.u <= 2047.0 and 0.0 <= star.v <= 2047.0 for star in false)


def test_false_lights_are_moved_and_swapped_stars_exchange_their_numbers(bag, tmp_path):
    for before, after in only(bag, tmp_path, LIGHTS, "false_lights", "count: 3"):
        known = [light.beacon_id for light in before.beacons]
        assert [light.beacon_id for light in after.beacons] == [*known, "false_2"]
        # Within 3° of the axis of a telescope of 100 mm.
        assert all(abs(light.x - 2.0e-4) < 0.00525 for light in after.beacons)
        assert all(one.x != other.x for one, other in zip(before.beacons, after.beacons, strict=False))
    for before, after in only(bag, tmp_path, STARS, "swap"):
        numbers = [star.catalogue_id for star in before.stars]
        assert [star.catalogue_id for star in after.stars] == [numbers[1], numbers[0], *numbers[2:]]
        assert [star.u for star in after.stars] == [star.u for star in before.stars]


def test_reordered_messages_are_all_there_in_another_order(bag, tmp_path):
    out = inject(bag, tmp_path, [f"topic: {INS}, kind: reorder, {WINDOW}, delay_s: 0.5"])
    before, after = records_of(bag, INS), records_of(out, INS)
    assert Counter(r.data for r in before) == Counter(r.data for r in after)
    assert [r.data for r in before] != [r.data for r in after]
    logs = [r.log_time_ns for r in after]
    assert logs == sorted(logs)
    delay_s = [(r.log_time_ns - ns_from_stamp(r.decode().header.stamp)) / SECOND_NS for r in after]
    assert 0.4 < max(delay_s) < 0.503


def test_a_flood_has_the_configured_number_of_messages_with_earlier_stamps(bag, tmp_path):
    out = inject(bag, tmp_path, [f"topic: {BOW}, kind: flood, {WINDOW}, times: 20, spread_s: 1.5"])
    before, after = records_of(bag, BOW), records_of(out, BOW)
    assert len(after) - len(before) == 5 * 19
    kept = {r.data for r in before}
    assert kept <= {r.data for r in after}
    late_s = [
        (r.log_time_ns - ns_from_stamp(r.decode().header.stamp)) / SECOND_NS for r in after if r.data not in kept
    ]
    assert 0.1 < min(late_s) < 0.3
    assert 1.5 < max(late_s) < 1.8
    logs = [r.log_time_ns for r in after]
    assert logs == sorted(logs)


def test_a_share_of_the_messages_is_drawn_by_the_seed(bag, tmp_path):
    counts = []
    for seed in (1, 1, 2):
        out = inject(bag, tmp_path, [f"topic: {INS}, kind: drop, start_s: 0.0, share: 0.4"], seed)
        counts.append([r.log_time_ns for r in records_of(out, INS)])
    total = len(records_of(bag, INS))
    # 251 messages: 0.6 ± 5 sigma of a binomial share.
    assert all(abs(len(found) / total - 0.6) < 5.0 * math.sqrt(0.24 / total) for found in counts)
    assert counts[0] == counts[1] != counts[2]


def test_the_same_seed_gives_the_same_bytes_and_another_fault_does_not_change_what_is_drawn(bag, tmp_path):
    flood = f"topic: {BOW}, kind: flood, {WINDOW}, times: 5"
    first = inject(bag, tmp_path, [flood], 4).read_bytes()
    assert inject(bag, tmp_path, [flood], 4).read_bytes() == first
    alone = [r.data for r in records_of(inject(bag, tmp_path, [flood], 4), BOW)]
    with_another = inject(bag, tmp_path, [flood, f"topic: {INS}, kind: reorder, {WINDOW}, delay_s: 0.2"], 4)
    assert [r.data for r in records_of(with_another, BOW)] == alone


def test_faults_of_one_topic_combine_and_may_change_only_one_of_two_copies(bag, tmp_path):
    out = inject(
        bag,
        tmp_path,
        [
            f"topic: {BOW}, kind: duplicate, {WINDOW}",
            f"topic: {BOW}, kind: knock, {WINDOW}, up_arcsec: 10",
            f"topic: {BOW}, kind: knock, start_s: 2.5, up_arcsec: 10",
        ],
    )
    start_ns = records_of(bag)[0].log_time_ns
    clean = {ns_from_stamp(m.header.stamp): rotation(m) for m in (r.decode() for r in records_of(bag, BOW))}
    turns = []
    for message in (r.decode() for r in records_of(out, BOW)):
        stamp_ns = ns_from_stamp(message.header.stamp)
        turn = log_rotation(clean[stamp_ns].T @ rotation(message))[1] / ARCSEC
        turns.append((round((stamp_ns - start_ns) / SECOND_NS, 3), round(turn)))
    expected = [(t, (10 if 2.0 <= t < 3.0 else 0) + (10 if t >= 2.5 else 0)) for t, _ in turns]
    assert turns == expected
    assert Counter(t for t, _ in turns)[2.233] == 2


def test_a_recording_in_a_folder_keeps_its_other_content(bag, tmp_path):
    """A rosbag2 folder with a namespace, unknown topics and a latched topic."""
    folder = FolderWriter(tmp_path / "voyage", SplitLimits())
    folder.add_topic("/aurora/ship/note", "std_msgs/msg/String", latched=True)
    text = records_of(bag, INS)[0].store.types["std_msgs/msg/String"](data="hello")
    data = bytes(records_of(bag, INS)[0].store.serialize_cdr(text, "std_msgs/msg/String", little_endian=True))
    first_ns = records_of(bag)[0].log_time_ns
    folder.write_raw("/aurora/ship/note", "std_msgs/msg/String", data, first_ns)
    for record in records_of(bag):
        if record.topic in (INS, "truth/attitude"):
            folder.write_raw("/aurora/" + record.topic, record.type_name, record.data, record.log_time_ns)
    folder.close()
    fault = f"topic: {INS}, kind: bias, {WINDOW}, up_arcsec: 30"
    out = inject(tmp_path / "voyage", tmp_path, [fault], 1, "--namespace", "aurora")
    with read_bag(out) as faulty:
        assert faulty.latched_topics == {"/aurora/ship/note"}
        assert faulty.topics["/aurora/ship/note"] == "std_msgs/msg/String"
    assert len(pairs(tmp_path / "voyage", out, "/aurora/ins/imu")) == 50
    truth = [r.data for r in records_of(out, "/aurora/truth/attitude")]
    assert truth == [r.data for r in records_of(bag, "truth/attitude")]


def test_each_fault_is_summarised_in_one_line(bag, tmp_path, capsys):
    window = "start_s: 2.0, end_s: 3.0"
    faults = [
        f"topic: {BOW}, kind: knock, start_s: 2.0, right_arcsec: 20.0",
        f"topic: {INS}, kind: drop, {window}",
        f"topic: {ENCODER}, kind: delay, delay_s: 0.5, {window}",
        f"topic: {FIX}, kind: duplicate, {window}",
        f"topic: {GYRO}, kind: drop, start_s: 50.0",
    ]
    counts = [
        sum(1 for record in records_of(bag, topic) if since <= stamp_s(record, bag) < until)
        for topic, since, until in [(BOW, 2.0, 9.0), (INS, 2.0, 3.0), (ENCODER, 2.0, 3.0), (FIX, 2.0, 3.0)]
    ]
    assert min(counts) > 0
    inject(bag, tmp_path, faults)
    heading, *lines = capsys.readouterr().out.splitlines()
    assert heading.endswith("5 faults, seed 1")
    assert lines == [
        f"f0: knock of {BOW}, from 2 s to the end: {counts[0]} messages changed",
        f"f1: drop of {INS}, from 2 s to 3 s: {counts[1]} messages dropped",
        f"f2: delay of {ENCODER}, from 2 s to 3 s: {counts[2]} messages delayed",
        f"f3: duplicate of {FIX}, from 2 s to 3 s: {counts[3]} messages added",
        f"f4: drop of {GYRO}, from 50 s to the end: no message affected",
    ]


def stamp_s(record, path):
    """Return the stamp of a message in seconds after the first message of its bag."""
    with read_bag(path) as read:
        return (ns_from_stamp(record.decode().header.stamp) - read.start_ns) / SECOND_NS


def test_attachments_and_metadata_are_copied_and_the_faults_are_printed(bag, tmp_path):
    out = inject(bag, tmp_path, [f"topic: {INS}, kind: drop, {WINDOW}"], 7)
    with read_bag(bag) as before, read_bag(out) as after:
        assert after.attachments["suite.yaml"] == before.attachments["suite.yaml"]
        assert after.attachments["scenario.yaml"] == b"scenario: here\n"
        assert b"kind: drop" in after.attachments["faults.yaml"]
        assert after.metadata["simulation"] == {"seed": "3"}
        assert after.metadata["injection"] == {"seed": "7"}


BROKEN = {
    "no such topic": ("topic: ins/imo, kind: drop, start_s: 1", ":2: 'faults.f.topic' = ins/imo is not in the bag"),
    "truth": ("topic: truth/attitude, kind: drop, start_s: 1", "'faults.f.topic' = truth/attitude is not in the bag"),
    "no such kind": ("topic: ins/imu, kind: explode, start_s: 1", "'faults.f.kind' = 'explode' must be one of drop"),
    "not applicable": ("topic: ins/imu, kind: slip, start_s: 1, azimuth_arcsec: 9", "= slip does not apply to"),
    "no size": ("topic: ins/imu, kind: knock, start_s: 1", "of kind knock needs forward_arcsec or up_arcsec or right"),
    "other size": ("topic: ins/imu, kind: drop, start_s: 1, east_m: 3", "'faults.f.east_m' is not used by kind drop"),
    "times": ("topic: ins/imu, kind: drop, start_s: 2, end_s: 1", "'faults.f.end_s' = 1.0 s must be after start_s"),
    "no start": ("topic: ins/imu, kind: drop", "'faults.f.start_s'"),
    "not finite": ("topic: ins/imu, kind: bias, start_s: 1, up_arcsec: .nan", "'faults.f.up_arcsec' must be finite"),
    "no such field": ("topic: ins/imu, kind: nan, start_s: 1, field: orientation.q", "has no field q: expected one"),
    "a text": ("topic: ins/imu, kind: corrupt, start_s: 1, field: header.frame_id", "not the path of a number"),
    "a group": ("topic: ins/imu, kind: corrupt, start_s: 1, field: orientation", "not the path of a number"),
    "no index": (
        "topic: ins/imu, kind: corrupt, start_s: 1, field: orientation_covariance", "has several elements: expected"
    ),
    "beyond": (
        "topic: ins/imu, kind: corrupt, start_s: 1, field: 'orientation_covariance[9]'", "has 9 elements, starting at"
    ),
    "whole": ("topic: beacon/a/baseline, kind: corrupt, start_s: 1, field: fix, value: 300", "from 0 to 255"),
    "32 bits": (
        "topic: theodolite/beacons, kind: corrupt, start_s: 1, field: beacons.sigma, value: 1e39", "is 3.4"
    ),
    "whole offset": ("topic: beacon/a/baseline, kind: offset, start_s: 1, field: fix, value: 1", "use corrupt"),
    "whole nan": ("topic: beacon/a/baseline, kind: nan, start_s: 1, field: fix", "allows no NaN"),
    "no path": ("topic: ins/imu, kind: nan, start_s: 1, field: 'a..b'", "not a field path"),
    "unknown key": ("topic: ins/imu, kind: drop, start_s: 1, size: 3", "parameter 'faults.f.size' is unknown"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_a_wrong_fault_is_one_line_with_file_line_and_key(bag, tmp_path, capsys, case):
    fault, expected = BROKEN[case]
    file, out = tmp_path / "faults.yaml", tmp_path / "out.mcap"
    file.write_text(f"faults:\n  f: {{{fault}}}\n")
    assert main([str(bag), "--faults", str(file), "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"{file}:" in line
    assert expected in line
    assert not out.exists()


def test_other_bad_input_is_one_line(bag, tmp_path, capsys):
    file, out = tmp_path / "faults.yaml", tmp_path / "out.mcap"
    for text, expected in (("faults: {}\n", "faults"), ("voyage: 3\n", "'voyage' is unknown"), ("", "expected 'name:")):
        file.write_text(text)
        assert main([str(bag), "--faults", str(file), "--out", str(out)]) == 2
        assert expected in capsys.readouterr().err
    file.write_text("faults: {f: {topic: ins/imu, kind: drop, start_s: 1}}\n")
    assert main([str(bag), "--faults", str(file), "--out", str(bag), "--force"]) == 2
    assert "would overwrite the input" in capsys.readouterr().err
    assert main([str(bag), "--faults", str(tmp_path / "none.yaml"), "--out", str(out)]) == 2
    assert "cannot be read" in capsys.readouterr().err
    out.write_bytes(b"")
    assert main([str(bag), "--faults", str(file), "--out", str(out)]) == 2
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["none.mcap", "--faults", "faults.yaml", "--out", "out.mcap"], "none.mcap: "),
        (["faults.yaml", "--faults", "faults.yaml", "--out", "out.mcap"], "faults.yaml: "),
        (["{bag}", "--faults", "faults.yaml", "--out", "out.mcap", "--seed", "-1"], "--seed"),
        (["{bag}", "--faults", "faults.yaml", "--out", "out.mcap", "--namespace", "other"], "is not in the bag"),
        (["{bag}", "--faults", "faults.yaml", "--out", "no/such/folder/out.mcap"], "no/such/folder"),
        (["{bag}", "--faults", "faults.yaml"], "--out"),
    ],
)
def test_usage_errors_exit_with_2_and_write_nothing(bag, tmp_path, capsys, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "faults.yaml").write_text("faults: {f: {topic: ins/imu, kind: drop, start_s: 1}}\n")
    try:
        code = main([word.format(bag=bag) for word in words])
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    shown = capsys.readouterr()
    assert expected in shown.err
    assert "Traceback" not in shown.err
    assert [path.name for path in tmp_path.iterdir()] == ["faults.yaml"]


def test_a_camera_without_description_is_named(bag, tmp_path, capsys):
    bare = tmp_path / "bare.mcap"
    with BagWriter(bare) as writer:
        for record in records_of(bag):
            writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    file = tmp_path / "faults.yaml"
    file.write_text(f"faults: {{f: {{topic: {STARS}, kind: knock, start_s: 1, up_arcsec: 5}}}}\n")
    assert main([str(bare), "--faults", str(file), "--out", str(tmp_path / "out.mcap")]) == 2
    expected = "fault 'f' of kind knock: no star sensor or telescope of the suite file has a camera"
    assert expected in capsys.readouterr().err
    assert CameraConfig().is_given is False


def test_every_kind_is_in_the_help(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out
    assert all(f"  {kind} " in shown for kind in KINDS)

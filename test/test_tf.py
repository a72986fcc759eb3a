"""Frames on ``/tf`` and ``/tf_static``: their chains, composed by scipy, agree with the suite's topics."""

import math
from collections import Counter, defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation, Slerp
from tf2_msgs.msg import TFMessage

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.stamps import ns_from_stamp
from ship_estimation.time_order.outcome import Status
from ship_replay.offline.replay import ADAPTERS, replay
from ship_testing.adapter_runs import FACTORY, SECOND_NS, START_NS, hand_over
from ship_testing.bag_parts import write_beginning
from ship_testing.every_input import voyage as voyage_of
from ship_testing.places import ROOT
from ship_testing.small_voyage import (
    FORE,
    INS,
    STARBOARD,
    config,
    fault_free_run,
    new_adapter,
    remove_interval,
    run_adapter,
    voyage,
)
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

THEODOLITE = ROOT / "bags" / "theodolite.mcap"
BEYOND_ROUNDING = 1e-12


def rotation_from_message(quaternion):
    return Rotation.from_quat([quaternion.x, quaternion.y, quaternion.z, quaternion.w])


def angle_between(one, other):
    """Return the angle between two rotations, rad."""
    return (one.inv() * other).magnitude()


def transforms(messages):
    return [transform for message in messages for transform in message.transforms]


def by_stamp(messages):
    return {ns_from_stamp(message.header.stamp): message for message in messages}


def ros_rotation(forward_azimuth, elevation, roll):
    """Return the rotation to East, North, Up from forward, left, up of a device, by the suite's angles, rad."""
    return Rotation.from_euler("ZYX", [math.pi / 2 - forward_azimuth, -elevation, roll])


def assert_for_tf2(sent):
    """Assert tf2's conditions: increasing stamps and one parent for each child, unit quaternions, no NaN."""
    parents, stamps = defaultdict(set), defaultdict(list)
    for transform in sent:
        parents[transform.child_frame_id].add(transform.header.frame_id)
        stamps[transform.child_frame_id].append(ns_from_stamp(transform.header.stamp))
        q, t = transform.transform.rotation, transform.transform.translation
        assert abs(math.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2) - 1.0) < 1e-15
        assert all(map(math.isfinite, (t.x, t.y, t.z)))
    assert {len(names) for names in parents.values()} == {1}
    assert all(earlier < later for times in stamps.values() for earlier, later in pairwise(times))


def test_the_deck_is_published_with_each_attitude_at_its_stamp():
    run = fault_free_run()
    decks, claimed = transforms(run.messages("/tf")), by_stamp(run.messages("ship/attitude"))
    assert_for_tf2(decks)
    assert [ns_from_stamp(deck.header.stamp) for deck in decks] == list(claimed)
    for deck, attitude in zip(decks, claimed.values(), strict=True):
        assert (deck.header.frame_id, deck.child_frame_id) == ("horizon", "deck")
        published = rotation_from_message(deck.transform.rotation)
        # Both forms of ship/attitude are compared: the quaternion, and the angles in ROS's convention.
        assert angle_between(published, rotation_from_message(attitude.orientation)) < BEYOND_ROUNDING
        assert angle_between(published, ros_rotation(attitude.heading, attitude.pitch, attitude.roll)) < BEYOND_ROUNDING


def test_no_transform_is_from_the_future():
    for ns, topic, message in fault_free_run().published:
        if topic.startswith("/tf"):
            assert all(ns_from_stamp(t.header.stamp) <= ns for t in message.transforms)


def test_from_the_deck_there_is_a_frame_to_each_configured_star_sensor():
    """The frames are as configured before the first star; later they have the estimate in ship/alignment."""
    run = fault_free_run()
    first, *_, last = run.messages("/tf_static")
    for static, alignment in ((first, None), (last, run.messages("ship/alignment")[-1])):
        assert {t.child_frame_id: t.header.frame_id for t in static.transforms} == {
            "star_fore": "deck", "star_starboard": "deck",
        }  # fmt: skip
        for transform in static.transforms:
            id_ = transform.child_frame_id.removeprefix("star_")
            sensor = config().star_sensors[id_]
            angles = np.deg2rad([sensor.azimuth_deg, sensor.elevation_deg, sensor.roll_deg])
            if alignment is not None:
                known = dict(zip(alignment.names, alignment.values, strict=True))
                angles = np.array([known[f"star.{id_}.{name}"] for name in ("azimuth", "elevation", "roll")])
            # In the deck, azimuth 0 is the bow: x, and not y as North is.
            mounted = Rotation.from_euler("ZYX", [-angles[0], -angles[1], angles[2]])
            assert angle_between(rotation_from_message(transform.transform.rotation), mounted) < BEYOND_ROUNDING
    before, after = (
        [rotation_from_message(one.transform.rotation) for one in each.transforms] for each in (first, last)
    )
    assert max(angle_between(one, other) for one, other in zip(before, after, strict=True)) > 1e-8


def test_through_the_deck_a_star_sensor_has_its_measured_attitude():
    """Within the errors of the small voyage: 100″ about the boresight, 3″ across, at five sigmas."""
    run = fault_free_run()
    decks = {
        ns_from_stamp(t.header.stamp): rotation_from_message(t.transform.rotation)
        for t in transforms(run.messages("/tf"))
    }
    mounted = {
        t.child_frame_id: rotation_from_message(t.transform.rotation) for t in run.messages("/tf_static")[-1].transforms
    }
    compared = 0
    for topic, frame in ((FORE, "star_fore"), (STARBOARD, "star_starboard")):
        for arrival in voyage():
            near = [ns for ns in decks if abs(ns - arrival.stamp_ns) <= 3_000_000]
            if arrival.topic == topic and near and arrival.stamp_ns > START_NS + 2 * SECOND_NS:
                measured = ros_rotation(arrival.message.azimuth, arrival.message.elevation, arrival.message.roll)
                # 3 ms of a ship that turns by 2.5°/s at most are 27″.
                off = np.degrees((measured.inv() * decks[near[0]] * mounted[frame]).as_rotvec()) * 3600.0
                assert np.all(np.abs(off) < [530.0, 60.0, 60.0]), off
                compared += 1
    assert compared >= 3


@pytest.mark.parametrize(
    ("ids", "expected"),
    [
        (["cam", "cam"], ["star_fore", "star_starboard"]),
        (["", ""], ["star_fore", "star_starboard"]),
        (["deck", "horizon"], ["star_fore", "star_starboard"]),
        (["star_starboard", ""], ["star_fore", "star_starboard"]),
        (["a", "b"], ["a", "b"]),
    ],
)
def test_each_sensor_has_a_separate_frame(ids, expected):
    adapter = new_adapter(star_sensors__fore__frame_id=ids[0], star_sensors__starboard__frame_id=ids[1])
    (static,) = [message for topic, message in adapter.tick(START_NS) if topic == "/tf_static"]
    assert [t.child_frame_id for t in static.transforms] == expected


def test_without_star_sensors_no_frame_below_the_deck_is_published():
    adapter = ShipAttitudeAdapter(ShipAttitudeConfig(), FACTORY)
    topics = [topic for topic, _ in adapter.tick(START_NS)]
    assert "ship/alignment" in topics
    assert "/tf_static" not in topics


def test_no_transform_is_published_for_an_invalid_attitude():
    """Two seconds without INS and stars: INVALID once a second; before and after, each output has its transform."""
    run = run_adapter(new_adapter(), remove_interval(voyage(), 2.0, 4.0, INS, FORE, STARBOARD))
    attitudes = run.messages("ship/attitude")
    invalid = [m for m in attitudes if m.status == Status.INVALID]
    claimed = [ns_from_stamp(m.header.stamp) for m in attitudes if m.status != Status.INVALID]
    assert len(invalid) >= 1
    decks = transforms(run.messages("/tf"))
    assert_for_tf2(decks)
    assert [ns_from_stamp(deck.header.stamp) for deck in decks] == claimed
    for attitude, in_degrees in zip(attitudes, run.messages("ship/attitude_deg"), strict=True):
        assert in_degrees.header == attitude.header
        assert in_degrees.status == attitude.status
        numbers = [
            in_degrees.heading_deg,
            in_degrees.pitch_deg,
            in_degrees.roll_deg,
            in_degrees.heading_95_arcsec,
            in_degrees.roll_95_arcsec,
        ]
        assert np.all(np.isnan(numbers)) == (attitude.status == Status.INVALID)


def test_stamps_continue_after_a_reset_and_restart_after_a_clock_jump():
    run = run_adapter(new_adapter(), voyage())
    run.adapter.service("reset", run.now_ns)
    hand_over(run, [a for a in voyage(7.0) if a.receive_ns > run.now_ns])
    assert_for_tf2(transforms(run.messages("/tf")))
    before = len(run.messages("/tf"))
    run.adapter.clock_jumped_back(START_NS)
    run.now_ns = START_NS
    hand_over(run, voyage())
    again = transforms(run.messages("/tf"))[before:]
    assert_for_tf2(again)
    assert ns_from_stamp(again[0].header.stamp) == START_NS


def test_degrees_and_95_percent():
    """1.96 sigma is also 95 % on page, alerts and report; the sigmas are those of ship/attitude."""
    run = fault_free_run()
    pairs = list(zip(run.messages("ship/attitude"), run.messages("ship/attitude_deg"), strict=True))
    assert len(pairs) > 100
    for attitude, in_degrees in pairs:
        angles = np.degrees([attitude.heading, attitude.pitch, attitude.roll])
        assert [in_degrees.heading_deg, in_degrees.pitch_deg, in_degrees.roll_deg] == pytest.approx(angles, rel=1e-15)
        arcsec = 1.96 * np.degrees(np.sqrt(np.asarray(attitude.covariance)[[0, 4, 8]])) * 3600.0
        found = [in_degrees.heading_95_arcsec, in_degrees.pitch_95_arcsec, in_degrees.roll_95_arcsec]
        assert found == pytest.approx(arcsec, rel=1e-12)


# -- the theodolite ---------------------------------------------------------------------------------------------


def replay_frames(folder: Path, changes=None):
    """Return topic → messages of both nodes, for ten seconds of the theodolite bag: ship/attitude by the INS alone."""
    part, out, suite = (
        write_beginning(THEODOLITE, folder / "part.mcap", 10.0),
        folder / "out.mcap",
        folder / "suite.yaml",
    )
    with read_bag(part) as bag:
        values = yaml.safe_load(bag.attachments[SUITE_ATTACHMENT].decode())
    values["/**/ship_attitude"] = {"ros__parameters": {"ins": {"frame_id": "ins"}}}
    values["/**/optical_axis"]["ros__parameters"]["ship"] |= changes or {}
    suite.write_text(yaml.safe_dump(values), encoding="utf-8")
    replay(part, out, ADAPTERS, suite)
    messages = defaultdict(list)
    with read_bag(out) as bag:
        for record in bag.records():
            messages[record.topic].append(record.decode())
        messages["latched"] = bag.latched_topics
    return messages


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    return replay_frames(tmp_path_factory.mktemp("both"))


def test_the_main_axis_is_published_with_each_pointing_below_the_deck(both):
    sent = transforms(both["/tf"])
    assert_for_tf2(sent)
    frames = {(t.header.frame_id, t.child_frame_id) for t in sent}
    assert frames == {("horizon", "deck"), ("deck", "theodolite_main")}
    pointings = by_stamp(m for m in both["theodolite/pointing"] if m.status != Status.INVALID)
    mains = [t for t in sent if t.child_frame_id == "theodolite_main"]
    assert [ns_from_stamp(t.header.stamp) for t in mains] == list(pointings)
    assert len(pointings) > 400
    # The bag's suite: 12 m forward, 3 m up, 2 m to port.
    places = {(t.transform.translation.x, t.transform.translation.y, t.transform.translation.z) for t in mains}
    assert places == {(12.0, 2.0, 3.0)}


def test_through_the_deck_as_tf2_interpolates_it_the_main_axis_is_the_pointing(both):
    """tf2 interpolates (slerp) between transforms; most readings are between two attitudes."""
    sent = transforms(both["/tf"])
    decks = {
        ns_from_stamp(t.header.stamp): rotation_from_message(t.transform.rotation)
        for t in sent
        if t.child_frame_id == "deck"
    }
    mains = {ns_from_stamp(t.header.stamp): t for t in sent if t.child_frame_id == "theodolite_main"}
    slerp = Slerp([ns - min(decks) for ns in decks], Rotation.concatenate(list(decks.values())))
    between = Counter()
    for ns, pointing in by_stamp(both["theodolite/pointing"]).items():
        if pointing.status == Status.INVALID:
            continue
        chain = slerp(ns - min(decks)) * rotation_from_message(mains[ns].transform.rotation)
        published = ros_rotation(pointing.azimuth, pointing.elevation, pointing.image_rotation)
        assert angle_between(chain, published) < BEYOND_ROUNDING
        between[ns in decks] += 1
    assert between[False] > 100
    assert between[True] > 50


def test_a_bag_of_a_replay_has_the_latched_frames_of_the_live_node(both):
    assert both["latched"] >= {"/tf_static"}
    assert "/tf" not in both["latched"]


def test_by_the_ins_alone_the_parent_of_the_main_axis_is_the_horizon(tmp_path):
    """The deck on /tf is not the attitude of the INS: as a child of this deck, the axis would have the INS's errors."""
    replayed = replay_frames(tmp_path, {"source": "ins/imu", "frame_id": ""})
    mains = [t for t in transforms(replayed["/tf"]) if t.child_frame_id == "theodolite_main"]
    pointings = by_stamp(m for m in replayed["theodolite/pointing"] if m.status != Status.INVALID)
    assert [ns_from_stamp(t.header.stamp) for t in mains] == list(pointings)
    for main, pointing in zip(mains, pointings.values(), strict=True):
        assert main.header.frame_id == "horizon"
        published = ros_rotation(pointing.azimuth, pointing.elevation, pointing.image_rotation)
        assert angle_between(rotation_from_message(main.transform.rotation), published) < BEYOND_ROUNDING


def test_no_transform_is_published_for_an_invalid_pointing():
    adapter = voyage_of("optical_axis").new_adapter()
    published = [*adapter.tick(START_NS), *adapter.tick(START_NS + 2 * SECOND_NS)]
    assert {m.status for topic, m in published if topic == "theodolite/pointing"} == {Status.INVALID}
    assert not [topic for topic, _ in published if topic.startswith("/tf")]


@pytest.mark.live
def test_late_subscribers_receive_the_sensor_frames(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain, received = free_domain_id(), []
    command = [*executable("ship_attitude_star", "ship_attitude"), "--ros-args", "--params-file"]
    command += [str(ROOT / "examples" / "two_sensors.yaml"), "-p", "slow_topics_period_s:=60.0"]
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    environment = live_environment(domain, tmp_path)
    with GraphObserver(domain) as observer, LiveProcess(command, tmp_path / "node.log", environment) as process:
        observer.node.create_subscription(TFMessage, "/tf_static", received.append, latched)
        assert observer.spin_until(lambda: received, 60.0), process.log_text()
        # The node publishes /tf_static again only after a minute: this subscriber receives the latched message.
        observer.node.create_subscription(TFMessage, "/tf_static", received.append, latched)
        assert observer.spin_until(lambda: len(received) > 1), process.log_text()
        assert process.end() == 0
    assert {(t.header.frame_id, t.child_frame_id) for t in received[1].transforms} == {
        ("deck", "star_fore"), ("deck", "star_starboard"),
    }  # fmt: skip
    assert received[1] == received[0]

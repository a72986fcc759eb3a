"""Bag writer: the same bytes each time, complete files only, readable by other programs."""

import itertools
import json
import os
import random
import struct

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.mcap_writer import CHUNK_BYTES
from ship_bags.mcap.recover import recover
from ship_bags.stamps import NS_PER_S
from ship_testing.hand_made_bags import FACTORY, PERIOD_NS, START_NS, imu, vector, write_imu_bag

HOUR_NS = 3_600_000_000_000


def test_same_calls_same_bytes(tmp_path):
    first, second = (write_imu_bag(tmp_path / name, attachments=[("suite.yaml", "a: 1\n")]) for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_the_file_is_renamed_only_when_complete(tmp_path):
    path = tmp_path / "voyage.mcap"
    with BagWriter(path) as bag:
        bag.write("ins/imu", imu(START_NS), START_NS)
        assert not path.exists()
    assert path.exists()
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_remains_after_an_error(tmp_path):
    bag = BagWriter(tmp_path / "voyage.mcap")
    with pytest.raises(AttributeError), bag:
        bag.write("ins/imu", "not a message", START_NS)
    assert list(tmp_path.iterdir()) == []


def test_flushed_messages_can_be_read_while_the_bag_is_still_open(tmp_path):
    path = tmp_path / "running.mcap"
    bag = BagWriter(path, atomic=False)
    for number in range(10):
        bag.write("ins/imu", imu(START_NS + number), START_NS + number)
    bag.flush()
    with read_bag(path) as running:
        assert sum(1 for _ in running.records()) == 10
    bag.close()


@pytest.mark.parametrize("seed", range(30))
def test_a_flipped_bit_in_an_unflushed_bag_loses_one_second(tmp_path, seed):
    """All ten seconds of the bag would fit into one chunk by their size."""
    data = bytearray(write_imu_bag(tmp_path / "voyage.mcap", count=1000).read_bytes())
    draw = random.Random(seed)
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    (tmp_path / "voyage.mcap").write_bytes(data)
    with read_bag(tmp_path / "voyage.mcap") as bag:
        found = {record.log_time_ns for record in bag.records()}
        problems = bag.problems
    lost = sorted(set(range(START_NS, START_NS + 1000 * PERIOD_NS, PERIOD_NS)) - found)
    assert not lost or (lost[-1] - lost[0] <= 1_000_000_000 and problems)


@pytest.mark.parametrize("finished", [False, True], ids=["killed", "finished"])
def test_recording_with_a_clock_step_back_and_an_oversized_message(tmp_path, finished):
    """The recording is kept in order of arrival, read in order of log time, and unchanged by a recovery."""
    bag = BagWriter(tmp_path / "voyage.mcap", atomic=False)
    log_times = [*range(0, 3 * HOUR_NS, HOUR_NS // 2), *range(0, 3 * HOUR_NS, HOUR_NS // 2), 10 * HOUR_NS]
    for number, time_ns in enumerate(log_times):
        size = 3 * CHUNK_BYTES if number in (4, 9) else 50
        bag.write_raw("topic", "std_msgs/msg/String", struct.pack("<I", number) + bytes(size), START_NS + time_ns)
        if number % 5 == 4:
            bag.flush()
    bag.flush()
    path = tmp_path / "copy.mcap"
    path.write_bytes((tmp_path / "voyage.mcap").read_bytes())
    bag.close()
    recovery = recover(path, tmp_path / "whole.mcap")
    assert recovery.counts.total() == len(log_times)
    for name in ("whole.mcap", "voyage.mcap" if finished else "copy.mcap"):
        with read_bag(tmp_path / name) as read:
            in_file = [(record.log_time_ns - START_NS, record.data[0]) for record in read.records_in_file_order()]
            in_time = [(record.log_time_ns - START_NS, record.data[0]) for record in read.records()]
        assert in_file == [(time_ns, number) for number, time_ns in enumerate(log_times)]
        assert in_time == sorted(in_file)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_many_messages_are_written_as_one_after_another(tmp_path, seed):
    """Chunks end at their size limit, and when time advances or goes back by a second."""
    rng, count = np.random.default_rng(seed), 400
    steps_ns = rng.integers(0, 20_000_000, count)
    steps_ns[rng.integers(0, count, 5)] += rng.integers(-3, 4, 5) * NS_PER_S
    times_ns = 1_400_000_000 * NS_PER_S + np.cumsum(steps_ns)
    lengths = rng.integers(0, 300_000 if seed % 2 else 500, count)
    data = [b"\x00\x01\x00\x00" + rng.bytes(int(length)) for length in lengths]
    topics = [("a", "std_msgs/msg/String"), ("b", "sensor_msgs/msg/Imu"), ("c", "std_msgs/msg/String")]
    of_topic = rng.integers(0, len(topics), count)
    parts = [slice(start, end) for start, end in itertools.pairwise([0, *sorted(rng.integers(1, count, 4)), count])]
    for name in ("one", "many"):
        with BagWriter(tmp_path / f"{name}.mcap") as writer:
            for topic in topics:
                writer.add_topic(*topic)
            if name == "one":
                for number, content, time_ns in zip(of_topic.tolist(), data, times_ns.tolist(), strict=True):
                    writer.write_raw(*topics[number], content, time_ns)
            else:
                for part in parts:
                    writer.write_many(topics, of_topic[part], data[part], times_ns[part])
            assert writer.message_count == count
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "many.mcap").read_bytes()


def test_many_messages_make_the_topics_that_are_not_announced(tmp_path):
    topics = [("a", "std_msgs/msg/String"), ("b", "sensor_msgs/msg/Imu")]
    with BagWriter(tmp_path / "many.mcap") as writer:
        writer.write_many(topics, np.array([1, 1]), [b"one", b"two"], np.array([START_NS, START_NS + 1]))
        writer.write_many(topics, np.array([0, 1]), [b"three", b"four"], np.array([START_NS + 2, START_NS + 3]))
        with pytest.raises(BadInput, match="carries"):
            writer.write_many([("a", "sensor_msgs/msg/Imu")], np.array([0]), [b"five"], np.array([START_NS]))
    with read_bag(tmp_path / "many.mcap") as bag:
        found = [(one.topic, one.sequence, bytes(one.data)) for one in bag.records()]
    assert found == [("b", 1, b"one"), ("b", 2, b"two"), ("a", 1, b"three"), ("b", 3, b"four")]


def test_another_type_on_a_topic_is_refused(tmp_path):
    with BagWriter(tmp_path / "voyage.mcap") as bag:
        bag.write("ins/imu", imu(START_NS), START_NS)
        with pytest.raises(BadInput, match=r"'ins/imu' carries sensor_msgs/msg/Imu, not geometry_msgs/msg/Vector3"):
            bag.write("ins/imu", vector(), START_NS)
        with pytest.raises(BadInput, match="message type x_msgs/msg/X is unknown"):
            bag.write_raw("x", "x_msgs/msg/X", b"", START_NS)


def test_a_folder_that_is_not_there_is_bad_input(tmp_path):
    with pytest.raises(BadInput, match=r"none/voyage\.mcap: cannot be written: No such file"):
        BagWriter(tmp_path / "none" / "voyage.mcap")


def test_other_readers_understand_the_bag(tmp_path):
    """The mcap project's reader and ROS 2 decoder read the bag; the decoder uses only the embedded definition."""
    path = write_imu_bag(tmp_path / "voyage.mcap", count=3)
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        decoded = list(reader.iter_decoded_messages())
    assert len(decoded) == 3
    schema, channel, message, content = decoded[2]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("sensor_msgs/msg/Imu", "ros2msg", "cdr")
    assert content.header.frame_id == "ins"
    assert content.header.stamp.sec * 10**9 + content.header.stamp.nanosec == message.log_time == START_NS + 20_000_000


@pytest.mark.parametrize(("latched", "durability"), [(False, "volatile"), (True, "transient_local")])
def test_quality_of_service_is_stored_as_by_rosbag2(tmp_path, latched, durability):
    path = tmp_path / "voyage.mcap"
    with BagWriter(path) as bag:
        bag.add_topic("v", "geometry_msgs/msg/Vector3", latched)
        bag.write("v", FACTORY.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0), START_NS)
    with open(path, "rb") as file:
        (channel,) = make_reader(file).get_summary().channels.values()
    (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert profile["durability"] == durability
    assert profile["reliability"] == "reliable"
    assert profile["deadline"] == {"sec": 9223372036, "nsec": 854775807}
    # From the type description of geometry_msgs/msg/Vector3 that ROS 2 Jazzy installs.
    assert channel.metadata["topic_type_hash"] == (
        "RIHS01_cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d"
    )


def test_attachments_and_metadata_come_back(tmp_path):
    path = tmp_path / "voyage.mcap"
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", "a: 1\n")
        bag.add_attachment("raw", b"\x00\xff", "application/octet-stream")
        bag.add_metadata("import_nmea", {"time": "instrument"})
        bag.write("v", vector(), START_NS)
    with read_bag(path) as bag:
        assert bag.attachments == {"suite.yaml": b"a: 1\n", "raw": b"\x00\xff"}
        assert json.dumps(bag.metadata) == '{"import_nmea": {"time": "instrument"}}'


@pytest.mark.parametrize("options", [{}, {"atomic": False}, {"atomic": False, "exclusive": True}], ids=str)
@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o007, 0o660)])
def test_a_file_has_the_rights_that_the_umask_leaves(tmp_path, options, mask, mode):
    before = os.umask(mask)
    try:
        BagWriter(tmp_path / "a.mcap", **options).close()
    finally:
        os.umask(before)
    assert (tmp_path / "a.mcap").stat().st_mode & 0o777 == mode

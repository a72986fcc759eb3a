"""rosbag2 folders: split by size and time, with an information file that lists every file at any time."""

import time

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import serialize
from ship_bags.stamps import NS_PER_S
from ship_testing.hand_made_bags import START_NS, imu, vector
from ship_testing.rosbag2_folders import information, rosbags_times

IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3"
PERIOD_NS = 10_000_000


def write(bag, numbers, topic="/ins/imu"):
    for number in numbers:
        bag.write_raw(topic, IMU, serialize(imu(START_NS + number * PERIOD_NS)), START_NS + number * PERIOD_NS)


def test_a_new_file_begins_by_size_and_rosbags_reads_them_as_one(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    bag.add_topic("/ins/imu", IMU)
    bag.add_topic("/ship/calibration", "geometry_msgs/msg/Vector3", latched=True)
    for part in range(20):
        write(bag, range(part * 10, part * 10 + 10))
        bag.flush()
    bag.close()
    metadata = information(tmp_path / "voyage")
    names = metadata["relative_file_paths"]
    assert len(names) > 2
    assert names == [f"voyage_{number}.mcap" for number in range(len(names))]
    # A file goes beyond the limit by one flush at most, and by its summary.
    assert all((tmp_path / "voyage" / name).stat().st_size < 3000 + 6000 for name in names)
    assert (metadata["version"], metadata["storage_identifier"], metadata["message_count"]) == (9, "mcap", 200)
    assert metadata["starting_time"]["nanoseconds_since_epoch"] == START_NS
    assert metadata["duration"]["nanoseconds"] == 199 * PERIOD_NS
    assert sum(file["message_count"] for file in metadata["files"]) == 200
    imu_topic, latched_topic = metadata["topics_with_message_count"]
    assert (imu_topic["topic_metadata"]["name"], imu_topic["message_count"]) == ("/ins/imu", 200)
    assert latched_topic["topic_metadata"]["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert imu_topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    expected = [START_NS + number * PERIOD_NS for number in range(200)]
    assert rosbags_times(tmp_path / "voyage") == expected
    # Each file is also read alone by the seeking reader, with the definitions in the file.
    alone = []
    for name in names:
        with open(tmp_path / "voyage" / name, "rb") as stream:
            for schema, _, message in make_reader(stream, validate_crcs=True).iter_messages():
                assert b"MSG: geometry_msgs/Quaternion" in schema.data
                alone.append(message.log_time)
    assert alone == expected
    with AnyReader([tmp_path / "voyage"]) as reader:
        connection, _, data = next(reader.messages())
        assert reader.deserialize(data, connection.msgtype).header.frame_id == "ins"


def test_a_new_file_begins_by_time(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(time_s=0.2))
    for number in range(3):
        write(bag, [number])
        bag.flush()
        time.sleep(0.25)
        bag.flush()
    bag.close()
    counts = [file["message_count"] for file in information(tmp_path / "voyage")["files"]]
    # The last file was started at the end of the third message's period.
    assert counts == [1, 1, 1, 0]
    assert len(rosbags_times(tmp_path / "voyage")) == 3


def test_no_new_file_without_messages(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(time_s=1e-6))
    for _ in range(5):
        bag.flush()
    bag.close()
    assert information(tmp_path / "voyage")["relative_file_paths"] == ["voyage_0.mcap"]


def test_the_information_file_lists_every_file_while_recording(tmp_path):
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    for part in range(12):
        write(bag, range(part * 10, part * 10 + 10))
        bag.flush()
        there = sorted(path.name for path in (tmp_path / "voyage").glob("*.mcap"))
        assert sorted(information(tmp_path / "voyage")["relative_file_paths"]) == there
        with read_bag(tmp_path / "voyage") as running:
            assert sum(1 for _ in running.records()) == part * 10 + 10
    bag.close()


def test_an_existing_folder_is_not_changed(tmp_path):
    with pytest.raises(BadInput, match="cannot be made: File exists"):
        FolderWriter(tmp_path, SplitLimits())


def test_every_file_repeats_the_latched_messages_and_the_bag_has_each_once(tmp_path):
    """Two nodes publish one message each on one topic; another topic has one message."""
    bag = FolderWriter(tmp_path / "voyage", SplitLimits(size_bytes=3000))
    for topic in ("/tf_static", "/ship/calibration"):
        bag.add_topic(topic, VECTOR, latched=True)
    latched = [("/tf_static", 1.0), ("/tf_static", 2.0), ("/ship/calibration", 3.0)]
    for number, (topic, value) in enumerate(latched):
        bag.write_raw(topic, VECTOR, serialize(vector(value)), START_NS + number)
    for part in range(12):
        write(bag, range(part * 10 + 1, part * 10 + 11))
        bag.flush()
    bag.close()
    with read_bag(tmp_path / "voyage") as whole:
        given = [(r.topic, r.decode().x) for r in whole.records({"/tf_static", "/ship/calibration"})]
        assert given == latched
        assert sum(1 for _ in whole.records_in_file_order()) == 123
    names = information(tmp_path / "voyage")["relative_file_paths"]
    assert len(names) > 2
    for name in names[:-1]:
        with read_bag(tmp_path / "voyage" / name) as alone:
            records = list(alone.records())
            assert [(r.topic, r.decode().x) for r in records if r.topic != "/ins/imu"] == latched
            # A player of this file alone must not wait for hours after the repeated messages.
            assert records[-1].log_time_ns - records[0].log_time_ns < 2 * NS_PER_S

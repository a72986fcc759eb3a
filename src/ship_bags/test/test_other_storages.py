"""Bags of other storages and programs: sqlite3, compressed folders, ROS 1, other definitions and encapsulations."""

import subprocess

import pytest
from mcap.writer import Writer

from ship_bags.commands.info import main as info
from ship_bags.errors import BadInput
from ship_bags.mcap import rosbags_file
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import definition, serialize
from ship_testing.hand_made_bags import START_NS, imu, vector

IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3"
PERIOD_NS = 100_000_000
COUNT = 45
CONVERSIONS = {
    "sqlite3": ["--dst-storage", "sqlite3"],
    "file": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "file"],
    "message": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "message"],
    "sqlite3 message": ["--dst-storage", "sqlite3", "--compress", "zstd", "--compress-mode", "message"],
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Write a folder with an INS and a latched topic, split into files."""
    folder = tmp_path_factory.mktemp("plain") / "voyage"
    bag = FolderWriter(folder, SplitLimits(size_bytes=3000))
    bag.add_topic("/ship/lever", VECTOR, latched=True)
    for number in range(COUNT):
        bag.write_raw("/ins/imu", IMU, serialize(imu(START_NS + number * PERIOD_NS)), START_NS + number * PERIOD_NS)
        bag.flush()
    bag.write_raw("/ship/lever", VECTOR, serialize(vector()), START_NS + COUNT * PERIOD_NS)
    bag.close()
    return folder


def contents(path):
    with read_bag(path) as bag:
        records = [(record.topic, record.log_time_ns, bytes(record.data)) for record in bag.records()]
        return records, bag.latched_topics, bag.problems


@pytest.fixture(params=CONVERSIONS)
def converted_bag(request, plain, tmp_path):
    """Convert the plain bag to another storage with rosbags-convert."""
    command = ["rosbags-convert", "--src", plain, "--dst", tmp_path / "other", *CONVERSIONS[request.param]]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    return tmp_path / "other"


def test_other_storages_are_read_the_same(plain, converted_bag, capsys):
    assert contents(converted_bag) == contents(plain)
    with read_bag(converted_bag) as bag:
        since_ns = START_NS + 40 * PERIOD_NS
        assert next(bag.records({"/ins/imu"}, since_ns)).log_time_ns == since_ns
        last = bag.last_before("/ins/imu", START_NS + 10 * PERIOD_NS)
        assert last.log_time_ns == START_NS + 9 * PERIOD_NS
        assert last.decode().header.frame_id == "ins"
    assert info([str(converted_bag)]) == 0
    assert "/ins/imu" in capsys.readouterr().out


def test_a_file_of_sqlite3_is_read_by_itself(plain, tmp_path):
    command = ["rosbags-convert", "--src", plain, "--dst", tmp_path / "other", *CONVERSIONS["sqlite3"]]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    assert contents(tmp_path / "other" / "other.db3")[0] == contents(plain)[0]


def test_a_damaged_file_of_sqlite3_is_one_line(plain, tmp_path):
    (tmp_path / "a.db3").write_bytes(b"SQLite format 3\0" + bytes(5000))
    with pytest.raises(BadInput, match=r"a\.db3: cannot be read by rosbags: "):
        read_bag(tmp_path / "a.db3")


def test_a_message_that_decompresses_beyond_the_limit_is_not_read(plain, tmp_path, monkeypatch):
    monkeypatch.setattr(rosbags_file, "MAX_CHUNK_BYTES", 200)
    command = ["rosbags-convert", "--src", plain, "--dst", tmp_path / "other", *CONVERSIONS["message"]]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    with pytest.raises(BadInput, match=r"cannot be read: a message decompresses to more than 256 MB"):
        read_bag(tmp_path / "other")


def test_files_too_large_for_the_temporary_folder_are_refused(plain, tmp_path):
    command = ["rosbags-convert", "--src", plain, "--dst", tmp_path / "other", *CONVERSIONS["file"]]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    (part, *_) = (tmp_path / "other").glob("*.zstd")
    # The header of a zstd frame that states a content size of 2^60 bytes.
    part.write_bytes(b"\x28\xb5\x2f\xfd\xe0" + (2**60).to_bytes(8, "little") + bytes(8))
    with pytest.raises(BadInput, match=r"other: needs 1152921504607 MB: .* set TMPDIR to another folder"):
        read_bag(tmp_path / "other")


def test_a_bag_of_ros_1_names_the_command_that_converts_it(tmp_path):
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    expected = f"a bag of ROS 1: rosbags-convert --src {tmp_path}/old.bag --dst {tmp_path}/old makes a rosbag2 folder"
    with pytest.raises(BadInput) as refused:
        read_bag(tmp_path / "old.bag")
    assert expected in str(refused.value)


def write_bag(path, topics):
    """Write a bag of an INS and other topics: name → type, definition, bytes of its messages."""
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        for topic, (type_name, text, data) in topics.items():
            schema = writer.register_schema(type_name, "ros2msg", text.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for number in range(3):
                writer.add_message(channel, START_NS + number, data, START_NS + number)
        writer.finish()
    return path


@pytest.mark.parametrize("text", ["float64 [", "other_msgs/Missing part", "\0", "std_msgs/Header header\nclass def"])
def test_an_unreadable_definition_affects_only_its_topic(tmp_path, text):
    good = (IMU, definition(IMU), serialize(imu(START_NS)))
    bag = write_bag(tmp_path / "a.mcap", {"/strange": ("x_msgs/msg/X", text, bytes(12)), "/ins/imu": good})
    records, _, problems = contents(bag)
    assert [record[0] for record in records] == ["/ins/imu"] * 3
    (problem,) = problems
    assert problem.startswith("a.mcap: topic '/strange' is skipped: ")


def test_windows_line_ends_in_a_definition_are_read(tmp_path):
    text = definition(IMU).replace("\n", "\r\n")
    bag = write_bag(tmp_path / "a.mcap", {"/ins/imu": (IMU, text, serialize(imu(START_NS)))})
    with read_bag(bag) as content:
        assert [record.decode().header.frame_id for record in content.records()] == ["ins"] * 3
        assert content.differences == {}


def test_xcdr2_is_read_if_the_padding_is_the_same(tmp_path):
    data = bytes(serialize(imu(START_NS)))
    bag = write_bag(tmp_path / "a.mcap", {"/ins/imu": (IMU, definition(IMU), b"\0\7" + data[2:])})
    with read_bag(bag) as content:
        assert [bytes(record.data) for record in content.records()] == [data] * 3

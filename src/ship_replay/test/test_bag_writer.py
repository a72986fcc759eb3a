"""What the writer promises: the same bytes each time, whole files only, readable by others."""

import json

import pytest
import yaml
from hand_made_bags import FACTORY, START_NS, imu, vector, write_imu_bag
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ship_replay.bag_reader import read_bag
from ship_replay.bag_writer import BagWriter
from ship_replay.errors import BadInput


def test_same_calls_same_bytes(tmp_path):
    first, second = (write_imu_bag(tmp_path / name, attachments=[("suite.yaml", "a: 1\n")]) for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_the_file_has_its_name_only_when_it_is_whole(tmp_path):
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
    """The mcap project's own reader and its ROS 2 decoder, which works from the embedded definition alone."""
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
def test_quality_of_service_is_noted_as_rosbag2_does(tmp_path, latched, durability):
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

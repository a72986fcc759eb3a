"""Content of a bag, and extraction of its suite file."""

import json
from pathlib import Path

import pytest

from ship_bags.commands.info import bag_content, main
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import serialize
from ship_testing.hand_made_bags import START_NS, imu, write_imu_bag

ROOT = Path(__file__).parents[3]
DEMO = ROOT / "bags" / "demo.mcap"


def output_of(arguments, capsys):
    assert main([str(argument) for argument in arguments]) == 0
    return capsys.readouterr().out


def refusal(arguments, capsys):
    assert main([str(argument) for argument in arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def row(text, topic):
    (found,) = [line.split() for line in text.splitlines() if line.startswith(f"{topic} ")]
    return found


def test_a_bag_of_the_repository(capsys):
    text = output_of([DEMO], capsys)
    # 120 s at 100 Hz, from the scenario; the mcap project's own tool counts the same.
    assert row(text, "ins/imu")[1:4] == ["sensor_msgs/msg/Imu", "12001", "100"]
    assert "2014-07-09T11:50:07.800Z to 2014-07-09T11:52:07.817Z, 120.017 s" in text
    assert f"{DEMO.stat().st_size} bytes, 14627 messages" in text
    assert "attached: suite.yaml" in text
    assert "attached: scenario.yaml, 1538 bytes, the scenario of a simulated bag" in text
    assert "metadata: simulation: seed=1" in text
    assert text.splitlines()[-1] == "complete: footer, index and checksums are valid"


def test_json_has_the_same_numbers(capsys):
    document = json.loads(output_of([DEMO, "--json"], capsys))
    topics = {topic["name"]: topic for topic in document["topics"]}
    assert topics["ins/imu"]["message_count"] == 12_001
    assert topics["ins/imu"]["rate_hz"] == pytest.approx(100.0, rel=1e-3)
    assert document["start_ns"] == 1_404_906_607_800_000_000
    assert document["problems"] == []


def test_a_truncated_bag_is_counted_up_to_the_cut(tmp_path, capsys):
    data = DEMO.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    text = output_of([tmp_path / "cut.mcap"], capsys)
    assert "problem: cut.mcap: no footer, it ends or is damaged at byte" in text
    assert "complete:" not in text
    count = int(row(text, "ins/imu")[2])
    assert 1000 < count < 12_001
    assert f"{bag_content(tmp_path / 'cut.mcap').message_count} messages could be read" in text


@pytest.mark.parametrize("cut", [209_815, 500_000])
def test_a_cut_within_an_index_is_no_damage(cut, tmp_path, capsys):
    """Bytes of a truncated index look like the header of an attachment."""
    (tmp_path / "cut.mcap").write_bytes(DEMO.read_bytes()[:cut])
    problems = [line for line in output_of([tmp_path / "cut.mcap"], capsys).splitlines() if line.startswith("problem:")]
    assert len(problems) == 1
    assert "no footer, it ends or is damaged at byte" in problems[0]


def test_a_damaged_chunk_is_named(tmp_path, capsys):
    data = bytearray(DEMO.read_bytes())
    data[len(data) // 3] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    text = output_of([tmp_path / "bad.mcap"], capsys)
    assert "problem: bad.mcap: the chunk at byte" in text
    assert int(row(text, "ins/imu")[2]) < 12_001


def test_a_bag_without_index(tmp_path, capsys):
    data = DEMO.read_bytes()
    (tmp_path / "tail.mcap").write_bytes(data[:-100])
    text = output_of([tmp_path / "tail.mcap"], capsys)
    assert row(text, "ins/imu")[2] == "12001"
    assert "problem: tail.mcap:" in text


def test_a_bag_without_messages(tmp_path, capsys):
    with BagWriter(tmp_path / "empty.mcap") as bag:
        bag.add_topic("ins/imu", "sensor_msgs/msg/Imu")
    text = output_of([tmp_path / "empty.mcap"], capsys)
    assert "0 messages" in text
    assert row(text, "ins/imu")[2:] == ["0", "-", "-", "-"]


def test_a_folder_is_one_bag(tmp_path, capsys):
    bag = FolderWriter(tmp_path / "folder", SplitLimits(size_bytes=1))
    for number in range(3):
        bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", serialize(imu(START_NS)), START_NS + number * 10_000_000)
        bag.flush()
    bag.close()
    text = output_of([tmp_path / "folder"], capsys)
    assert row(text, "ins/imu")[2:] == ["3", "100", "0.000", "0.020"]
    assert "files, 3 messages" in text


@pytest.mark.parametrize("content", [b"", b"no bag at all, but a text\n"])
def test_a_file_that_is_not_a_bag_is_refused(content, tmp_path, capsys):
    (tmp_path / "a.mcap").write_bytes(content)
    assert "a.mcap: " in refusal([tmp_path / "a.mcap"], capsys)


def test_a_missing_file_is_refused(tmp_path, capsys):
    assert refusal([tmp_path / "none.mcap"], capsys).endswith("none.mcap: no such file or folder")


def test_the_suite_file_comes_out_byte_for_byte(tmp_path, capfdbinary):
    suite = "a: ψ\n# ends without a line end".encode()
    write_imu_bag(tmp_path / "a.mcap", 3, attachments=[(SUITE_ATTACHMENT, suite)])
    assert main([str(tmp_path / "a.mcap"), "--suite"]) == 0
    assert capfdbinary.readouterr().out == suite
    assert main([str(tmp_path / "a.mcap"), "--suite", str(tmp_path / "out.yaml")]) == 0
    assert (tmp_path / "out.yaml").read_bytes() == suite


def test_a_suite_file_is_overwritten_only_with_force(tmp_path, capsys):
    (tmp_path / "out.yaml").write_text("precious")
    line = refusal([DEMO, "--suite", tmp_path / "out.yaml"], capsys)
    assert line.endswith("out.yaml: already exists: use --force to overwrite")
    assert (tmp_path / "out.yaml").read_text() == "precious"
    assert main([str(DEMO), "--suite", str(tmp_path / "out.yaml"), "--force"]) == 0
    assert "ship_attitude" in (tmp_path / "out.yaml").read_text()


def test_a_bag_without_a_suite_file_lists_its_attachments(tmp_path, capsys):
    write_imu_bag(tmp_path / "a.mcap", 3, attachments=[("notes.txt", "rain")])
    line = refusal([tmp_path / "a.mcap", "--suite"], capsys)
    assert "a.mcap: no suite file (suite.yaml) is attached to it, only notes.txt: " in line
    assert line.endswith("take the file with which the nodes ran, and give it to replay by --config")
    write_imu_bag(tmp_path / "b.mcap", 3)
    line = refusal([tmp_path / "b.mcap", "--suite"], capsys)
    assert "b.mcap: no suite file (suite.yaml) is attached to it: take" in line


def test_a_long_metadata_entry_is_shown_by_its_length(tmp_path, capsys):
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("a", imu(START_NS), START_NS)
        bag.add_metadata("rosbag2", {"ROS_DISTRO": "jazzy", "serialized_metadata": "version: 9\n" * 1000})
    lines = output_of([tmp_path / "a.mcap"], capsys).splitlines()
    assert "metadata: rosbag2: ROS_DISTRO=jazzy, serialized_metadata=(11000 characters)" in lines


def test_control_characters_of_a_bag_do_not_reach_the_terminal(tmp_path, capsys):
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("\x1b[31mred", imu(START_NS), START_NS)
        bag.add_metadata("note\x1b", {"key": "\x07"})
    text = output_of([tmp_path / "a.mcap"], capsys)
    assert "\x1b" not in text
    assert "\x07" not in text

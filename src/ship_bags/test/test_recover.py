"""Recovery of damaged and unfinished bags: only the damaged chunk is lost, and it is named."""

import random
from collections import Counter
from pathlib import Path

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from ship_bags.commands.record import main
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.mcap.recover import recover, recovered_path
from ship_bags.stamps import utc_text
from ship_testing.every_case import check_every_case
from ship_testing.hand_made_bags import START_NS, imu, vector
from ship_testing.mcap_places import places

CHUNKS = 30
PER_CHUNK = 10
PERIOD_NS = 10_000_000


@pytest.fixture(scope="module")
def unfinished_recording(tmp_path_factory):
    """Return the bytes of a recording of two topics, 300 messages in 30 flushed chunks, after a kill."""
    path = tmp_path_factory.mktemp("recording") / "voyage.mcap"
    bag = BagWriter(path, atomic=False)
    bag.add_attachment("suite.yaml", "ship_attitude: {}\n")
    for number in range(CHUNKS * PER_CHUNK):
        time_ns = START_NS + number * PERIOD_NS
        if number % 2:
            bag.write("ship/lever", vector(float(number)), time_ns)
        else:
            bag.write("ins/imu", imu(time_ns), time_ns)
        if number % PER_CHUNK == PER_CHUNK - 1:
            bag.flush()
    data = path.read_bytes()
    bag.close()
    return data


def by_mcap(path):
    with open(path, "rb") as stream:
        return sorted(
            (message.log_time, channel.topic, bytes(message.data))
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        )


def by_rosbags(path):
    with Reader(path) as reader:
        return sorted((time_ns, connection.topic, bytes(data)) for connection, time_ns, data in reader.messages())


def original(unfinished_recording, tmp_path):
    path = tmp_path / "original.mcap"
    path.write_bytes(unfinished_recording)
    with read_bag(path) as bag:
        found = [(record.log_time_ns, record.topic, bytes(record.data)) for record in bag.records()]
    assert len(found) == CHUNKS * PER_CHUNK
    return found


def test_an_unfinished_file_is_read_by_both_readers_after_recovery(unfinished_recording, tmp_path):
    source = tmp_path / "voyage.mcap"
    source.write_bytes(unfinished_recording)
    recovery = recover(source, recovered_path(source))
    assert recovery.path == tmp_path / "voyage.recovered.mcap"
    assert recovery.counts == Counter({"ins/imu": 150, "ship/lever": 150})
    expected = original(unfinished_recording, tmp_path)
    assert by_mcap(recovery.path) == by_rosbags(recovery.path) == sorted(expected)
    assert source.read_bytes() == unfinished_recording
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "original.mcap",
        "voyage.mcap",
        "voyage.recovered.mcap",
    ]
    with open(recovery.path, "rb") as stream:
        reader = make_reader(stream)
        assert [(record.name, record.data) for record in reader.iter_attachments()] == [
            ("suite.yaml", b"ship_attitude: {}\n")
        ]
        (note,) = reader.iter_metadata()
        assert note.metadata["from"] == "voyage.mcap"
        assert "no footer" in note.metadata["1"]
        channels = reader.get_summary().channels.values()
        assert all("durability: volatile" in channel.metadata["offered_qos_profiles"] for channel in channels)


def test_a_finished_recording_needs_no_recovery(unfinished_recording, tmp_path):
    """The writer stores each schema and channel twice, inside a chunk and after it; no reader is disturbed by this."""
    path = tmp_path / "whole.mcap"
    path.write_bytes(finished_bytes(unfinished_recording, tmp_path))
    assert by_mcap(path) == by_rosbags(path) == sorted(original(unfinished_recording, tmp_path))
    with read_bag(path) as bag:
        assert sum(1 for _ in bag.records()) == CHUNKS * PER_CHUNK
        assert bag.problems == []


@pytest.mark.parametrize("seed", range(20))
def test_a_truncated_file_gives_every_complete_chunk(unfinished_recording, tmp_path, seed):
    cut = random.Random(seed).randrange(places(unfinished_recording)[3][0], len(unfinished_recording))
    whole = sum(
        opcode == Opcode.CHUNK and offset + length <= cut for offset, opcode, length in places(unfinished_recording)
    )
    source = tmp_path / "voyage.mcap"
    source.write_bytes(unfinished_recording[:cut])
    if whole == 0:
        with pytest.raises(BadInput, match="no message reached the disk"):
            recover(source, recovered_path(source))
        return
    recovery = recover(source, recovered_path(source))
    expected = original(unfinished_recording, tmp_path)[: whole * PER_CHUNK]
    assert by_mcap(recovery.path) == by_rosbags(recovery.path) == sorted(expected)


@pytest.mark.slow
@pytest.mark.parametrize("finished", [False, True], ids=["killed", "finished"])
def test_a_flipped_bit_loses_and_names_only_its_chunk(unfinished_recording, tmp_path, finished):
    whole = finished_bytes(unfinished_recording, tmp_path) if finished else unfinished_recording

    def check(seed):
        check_a_flipped_bit(seed, whole, unfinished_recording, tmp_path)

    check_every_case([(seed,) for seed in range(50)], check)


def check_a_flipped_bit(seed, whole, unfinished_recording, tmp_path):
    folder = tmp_path / f"seed_{seed}"
    folder.mkdir()
    source = folder / "voyage.mcap"
    data = bytearray(whole)
    draw = random.Random(seed)
    position = draw.randrange(len(data))
    data[position] ^= 1 << draw.randrange(8)
    source.write_bytes(data)
    recovery = recover(source, recovered_path(source))
    found = by_mcap(recovery.path)
    assert found == by_rosbags(recovery.path)
    expected = original(unfinished_recording, tmp_path)
    lost = hit_messages(unfinished_recording, expected, position)
    if len(found) < len(expected):
        assert found == sorted(message for message in expected if message not in lost)
        assert names_time_range(recovery.problems, lost), recovery.problems
    else:
        # The bit is outside the chunks, or in a field that is not needed to read the chunk.
        assert found == sorted(expected)


@pytest.mark.parametrize("part", ["opcode", "length", "start time", "checksum", "data"])
def test_damage_in_the_first_chunk_with_the_definitions(unfinished_recording, tmp_path, part):
    offset = next(offset for offset, opcode, _ in places(unfinished_recording) if opcode == Opcode.CHUNK)
    data = bytearray(unfinished_recording)
    data[offset + {"opcode": 0, "length": 2, "start time": 12, "checksum": 34, "data": 90}[part]] ^= 0x10
    source = tmp_path / "voyage.mcap"
    source.write_bytes(data)
    recovery = recover(source, recovered_path(source))
    expected = original(unfinished_recording, tmp_path)
    # The start time of a chunk also follows from its messages.
    lost = 0 if part == "start time" else PER_CHUNK
    assert by_mcap(recovery.path) == sorted(expected[lost:])


@pytest.mark.parametrize("byte", range(9))
def test_any_wrong_byte_in_headers_and_between_chunks(unfinished_recording, tmp_path, byte):
    """A wrong opcode or length of the third chunk, or of a record after it, loses no message of another chunk."""
    chunks = [number for number, (_, opcode, _) in enumerate(places(unfinished_recording)) if opcode == Opcode.CHUNK]
    expected = original(unfinished_recording, tmp_path)
    for offset, opcode, _ in places(unfinished_recording)[chunks[2] : chunks[3]]:
        for bit in range(8):
            data = bytearray(unfinished_recording)
            data[offset + byte] ^= 1 << bit
            source = tmp_path / "voyage.mcap"
            source.write_bytes(data)
            with read_bag(source) as bag:
                found = [(record.log_time_ns, record.topic, bytes(record.data)) for record in bag.records()]
                problems = bag.problems
            lost = expected[2 * PER_CHUNK : 3 * PER_CHUNK] if opcode == Opcode.CHUNK else []
            assert found == [message for message in expected if message not in lost], (offset, bit)
            assert any(f"bytes {offset} to " in line for line in problems), (offset, bit)


def finished_bytes(unfinished_recording, folder):
    """Return the same recording, finished, with its small chunks."""
    path = folder / "finished.mcap"
    bag = BagWriter(path, atomic=False)
    bag.add_attachment("suite.yaml", "ship_attitude: {}\n")
    for number, (time_ns, topic, data) in enumerate(original(unfinished_recording, folder)):
        kind = "geometry_msgs/msg/Vector3" if topic == "ship/lever" else "sensor_msgs/msg/Imu"
        bag.write_raw(topic, kind, data, time_ns)
        if number % PER_CHUNK == PER_CHUNK - 1:
            bag.flush()
    bag.close()
    data = path.read_bytes()
    assert data[: len(unfinished_recording)] == unfinished_recording
    return data


def hit_messages(unfinished_recording, expected, position):
    """Return the messages of the chunk at a byte."""
    chunks = [(offset, length) for offset, opcode, length in places(unfinished_recording) if opcode == Opcode.CHUNK]
    for number, (offset, length) in enumerate(chunks):
        if offset <= position < offset + length:
            return expected[number * PER_CHUNK : (number + 1) * PER_CHUNK]
    return []


def names_time_range(problems, lost):
    """Return True if a line names the chunk's times, or those of its neighbours if its header is damaged."""
    start_ns, end_ns = lost[0][0], lost[-1][0]
    before = "the start" if start_ns == START_NS else utc_text(start_ns - PERIOD_NS)
    ranges = [
        f"messages from {utc_text(start_ns)} to {utc_text(end_ns)} are lost",
        f"messages between {before} and {utc_text(end_ns + PERIOD_NS)} are lost",
        f"messages between {before} and the end are lost",
    ]
    return any(text in line for line in problems for text in ranges)


def killed_folder(path):
    """Write 240 messages into a folder of several files, the last one unfinished; return the file names."""
    bag = FolderWriter(path, SplitLimits(size_bytes=4000))
    for number in range(240):
        time_ns = START_NS + number * PERIOD_NS
        bag.add_topic("ins/imu", "sensor_msgs/msg/Imu") if number == 0 else None
        bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", serialized_imu(time_ns), time_ns)
        if number % PER_CHUNK == PER_CHUNK - 1:
            bag.flush()
    bag.flush()
    return [information.name for information in bag.files]


def serialized_imu(time_ns):
    from ship_bags.message_store import serialize

    return serialize(imu(time_ns))


def test_a_folder_becomes_a_folder_that_rosbags_reads(tmp_path):
    names = killed_folder(tmp_path / "voyage")
    assert len(names) > 2
    with pytest.raises(Exception, match=r"end magic|footer"), Reader(tmp_path / "voyage"):
        pass
    assert main(["--recover", str(tmp_path / "voyage")]) == 0
    target = tmp_path / "voyage.recovered"
    assert len(by_rosbags(target)) == 240
    information = yaml.safe_load((target / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["message_count"] == 240
    # The last file holds no message yet when the one before has just been finished.
    assert information["relative_file_paths"] in (names, names[:-1])
    with read_bag(target) as bag:
        assert sum(1 for _ in bag.records()) == 240
        assert bag.problems == []


class TestCommand:
    def test_several_files_with_an_invalid_one(self, unfinished_recording, tmp_path, capsys):
        for name in ("a.mcap", "c.mcap"):
            (tmp_path / name).write_bytes(unfinished_recording)
        (tmp_path / "b.mcap").write_bytes(b"SQLite format 3\x00" * 10)
        assert main(["--recover", *(str(tmp_path / name) for name in ("a.mcap", "b.mcap", "c.mcap"))]) == 2
        printed = capsys.readouterr()
        assert printed.err == f"record: {tmp_path}/b.mcap: not an MCAP file\n"
        assert printed.out.count("300 messages on 2 topics, all read back by mcap and rosbags") == 2
        assert not (tmp_path / "b.recovered.mcap").exists()

    def test_nothing_is_overwritten(self, unfinished_recording, tmp_path, capsys):
        source = tmp_path / "a.mcap"
        source.write_bytes(unfinished_recording)
        for target in (tmp_path / "b.mcap", source):
            if target != source:
                target.write_bytes(b"precious")
            before = target.read_bytes()
            assert main(["--recover", str(source), "--out", str(target)]) == 2
            assert "already exists" in capsys.readouterr().err
            assert target.read_bytes() == before

    @pytest.mark.parametrize(
        ("content", "expected"),
        [(None, "No such file"), (b"", "the file is empty"), (b"\x89MCAP0\r\n", "no message reached the disk")],
    )
    def test_nothing_to_recover(self, tmp_path, capsys, content, expected):
        source = tmp_path / "a.mcap"
        if content is not None:
            source.write_bytes(content)
        assert main(["--recover", str(source)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert str(source) in error
        assert expected in error

    def test_one_name_for_several_results(self, capsys):
        with pytest.raises(SystemExit) as left:
            main(["--recover", "a.mcap", "b.mcap", "--out", "c.mcap"])
        assert left.value.code == 2
        assert "--out names one result" in capsys.readouterr().err


def test_a_result_that_fails_the_read_back_is_discarded(unfinished_recording, tmp_path, monkeypatch):
    """A disk that stores other bytes: one byte of the copy is changed."""
    source = tmp_path / "voyage.mcap"
    source.write_bytes(unfinished_recording)
    replaced = []
    from ship_bags.mcap import recover as module

    read = module._read_by_mcap

    def read_spoiled(path: Path):
        data = bytearray(path.read_bytes())
        offset = next(offset for offset, opcode, _ in places(bytes(data[:-8])) if opcode == Opcode.CHUNK)
        data[offset + 200] ^= 1
        path.write_bytes(data)
        replaced.append(path)
        return read(path)

    monkeypatch.setattr(module, "_read_by_mcap", read_spoiled)
    assert main(["--recover", str(source)]) == 2
    assert replaced
    assert [path.name for path in tmp_path.iterdir()] == ["voyage.mcap"]

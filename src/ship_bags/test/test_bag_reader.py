"""Bag reader: order, split, overlapping, truncated, damaged and invalid bags."""

import gc
import io
import random
import struct
import tracemalloc

import pytest
import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import definition, serialize
from ship_bags.stamps import utc_text
from ship_testing.hand_made_bags import START_NS, imu, write_imu_bag

IMU = "sensor_msgs/msg/Imu"
VECTOR = "geometry_msgs/msg/Vector3"


def write_numbered(path, log_times, topics=("a",), **options):
    """Write Vector3 messages (x = index in ``log_times``) with the mcap project's writer, in small chunks."""
    options = {"chunk_size": 1500, **options}
    with open(path, "wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(VECTOR, "ros2msg", definition(VECTOR).encode())
        channels = [writer.register_channel(topic, "cdr", schema) for topic in topics]
        for number, log_time in enumerate(log_times):
            data = b"\x00\x01\x00\x00" + struct.pack("<3d", number, 0.0, 0.0)
            writer.add_message(channels[number % len(channels)], log_time, data, log_time)
        writer.finish()
    return path


def numbers(path):
    """Return (log time, x) of all messages as read, and the problems."""
    with read_bag(path) as bag:
        found = [(record.log_time_ns, int(record.decode().x)) for record in bag.records()]
        assert bag.message_count == len(found)
        return found, bag.problems


def chunk_offsets(data):
    """Return offset and length of each chunk record, by scanning the records."""
    offset, chunks = 8, []
    while offset < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if opcode == Opcode.CHUNK:
            chunks.append((offset, 9 + length))
        offset += 9 + length
    return chunks


def whole_messages(data):
    """Return the number of messages that the mcap project's StreamReader reads from a truncated file."""
    count = 0
    try:
        for record in StreamReader(io.BytesIO(data)).records:
            count += isinstance(record, Message)
    except (McapError, struct.error, zstandard.ZstdError):
        return count
    return count


MESSAGES = 300
TIMES = [START_NS + number * 10_000_000 for number in range(MESSAGES)]


@pytest.fixture
def bag_bytes(tmp_path):
    """Return a bag of twelve chunks."""
    return write_numbered(tmp_path / "whole.mcap", TIMES).read_bytes()


def shuffled_times(seed):
    """Return log times that increase by 10 ms but are up to 0.3 s out of order, with repetitions."""
    draw = random.Random(seed)
    return [START_NS + (10 * number + draw.randrange(0, 300, 10)) * 1_000_000 for number in range(2000)]


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_log_time_order_with_ties_in_order_of_the_file(tmp_path, compression):
    times = shuffled_times(1)
    found, problems = numbers(write_numbered(tmp_path / "bag.mcap", times, compression=compression))
    assert found == sorted((time, number) for number, time in enumerate(times))
    assert problems == []


def test_messages_outside_chunks(tmp_path):
    times = shuffled_times(2)
    found, _ = numbers(write_numbered(tmp_path / "bag.mcap", times, use_chunking=False))
    assert found == sorted((time, number) for number, time in enumerate(times))


def test_only_the_requested_topics(tmp_path):
    path = write_numbered(tmp_path / "bag.mcap", range(1, 31), topics=("a", "b", "c"))
    with read_bag(path) as bag:
        assert [record.log_time_ns for record in bag.records({"b"})] == list(range(2, 31, 3))
        assert bag.topics == {"a": VECTOR, "b": VECTOR, "c": VECTOR}
        assert (bag.start_ns, bag.end_ns) == (1, 30)


@pytest.mark.parametrize("use_index", [True, False])
@pytest.mark.parametrize("before", [0, 1, 40, 999, 5000])
def test_the_last_message_of_a_topic_before_a_time(tmp_path, before, use_index):
    rng = random.Random(before)
    times = [START_NS + number + rng.randrange(-30, 30) for number in range(1000)]
    index_types = IndexType.ALL if use_index else IndexType.ALL & ~IndexType.MESSAGE
    path = write_numbered(tmp_path / "bag.mcap", times, ("a", "b", "c"), index_types=index_types)
    before_ns = START_NS + before
    earlier = [(time, number) for number, time in enumerate(times) if time < before_ns and number % 3 == 1]
    with read_bag(path) as bag:
        found = bag.last_before("b", before_ns)
        assert (found and (found.log_time_ns, int(found.decode().x))) == (max(earlier) if earlier else None)
        assert bag.last_before("absent", before_ns) is None


def test_chunks_without_the_topics_are_not_read(tmp_path):
    with BagWriter(tmp_path / "bag.mcap") as writer:
        for second in range(100):  # a chunk each
            name = "rare" if second == 40 else "usual"
            writer.write(name, imu(START_NS + second * 2 * 10**9), START_NS + second * 2 * 10**9)
    with read_bag(tmp_path / "bag.mcap") as bag:
        read, original = [], bag._files[0].messages
        bag._files[0].messages = lambda place: read.append(place) or original(place)
        assert [record.log_time_ns for record in bag.records({"rare"})] == [START_NS + 80 * 10**9]
        assert len(read) == 1
        assert bag.last_before("rare", bag.end_ns).log_time_ns == START_NS + 80 * 10**9
        assert len(read) == 2
        assert len(list(bag.records())) == 100


@pytest.mark.parametrize("since", [0, 1, 500, 777, 1500])
def test_earlier_chunks_are_not_read(tmp_path, since):
    times = [time // 1_000_000 for time in shuffled_times(3)]
    since_ns = min(times) + since
    path = write_numbered(tmp_path / "bag.mcap", times)
    with read_bag(path) as bag:
        read, original = [], bag._files[0].messages
        bag._files[0].messages = lambda place: read.append(place) or original(place)
        found = [(record.log_time_ns, int(record.decode().x)) for record in bag.records(since_ns=since_ns)]
        assert all(place.end_ns >= since_ns for place in read)
    assert found == sorted((time, number) for number, time in enumerate(times) if time >= since_ns)


def test_memory_stays_small(tmp_path):
    """A chunk is read at its time, not before."""
    path = write_numbered(tmp_path / "bag.mcap", range(1, 20_001))
    with read_bag(path) as bag:
        chunks = [place for file in bag._files for place in file.chunks]
        assert len(chunks) > 100
        read, original = [], bag._files[0].messages
        bag._files[0].messages = lambda place: read.append(place) or original(place)
        records = bag.records()
        for _ in range(1000):
            next(records)
        # 25 messages a chunk.
        assert len(read) < 45


def folder_bag(path, parts, **information):
    path.mkdir()
    names = []
    for number, times in enumerate(parts):
        names.append(f"voyage_{number}.mcap")
        write_numbered(path / names[-1], times)
    content = {"storage_identifier": "mcap", "relative_file_paths": names, "compression_mode": "", **information}
    (path / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    return path


def test_rosbag2_folder_with_split_files(tmp_path):
    # The second file begins before the first ends; at equal times the first comes first.
    found, problems = numbers(folder_bag(tmp_path / "voyage", [[10, 20, 30], [25, 30, 40]]))
    assert [time for time, _ in found] == [10, 20, 25, 30, 30, 40]
    assert [number for _, number in found] == [0, 1, 0, 2, 1, 2]
    assert problems == []


@pytest.mark.parametrize("share", [0.2, 0.5, 0.77, 0.999])
def test_cut_file_gives_all_up_to_the_cut(tmp_path, bag_bytes, share):
    path = tmp_path / "cut.mcap"
    cut = bag_bytes[: int(len(bag_bytes) * share)]
    path.write_bytes(cut)
    expected = whole_messages(cut)
    assert expected > 0
    with read_bag(path) as bag:
        times = [record.log_time_ns for record in bag.records()]
        assert times == TIMES[:expected]
        (problem,) = bag.problems
        assert bag.last_time_ns == times[-1]
    assert "no footer" in problem or "summary" in problem
    assert f"{expected} messages could be read, the last at {utc_text(times[-1])}" in problem


class GrowingFile(io.BytesIO):
    """File that another program writes: whenever its end has been read, it grows."""

    def __init__(self, data, grown_by):
        super().__init__(data)
        self._grown_by = grown_by

    def seek(self, offset, whence=io.SEEK_SET):
        place = super().seek(offset, whence)
        if whence == io.SEEK_END:
            super().seek(0, io.SEEK_END)
            self.write(self._grown_by)
            super().seek(place)
        return place


@pytest.mark.parametrize("share", [0.2, 0.77])
@pytest.mark.parametrize("grown_by", ["a byte", "all the rest"])
def test_a_growing_file_gives_its_content_at_opening(
    tmp_path, bag_bytes, monkeypatch, share, grown_by
):
    length = int(len(bag_bytes) * share)
    there, rest = bag_bytes[:length], bag_bytes[length:]
    growing = GrowingFile(there, rest[:1] if grown_by == "a byte" else rest)
    monkeypatch.setattr("ship_bags.mcap.bag_file.open", lambda *_: growing, raising=False)
    with read_bag(tmp_path / "whole.mcap") as bag:
        assert [record.log_time_ns for record in bag.records()] == TIMES[: whole_messages(there)]
        (problem,) = bag.problems
    assert "no footer" in problem


def test_a_file_that_became_shorter_since_it_was_opened_has_no_whole_footer(tmp_path, bag_bytes, monkeypatch):
    shrunk = io.BytesIO(bag_bytes[:-3000])
    shrunk.seek = lambda *where: len(bag_bytes) if where == (0, io.SEEK_END) else io.BytesIO.seek(shrunk, *where)
    monkeypatch.setattr("ship_bags.mcap.bag_file.open", lambda *_: shrunk, raising=False)
    with read_bag(tmp_path / "whole.mcap") as bag:
        assert [record.log_time_ns for record in bag.records()] == TIMES[: whole_messages(bag_bytes[:-3000])]


def test_flipped_bits_in_a_chunk_lose_only_that_chunk(tmp_path, bag_bytes):
    chunks = chunk_offsets(bag_bytes)
    assert len(chunks) == 12
    path = tmp_path / "flipped.mcap"
    draw = random.Random(3)
    for offset, length in chunks:
        flipped = bytearray(bag_bytes)
        flipped[offset + 60 + draw.randrange(length - 60)] ^= 1 << draw.randrange(8)
        path.write_bytes(flipped)
        lost = {
            record.log_time
            for record in StreamReader(io.BytesIO(only_chunk(bag_bytes, offset, length)), skip_magic=True).records
            if isinstance(record, Message)
        }
        with read_bag(path) as bag:
            found = {record.log_time_ns for record in bag.records()}
            (problem,) = bag.problems
        assert len(found) + len(lost) == MESSAGES
        assert not found & lost
        assert f"chunk at byte {offset} is damaged" in problem
        assert "messages from 2023-11-14T22:13:2" in problem
        assert problem.endswith("are lost")


def only_chunk(data, offset, length):
    """Return one chunk and the end of a file, for the StreamReader."""
    footer = struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + b"\x89MCAP0\r\n"
    return data[offset : offset + length] + footer


@pytest.mark.parametrize("field_offset", [0, 4, 9 + 3, 9 + 8 + 3, 9 + 16 + 6, 9 + 28])
def test_flipped_bits_in_the_header_of_a_chunk(tmp_path, bag_bytes, field_offset):
    """Opcode, length, times, uncompressed size and compression: only that chunk is lost, no hang, no disorder."""
    offset, length = chunk_offsets(bag_bytes)[2]
    flipped = bytearray(bag_bytes)
    flipped[offset + field_offset] ^= 0x40
    path = tmp_path / "flipped.mcap"
    path.write_bytes(flipped)
    with read_bag(path) as bag:
        times = [record.log_time_ns for record in bag.records()]
        problems = bag.problems
    assert times == sorted(times)
    in_chunk = whole_messages(b"\x89MCAP0\r\n" + only_chunk(bag_bytes, offset, length))
    # The times in the chunk's header are also in the summary, which takes precedence: nothing is lost then.
    assert len(times) in (MESSAGES - in_chunk, MESSAGES)
    assert len(problems) == (0 if len(times) == MESSAGES else 1)


def test_flipped_bit_in_the_summary_loses_nothing(tmp_path, bag_bytes):
    flipped = bytearray(bag_bytes)
    flipped[-120] ^= 1
    path = tmp_path / "flipped.mcap"
    path.write_bytes(flipped)
    with read_bag(path) as bag:
        assert sum(1 for _ in bag.records()) == MESSAGES
        assert "its summary is missing or damaged; 300 messages" in bag.problems[0]


def test_every_byte_of_a_small_bag_may_be_wrong(tmp_path):
    """Any wrong byte causes no exception except BadInput, and no message that is not in the bag."""
    path = tmp_path / "small.mcap"
    data = write_numbered(path, range(1, 61)).read_bytes()
    truth = {(time, time - 1) for time in range(1, 61)}
    draw = random.Random(4)
    for position in draw.sample(range(len(data)), 600):
        flipped = bytearray(data)
        flipped[position] ^= 1 << draw.randrange(8)
        path.write_bytes(flipped)
        try:
            with read_bag(path) as bag:
                found = {(record.log_time_ns, int(record.decode().x)) for record in bag.records()}
        except BadInput:
            continue
        assert found <= truth, position


def test_unknown_encodings_are_skipped_by_name(tmp_path):
    path = tmp_path / "mixed.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        good = writer.register_schema(IMU, "ros2msg", definition(IMU).encode())
        proto = writer.register_schema("x.Proto", "protobuf", b"\x00")
        named = writer.register_schema("x_msgs/msg/X", "ros2msg", b"")
        channels = {
            "ins/imu": writer.register_channel("ins/imu", "cdr", good),
            "radar": writer.register_channel("radar", "protobuf", proto),
            "json": writer.register_channel("json", "json", good),
            "empty": writer.register_channel("empty", "cdr", named),
            "bare": writer.register_channel("bare", "cdr", 0),
        }
        for channel in channels.values():
            writer.add_message(channel, START_NS, serialize(imu(START_NS)), START_NS)
        writer.finish()
    with read_bag(path) as bag:
        assert [record.topic for record in bag.records()] == ["ins/imu"]
        assert bag.topics == {"ins/imu": IMU}
        assert set(bag.skipped_topics) == {"radar", "json", "empty", "bare"}
        assert any("topic 'radar' is skipped: message encoding 'protobuf' is unknown" in line for line in bag.problems)
        assert any("the definition of x_msgs/msg/X is not in the bag" in line for line in bag.problems)


def test_the_definition_in_the_bag_takes_precedence(tmp_path):
    """A bag of another version of the message is decoded by its own definition, and the difference reported."""
    path = tmp_path / "older.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(VECTOR, "ros2msg", b"float32 x\nfloat64 y\n")
        channel = writer.register_channel("v", "cdr", schema)
        writer.add_message(channel, 1, b"\x00\x01\x00\x00" + struct.pack("<f4xd", 1.5, 2.5), 1)
        writer.finish()
    with read_bag(path) as bag:
        (record,) = bag.records()
        assert (record.decode().x, record.decode().y) == (1.5, 2.5)
        assert any(f"{VECTOR}.x is float32 in the bag and float64 here" in line for line in bag.problems)
        assert any(f"{VECTOR}.z is missing in the bag" in line for line in bag.problems)


def test_bytes_that_are_not_the_message(tmp_path):
    path = tmp_path / "short.mcap"
    with BagWriter(path) as bag:
        bag.write_raw("ins/imu", IMU, serialize(imu(START_NS))[:50], START_NS)
    with read_bag(path) as bag:
        (record,) = bag.records()
        with pytest.raises(BadInput, match=rf"topic 'ins/imu' at 2023-11-14T22:13:20\.050Z: not a {IMU}"):
            record.decode()


def test_a_live_message_that_ends_with_an_empty_sequence_is_read(tmp_path):
    """rclpy writes the padding for missing elements, with undefined bytes."""
    from rclpy.serialization import serialize_message

    from ship_msgs.msg import InputHealth

    kind, health = "ship_msgs/msg/InputHealth", InputHealth(topic="ins/imu", received=7)
    path = tmp_path / "live.mcap"
    with BagWriter(path) as bag:
        bag.write_raw("input_health", kind, bytes(serialize_message(health)), START_NS)
    with read_bag(path) as bag:
        (record,) = bag.records()
        back = record.decode()
    assert (back.topic, back.received, list(back.reason_counts)) == ("ins/imu", 7, [])


def test_damaged_attachment_is_reported(tmp_path):
    path = write_imu_bag(tmp_path / "bag.mcap", 10, attachments=[("suite.yaml", "a: 12345\n")])
    path.write_bytes(path.read_bytes().replace(b"a: 12345", b"a: 12346"))
    with read_bag(path) as bag:
        assert bag.attachments == {}
        assert "attachment record is damaged" in bag.problems[0]


class TestBadInput:
    def assert_refused(self, path, match):
        with pytest.raises(BadInput, match=match) as caught:
            read_bag(path)
        assert str(path) in str(caught.value)

    def test_missing(self, tmp_path):
        self.assert_refused(tmp_path / "none.mcap", "no such file or folder")

    def test_empty(self, tmp_path):
        (tmp_path / "a.mcap").write_bytes(b"")
        self.assert_refused(tmp_path / "a.mcap", "the file is empty")

    def test_not_mcap(self, tmp_path):
        (tmp_path / "a.mcap").write_bytes(b"SQLite format 3\x00" * 10)
        self.assert_refused(tmp_path / "a.mcap", "not an MCAP file")

    def test_no_messages(self, tmp_path):
        self.assert_refused(write_numbered(tmp_path / "a.mcap", []), "the bag holds no messages")

    def test_only_the_magic(self, tmp_path):
        (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
        self.assert_refused(tmp_path / "a.mcap", "holds no messages .*no footer")

    def test_all_chunks_damaged(self, tmp_path):
        """The summary lists two chunks, none of which can be read."""
        path = write_numbered(tmp_path / "a.mcap", TIMES[:45])
        data = bytearray(path.read_bytes())
        chunks = chunk_offsets(data)
        assert len(chunks) == 2
        for offset, length in chunks:
            middle = offset + length // 2
            data[middle : middle + 20] = bytes(20)
        path.write_bytes(data)
        text = "holds no messages that can be read .*the chunk at byte .* is damaged .*the chunk at byte"
        self.assert_refused(path, text)

    def test_unknown_compression(self, tmp_path, monkeypatch):
        original = Chunk.write

        def write(chunk, stream):
            chunk.compression = "bz2"
            original(chunk, stream)

        monkeypatch.setattr(Chunk, "write", write)
        self.assert_refused(write_numbered(tmp_path / "a.mcap", range(1, 99)), "compression 'bz2' is unknown")

    def test_folder_without_metadata(self, tmp_path):
        self.assert_refused(tmp_path, r"has no metadata\.yaml")

    def test_folder_of_another_storage(self, tmp_path):
        self.assert_refused(folder_bag(tmp_path / "a", [[1]], storage_identifier="x"), "'x': expected mcap or sqlite3")

    def test_compressed_folder(self, tmp_path):
        self.assert_refused(folder_bag(tmp_path / "a", [[1]], compression_mode="LZ4"), "compression_mode is 'lz4'")

    def test_folder_with_a_file_missing(self, tmp_path):
        path = folder_bag(tmp_path / "a", [[1], [2]])
        (path / "voyage_1.mcap").unlink()
        self.assert_refused(path, r"voyage_1\.mcap: cannot be read: No such file")

    def test_invalid_metadata(self, tmp_path):
        (tmp_path / "metadata.yaml").write_text("- a list\n")
        self.assert_refused(tmp_path, "not the information file of a rosbag2 bag")


def test_a_chunk_of_a_long_bag_takes_little_memory(tmp_path):
    count = 2000
    path = write_numbered(tmp_path / "long.mcap", range(8 * count), topics="abcdefgh", chunk_size=300)
    read_bag(path).close()
    gc.collect()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        with read_bag(path) as bag:
            held, _ = tracemalloc.get_traced_memory()
            assert sum(1 for _ in bag.records({"a"})) == count
    finally:
        tracemalloc.stop()
    # The reader stores neither the index offset of each channel nor a set of channels for each chunk.
    assert held - before < 300 * count

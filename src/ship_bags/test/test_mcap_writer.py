"""The MCAP writer writes the same bytes as the mcap project's writer, but needs no growing memory."""

import io
import random
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from ship_bags.mcap.mcap_writer import CHUNK_BYTES, McapWriter


class Reference:
    """The mcap project's writer with the methods of ``McapWriter``."""

    def __init__(self, stream: io.BytesIO) -> None:
        self._writer = Writer(stream)
        self._writer.start("ros2", "test")
        self.register_schema, self.register_channel = self._writer.register_schema, self._writer.register_channel
        self.add_metadata, self.finish = self._writer.add_metadata, self._writer.finish
        self.flush = self._writer.flush

    def add_message(self, channel: int, log_time_ns: int, data: bytes, publish_time_ns: int, sequence: int) -> None:
        """Apply the suite's additional rule: no chunk has more than one second."""
        chunk = self._writer._Writer__chunk_builder
        first_ns, last_ns = min(log_time_ns, chunk.message_start_time), max(log_time_ns, chunk.message_end_time)
        if chunk.num_messages and last_ns - first_ns > 1_000_000_000:
            self.flush()
        self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(0, 0, name, media_type, data)


def write_at_random(writer: McapWriter | Reference, seed: int, count: int) -> None:
    """Make ``count`` random calls: messages and definitions of all sizes, times that go back, chunks that overflow."""
    rng = random.Random(seed)
    channels: list[int] = []
    for _ in range(count):
        choice = rng.random()
        if choice < 0.1 or not channels:
            size = rng.choice([0, 3000, CHUNK_BYTES // 2])
            schema = writer.register_schema(f"schema {len(channels)}", "ros2msg", rng.randbytes(size))
            channels.append(writer.register_channel(f"topic {len(channels)}", "cdr", schema, {"key": "value"}))
        elif choice < 0.8:
            log_time_ns = rng.choice([0, 5, 10**18 + rng.randrange(1000), 10**18 + rng.randrange(3 * 10**9)])
            data = rng.randbytes(rng.choice([0, 5, 300, CHUNK_BYTES // 3]))
            writer.add_message(rng.choice(channels), log_time_ns, data, rng.randrange(10**18), rng.randrange(2**32))
        elif choice < 0.9:
            writer.flush()
        elif choice < 0.95:
            writer.add_attachment("name", "text/plain", rng.randbytes(50))
        else:
            writer.add_metadata("name", {"key": str(rng.random())})
    writer.finish()


@pytest.mark.parametrize(("seed", "count"), [(0, 0), (1, 1), *((seed, 60) for seed in range(2, 12))])
def test_the_same_bytes_as_the_projects_own_writer(tmp_path: Path, seed: int, count: int) -> None:
    ours, reference = io.BytesIO(), io.BytesIO()
    write_at_random(McapWriter(ours, tmp_path, "ros2", "test"), seed, count)
    write_at_random(Reference(reference), seed, count)
    assert ours.getvalue() == reference.getvalue()


def chunk_times(data: bytes) -> list[tuple[int, int]]:
    """Return first and last log time of each chunk, by its messages."""
    records = StreamReader(io.BytesIO(data), emit_chunks=True).records
    chunks = [record for record in records if isinstance(record, Chunk)]
    times = [[r.log_time for r in breakup_chunk(chunk, True) if isinstance(r, Message)] for chunk in chunks]
    return [(min(of_one), max(of_one)) for of_one in times]


def write_bag(tmp_path: Path, messages: list[tuple[int, int]]) -> bytes:
    """Write a file of messages given by log time and size, without a flush."""
    stream = io.BytesIO()
    writer = McapWriter(stream, tmp_path, "ros2", "test")
    channel = writer.register_channel("topic", "cdr", writer.register_schema("schema", "ros2msg", b""), {})
    for number, (time_ns, size) in enumerate(messages):
        writer.add_message(channel, time_ns, bytes(size), time_ns, number)
    writer.finish()
    return stream.getvalue()


SECOND_NS = 1_000_000_000


def test_no_chunk_has_more_than_one_second(tmp_path: Path) -> None:
    data = write_bag(tmp_path, [(10**18 + number * 10_000_000, 100) for number in range(1000)])
    found = chunk_times(data)
    assert len(found) == 10
    assert all(last_ns - first_ns <= SECOND_NS for first_ns, last_ns in found)
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    assert [message.sequence for _, _, message in reader.iter_messages()] == list(range(1000))


def test_a_clock_step_back_begins_a_new_chunk(tmp_path: Path) -> None:
    """No chunk spans the hour between the two times: reading in order of time keeps one chunk in memory."""
    times = [10**18 + number * 10_000_000 for number in range(150)]
    earlier = [time_ns - 3600 * SECOND_NS for time_ns in times]
    data = write_bag(tmp_path, [(time_ns, 10) for time_ns in times + earlier])
    found = chunk_times(data)
    assert len(found) == 4
    assert all(last_ns - first_ns <= SECOND_NS for first_ns, last_ns in found)
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    assert [message.sequence for _, _, message in reader.iter_messages()] == [*range(150, 300), *range(150)]


def test_an_oversized_message_ends_its_chunk_and_is_read(tmp_path: Path) -> None:
    sizes = [10, 3 * CHUNK_BYTES, 10, 3 * CHUNK_BYTES, 3 * CHUNK_BYTES, 10]
    data = write_bag(tmp_path, [(10**18 + number, size) for number, size in enumerate(sizes)])
    assert len(chunk_times(data)) == 4
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    assert [len(message.data) for _, _, message in reader.iter_messages()] == sizes


def test_many_chunks_need_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream, tmp_path, "ros2", "test")
        channel = writer.register_channel("topic", "cdr", writer.register_schema("schema", "ros2msg", b""), {})

        def write(numbers: range) -> None:
            for number in numbers:
                writer.add_message(channel, number, b"data", number, number)
                writer.flush()

        write(range(2000))
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        write(range(2000, 6000))
        after, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        # The project's writer keeps 700 bytes a chunk here: 2.8 MB.
        assert after - before < 100_000
        assert list(tmp_path.iterdir()) == [path]
        writer.finish()
    with path.open("rb") as stream:
        numbers = [message.sequence for _, _, message in make_reader(stream).iter_messages(topics="topic")]
    assert numbers == list(range(6000))

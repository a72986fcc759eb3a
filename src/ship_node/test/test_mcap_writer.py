"""Our writer of MCAP files against the mcap project's own: the same bytes, without its growth."""

import io
import random
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from ship_node.mcap_writer import CHUNK_BYTES, McapWriter


class Reference:
    """The project's writer with the calls of ours."""

    def __init__(self, stream: io.BytesIO) -> None:
        self._writer = Writer(stream)
        self._writer.start("ros2", "test")
        self.register_schema, self.register_channel = self._writer.register_schema, self._writer.register_channel
        self.add_message, self.add_metadata = self._writer.add_message, self._writer.add_metadata
        self.flush, self.finish = self._writer.flush, self._writer.finish

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(0, 0, name, media_type, data)


def write_at_random(writer: McapWriter | Reference, seed: int, count: int) -> None:
    """So many calls of all kinds; messages and definitions of all sizes, times that go back, chunks that overflow."""
    rng = random.Random(seed)
    channels: list[int] = []
    for _ in range(count):
        choice = rng.random()
        if choice < 0.1 or not channels:
            size = rng.choice([0, 3000, CHUNK_BYTES // 2])
            schema = writer.register_schema(f"schema {len(channels)}", "ros2msg", rng.randbytes(size))
            channels.append(writer.register_channel(f"topic {len(channels)}", "cdr", schema, {"key": "value"}))
        elif choice < 0.8:
            log_time_ns = rng.choice([0, 5, 10**18 + rng.randrange(1000)])
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


def test_many_chunks_cost_no_memory_and_no_file(tmp_path: Path) -> None:
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

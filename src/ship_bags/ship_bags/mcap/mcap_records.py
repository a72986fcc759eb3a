"""Records of an MCAP file by their place, and the messages of a chunk, with every damage found out."""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord, Message
from mcap.stream_reader import breakup_chunk

from ship_bags.stamps import END_OF_TIME_NS

COMPRESSIONS = ("", "zstd", "lz4")
"""Known here; the empty one is none."""

HEADER = struct.Struct("<BQ")
"""Opcode and length, before the body of each record."""

MAX_CHUNK_MB = 256
"""So much a chunk may hold, before compression. Writers make chunks of a few megabytes."""

MAX_CHUNK_RECORDS = 1_000_000
"""So many records: one without content takes twenty times its bytes in memory."""

_BYTES_PER_MB = 1_000_000
# A day of ticks may follow.
_LATEST_NS = END_OF_TIME_NS - 86_400_000_000_000
_MAX_CHUNK_BYTES = MAX_CHUNK_MB * _BYTES_PER_MB

Result = TypeVar("Result")


class DamagedChunk(Exception):
    """The bytes of a chunk are not what was written."""


@dataclass(frozen=True)
class ChunkPlace:
    """Where messages lie in a file: one chunk, or a run of messages outside any chunk.

    Attributes:
        offset: byte at which the first record begins.
        length: bytes up to the end of the last one.
        start_ns: earliest log time.
        end_ns: latest log time.
        loose: whether it is a run of messages outside any chunk.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    loose: bool = False


@dataclass(frozen=True)
class RecordFile:
    """The bytes of an MCAP file.

    Attributes:
        stream: the open file.
        size: its length in bytes.
    """

    stream: BinaryIO
    size: int

    def record_at(self, offset: int) -> tuple[int, bytes] | None:
        """Opcode and body of the record at an offset; None where it does not fit into the file."""
        self.stream.seek(offset)
        header = self.stream.read(HEADER.size)
        if len(header) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(header)
        if opcode == 0 or offset + HEADER.size + length > self.size:
            return None
        return opcode, self.stream.read(length)

    def records_of(self, place: ChunkPlace, check_times: bool = True) -> list[McapRecord]:
        """Records of one place, in file order.

        Args:
            place: where they lie.
            check_times: whether messages outside the times of the place make it damaged.

        Raises:
            DamagedChunk: it cannot be decompressed or parsed, its checksum is wrong, or its times are not those
                announced.
        """
        if place.loose:
            return _of_our_time(list(self._loose_messages(place)))
        record = self.record_at(place.offset)
        if record is None or record[0] != Opcode.CHUNK or len(record[1]) + HEADER.size != place.length:
            raise DamagedChunk("its header is wrong")
        chunk = _guarded(lambda: parsed(Chunk.read, record[1]))
        if chunk.compression not in COMPRESSIONS:
            raise DamagedChunk(f"compression {chunk.compression!r} is unknown")
        content = _unfolded(chunk)
        records = _guarded(lambda: breakup_chunk(replace(chunk, data=content, compression=""), validate_crc=True))
        times = [record.log_time for record in records if isinstance(record, Message)]
        if check_times and times and (min(times) < place.start_ns or max(times) > place.end_ns):
            raise DamagedChunk("its header has other times than its messages")
        return _of_our_time(records)

    def _loose_messages(self, place: ChunkPlace) -> Iterator[McapRecord]:
        offset = place.offset
        while offset < place.offset + place.length:
            record = self.record_at(offset)
            if record is None:
                raise DamagedChunk("it cannot be read")
            yield Message.read(ReadDataStream(io.BytesIO(record[1])), len(record[1]))
            offset += HEADER.size + len(record[1])


def parsed(read: Callable[[ReadDataStream], Result], body: bytes) -> Result:
    """A record from its body, by the ``read`` of its class."""
    return read(ReadDataStream(io.BytesIO(body)))


def _of_our_time(records: list[McapRecord]) -> list[McapRecord]:
    """The records, where a replay can give each of them its time.

    Raises:
        DamagedChunk: no stamp can carry a log time.
    """
    if any(isinstance(record, Message) and record.log_time >= _LATEST_NS for record in records):
        raise DamagedChunk("it has log times beyond the year 2038, which no stamp can carry")
    return records


def _unfolded(chunk: Chunk) -> bytes:
    """Content of a chunk; what its header and the compressed bytes say of its size is not believed.

    Raises:
        DamagedChunk: it cannot be decompressed, or holds more than it may.
    """
    if chunk.uncompressed_size > _MAX_CHUNK_BYTES:
        size_mb = chunk.uncompressed_size / _BYTES_PER_MB
        raise DamagedChunk(f"it says that it unfolds to {size_mb:.0f} MB: at most {MAX_CHUNK_MB} are taken")
    content = _guarded(lambda: _decompressed(chunk.compression, chunk.data))
    if len(content) > _MAX_CHUNK_BYTES:
        raise DamagedChunk(f"it unfolds to more than {MAX_CHUNK_MB} MB")
    if chunk.uncompressed_crc == 0 and len(content) != chunk.uncompressed_size:
        # Compressed bytes that are cut end without an error; a checksum would tell.
        raise DamagedChunk(f"it unfolds to {len(content)} bytes and says {chunk.uncompressed_size}")
    if _record_count(content) > MAX_CHUNK_RECORDS:
        raise DamagedChunk(f"it holds more than {MAX_CHUNK_RECORDS} records")
    return content


def _decompressed(compression: str, data: bytes) -> bytes:
    """Content of compressed bytes, up to one byte more than a chunk may hold."""
    if compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return stream.read(_MAX_CHUNK_BYTES + 1)
    if compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=_MAX_CHUNK_BYTES + 1)
    return data


def _record_count(content: bytes) -> int:
    """Records by their lengths, counted no further than one too many."""
    count = offset = 0
    while offset + HEADER.size <= len(content) and count <= MAX_CHUNK_RECORDS:
        offset += HEADER.size + HEADER.unpack_from(content, offset)[1]
        count += 1
    return count


def _guarded(parse: Callable[[], Result]) -> Result:
    try:
        return parse()
    except Exception as problem:
        # Damaged bytes make decompressor and parser fail in any way.
        raise DamagedChunk(str(problem) or type(problem).__name__) from problem

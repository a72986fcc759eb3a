"""Records of an MCAP file by their place, and the messages of a chunk, with every damage found out."""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord, Message
from mcap.stream_reader import breakup_chunk

COMPRESSIONS = ("", "zstd", "lz4")
"""Known here; the empty one is none."""

HEADER = struct.Struct("<BQ")
"""Opcode and length, before the body of each record."""

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
            return list(self._loose_messages(place))
        record = self.record_at(place.offset)
        if record is None or record[0] != Opcode.CHUNK or len(record[1]) + HEADER.size != place.length:
            raise DamagedChunk("its header is wrong")
        chunk = _guarded(lambda: parsed(Chunk.read, record[1]))
        if chunk.compression not in COMPRESSIONS:
            raise DamagedChunk(f"compression {chunk.compression!r} is unknown")
        records = _guarded(lambda: breakup_chunk(chunk, validate_crc=True))
        times = [record.log_time for record in records if isinstance(record, Message)]
        if check_times and times and (min(times) < place.start_ns or max(times) > place.end_ns):
            raise DamagedChunk("its header has other times than its messages")
        return records

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


def _guarded(parse: Callable[[], Result]) -> Result:
    try:
        return parse()
    except Exception as problem:
        # Damaged bytes make decompressor and parser fail in any way.
        raise DamagedChunk(str(problem) or type(problem).__name__) from problem

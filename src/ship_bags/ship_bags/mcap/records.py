"""Reader of the records of an MCAP file and of its chunks; damaged records are detected, skipped and reported.

:func:`records_of_chunk` returns the records in a chunk, with checks of the stated sizes, the checksum and the records.

:class:`RecordFile` returns the record at an offset and the records of a chunk. :func:`scan_records` yields the records
in order. The scan accepts a record only if the body has the structure of the opcode. After a damaged record the scan
continues at the next chunk, message index, metadata, attachment or end of data. Therefore one wrong bit costs at most
one record, and the schemas, channels and messages outside chunks before the place where the scan continues.
"""

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema

from ship_bags.stamps import END_OF_TIME_NS

COMPRESSIONS = ("", "zstd", "lz4")
"""Compressions that can be read; the empty name means none."""

HEADER = struct.Struct("<BQ")
"""Opcode and length, in front of the body of each record."""

MAX_CHUNK_MB = 256
"""Maximum size of a chunk before compression, MB. Writers make chunks of a few megabytes."""

MAX_CHUNK_RECORDS = 1_000_000
"""Maximum number of records in a chunk; an empty record takes twenty times its length in memory."""

_BYTES_PER_MB = 1_000_000
MAX_CHUNK_BYTES = MAX_CHUNK_MB * _BYTES_PER_MB
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_OTHERS_OF_CHUNK: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.CHANNEL: Channel.read, Opcode.SCHEMA: Schema.read
}

# Log times end a day earlier than stamps, because the ticks of a replay may continue for a day.
_LATEST_NS = END_OF_TIME_NS - 86_400_000_000_000

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MIN_ATTACHMENT_BYTES = 8 + 8 + 4 + 4 + 8 + 4
_STRUCTURES: dict[int, tuple[int, tuple[struct.Struct, ...]]] = {
    Opcode.CHUNK: (_CHUNK_HEAD.size, (_U32, _U64)),
    Opcode.SCHEMA: (_U16.size, (_U32, _U32, _U32)),
    Opcode.CHANNEL: (2 * _U16.size, (_U32, _U32, _U32)),
    Opcode.METADATA: (0, (_U32, _U32)),
    Opcode.HEADER: (0, (_U32, _U32)),
}
"""Opcode → size of the fields at the beginning of a body, and the sizes that state the lengths of the other fields."""

# Header of a record at which a scan may continue. Schemas, channels and messages are left out: inside a damaged
# uncompressed chunk they look valid, but no checksum protects them. The upper bytes of a length are zero in any file
# below a tebibyte.
_RESTART = re.compile(rb"[\x06\x07\x09\x0c\x0f].{5}\x00\x00\x00", re.DOTALL)
_WINDOW_BYTES = 1 << 20

Result = TypeVar("Result")


class DamagedChunk(Exception):
    """The bytes of a chunk are damaged."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Location of messages in a file: one chunk, or a run of messages outside any chunk.

    Attributes:
        offset: byte at which the first record begins.
        length: number of bytes up to the end of the last record.
        start_ns: earliest log time.
        end_ns: latest log time.
        is_outside_chunk: True for a run of messages outside any chunk.
        channels: channels with messages here, from the file's index; None if unknown.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    is_outside_chunk: bool = False
    channels: frozenset[int] | None = None


@dataclass(frozen=True)
class RecordFile:
    """Bytes of an MCAP file.

    Attributes:
        stream: the open file.
        size: length of the file, bytes.
    """

    stream: BinaryIO
    size: int

    def record_at(self, offset: int) -> tuple[int, bytes] | None:
        """Return opcode and body of the record at an offset; None if no complete record begins there."""
        self.stream.seek(offset)
        header = self.stream.read(HEADER.size)
        if len(header) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(header)
        if opcode == 0 or offset + HEADER.size + length > self.size:
            return None
        return opcode, self.stream.read(length)

    def records_of(self, place: ChunkPlace, check_times: bool = True) -> list[McapRecord]:
        """Return the records of one place, in file order.

        Args:
            place: location of the records.
            check_times: True if messages outside the times of the place mean damage.

        Raises:
            DamagedChunk: the chunk cannot be decompressed or parsed, its header or checksum is wrong, a message is
                outside the stated times, or a stamp cannot represent a log time.
        """
        if place.is_outside_chunk:
            return _check_log_times(list(self._messages_outside_chunks(place)))
        record = self.record_at(place.offset)
        if record is None or record[0] != Opcode.CHUNK or len(record[1]) + HEADER.size != place.length:
            raise DamagedChunk("its header is wrong")
        chunk = raise_damaged(lambda: parse_record(Chunk.read, record[1]))
        records = records_of_chunk(chunk)
        times = [record.log_time for record in records if isinstance(record, Message)]
        if check_times and times and (min(times) < place.start_ns or max(times) > place.end_ns):
            raise DamagedChunk("its header has other times than its messages")
        return _check_log_times(records)

    def _messages_outside_chunks(self, place: ChunkPlace) -> Iterator[McapRecord]:
        offset = place.offset
        while offset < place.offset + place.length:
            record = self.record_at(offset)
            if record is None:
                raise DamagedChunk("it cannot be read")
            yield Message.read(ReadDataStream(io.BytesIO(record[1])), len(record[1]))
            offset += HEADER.size + len(record[1])


@dataclass(frozen=True)
class ScannedRecord:
    """Valid record: its offset, opcode and body."""

    offset: int
    opcode: int
    body: bytes

    @property
    def length(self) -> int:
        """Length of header and body, bytes."""
        return HEADER.size + len(self.body)


@dataclass(frozen=True)
class Gap:
    """Bytes that are not a record: from `start` to `end`, or to the end of the file if `end` is None."""

    start: int
    end: int | None


def scan_records(data: RecordFile, offset: int) -> Iterator[ScannedRecord | Gap]:
    """Yield the records from an offset up to the end of the data section, of the readable part, or of the file.

    The last item is a record (DATA_END or FOOTER) in a finished file, otherwise a gap without end.
    """
    while True:
        record = _valid_record_at(data, offset)
        if record is None:
            after = _next_valid_offset(data, offset)
            yield Gap(offset, after)
            if after is None:
                return
            offset = after
            continue
        yield record
        if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        offset += record.length


def has_header(data: RecordFile, offset: int) -> bool:
    """Return True if a header record, with which every MCAP file begins, is at an offset."""
    record = _valid_record_at(data, offset)
    return record is not None and record.opcode == Opcode.HEADER


def is_stamp_time(log_time_ns: int) -> bool:
    """True if a stamp can represent a log time, and also the time a day later."""
    return 0 <= log_time_ns < _LATEST_NS


def _check_log_times(records: list[McapRecord]) -> list[McapRecord]:
    """Return the records if a replay can represent all log times.

    Raises:
        DamagedChunk: a stamp cannot represent a log time.
    """
    if any(isinstance(record, Message) and not is_stamp_time(record.log_time) for record in records):
        raise DamagedChunk("it has log times after the year 2038, which no stamp can represent")
    return records


def _valid_record_at(data: RecordFile, offset: int) -> ScannedRecord | None:
    found = data.record_at(offset)
    return ScannedRecord(offset, *found) if found is not None and _is_valid(*found) else None


def _next_valid_offset(data: RecordFile, damaged: int) -> int | None:
    """Return the offset of the next valid record after a damaged record, whose stated length may be wrong, too."""
    window_start = damaged + 1
    while window_start < data.size:
        data.stream.seek(window_start)
        window = data.stream.read(_WINDOW_BYTES + HEADER.size - 1)
        position = 0
        while (match := _RESTART.search(window, position)) is not None:
            if _can_continue_at(data, window_start + match.start()):
                return window_start + match.start()
            position = match.start() + 1
        window_start += _WINDOW_BYTES
    return None


def _can_continue_at(data: RecordFile, offset: int) -> bool:
    record = _valid_record_at(data, offset)
    if record is None or record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.HEADER):
        return False
    if record.opcode == Opcode.ATTACHMENT:
        # The bytes of a truncated index may look like the header of an attachment.
        return _is_whole_attachment(record.body)
    return record.opcode != Opcode.CHUNK or _compression(record.body) in COMPRESSIONS


def _is_whole_attachment(body: bytes) -> bool:
    """True if name, media type and content fill the body, and the checksum, if given, is right."""
    checksum = _U32.unpack_from(body, len(body) - _U32.size)[0]
    try:
        end = _end_of(body, 2 * _U64.size, (_U32, _U32, _U64)) + _U32.size
    except struct.error:
        return False
    return end == len(body) and checksum in (0, zlib.crc32(body[: -_U32.size]))


def _compression(chunk: bytes) -> str:
    length = _U32.unpack_from(chunk, _CHUNK_HEAD.size)[0]
    start = _CHUNK_HEAD.size + _U32.size
    return chunk[start : start + length].decode("latin-1")


def _is_valid(opcode: int, body: bytes) -> bool:
    """True if a body may be a record of an opcode: by its length for a message or attachment, else by its structure."""
    try:
        if opcode in _STRUCTURES:
            return _end_of(body, *_STRUCTURES[opcode]) == len(body)
        if opcode == Opcode.MESSAGE_INDEX:
            return _is_message_index(body)
        if opcode == Opcode.MESSAGE:
            # One wrong bit makes a message index look like a message.
            return len(body) >= _MESSAGE_HEAD.size and not _is_message_index(body)
    except struct.error:
        return False
    if opcode == Opcode.ATTACHMENT:
        return len(body) >= _MIN_ATTACHMENT_BYTES
    return (opcode, len(body)) in ((Opcode.DATA_END, 4), (Opcode.FOOTER, 20))


def _is_message_index(body: bytes) -> bool:
    entries_bytes: int = _U32.unpack_from(body, _U16.size)[0]
    return _U16.size + _U32.size + entries_bytes == len(body) and entries_bytes % 16 == 0


def _end_of(body: bytes, offset: int, sizes: tuple[struct.Struct, ...]) -> int:
    """Return the end of consecutive fields that each begin with their size."""
    for size in sizes:
        offset += size.size + size.unpack_from(body, offset)[0]
    return offset


def records_of_chunk(chunk: Chunk) -> list[McapRecord]:
    """Return the messages, channels and schemas of a chunk, in their order.

    Raises:
        DamagedChunk: the chunk cannot be decompressed or parsed, exceeds a limit, or its checksum is wrong.
    """
    if chunk.compression not in COMPRESSIONS:
        raise DamagedChunk(f"compression {chunk.compression!r} is unknown")
    content = _decompressed_content(chunk)
    return raise_damaged(lambda: _split(chunk, content))


def _decompressed_content(chunk: Chunk) -> bytes:
    """Return the decompressed content of a chunk; without a checksum its length must equal the stated length.

    Raises:
        DamagedChunk: the chunk cannot be decompressed, or exceeds a limit.
    """
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        size_mb = chunk.uncompressed_size / _BYTES_PER_MB
        raise DamagedChunk(f"its stated size is {size_mb:.0f} MB decompressed: at most {MAX_CHUNK_MB} are read")
    content = raise_damaged(lambda: decompress(chunk.compression, chunk.data))
    if len(content) > MAX_CHUNK_BYTES:
        raise DamagedChunk(f"it decompresses to more than {MAX_CHUNK_MB} MB")
    if chunk.uncompressed_crc == 0 and len(content) != chunk.uncompressed_size:
        # Truncated compressed bytes end without an error, which only a checksum or the length can reveal.
        raise DamagedChunk(f"it decompresses to {len(content)} bytes instead of {chunk.uncompressed_size}")
    if _record_count(content) > MAX_CHUNK_RECORDS:
        raise DamagedChunk(f"the chunk has more than {MAX_CHUNK_RECORDS} records")
    return content


def decompress(compression: str, data: bytes) -> bytes:
    """Return the content of compressed bytes, up to one byte more than the limit of a chunk.

    Bytes without compression are returned unchanged.
    """
    unfolded: bytes = data
    if compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            unfolded = stream.read(MAX_CHUNK_BYTES + 1)
    elif compression == "lz4":
        unfolded = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK_BYTES + 1)
    return unfolded


def _record_count(content: bytes) -> int:
    """Return the number of records by their lengths, at most one above the limit; 0 for a short content."""
    count = offset = 0
    if len(content) <= MAX_CHUNK_RECORDS * HEADER.size:
        return 0
    while offset + HEADER.size <= len(content) and count <= MAX_CHUNK_RECORDS:
        offset += HEADER.size + HEADER.unpack_from(content, offset)[1]
        count += 1
    return count


def _split(chunk: Chunk, content: bytes) -> list[McapRecord]:
    """Return the messages, channels and schemas of a chunk's content, in order; other records are skipped.

    The result equals that of mcap's ``breakup_chunk``, in less time.
    """
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise DamagedChunk("its checksum is wrong")
    records: list[McapRecord] = []
    offset = 0
    while offset < len(content):
        opcode, length = HEADER.unpack_from(content, offset)
        offset += HEADER.size
        end = offset + length
        if end > len(content) or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.size):
            raise DamagedChunk("a record in it is truncated")
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content, offset)
            data = content[offset + _MESSAGE_HEAD.size : end]
            records.append(Message(channel_id, log_time, data, publish_time, sequence))
        elif opcode in _OTHERS_OF_CHUNK:
            records.append(parse_record(_OTHERS_OF_CHUNK[opcode], content[offset:end]))
        offset = end
    return records


def parse_record(read: Callable[[ReadDataStream], Result], body: bytes) -> Result:
    """Return a record from its body, by the ``read`` method of its class."""
    return read(ReadDataStream(io.BytesIO(body)))


def raise_damaged(parse: Callable[[], Result]) -> Result:
    """Return the result of a parser; raise DamagedChunk for any exception."""
    try:
        return parse()
    except Exception as problem:
        # Decompressor and parser may raise anything for damaged bytes.
        raise DamagedChunk(str(problem) or type(problem).__name__) from problem

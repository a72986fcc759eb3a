"""Reader of the content of an MCAP chunk, with checks of the stated sizes, the checksum and the records."""

import io
import struct
import zlib
from collections.abc import Callable
from typing import TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema

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

Result = TypeVar("Result")


class DamagedChunk(Exception):
    """The bytes of a chunk are damaged."""


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

"""What a chunk of an MCAP file holds, unfolded without trusting it: no size, checksum or record that it states."""

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
"""Opcode and length, before the body of each record."""

MAX_CHUNK_MB = 256
"""The most that a chunk may hold, before compression. Writers make chunks of a few megabytes."""

MAX_CHUNK_RECORDS = 1_000_000
"""The most records that a chunk may hold: a record without content takes twenty times its bytes in memory."""

_BYTES_PER_MB = 1_000_000
MAX_CHUNK_BYTES = MAX_CHUNK_MB * _BYTES_PER_MB
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_OTHERS_OF_CHUNK: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.CHANNEL: Channel.read, Opcode.SCHEMA: Schema.read
}

Result = TypeVar("Result")


class DamagedChunk(Exception):
    """The bytes of a chunk are not what was written."""


def records_of_chunk(chunk: Chunk) -> list[McapRecord]:
    """The messages, channels and schemas of a chunk, in their order.

    Raises:
        DamagedChunk: it cannot be decompressed or parsed, holds more than it may, or its checksum is wrong.
    """
    if chunk.compression not in COMPRESSIONS:
        raise DamagedChunk(f"compression {chunk.compression!r} is unknown")
    content = _unfolded(chunk)
    return guarded(lambda: _split(chunk, content))


def _unfolded(chunk: Chunk) -> bytes:
    """Content of a chunk, decompressed. The sizes that its header and its bytes state are not trusted.

    Raises:
        DamagedChunk: it cannot be decompressed, or holds more than it may.
    """
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        size_mb = chunk.uncompressed_size / _BYTES_PER_MB
        raise DamagedChunk(f"it says that it unfolds to {size_mb:.0f} MB: at most {MAX_CHUNK_MB} are taken")
    content = guarded(lambda: decompressed(chunk.compression, chunk.data))
    if len(content) > MAX_CHUNK_BYTES:
        raise DamagedChunk(f"it unfolds to more than {MAX_CHUNK_MB} MB")
    if chunk.uncompressed_crc == 0 and len(content) != chunk.uncompressed_size:
        # Compressed bytes that are cut end without an error; here no checksum tells.
        raise DamagedChunk(f"it unfolds to {len(content)} bytes and says {chunk.uncompressed_size}")
    if _record_count(content) > MAX_CHUNK_RECORDS:
        raise DamagedChunk(f"it holds more than {MAX_CHUNK_RECORDS} records")
    return content


def decompressed(compression: str, data: bytes) -> bytes:
    """Content of compressed bytes, up to one byte more than a chunk may hold."""
    unfolded: bytes = data
    if compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            unfolded = stream.read(MAX_CHUNK_BYTES + 1)
    elif compression == "lz4":
        unfolded = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=MAX_CHUNK_BYTES + 1)
    return unfolded


def _record_count(content: bytes) -> int:
    """Records by their lengths, counted no further than one too many; 0 where there cannot be so many."""
    count = offset = 0
    if len(content) <= MAX_CHUNK_RECORDS * HEADER.size:
        return 0
    while offset + HEADER.size <= len(content) and count <= MAX_CHUNK_RECORDS:
        offset += HEADER.size + HEADER.unpack_from(content, offset)[1]
        count += 1
    return count


def _split(chunk: Chunk, content: bytes) -> list[McapRecord]:
    """The messages, channels and schemas in the content of a chunk, in their order; others are stepped over.

    It gives what ``breakup_chunk`` of mcap gives, in less time.
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
            raise DamagedChunk("a record in it is cut off")
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content, offset)
            data = content[offset + _MESSAGE_HEAD.size : end]
            records.append(Message(channel_id, log_time, data, publish_time, sequence))
        elif opcode in _OTHERS_OF_CHUNK:
            records.append(parsed(_OTHERS_OF_CHUNK[opcode], content[offset:end]))
        offset = end
    return records


def parsed(read: Callable[[ReadDataStream], Result], body: bytes) -> Result:
    """A record from its body, by the ``read`` of its class."""
    return read(ReadDataStream(io.BytesIO(body)))


def guarded(parse: Callable[[], Result]) -> Result:
    """What a parser gives; whatever it fails by is a damaged chunk."""
    try:
        return parse()
    except Exception as problem:
        # Decompressor and parser may fail in any way over damaged bytes.
        raise DamagedChunk(str(problem) or type(problem).__name__) from problem

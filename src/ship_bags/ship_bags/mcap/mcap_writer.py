"""Writer of MCAP records, with the same bytes as the writer of the mcap project if the chunks end at the same records.

The writer of the mcap project keeps an object for every chunk until the end, and takes several times as long per
message. A black box or a recorder writes up to fourteen chunks a second, for weeks, on the computer of an estimator
that needs the processor.
"""

import struct
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

CHUNK_BYTES = 1024 * 1024
"""Size at which a chunk ends, before compression, bytes."""

CHUNK_NS = 1_000_000_000
"""Maximum range of log times in a chunk, ns; one wrong bit costs no more than one chunk."""

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of every MCAP file."""

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD_BYTES = 2 + 4 + 8 + 8
_MESSAGE_HEADS = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""Headers of many messages."""
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_HEAD_BYTES = 2 + 4
_INDEX_ENTRY = struct.Struct("<QQ")
_FOOTER_HEAD = struct.Struct("<BQQQ")
_FOOTER_BYTES = 8 + 8 + 4
# The index takes a hundred bytes per chunk. An index up to this size is in memory; a larger index is in a file.
_INDEX_IN_MEMORY_BYTES = 1 << 16
_BLOCK_BYTES = 1 << 20


class McapWriter:
    """MCAP file being written: chunks with zstd and checksums, indexes and statistics at the end.

    Args:
        stream: stream for the whole file; it stays open.
        folder: folder for a temporary file without a name, which contains the index until the end.
        profile: profile of the header, e.g. ``ros2``.
        library: library of the header.
    """

    def __init__(self, stream: BinaryIO, folder: Path, profile: str, library: str) -> None:
        self._stream = stream
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._chunk_indexes = tempfile.SpooledTemporaryFile(max_size=_INDEX_IN_MEMORY_BYTES, dir=str(folder))  # noqa: SIM115
        self._chunk_count = 0
        self._message_counts: dict[int, int] = {}
        self._first_ns = self._last_ns = 0
        self._compressor = zstandard.ZstdCompressor(level=3)
        # Current chunk: its records, index entries of its messages by channel, and their earliest and latest times.
        self._chunk = bytearray()
        self._indexes: dict[int, bytearray] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        stream.write(MAGIC + _bytes_of(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message type; return its id."""
        self._schemas.append(Schema(len(self._schemas) + 1, data, encoding, name))
        self._add_to_chunk(_bytes_of(self._schemas[-1]))
        return len(self._schemas)

    def register_channel(self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str]) -> int:
        """Add a topic; return its id."""
        self._channels.append(Channel(len(self._channels) + 1, topic, message_encoding, metadata, schema_id))
        self._add_to_chunk(_bytes_of(self._channels[-1]))
        return len(self._channels)

    def add_message(
        self, channel_id: int, log_time_ns: int, data: bytes, publish_time_ns: int, sequence: int
    ) -> None:
        """Add a message to the chunk, or to a new chunk if its time is too far from the other messages."""
        if self._start_ns is not None and (
            log_time_ns - self._start_ns > CHUNK_NS or self._end_ns - log_time_ns > CHUNK_NS
        ):
            self._end_chunk()
        entries = self._indexes.get(channel_id)
        if entries is None:
            entries = self._indexes[channel_id] = bytearray()
        entries += _INDEX_ENTRY.pack(log_time_ns, len(self._chunk))
        length = _MESSAGE_HEAD_BYTES + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence, log_time_ns, publish_time_ns)
        if self._start_ns is None or log_time_ns < self._start_ns:
            self._start_ns = log_time_ns
        self._end_ns = max(self._end_ns, log_time_ns)
        self._message_counts[channel_id] = self._message_counts.get(channel_id, 0) + 1
        self._add_to_chunk(data)

    def add_messages(
        self,
        channel_ids: NDArray[np.int64],
        log_times_ns: NDArray[np.int64],
        data: Sequence[bytes],
        sequences: NDArray[np.int64],
    ) -> None:
        """Add messages one after another, as by :meth:`add_message`, with their log times as publish times.

        Args:
            channel_ids: channel of each message, shape (N,).
            log_times_ns: log time of each message, ns, shape (N,).
            data: data of each message.
            sequences: sequence number of each message, shape (N,).
        """
        lengths = np.fromiter(map(len, data), np.int64, len(data)) + _MESSAGE_HEAD_BYTES
        heads = np.empty(len(data), dtype=_MESSAGE_HEADS)
        heads["opcode"], heads["length"], heads["channel"], heads["sequence"] = (
            Opcode.MESSAGE, lengths, channel_ids, sequences
        )
        heads["log_time"] = heads["publish_time"] = log_times_ns
        content, size = heads.tobytes(), _MESSAGE_HEADS.itemsize
        records = [part for n, body in enumerate(data) for part in (content[size * n : size * n + size], body)]
        # The stated length counts the bytes after opcode and length.
        ends = np.cumsum(lengths + size - _MESSAGE_HEAD_BYTES)
        start = 0
        while start < len(data):
            stop = self._end_of_chunk(log_times_ns, ends, start)
            self._add_to_current_chunk(
                channel_ids, log_times_ns, ends, slice(start, stop), records[2 * start : 2 * stop]
            )
            start = stop

    def _end_of_chunk(self, log_times_ns: NDArray[np.int64], ends: NDArray[np.int64], start: int) -> int:
        """Return the index of the first message after the chunk to which message ``start`` belongs.

        If message ``start`` is too far in time from the current chunk, that chunk is ended first.
        """
        if self._start_ns is not None and (
            log_times_ns[start] - self._start_ns > CHUNK_NS or self._end_ns - log_times_ns[start] > CHUNK_NS
        ):
            self._end_chunk()
        first_ns = log_times_ns[start] if self._start_ns is None else self._start_ns
        times_ns = log_times_ns[start:]
        earliest_ns = np.minimum(np.minimum.accumulate(times_ns), first_ns)
        latest_ns = np.maximum(np.maximum.accumulate(times_ns), self._end_ns)
        # Each message is compared with the messages before it; the first message belongs to the chunk in any case.
        far = (times_ns[1:] - earliest_ns[:-1] > CHUNK_NS) | (latest_ns[:-1] - times_ns[1:] > CHUNK_NS)
        near = len(far) if not far.any() else int(np.argmax(far))
        before = int(ends[start - 1]) if start else 0
        room = int(np.searchsorted(ends[start:] - before, CHUNK_BYTES - len(self._chunk), side="right"))
        return start + min(near, room) + 1

    def _add_to_current_chunk(
        self,
        channel_ids: NDArray[np.int64],
        log_times_ns: NDArray[np.int64],
        ends: NDArray[np.int64],
        some: slice,
        records: Sequence[bytes],
    ) -> None:
        times_ns, channels = log_times_ns[some], channel_ids[some]
        before = int(ends[some.start - 1]) if some.start else 0
        entries = np.empty((len(times_ns), 2), dtype="<u8")
        entries[0, 1], entries[1:, 1] = len(self._chunk), len(self._chunk) + ends[some][:-1] - before
        entries[:, 0] = times_ns
        # The channels are in the order of their first messages, as when messages are added one by one.
        for channel_id in dict.fromkeys(channels.tolist()):
            of_channel = channels == channel_id
            self._indexes.setdefault(channel_id, bytearray()).extend(entries[of_channel].tobytes())
            self._message_counts[channel_id] = self._message_counts.get(channel_id, 0) + int(of_channel.sum())
        first_ns = int(times_ns.min())
        self._start_ns = first_ns if self._start_ns is None else min(self._start_ns, first_ns)
        self._end_ns = max(self._end_ns, int(times_ns.max()))
        self._add_to_chunk(b"".join(records))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment, with times of zero."""
        offset = self._stream.tell()
        length = self._stream.write(_bytes_of(Attachment(0, 0, name, media_type, data)))
        self._attachment_indexes.append(AttachmentIndex(offset, length, 0, 0, len(data), name, media_type))

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Add a metadata record."""
        offset = self._stream.tell()
        length = self._stream.write(_bytes_of(Metadata(name, entries)))
        self._metadata_indexes.append(MetadataIndex(offset, length, name))

    def flush(self) -> None:
        """End the chunk if it has a message, and flush the stream; a chunk without messages stays in memory."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """End the file with its indexes."""
        self._end_chunk()
        self._stream.write(_bytes_of(DataEnd(0)))
        start = position = self._stream.tell()
        crc = 0
        offsets = []
        for opcode, blocks in self._summary():
            group_start = position
            for block in blocks:
                self._stream.write(block)
                crc = zlib.crc32(block, crc)
                position += len(block)
            offsets.append(_bytes_of(SummaryOffset(opcode, group_start, position - group_start)))
        self._stream.write(b"".join(offsets))
        crc = zlib.crc32(b"".join(offsets), crc)
        crc = zlib.crc32(_FOOTER_HEAD.pack(Opcode.FOOTER, _FOOTER_BYTES, start, position), crc)
        self._stream.write(_bytes_of(Footer(start, position, crc)) + MAGIC)
        self.discard()

    def discard(self) -> None:
        """Close the index; nothing may be written afterwards."""
        self._chunk_indexes.close()

    def _add_to_chunk(self, data: bytes) -> None:
        self._chunk += data
        if len(self._chunk) > CHUNK_BYTES:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk and its message indexes; a chunk without messages is kept open."""
        if self._start_ns is None:
            return
        offset = self._stream.tell()
        plain = bytes(self._chunk)
        compressed = self._compressor.compress(plain)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_end_time=self._end_ns,
            message_start_time=self._start_ns,
            uncompressed_crc=zlib.crc32(plain),
            uncompressed_size=len(plain),
        )
        length = self._stream.write(_bytes_of(chunk))
        offsets: dict[int, int] = {}
        indexes = bytearray()
        for channel_id, entries in self._indexes.items():
            offsets[channel_id] = offset + length + len(indexes)
            length_of_body = _INDEX_HEAD_BYTES + len(entries)
            indexes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length_of_body, channel_id, len(entries))
            indexes += entries
        self._stream.write(indexes)
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(compressed),
            message_end_time=self._end_ns,
            message_index_length=len(indexes),
            message_index_offsets=offsets,
            message_start_time=self._start_ns,
            uncompressed_size=len(plain),
        )
        self._chunk_indexes.write(_bytes_of(index))
        self._first_ns = self._start_ns if self._chunk_count == 0 else min(self._first_ns, self._start_ns)
        self._last_ns = max(self._last_ns, self._end_ns)
        self._chunk_count += 1
        self._chunk.clear()
        self._indexes = {}
        self._start_ns, self._end_ns = None, 0

    def _summary(self) -> Iterator[tuple[Opcode, Iterable[bytes]]]:
        """Yield the opcode and the records, in blocks, of each group of the summary."""
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._message_counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._message_counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        yield Opcode.SCHEMA, map(_bytes_of, self._schemas)
        yield Opcode.CHANNEL, map(_bytes_of, self._channels)
        yield Opcode.STATISTICS, [_bytes_of(statistics)]
        self._chunk_indexes.seek(0)
        yield Opcode.CHUNK_INDEX, iter(lambda: self._chunk_indexes.read(_BLOCK_BYTES), b"")
        yield Opcode.ATTACHMENT_INDEX, map(_bytes_of, self._attachment_indexes)
        yield Opcode.METADATA_INDEX, map(_bytes_of, self._metadata_indexes)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    end: Callable[[], bytes] = builder.end  # mcap gives it no type
    return end()

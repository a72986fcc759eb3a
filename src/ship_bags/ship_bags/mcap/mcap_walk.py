"""Walks through the records of an MCAP file without trusting it: what is damaged is stepped over and told.

A record is taken only where its body has the structure that its opcode says. After a damaged one the walk goes on at
the next record that can stand between chunks, so that one wrong bit costs one record, whatever it hits.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode

from ship_bags.mcap.mcap_records import COMPRESSIONS, HEADER, RecordFile

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_CHUNK_HEAD = struct.Struct("<QQQI")
_ATTACHMENT_LEAST = 8 + 8 + 4 + 4 + 8 + 4
_MESSAGE_LEAST = 2 + 4 + 8 + 8
# Where a walk may go on. Schemas, channels and messages are left out: inside an uncompressed damaged chunk they look
# sound, but nothing vouches for them. The length's upper bytes are zero in any file below a tebibyte.
_RESTART = re.compile(rb"[\x06\x07\x09\x0c\x0f].{5}\x00\x00\x00", re.DOTALL)
_WINDOW_BYTES = 1 << 20


@dataclass(frozen=True)
class WalkedRecord:
    """A sound record: where it begins, its opcode, its body."""

    offset: int
    opcode: int
    body: bytes

    @property
    def length(self) -> int:
        """Bytes from the first of its head to the last of its body."""
        return HEADER.size + len(self.body)


@dataclass(frozen=True)
class Gap:
    """Bytes that are no record: from `start` up to `end`, or to the end of the file where `end` is None."""

    start: int
    end: int | None


def walk(data: RecordFile, offset: int) -> Iterator[WalkedRecord | Gap]:
    """Records from an offset on, up to the end of the data section, the cut, or the end of the file.

    The last one is a record (DATA_END or FOOTER) in a file that was finished, otherwise a gap without end.
    """
    while True:
        record = _sound_record(data, offset)
        if record is None:
            after = _restart(data, offset)
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
    """Whether the record with which every MCAP file begins is at an offset."""
    record = _sound_record(data, offset)
    return record is not None and record.opcode == Opcode.HEADER


def _sound_record(data: RecordFile, offset: int) -> WalkedRecord | None:
    found = data.record_at(offset)
    return WalkedRecord(offset, *found) if found is not None and _is_sound(*found) else None


def _restart(data: RecordFile, damaged: int) -> int | None:
    """Offset of the next sound record after a damaged one, whose own length may be what is wrong."""
    window_start = damaged + 1
    while window_start < data.size:
        data.stream.seek(window_start)
        window = data.stream.read(_WINDOW_BYTES + HEADER.size - 1)
        position = 0
        while (match := _RESTART.search(window, position)) is not None:
            if _can_restart(data, window_start + match.start()):
                return window_start + match.start()
            position = match.start() + 1
        window_start += _WINDOW_BYTES
    return None


def _can_restart(data: RecordFile, offset: int) -> bool:
    record = _sound_record(data, offset)
    if record is None or record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.HEADER):
        return False
    return record.opcode != Opcode.CHUNK or _compression(record.body) in COMPRESSIONS


def _compression(chunk: bytes) -> str:
    length = _U32.unpack_from(chunk, _CHUNK_HEAD.size)[0]
    start = _CHUNK_HEAD.size + _U32.size
    return chunk[start : start + length].decode("latin-1")


def _is_sound(opcode: int, body: bytes) -> bool:
    """Whether a body has the structure of its opcode, to the last byte."""
    try:
        if opcode == Opcode.CHUNK:
            return _end_of(body, _CHUNK_HEAD.size, (_U32, _U64)) == len(body)
        if opcode == Opcode.MESSAGE_INDEX:
            return _is_message_index(body)
        if opcode == Opcode.MESSAGE:
            # One wrong bit makes a message of an index.
            return len(body) >= _MESSAGE_LEAST and not _is_message_index(body)
        if opcode == Opcode.SCHEMA:
            return _end_of(body, _U16.size, (_U32, _U32, _U32)) == len(body)
        if opcode == Opcode.CHANNEL:
            return _end_of(body, 2 * _U16.size, (_U32, _U32, _U32)) == len(body)
        if opcode == Opcode.METADATA:
            return _end_of(body, 0, (_U32, _U32)) == len(body)
        if opcode == Opcode.HEADER:
            return _end_of(body, 0, (_U32, _U32)) == len(body)
    except struct.error:
        return False
    if opcode == Opcode.ATTACHMENT:
        return len(body) >= _ATTACHMENT_LEAST
    return (opcode, len(body)) in ((Opcode.DATA_END, 4), (Opcode.FOOTER, 20))


def _is_message_index(body: bytes) -> bool:
    entries_bytes = _U32.unpack_from(body, _U16.size)[0]
    return _U16.size + _U32.size + entries_bytes == len(body) and entries_bytes % 16 == 0


def _end_of(body: bytes, offset: int, sizes: tuple[struct.Struct, ...]) -> int:
    """Where a row of fields ends that each begin with their size."""
    for size in sizes:
        offset += size.size + size.unpack_from(body, offset)[0]
    return offset

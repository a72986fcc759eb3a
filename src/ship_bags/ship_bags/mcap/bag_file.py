"""One file of a bag: its content independent of the storage, and an MCAP file as a list of chunks.

The chunks can be read one by one, even if the file is damaged. A complete file ends in a summary with the location of
each chunk. A file without a summary (the recorder was killed, the disk was full) is scanned record by record up to its
end; damaged records are skipped.

The further files of a black box are next to its first file and are read with it.
"""

import io
import re
import shlex
import struct
import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from ship_bags.errors import BadInput
from ship_bags.input_files import check_regular
from ship_bags.mcap.mcap_writer import MAGIC
from ship_bags.mcap.records import (
    COMPRESSIONS,
    ChunkPlace,
    DamagedChunk,
    Gap,
    RecordFile,
    ScannedRecord,
    has_header,
    parse_record,
    scan_records,
)
from ship_bags.stamps import utc_text
from ship_bags.topic_names import BLACK_BOX_METADATA

_ROS1_BEGIN = b"#ROSBAG"
_FOOTER = struct.Struct("<BQQQI8s")
_CHUNK_TIMES = struct.Struct("<QQ")
"""Earliest and latest log time, at the beginning of a chunk's body."""

_LOG_TIME = struct.Struct("<Q")
_LOG_TIME_OFFSET = 2 + 4
"""Offset of the log time in the body of a message, after channel id and sequence number."""

_CHECKSUM = struct.Struct("<I")
"""Checksum at the end of the summary and of an attachment's body."""

_MESSAGES_PER_PLACE = 5000
_BLOCK_BYTES = 1 << 20

_FIRST = "1"


@dataclass
class BagFile(ABC):
    """Content of a file of a bag besides its messages, and the places of the messages.

    Attributes:
        path: path of the file, or of the folder if its files are read as one file.
        chunks: places of the messages, in file order.
        recorded_names: topic → its name in the file, for renamed topics.
        side_records: attachments and metadata, in file order.
        problems: one line per problem known so far.
    """

    path: Path
    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    recorded_names: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    side_records: list[Attachment | Metadata] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    @abstractmethod
    def size_bytes(self) -> int:
        """Size on the disk, bytes."""

    @abstractmethod
    def messages(self, place: ChunkPlace) -> list[Message]:
        """Return the messages of one place, in file order; a damaged place gives none, and adds a problem."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def add_problem(self, problem: str) -> None:
        """Add a line to ``problems`` only once, because a place may be read repeatedly."""
        if problem not in self.problems:
            self.problems.append(problem)


@dataclass
class McapFile(BagFile):
    """MCAP file whose records this package reads itself."""

    data: RecordFile = field(kw_only=True)

    @property
    def size_bytes(self) -> int:
        """See :class:`BagFile`."""
        return self.data.size

    def messages(self, place: ChunkPlace) -> list[Message]:
        """See :class:`BagFile`."""
        try:
            return [record for record in self.data.records_of(place) if isinstance(record, Message)]
        except DamagedChunk as damage:
            self.add_problem(
                f"{self.path.name}: the chunk at byte {place.offset} is damaged ({damage}): messages from "
                f"{utc_text(place.start_ns)} to {utc_text(place.end_ns)} are lost"
            )
            return []

    def close(self) -> None:
        """See :class:`BagFile`."""
        self.data.stream.close()


def open_mcap(path: Path) -> McapFile:
    """Open an MCAP file and find its chunks.

    Raises:
        BadInput: the file is missing, unreadable, empty, not MCAP, or of an unknown compression.
    """
    try:
        check_regular(path)
        stream = open(path, "rb")  # noqa: SIM115 - closed by the bag that owns it
    except OSError as problem:
        raise BadInput(f"cannot be read: {problem.strerror}", file=path) from problem
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    magic = stream.read(len(MAGIC))
    file = McapFile(path, data=RecordFile(stream, size))
    if magic != MAGIC:
        if not has_header(file.data, len(MAGIC)):
            stream.close()
            raise _not_mcap_error(path, size, magic)
        file.problems.append(f"{path.name}: its first {len(MAGIC)} bytes are damaged; no data are lost")
    summary = _summary(file)
    if summary is not None:
        _read_summary(file, summary)
    else:
        _scan(file)
    return file


def _not_mcap_error(path: Path, size: int, begin: bytes) -> BadInput:
    if size == 0:
        return BadInput("the file is empty", file=path)
    if begin.startswith(_ROS1_BEGIN):
        folder = shlex.quote(str(path.with_suffix("")))
        advice = f"rosbags-convert --src {shlex.quote(str(path))} --dst {folder} makes a rosbag2 folder of it"
        return BadInput(f"a bag of ROS 1: {advice}", file=path)
    if begin.startswith(zstandard.FRAME_HEADER):
        return BadInput("a compressed file: give its rosbag2 folder instead", file=path)
    return BadInput("not an MCAP file", file=path)


@dataclass
class _Summary:
    """Summary of a file; only the place of each chunk is kept, because long bags have many chunks.

    Attributes:
        places: places of the chunks, in the order of the summary.
        compressions: compressions of the chunks.
        attachments: offsets of the attachments, bytes.
        metadata: offsets of the metadata records, bytes.
    """

    statistics: Statistics | None = None
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    places: list[ChunkPlace] = field(default_factory=list)
    compressions: set[str] = field(default_factory=set)
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    _channel_sets: dict[frozenset[int], frozenset[int]] = field(default_factory=dict)

    def add(self, record: McapRecord) -> None:
        """Add a record of the summary."""
        match record:
            case Statistics():
                self.statistics = record
            case Schema():
                self.schemas[record.id] = record
            case Channel():
                self.channels[record.id] = record
            case ChunkIndex():
                self._take_chunk(record)
            case AttachmentIndex():
                self.attachments.append(record.offset)
            case MetadataIndex():
                self.metadata.append(record.offset)

    def _take_chunk(self, index: ChunkIndex) -> None:
        self.compressions.add(index.compression)
        channels = frozenset(index.message_index_offsets)
        # Most chunks hold messages of the same channels.
        channels = self._channel_sets.setdefault(channels, channels)
        place = ChunkPlace(
            index.chunk_start_offset,
            index.chunk_length,
            index.message_start_time,
            index.message_end_time,
            channels=channels or None,  # a writer may leave the index out
        )
        self.places.append(place)

    @property
    def is_complete(self) -> bool:
        """True if the summary lists all channels, their schemas and all places of messages."""
        statistics = self.statistics
        if statistics is None or statistics.channel_count != len(self.channels):
            return False
        if any(channel.schema_id and channel.schema_id not in self.schemas for channel in self.channels.values()):
            return False
        return statistics.chunk_count == len(self.places) and (
            statistics.message_count == 0 or statistics.chunk_count > 0
        )


def _summary(file: McapFile) -> _Summary | None:
    """Return the file's summary if it exists, is valid and lists every chunk; else None."""
    start = _summary_start(file)
    if start is None:
        return None
    summary = _Summary()
    file.data.stream.seek(start)
    try:
        for record in StreamReader(file.data.stream, skip_magic=True).records:
            summary.add(record)
            if isinstance(record, Footer):
                break
    except Exception:
        # The parser may raise anything for damaged bytes; the file is scanned instead.
        return None
    return summary if summary.is_complete else None


def _summary_start(file: McapFile) -> int | None:
    """Return the offset of the summary; None unless the file ends in a footer whose checksum is right or not given.

    Offsets are counted from the start of the file, because its end moves while the file is being written.
    """
    if file.data.size < len(MAGIC) + _FOOTER.size:
        return None
    file.data.stream.seek(file.data.size - _FOOTER.size)
    footer = file.data.stream.read(_FOOTER.size)
    if len(footer) < _FOOTER.size:
        return None
    opcode, _, start, _, checksum, magic = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or magic != MAGIC or not 0 < start < file.data.size:
        return None
    file.data.stream.seek(start)
    found, left = 0, file.data.size - start - _CHECKSUM.size - len(MAGIC)
    while left > 0 and (block := file.data.stream.read(min(left, _BLOCK_BYTES))):
        found, left = zlib.crc32(block, found), left - len(block)
    return start if checksum in (0, found) else None


def _read_summary(file: McapFile, summary: _Summary) -> None:
    if summary.compressions and summary.compressions.isdisjoint(COMPRESSIONS):
        unknown = min(summary.compressions)
        raise BadInput(f"compression {unknown!r} is unknown: expected zstd, lz4 or none", file=file.path)
    file.schemas.update(summary.schemas)
    file.channels.update(summary.channels)
    file.chunks.extend(sorted(summary.places, key=lambda place: place.offset))
    for offset in summary.attachments + summary.metadata:
        record = file.data.record_at(offset)
        if record is None:
            file.problems.append(f"{file.path.name}: the attachment or metadata at byte {offset} is damaged")
        else:
            _take_side_record(file, *record)


def _scan(file: McapFile) -> None:
    """Find the chunks of a file without a usable summary, up to its end or the last readable record."""
    loose: list[tuple[int, int, int]] = []
    gaps: list[tuple[Gap, int]] = []
    message_count, cut = 0, None
    for part in scan_records(file.data, len(MAGIC)):
        is_message = isinstance(part, ScannedRecord) and part.opcode == Opcode.MESSAGE
        if loose and (not is_message or len(loose) == _MESSAGES_PER_PLACE):
            file.chunks.append(_place_outside_chunk(loose))
            loose = []
        if isinstance(part, Gap):
            if part.end is None:
                cut = part.start
            else:
                gaps.append((part, len(file.chunks)))
        elif part.opcode == Opcode.CHUNK:
            message_count += _take_chunk(file, part)
        elif is_message:
            loose.append((part.offset, part.length, _LOG_TIME.unpack_from(part.body, _LOG_TIME_OFFSET)[0]))
            message_count += 1
        else:
            _take_side_record(file, part.opcode, part.body)
    if loose:
        file.chunks.append(_place_outside_chunk(loose))
    last_ns = max((place.end_ns for place in file.chunks), default=None)
    last = "none" if last_ns is None else utc_text(last_ns)
    what = "its summary is missing or damaged" if cut is None else f"no footer, it ends or is damaged at byte {cut}"
    file.problems.append(f"{file.path.name}: {what}; {message_count} messages could be read, the last at {last}")
    file.problems.extend(_gap_text(file, gap, place_number) for gap, place_number in gaps)


def _gap_text(file: McapFile, gap: Gap, place_number: int) -> str:
    before, after = file.chunks[:place_number], file.chunks[place_number:]
    start = utc_text(before[-1].end_ns) if before else "the start"
    end = utc_text(after[0].start_ns) if after else "the end"
    return (
        f"{file.path.name}: bytes {gap.start} to {gap.end} are damaged: "
        f"messages between {start} and {end} are lost, if any"
    )


def _take_chunk(file: McapFile, chunk: ScannedRecord) -> int:
    """Add a chunk that the scan has found, and the chunk's channels; return the number of messages in the chunk."""
    announced = ChunkPlace(chunk.offset, chunk.length, *_CHUNK_TIMES.unpack_from(chunk.body))
    try:
        records = file.data.records_of(announced, check_times=False)
    except DamagedChunk:
        file.chunks.append(announced)
        return 0  # messages() reports it with the time range
    times = [record.log_time for record in records if isinstance(record, Message)]
    if times:
        # The times are those of the messages, because no checksum protects the times in the chunk's header.
        file.chunks.append(ChunkPlace(chunk.offset, chunk.length, min(times), max(times)))
    for record in records:
        # Records in a chunk are protected by its checksum, so they take precedence over records outside a chunk.
        if isinstance(record, Schema):
            file.schemas[record.id] = record
        elif isinstance(record, Channel):
            file.channels[record.id] = record
    return len(times)


def _place_outside_chunk(messages: list[tuple[int, int, int]]) -> ChunkPlace:
    """Return the place of consecutive messages given as (offset, length, log time)."""
    times = [time_ns for _, _, time_ns in messages]
    length = messages[-1][0] + messages[-1][1] - messages[0][0]
    return ChunkPlace(messages[0][0], length, min(times), max(times), is_outside_chunk=True)


def _take_side_record(file: McapFile, opcode: int, body: bytes) -> None:
    """Keep a schema, channel, attachment or metadata record; ignore other records."""
    try:
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema.read, body)
            file.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel.read, body)
            file.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.METADATA:
            metadata = parse_record(Metadata.read, body)
            file.metadata[metadata.name] = metadata.metadata
            file.side_records.append(metadata)
        elif opcode == Opcode.ATTACHMENT:
            checksum = _CHECKSUM.unpack_from(body, len(body) - _CHECKSUM.size)[0]
            if checksum not in (0, zlib.crc32(body[: -_CHECKSUM.size])):
                raise DamagedChunk("its checksum is wrong")
            attachment = parse_record(Attachment.read, body)
            file.attachments[attachment.name] = attachment.data
            file.side_records.append(attachment)
    except Exception as problem:
        # The parser may raise anything for damaged bytes, with useless texts.
        why = f" ({problem})" if isinstance(problem, DamagedChunk) else ""
        file.problems.append(f"{file.path.name}: one {Opcode(opcode).name.lower()} record is damaged{why}: it is lost")


def further_black_box_files(first: BagFile) -> list[BagFile]:
    """Return the files that continue the first file of a black box, in order; an empty list for any other file.

    A missing or unreadable file becomes a line in the problems of the first file.
    """
    entries = first.metadata.get(BLACK_BOX_METADATA, {})
    if entries.get("part") != _FIRST:
        return []
    found: dict[int, BagFile] = {}
    pattern = re.compile(re.escape(first.path.stem) + r"\.part\d+\.mcap", re.ASCII)
    for path in (path for path in first.path.parent.iterdir() if pattern.fullmatch(path.name)):
        try:
            file = open_mcap(path)
        except BadInput as problem:
            first.add_problem(str(problem))
            continue
        # Only the black-box header of the first file is kept.
        of_part = file.metadata.pop(BLACK_BOX_METADATA, {})
        number = of_part.get("part", "")
        if of_part.get("box") == entries.get("box") and number.isascii() and number.isdecimal():
            found[int(number)] = file
        else:
            file.close()
    for missing in set(range(2, max(found, default=1))) - found.keys():
        first.add_problem(f"{first.path.name}: part {missing} of the black box is missing")
    return [found[number] for number in sorted(found)]

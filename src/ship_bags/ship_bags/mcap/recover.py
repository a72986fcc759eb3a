"""Recovery of damaged or unfinished bags: every readable message is written to a new file with an index.

The original is only read. Each new file is renamed to its final name after two other readers have read back every
message: the seeking reader of the `mcap` project, and `rosbags`. A new folder has its final name from the start;
`rosbags` reads the whole folder back at the end.
"""

import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

from ship_bags.command_line import with_progress
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_file import McapFile, open_mcap
from ship_bags.mcap.folder import INFORMATION_FILE, FileInformation, TopicInformation, write_information
from ship_bags.output_files import check_file, file_in_errors, open_new

_LIBRARY = "ship_bags record --recover"
_NOTE = "recovered"
"""Name of the metadata record with the name of the original and its problems."""


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: the new file or folder, its number of messages per topic, and one line per problem."""

    path: Path
    counts: Counter[str]
    problems: list[str] = field(default_factory=list)


@dataclass
class _Tally:
    """Number of messages per topic, and a checksum of times and bytes that is independent of the messages' order."""

    counts: Counter[str] = field(default_factory=Counter)
    digests: Counter[str] = field(default_factory=Counter)

    def add(self, topic: str, log_time_ns: int, data: bytes) -> None:
        self.counts[topic] += 1
        self.digests[topic] += zlib.crc32(data, log_time_ns & 0xFFFFFFFF)


def recovered_path(source: Path) -> Path:
    """Return the path of the result: ``voyage.recovered.mcap`` for ``voyage.mcap``, or a folder."""
    if source.is_dir():
        return source.with_name(f"{source.name}.recovered")
    return source.with_name(f"{source.name.removesuffix('.mcap')}.recovered.mcap")


def recover(source: Path, target: Path, force: bool = False) -> Recovery:
    """Recover one .mcap file, or the files of a folder into a folder with a new information file.

    Args:
        source: bag to read.
        target: path of the result.
        force: True to overwrite a file; a folder is never overwritten.

    Raises:
        BadInput: the source has no readable message, the target exists or cannot be created, or the result read back
            differs from what was written.
        OSError: writing fails, for example on a full disk.
    """
    if source.is_dir():
        if os.path.lexists(target):
            raise BadInput("already exists: remove it, or give another name by --out", file=target)
        return _recover_folder(source, target)
    check_file(target, force)
    if target.resolve() == source.resolve():
        raise BadInput("the output would overwrite the input", file=target)
    topics: dict[str, TopicInformation] = {}
    return _recover_file(source, target, topics, _Tally())[0]


def _recover_folder(source: Path, target: Path) -> Recovery:
    parts = sorted(source.glob("*.mcap"), key=_number)
    if not parts:
        raise BadInput("there are no .mcap files in this folder", file=source)
    target.mkdir()
    files: list[FileInformation] = []
    topics: dict[str, TopicInformation] = {}
    whole, written = Recovery(target, Counter()), _Tally()
    for part in parts:
        try:
            recovery, information = _recover_file(part, target / part.name, topics, written)
        except BadInput as problem:
            # A file that cannot be recovered, such as a last file without messages, is left out and reported.
            whole.problems.append(str(problem))
            continue
        files.append(information)
        whole.counts.update(recovery.counts)
        whole.problems.extend(recovery.problems)
    if not files:
        target.rmdir()
        raise BadInput("; ".join(whole.problems))
    write_information(target, files, list(topics.values()))
    _read_back(target, target / INFORMATION_FILE, "rosbags", _read_by_rosbags, written)
    return whole


def _number(path: Path) -> tuple[int, str]:
    """Sort key of files: voyage_10.mcap comes after voyage_9.mcap."""
    digits = path.stem.rpartition("_")[2]
    return (int(digits) if digits.isdigit() else 0, path.name)


def _recover_file(
    source: Path, target: Path, topics: dict[str, TopicInformation], whole: _Tally
) -> tuple[Recovery, FileInformation]:
    """Recover one file; add its topics and messages to the totals of the whole bag."""
    file = open_mcap(source)
    # rosbags recognises MCAP by its suffix only.
    part = target.with_name(f"{target.stem}.part.mcap")
    try:
        if not file.chunks:
            raise BadInput("no message reached the disk, there is nothing to recover", file=source)
        try:
            with file_in_errors(target):
                written, information = _rewrite(file, part, target.name, topics)
                if not written.counts:
                    raise BadInput(f"no message can be read: {'; '.join(file.problems)}", file=source)
                _read_back(part, target, "mcap", _read_by_mcap, written)
                _read_back(part, target, "rosbags", _read_by_rosbags, written)
                part.replace(target)
        finally:
            part.unlink(missing_ok=True)
        whole.counts.update(written.counts)
        whole.digests.update(written.digests)
    finally:
        file.close()
    return Recovery(target, written.counts, file.problems), information


def _rewrite(
    file: McapFile, part: Path, name: str, topics: dict[str, TopicInformation]
) -> tuple[_Tally, FileInformation]:
    """Write all readable records into a new file, messages in their original order."""
    tally, information, unknown = _Tally(), FileInformation(name), 0
    try:
        stream = open_new(part)
    except OSError as problem:
        raise BadInput(f"cannot be written: {problem.strerror}", file=part) from problem
    with stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library=_LIBRARY)
        for record in file.side_records:
            if isinstance(record, Attachment):
                writer.add_attachment(
                    record.create_time, record.log_time, record.name, record.media_type, record.data
                )
            else:
                writer.add_metadata(record.name, record.metadata)
        channels = _Channels(file, writer, topics)
        for message in _all_messages(file):
            channel = file.channels.get(message.channel_id)
            if channel is None:
                unknown += 1
                continue
            number = channels.number(channel)
            writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
            tally.add(channel.topic, message.log_time, message.data)
            information.add(message.log_time)
            topics[channel.topic].message_count += 1
        if unknown:
            file.problems.append(f"{file.path.name}: {unknown} messages are lost: their topic is not in the file")
        notes = {str(number): problem for number, problem in enumerate(file.problems, 1)}
        writer.add_metadata(_NOTE, {"from": file.path.name, **notes})
        finish: Callable[[], None] = writer.finish  # mcap gives it no type
        finish()
        stream.flush()
        os.fsync(stream.fileno())
    return tally, information


class _Channels:
    """Channels of the new file, each created at its first message."""

    def __init__(self, file: McapFile, writer: Writer, topics: dict[str, TopicInformation]) -> None:
        self._file = file
        self._writer = writer
        self._topics = topics
        self._schemas: dict[int, int] = {}
        self._numbers: dict[int, int] = {}

    def number(self, channel: Channel) -> int:
        """Return the id in the new file of a channel of the old file."""
        if channel.id not in self._numbers:
            schema = self._file.schemas.get(channel.schema_id)
            if schema is not None and schema.id not in self._schemas:
                self._schemas[schema.id] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._numbers[channel.id] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schemas.get(channel.schema_id, 0), channel.metadata
            )
            self._topics.setdefault(
                channel.topic,
                TopicInformation(
                    channel.topic,
                    "" if schema is None else schema.name,
                    channel.metadata.get("offered_qos_profiles", ""),
                    channel.metadata.get("topic_type_hash", ""),
                ),
            )
        return self._numbers[channel.id]


def _all_messages(file: McapFile) -> Iterable[Message]:
    first_ns = min(place.start_ns for place in file.chunks)
    last_ns = max(place.end_ns for place in file.chunks)
    for place in with_progress(file.chunks, file.path.name, first_ns, last_ns, lambda place: place.start_ns):
        yield from file.messages(place)


def _read_by_mcap(path: Path) -> _Tally:
    tally = _Tally()
    with open(path, "rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            tally.add(channel.topic, message.log_time, message.data)
    return tally


def _read_by_rosbags(path: Path) -> _Tally:
    tally = _Tally()
    with Reader(path) as reader:
        for connection, log_time_ns, data in reader.messages():
            tally.add(connection.topic, log_time_ns, data)
    return tally


def _read_back(path: Path, name: Path, reader: str, read: Callable[[Path], _Tally], written: _Tally) -> None:
    """Check that a reader reads the written messages back from a file.

    Raises:
        BadInput: other messages are read back, or the reader fails.
    """
    try:
        found = read(path)
    except Exception as problem:
        # A reader may raise any exception for a wrong result.
        raise BadInput(f"is not written: reading it back by {reader} failed: {problem}", file=name) from problem
    for topic in sorted(found.counts.keys() | written.counts.keys()):
        if (found.counts[topic], found.digests[topic]) != (written.counts[topic], written.digests[topic]):
            raise BadInput(
                f"is not written: {reader} reads back {found.counts[topic]} messages of topic '{topic}' "
                f"instead of {written.counts[topic]}, or with other bytes",
                file=name,
            )

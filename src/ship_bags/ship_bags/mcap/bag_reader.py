"""Reader of bags (one .mcap file, or a rosbag2 folder with its split files) in order of log time.

Chunks are read one by one, so that memory does not grow with the length of the bag; the messages of chunks that overlap
in time are merged. Damaged records are skipped and listed in ``Bag.problems``.
"""

import re
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Message
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ship_bags.command_line import with_progress
from ship_bags.errors import BadInput, one_line
from ship_bags.mcap.bag_file import BagFile, further_black_box_files, open_mcap
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.mcap.folder import INFORMATION_FILE, file_names, needs_rosbags, repeated_message_times
from ship_bags.mcap.records import ChunkPlace
from ship_bags.message_store import BagTypes, message_store, store_with_definitions
from ship_bags.stamps import utc_text
from ship_bags.topic_names import BLACK_BOX_METADATA, current_names, relative_topic

# The durability is a name since rosbag2's metadata version 9, a number before.
_LATCHED = re.compile(r"durability: (transient_local|1)\b")

MAX_MEMORY_MB = 512
"""Maximum part of a bag in memory, MB. For an ordinary bag a chunk or two are in memory, because later chunks do not
overlap these in time."""

_PLACE_BITS = 32
"""Number of lower bits in a message's order in the bag, which count the messages of a place. The upper bits count the
places."""

_RECORD_BYTES = 250
"""Memory of a message in addition to its data, bytes."""

_XCDR2_HEADS = b"\x00\x06", b"\x00\x07"
"""Encapsulations of plain XCDR2, big and little endian. XCDR2 is read as XCDR1, which is right if the padding is the
same; if XCDR2 pads less, the message is too short to be decoded."""

_PADDING_BYTES = 4
"""Maximum padding in front of an 8-byte element, bytes."""


@dataclass(slots=True)
class BagRecord:
    """Message of a bag; if `rosbags` reads the bag, the sequence number is 0 and the publish time is the log time."""

    topic: str
    type_name: str
    log_time_ns: int
    data: bytes
    store: Typestore
    sequence: int = 0
    publish_time_ns: int = 0

    def decode(self) -> Any:
        """Return the message with its fields as attributes, by the bag's definition.

        Raises:
            BadInput: the bytes are not a message of this type.
        """
        try:
            try:
                return self.store.deserialize_cdr(self.data, self.type_name)
            except SerdeError:
                # If a message ends with an empty sequence of 8-byte elements, rclpy pads as if an element followed.
                return self.store.deserialize_cdr(self.data[:-_PADDING_BYTES], self.type_name)
        except Exception as problem:
            # The generated decoder may raise anything for bytes of another type.
            raise BadInput(
                f"topic '{self.topic}' at {utc_text(self.log_time_ns)}: not a {self.type_name}: {problem}"
            ) from problem


class _BagPlace(NamedTuple):
    """Place of messages: its order among all places of the bag, and the index of its file."""

    order: int
    file_number: int
    place: ChunkPlace


class Bag:
    """Open bag; use it in a ``with`` statement.

    Attributes:
        topics: topic → type name, for the readable topics.
        recorded_names: topic → its name in the bag, for renamed topics (:mod:`ship_bags.topic_names`).
        skipped_topics: topic → why it cannot be read.
        store: types of the bag's messages; the definitions in the bag take precedence.
        differences: type name → one line per field that the bag defines differently from this version of the suite.
        attachments: name → content.
        metadata: name → entries.
        message_count: messages yielded so far.
        last_time_ns: log time of the last yielded message; None before the first.
    """

    def __init__(self, path: Path, files: list[BagFile]) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.skipped_topics: dict[str, str] = {}
        self.recorded_names = {new: old for file in files for new, old in file.recorded_names.items()}
        self.attachments = {name: data for file in files for name, data in file.attachments.items()}
        self.metadata = {name: entries for file in files for name, entries in file.metadata.items()}
        self.message_count = 0
        self.last_time_ns: int | None = None
        self._files = files
        # Messages that a file repeats from earlier files are needed only if the file is read alone.
        self._repeated = [
            set[tuple[str, int]]() if n == 0 else repeated_message_times(f.metadata) for n, f in enumerate(files)
        ]
        self._usable_channels = [self._channels_of(file) for file in files]
        types = self._types()
        self.store, self.differences = types.store, types.differences
        self._skip_unreadable(types.unreadable)

    @property
    def start_ns(self) -> int:
        """Log time of the first message; :func:`read_bag` refuses a bag without messages."""
        return min(place.start_ns for file in self._files for place in file.chunks)

    @property
    def end_ns(self) -> int:
        """Log time of the last message."""
        return max(place.end_ns for file in self._files for place in file.chunks)

    @property
    def latched_topics(self) -> set[str]:
        """Topics whose publishers kept their last messages for late subscribers (transient local)."""
        return {
            channel.topic
            for file in self._files
            for channel in file.channels.values()
            if _LATCHED.search(channel.metadata.get("offered_qos_profiles", ""))
        }

    @property
    def problems(self) -> list[str]:
        """One line per problem of the bag; complete after all records were read."""
        name = self.path.name
        lines = [problem for file in self._files for problem in file.problems]
        lines += [f"{name}: topic '{topic}' is skipped: {why}" for topic, why in self.skipped_topics.items()]
        lines += [f"{name}: {line}" for line in sorted({line for part in self.differences.values() for line in part})]
        return [one_line(line) for line in lines]

    def records(self, topics: Collection[str] | None = None, since_ns: int = 0) -> Iterator[BagRecord]:
        """Yield messages in order of log time; messages of equal time are in the order of the files.

        Chunks without messages of the topics, by the bag's index, are not read.

        Args:
            topics: names of the topics wanted; None for all readable topics.
            since_ns: earliest log time of the messages; chunks that end before it are not read.

        Raises:
            BadInput: chunks that overlap in time hold more than MAX_MEMORY_MB.
        """
        channels = self._channels_with(topics)
        places = self._places(None if topics is None else channels)
        places = [entry for entry in places if entry.place.end_ns >= since_ns]
        waiting: list[tuple[int, int, BagRecord]] = []
        for number, bag_place in enumerate(places):
            waiting.extend(self._chunk_records(bag_place, channels[bag_place.file_number]))
            if sum(len(record.data) + _RECORD_BYTES for _, _, record in waiting) > MAX_MEMORY_MB * 1_000_000:
                raise BadInput(
                    f"the chunk at byte {bag_place.place.offset} and those that overlap it in "
                    f"time hold more than {MAX_MEMORY_MB} MB",
                    file=self._files[bag_place.file_number].path,
                )
            # The order in the file decides for equal times and is unique, so records are never compared.
            waiting.sort(key=lambda entry: entry[:2])
            last = number + 1 == len(places)
            ready = len(waiting) if last else bisect_left(waiting, (places[number + 1].place.start_ns,))
            for time_ns, _, record in waiting[:ready]:
                if time_ns < since_ns:
                    continue
                self.message_count += 1
                self.last_time_ns = time_ns
                yield record
            del waiting[:ready]

    def last_before(self, topic: str, before_ns: int) -> BagRecord | None:
        """Return the last message of a topic before a log time; None without such a message. Few chunks are read."""
        channels = self._channels_with({topic})
        found: tuple[int, int, BagRecord] | None = None
        for entry in sorted(self._places(channels), key=lambda entry: -entry.place.end_ns):
            if found is not None and entry.place.end_ns < found[0]:
                break
            if entry.place.start_ns >= before_ns:
                continue
            for each in self._chunk_records(entry, channels[entry.file_number]):
                if each[0] < before_ns and (found is None or each[:2] > found[:2]):
                    found = each
        return None if found is None else found[2]

    def records_in_file_order(self) -> Iterator[BagRecord]:
        """Yield all messages in the order of the files, in any order of log time."""
        for number, (file, channels) in enumerate(zip(self._files, self._usable_channels, strict=True)):
            for place in sorted(file.chunks, key=lambda place: place.offset):
                for message in file.messages(place):
                    if message.channel_id in channels and not self._is_repeated(number, message):
                        self.message_count += 1
                        self.last_time_ns = message.log_time
                        yield self._record(message, channels)

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channels_with(self, topics: Collection[str] | None) -> list[dict[int, str]]:
        """Return, for each file, channel → topic for the topics wanted (None for all topics)."""
        return [
            {number: name for number, name in usable.items() if topics is None or name in topics}
            for usable in self._usable_channels
        ]

    def _places(self, channels: list[dict[int, str]] | None) -> list[_BagPlace]:
        """Return the places with messages of some channels (None: all), by their start times."""
        in_bag_order = ((number, place) for number, file in enumerate(self._files) for place in file.chunks)
        places = [
            _BagPlace(order, number, place)
            for order, (number, place) in enumerate(in_bag_order)
            if channels is None or place.channels is None or not place.channels.isdisjoint(channels[number])
        ]
        return sorted(places, key=lambda entry: (entry.place.start_ns, entry.order))

    def _chunk_records(self, at: _BagPlace, channels: dict[int, str]) -> Iterator[tuple[int, int, BagRecord]]:
        """Yield (log time, order in the bag, record) of the messages of some channels of one place."""
        for order, message in enumerate(self._files[at.file_number].messages(at.place), at.order << _PLACE_BITS):
            if message.channel_id in channels and not self._is_repeated(at.file_number, message):
                yield message.log_time, order, self._record(message, channels)

    def _is_repeated(self, file_number: int, message: Message) -> bool:
        """True if a message is a copy of a message in an earlier file."""
        repeated = self._repeated[file_number]
        if not repeated:
            return False
        topic = self._files[file_number].channels[message.channel_id].topic
        return (self.recorded_names.get(topic, topic), message.log_time) in repeated

    def _record(self, message: Message, channels: dict[int, str]) -> BagRecord:
        topic, data = channels[message.channel_id], message.data
        if data[:2] in _XCDR2_HEADS:
            data = b"\0" + bytes([data[1] & 1]) + data[2:]
        return BagRecord(
            topic, self.topics[topic], message.log_time, data, self.store, message.sequence, message.publish_time
        )

    def _channels_of(self, file: BagFile) -> dict[int, str]:
        """Return channel → topic for the readable channels; record topics, types and skipped topics."""
        usable: dict[int, str] = {}
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            reason = None
            if channel.message_encoding != "cdr":
                reason = f"message encoding {channel.message_encoding!r} is unknown, expected 'cdr'"
            elif schema is None or schema.encoding != "ros2msg":
                reason = f"schema encoding {schema.encoding if schema else ''!r} is unknown, expected 'ros2msg'"
            elif not schema.data and schema.name not in message_store().fielddefs:
                reason = f"the definition of {schema.name} is not in the bag"
            elif self.topics.get(channel.topic, schema.name) != schema.name:
                reason = f"it carries {schema.name} besides {self.topics[channel.topic]}"
            if reason is not None:
                self.skipped_topics[channel.topic] = reason
            elif schema is not None:
                self.topics[channel.topic] = schema.name
                usable[channel.id] = channel.topic
        return usable

    def _skip_unreadable(self, unreadable: Mapping[str, str]) -> None:
        for topic, type_name in list(self.topics.items()):
            if type_name in unreadable:
                del self.topics[topic]
                self.skipped_topics[topic] = unreadable[type_name]
        self._usable_channels = [
            {number: topic for number, topic in usable.items() if topic in self.topics}
            for usable in self._usable_channels
        ]

    def _types(self) -> BagTypes:
        definitions: dict[str, str] = {}
        for file, usable in zip(self._files, self._usable_channels, strict=True):
            for number in usable:
                schema = file.schemas[file.channels[number].schema_id]
                definitions.setdefault(schema.name, schema.data.decode("utf-8", errors="replace"))
        return store_with_definitions(definitions)


def read_bag(path: Path | str) -> Bag:
    """Open a bag: one .mcap or .db3 file, or a rosbag2 folder with metadata.yaml (MCAP, sqlite3 or compressed files).

    Raises:
        BadInput: the bag cannot be opened (see :func:`open_files`), or has no readable messages.
    """
    path = Path(path)
    files = open_files(path)
    try:
        if not any(file.messages(place) for file in files for place in file.chunks):
            problems = "; ".join(problem for file in files for problem in file.problems)
            why = f" that can be read ({problems})" if problems else ""
            raise BadInput(f"the bag holds no messages{why}", file=path)
        return Bag(path, files)
    except BadInput:
        for file in files:
            file.close()
        raise


def open_files(path: Path) -> list[BagFile]:
    """Open the files of a bag, in order; topics get the names of :mod:`ship_bags.topic_names`.

    Raises:
        BadInput: a file is missing, unreadable, empty or of unknown storage or compression, a folder has no
            metadata.yaml, or a topic cannot be renamed.
    """
    files: list[BagFile] = []
    try:
        if needs_rosbags(path):
            # The import takes a while, and few bags need it.
            from ship_bags.mcap.rosbags_file import open_with_rosbags

            files.append(open_with_rosbags(path))
        else:
            for part in _mcap_files(path):
                files.append(open_mcap(part))  # noqa: PERF401 - those opened so far are closed on failure
            files += further_black_box_files(files[0])
        _rename_topics(path, files)
    except BadInput:
        for file in files:
            file.close()
        raise
    return files


def _rename_topics(path: Path, files: list[BagFile]) -> None:
    """Apply the command's topic names; a topic that already had such a name is not read."""
    names = current_names()
    if any(BLACK_BOX_METADATA in file.metadata for file in files):
        names = replace(names, is_by_suite=False)  # the node has used the suite's names already
    topics = {channel.topic for file in files for channel in file.channels.values()}
    attached = [file.attachments[SUITE_ATTACHMENT] for file in files if SUITE_ATTACHMENT in file.attachments]
    renamed = names.new_names(topics, attached[-1].decode("utf-8", errors="replace") if attached else "")
    unmatched = names.unmatched_remaps(topics)
    if unmatched and not names.is_by_suite:
        raise BadInput(f"has no topic '{unmatched[0]}' to rename; it has {', '.join(sorted(topics))}", file=path)
    first: dict[str | None, str] = {}
    for old, new in sorted(renamed.items()):
        other = first.setdefault(relative_topic(new), old)
        if other != old:
            raise BadInput(f"topics '{other}' and '{old}' cannot both be read as '{new}'", file=path)
    covered = {topic for topic in topics - renamed.keys() if relative_topic(topic) in first}
    for file in files:
        for number, channel in list(file.channels.items()):
            if channel.topic in covered:
                del file.channels[number]
            elif channel.topic in renamed:
                file.channels[number] = replace(channel, topic=renamed[channel.topic])
        file.recorded_names = {new: old for old, new in renamed.items()}
    lines = [f"has no topic '{name}' to rename" for name in unmatched]
    lines += [f"topic '{topic}' is not read: {first[relative_topic(topic)]} has its name" for topic in sorted(covered)]
    files[0].problems += [f"{path.name}: {line}" for line in lines]


ProgressWrapper = Callable[[Iterator[BagRecord], Bag], Iterator[BagRecord]]
"""Function that wraps the iteration over a bag in a progress bar, such as :func:`with_bag_progress`."""


def with_bag_progress(records: Iterator[BagRecord], bag: Bag, doing: str = "") -> Iterator[BagRecord]:
    """Yield the records and show the progress on stderr.

    Args:
        records: records of the bag, in order of log time.
        bag: bag whose name is shown.
        doing: task in the shown line, as "evaluating".
    """
    label = f"{doing} {bag.path.name}".lstrip()
    return with_progress(records, label, bag.start_ns, bag.end_ns, lambda record: record.log_time_ns)


def _mcap_files(path: Path) -> list[Path]:
    if not path.exists():
        raise BadInput("no such file or folder", file=path)
    if not path.is_dir():
        return [path]
    information_path = path / INFORMATION_FILE
    if not information_path.is_file():
        raise BadInput(f"the folder has no {INFORMATION_FILE}: give one of its .mcap files instead", file=path)
    return [path / name for name in file_names(information_path)]

"""rosbag2 folders: several MCAP files and an information file (metadata.yaml), as ROS 2 Jazzy writes them.

Each value that is used from an information file is checked. The file is written atomically. :class:`FolderWriter`
splits a recording by size and time.

The last messages of latched topics are repeated in every file of a split recording, so that each file is usable alone.
A file lists its repeated messages in a metadata record, so that a reader of the whole folder leaves the copies out.
"""

import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ship_bags.errors import BadInput
from ship_bags.input_files import plain_data
from ship_bags.mcap.bag_writer import BagWriter, own_qos_text
from ship_bags.message_store import type_hash
from ship_bags.output_files import write_atomically

REPEATED_METADATA = "repeated"
"""Name of a file's metadata record with topic → log time of the copies, ns."""

_MAX_MESSAGES = 16
"""Maximum number of messages per topic; several nodes may have published a message each, as on /tf_static."""
_MAX_BYTES = 16 * 2**20

INFORMATION_FILE = "metadata.yaml"
_STORAGES = "mcap", "sqlite3"
_SQLITE_SUFFIX = ".db3"
_COMPRESSION_MODES = "none", "file", "message"
_INFORMATION_KEY = "rosbag2_bagfile_information"
_VERSION = 9
_ROS_DISTRO = "jazzy"


class LatchedMessage(NamedTuple):
    """Message as written."""

    topic: str
    type_name: str
    data: bytes
    publish_time_ns: int


class LatchedMessages:
    """Newest messages of each latched topic, without duplicates."""

    def __init__(self) -> None:
        self._messages: dict[str, deque[LatchedMessage]] = {}

    def __contains__(self, topic: str) -> bool:
        """True if a topic is latched."""
        return topic in self._messages

    def __iter__(self) -> Iterator[LatchedMessage]:
        """Iterate over all messages, topic by topic, oldest first."""
        return (message for kept in self._messages.values() for message in kept)

    def add_topic(self, topic: str) -> None:
        """Add a latched topic."""
        self._messages.setdefault(topic, deque(maxlen=_MAX_MESSAGES))

    def add(self, message: LatchedMessage) -> None:
        """Add a message of a latched topic."""
        kept = self._messages[message.topic]
        for other in [other for other in kept if other.data == message.data]:
            kept.remove(other)
        kept.append(message)
        while len(kept) > 1 and sum(len(other.data) for other in kept) > _MAX_BYTES:
            kept.popleft()


def repeated_message_times(metadata: Mapping[str, Mapping[str, str]]) -> set[tuple[str, int]]:
    """Return topic and log time of the copies in a file, by its metadata; a damaged entry is left out."""
    entries = metadata.get(REPEATED_METADATA, {})
    return {(topic, int(time)) for topic, time in entries.items() if time.isascii() and time.isdecimal()}


@dataclass(kw_only=True)
class MessageCount:
    """Number of messages, and their first and last log time; the times are None without a message."""

    start_ns: int | None = None
    end_ns: int | None = None
    message_count: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count one message."""
        self.message_count += 1
        self.start_ns = log_time_ns if self.start_ns is None else min(self.start_ns, log_time_ns)
        self.end_ns = log_time_ns if self.end_ns is None else max(self.end_ns, log_time_ns)


@dataclass
class FileInformation(MessageCount):
    """Entry of the information file for one file."""

    name: str


@dataclass
class TopicInformation:
    """Entry of the information file for one topic; `qos_profiles` is the text that the topic's channels contain."""

    name: str
    type_name: str
    qos_profiles: str
    type_hash: str
    message_count: int = 0


class SplitLimits(NamedTuple):
    """Limits at which a file with messages ends; None for no limit. The limits are checked at each flush."""

    size_bytes: int | None = None
    time_s: float | None = None


class FolderWriter:
    """rosbag2 folder being written; a recorder uses it as a :class:`ship_bags.mcap.bag_writer.BagWriter`.

    The information file names the current file before its first message, so that every file is found after a crash.
    Until :meth:`close`, the counts in the information file are from its last update.

    Args:
        folder: folder to create; the files in it are named after the folder.
        limits: limits of a file, checked by each :meth:`flush`.

    Raises:
        BadInput: the folder exists or cannot be created.
    """

    def __init__(self, folder: Path, limits: SplitLimits) -> None:
        self.path = folder
        self.files: list[FileInformation] = []
        self._limits = limits
        self._topics: dict[str, TopicInformation] = {}
        self._latched = LatchedMessages()
        self._unrepeated: list[LatchedMessage] = []
        self._is_information_outdated = False
        try:
            folder.mkdir()
        except OSError as problem:
            raise BadInput(f"cannot be made: {problem.strerror}", file=folder) from problem
        self._open_file()

    @property
    def flushed_bytes(self) -> int:
        """Length of the current file at its last flush."""
        return self._bag.flushed_bytes

    def add_topic(
        self, topic: str, type_name: str, latched: bool = False, qos_profiles: str | None = None
    ) -> None:
        """Add a topic, in this and all later files."""
        text = own_qos_text(latched) if qos_profiles is None else qos_profiles
        self._bag.add_topic(topic, type_name, latched, text)
        if latched:
            self._latched.add_topic(topic)
        self._topics[topic] = TopicInformation(topic, type_name, text, type_hash(type_name))
        self._is_information_outdated = True

    def write_raw(
        self, topic: str, type_name: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Add a message given by its CDR bytes."""
        if topic not in self._topics:
            self.add_topic(topic, type_name)
        self._repeat_latched(log_time_ns)
        self._write(topic, type_name, data, log_time_ns, publish_time_ns)
        if topic in self._latched:
            sent_ns = log_time_ns if publish_time_ns is None else publish_time_ns
            self._latched.add(LatchedMessage(topic, type_name, bytes(data), sent_ns))

    def _repeat_latched(self, log_time_ns: int) -> None:
        """Write the latched messages of earlier files before the first message of this file, and list them."""
        if not self._unrepeated:
            return
        before_ns = log_time_ns - 1
        for message in self._unrepeated:
            self._write(message.topic, message.type_name, message.data, before_ns, message.publish_time_ns)
        topics = {message.topic for message in self._unrepeated}
        self._bag.add_metadata(REPEATED_METADATA, dict.fromkeys(sorted(topics), str(before_ns)))
        self._unrepeated = []

    def _write(self, topic: str, type_name: str, data: bytes, log_time_ns: int, publish_time_ns: int | None) -> None:
        self._bag.write_raw(topic, type_name, data, log_time_ns, publish_time_ns)
        self._topics[topic].message_count += 1
        self.files[-1].add(log_time_ns)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Add a metadata record to the current file."""
        self._bag.add_metadata(name, entries)

    def add_attachment(self, name: str, content: str | bytes) -> None:
        """Add an attachment to the current file; readers use the last attachment of each name."""
        self._bag.add_attachment(name, content)

    def flush(self) -> None:
        """Flush the current file as :meth:`BagWriter.flush` does, and begin a new file if a limit is reached."""
        self._bag.flush()
        if self._is_full():
            self._bag.close()
            self._open_file()
        elif self._is_information_outdated:
            self._write_information()

    def close(self) -> None:
        """Finish the last file and the information file."""
        self._bag.close()
        self._write_information()

    def truncate(self) -> None:
        """Give up after a failed write, and truncate the current file to the last :meth:`flush`."""
        self._bag.truncate()

    def _open_file(self) -> None:
        self.files.append(FileInformation(f"{self.path.name}_{len(self.files)}.mcap"))
        self._bag = BagWriter(self.path / self.files[-1].name, atomic=False)
        # The information file names only files that exist and begin as MCAP: a crash here loses no data.
        self._bag.flush()
        self._write_information()
        self._file_start_s = time.monotonic()
        for topic in self._topics.values():
            self._bag.add_topic(topic.name, topic.type_name, topic.name in self._latched, topic.qos_profiles)
        self._unrepeated = list(self._latched)

    def _is_full(self) -> bool:
        if self.files[-1].message_count == 0:
            return False
        size_bytes, time_s = self._limits
        return (size_bytes is not None and self._bag.flushed_bytes >= size_bytes) or (
            time_s is not None and time.monotonic() - self._file_start_s >= time_s
        )

    def _write_information(self) -> None:
        write_information(self.path, self.files, list(self._topics.values()))
        self._is_information_outdated = False


def needs_rosbags(path: Path) -> bool:
    """True if a bag needs the library `rosbags`: sqlite3 or compressed files instead of plain MCAP.

    Raises:
        BadInput: the bag is a folder with a wrong information file, or of an unknown storage.
    """
    if path.is_file():
        return path.suffix == _SQLITE_SUFFIX
    if not (path / INFORMATION_FILE).is_file():
        return False
    information = _read_information(path / INFORMATION_FILE)
    _listed_files(information, path / INFORMATION_FILE)
    return information.get("storage_identifier") != "mcap" or _compression_mode(information) != "none"


def file_names(information_path: Path) -> list[str]:
    """Return the files listed in an information file, all in or below its folder.

    Raises:
        BadInput: the file cannot be read, is not an information file of a known storage, or lists a file outside
            its folder.
    """
    return _listed_files(_read_information(information_path), information_path)


def _read_information(path: Path) -> dict[str, Any]:
    """Return the entries of an information file with a known storage."""
    try:
        document = plain_data(str(path), path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as problem:
        raise BadInput(f"cannot be read: {problem}", file=path) from problem
    information = document.get(_INFORMATION_KEY) if isinstance(document, dict) else None
    if not isinstance(information, dict):
        raise BadInput(f"not the information file of a rosbag2 bag: it has no {_INFORMATION_KEY}", file=path)
    for key, known in (("storage_identifier", _STORAGES), ("compression_mode", _COMPRESSION_MODES)):
        value = _compression_mode(information) if key == "compression_mode" else information.get(key)
        if value not in known:
            raise BadInput(f"{key} is '{value!s:.40}': expected {' or '.join(known)}", file=path)
    return information


def _compression_mode(information: dict[str, Any]) -> str:
    return str(information.get("compression_mode") or "none").lower()


def _listed_files(information: dict[str, Any], path: Path) -> list[str]:
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise BadInput("relative_file_paths names no file", file=path)
    for name in names:
        # A file of another folder is not part of this bag, even if it is listed.
        if not isinstance(name, str) or "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
            raise BadInput(f"relative_file_paths: '{name!s:.80}' is not a file of this folder", file=path)
    return names


def write_information(folder: Path, files: Sequence[FileInformation], topics: Sequence[TopicInformation]) -> None:
    """Write metadata.yaml atomically, so that a power failure leaves either the former or the new file.

    Raises:
        OSError: the file cannot be written; the former file stays.
    """
    write_atomically(folder / INFORMATION_FILE, yaml.safe_dump(_information(files, topics), sort_keys=False))
    _sync_folder(folder)


def _sync_folder(folder: Path) -> None:
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def _information(files: Sequence[FileInformation], topics: Sequence[TopicInformation]) -> dict[str, Any]:
    start_ns = min((file.start_ns for file in files if file.start_ns is not None), default=None)
    end_ns = max((file.end_ns for file in files if file.end_ns is not None), default=None)
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        **_span(start_ns, end_ns),
        "message_count": sum(file.message_count for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _offers(topic.qos_profiles),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {"path": file.name, **_span(file.start_ns, file.end_ns), "message_count": file.message_count}
            for file in files
        ],
        "custom_data": None,
        "ros_distro": _ROS_DISTRO,
    }
    return {_INFORMATION_KEY: information}


def _offers(text: str) -> list[Any]:
    """Return the QoS stored in a channel; empty if the text of a damaged bag is something else."""
    try:
        offers = plain_data("offered_qos_profiles", text)
    except BadInput:
        return []
    return offers if isinstance(offers, list) else []


def _span(start_ns: int | None, end_ns: int | None) -> dict[str, dict[str, int]]:
    start, end = (0, 0) if start_ns is None or end_ns is None else (start_ns, end_ns)
    return {"duration": {"nanoseconds": end - start}, "starting_time": {"nanoseconds_since_epoch": start}}

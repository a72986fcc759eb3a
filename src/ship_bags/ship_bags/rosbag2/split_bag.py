"""Writes a rosbag2 folder: files that are split by size and time, and an information file that is always whole."""

import time
from pathlib import Path
from typing import NamedTuple

from ship_bags.errors import BadInput
from ship_bags.mcap.stored_messages_writer import BagWriter, qos_text
from ship_bags.message_store import type_hash
from ship_bags.rosbag2.rosbag2_folder import FileInformation, TopicInformation, write_information


class SplitLimits(NamedTuple):
    """When a new file begins; None is never. A file goes beyond by what one flush period brings, at most."""

    size_bytes: int | None = None
    time_s: float | None = None


class FolderWriter:
    """A rosbag2 folder being written, with the calls of :class:`ship_bags.mcap.stored_messages_writer.BagWriter`.

    The information file names the file being written before its first message, so that after a crash every file is
    found; its counts are those of its last writing until :meth:`close`.

    Args:
        folder: folder to make; its files are named after it.
        limits: when a new file begins, looked at by each :meth:`flush`.

    Raises:
        BadInput: the folder is there already or cannot be made.
    """

    def __init__(self, folder: Path, limits: SplitLimits) -> None:
        self.path = folder
        self.files: list[FileInformation] = []
        self._limits = limits
        self._topics: dict[str, TopicInformation] = {}
        self._latched: set[str] = set()
        self._outdated = False
        try:
            folder.mkdir()
        except OSError as problem:
            raise BadInput(f"{folder}: cannot be made: {problem.strerror}") from problem
        self._begin_file()

    @property
    def message_count(self) -> int:
        """Messages written, in all files."""
        return sum(file.message_count for file in self.files)

    @property
    def whole_bytes(self) -> int:
        """Length of the file being written at its last flush."""
        return self._bag.whole_bytes

    def add_topic(
        self, topic: str, type_name: str, latched: bool = False, qos_profiles: str | None = None
    ) -> None:
        """Announce a topic; in this and all later files."""
        own_qos = qos_text(
            "keep_last", 1 if latched else 100, "reliable", "transient_local" if latched else "volatile"
        )
        text = own_qos if qos_profiles is None else qos_profiles
        self._bag.add_topic(topic, type_name, latched, text)
        if latched:
            self._latched.add(topic)
        self._topics[topic] = TopicInformation(topic, type_name, text, type_hash(type_name))
        self._outdated = True

    def write_raw(
        self, topic: str, type_name: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Add a message given by its CDR bytes, as they are."""
        if topic not in self._topics:
            self.add_topic(topic, type_name)
        self._bag.write_raw(topic, type_name, data, log_time_ns, publish_time_ns)
        self._topics[topic].message_count += 1
        self.files[-1].add(log_time_ns)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Add a metadata record to the file being written."""
        self._bag.add_metadata(name, entries)

    def add_attachment(self, name: str, content: str | bytes) -> None:
        """Attach a file to the file being written; a later one of the same name takes its place."""
        self._bag.add_attachment(name, content)

    def flush(self) -> None:
        """Bring every message written so far onto the disk, and begin a new file when it is time."""
        self._bag.flush()
        if self._is_full():
            self._bag.close()
            self._begin_file()
        elif self._outdated:
            self._write_information()

    def close(self) -> None:
        """Finish the last file and the information file."""
        self._bag.close()
        self._write_information()

    def cut(self) -> None:
        """Give up after a failed write: what was written since the last :meth:`flush` is cut off."""
        self._bag.cut()

    def _begin_file(self) -> None:
        self.files.append(FileInformation(f"{self.path.name}_{len(self.files)}.mcap"))
        self._bag = BagWriter(self.path / self.files[-1].name, atomic=False)
        # Named once it is there and begins as an MCAP file does: a crash in between costs neither file nor folder.
        self._bag.flush()
        self._write_information()
        self._begun_s = time.monotonic()
        for topic in self._topics.values():
            self._bag.add_topic(topic.name, topic.type_name, topic.name in self._latched, topic.qos_profiles)

    def _is_full(self) -> bool:
        if self.files[-1].message_count == 0:
            return False
        size_bytes, time_s = self._limits
        return (size_bytes is not None and self._bag.whole_bytes >= size_bytes) or (
            time_s is not None and time.monotonic() - self._begun_s >= time_s
        )

    def _write_information(self) -> None:
        write_information(self.path, self.files, list(self._topics.values()))
        self._outdated = False

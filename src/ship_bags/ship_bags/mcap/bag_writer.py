"""Writer of MCAP bags as rosbag2 makes them: CDR messages, embedded definitions, QoS per topic.

The same calls give the same bytes, whatever the time and the place of writing.

A flushed bag survives a crash: the flushed part consists of complete chunks. Definitions are stored twice, inside a
chunk and after it, so that no single damage makes the messages of other chunks unreadable.
"""

import contextlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from ship_bags.errors import BadInput
from ship_bags.mcap.mcap_writer import McapWriter
from ship_bags.output_files import DiskSync, error_with_path, file_in_errors, open_new, part_path

SUITE_ATTACHMENT = "suite.yaml"
"""Name of the attachment with the suite's configuration."""

SCENARIO_ATTACHMENT = "scenario.yaml"
"""Name of the attachment with the scenario of a simulated bag."""

_FEW_MESSAGES = 16
"""Number of messages below which it is faster to write them one by one than together."""

_NEW = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
_EXCLUSIVE, _REPLACING = _NEW | os.O_EXCL, _NEW | os.O_TRUNC

_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_QOS_TEMPLATE = """\
- history: {history}
  depth: {depth}
  reliability: {reliability}
  durability: {durability}
  deadline: {forever}
  lifespan: {forever}
  liveliness: automatic
  liveliness_lease_duration: {forever}
  avoid_ros_namespace_conventions: false
"""


def qos_text(history: str, depth: int, reliability: str, durability: str) -> str:
    """Return an offered QoS as rosbag2 stores it, e.g. ``qos_text("keep_last", 1, "reliable", "volatile")``."""
    return _QOS_TEMPLATE.format(
        history=history, depth=depth, reliability=reliability, durability=durability, forever=_FOREVER
    )


def own_qos_text(latched: bool) -> str:
    """Return the QoS that the suite's own publishers offer, as rosbag2 stores it."""
    return qos_text("keep_last", 1 if latched else 100, "reliable", "transient_local" if latched else "volatile")


class TypeDefinition(NamedTuple):
    """Definition of a message type with all types that it refers to ("ros2msg"), and its RIHS01 hash."""

    text: str
    hash: str


def suite_definition(type_name: str) -> TypeDefinition:
    """Return the definition of a type of ROS 2 Jazzy or of ship_msgs.

    Raises:
        rosbags.typesys.TypesysError: the type is unknown.
    """
    from ship_bags.message_store import definition, type_hash

    return TypeDefinition(definition(type_name), type_hash(type_name))


class BagWriter:
    """MCAP file being written; use it in a ``with`` statement.

    The types of :mod:`ship_bags.message_store` are loaded only if needed. A live node gives definitions and bytes
    itself, and starts sooner without these types.

    Attributes:
        path: path of the file.
        message_count: number of messages written.
        flushed_bytes: length of the file at the last :meth:`flush`, up to which it stays readable.

    Args:
        path: file to write, ending in .mcap.
        atomic: True to write to ``<path>.part`` and rename this file at the end, so that a file named ``path`` is
            always complete. False for a recorder, whose file must survive a crash.
        define: returns the definition of a message type by its name, or raises any exception.
        library: name of the program, for the header of the file. The default must not change: the same scenario and
            seed give the same bytes in every version.
        exclusive: True to refuse overwriting a file; without effect if ``atomic``.

    Raises:
        BadInput: the file cannot be created.
    """

    def __init__(
        self,
        path: Path | str,
        atomic: bool = True,
        *,
        define: Callable[[str], TypeDefinition] = suite_definition,
        library: str = "ship_replay",
        exclusive: bool = False,
    ) -> None:
        self.path = Path(path)
        self.message_count = self.flushed_bytes = 0
        self._define = define
        self._written_path = part_path(self.path) if atomic else self.path
        try:
            self._file = _open(self._written_path, atomic, exclusive)
        except OSError as problem:
            raise BadInput(f"cannot be written: {problem.strerror}", file=self.path) from problem
        self._sync = DiskSync(self._file.fileno())
        self._writer = McapWriter(self._file, self.path.parent, profile="ros2", library=library)
        self._schemas: dict[str, tuple[int, str]] = {}
        self._channels: dict[str, tuple[int, str]] = {}
        self._sequences: dict[int, int] = {}
        self._unrepeated_records: list[Schema | Channel] = []

    def add_topic(
        self, topic: str, type_name: str, latched: bool = False, qos_profiles: str | None = None
    ) -> None:
        """Add a topic before its first message. This call is needed only for a latched or empty topic, or another QoS.

        Args:
            topic: name of the topic.
            type_name: type of the messages, e.g. ``sensor_msgs/msg/Imu``.
            latched: True if the last message is kept for late subscribers.
            qos_profiles: QoS that the topic's publishers offer, by :func:`qos_text`; None for the QoS of the suite's
                publishers.

        Raises:
            BadInput: the topic already has another type, or the type is unknown.
            OSError: the file cannot be written.
        """
        self._channel_id(topic, type_name, latched, qos_profiles)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message made by :class:`ship_bags.message_store.RosbagsFactory` or decoded from a bag.

        Raises:
            BadInput: the topic already has another type, or the type is unknown.
            OSError: the file cannot be written.
        """
        from ship_bags.message_store import serialize

        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(
        self,
        topic: str,
        type_name: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Add a message given by its CDR bytes; without a sequence number the messages of the topic are counted.

        Raises:
            BadInput: the topic already has another type, or the type is unknown.
            OSError: the file cannot be written.
        """
        channel_id = self._channel_id(topic, type_name)
        if sequence is None:
            sequence = self._sequences[channel_id] = self._sequences.get(channel_id, 0) + 1
        sent_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        try:
            self._writer.add_message(channel_id, log_time_ns, data, sent_ns, sequence)
        except OSError as problem:
            raise error_with_path(problem, self.path) from problem
        self.message_count += 1

    def write_many(
        self,
        topics: Sequence[tuple[str, str]],
        of_topic: NDArray[np.int64],
        data: Sequence[bytes],
        log_times_ns: NDArray[np.int64],
    ) -> None:
        """Add messages one after another, as by :meth:`write_raw`.

        Args:
            topics: name and type of each topic.
            of_topic: index of the topic of each message, shape (N,).
            data: bytes of each message.
            log_times_ns: log times, ns, shape (N,).

        Raises:
            BadInput: a topic already has another type, or the type is unknown.
            OSError: the file cannot be written.
        """
        if len(data) < _FEW_MESSAGES:
            for number, content, time_ns in zip(of_topic.tolist(), data, log_times_ns.tolist(), strict=True):
                topic, type_name = topics[number]
                self.write_raw(topic, type_name, content, time_ns)
            return
        sequences = np.empty(len(data), dtype=np.int64)
        channel_ids = np.empty(len(data), dtype=np.int64)
        # Channels are made in the order of their first messages.
        for number in dict.fromkeys(of_topic.tolist()):
            places = np.flatnonzero(of_topic == number)
            channel_id = self._channel_id(*topics[number])
            before = self._sequences.get(channel_id, 0)
            self._sequences[channel_id] = before + len(places)
            channel_ids[places], sequences[places] = channel_id, before + 1 + np.arange(len(places))
        with file_in_errors(self.path):
            self._writer.add_messages(channel_ids, log_times_ns, data, sequences)
        self.message_count += len(data)

    def add_attachment(self, name: str, content: str | bytes, media_type: str = "application/yaml") -> None:
        """Attach a file."""
        data = content.encode() if isinstance(content, str) else content
        with file_in_errors(self.path):
            self._writer.add_attachment(name, media_type, data)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Add a metadata record."""
        with file_in_errors(self.path):
            self._writer.add_metadata(name, entries)

    def flush(self) -> None:
        """Pass all messages so far to the operating system, so that they survive this process, and start a sync.

        Raises:
            OSError: the file cannot be written, or the sync of an earlier flush failed.
        """
        with file_in_errors(self.path):
            self._writer.flush()
            self._repeat_definitions()
            self._file.flush()
            self._sync.request()
            self.flushed_bytes = self._file.tell()

    def close(self) -> None:
        """Finish the file; an atomic writer renames the file, or leaves no file if this fails.

        Raises:
            OSError: the file cannot be written.
        """
        if self._file.closed:
            return
        try:
            with file_in_errors(self.path):
                self._writer.finish()
                self._file.flush()
                self._sync.finish()
                os.fsync(self._file.fileno())
                if self._written_path != self.path:
                    # The file is renamed before it is closed. Closing ends its lock; another program could then remove
                    # the .part file.
                    self._written_path.replace(self.path)
                self._file.close()
        except BaseException:
            if self._written_path != self.path:
                self.discard()
            raise

    def discard(self) -> None:
        """Give up; an atomic writer leaves no file, any other writer leaves the part that is written."""
        if self._written_path != self.path:
            self._written_path.unlink(missing_ok=True)
        self._release()

    def truncate(self) -> None:
        """Give up after a failed write, and truncate the file to the last :meth:`flush`."""
        self._release()
        with contextlib.suppress(OSError):
            os.truncate(self._written_path, self.flushed_bytes)

    def _release(self) -> None:
        # Closing flushes the buffers, which fails again on a full disk.
        with contextlib.suppress(OSError):
            self._writer.discard()
        self._sync.finish()
        with contextlib.suppress(OSError):
            self._file.close()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or self._written_path == self.path:
            self.close()
        else:
            self.discard()

    def _channel_id(
        self, topic: str, type_name: str, latched: bool = False, qos_profiles: str | None = None
    ) -> int:
        known = self._channels.get(topic)
        if known is not None:
            if known[1] != type_name:
                raise BadInput(f"topic '{topic}' carries {known[1]}, not {type_name}", file=self.path)
            return known[0]
        schema_id, type_hash = self._schema(type_name)
        qos = own_qos_text(latched) if qos_profiles is None else qos_profiles
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        channel_id = self._writer.register_channel(topic, "cdr", schema_id, metadata)
        self._unrepeated_records.append(Channel(channel_id, topic, "cdr", metadata, schema_id))
        self._channels[topic] = (channel_id, type_name)
        return channel_id

    def _schema(self, type_name: str) -> tuple[int, str]:
        """Return the id of a type in the file, and its hash; the type is registered at its first use."""
        if type_name not in self._schemas:
            try:
                text, type_hash = self._define(type_name)
            except Exception as problem:
                raise BadInput(f"message type {type_name} is unknown", file=self.path) from problem
            data = text.encode()
            schema_id = self._writer.register_schema(type_name, "ros2msg", data)
            self._unrepeated_records.append(Schema(schema_id, data, "ros2msg", type_name))
            self._schemas[type_name] = schema_id, type_hash
        return self._schemas[type_name]

    def _repeat_definitions(self) -> None:
        """Write new schemas and channels once more, between chunks, as MCAP allows."""
        records = RecordBuilder()
        for record in self._unrepeated_records:
            record.write(records)
        self._unrepeated_records.clear()
        end: Callable[[], bytes] = records.end  # mcap gives it no type
        self._file.write(end())


def _open(path: Path, atomic: bool, exclusive: bool) -> BinaryIO:
    if atomic:
        return open_new(path)
    # Without a mode, os.open would create an executable file.
    number = os.open(path, _EXCLUSIVE if exclusive else _REPLACING, 0o666)
    return os.fdopen(number, "wb")

"""Writes MCAP bags as rosbag2 does: CDR messages, embedded definitions, quality of service per topic.

The same calls give the same bytes: nothing in the file depends on the time or the place of writing.
"""

import os
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer

from ship_replay.errors import BadInput
from ship_replay.message_store import definition, serialize, type_hash

SUITE_ATTACHMENT = "suite.yaml"
"""Name of the attachment that holds the suite's configuration."""

SCENARIO_ATTACHMENT = "scenario.yaml"
"""Name of the attachment that holds the scenario of a simulated bag."""

_LIBRARY = "ship_replay"
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_QOS_TEMPLATE = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {forever}
  lifespan: {forever}
  liveliness: automatic
  liveliness_lease_duration: {forever}
  avoid_ros_namespace_conventions: false
"""


class BagWriter:
    """One MCAP file being written; use it in a ``with`` statement.

    Args:
        path: file to write, ending in .mcap.
        atomic: write beside it (``<path>.part``) and rename at the end, so that a file of this name is always
            whole. A recorder, whose file must survive a crash, says False.

    Raises:
        BadInput: the file cannot be made.
    """

    def __init__(self, path: Path | str, atomic: bool = True) -> None:
        self.path = Path(path)
        self.message_count = 0
        self._written_path = self.path.with_name(self.path.name + ".part") if atomic else self.path
        try:
            self._file = open(self._written_path, "wb")  # noqa: SIM115 - closed by close()
        except OSError as problem:
            raise BadInput(f"{self.path}: cannot be written: {problem.strerror}") from problem
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=_LIBRARY)
        self._schema_ids: dict[str, int] = {}
        self._channels: dict[str, tuple[int, str]] = {}
        self._sequences: dict[int, int] = {}

    def add_topic(self, topic: str, type_name: str, latched: bool = False) -> None:
        """Announce a topic before its first message; needed only where it is latched or may stay empty."""
        self._channel_id(topic, type_name, latched)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message made by :class:`ship_replay.message_store.RosbagsFactory` or decoded from a bag.

        Raises:
            BadInput: the topic already carries another type.
        """
        self.write_raw(topic, message.__msgtype__, serialize(message), log_time_ns)

    def write_raw(
        self, topic: str, type_name: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Add a message given by its CDR bytes, as they are.

        Raises:
            BadInput: the topic already carries another type, or the type is unknown.
        """
        channel_id = self._channel_id(topic, type_name)
        sequence = self._sequences[channel_id] = self._sequences.get(channel_id, 0) + 1
        self._writer.add_message(
            channel_id=channel_id,
            log_time=log_time_ns,
            data=data,
            publish_time=log_time_ns if publish_time_ns is None else publish_time_ns,
            sequence=sequence,
        )
        self.message_count += 1

    def add_attachment(self, name: str, content: str | bytes, media_type: str = "application/yaml") -> None:
        """Attach a file."""
        data = content.encode() if isinstance(content, str) else content
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, entries)

    def flush(self) -> None:
        """Bring every message written so far onto the disk."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Finish the file; with ``atomic`` it gets its name now."""
        if self._file.closed:
            return
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        if self._written_path != self.path:
            self._written_path.replace(self.path)

    def discard(self) -> None:
        """Give up: an atomic writer leaves nothing behind, another what it wrote so far."""
        self._file.close()
        if self._written_path != self.path:
            self._written_path.unlink(missing_ok=True)

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None or self._written_path == self.path:
            self.close()
        else:
            self.discard()

    def _channel_id(self, topic: str, type_name: str, latched: bool = False) -> int:
        known = self._channels.get(topic)
        if known is not None:
            if known[1] != type_name:
                raise BadInput(f"{self.path}: topic '{topic}' carries {known[1]}, not {type_name}")
            return known[0]
        channel_id = self._writer.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schema_id(type_name),
            metadata={
                "offered_qos_profiles": _QOS_TEMPLATE.format(
                    depth=1 if latched else 100,
                    durability="transient_local" if latched else "volatile",
                    forever=_FOREVER,
                ),
                "topic_type_hash": type_hash(type_name),
            },
        )
        self._channels[topic] = (channel_id, type_name)
        return channel_id

    def _schema_id(self, type_name: str) -> int:
        if type_name not in self._schema_ids:
            try:
                text = definition(type_name)
            except Exception as problem:
                raise BadInput(f"{self.path}: message type {type_name} is unknown") from problem
            self._schema_ids[type_name] = self._writer.register_schema(type_name, "ros2msg", text.encode())
        return self._schema_ids[type_name]

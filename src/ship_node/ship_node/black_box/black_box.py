"""Black box of a live node: all inputs and outputs in order of use, on the disk within a tenth of a second.

The node only puts entries into a queue; a thread writes them, so that a slow disk never delays the estimate.

A further file, ``NAME.part2.mcap`` and so on, follows when the last one is full or the disk works again. It is next to
the first file. Each file starts with the header, so that the file can be read alone. When the first file is opened, the
bag reader reads all files as one bag.
"""

import json
import re
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import serialize_message
from std_msgs.msg import String

from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_definition, type_hash
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER
from ship_bags.provenance import versions
from ship_node.adapters.adapter import Adapter
from ship_node.black_box.black_box_format import (
    EVENTS_TOPIC,
    EVENTS_TYPE,
    FORMAT,
    METADATA,
    VERSIONS_ATTACHMENT,
    Closed,
    EntriesLost,
    Event,
    FileUsed,
    event_text,
)
from ship_node.messages.common_messages import DiagnosticStatus, Level
from ship_node.messages.inputs_outputs import OutputTopic
from ship_node.parameters.parameter_file import parameter_text
from ship_node.saved_files.saved_document import FileUse

FLUSH_PERIOD_S = 0.07
"""Flush period, s; including the duration of a flush, data are on the disk after 0.1 s."""

MAX_QUEUE_ENTRIES = 50_000
"""Maximum number of entries waiting for a slow disk, about a minute of a node at 200 Hz.

Further entries are lost and counted.
"""

MAX_QUEUE_BYTES = 64 * 2**20
"""Maximum size of the waiting entries, bytes; files that the node read and wrote do not count."""

RETRY_S = 10.0
"""Period of the attempts to open a new file after a failure of the disk, s."""

MAX_ENTRIES_BEFORE_TIME = 1000
"""Maximum number of entries kept before the node has a time; above it the oldest entries are lost."""


class BlackBoxHeader(NamedTuple):
    """Header of each file of a black box: names, parameters and versions as texts, and all topics."""

    node: str
    namespace: str
    parameters: str
    versions: str
    topics: Sequence[OutputTopic]


class BlackBoxFiles:
    """Files of one black box, of which the last is being written.

    Attributes:
        path: path of the first file.
        writer: writer of the last file. After a failed write, ``truncate`` keeps the file up to its last flush.
        count: number of entries written, in all files; each entry has its number.

    Args:
        path: path given by the parameter; see :func:`free_path`.
        head: header of each file.
        part_bytes: size at which a file is full; 0 for never.

    Raises:
        BadInput: the first file cannot be created.
    """

    def __init__(self, path: str, head: BlackBoxHeader, part_bytes: int) -> None:
        self.count = 0
        self._head, self._part_bytes = head, part_bytes
        self._types = {topic.topic: topic.type_name for topic in head.topics}
        self._id, self._part = secrets.token_hex(8), 1
        self.writer = _open_first(path, head.node)
        self.path = self.writer.path
        self._write_header(self.writer)

    def write(self, topic: str, data: bytes, time_ns: int, waiting_ns: int) -> None:
        """Add an entry; the entries of all topics are numbered together, so that a gap shows a missing entry."""
        self.count += 1
        self.writer.write_raw(topic, self._types[topic], data, time_ns, waiting_ns, self.count)

    def flush(self) -> None:
        """Write everything to the disk, and begin a new file if the last one is full."""
        self.writer.flush()
        if self._part_bytes and self.writer.flushed_bytes >= self._part_bytes:
            full = self.writer
            self.open_next()
            full.close()

    def open_next(self) -> None:
        """Begin a new file.

        Raises:
            OSError, BadInput: the file cannot be created; no part of it is left.
        """
        number = self._part + 1
        while (path := self.path.with_name(f"{self.path.stem}.part{number}.mcap")).exists():
            number += 1
        writer = _writer(path)
        before, self._part = self._part, self._part + 1
        try:
            self._write_header(writer)
        except BaseException:
            self._part = before
            writer.truncate()
            path.unlink(missing_ok=True)
            raise
        self.writer = writer

    def close(self) -> None:
        """Finish the last file."""
        self.writer.close()

    def _write_header(self, writer: BagWriter) -> None:
        head = self._head
        entries = {"format": FORMAT, "node": head.node, "namespace": head.namespace}
        writer.add_metadata(METADATA, entries | {"box": self._id, "part": str(self._part), "first": self.path.name})
        writer.add_attachment(SUITE_ATTACHMENT, head.parameters)
        writer.add_attachment(VERSIONS_ATTACHMENT, head.versions, "application/json")
        for topic in head.topics:
            writer.add_topic(topic.topic, topic.type_name, topic.latched)
        writer.flush()


def free_path(path: Path) -> Path:
    """Return the path if neither the path nor a numbered path exists; otherwise the path with the next number.

    The numbered paths are ``box_2.mcap``, ``box_3.mcap`` and so on.
    """
    pattern = re.compile(re.escape(path.stem) + r"_(\d+)" + re.escape(path.suffix))
    matches = [pattern.fullmatch(other.name) for other in path.parent.iterdir()]
    newest = max((int(match[1]) for match in matches if match), default=1 if path.exists() else 0)
    return path.with_name(f"{path.stem}_{newest + 1}{path.suffix}") if newest else path


def _open_first(text: str, node_name: str) -> BagWriter:
    """Open a new file at a path, or a file with the node's name in a folder."""
    path = Path(text)
    if text.endswith("/") or path.is_dir():
        path = path / f"{node_name}.mcap"
    if path.suffix != ".mcap":
        raise _unusable_path_error(text, "expected a file ending in .mcap, or a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            free = free_path(path)
            try:
                return _writer(free)
            except BadInput:
                # Another node may have taken the name meanwhile.
                if not free.exists():
                    raise
    except (OSError, BadInput) as error:
        raise _unusable_path_error(text, str(error)) from error


def _writer(path: Path) -> BagWriter:
    return BagWriter(path, atomic=False, define=installed_definition, library="ship_node", exclusive=True)


def _unusable_path_error(path: str, reason: str) -> BadInput:
    name = BLACK_BOX_PARAMETER
    return BadInput(f"parameter '{name}' = '{path}': {reason}", parameters=(name,), value=path)


class _Message(NamedTuple):
    topic: str
    data: bytes
    time_ns: int
    waiting_ns: int


class _Attachment(NamedTuple):
    name: str
    content: bytes


class BlackBox:
    """Black box being written.

    Attributes:
        path: path of the first file.

    Args:
        path: path given by the parameter; see :func:`ship_node.black_box.black_box.free_path`.
        adapter: adapter of the node.
        config: configuration of the node.
        outputs: all topics that are published.
        namespace: namespace of the node.
        on_failure: called with a log line when the disk fails, and when writing continues in a new file.
        part_bytes: size at which a new file begins; 0 for never.

    Raises:
        BadInput: the file cannot be created.
    """

    def __init__(
        self,
        path: str,
        adapter: Adapter,
        config: Any,
        outputs: Iterable[OutputTopic],
        namespace: str,
        on_failure: Callable[[str], None],
        part_bytes: int = 0,
    ) -> None:
        node = adapter.node_name
        topics = [OutputTopic(EVENTS_TOPIC, EVENTS_TYPE)]
        topics += [*(OutputTopic(topic.topic, topic.type_name) for topic in adapter.inputs), *outputs]
        package = type(adapter).__module__.partition(".")[0]
        used = versions(package, {topic.type_name: type_hash(topic.type_name) for topic in topics})
        head = BlackBoxHeader(node, namespace, parameter_text(node, config), json.dumps(used, indent=1), topics)
        self._files = BlackBoxFiles(path, head, part_bytes)
        self.path = self._files.path
        self._queue: deque[_Message | _Attachment] = deque()
        self._bytes_put = self._bytes_written = 0
        self._before_time: deque[_Message] = deque()
        self._last_ns = 0
        self._file_count = self._lost = self._lost_unreported = 0
        self._unflushed = self._lost_by_failure = 0
        self._failure, self._retry_s = "", 0.0
        self._on_failure = on_failure
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._write_periodically, name="black box", daemon=True)
        self._thread.start()

    def add(self, topic: str, data: bytes, time_ns: int, waiting_ns: int | None = None) -> None:
        """Record a message used or published.

        Args:
            topic: relative name of the topic.
            data: CDR bytes of the message.
            time_ns: the node time; 0 before the first /clock. Such a message gets the time of the first entry that has
                a time.
            waiting_ns: timeout-clock time; None if it is equal to ``time_ns``.
        """
        if time_ns == 0:
            if len(self._before_time) >= MAX_ENTRIES_BEFORE_TIME:
                self._before_time.popleft()
                self._lost += 1
                self._lost_unreported += 1
            self._before_time.append(_Message(topic, data, 0, 0))
            return
        self._last_ns = time_ns
        if self._before_time:
            for message in self._before_time:
                self._append(message._replace(time_ns=time_ns, waiting_ns=time_ns))
            self._before_time.clear()
        self._append(_Message(topic, data, time_ns, time_ns if waiting_ns is None else waiting_ns))

    def add_event(self, event: Event, time_ns: int, waiting_ns: int | None = None) -> None:
        """Record an event; the times are as in :meth:`add`."""
        self.add(EVENTS_TOPIC, _event_data(event), time_ns, waiting_ns)

    def add_file(self, use: FileUse, time_ns: int) -> None:
        """Record a file read or written, with its content."""
        name = None
        if use.content is not None:
            self._file_count += 1
            name = f"files/{self._file_count:04d}/{Path(use.path).name}"
            self._queue.append(_Attachment(name, use.content))
        self.add_event(FileUsed(use.path, use.written, name, use.error), time_ns)

    def status(self) -> DiagnosticStatus:
        """Return the status of the black box."""
        writer = self._files.writer
        if self._failure:
            text = f"{writer.path}: writing failed: {self._failure}; a new file is tried every {RETRY_S:g} s"
            return DiagnosticStatus("black box", Level.ERROR, text)
        values = {"bytes": str(writer.flushed_bytes), "waiting": str(len(self._queue)), "lost": str(self._lost)}
        if self._lost:
            why = "the disk was slow or full, or /clock was missing"
            text = f"{writer.path}: {self._lost} entries lost: {why}"
            return DiagnosticStatus("black box", Level.ERROR, text, values)
        return DiagnosticStatus("black box", Level.OK, f"writing {writer.path}", values)

    def close(self) -> None:
        """Write the remaining entries and finish the file; a second call does nothing."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._thread.join()
        # If the node never had a time, the entries waiting for a time are written now.
        self.add_event(Closed(), max(self._last_ns, 1))
        self._run_write(self._write_all)
        self._run_write(self._files.close)

    def _append(self, message: _Message) -> None:
        waiting_bytes = self._bytes_put - self._bytes_written
        if len(self._queue) >= MAX_QUEUE_ENTRIES or waiting_bytes + len(message.data) > MAX_QUEUE_BYTES:
            self._lost += 1
            self._lost_unreported += 1
            return
        if self._lost_unreported:
            lost = _event_data(EntriesLost(self._lost_unreported))
            self._lost_unreported = 0
            self._enqueue(message._replace(topic=EVENTS_TOPIC, data=lost))
        self._enqueue(message)

    def _enqueue(self, message: _Message) -> None:
        self._bytes_put += len(message.data)
        self._queue.append(message)

    def _write_periodically(self) -> None:
        due_s = time.monotonic() + FLUSH_PERIOD_S
        while not self._stopping.wait(max(0.0, due_s - time.monotonic())):
            due_s = time.monotonic() + FLUSH_PERIOD_S
            self._run_write(self._write_all)

    def _write_all(self) -> None:
        count = len(self._queue)
        for _ in range(count):
            entry = self._queue.popleft()
            self._unflushed += 1
            if isinstance(entry, _Attachment):
                self._files.writer.add_attachment(entry.name, entry.content, "application/octet-stream")
            else:
                self._bytes_written += len(entry.data)
                self._write_loss(entry)
                self._files.write(*entry)
        if count:
            self._files.flush()
            self._unflushed = 0

    def _write_loss(self, entry: _Message) -> None:
        """Record, before the first entry after a failure of the disk, the number of entries that the failure lost."""
        if self._lost_by_failure:
            lost, self._lost_by_failure = _event_data(EntriesLost(self._lost_by_failure)), 0
            self._files.write(EVENTS_TOPIC, lost, entry.time_ns, entry.waiting_ns)

    def _run_write(self, write: Callable[[], None]) -> None:
        """Call a write function; a failure does not end the node.

        After a failure entries are lost until a new file is open.
        """
        if self._failure and not self._has_new_file():
            self._drop_pending()
            return
        try:
            write()
        except Exception as error:
            self._failure = error.strerror if isinstance(error, OSError) and error.strerror else repr(error)
            self._retry_s = time.monotonic() + RETRY_S
            self._files.writer.truncate()
            self._drop_pending()
            self._on_failure(
                f"black box {self._files.writer.path}: writing failed: {self._failure}; it is complete up to the last "
                f"flush, and a new file is tried every {RETRY_S:g} s"
            )

    def _has_new_file(self) -> bool:
        """Try to continue in a new file; return True if the file could be created."""
        if time.monotonic() < self._retry_s:
            return False
        try:
            self._files.open_next()
        except (OSError, BadInput):
            self._retry_s = time.monotonic() + RETRY_S
            return False
        self._failure = ""
        self._on_failure(f"black box continues in {self._files.writer.path}: {self._lost_by_failure} entries were lost")
        return True

    def _drop_pending(self) -> None:
        """Count the waiting entries, and the entries written since the last flush, as lost."""
        count = len(self._queue)
        for _ in range(count):
            entry = self._queue.popleft()
            self._bytes_written += 0 if isinstance(entry, _Attachment) else len(entry.data)
        self._lost += count + self._unflushed
        self._lost_by_failure += count + self._unflushed
        self._unflushed = 0


def _event_data(event: Event) -> bytes:
    return bytes(serialize_message(String(data=event_text(event))))

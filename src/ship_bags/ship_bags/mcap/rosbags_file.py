"""rosbag2 folders and files other than plain MCAP (sqlite3, or compressed), read by the library `rosbags`."""

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.records import Channel, Message, Schema
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_file import BagFile
from ship_bags.mcap.records import MAX_CHUNK_BYTES, MAX_CHUNK_MB, ChunkPlace, decompress, is_stamp_time
from ship_bags.stamps import NS_PER_S, utc_text

_MAX_PLACES = 10_000
_FRAME_HEAD_BYTES = 18
"""Maximum length of the header of a zstd frame, which may state the size of its content."""
_ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


@dataclass
class RosbagsFile(BagFile):
    """Folder, or sqlite3 file, read by `rosbags`; each place is a range of log times."""

    reader: Reader = field(kw_only=True)

    @property
    def size_bytes(self) -> int:
        """See :class:`BagFile`."""
        files = [self.path] if self.path.is_file() else [path for path in self.path.iterdir() if path.is_file()]
        return sum(path.stat().st_size for path in files)

    def messages(self, place: ChunkPlace) -> list[Message]:
        """See :class:`BagFile`."""
        try:
            return list(self._messages(place))
        except Exception as problem:
            # The library may raise anything for damaged files.
            times = f"from {utc_text(place.start_ns)} to {utc_text(place.end_ns)}"
            self.add_problem(f"{self.path.name}: messages {times} cannot be read: {problem}")
            return []

    def close(self) -> None:
        """See :class:`BagFile`."""
        self.reader.close()

    def _messages(self, place: ChunkPlace) -> Iterator[Message]:
        span_ns = place.start_ns, place.end_ns + 1
        if self.reader.compression_mode != "message":
            for connection, time_ns, data in self.reader.messages((), *span_ns):
                yield Message(connection.id, time_ns, bytes(data), publish_time=time_ns, sequence=0)
            return
        # The library would decompress to any size that a message states.
        numbers = {(connection.topic, connection.msgtype): connection.id for connection in self.reader.connections}
        for storage in getattr(self.reader.storage, "storages", ()):
            for connection, time_ns, data in storage.messages(storage.connections, *span_ns):
                number = numbers[connection.topic, connection.msgtype]
                yield Message(number, time_ns, _decompress_message(data), publish_time=time_ns, sequence=0)


def open_with_rosbags(path: Path) -> RosbagsFile:
    """Open a rosbag2 folder with sqlite3 or compressed files, or one sqlite3 file.

    Raises:
        BadInput: the bag cannot be read.
    """
    _check_disk_space(path)
    try:
        reader = Reader(path)
        reader.open()
    except Exception as problem:
        # The library may raise anything for files of another format.
        raise BadInput(f"cannot be read by rosbags: {problem}", file=path) from problem
    file = RosbagsFile(path, reader=reader)
    for connection in reader.connections:
        schema, channel = _describe(connection)
        file.schemas[schema.id], file.channels[channel.id] = schema, channel
    if reader.message_count:
        file.chunks.extend(_places(file, reader.start_time, reader.end_time - 1))
    return file


def _check_disk_space(path: Path) -> None:
    """Refuse a folder whose compressed files state a size larger than the free space for temporary files.

    Raises:
        BadInput: the free space is too small.
    """
    needed = 0
    for part in path.glob("*.zstd"):
        with part.open("rb") as stream:
            head = stream.read(_FRAME_HEAD_BYTES)
        if head.startswith(zstandard.FRAME_HEADER):
            needed += max(0, zstandard.frame_content_size(head))
    folder = tempfile.gettempdir()
    free = shutil.disk_usage(folder).free
    if needed > free:
        needed_mb, free_mb = (round(size / 1e6) for size in (needed, free))
        raise BadInput(f"needs {needed_mb} MB: {folder} has {free_mb} MB free; set TMPDIR to another folder", file=path)


def _decompress_message(data: bytes) -> bytes:
    content = decompress("zstd", data)
    if len(content) > MAX_CHUNK_BYTES:
        raise ValueError(f"a message decompresses to more than {MAX_CHUNK_MB} MB")
    return content


def _describe(connection: Connection) -> tuple[Schema, Channel]:
    """Return definition and topic of a connection as MCAP records; if the definition is empty, the suite's is used."""
    form, text = connection.msgdef
    schema = Schema(connection.id, text.encode(), _ENCODINGS.get(form, "ros2msg"), connection.msgtype)
    offers = getattr(connection.ext, "offered_qos_profiles", ())
    durabilities = [f"durability: {qos.durability.name.lower()}" for qos in offers]
    metadata = {"offered_qos_profiles": "\n".join(durabilities)}
    return schema, Channel(connection.id, connection.topic, "cdr", metadata, connection.id)


def _places(file: RosbagsFile, start_ns: int, end_ns: int) -> Iterator[ChunkPlace]:
    """Yield ranges of log times, each of a second, or longer if there would be too many ranges."""
    if not (is_stamp_time(start_ns) and is_stamp_time(end_ns)):
        file.add_problem(f"{file.path.name}: it has log times that no stamp can represent: it is not read")
        return
    length_ns = max(NS_PER_S, -(-(end_ns - start_ns + 1) // _MAX_PLACES))
    for number, begin_ns in enumerate(range(start_ns, end_ns + 1, length_ns)):
        yield ChunkPlace(number, 0, begin_ns, min(begin_ns + length_ns - 1, end_ns))

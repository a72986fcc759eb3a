"""Files of a black box: a first file, and a further file when the last one is full or the disk works again.

A further file, ``NAME.part2.mcap`` and so on, is next to the first file. Each file starts with the header, so that the
file can be read alone. When the first file is opened, the bag reader reads all files as one bag.
"""

import re
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ship_bags.errors import BadInput
from ship_bags.live.installed_types import installed_definition
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER
from ship_node.black_box.black_box_format import FORMAT, METADATA, VERSIONS_ATTACHMENT
from ship_node.messages.topics import OutputTopic


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
        last_path: path of the file being written.
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
        self._writer = _open_first(path, head.node)
        self.path = self.last_path = self._writer.path
        self._write_header(self._writer)

    @property
    def flushed_bytes(self) -> int:
        """Length of the last file at its last flush."""
        return self._writer.flushed_bytes

    def write(self, topic: str, data: bytes, time_ns: int, waiting_ns: int) -> None:
        """Add an entry; the entries of all topics are numbered together, so that a gap shows a missing entry."""
        self.count += 1
        self._writer.write_raw(topic, self._types[topic], data, time_ns, waiting_ns, self.count)

    def attach(self, name: str, content: bytes) -> None:
        """Attach a file that the node read or wrote."""
        self._writer.add_attachment(name, content, "application/octet-stream")

    def flush(self) -> None:
        """Write everything to the disk, and begin a new file if the last one is full."""
        self._writer.flush()
        if self._part_bytes and self._writer.flushed_bytes >= self._part_bytes:
            full = self._writer
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
        self._writer, self.last_path = writer, path

    def truncate(self) -> None:
        """Give up the last file after a failed write; the file stays valid up to its last flush."""
        self._writer.truncate()

    def close(self) -> None:
        """Finish the last file."""
        self._writer.close()

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
    """Return the error about a path where no black box can be written."""
    name = BLACK_BOX_PARAMETER
    return BadInput(f"parameter '{name}' = '{path}': {reason}", parameters=(name,), value=path)

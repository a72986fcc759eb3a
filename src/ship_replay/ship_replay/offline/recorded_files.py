"""The files that a node read and wrote, given back from its black box instead of the disk."""

import os
from collections import deque
from pathlib import Path

from ship_node.documents.files import FileUse
from ship_replay.offline.message_difference import Difference


class AnotherFileUse(Exception):
    """The replay did with a file what the node had not done."""

    def __init__(self, difference: Difference) -> None:
        super().__init__(difference.line)
        self.difference = difference


class RecordedFiles:
    """Reads give what the node read; writes are compared with what it wrote, and nothing reaches the disk."""

    def __init__(self) -> None:
        self._uses: deque[FileUse] = deque()
        self.time_ns = 0

    def expect(self, use: FileUse) -> None:
        """Note the next use by the node."""
        self._uses.append(use)

    def read(self, path: Path) -> bytes:
        """What the node read at this moment.

        Raises:
            OSError: as it failed for the node.
            AnotherFileUse: the node read nothing, or another file.
        """
        return self._next(path, written=False).content or b""

    def write(self, path: Path, content: bytes) -> None:
        """Compare with what the node wrote at this moment.

        Raises:
            OSError: as it failed for the node.
            AnotherFileUse: the node wrote nothing, another file or other bytes.
        """
        recorded = self._next(path, written=True).content or b""
        if recorded != content:
            raise AnotherFileUse(_content_difference(path, self.time_ns, recorded, content))

    def _next(self, path: Path, written: bool) -> FileUse:
        use = self._uses.popleft() if self._uses else None
        if use is None or (use.path, use.written) != (str(path), written):
            raise AnotherFileUse(
                Difference(f"file {path}", self.time_ns, "", _use_text(use), f"{'written' if written else 'read'}")
            )
        if use.error is not None:
            raise OSError(use.error, os.strerror(use.error), str(path))
        return use


def _use_text(use: FileUse | None) -> str:
    return "no use of a file" if use is None else f"{use.path} {'written' if use.written else 'read'}"


def _content_difference(path: Path, time_ns: int, recorded: bytes, replayed: bytes) -> Difference:
    """The first line that differs."""
    one, other = (content.decode(errors="replace").splitlines() for content in (recorded, replayed))
    for number, (a, b) in enumerate(zip(one, other, strict=False), 1):
        if a != b:
            return Difference(f"file {path}", time_ns, f"line {number}", repr(a), repr(b))
    return Difference(f"file {path}", time_ns, "length", f"{len(recorded)} bytes", f"{len(replayed)} bytes")

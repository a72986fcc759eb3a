"""The files that an adapter reads and writes while it runs: on the disk, noted for the black box.

What a node reads is an input like any message: a replay must be given the same bytes.
"""

import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ship_bags.output_files import write_whole

LONGEST_FILE_BYTES = 16_000_000
"""A saved alignment or calibration has some ten thousand."""


@dataclass(frozen=True)
class FileUse:
    """One file read or written.

    Attributes:
        path: as the adapter named it.
        written: whether it was written, not read.
        content: the bytes; None where it failed.
        error: error number (errno) where it failed.
    """

    path: str
    written: bool
    content: bytes | None
    error: int | None = None


class Files(Protocol):
    """What an adapter may do with files; a failure is an OSError."""

    def read(self, path: Path) -> bytes:
        """The whole content."""
        ...

    def write(self, path: Path, content: bytes) -> None:
        """Write a file that is either the old or the new one, never a part; folders are made."""
        ...


class DiskFiles:
    """The files themselves."""

    def read(self, path: Path) -> bytes:
        """See :meth:`Files.read`; a file longer than anything that is saved is an OSError, too."""
        with path.open("rb") as stream:
            content = stream.read(LONGEST_FILE_BYTES + 1)
        if len(content) > LONGEST_FILE_BYTES:
            raise _plain(errno.EFBIG, path)
        return content

    def write(self, path: Path, content: bytes) -> None:
        """See :meth:`Files.write`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write_whole(path, content)
        except OSError as error:
            raise _plain(error.errno or errno.EIO, path) from error


def _plain(number: int, path: Path) -> OSError:
    """The error as a replay of the black box will raise it, which knows only its number."""
    return OSError(number, os.strerror(number), str(path))


class NotedFiles:
    """The files themselves, each use noted.

    Attributes:
        uses: in order; whoever takes them clears the list.
    """

    def __init__(self) -> None:
        self.uses: list[FileUse] = []
        self._disk = DiskFiles()

    def read(self, path: Path) -> bytes:
        """See :meth:`Files.read`."""
        try:
            content = self._disk.read(path)
        except OSError as error:
            self.uses.append(FileUse(str(path), False, None, error.errno or errno.EIO))
            raise
        self.uses.append(FileUse(str(path), False, content))
        return content

    def write(self, path: Path, content: bytes) -> None:
        """See :meth:`Files.write`."""
        try:
            self._disk.write(path, content)
        except OSError as error:
            self.uses.append(FileUse(str(path), True, None, error.errno or errno.EIO))
            raise
        self.uses.append(FileUse(str(path), True, content))


DISK = DiskFiles()

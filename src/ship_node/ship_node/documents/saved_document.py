"""The files that an adapter reads and writes while it runs, and the documents that a node saves for its next start.

What a node reads is an input like any message: a replay must be given the same bytes. So an adapter reads and writes
through :class:`Files` alone, where a black box can note each use. A saved document is YAML that people can read, with
format and version.
"""

import errno
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import yaml

from ship_bags.errors import BadInput
from ship_bags.output_files import write_whole
from ship_bags.regular_files import check_regular, open_refusal
from ship_bags.stamps import END_OF_TIME_NS
from ship_bags.yaml_text import plain_data

LONGEST_FILE_BYTES = 16_000_000
"""A saved alignment or calibration has some ten thousand."""

_ROUNDING = 1e-6

Content = TypeVar("Content")
Value = TypeVar("Value")


@dataclass(frozen=True)
class FileUse:
    """One file read or written.

    Attributes:
        path: as the adapter named it.
        written: whether it was written or set aside, not read.
        content: the bytes; of a file set aside its new path; None where it failed.
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

    def set_aside(self, path: Path) -> Path:
        """Rename a file that cannot be used, so that it stays and another one can take its place; return its new path.

        The new name ends with ``.unreadable``, or ``.unreadable.2`` and so on where such a file is there already.
        """
        ...


class DiskFiles:
    """The files themselves."""

    def read(self, path: Path) -> bytes:
        """See :meth:`Files.read`; a file longer than anything that is saved is an OSError, too."""
        try:
            check_regular(path)
            with path.open("rb") as stream:
                content = stream.read(LONGEST_FILE_BYTES + 1)
        except OSError as error:
            raise _plain(error.errno or errno.EIO, path) from error
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

    def set_aside(self, path: Path) -> Path:
        """See :meth:`Files.set_aside`."""
        aside = _free_name(path)
        try:
            path.rename(aside)
        except OSError as error:
            raise _plain(error.errno or errno.EIO, path) from error
        return aside


class UntouchedFiles(DiskFiles):
    """The files themselves, read as they are and never changed: what is written is forgotten.

    Whoever runs an adapter to see what it would do, as a replay does, must not replace what a ship has saved.
    """

    def write(self, path: Path, content: bytes) -> None:
        """See :meth:`Files.write`: nothing happens."""

    def set_aside(self, path: Path) -> Path:
        """See :meth:`Files.set_aside`: nothing happens; the path is that which a node would use."""
        return _free_name(path)


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

    def set_aside(self, path: Path) -> Path:
        """See :meth:`Files.set_aside`."""
        try:
            aside = self._disk.set_aside(path)
        except OSError as error:
            self.uses.append(FileUse(str(path), True, None, error.errno or errno.EIO))
            raise
        self.uses.append(FileUse(str(path), True, str(aside).encode()))
        return aside


DISK, UNTOUCHED = DiskFiles(), UntouchedFiles()


@dataclass(frozen=True)
class SavedFormat(Generic[Content]):
    """A kind of saved document.

    Attributes:
        format: first line of the file.
        version: of its layout; no other is read.
        what: "alignment", "calibration": for messages.
        document: what is written of a content.
        content: what a document says; a ValueError names the section that cannot be used.
    """

    format: str
    version: int
    what: str
    document: Callable[[Content], dict[str, Any]]
    content: Callable[[dict[str, Any]], Content]

    def save(self, path: Path, content: Content, files: Files = DISK) -> bytes:
        """Write a document; the file is either the old one or the new one, never a part. Returns what was written.

        Raises:
            BadInput: the file cannot be written.
        """
        whole = {"format": self.format, "version": self.version, **self.document(content)}
        written = yaml.safe_dump(whole, sort_keys=False, width=110).encode()
        try:
            files.write(path, written)
        except OSError as error:
            raise BadInput(f"the {self.what} cannot be written: {error.strerror}", file=path) from error
        return written

    def load(self, path: Path, files: Files = DISK) -> Content:
        """Read a document.

        Raises:
            BadInput: names the file and what is wrong with it.
        """
        return self.parsed(path, self.read_at(path, files))

    def read_at(self, path: Path, files: Files = DISK) -> bytes:
        """The bytes of a document.

        Raises:
            BadInput: the file cannot be read.
        """
        try:
            return files.read(path)
        except OSError as error:
            raise self._unreadable(path, error) from error

    def written_at(self, path: Path, files: Files = DISK) -> bytes | None:
        """As :meth:`read_at`; None where there is no such file."""
        try:
            return files.read(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise self._unreadable(path, error) from error

    def _unreadable(self, path: Path, error: OSError) -> BadInput:
        return BadInput(f"the {self.what} cannot be read: {open_refusal(error.errno or errno.EIO)}", file=path)

    def parsed(self, path: Path, written: bytes) -> Content:
        """What the bytes of a document say.

        Raises:
            BadInput: names the file and what is wrong with it.
        """
        try:
            document = plain_data(str(path), written.decode())
        except UnicodeDecodeError as error:
            raise BadInput(f"not a text in UTF-8: {error.reason} at byte {error.start}", file=path) from error
        article = "an" if self.what[0] in "aeiou" else "a"
        if not isinstance(document, dict) or document.get("format") != self.format:
            raise BadInput(f"not {article} {self.what}: expected 'format: {self.format}'", file=path)
        if document.get("version") != self.version:
            found = f"{document.get('version')!r:.40}"
            raise BadInput(f"version {found} of the {self.what}: expected {self.version}", file=path)
        try:
            return self.content(document)
        except ValueError as error:
            raise BadInput(f"the {self.what} cannot be used: {error}; save it anew", file=path) from error


def section(document: dict[str, Any], key: str, read: Callable[[Any], Value]) -> Value:
    """One section of a document.

    Raises:
        ValueError: names the section that is missing or cannot be read.
    """
    if key not in document:
        raise ValueError(f"'{key}' is missing")
    try:
        return read(document[key])
    except KeyError as error:
        raise ValueError(f"'{key}': {error} is missing") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"'{key}': {error}") from error


def stamp_ns(value: Any) -> int:
    """A time in nanoseconds.

    Raises:
        ValueError: it is none that a message can carry.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < END_OF_TIME_NS:
        raise ValueError("expected a whole number of nanoseconds since 1970")
    return value


def texts(values: Mapping[Any, Any]) -> dict[str, str]:
    """Texts by name.

    Raises:
        ValueError: one is a list or a group.
    """
    for name, value in values.items():
        if isinstance(value, (list, dict)):
            raise ValueError(f"{name} is a list or a group: expected a text")
    return {str(name): str(value) for name, value in values.items()}


def finite_numbers(values: dict[str, Any]) -> dict[str, float]:
    """Numbers by name.

    Raises:
        ValueError: one is NaN, infinite or no number.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(float(value)):
            raise ValueError(f"{name} is {value!r:.40}: expected a finite number")
    return {str(name): float(value) for name, value in values.items()}


def joint_covariance(rows: list[list[float]], size: int) -> npt.NDArray[np.float64]:
    """A covariance of numbers in different units, shape (size, size).

    Raises:
        ValueError: wrong shape, not finite, not symmetric or not positive semidefinite.
    """
    if not isinstance(rows, list):
        raise ValueError(f"expected {size} x {size} finite numbers")
    covariance = np.array(rows, dtype=float)
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise ValueError(f"shape {covariance.shape}: expected {size} x {size} finite numbers")
    # In sigmas, because angles are far smaller numbers than seconds; what is held fixed has none.
    sigma = np.sqrt(np.abs(np.diagonal(covariance)))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
        raise ValueError("not symmetric")
    if np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        raise ValueError("not positive semidefinite")
    return covariance


def _free_name(path: Path) -> Path:
    """Return the first name for a file set aside that is not taken."""
    names = (path.with_name(f"{path.name}.unreadable{number}") for number in ("", *(f".{n}" for n in range(2, 100))))
    return next((name for name in names if not os.path.lexists(name)), path.with_name(f"{path.name}.unreadable"))


def _plain(number: int, path: Path) -> OSError:
    """The error as a replay of the black box will raise it, which knows only its number."""
    return OSError(number, os.strerror(number), str(path))

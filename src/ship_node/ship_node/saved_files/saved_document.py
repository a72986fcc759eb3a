"""Files that an adapter reads and writes while it runs, and documents that a node saves for its next start.

A file that a node reads is an input like any message, so a replay must get the same bytes. Therefore an adapter reads
and writes only through :class:`Files`, where a black box can record each use. A saved document is readable YAML with
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
from ship_bags.input_files import check_regular, open_error_text, plain_data
from ship_bags.output_files import write_atomically
from ship_bags.stamps import END_OF_TIME_NS

MAX_FILE_BYTES = 16_000_000
"""Maximum size of a file, bytes; a saved alignment or calibration has about ten thousand."""

_ROUNDING = 1e-6

Content = TypeVar("Content")
Value = TypeVar("Value")


@dataclass(frozen=True)
class FileUse:
    """One use of a file: read, written or set aside.

    Attributes:
        path: path given by the adapter.
        written: True if the file was written or set aside, False if it was read.
        content: bytes of the file, or the new path of a file set aside; None if the operation failed.
        error: error number (errno) if the operation failed.
    """

    path: str
    written: bool
    content: bytes | None
    error: int | None = None


class Files(Protocol):
    """File operations of an adapter; a failure is an OSError."""

    def read(self, path: Path) -> bytes:
        """Return the whole content."""
        ...

    def write(self, path: Path, content: bytes) -> None:
        """Write a file atomically, so that either the old or the new file exists; create missing folders."""
        ...

    def set_aside(self, path: Path) -> Path:
        """Rename an unusable file, so that it is kept and a new file can be written; return its new path.

        The new name ends with ``.unreadable``, or ``.unreadable.2`` and so on if such a file exists.
        """
        ...


class DiskFiles:
    """Files on the disk."""

    def read(self, path: Path) -> bytes:
        """See :meth:`Files.read`; a file longer than :data:`MAX_FILE_BYTES` raises an OSError, too."""
        try:
            check_regular(path)
            with path.open("rb") as stream:
                content = stream.read(MAX_FILE_BYTES + 1)
        except OSError as error:
            raise _plain_os_error(error.errno or errno.EIO, path) from error
        if len(content) > MAX_FILE_BYTES:
            raise _plain_os_error(errno.EFBIG, path)
        return content

    def write(self, path: Path, content: bytes) -> None:
        """See :meth:`Files.write`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write_atomically(path, content)
        except OSError as error:
            raise _plain_os_error(error.errno or errno.EIO, path) from error

    def set_aside(self, path: Path) -> Path:
        """See :meth:`Files.set_aside`."""
        aside = _free_path(path)
        try:
            path.rename(aside)
        except OSError as error:
            raise _plain_os_error(error.errno or errno.EIO, path) from error
        return aside


class ReadOnlyFiles(DiskFiles):
    """Files on the disk that are never changed; written content is discarded.

    A program that runs an adapter without being the node, such as a replay, must not replace a ship's saved documents.
    """

    def write(self, path: Path, content: bytes) -> None:
        """See :meth:`Files.write`; does nothing."""

    def set_aside(self, path: Path) -> Path:
        """See :meth:`Files.set_aside`; returns the path that a node would use, without renaming."""
        return _free_path(path)


class RecordingFiles:
    """Files on the disk, with a record of each use.

    Attributes:
        uses: uses of files in order; the reader of this list clears it.
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


DISK, READ_ONLY = DiskFiles(), ReadOnlyFiles()


@dataclass(frozen=True)
class SavedFormat(Generic[Content]):
    """Format of a saved document.

    Attributes:
        format: value of the key ``format``, which is in the first line of the file.
        version: version of the layout; a document of another version is not read.
        kind_name: name of the document in texts, as "alignment" or "calibration".
        document: converts a content to a document.
        content: converts a document to a content; its ValueError names the section that cannot be used.
    """

    format: str
    version: int
    kind_name: str
    document: Callable[[Content], dict[str, Any]]
    content: Callable[[dict[str, Any]], Content]

    def save(self, path: Path, content: Content, files: Files = DISK) -> bytes:
        """Write a document atomically; return its bytes.

        Raises:
            BadInput: the file cannot be written.
        """
        whole = {"format": self.format, "version": self.version, **self.document(content)}
        written = yaml.safe_dump(whole, sort_keys=False, width=110).encode()
        try:
            files.write(path, written)
        except OSError as error:
            raise BadInput(f"the {self.kind_name} cannot be written: {error.strerror}", file=path) from error
        return written

    def load(self, path: Path, files: Files = DISK) -> Content:
        """Read a document.

        Raises:
            BadInput: the document cannot be read or used; the text names the file and the error.
        """
        return self.parse(path, self.read_bytes(path, files))

    def read_bytes(self, path: Path, files: Files = DISK) -> bytes:
        """Return the bytes of a document.

        Raises:
            BadInput: the file cannot be read.
        """
        try:
            return files.read(path)
        except OSError as error:
            reason = f"the {self.kind_name} cannot be read: {open_error_text(error.errno or errno.EIO)}"
            raise BadInput(reason, file=path) from error

    def read_if_present(self, path: Path, files: Files = DISK) -> bytes | None:
        """Return the bytes of a document; None if the file does not exist.

        Raises:
            BadInput: the file cannot be read.
        """
        try:
            return self.read_bytes(path, files)
        except BadInput as error:
            if isinstance(error.__cause__, (FileNotFoundError, NotADirectoryError)):
                return None
            raise

    def parse(self, path: Path, written: bytes) -> Content:
        """Return the content of a document's bytes.

        Raises:
            BadInput: the document cannot be read or used; the text names the file and the error.
        """
        try:
            document = plain_data(str(path), written.decode())
        except UnicodeDecodeError as error:
            raise BadInput(f"not UTF-8 text: {error.reason} at byte {error.start}", file=path) from error
        article = "an" if self.kind_name[0] in "aeiou" else "a"
        if not isinstance(document, dict) or document.get("format") != self.format:
            raise BadInput(f"not {article} {self.kind_name}: expected 'format: {self.format}'", file=path)
        if document.get("version") != self.version:
            found = f"{document.get('version')!r:.40}"
            raise BadInput(f"version {found} of the {self.kind_name}: expected {self.version}", file=path)
        try:
            return self.content(document)
        except ValueError as error:
            raise BadInput(f"the {self.kind_name} cannot be used: {error}; save it again", file=path) from error


def section(document: dict[str, Any], key: str, read: Callable[[Any], Value]) -> Value:
    """Return one section of a document.

    Raises:
        ValueError: the section is missing or cannot be read; the text names the section.
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
    """Return a time, ns.

    Raises:
        ValueError: the value is not a time that a stamp can represent.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < END_OF_TIME_NS:
        raise ValueError("expected a whole number of nanoseconds since 1970")
    return value


def texts(values: Mapping[Any, Any]) -> dict[str, str]:
    """Return values by name, numbers converted to texts.

    Raises:
        ValueError: a value is a list or a group.
    """
    for name, value in values.items():
        if isinstance(value, (list, dict)):
            raise ValueError(f"{name} is a list or a group: expected a text")
    return {str(name): str(value) for name, value in values.items()}


def finite_numbers(values: dict[str, Any]) -> dict[str, float]:
    """Return finite numbers by name.

    Raises:
        ValueError: a value is NaN, infinite or not a number.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(float(value)):
            raise ValueError(f"{name} is {value!r:.40}: expected a finite number")
    return {str(name): float(value) for name, value in values.items()}


def joint_covariance(rows: list[list[float]], size: int) -> npt.NDArray[np.float64]:
    """Return a covariance of quantities in different units, shape (size, size).

    Raises:
        ValueError: wrong shape, not finite, not symmetric or not positive semidefinite.
    """
    if not isinstance(rows, list):
        raise ValueError(f"expected {size} x {size} finite numbers")
    covariance = np.array(rows, dtype=float)
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise ValueError(f"shape {covariance.shape}: expected {size} x {size} finite numbers")
    # The checks are relative to the sigmas, because angles are far smaller numbers than seconds. A fixed quantity has a
    # sigma of 0.
    sigma = np.sqrt(np.abs(np.diagonal(covariance)))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
        raise ValueError("not symmetric")
    if np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        raise ValueError("not positive semidefinite")
    return covariance


def _free_path(path: Path) -> Path:
    """Return the first free name for a file that is set aside; if all 99 exist, the first, which is overwritten."""
    names = (path.with_name(f"{path.name}.unreadable{number}") for number in ("", *(f".{n}" for n in range(2, 100))))
    return next((name for name in names if not os.path.lexists(name)), path.with_name(f"{path.name}.unreadable"))


def _plain_os_error(number: int, path: Path) -> OSError:
    """Return an error made from error number and path alone: a black box records nothing else for a replay."""
    return OSError(number, os.strerror(number), str(path))

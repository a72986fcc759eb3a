"""Output files: permission to write, atomic writing, and sync to the disk.

A command overwrites no existing file without ``--force``, and never replaces a folder, device or pipe. This is checked
before the work begins, so that a long run is not lost because of a name.

A file is written next to its final name, as ``NAME.part``, until it is complete. A part is opened exclusively and
follows no link, so that no file of another program is written. A part left by a killed program is removed; a part that
another program is writing is kept.
"""

import contextlib
import errno
import fcntl
import io
import os
import stat
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ship_bags.errors import BadInput

if TYPE_CHECKING:
    import argparse

PART_SUFFIX = ".part"

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}

_FORMULA_BEGINS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
"""Characters that start a formula in a spreadsheet."""

_ERROR_TEXTS = {
    errno.EBUSY: "another program is writing it",
    errno.ELOOP: "it is a link: remove it",
    errno.EEXIST: "it exists and is not a regular file: remove it",
}


def add_force_option(parser: "argparse.ArgumentParser") -> None:
    """Add the option ``--force``, which :func:`check_file` and :func:`check_folder` need."""
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def check_file(path: Path, force: bool) -> None:
    """Check that a file can be written.

    Args:
        path: path of the file.
        force: True if the file may exist.

    Raises:
        BadInput: the file exists without ``force``, is not a regular file, or its folder is missing or not writable.
    """
    if not path.parent.is_dir():
        raise BadInput(f"cannot be written: there is no folder {path.parent}", file=path)
    _check_access(path.parent, path)
    _check_name(path, force)


def check_folder(folder: Path, names: Iterable[str], force: bool) -> None:
    """Check that files can be written into a folder, which is created later if it is missing.

    Args:
        folder: the folder.
        names: names of the files.
        force: True if files of these names may exist.

    Raises:
        BadInput: a file exists without ``force`` or is not a regular file, or the folder cannot be created or written
            to.
    """
    there = folder
    while not there.exists() and not there.is_symlink() and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise BadInput(f"is {_kind(there)}: expected a folder", file=there)
    _check_access(there, folder)
    if there == folder:
        for name in names:
            _check_name(folder / name, force)


def part_path(path: Path) -> Path:
    """Return the path at which a file is written until it is complete."""
    return path.with_name(path.name + PART_SUFFIX)


def open_new(path: Path) -> BinaryIO:
    """Open a new file for writing and lock it until it is closed.

    A regular file of this name that no program has locked is removed: it is the leftover of a killed program.

    Raises:
        OSError: the file cannot be created, is not a regular file, or another program is writing it.
    """
    try:
        number = _create(path)
    except FileExistsError:
        _remove_leftover(path)
        number = _create(path)
    try:
        _lock(number)
        if os.fstat(number).st_nlink == 0:
            # Another program has removed this part as a leftover of a killed program.
            raise _os_error(errno.EBUSY, path)
        return os.fdopen(number, "wb")
    except OSError:
        os.close(number)
        raise


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write a file atomically, so that either the old or the new file exists even if this program is killed.

    Raises:
        OSError: the file cannot be written; the error names the file, and no part of it is left.
    """
    part = part_path(path)
    with file_in_errors(path), open_new(part) as stream:
        try:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def file_in_errors(path: Path) -> Iterator[None]:
    """Put the final file name, as given by the user, into an OSError."""
    try:
        yield
    except OSError as problem:
        raise error_with_path(problem, path) from problem


def error_with_path(problem: OSError, path: Path) -> OSError:
    """Return the error with a file name."""
    return OSError(problem.errno, problem.strerror or str(problem), str(path))


def csv_text(text: str) -> str:
    """Return a text as a CSV cell, with ' in front if a spreadsheet would take the text for a formula.

    A text that is a number, as -1.5, is not changed.
    """
    if not text.startswith(_FORMULA_BEGINS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> Path:
    """Write a table; return its path."""
    import csv  # needed for tables only

    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(map(csv_text, header))
    writer.writerows([_text(value) for value in row] for row in rows)
    write_atomically(path, table.getvalue())
    return path


class DiskSync:
    """Synchronisation of a file to the disk in a separate thread, one request at a time.

    Data passed to the operating system survive the end of the process; a sync is needed only for a power failure. On a
    busy disk a sync takes hundreds of milliseconds, during which the writer must go on.

    Args:
        number: file descriptor; it must stay open until :meth:`finish`.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="disk sync")
        self._running: Future[None] | None = None

    def request(self) -> None:
        """Start a sync; do nothing while the last sync runs, because the next request includes the data.

        Raises:
            OSError: the last sync failed.
        """
        if self._running is not None:
            if not self._running.done():
                return
            self._running.result()
        self._running = self._thread.submit(os.fsync, self._number)

    def finish(self) -> None:
        """Wait for the last sync, whose error is not raised; no request may follow."""
        self._thread.shutdown(wait=True)


def _check_access(folder: Path, path: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        reason = errno.EROFS if os.statvfs(folder).f_flag & os.ST_RDONLY else errno.EACCES
        raise BadInput(f"cannot be written: {os.strerror(reason)}", file=path)


def _check_name(path: Path, force: bool) -> None:
    if not os.path.lexists(path):
        return
    if not path.is_file():
        raise BadInput(f"is {_kind(path)}: expected a file", file=path)
    if not force:
        raise BadInput("already exists: use --force to overwrite", file=path)


def _kind(path: Path) -> str:
    try:
        return _KINDS.get(stat.S_IFMT(path.stat().st_mode), "a file")
    except OSError:
        return "a link to nothing"


def _create(path: Path) -> int:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.open(path, flags, 0o666)


def _remove_leftover(path: Path) -> None:
    """Remove a file left by a killed program.

    Raises:
        OSError: the path is not a regular file, or another program is writing the file.
    """
    mode = os.lstat(path).st_mode
    if not stat.S_ISREG(mode):
        raise _os_error(errno.ELOOP if stat.S_ISLNK(mode) else errno.EEXIST, path)
    number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _lock(number)
        os.unlink(path)
    except BlockingIOError as problem:
        raise _os_error(errno.EBUSY, path) from problem
    finally:
        os.close(number)


def _lock(number: int) -> None:
    """Lock a file until it is closed.

    Raises:
        BlockingIOError: another program has locked it.
    """
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # Some file systems have no locks, so the exclusive opening must suffice.
        return


def _os_error(number: int, path: Path) -> OSError:
    return OSError(number, f"{path.name}: {_ERROR_TEXTS[number]}", str(path))


def _text(value: Any) -> Any:
    """Return a value for a table: a float with five decimals, empty for NaN; a text by :func:`csv_text`; else as it is.

    Five decimals are the same on every computer.
    """
    if not isinstance(value, (float, np.floating)):
        return csv_text(value) if isinstance(value, str) else value
    # Adding zero removes the sign of a negative number rounded to zero.
    return "" if np.isnan(value) else f"{round(float(value), 5) + 0.0:.5f}"

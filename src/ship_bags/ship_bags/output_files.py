"""Files that are written: where that may be, files that get their name when they are whole, and the way onto the disk.

A command writes over nothing that is there unless it is told to. It never replaces a folder, device or pipe. It
looks at that before the work begins, for a run of minutes must not be lost for a name.

Until a file is whole it is written beside its name, as ``NAME.part``. A part is opened exclusively and follows no link,
so that nobody else's file is written. A part that a killed program left is taken away; one that another program writes
at this moment is not.
"""

import errno
import fcntl
import io
import os
import stat
from collections.abc import Iterable
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
"""What a spreadsheet takes for the begin of a formula."""

_REASONS = {
    errno.EBUSY: "another program writes it",
    errno.ELOOP: "it is a link: take it away",
    errno.EEXIST: "it is there and no regular file: take it away",
}


def add_force(parser: "argparse.ArgumentParser") -> None:
    """The option that :func:`check_file` and :func:`check_folder` ask about."""
    parser.add_argument("--force", action="store_true", help="write over files that are there")


def check_file(path: Path, force: bool) -> None:
    """Make sure that a file can be written.

    Args:
        path: of the file.
        force: whether it may be there.

    Raises:
        BadInput: it is there, is no regular file, or its folder is not there or cannot be written to.
    """
    if not path.parent.is_dir():
        raise BadInput(f"cannot be written: there is no folder {path.parent}", file=path)
    _check_access(path.parent, path)
    _check_name(path, force)


def check_folder(folder: Path, names: Iterable[str], force: bool) -> None:
    """Make sure that files can be written into a folder, which is made later where it is not there.

    Args:
        folder: the folder.
        names: of the files.
        force: whether files of these names may be there.

    Raises:
        BadInput: one is there or is no regular file, or the folder cannot be made or written to.
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


def part_of(path: Path) -> Path:
    """Where a file is written until it is whole."""
    return path.with_name(path.name + PART_SUFFIX)


def open_new(path: Path) -> BinaryIO:
    """Open a file for writing that no other program writes, and hold it until it is closed.

    Raises:
        OSError: it cannot be made, is no regular file, or another program writes it.
    """
    try:
        number = _created(path)
    except FileExistsError:
        _take_away(path)
        number = _created(path)
    try:
        _hold(number)
        if os.fstat(number).st_nlink == 0:
            # Another program took this part for one that a killed program had left, and removed it.
            raise _refusal(errno.EBUSY, path)
        return os.fdopen(number, "wb")
    except OSError:
        os.close(number)
        raise


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file that is either the old or the new one, never a part, whatever ends this program.

    Raises:
        OSError: it cannot be written; it names the file, and nothing is left of the attempt.
    """
    part = part_of(path)
    try:
        with open_new(part) as stream:
            try:
                stream.write(content.encode() if isinstance(content, str) else content)
                stream.flush()
                os.fsync(stream.fileno())
                part.replace(path)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except OSError as problem:
        raise named(problem, path) from problem


def named(problem: OSError, path: Path) -> OSError:
    """The same problem, with the name of the file that the user knows."""
    return OSError(problem.errno, problem.strerror or str(problem), str(path))


def csv_text(text: str) -> str:
    """Return a text as a cell of CSV that a spreadsheet takes for no formula: with ' in front where it would be one.

    A text that is a number, as -1.5, stays one.
    """
    if not text.startswith(_FORMULA_BEGINS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> Path:
    """Write a table; returns its path."""
    import csv  # only tables need it

    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(map(csv_text, header))
    writer.writerows([_text(value) for value in row] for row in rows)
    write_whole(path, table.getvalue())
    return path


class DiskSync:
    """Brings what was written to a file onto the disk, in a thread of its own, one request at a time.

    What was handed to the system survives the end of the process, however it ends; only a power cut needs the disk. A
    busy disk takes hundreds of milliseconds for that, in which the writer must go on.

    Args:
        number: file descriptor; it must stay open until :meth:`finish`.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="disk sync")
        self._running: Future[None] | None = None

    def request(self) -> None:
        """Begin a sync; nothing where the last one still runs: the next request makes up for it.

        Raises:
            OSError: the last one failed.
        """
        if self._running is not None:
            if not self._running.done():
                return
            self._running.result()
        self._running = self._thread.submit(os.fsync, self._number)

    def finish(self) -> None:
        """Wait for the last sync, whatever came of it; no request may follow."""
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
        raise BadInput("is there already: --force writes over it", file=path)


def _kind(path: Path) -> str:
    try:
        return _KINDS.get(stat.S_IFMT(path.stat().st_mode), "a file")
    except OSError:
        return "a link to nothing"


def _created(path: Path) -> int:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.open(path, flags, 0o666)


def _take_away(path: Path) -> None:
    """Remove what a killed program left.

    Raises:
        OSError: it is no regular file, or another program writes it.
    """
    mode = os.lstat(path).st_mode
    if not stat.S_ISREG(mode):
        raise _refusal(errno.ELOOP if stat.S_ISLNK(mode) else errno.EEXIST, path)
    number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _hold(number)
        os.unlink(path)
    except BlockingIOError as problem:
        raise _refusal(errno.EBUSY, path) from problem
    finally:
        os.close(number)


def _hold(number: int) -> None:
    """Lock a file until it is closed.

    Raises:
        BlockingIOError: another program has locked it.
    """
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # Some disks know no locks: there the exclusive opening must be enough.
        return


def _refusal(number: int, path: Path) -> OSError:
    return OSError(number, f"{path.name}: {_REASONS[number]}", str(path))


def _text(value: Any) -> Any:
    """A number with five decimals: none that counts is lost, and every machine writes the same file; a text as text."""
    if not isinstance(value, (float, np.floating)):
        return csv_text(value) if isinstance(value, str) else value
    # Adding zero takes the sign from a negative number that was rounded to zero.
    return "" if np.isnan(value) else f"{round(float(value), 5) + 0.0:.5f}"

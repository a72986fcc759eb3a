"""Files that get their name when they are whole: until then they are written beside it, as ``NAME.part``.

A part is opened exclusively and follows no link, so that nobody else's file is written. One that a killed program left
is taken away; one that another program writes at this moment is not.
"""

import errno
import fcntl
import os
import stat
from pathlib import Path
from typing import BinaryIO

SUFFIX = ".part"

_REASONS = {
    errno.EBUSY: "another program writes it",
    errno.ELOOP: "it is a link: take it away",
    errno.EEXIST: "it is there and no regular file: take it away",
}


def part_of(path: Path) -> Path:
    """Where a file is written until it is whole."""
    return path.with_name(path.name + SUFFIX)


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
            # Another program took it for one that was left.
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
    """The problem with the name of the file that the user knows."""
    return OSError(problem.errno, problem.strerror or str(problem), str(path))


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
        # There are disks without locks; exclusive opening alone has to do there.
        return


def _refusal(number: int, path: Path) -> OSError:
    return OSError(number, f"{path.name}: {_REASONS[number]}", str(path))

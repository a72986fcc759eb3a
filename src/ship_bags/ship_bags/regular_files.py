"""Files that a node or a suite reads: regular ones only.

To open a pipe waits for its other end, and a device may have no end: neither may hold up the start of a node.
"""

import errno
import os
import stat
from pathlib import Path


def check_regular(path: Path) -> None:
    """Raise unless a path names a regular file, or nothing at all, which its opening reports.

    Raises:
        OSError: EISDIR where it is a folder, ESPIPE where it is a pipe, a device or a socket.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        reason = errno.EISDIR if stat.S_ISDIR(mode) else errno.ESPIPE
        raise OSError(reason, open_refusal(reason), str(path))


def open_refusal(number: int) -> str:
    """Return why a file could not be opened, by its error number, for people."""
    if number == errno.EISDIR:
        return "it is a folder: expected a file"
    if number == errno.ESPIPE:
        return "it is a pipe, a device or a socket: expected a file"
    return os.strerror(number)

"""Check that an input file of a node or a suite is a regular file.

Opening a pipe waits for its other end, and reading a device may never end. Neither must block the start of a node.
"""

import errno
import os
import stat
from pathlib import Path


def check_regular(path: Path) -> None:
    """Raise an error unless a path is a regular file; a missing file is reported later, when it is opened.

    Raises:
        OSError: EISDIR for a folder, ESPIPE for a pipe, a device or a socket.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        reason = errno.EISDIR if stat.S_ISDIR(mode) else errno.ESPIPE
        raise OSError(reason, open_error_text(reason), str(path))


def open_error_text(number: int) -> str:
    """Return the text of an error at opening a file, by its error number."""
    if number == errno.EISDIR:
        return "it is a folder: expected a file"
    if number == errno.ESPIPE:
        return "it is a pipe, a device or a socket: expected a file"
    return os.strerror(number)

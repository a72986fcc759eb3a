"""Where a command may write: over nothing that is there unless it is told to, and over nothing but files ever.

Looked at before the work begins: a run of minutes is not lost for a name.
"""

import argparse
import errno
import os
import stat
from collections.abc import Iterable
from pathlib import Path

from ship_bags.errors import BadInput

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def add_force(parser: argparse.ArgumentParser) -> None:
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
        raise BadInput(f"{path}: cannot be written: there is no folder {path.parent}")
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
        raise BadInput(f"{there}: is {_kind(there)}: expected a folder")
    _check_access(there, folder)
    if there == folder:
        for name in names:
            _check_name(folder / name, force)


def _check_access(folder: Path, path: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        reason = errno.EROFS if os.statvfs(folder).f_flag & os.ST_RDONLY else errno.EACCES
        raise BadInput(f"{path}: cannot be written: {os.strerror(reason)}")


def _check_name(path: Path, force: bool) -> None:
    if not os.path.lexists(path):
        return
    if not path.is_file():
        raise BadInput(f"{path}: is {_kind(path)}: expected a file")
    if not force:
        raise BadInput(f"{path}: is there already: --force writes over it")


def _kind(path: Path) -> str:
    try:
        return _KINDS.get(stat.S_IFMT(path.stat().st_mode), "a file")
    except OSError:
        return "a link to nothing"

"""Check of files and permissions: what the nodes read and write, and the devices in the suite file."""

import getpass
import os
import re
import stat
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER, read_sections
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.suite.plan import SAVED_FILES

_CHECK = "files"
_DEVICES = "/dev/"
_SINK = r"sinks\.[^.]+\.path"
"""Pattern of a parameter with a file to which ``nmea_out`` appends."""
_SERIAL = r"(sinks|sources)\.[^.]+\.device"


@dataclass(frozen=True)
class PathState:
    """A path that the suite needs.

    Attributes:
        path: the path.
        named_by: the setting that contains the path, with its file and line.
        is_device: True for a device, which must exist already.
        exists: True if the path exists.
        readable: True if this user can read the file.
        writable: True if this user can write the file, or create it if it does not exist.
        is_wrong_kind: True for a path that must be a serial device and is not, or for a folder in place of a file to
            which ``nmea_out`` appends.
    """

    path: Path
    named_by: str
    is_device: bool
    exists: bool
    readable: bool
    writable: bool
    is_wrong_kind: bool = False


def read_path_states(suite_path: Path, box: Path | None) -> list[PathState]:
    """Return the states of the devices and written files in a suite file, and of the folder of the black boxes."""
    found = [] if box is None else [_state(box, "--box", creates_parents=True)]
    for section in read_sections(suite_path)[1]:
        for name, (value, line) in section.parameters.items():
            if not isinstance(value, str) or not value:
                continue
            is_sink = re.fullmatch(_SINK, name) is not None
            is_device = not is_sink and (value.startswith(_DEVICES) or re.fullmatch(_SERIAL, name) is not None)
            if is_device or is_sink or name.rpartition(".")[2] in (*SAVED_FILES, BLACK_BOX_PARAMETER):
                found.append(_state(Path(value), f"{suite_path}:{line}: {name}", is_device, is_appended=is_sink))
    return found


def check_files(states: Sequence[PathState], missing_settings: Sequence[str]) -> Iterator[CheckLine]:
    """Check all paths.

    Args:
        states: states of the paths.
        missing_settings: lines about nodes without the setting of a saved file.
    """
    user = getpass.getuser()
    for text in missing_settings:
        yield CheckLine(_CHECK, Result.WARN, text, "configure a file: docs/how-to/bring_up.md")
    for state in states:
        problem, advice = _problem(state, user)
        result = Result.FAIL if problem else Result.OK
        yield CheckLine(_CHECK, result, f"{state.named_by} {state.path}: {problem or 'good'}", advice)
    if not states and not missing_settings:
        yield CheckLine(_CHECK, Result.OK, "the suite file names no file and no device")


def _problem(state: PathState, user: str) -> tuple[str, str]:
    if state.is_wrong_kind:
        if state.is_device:
            return "is not a serial device", "use for example /dev/ttyUSB0, or check its name: ls /dev/serial/by-id"
        return "is a folder", f"use a file in it, for example {state.path / 'attitude.nmea'}"
    if state.is_device and not state.exists:
        return "is not there", "plug the device in, or check its name: ls /dev/serial/by-id"
    if state.is_device and not (state.readable and state.writable):
        return f"user {user} may not read and write it", f"sudo usermod -aG dialout {user}, then log in again"
    if state.exists and not (state.readable and state.writable):
        return f"user {user} may not read and write it", f"sudo chown {user} {state.path}"
    if not state.writable:
        return f"user {user} cannot create it", f"create its folder: mkdir -p {state.path.parent}"
    return "", ""


def _state(
    path: Path, named_by: str, is_device: bool = False, creates_parents: bool = False, is_appended: bool = False
) -> PathState:
    if path.is_dir():
        is_wrong_kind = is_device or is_appended
        return PathState(
            path, named_by, is_device, True, os.access(path, os.R_OK), _can_create_file(path), is_wrong_kind
        )
    if path.exists():
        # A saved file is replaced by a new file, so its folder must be writable.
        writable = os.access(path, os.W_OK) and (is_device or is_appended or _can_create_file(path.parent))
        is_wrong_kind = is_device and not stat.S_ISCHR(path.stat().st_mode)
        return PathState(path, named_by, is_device, True, os.access(path, os.R_OK), writable, is_wrong_kind)
    above = path.absolute().parent
    while creates_parents and not above.exists() and above != above.parent:
        above = above.parent
    return PathState(path, named_by, is_device, False, False, above.is_dir() and _can_create_file(above))


def _can_create_file(folder: Path) -> bool:
    """True if a file can be created in a folder, tested with an unnamed temporary file."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False

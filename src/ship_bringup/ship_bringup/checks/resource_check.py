"""Checks of the files, devices and ports that the nodes use: existence, permissions, and availability now.

Files are those that the nodes read and write. Ports, own addresses and serial devices are those of nmea_in and
nmea_out. A port is bound briefly, without listening, and released. A device is not opened, because opening could change
its control lines; the system reports the process that has the device open.
"""

import contextlib
import errno
import getpass
import os
import re
import socket
import stat
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER, full_name, read_sections
from ship_bringup.checks.check_line import CheckLine, Result
from ship_bringup.suite.plan import SAVED_FILES
from ship_node.parameters.machine_resources import MachineResource, ResourceKind, port_resource
from ship_node.parameters.parameter_file import read_node_parameters

_FILES = "files"
_DEVICES = "/dev/"
_SINK = r"sinks\.[^.]+\.path"
"""Pattern of a parameter with a file to which ``nmea_out`` appends."""
_SERIAL = r"(sinks|sources)\.[^.]+\.device"

_PORTS = "ports"
_SOCKETS = {ResourceKind.UDP: socket.SOCK_DGRAM, ResourceKind.TCP: socket.SOCK_STREAM}
_TABLES = {ResourceKind.UDP: ("udp", "udp6"), ResourceKind.TCP: ("tcp", "tcp6")}
_BLOCKING_STATES = {"udp": "07", "udp6": "07", "tcp": "0A", "tcp6": "0A"}
"""Protocol → socket state in the system's table that prevents binding the same port."""
_ANY_PORT = 0


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
        yield CheckLine(_FILES, Result.WARN, text, "configure a file: docs/how-to/bring_up.md")
    for state in states:
        problem, advice = _path_problem(state, user)
        result = Result.FAIL if problem else Result.OK
        yield CheckLine(_FILES, result, f"{state.named_by} {state.path}: {problem or 'good'}", advice)
    if not states and not missing_settings:
        yield CheckLine(_FILES, Result.OK, "the suite file names no file and no device")


def _path_problem(state: PathState, user: str) -> tuple[str, str]:
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


@dataclass(frozen=True)
class PlaceState:
    """A port or device that a node will use.

    Attributes:
        node: full name of the node.
        named_by: file, line and parameter with the place.
        place: the port or device; port 0 if only the address matters.
        error: errno of the reason why the place is not available; 0 if it is available.
        holder: program that uses the place, if known.
    """

    node: str
    named_by: str
    place: MachineResource
    error: int = 0
    holder: str = ""


def read_place_states(path: Path, namespace: str, companions: Mapping[str, Any]) -> Iterator[PlaceState]:
    """Yield the states of a suite's NMEA ports and own addresses, and of its devices in use.

    Files may be shared and are not checked.

    Args:
        path: the suite file.
        namespace: namespace of the suite.
        companions: name → configuration of each node.
    """
    for name, config in companions.items():
        node = full_name(name, namespace)
        file = read_node_parameters(path, node)
        own = [port_resource(key, ResourceKind.UDP, _ANY_PORT, address) for key, address in config.interfaces.items()]
        for place in (*config.places, *own):
            named_by = f"{path}:{file.line_of(place.parameter)}: {place.parameter}"
            if place.kind in _SOCKETS:
                error = _binding_error(place)
                holder = _holding_program(_sockets(place)) if error == errno.EADDRINUSE else ""
                yield PlaceState(node, named_by, place, error, holder)
            elif _is_device(str(place.name)) and (holder := _holding_program({os.path.realpath(str(place.name))})):
                yield PlaceState(node, named_by, place, errno.EADDRINUSE, holder)


def check_places(states: Sequence[PlaceState], running: Collection[str]) -> Iterator[CheckLine]:
    """Check all ports and devices.

    Args:
        states: states of the ports and devices.
        running: full names of running nodes, for example an ``nmea_in`` started by hand.
    """
    for state in states:
        if state.error == errno.EADDRINUSE and state.node in running:
            found = f"{state.named_by}: {state.place} is in use while {state.node} runs"
            yield CheckLine(_PORTS, Result.NOT_CHECKED, found, "end it before the suite, or the suite cannot use it")
            continue
        problem, advice = _place_problem(state)
        place, good = state.place, "is available" if state.place.name else "is an address of this machine"
        found = f"{state.named_by}: {place if place.name else place.address} {problem or good}"
        yield CheckLine(_PORTS, Result.FAIL if problem else Result.OK, found, advice)


def _place_problem(state: PlaceState) -> tuple[str, str]:
    if not state.error:
        return "", ""
    if state.error == errno.EADDRINUSE:
        holder = state.holder or "another program, or by this suite if it already runs"
        other = "device" if state.place.kind is ResourceKind.PATH else "port"
        return f"is in use by {holder}", f"end that program, or configure another {other}"
    if state.error == errno.EADDRNOTAVAIL:
        return "is not available: this machine has no such address", "use one of those that 'ip -4 address' shows"
    if state.error in (errno.EACCES, errno.EPERM):
        return f"is not permitted for user {getpass.getuser()}", "use a port from 1024 on"
    return f"is not available: {os.strerror(state.error)}", "correct it in the suite file"


def _binding_error(place: MachineResource) -> int:
    """Bind a port as the nodes do; return the errno of the failure, 0 on success."""
    try:
        with socket.socket(socket.AF_INET, _SOCKETS[place.kind]) as trial_socket:
            if place.kind is ResourceKind.TCP or place.is_multicast:
                trial_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial_socket.bind((place.address, int(place.name)))
    except socket.gaierror:
        return errno.EADDRNOTAVAIL
    except OSError as problem:
        return problem.errno or errno.EIO
    return 0


def _is_device(path: str) -> bool:
    try:
        return stat.S_ISCHR(os.stat(path).st_mode)
    except OSError:
        return False


def _sockets(place: MachineResource) -> set[str]:
    """Return the sockets that block a port at any address, by their names in /proc/PID/fd."""
    found = set()
    for table in _TABLES[place.kind]:
        try:
            rows = Path("/proc/net", table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for _, local, _, state, *others in map(str.split, rows):
            if int(local.rpartition(":")[2], 16) == place.name and state == _BLOCKING_STATES[table]:
                found.add(f"socket:[{others[5]}]")
    return found


def _holding_program(names: Collection[str]) -> str:
    """Return the program that has one of some files open; empty if unknown, as for programs of other users."""
    for process in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError):  # the process has ended, or belongs to another user
            if any(
                _link_target(f"/proc/{process}/fd/{number}") in names for number in os.listdir(f"/proc/{process}/fd")
            ):
                return f"{_program_name(Path('/proc', process))} (process {process})"
    return ""


def _link_target(path: str) -> str:
    try:
        return os.readlink(path)
    except OSError:
        return ""  # the file was closed meanwhile


def _program_name(process: Path) -> str:
    """Return the name of a process's program; for Python, the name of the script."""
    name = process.joinpath("comm").read_text(encoding="utf-8", errors="replace").strip()
    words = process.joinpath("cmdline").read_text(encoding="utf-8", errors="replace").split("\0")
    is_script = name.startswith("python") and len(words) > 1 and not words[1].startswith("-")
    return os.path.basename(words[1]) if is_script else name

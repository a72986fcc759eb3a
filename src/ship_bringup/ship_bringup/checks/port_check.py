"""Ports, own addresses and serial devices that nmea_in and nmea_out will hold: whether they can be had now.

A port is bound for a moment, without listening, and given back. A device is not opened, which could move its lines:
the system tells who has it open.
"""

import contextlib
import errno
import getpass
import os
import socket
import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.parameter_yaml import full_name
from ship_bringup.checks.check_line import CheckLine, Result
from ship_node.parameters.parameter_file import read
from ship_node.parameters.places import HeldPlace, PlaceKind, held_port

_CHECK = "ports"
_SOCKETS = {PlaceKind.UDP: socket.SOCK_DGRAM, PlaceKind.TCP: socket.SOCK_STREAM}
_TABLES = {PlaceKind.UDP: ("udp", "udp6"), PlaceKind.TCP: ("tcp", "tcp6")}
_LISTENS = {"udp": "07", "udp6": "07", "tcp": "0A", "tcp6": "0A"}
"""State of a socket in the system's table that others cannot bind beside."""
_ANY_PORT = 0


@dataclass(frozen=True)
class PlaceState:
    """A place that a node will hold.

    Attributes:
        node: its full name.
        named_by: file, line and parameter.
        place: what is held; port 0 where only the address matters.
        error: why it cannot be had, as errno; 0 where it can.
        holder: program that has it, where that can be told.
    """

    node: str
    named_by: str
    place: HeldPlace
    error: int = 0
    holder: str = ""


def look_at_places(path: Path, namespace: str, companions: Mapping[str, Any]) -> Iterator[PlaceState]:
    """Try all places of a suite's NMEA nodes, but for files, which several may open.

    Args:
        path: the suite file.
        namespace: of the suite.
        companions: name → configuration of each node.
    """
    for name, config in companions.items():
        node = full_name(name, namespace)
        file = read(path, node)
        own = [held_port(key, PlaceKind.UDP, _ANY_PORT, address) for key, address in config.interfaces.items()]
        for place in (*config.places, *own):
            named_by = f"{path}:{file.line_of(place.parameter)}: {place.parameter}"
            if place.kind in _SOCKETS:
                error = _binding_error(place)
                holder = _holder(_sockets(place)) if error == errno.EADDRINUSE else ""
                yield PlaceState(node, named_by, place, error, holder)
            elif _is_device(str(place.name)) and (holder := _holder({os.path.realpath(str(place.name))})):
                yield PlaceState(node, named_by, place, errno.EADDRINUSE, holder)


def judge_places(states: Sequence[PlaceState], running: Collection[str]) -> Iterator[CheckLine]:
    """Rows of all places.

    Args:
        states: what was found.
        running: full names of nodes that run already, as an ``nmea_in`` that was started by hand.
    """
    for state in states:
        if state.error == errno.EADDRINUSE and state.node in running:
            found = f"{state.named_by}: {state.place} is in use while {state.node} runs"
            yield CheckLine(_CHECK, Result.NOT_CHECKED, found, "end it before the suite, or the suite cannot have it")
            continue
        problem, advice = _problem(state)
        good = "can be had" if state.place.name else "is an address of this machine"
        found = f"{state.named_by}: {_words(state.place)} {problem or good}"
        yield CheckLine(_CHECK, Result.FAIL if problem else Result.OK, found, advice)


def _problem(state: PlaceState) -> tuple[str, str]:
    if not state.error:
        return "", ""
    if state.error == errno.EADDRINUSE:
        holder = state.holder or "another program, or by this suite if it already runs"
        other = "device" if state.place.kind is PlaceKind.PATH else "port"
        return f"is in use by {holder}", f"end that one, or give another {other}"
    if state.error == errno.EADDRNOTAVAIL:
        return "cannot be had: this machine has no such address", "give one of those that 'ip -4 address' shows"
    if state.error in (errno.EACCES, errno.EPERM):
        return f"may not be had by user {getpass.getuser()}", "give a port from 1024 on"
    return f"cannot be had: {os.strerror(state.error)}", "set it right in the suite file"


def _words(place: HeldPlace) -> str:
    return str(place) if place.name else place.address


def _binding_error(place: HeldPlace) -> int:
    """Bind a port as the nodes do; errno of what failed, 0 where nothing did."""
    try:
        with socket.socket(socket.AF_INET, _SOCKETS[place.kind]) as tried:
            if place.kind is PlaceKind.TCP or place.is_group:
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((place.address, int(place.name)))
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


def _sockets(place: HeldPlace) -> set[str]:
    """What processes that have a port open call it, whatever the address."""
    found = set()
    for table in _TABLES[place.kind]:
        try:
            rows = Path("/proc/net", table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for _, local, _, state, *others in map(str.split, rows):
            if int(local.rpartition(":")[2], 16) == place.name and state == _LISTENS[table]:
                found.add(f"socket:[{others[5]}]")
    return found


def _holder(names: Collection[str]) -> str:
    """The program that has one of some files open; empty where none is seen, as those of other users are not."""
    for process in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError):  # gone, or another user's
            if any(_link(f"/proc/{process}/fd/{number}") in names for number in os.listdir(f"/proc/{process}/fd")):
                return f"{_program(Path('/proc', process))} (process {process})"
    return ""


def _link(path: str) -> str:
    try:
        return os.readlink(path)
    except OSError:
        return ""  # closed meanwhile


def _program(process: Path) -> str:
    """Name of a process's program; where that is Python, of its script."""
    name = process.joinpath("comm").read_text(encoding="utf-8", errors="replace").strip()
    words = process.joinpath("cmdline").read_text(encoding="utf-8", errors="replace").split("\0")
    is_script = name.startswith("python") and len(words) > 1 and not words[1].startswith("-")
    return os.path.basename(words[1]) if is_script else name

"""Keeps the successor of a killed program from its ports, so that DDS connects it at once.

A killed program cannot say farewell: for 20 s, the default lease of DDS, its peers go on talking to it, and a successor
on the same ports gets what is meant for the dead one. Shared memory has the same fault, and no ports that could be
kept.

On other ports the successor is met as soon as each peer tells by itself that it is there: every 0.5 s with the suite's
profile (:data:`ship_bags.live.ros_process.DDS_PROFILE`), every 3 s by default. Seen on the wire with Fast DDS 2.14: the
peers answer its first words within 0.1 ms, before it listens, and do not answer those words when they are repeated.
"""

import contextlib
import os
import socket
import time
from pathlib import Path

UDP_ALONE = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
"""Environment of a program that is to be connected quickly after a kill, where people do not set it otherwise."""

_LEASE_S = 20.0
_MARGIN_S = 5.0
_FIRST_EPHEMERAL = 32768


class HeldPorts:
    """UDP ports that nobody else can take, each for the time of a lease."""

    def __init__(self) -> None:
        self._held: list[tuple[float, list[socket.socket]]] = []

    def hold(self, ports: frozenset[int]) -> None:
        """Take those of some ports that are free; give back those whose time is over.

        Without them the successor is met later, which is no reason to fail: the process may have no file descriptors.
        """
        now_s = time.monotonic()
        for until_s, sockets in self._held:
            if until_s <= now_s:
                _close(sockets)
        self._held = [(until_s, sockets) for until_s, sockets in self._held if until_s > now_s]
        taken = []
        for port in sorted(ports):
            with contextlib.suppress(OSError):
                own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                taken.append(own)
                own.bind(("", port))
        self._held.append((now_s + _LEASE_S + _MARGIN_S, taken))

    def close(self) -> None:
        """Give all back."""
        for _, sockets in self._held:
            _close(sockets)
        self._held = []


def ports_of(pid: int) -> frozenset[int]:
    """UDP ports that a process listens at, those that the system gave it aside; none where it is gone."""
    inodes = set()
    with contextlib.suppress(OSError):
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                inodes.add(os.readlink(link).removeprefix("socket:[").removesuffix("]"))
        rows = Path(f"/proc/{pid}/net/udp").read_text(encoding="ascii").splitlines()[1:]
        columns = [row.split() for row in rows]
        ports = {int(column[1].rpartition(":")[2], 16) for column in columns if column[9] in inodes}
        return frozenset(port for port in ports if port < _FIRST_EPHEMERAL)
    return frozenset()


def _close(sockets: list[socket.socket]) -> None:
    for each in sockets:
        each.close()

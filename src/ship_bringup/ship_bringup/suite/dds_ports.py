"""Reserve the ports of a killed program, so that DDS connects its successor at once.

A killed program does not announce its end. For 20 s, the default lease of DDS, peers continue to send to the program's
ports. A successor on these ports receives the messages meant for the killed program, and is discovered later. Shared
memory has the same defect, but no ports that could be reserved (see :data:`UDP_ONLY`).

On other ports the successor is discovered as soon as each peer announces itself: every 0.5 s with the suite's profile
(:data:`ship_bags.live.dds.DDS_PROFILE`), every 3 s by default. The successor must wait for these announcements.
The peers answer the successor's own first announcement within 0.1 ms, before the successor listens, and do not answer
repetitions (observed with Fast DDS 2.14).
"""

import contextlib
import os
import socket
import time
from pathlib import Path

UDP_ONLY = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
"""Environment of a program that must be connected quickly after a kill, unless the user sets this variable."""

_LEASE_S = 20.0
_MARGIN_S = 5.0
_FIRST_EPHEMERAL = 32768


class ReservedPorts:
    """UDP ports that no other process can take, each for the default lease of DDS plus 5 s."""

    def __init__(self) -> None:
        self._reserved: list[tuple[float, list[socket.socket]]] = []

    def reserve(self, ports: frozenset[int]) -> None:
        """Reserve the free ports among some ports, and release reserved ports whose time is over.

        A failure (for example no file descriptors left) is ignored: the successor is then discovered later.
        """
        now_s = time.monotonic()
        for until_s, sockets in self._reserved:
            if until_s <= now_s:
                _close(sockets)
        self._reserved = [(until_s, sockets) for until_s, sockets in self._reserved if until_s > now_s]
        taken = []
        for port in sorted(ports):
            with contextlib.suppress(OSError):
                own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                taken.append(own)
                own.bind(("", port))
        self._reserved.append((now_s + _LEASE_S + _MARGIN_S, taken))

    def close(self) -> None:
        """Release all ports."""
        for _, sockets in self._reserved:
            _close(sockets)
        self._reserved = []


def udp_ports_of(pid: int) -> frozenset[int]:
    """Return the UDP ports that a process has bound, without ephemeral ports; empty if the process has ended."""
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

"""What a node holds of its machine while it runs: ports, serial devices and files, and that no two hold the same."""

import ipaddress
import os.path
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

from ship_estimation.parameters import ParameterError

ANY_ADDRESS = "0.0.0.0"


class PlaceKind(Enum):
    """What is held, and the word for it."""

    UDP = "UDP port"
    TCP = "TCP port"
    PATH = "path"


@dataclass(frozen=True)
class HeldPlace:
    """A port that is listened at, a serial device or a file; made by :func:`held_port` and :func:`held_path`.

    Attributes:
        parameter: dotted name of the parameter that names it.
        kind: what it is.
        name: the port's number, or the path.
        address: of a port the own address or the multicast group; empty for all addresses.
    """

    parameter: str
    kind: PlaceKind
    name: int | str
    address: str = ""

    def __str__(self) -> str:
        """As people say it.

        Example:
            >>> str(held_port("sinks.bridge.port", PlaceKind.TCP, 10110, "127.0.0.1"))
            'TCP port 10110 of 127.0.0.1'
        """
        return f"{self.kind.value} {self.name}" + (f" of {self.address}" if self.address else "")

    @property
    def is_group(self) -> bool:
        """Whether it is a port of a multicast group: every listener of a group gets what is sent to it."""
        try:
            return ipaddress.ip_address(self.address).is_multicast
        except ValueError:
            return False

    def excludes(self, other: "HeldPlace") -> bool:
        """Whether only one of two can be had."""
        if (self.kind, self.name) != (other.kind, other.name):
            return False
        if self.address == other.address:
            return not self.is_group
        return not (self.address and other.address)


def is_ipv4(text: str) -> bool:
    """True for an IPv4 address as numbers."""
    try:
        return ipaddress.ip_address(text).version == 4
    except ValueError:
        return False


def held_port(parameter: str, kind: PlaceKind, port: int, address: str = "") -> HeldPlace:
    """A port of an own address or of a group, as it is written; without one, or with 0.0.0.0, of all addresses."""
    return HeldPlace(parameter, kind, port, "" if address == ANY_ADDRESS else address)


def held_path(parameter: str, path: str) -> HeldPlace:
    """A device or a file by its path as it is written, but for needless slashes and dots.

    That two links lead to one device is not seen before the start: what is plugged in then may be another device.

    Example:
        >>> held_path("sinks.log.path", "/var/log//ship/./a.nmea").name
        '/var/log/ship/a.nmea'
    """
    return HeldPlace(parameter, PlaceKind.PATH, os.path.normpath(path))


def clashes(places: Iterable[HeldPlace]) -> Iterator[tuple[HeldPlace, HeldPlace]]:
    """Pairs of places of which only one can be had, each in the order in which they come."""
    return ((one, other) for one, other in combinations(places, 2) if one.excludes(other))


def refuse_clashes(places: Iterable[HeldPlace]) -> None:
    """Refuse places of one node of which only one can be had.

    Raises:
        ParameterError: names both parameters.
    """
    for one, other in clashes(places):
        reason = f"parameter '{other.parameter}' = {other.name!r}: '{one.parameter}' has {one} already"
        raise ParameterError(f"{reason}: expected a {one.kind.value} of its own", other.parameter, value=other.name)

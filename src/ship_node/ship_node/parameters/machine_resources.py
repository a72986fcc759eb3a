"""Resources of the computer that a node uses exclusively: ports, serial devices, files; detection of conflicts."""

import ipaddress
import os.path
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

from ship_estimation.parameters.schema import ParameterError

ANY_ADDRESS = "0.0.0.0"


class ResourceKind(Enum):
    """Kind of a resource, with its name in texts."""

    UDP = "UDP port"
    TCP = "TCP port"
    PATH = "path"


@dataclass(frozen=True)
class MachineResource:
    """Listening port, serial device or file; made by :func:`port_resource` and :func:`path_resource`.

    Attributes:
        parameter: dotted name of the parameter that gives the resource.
        kind: kind of resource.
        name: the port's number, or the path.
        address: address of a port, either of this computer or of a multicast group; empty for all addresses.
    """

    parameter: str
    kind: ResourceKind
    name: int | str
    address: str = ""

    def __str__(self) -> str:
        """Return the resource as text.

        Example:
            >>> str(port_resource("sinks.bridge.port", ResourceKind.TCP, 10110, "127.0.0.1"))
            'TCP port 10110 of 127.0.0.1'
        """
        return f"{self.kind.value} {self.name}" + (f" of {self.address}" if self.address else "")

    @property
    def is_multicast(self) -> bool:
        """True for a port of a multicast group, whose datagrams every listener gets."""
        return is_multicast(self.address)

    def conflicts_with(self, other: "MachineResource") -> bool:
        """Return True if the two resources cannot be used together."""
        if (self.kind, self.name) != (other.kind, other.name):
            return False
        if self.address == other.address:
            return not self.is_multicast
        return not (self.address and other.address)


def is_ipv4(text: str) -> bool:
    """True for an IPv4 address in numeric form."""
    try:
        return ipaddress.ip_address(text).version == 4
    except ValueError:
        return False


def is_multicast(text: str) -> bool:
    """True for the address of a multicast group in numeric form."""
    try:
        return ipaddress.ip_address(text).is_multicast
    except ValueError:
        return False


def port_resource(parameter: str, kind: ResourceKind, port: int, address: str = "") -> MachineResource:
    """Return a port of one address or multicast group; an empty address and 0.0.0.0 stand for all addresses."""
    return MachineResource(parameter, kind, port, "" if address == ANY_ADDRESS else address)


def path_resource(parameter: str, path: str) -> MachineResource:
    """Return a device or a file by its path as written, without redundant slashes and dots.

    Links are not resolved, because at the start a link may lead to another device.

    Example:
        >>> path_resource("sinks.log_text.path", "/var/log//ship/./a.nmea").name
        '/var/log/ship/a.nmea'
    """
    return MachineResource(parameter, ResourceKind.PATH, os.path.normpath(path))


def refuse_conflicts(places: Iterable[MachineResource]) -> None:
    """Refuse conflicting resources of one node.

    Raises:
        ParameterError: two resources conflict; the text names both parameters.
    """
    for one, other in combinations(places, 2):
        if one.conflicts_with(other):
            reason = f"parameter '{other.parameter}' = {other.name!r}: '{one.parameter}' has {one} already"
            raise ParameterError(f"{reason}: expected a {one.kind.value} of its own", other.parameter, value=other.name)

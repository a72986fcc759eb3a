"""Conflicts of ports and files, compared with the kernel."""

import contextlib
import itertools
import socket

import pytest

from ship_estimation.parameters.schema import ParameterError
from ship_node.parameters.machine_resources import ResourceKind, path_resource, port_resource, refuse_conflicts
from ship_testing.nmea_in_peer import free_port

ADDRESSES = "", "0.0.0.0", "127.0.0.1", "127.0.0.2", "239.192.0.4", "239.192.0.5"
KINDS = {ResourceKind.UDP: socket.SOCK_DGRAM, ResourceKind.TCP: socket.SOCK_STREAM}


def can_have_both(kind, one, other):
    """Return True if the kernel allows a port at both addresses, opened as sinks and sources do."""
    port = free_port(KINDS[kind])
    with contextlib.ExitStack() as stack:
        for address in (one, other):
            first = stack.enter_context(socket.socket(socket.AF_INET, KINDS[kind]))
            if kind is ResourceKind.TCP or port_resource("", kind, port, address).is_multicast:
                first.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                first.bind((address, port))
            except OSError:
                return False
            if kind is ResourceKind.TCP:
                first.listen()
    return True


@pytest.mark.parametrize(
    ("kind", "one", "other"),
    [
        (kind, *pair)
        for kind, addresses in ((ResourceKind.UDP, ADDRESSES), (ResourceKind.TCP, ADDRESSES[:4]))
        for pair in itertools.product(addresses, repeat=2)
    ],
)
def test_ports_conflict_as_in_the_kernel(kind, one, other):
    places = port_resource("a", kind, 10110, one), port_resource("b", kind, 10110, other)
    assert places[0].conflicts_with(places[1]) is not can_have_both(kind, one, other)


def test_resources_of_different_kind_or_name_do_not_conflict():
    places = [
        port_resource("a", ResourceKind.UDP, 10110),
        port_resource("b", ResourceKind.TCP, 10110),
        port_resource("c", ResourceKind.TCP, 10111),
        path_resource("d", "/dev/ttyUSB0"),
        path_resource("e", "/dev/ttyUSB1"),
    ]
    refuse_conflicts(places)
    with pytest.raises(ParameterError, match=r"parameter 'f' = '/dev/ttyUSB1': 'e' has path /dev/ttyUSB1 already"):
        refuse_conflicts([*places, path_resource("f", "/dev//./ttyUSB1")])

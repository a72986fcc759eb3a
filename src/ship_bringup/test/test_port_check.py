"""Ports, own addresses and devices of the NMEA nodes: available, in use by a program, or not of this machine."""

import os
import pty
import socket
import subprocess
import sys

import pytest

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.resource_check import PlaceState, check_places, read_place_states
from ship_bringup.security.rights import load_companions
from ship_node.parameters.machine_resources import ResourceKind, port_resource
from ship_testing.nmea_in_peer import free_port

STREAM, DATAGRAM = socket.SOCK_STREAM, socket.SOCK_DGRAM
HELD = {
    "server": ("nmea_out", "sinks.a.port", STREAM, "kind: tcp_server, port: PORT"),
    "bridge": ("nmea_out", "sinks.a.listen_port", DATAGRAM, "kind: udp, address: 10.0.0.1, port: 1, listen_port: PORT"),
    "source": ("nmea_in", "sources.a.port", DATAGRAM, "kind: udp, becomes: gyro, port: PORT"),
}


@pytest.fixture
def look(tmp_path):
    """Return a function that checks one sink or source."""

    def states(node, text, namespace="", running=()):
        group = "sinks" if node == "nmea_out" else "sources"
        path = tmp_path / "suite.yaml"
        path.write_text(f"/**/{node}:\n  ros__parameters:\n    {group}:\n      a: {{{text}}}\n")
        found = read_place_states(path, namespace, load_companions(path, namespace))
        rows = check_places(list(found), running)
        return [(row.result, row.finding.replace(f"{tmp_path}/", ""), row.advice) for row in rows]

    return states


@pytest.mark.parametrize("what", HELD)
def test_free_port_and_port_in_use(look, what):
    node, key, kind, text = HELD[what]
    port = free_port(kind)
    text, name = text.replace("PORT", str(port)), f"{'TCP' if kind is STREAM else 'UDP'} port {port}"
    for _ in range(2):  # the check binds the port and releases it
        assert look(node, text) == [(Result.OK, f"suite.yaml:4: {key}: {name} is available", "")]
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("", port))
        if kind is STREAM:
            other.listen()
        ((result, found, advice),) = look(node, text)
        assert (result, advice) == (Result.FAIL, "end that program, or configure another port")
        assert found.startswith(f"suite.yaml:4: {key}: {name} is in use by ")
        assert found.endswith(f"(process {os.getpid()})")
        # The node was started by hand, to check the instruments.
        ((result, found, _),) = look(node, text, "demo", [f"/demo/{node}"])
        assert (result, found) == (Result.NOT_CHECKED, f"suite.yaml:4: {key}: {name} is in use while /demo/{node} runs")


def test_program_of_a_port_is_named_by_its_script(look, tmp_path):
    script = tmp_path / "old_logger.py"
    text = "import socket, sys\ns = socket.create_server(('', 0))\nprint(s.getsockname()[1], flush=True)\n"
    script.write_text(text + "sys.stdin.read()\n")
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, str(script)], **piped) as process:
        ((_, found, _),) = look("nmea_out", f"kind: tcp_server, port: {process.stdout.readline().strip()}")
        process.stdin.close()
    assert found.endswith(f" is in use by old_logger.py (process {process.pid})")


def test_unknown_program_may_be_the_suite():
    state = PlaceState("/nmea_out", "suite.yaml:4: sinks.a.port", port_resource("", ResourceKind.TCP, 10110), 98)
    (row,) = check_places([state], [])
    assert row.finding.endswith("TCP port 10110 is in use by another program, or by this suite if it already runs")


@pytest.mark.parametrize(
    ("node", "text", "rows"),
    [
        ("nmea_out", "kind: tcp_server, address: 203.0.113.7, port: 10110",
         ["port: TCP port 10110 of 203.0.113.7 is not available: this machine has no such address"]),
        ("nmea_out", "kind: udp, address: 239.192.0.4, port: 1, interface: 203.0.113.7",
         ["interface: 203.0.113.7 is not available: this machine has no such address"]),
        ("nmea_in", "kind: udp, becomes: ins, address: 203.0.113.7, port: 10110",
         ["port: UDP port 10110 of 203.0.113.7 is not available: this machine has no such address"]),
        ("nmea_out", "kind: udp, address: 239.192.0.4, port: 1, interface: 127.0.0.1",
         ["interface: 127.0.0.1 is an address of this machine"]),
        ("nmea_in", "kind: tcp, becomes: ins, address: 203.0.113.7, port: 10110", []),
        ("nmea_out", "kind: file, path: /nowhere", []),
        ("nmea_out", "kind: serial, device: /dev/ttyNONE7", []),
    ],
)  # fmt: skip
def test_own_addresses_are_of_this_machine(look, node, text, rows):
    found = look(node, text)
    assert [words.partition(".a.")[2] for _, words, _ in found] == rows
    assert all((result is Result.FAIL) is ("not available" in words) for result, words, _ in found)


def test_device_in_use_by_another_program(look):
    first, second = pty.openpty()
    try:
        text = f"kind: serial, device: {os.ttyname(second)}"
        ((result, found, advice),) = look("nmea_out", text)
        assert (result, advice) == (Result.FAIL, "end that program, or configure another device")
        assert f"sinks.a.device: path {os.ttyname(second)} is in use by " in found
        os.close(second)
        second = None
        assert look("nmea_out", text) == []
    finally:
        os.close(first)
        if second is not None:
            os.close(second)

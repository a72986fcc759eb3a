"""Ports, devices and files that two sinks of nmea_out may share, and those that they may not."""

import pytest

from ship_estimation.parameters.schema import ParameterError, build
from ship_nmea.out.config import NmeaOutConfig

UDP = {"kind": "udp", "address": "192.168.1.40", "port": 10110}
SERVER = {"kind": "tcp_server", "port": 10110}
SERIAL = {"kind": "serial", "device": "/dev/ttyUSB0"}
FILE = {"kind": "file", "path": "/var/log/ship/a.nmea"}


@pytest.mark.parametrize(
    ("one", "other", "parameter", "complaint"),
    [
        (FILE, FILE, "sinks.b.path", "'sinks.a.path' has path /var/log/ship/a.nmea already: expected a path of its"),
        (FILE, FILE | {"path": "/var/log/ship/../ship//a.nmea"}, "sinks.b.path", "'sinks.a.path' has path"),
        (SERIAL, SERIAL | {"baud": 4800}, "sinks.b.device", "'sinks.a.device' has path /dev/ttyUSB0 already"),
        (SERVER, SERVER, "sinks.b.port", "'sinks.a.port' has TCP port 10110 already: expected a TCP port of its own"),
        (SERVER, SERVER | {"address": "127.0.0.1"}, "sinks.b.port", "'sinks.a.port' has TCP port 10110 already"),
        *[(UDP | {"listen_port": 10111}, UDP | {"address": "192.168.1.41", "listen_port": 10111},
           "sinks.b.listen_port", "'sinks.a.listen_port' has UDP port 10111 already")],
    ],
)  # fmt: skip
def test_exclusive_places_are_refused(one, other, parameter, complaint):
    with pytest.raises(ParameterError, match=complaint) as caught:
        build(NmeaOutConfig, {"sinks": {"a": one, "b": other}})
    assert caught.value.parameters == (parameter,)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (UDP, UDP),
        (UDP, UDP | {"listen_port": 10110}),
        (SERVER, UDP | {"listen_port": 10110}),
        (SERVER | {"address": "127.0.0.1"}, SERVER | {"address": "10.0.0.7"}),
        (FILE, FILE | {"path": "/var/log/ship/b.nmea"}),
    ],
)
def test_shared_places_are_accepted(one, other):
    build(NmeaOutConfig, {"sinks": {"a": one, "b": other}})


@pytest.mark.parametrize(
    ("sink", "parameter", "complaint"),
    [
        (SERVER | {"from": ["bridge.local"]}, "sinks.a.from", "names 'bridge.local': expected IPv4 addresses"),
        (SERIAL | {"from": ["10.0.0.7"]}, "sinks.a.from", "does not apply to kind serial"),
    ],
)
def test_invalid_command_addresses_are_refused(sink, parameter, complaint):
    with pytest.raises(ParameterError, match=complaint) as caught:
        build(NmeaOutConfig, {"sinks": {"a": sink}})
    assert caught.value.parameters == (parameter,)


def test_commands_are_accepted_from_configured_addresses_only():
    """The default for UDP is the destination address; commands on a serial line have no address."""
    listed = {"from": ["10.0.0.7"]}
    sinks = build(NmeaOutConfig, {"sinks": {
        "udp": UDP, "other": UDP | listed, "server": SERVER, "bridge": SERVER | listed | {"port": 10111},
        "line": SERIAL,
    }}).sinks  # fmt: skip
    allowed = {
        name: [
            address for address in ("192.168.1.40", "10.0.0.7", "10.0.0.9", "") if sink.accepts_commands_from(address)
        ]
        for name, sink in sinks.items()
    }
    assert allowed == {
        "udp": ["192.168.1.40", ""], "other": ["10.0.0.7", ""], "server": [""], "bridge": ["10.0.0.7", ""],
        "line": [""],
    }  # fmt: skip

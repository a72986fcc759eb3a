"""What two sinks of nmea_out may share, and what they may not."""

import pytest

from ship_estimation.parameters import ParameterError, build
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
def test_what_only_one_sink_can_have_is_refused(one, other, parameter, complaint):
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
def test_what_several_sinks_can_have_is_taken(one, other):
    build(NmeaOutConfig, {"sinks": {"a": one, "b": other}})

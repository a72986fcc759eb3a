"""Invalid parameters of nmea_in: the error names each one and what was expected."""

import pytest

from ship_estimation.parameters.schema import ParameterError, build
from ship_nmea.instruments.config import NmeaInConfig

UDP = {"kind": "udp", "port": 10110}
GROUP = UDP | {"address": "239.192.0.4"}
SERIAL = {"kind": "serial", "device": "/dev/ttyUSB0"}


@pytest.mark.parametrize(
    ("sources", "parameter", "complaint"),
    [
        ({"a": {"kind": "udp", "becomes": "ins"}}, "sources.a.port", "needs one, from 1 to 65535"),
        ({"a": {"kind": "tcp", "becomes": "ins", "port": 4001}}, "sources.a.address", "needs the server's name"),
        ({"a": {"kind": "serial", "becomes": "ins"}}, "sources.a.device", "needs one, as /dev/ttyUSB0"),
        ({"a": UDP | {"becomes": "ins", "interface": "eth0"}}, "sources.a.interface", "expected an IPv4 address"),
        ({"a": UDP | {"becomes": "ins", "device": "/dev/x"}}, "sources.a.device", "does not apply to kind udp"),
        ({}, "sources", "names no source"),
        ({"a": UDP}, "sources.a.becomes", "must be given"),
        ({"a": UDP | {"becomes": "compass"}}, "sources.a.becomes", "must be one of ins, reference, gyro"),
        ({"a": UDP | {"becomes": "ins", "port": 70000}}, "sources.a.port", "out of its range"),
        ({"a": UDP | {"becomes": "ins", "speed": 1}}, "sources.a.speed", "is unknown"),
        ({"a": UDP | {"becomes": "ins", "from": ["ins.local"]}}, "sources.a.from", "expected IPv4 addresses"),
        ({"a": SERIAL | {"becomes": "ins", "from": ["10.0.0.7"]}}, "sources.a.from", "does not apply to kind serial"),
        ({"a": UDP | {"becomes": "ins", "talkers": ["gp"]}}, "sources.a.talkers", "two capital letters"),
        ({n: UDP | {"becomes": "ins"} for n in "ab"}, "sources.b.becomes", "'a' already has this role"),
        (
            {n: SERIAL | {"becomes": "gyro", "baud": baud} for n, baud in (("a", 4800), ("b", 9600))},
            "sources.b.baud",
            "'a' reads the same device at 4800 Bd",
        ),
        (
            {n: GROUP | {"becomes": "gyro", "interface": own} for n, own in (("a", ""), ("b", "10.0.0.7"))},
            "sources.b.interface",
            "'a' receives the same by the default one; only one is opened",
        ),
        (
            {n: UDP | {"becomes": "gyro", "address": own} for n, own in (("a", "127.0.0.1"), ("b", ""))},
            "sources.b.port",
            "'sources.a.port' has UDP port 10110 of 127.0.0.1 already: expected a UDP port of its own",
        ),
        (
            {n: UDP | {"becomes": "gyro", "address": own} for n, own in (("a", "239.192.0.4"), ("b", "0.0.0.0"))},
            "sources.b.port",
            "'sources.a.port' has UDP port 10110 of 239.192.0.4 already",
        ),
    ],
)
def test_invalid_parameters_are_named(sources, parameter, complaint):
    with pytest.raises(ParameterError, match=complaint) as caught:
        build(NmeaInConfig, {"sources": sources})
    assert caught.value.parameters == (parameter,)


def test_separate_gnss_receiver_gives_the_fix():
    alone = build(NmeaInConfig, {"sources": {"a": UDP | {"becomes": "ins"}}})
    assert list(alone.role("a").topics("a")) == ["ins/imu", "gnss/fix"]
    both = build(NmeaInConfig, {"sources": {"a": UDP | {"becomes": "ins"}, "b": UDP | {"becomes": "gnss"}}})
    assert list(both.role("a").topics("a")) == ["ins/imu"]
    assert list(both.role("b").topics("b")) == ["gnss/fix"]


@pytest.mark.parametrize(
    ("one", "other", "held"),
    [
        (UDP, UDP | {"address": "0.0.0.0"}, ["sources.a.port"]),
        (SERIAL, SERIAL | {"device": "/dev//ttyUSB0"}, ["sources.a.device"]),
        (GROUP, GROUP | {"address": "239.192.0.5"}, ["sources.a.port", "sources.b.port"]),
        (UDP | {"address": "10.0.0.7"}, UDP | {"address": "127.0.0.1"}, ["sources.a.port", "sources.b.port"]),
        *[({"kind": "tcp", "address": "10.0.0.1", "port": 4001}, other, held) for other, held in (
            (UDP | {"port": 4001}, ["sources.b.port"]), ({"kind": "tcp", "address": "10.0.0.1", "port": 4001}, []))],
    ],
)  # fmt: skip
def test_sources_share_a_place_only_if_it_is_the_same(one, other, held):
    config = build(NmeaInConfig, {"sources": {"a": one | {"becomes": "gyro"}, "b": other | {"becomes": "reference"}}})
    assert [place.parameter for place in config.places] == held
    assert (config.sources["a"].place == config.sources["b"].place) is (len(held) < 2 and other["kind"] == one["kind"])

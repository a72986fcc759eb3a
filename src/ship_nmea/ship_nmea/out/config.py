"""Parameters of ``nmea_out``."""

import re
from dataclasses import dataclass

from ship_estimation.parameters.fields import mapping_of, parameter
from ship_estimation.parameters.schema import ParameterError
from ship_nmea.sentences.attitude import ATTITUDE_SENTENCES
from ship_node.parameters.machine_resources import (
    MachineResource,
    ResourceKind,
    is_ipv4,
    path_resource,
    port_resource,
    refuse_conflicts,
)

UDP, TCP_SERVER, SERIAL, FILE = "udp", "tcp_server", "serial", "file"
ALF, ALC, HBT = "ALF", "ALC", "HBT"
ALERT_SENTENCES = ALF, ALC, HBT

_REQUIRED_PARAMETERS = {UDP: ("address", "port"), TCP_SERVER: ("port",), SERIAL: ("device",), FILE: ("path",)}
_ALLOWED_PARAMETERS = {
    UDP: ("address", "port", "listen_port", "interface", "from"),
    TCP_SERVER: ("address", "port", "from"),
    SERIAL: ("device", "baud"),
    FILE: ("path",),
}
"""Kind of a sink → required parameters of its place, and all parameters that apply to it."""


@dataclass(frozen=True)
class SinkConfig:
    """Destination, kinds and rate of sentences."""

    kind: str = parameter(doc="how the sentences are sent", choices=(UDP, TCP_SERVER, SERIAL, FILE))
    sentences: tuple[str, ...] = parameter(
        ("HDT", "THS", "ROT"), doc="sentences to send, in this order", choices=(*ATTITUDE_SENTENCES, *ALERT_SENTENCES)
    )
    rate_hz: float = parameter(
        10.0, doc="rate of the attitude; at most the rate at which it is received", unit="Hz", minimum=0.01,
        maximum=1000.0,
    )  # fmt: skip
    decimals: int = parameter(
        4, doc="decimals of angles in degrees and of rates in °/min, an accuracy has one more; from 5 on a PASHR is"
        " longer than the 82 bytes of the standard", minimum=1, maximum=7,
    )  # fmt: skip
    address: str = parameter(
        "", doc="udp: IPv4 address of a host, a broadcast or a multicast group; tcp_server: own address, empty for all"
    )
    port: int = parameter(0, doc="udp: port sent to; tcp_server: port listened on", minimum=0, maximum=65535)
    listen_port: int = parameter(
        0, doc="udp: own port, to which the bridge sends its commands (ACN); 0 for none", minimum=0, maximum=65535
    )
    from_: tuple[str, ...] = parameter(
        (), doc="udp and tcp_server: IPv4 addresses whose commands (ACN) are executed; empty: for udp the host in "
        "address, for tcp_server none",
    )  # fmt: skip
    interface: str = parameter("", doc="udp to a group: own IPv4 address of the network to use; empty for the default")
    device: str = parameter("", doc="serial: device, better by its name in /dev/serial/by-id")
    baud: int = parameter(
        38400, doc="serial: rate; 4800 is that of NMEA 0183, about seven sentences per second", unit="Bd", minimum=300,
        maximum=4_000_000,
    )  # fmt: skip
    path: str = parameter("", doc="file: sentences are appended to it")

    def first_error(self) -> tuple[str, str] | None:
        """Return the first parameter that does not fit, and the reason; None if all parameters fit."""
        for name in _REQUIRED_PARAMETERS[self.kind]:
            if not getattr(self, name):
                return name, f"must be given for kind {self.kind}"
        allowed = _ALLOWED_PARAMETERS[self.kind]
        for field in ("address", "port", "listen_port", "interface", "from_", "device", "path"):
            name = field.removesuffix("_")
            if getattr(self, field) and name not in allowed:
                return name, f"does not apply to kind {self.kind}, which takes {', '.join(allowed)}"
        for address in self.from_:
            if not is_ipv4(address):
                return "from", f"names '{address}': expected IPv4 addresses, for example 10.0.0.7"
        for name in ("address", "interface"):
            if getattr(self, name) and not is_ipv4(getattr(self, name)):
                return name, f"is '{getattr(self, name)}': expected an IPv4 address, for example 192.168.1.255"
        if not self.sentences:
            return "sentences", "is empty: expected at least one sentence"
        for name in self.sentences:
            if self.sentences.count(name) > 1:
                return "sentences", f"names {name} twice: expected each sentence once"
        return None

    def accepts_commands_from(self, address: str) -> bool:
        """True if commands from an address are executed; commands from a serial line (no address) always are."""
        if not address or address in self.from_:
            return True
        return not self.from_ and self.kind == UDP and address == self.address

    def held_place(self, name: str) -> MachineResource | None:
        """Return the port, device or file of this machine that the sink occupies; None for UDP without ``listen_port``.

        Args:
            name: name of the sink's group of parameters, for example ``sinks.bridge``.
        """
        if self.kind == TCP_SERVER:
            return port_resource(f"{name}.port", ResourceKind.TCP, self.port, self.address)
        if self.kind == SERIAL:
            return path_resource(f"{name}.device", self.device)
        if self.kind == FILE:
            return path_resource(f"{name}.path", self.path)
        return port_resource(f"{name}.listen_port", ResourceKind.UDP, self.listen_port) if self.listen_port else None


@dataclass(frozen=True)
class NmeaOutConfig:
    """All parameters of the node."""

    sinks: dict[str, SinkConfig] = mapping_of(doc="destinations of sentences, by any name")
    talker: str = parameter("IN", doc="talker of HDT, THS, ROT and alerts: IN integrated navigation, HE gyro, ...")
    longest_age_s: float = parameter(
        1.0, doc="maximum age of an attitude by its stamp and by its arrival; an older one is sent void", unit="s",
        minimum=0.01, maximum=60.0,
    )  # fmt: skip
    alerts_period_s: float = parameter(
        30.0, doc="period of ALC and HBT", unit="s", minimum=0.1, maximum=60.0
    )
    manufacturer: str = parameter("ZZZ", doc="code of three letters that stands for this suite in ALF, ALC, ACN, ARC")

    tell_simulated: bool = parameter(
        False, doc="for training: under /clock (played bag, simulation) all is sent as usual; if false, only THS is"
        " valid, in mode S, and no alert is sent",
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Check the parameters against each other.

        Raises:
            ParameterError: a parameter is invalid or contradicts another parameter.
        """
        if not self.sinks:
            raise ParameterError("parameter 'sinks' names no sink: expected one as 'sinks.bridge.kind'", "sinks")
        for name, sink in self.sinks.items():
            if misfit := sink.first_error():
                full_name = f"sinks.{name}.{misfit[0]}"
                raise ParameterError(f"parameter '{full_name}' {misfit[1]}", full_name)
        _check_letters("talker", self.talker, 2)
        _check_letters("manufacturer", self.manufacturer, 3)
        refuse_conflicts(self.places)

    @property
    def places(self) -> tuple[MachineResource, ...]:
        """Return the ports, devices and files of this machine that the node occupies."""
        return tuple(filter(None, (sink.held_place(f"sinks.{name}") for name, sink in self.sinks.items())))

    @property
    def interfaces(self) -> dict[str, str]:
        """Dotted name of each ``interface`` parameter that is set → its value, an address of this machine."""
        own = {f"sinks.{id_}.interface": sink.interface for id_, sink in self.sinks.items()}
        return {name: address for name, address in own.items() if address}


def _check_letters(name: str, value: str, count: int) -> None:
    if not re.fullmatch(f"[A-Z]{{{count}}}", value):
        reason = f"parameter '{name}' = '{value:.20}': expected {count} capital letters"
        raise ParameterError(reason, name, value=value)


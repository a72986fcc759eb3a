"""Parameters of ``nmea_in``: sources, the places where they are received, and the messages of their sentences."""

import os.path
from dataclasses import dataclass

from ship_bags.nmea.instrument import GNSS, GYRO, INS, INSTRUMENT_TIME, REFERENCE, WEATHER, InstrumentRole
from ship_bags.nmea.instrument_lines import OPTIONAL, REQUIRED, is_talker
from ship_estimation.parameters.fields import mapping_of, parameter
from ship_estimation.parameters.schema import ParameterError
from ship_node.parameters.machine_resources import (
    ANY_ADDRESS,
    MachineResource,
    ResourceKind,
    is_ipv4,
    path_resource,
    port_resource,
    refuse_conflicts,
)

UDP, TCP, SERIAL = "udp", "tcp", "serial"
ARRIVAL_TIME = "arrival"

_PARAMETERS_OF_KIND = {
    UDP: ("address", "port", "interface", "from"),
    TCP: ("address", "port"),
    SERIAL: ("device", "baud"),
}
"""Kind of a source → parameters of its place."""

_UNIQUE_ROLES = (INS, GNSS, WEATHER)
"""Roles whose topics do not contain the name of the source: only one source may have each role."""


@dataclass(frozen=True)
class NmeaSourceConfig:
    """One instrument: the place where its sentences are received, and the messages made from them."""

    kind: str = parameter(
        doc="udp listens for datagrams, tcp connects to a server, serial reads a device", choices=(UDP, TCP, SERIAL)
    )
    becomes: str = parameter(
        doc="ins: ins/imu, and gnss/fix where no source is gnss; reference and gyro (heading alone): "
        "reference/<id>/imu; gnss: gnss/fix; weather: met/*",
        choices=(INS, REFERENCE, GYRO, GNSS, WEATHER),
    )
    address: str = parameter(
        "",
        doc="udp: the local address to listen at, or a multicast group; empty for all of this machine; "
        "tcp: name or address of the server",
    )
    port: int = parameter(
        0, doc="port of udp and tcp; sources with the same place share it", minimum=0, maximum=65535
    )
    interface: str = parameter(
        "", doc="udp of a group: own IPv4 address of the network to use; empty for the default"
    )
    from_: tuple[str, ...] = parameter(
        (),
        doc="udp: IPv4 addresses whose datagrams are used; if empty, the first sender is used until it sends nothing "
        "for 10 s",
    )
    device: str = parameter("", doc="serial: the device, as /dev/ttyUSB0")
    baud: int = parameter(
        4800, doc="serial: 4800 by the standard, 38400 for high speed", unit="Bd", minimum=50, maximum=4_000_000
    )
    talkers: tuple[str, ...] = parameter(
        (), doc="two letters each, as GP, HE: sentences of others are not used; empty for all; PSXN and PASHR have none"
    )
    checksum: str = parameter(
        REQUIRED,
        doc="optional: sentences without a checksum are used if all their fields are there",
        choices=(REQUIRED, OPTIONAL),
    )
    quality_9_is_fix: bool = parameter(
        False, doc="a GGA of quality 9 is a fix with SBAS, as some manufacturers define it; otherwise it is not a fix"
    )
    time: str = parameter(
        INSTRUMENT_TIME,
        doc="stamp of attitudes and fixes: the time in the sentences (ZDA, PASHR, GGA) or the arrival; heading and "
        "weather contain no time and are stamped by the arrival",
        choices=(INSTRUMENT_TIME, ARRIVAL_TIME),
    )
    transducers: tuple[str, ...] = parameter(
        (), doc="weather: names of the XDR transducers that measure the air; needed if there are several of a kind"
    )
    silent_after_s: float = parameter(
        3.0, doc="time without a message after which the source is in error", unit="s", minimum=0.1, maximum=3600.0
    )

    @property
    def place(self) -> str:
        """Return the place where the source is received, as text; several sources may share a place."""
        if self.kind == SERIAL:
            return f"{os.path.normpath(self.device)} at {self.baud} Bd"
        return f"{self.kind} {self.address or ANY_ADDRESS}:{self.port}"

    def held_place(self, name: str) -> MachineResource | None:
        """Return the port or device of this machine that the source occupies; None for TCP.

        Args:
            name: name of the source's group of parameters, for example ``sources.gyro``.
        """
        if self.kind == SERIAL:
            return path_resource(f"{name}.device", self.device)
        if self.kind == UDP:
            return port_resource(f"{name}.port", ResourceKind.UDP, self.port, self.address)
        return None


@dataclass(frozen=True)
class NmeaInConfig:
    """All parameters of ``nmea_in``."""

    sources: dict[str, NmeaSourceConfig] = mapping_of("instruments by id")

    def __post_init__(self) -> None:
        """Check the parameters against each other.

        Raises:
            ParameterError: a parameter is invalid or contradicts another parameter.
        """
        if not self.sources:
            raise ParameterError("parameter 'sources' names no source: expected one as 'sources.gyro.kind'", "sources")
        for id_, source in self.sources.items():
            _check_place(f"sources.{id_}", source)
            for talker in source.talkers:
                if not is_talker(talker):
                    raise _error(f"sources.{id_}.talkers", talker, "expected two capital letters, as GP")
        for role in _UNIQUE_ROLES:
            ids = [id_ for id_, source in self.sources.items() if source.becomes == role]
            if len(ids) > 1:
                raise _error(f"sources.{ids[1]}.becomes", role, f"'{ids[0]}' already has this role")
        self._check_shared()
        refuse_conflicts(self.places)

    @property
    def places(self) -> tuple[MachineResource, ...]:
        """Return the ports and devices that the node occupies, each once, with the first source that uses it."""
        held: dict[str, MachineResource | None] = {}
        for id_, source in self.sources.items():
            held.setdefault(source.place, source.held_place(f"sources.{id_}"))
        return tuple(filter(None, held.values()))

    @property
    def interfaces(self) -> dict[str, str]:
        """Dotted name of each ``interface`` parameter that is set → its value, an address of this machine."""
        own = {f"sources.{id_}.interface": source.interface for id_, source in self.sources.items()}
        return {name: address for name, address in own.items() if address}

    def _check_shared(self) -> None:
        """Refuse sources that share a device or a UDP or TCP address with different settings."""
        firsts: dict[str, tuple[str, NmeaSourceConfig]] = {}
        for id_, source in self.sources.items():
            where = os.path.normpath(source.device) if source.kind == SERIAL else source.place
            first_id, first = firsts.setdefault(where, (id_, source))
            if source.kind == SERIAL and source.baud != first.baud:
                reason = f"'{first_id}' reads the same device at {first.baud} Bd"
                raise _error(f"sources.{id_}.baud", source.baud, reason)
            if source.interface != first.interface:
                reason = f"'{first_id}' receives the same by {first.interface or 'the default one'}; only one is opened"
                raise _error(f"sources.{id_}.interface", source.interface, reason)

    def role(self, id_: str) -> InstrumentRole:
        """Return the role of a source: the kind of messages made from its lines."""
        source = self.sources[id_]
        has_receiver = any(other.becomes == GNSS for other in self.sources.values())
        by_instrument = source.time == INSTRUMENT_TIME
        return InstrumentRole(
            source.becomes,
            by_instrument,
            frozenset(source.transducers),
            has_fix=not has_receiver,
            quality_9_is_fix=source.quality_9_is_fix,
        )


def _check_place(name: str, source: NmeaSourceConfig) -> None:
    given = {
        "address": source.address, "port": source.port, "interface": source.interface, "from": source.from_,
        "device": source.device,
    }  # fmt: skip
    for key, value in given.items():
        means = _PARAMETERS_OF_KIND[source.kind]
        if value and key not in means:
            raise _error(f"{name}.{key}", value, f"does not apply to kind {source.kind}, only {', '.join(means)}")
    if source.interface and not is_ipv4(source.interface):
        raise _error(f"{name}.interface", source.interface, "expected an IPv4 address of this machine")
    for address in source.from_:
        if not is_ipv4(address):
            raise _error(f"{name}.from", address, "expected IPv4 addresses, for example 10.0.0.7")
    if source.kind == SERIAL and not source.device:
        raise _error(f"{name}.device", "", "a serial source needs one, as /dev/ttyUSB0")
    if source.kind != SERIAL and not source.port:
        raise _error(f"{name}.port", source.port, f"a source of kind {source.kind} needs one, from 1 to 65535")
    if source.kind == TCP and not source.address:
        raise _error(f"{name}.address", "", "a source of kind tcp needs the server's name or address")


def _error(name: str, value: object, reason: str) -> ParameterError:
    return ParameterError(f"parameter '{name}' = {value!r}: {reason}", name, value=value)

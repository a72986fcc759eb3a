"""The parameters of ``nmea_in``: the sources, where each is heard and what its sentences become."""

import os.path
from dataclasses import dataclass

from ship_bags.nmea.instrument import GNSS, GYRO, INS, INSTRUMENT_TIME, REFERENCE, WEATHER, InstrumentRole
from ship_bags.nmea.lines import OPTIONAL, REQUIRED, is_talker
from ship_estimation.parameter_fields import mapping_of, parameter
from ship_estimation.parameters import ParameterError
from ship_node.parameters.places import (
    ANY_ADDRESS,
    HeldPlace,
    PlaceKind,
    held_path,
    held_port,
    is_ipv4,
    refuse_clashes,
)

UDP, TCP, SERIAL = "udp", "tcp", "serial"
ARRIVAL_TIME = "arrival"

_MEANT = {UDP: ("address", "port", "interface", "from"), TCP: ("address", "port"), SERIAL: ("device", "baud")}
"""Of the parameters that say where a source is heard those that mean something to its kind."""

_ALONE = (INS, GNSS, WEATHER)
"""Roles whose topics have no name of the source in theirs, so that two sources would be mixed on them."""


@dataclass(frozen=True)
class NmeaSourceConfig:
    """One instrument: where its sentences are heard, and what becomes of them."""

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
        0, doc="of udp and tcp; sources with the same place share it", minimum=0, maximum=65535
    )
    interface: str = parameter(
        "", doc="udp of a group: own IPv4 address of the network to use; empty for the default"
    )
    from_: tuple[str, ...] = parameter(
        (),
        doc="udp: IPv4 addresses of which datagrams are used; empty: those of the first sender, until it is silent for "
        "10 s",
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
        False, doc="a GGA of quality 9 is a fix with SBAS, as some makers mean it; otherwise it is no fix"
    )
    time: str = parameter(
        INSTRUMENT_TIME,
        doc="what stamps attitudes and fixes: the time in the sentences (ZDA, PASHR, GGA) or the arrival; heading and "
        "weather carry none and are stamped by the arrival",
        choices=(INSTRUMENT_TIME, ARRIVAL_TIME),
    )
    transducers: tuple[str, ...] = parameter(
        (), doc="weather: names of the transducers of XDR that are the air's; needed where there are several of a kind"
    )
    silent_after_s: float = parameter(
        3.0, doc="without a message of it for this long the source is an error", unit="s", minimum=0.1, maximum=3600.0
    )

    @property
    def place(self) -> str:
        """Where the source is heard, for people; sources of one place share it."""
        if self.kind == SERIAL:
            return f"{os.path.normpath(self.device)} at {self.baud} Bd"
        return f"{self.kind} {self.address or ANY_ADDRESS}:{self.port}"

    def held(self, name: str) -> HeldPlace | None:
        """What it holds of this machine, if anything.

        Args:
            name: of the source's group of parameters, as ``sources.gyro``.
        """
        if self.kind == SERIAL:
            return held_path(f"{name}.device", self.device)
        if self.kind == UDP:
            return held_port(f"{name}.port", PlaceKind.UDP, self.port, self.address)
        return None


@dataclass(frozen=True)
class NmeaInConfig:
    """All parameters of ``nmea_in``."""

    sources: dict[str, NmeaSourceConfig] = mapping_of("instruments by id")

    def __post_init__(self) -> None:
        """Check what belongs together.

        Raises:
            ParameterError: names the parameter.
        """
        if not self.sources:
            raise ParameterError("parameter 'sources' names no source: expected one as 'sources.gyro.kind'", "sources")
        for id_, source in self.sources.items():
            _check_place(f"sources.{id_}", source)
            for talker in source.talkers:
                if not is_talker(talker):
                    raise _error(f"sources.{id_}.talkers", talker, "expected two capital letters, as GP")
        for role in _ALONE:
            ids = [id_ for id_, source in self.sources.items() if source.becomes == role]
            if len(ids) > 1:
                raise _error(f"sources.{ids[1]}.becomes", role, f"'{ids[0]}' becomes that already")
        self._check_shared()
        refuse_clashes(self.places)

    @property
    def places(self) -> tuple[HeldPlace, ...]:
        """What the node holds of this machine; what sources share it holds once, by the first of them."""
        held: dict[str, HeldPlace | None] = {}
        for id_, source in self.sources.items():
            held.setdefault(source.place, source.held(f"sources.{id_}"))
        return tuple(filter(None, held.values()))

    @property
    def interfaces(self) -> dict[str, str]:
        """Dotted name of a parameter → the own address that it names beside a port's."""
        own = {f"sources.{id_}.interface": source.interface for id_, source in self.sources.items()}
        return {name: address for name, address in own.items() if address}

    def _check_shared(self) -> None:
        """Refuse sources that share a device or a group and would have it opened differently."""
        firsts: dict[str, tuple[str, NmeaSourceConfig]] = {}
        for id_, source in self.sources.items():
            where = os.path.normpath(source.device) if source.kind == SERIAL else source.place
            first_id, first = firsts.setdefault(where, (id_, source))
            if source.kind == SERIAL and source.baud != first.baud:
                reason = f"'{first_id}' reads the same device at {first.baud} Bd"
                raise _error(f"sources.{id_}.baud", source.baud, reason)
            if source.interface != first.interface:
                reason = f"'{first_id}' hears the same by {first.interface or 'the default one'}, and one is opened"
                raise _error(f"sources.{id_}.interface", source.interface, reason)

    def role(self, id_: str) -> InstrumentRole:
        """What the lines of a source become."""
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
        means = _MEANT[source.kind]
        if value and key not in means:
            raise _error(f"{name}.{key}", value, f"means nothing to kind {source.kind}, which takes {', '.join(means)}")
    if source.interface and not is_ipv4(source.interface):
        raise _error(f"{name}.interface", source.interface, "expected an IPv4 address of this machine")
    for address in source.from_:
        if not is_ipv4(address):
            raise _error(f"{name}.from", address, "expected IPv4 addresses, as 10.0.0.7")
    if source.kind == SERIAL and not source.device:
        raise _error(f"{name}.device", "", "a serial source needs one, as /dev/ttyUSB0")
    if source.kind != SERIAL and not source.port:
        raise _error(f"{name}.port", source.port, f"a source of kind {source.kind} needs one, from 1 to 65535")
    if source.kind == TCP and not source.address:
        raise _error(f"{name}.address", "", "a source of kind tcp needs the server's name or address")


def _error(name: str, value: object, reason: str) -> ParameterError:
    return ParameterError(f"parameter '{name}' = {value!r}: {reason}", name, value=value)

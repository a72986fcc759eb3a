"""``nmea_in``: receive instruments' sentences and publish their values."""

import threading
import time
from collections.abc import Iterator, Sequence

from ship_bags.errors import BadInput
from ship_bags.nmea.instrument_lines import REQUIRED, parse_line
from ship_nmea.connections import permanent_error
from ship_nmea.instruments.config import SERIAL, UDP, NmeaInConfig
from ship_nmea.instruments.links import LinkReader, make_link
from ship_nmea.instruments.source import Source
from ship_nmea.nmea_node import NmeaNode, run_nmea_node
from ship_node.messages.common_messages import DiagnosticStatus
from ship_node.messages.inputs_outputs import OutputTopic

NAME = "nmea_in"

_DESCRIPTION = """\
Receives instruments' sentences (NMEA 0183) on UDP ports, TCP servers and serial devices, and publishes ins/imu,
reference/<id>/imu, gnss/fix, met/pressure, met/temperature and met/humidity, with the parser of import_nmea.

It reads PSXN 20 and 23, PRDID and PTNTHPR with ZDA, PASHR, PSAT,HPR, GGA, HDT, THS, ROT, XDR, MDA and MET. Sentences
that cannot be used are counted by reason in /diagnostics, with an example for each source; so are datagrams of a sender
other than the first, or not listed in from. A lost source is reported there and opened again.
"""

_LINES_PER_TURN = 50
"""Number of lines of a link processed before the next link, so that a flood on one link delays no other link."""
_IDLE_S = 0.5
_PARAMETER_NAMES = {UDP: ("port", "address"), SERIAL: ("device", "baud")}
"""Parameters named in a permanent error (:func:`ship_nmea.connections.permanent_error`).

TCP has no entry, because the cause of a TCP failure is the other side."""
_JOIN_TIMEOUT_S = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``nmea_in``; return the exit code."""
    return run_nmea_node(NAME, _DESCRIPTION, NmeaInConfig, NmeaIn, arguments)


class NmeaIn:
    """Work of the node, with a reading thread for each link and one publishing thread.

    Raises:
        InputError: no link can be opened until the user acts, for example because the ports are in use.
    """

    def __init__(self, runtime: NmeaNode) -> None:
        config: NmeaInConfig = runtime.config
        self._guard = runtime.guard
        self._lines_came, self._stop = threading.Event(), threading.Event()
        self._sources: dict[str, list[Source]] = {}
        self._publishers = {}
        for id_, source_config in config.sources.items():
            source = Source(id_, source_config, config.role(id_), runtime.factory, time.monotonic_ns())
            self._sources.setdefault(source_config.place, []).append(source)
            for topic, type_name in source.topics.items():
                self._publishers[topic] = runtime.publisher(OutputTopic(topic, type_name))
        self._readers = {
            place: LinkReader(make_link(sources[0].config), runtime.clock.now_ns, self._lines_came.set)
            for place, sources in self._sources.items()
        }
        runtime.require_one_open(list(self._opening_errors()), len(self._readers))
        for reader in self._readers.values():
            reader.start()
        self._publishing = threading.Thread(target=self._publish_until_stopped, daemon=True)
        self._publishing.start()

    def statuses(self) -> Iterator[DiagnosticStatus]:
        """Yield the status of each source."""
        now_ns = time.monotonic_ns()
        for place, reader in self._readers.items():
            for source in self._sources[place]:
                yield source.status(reader.problem, reader.dropped, now_ns)

    def close(self) -> None:
        """See :class:`ship_nmea.nmea_node.Work`."""
        self._stop.set()
        self._lines_came.set()
        self._publishing.join(_JOIN_TIMEOUT_S)
        for reader in self._readers.values():
            reader.stop()
        for reader in self._readers.values():
            reader.wait_for_end()

    def _opening_errors(self) -> Iterator[BadInput]:
        """Yield an error for each link that cannot be opened until the user acts."""
        for place, reader in self._readers.items():
            source = self._sources[place][0]
            error = reader.failure and permanent_error(
                reader.failure, f"sources.{source.id}", source.config, _PARAMETER_NAMES
            )
            if error:
                yield error

    def _publish_until_stopped(self) -> None:
        while not self._stop.is_set():
            self._lines_came.wait(_IDLE_S)
            self._lines_came.clear()
            count = 1
            while count and not self._stop.is_set():
                count = sum(self._publish_some(place) for place in self._readers)

    def _publish_some(self, place: str) -> int:
        """Publish the values of some lines of a link; return the number of lines."""
        lines = self._readers[place].take_lines(_LINES_PER_TURN)
        for arrival_ns, line, sender in lines:
            self._guard.call(place, self._publish_line, place, arrival_ns, line, sender)
        return len(lines)

    def _publish_line(self, place: str, arrival_ns: int, line: bytes, sender: str) -> None:
        now_ns = time.monotonic_ns()
        for source in self._sources[place]:
            for received in parse_line(line, source.config.checksum == REQUIRED):
                for topic, message in source.convert(received, arrival_ns, now_ns, sender):
                    self._publishers[topic].publish(message)

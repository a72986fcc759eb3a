"""Links to instruments: a UDP port, a TCP server or a serial device, each read by a separate thread.

A lost link is reopened for as long as the node runs. The arrival time of a line is the node's time at which the end of
the line was read. A sentence cut at the end of a datagram is joined with the next datagram of the same sender.
"""

import contextlib
import re
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from ship_nmea.connections import LineSplitter, error_text, open_serial
from ship_nmea.instruments.config import SERIAL, UDP, NmeaSourceConfig
from ship_node.parameters.machine_resources import ANY_ADDRESS, is_multicast

JOIN_TIMEOUT_NS = 200_000_000
"""Maximum wait for the rest of a cut sentence, ns."""

_MAX_INCOMPLETE = 100
"""Maximum number of senders with a cut sentence in memory: a bound in case of forged addresses."""
_CUT_SENTENCE = re.compile(rb".*[$!](?!.*\*[0-9A-Fa-f]{2}\s*$)[^$!]*", re.DOTALL)
"""Pattern of a text that ends within a sentence, before the end of its checksum."""

RETRY_S = 1.0
MAX_QUEUED_LINES = 1000
"""Maximum number of queued lines of a link. If more arrive, the oldest lines are dropped."""

_READ_TIMEOUT_S = 0.2
_CONNECT_TIMEOUT_S = 2.0
_JOIN_TIMEOUT_S = 0.5
_MAX_READ_BYTES = 65536
_RECEIVE_BUFFER = 1 << 20
_SO_RXQ_OVFL = 40
"""Linux socket option that adds to each datagram the number of dropped datagrams. Python has no name for it."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(64)
_KEEPALIVE = {"TCP_KEEPIDLE": 3, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}
"""TCP keep-alive: an idle connection is probed after 3 s and, without an answer, closed 3 s later."""


class DatagramLines:
    """Joins the lines of datagrams, separately for each sender."""

    def __init__(self) -> None:
        self._incomplete: dict[str, tuple[int, int, bytes]] = {}

    def split(self, data: bytes, sender: str, arrival_ns: int, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return arrival, line and sender of the complete lines, and of cut lines whose rest has not arrived in time.

        Args:
            data: data of the datagram; empty if no datagram arrived.
            sender: sender of the datagram.
            arrival_ns: arrival time of the datagram, by the node's clock.
            now_ns: steady time.
        """
        lines = self._timed_out_lines(now_ns)
        if not data:
            return lines
        *_, first_part = self._incomplete.pop(sender, (0, 0, b""))
        splitter = LineSplitter()
        lines += [(arrival_ns, line, sender) for line in splitter.split(first_part + data)]
        for rest in splitter.flush():
            if _CUT_SENTENCE.fullmatch(rest) and len(self._incomplete) < _MAX_INCOMPLETE:
                self._incomplete[sender] = now_ns, arrival_ns, rest
            else:
                lines.append((arrival_ns, rest, sender))
        return lines

    def _timed_out_lines(self, now_ns: int) -> list[tuple[int, bytes, str]]:
        """Return the cut sentences whose rest has not arrived in time."""
        late = [sender for sender, (since_ns, _, _) in self._incomplete.items() if now_ns - since_ns > JOIN_TIMEOUT_NS]
        return [(*self._incomplete.pop(sender)[1:], sender) for sender in late]


class Link(Protocol):
    """Source of bytes; each method may raise OSError.

    Attributes:
        is_stream: True if lines continue from one read to the next.
        opens_at_once: True if opening never blocks.
        dropped_count: number of datagrams that were dropped by the system because they were not read in time.
    """

    is_stream: bool
    opens_at_once: bool
    dropped_count: int

    def open(self) -> None:
        """Open the link."""
        ...

    def read(self) -> tuple[bytes, str]:
        """Return the next bytes (empty after a timeout), and the sender of a datagram; datagrams are returned whole."""
        ...

    def close(self) -> None:
        """Close the link."""
        ...


class UdpLink:
    """Receives datagrams sent to a port of this machine or of a multicast group."""

    is_stream = False
    opens_at_once = True
    dropped_count = 0

    def __init__(self, address: str, port: int, interface: str) -> None:
        self._address, self._port, self._interface = address or ANY_ADDRESS, port, interface or ANY_ADDRESS

    def open(self) -> None:
        """See :class:`Link`."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            self._socket.settimeout(_READ_TIMEOUT_S)
            is_group = is_multicast(self._address)
            if is_group:
                # Every receiver of a group gets each datagram, so other programs may bind the same port.
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((self._address, self._port))
            if is_group:
                member = socket.inet_aton(self._address) + socket.inet_aton(self._interface)
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError:
            self._socket.close()
            raise

    def read(self) -> tuple[bytes, str]:
        """See :class:`Link`."""
        try:
            data, ancillary, _, (address, port) = self._socket.recvmsg(_MAX_READ_BYTES, _ANCILLARY_BYTES)
        except TimeoutError:
            return b"", ""
        for _, kind, value in ancillary:
            if kind == _SO_RXQ_OVFL:
                self.dropped_count = int.from_bytes(value, sys.byteorder)
        return data, f"{address}:{port}"

    def close(self) -> None:
        """See :class:`Link`."""
        self._socket.close()


class TcpLink:
    """Connects to a TCP server and reads the data that it sends."""

    is_stream = True
    opens_at_once = False
    dropped_count = 0

    def __init__(self, address: str, port: int) -> None:
        self._place = address, port

    def open(self) -> None:
        """See :class:`Link`."""
        self._socket = socket.create_connection(self._place, timeout=_CONNECT_TIMEOUT_S)
        self._socket.settimeout(_READ_TIMEOUT_S)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def read(self) -> tuple[bytes, str]:
        """See :class:`Link`."""
        try:
            data = self._socket.recv(_MAX_READ_BYTES)
        except TimeoutError:
            return b"", ""
        if not data:
            raise ConnectionError("the server closed the connection")
        return data, ""

    def close(self) -> None:
        """See :class:`Link`."""
        self._socket.close()


class SerialLink:
    """Reads a serial device."""

    is_stream = True
    opens_at_once = True
    dropped_count = 0

    def __init__(self, device: str, baud: int) -> None:
        self._device, self._baud = device, baud

    def open(self) -> None:
        """See :class:`Link`."""
        self._serial = open_serial(self._device, self._baud, _READ_TIMEOUT_S)

    def read(self) -> tuple[bytes, str]:
        """See :class:`Link`."""
        data: bytes = self._serial.read(max(1, self._serial.in_waiting))
        return data, ""

    def close(self) -> None:
        """See :class:`Link`."""
        self._serial.close()


def make_link(source: NmeaSourceConfig) -> Link:
    """Return a link for a source."""
    if source.kind == SERIAL:
        return SerialLink(source.device, source.baud)
    if source.kind == UDP:
        return UdpLink(source.address, source.port, source.interface)
    return TcpLink(source.address, source.port)


class LinkReader:
    """Reads a link in a separate thread and queues its lines, at most :data:`MAX_QUEUED_LINES`.

    Args:
        link: the link, not opened yet.
        now_ns: returns the node's time, ns.
        on_lines: called when lines have arrived.

    Attributes:
        problem: one line about why the link is not open; empty if it is open.
        failure: exception raised when the constructor tried to open the link; otherwise None.
    """

    def __init__(self, link: Link, now_ns: Callable[[], int], on_lines: Callable[[], None]) -> None:
        self._link, self._is_open = link, False
        self._now_ns, self._on_lines = now_ns, on_lines
        self._lines: deque[tuple[int, bytes, str]] = deque(maxlen=MAX_QUEUED_LINES)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self.problem = "not open yet"
        self.failure: OSError | None = None
        self._overwritten = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        if link.opens_at_once:
            try:
                self._open()
            except OSError as problem:
                self.failure, self.problem = problem, error_text(problem)

    def start(self) -> None:
        """Start reading."""
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of lines dropped from the full queue, plus number of datagrams dropped before they were read."""
        return self._overwritten + self._link.dropped_count

    def take_lines(self, max_count: int) -> list[tuple[int, bytes, str]]:
        """Remove the oldest queued lines; return arrival time, line and sender of each."""
        with self._lock:
            return [self._lines.popleft() for _ in range(min(max_count, len(self._lines)))]

    def stop(self) -> None:
        """Request the thread to end and to close the link."""
        self._stop.set()

    def wait_for_end(self) -> None:
        """Wait up to 0.5 s for the end of the thread.

        A thread that still waits for a host name or a connection ends with the process.
        """
        self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                if not self._is_open:
                    self._open()
                self._read()
            except Exception as problem:
                # A driver may raise anything; opening is retried.
                self.problem = error_text(problem)
            if self._is_open:
                self._is_open = False
                with contextlib.suppress(OSError):
                    self._link.close()
            self._stop.wait(RETRY_S)

    def _open(self) -> None:
        self._link.open()
        self._is_open, self.problem = True, ""

    def _read(self) -> None:
        splitter, datagrams = LineSplitter(), DatagramLines()
        while not self._stop.is_set():
            data, sender = self._link.read()
            now_ns = self._now_ns()
            if self._link.is_stream:
                lines = [(now_ns, line, "") for line in splitter.split(data)]
            else:
                lines = datagrams.split(data, sender, now_ns, time.monotonic_ns())
            if lines:
                self._queue_lines(lines)

    def _queue_lines(self, lines: list[tuple[int, bytes, str]]) -> None:
        with self._lock:
            self._overwritten += max(0, len(self._lines) + len(lines) - MAX_QUEUED_LINES)
            self._lines.extend(lines)
        self._on_lines()

"""Outlets of sinks: UDP datagrams, a TCP server with its clients, a serial line, and a file.

Once a sink has started, only its thread calls ``open``, ``send`` and ``close``. An outlet never blocks, except for a
file on a slow disk. ``send`` either sends a sentence or returns False. Received data is passed on in complete lines. On
failure an outlet raises OSError and is opened again later.
"""

import contextlib
import errno
import os
import selectors
import socket
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path

import serial

from ship_bags.nmea.instrument_lines import LONGEST_LINE
from ship_nmea.connections import LineSplitter, open_serial
from ship_nmea.out.config import FILE, SERIAL, TCP_SERVER, UDP, SinkConfig

RECEIVE_BYTES = 4096
"""Maximum number of bytes per read."""

LineReceiver = Callable[[str, str], None]
"""Function called with a received line and the address of its sender (empty for a serial line)."""

MAX_CLIENTS, MAX_CLIENTS_PER_HOST = 32, 8
"""Maximum number of clients, and of clients of one host, so that one host cannot shut out other hosts."""
CLIENT_TIMEOUT_S = 10.0
"""Time without acknowledgement of sent data after which a client is disconnected, s."""

_MAX_READS = 20
"""Maximum number of reads in a row: a flood of received datagrams must not delay the sentences."""
_SEND_BUFFER_BYTES = 4096
"""Size of the send buffer of a client: small, because data waiting for a slow client are old when they are read."""

_MAX_UNSENT_S = 0.1
"""Maximum transmission time of the unsent data of a serial line, s; with more unsent data, no sentence is accepted."""
_BITS_PER_BYTE = 10


class Outlet(ABC):
    """Destination of a sink.

    Attributes:
        place: kind and address of the destination, as text.
        client_lost_ns: steady time at which a client was last disconnected or refused; None if there was none.

    Args:
        config: configuration of the sink.
        receive: called with each received line and the address of its sender.
    """

    def __init__(self, config: SinkConfig, receive: LineReceiver) -> None:
        self._config, self._receive = config, receive
        self.client_lost_ns: int | None = None
        where = {
            UDP: f"{config.address}:{config.port}",
            TCP_SERVER: f"{config.address or '*'}:{config.port}",
            SERIAL: f"{config.device} at {config.baud} Bd",
            FILE: str(Path(config.path).absolute()),
        }
        self.place = f"{config.kind} {where[config.kind]}"

    @abstractmethod
    def open(self, selector: selectors.BaseSelector) -> None:
        """Open the outlet, and register its events and their handlers with the selector.

        Raises:
            OSError: the outlet cannot be opened now.
        """

    @abstractmethod
    def send(self, sentence: bytes) -> bool:
        """Send a sentence; return False if the caller must try again soon.

        Raises:
            OSError: the outlet is broken.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the outlet; also called after :meth:`open` has failed."""

    def status_note(self) -> str:
        """Return further text for the status of the outlet."""
        return ""


def command_texts(lines: Iterable[bytes]) -> list[str]:
    """Return received lines as texts, without empty lines and lines longer than :data:`LONGEST_LINE`."""
    texts = [line.decode("ascii", errors="replace").strip() for line in lines if len(line) <= LONGEST_LINE]
    return [text for text in texts if text]


class UdpOutlet(Outlet):
    """Sends to one host, to a network (broadcast) or to a group; commands are received at ``listen_port``."""

    _socket: socket.socket | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        config = self._config
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if config.interface:
            own = socket.inet_aton(config.interface)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        if config.listen_port:
            self._socket.bind(("", config.listen_port))
            selector.register(self._socket, selectors.EVENT_READ, self._read)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._socket is not None
        try:
            self._socket.sendto(sentence, (self._config.address, self._config.port))
        except BlockingIOError:
            return False
        except ConnectionRefusedError:
            pass  # error of an earlier sentence: no program receives at the destination now
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._socket is not None:
            self._socket.close()

    def _read(self) -> None:
        assert self._socket is not None
        for _ in range(_MAX_READS):
            try:
                data, (address, _) = self._socket.recvfrom(RECEIVE_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            for line in command_texts(LineSplitter().split(data + b"\n")):
                self._receive(line, address)


class _Client:
    """A connected client, and the part of a sentence that the client has not taken yet."""

    def __init__(self, connection: socket.socket, address: str) -> None:
        self.connection, self.address = connection, address
        self.splitter = LineSplitter()
        self.unsent = b""


class TcpOutlet(Outlet):
    """A server; each client receives as much as it can take, and is disconnected if it acknowledges nothing."""

    def __init__(self, config: SinkConfig, receive: LineReceiver) -> None:
        super().__init__(config, receive)
        self._server: socket.socket | None = None
        self._clients: list[_Client] = []
        self._skipped = self._disconnected = 0
        self._host_limit_note = ""

    def open(self, selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        config = self._config
        self._selector = selector
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.setblocking(False)
        self._server.bind((config.address, config.port))
        self._server.listen()
        selector.register(self._server, selectors.EVENT_READ, self._accept)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`; always True, because clients that are not ready are skipped."""
        for client in list(self._clients):
            if client.unsent:
                self._write(client)
            if client.unsent:
                self._skipped += 1
            else:
                client.unsent = sentence
                self._write(client)
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        for client in list(self._clients):
            self._drop(client)
        if self._server is not None:
            self._server.close()

    def status_note(self) -> str:
        """See :meth:`Outlet.status_note`."""
        text = f"{len(self._clients)} clients"
        if self._skipped:
            text += f", {self._skipped} sentences skipped for clients that did not read"
        if self._disconnected:
            text += f", {self._disconnected} clients disconnected{self._host_limit_note}"
        return text

    def _accept(self) -> None:
        assert self._server is not None
        try:
            connection, (address, _) = self._server.accept()
        except OSError:
            return  # connection closed again, or too many open files: the listening socket itself still works
        of_host = sum(client.address == address for client in self._clients)
        if len(self._clients) >= MAX_CLIENTS or of_host >= MAX_CLIENTS_PER_HOST:
            connection.close()
            self._count_disconnection()
            if of_host >= MAX_CLIENTS_PER_HOST:
                self._host_limit_note = f", {address} has {MAX_CLIENTS_PER_HOST} connections, the maximum per host"
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        # At a low rate the send buffer takes minutes to fill; the system detects missing acknowledgements earlier.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * CLIENT_TIMEOUT_S))
        client = _Client(connection, address)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._read(client))

    def _count_disconnection(self) -> None:
        self._disconnected += 1
        self.client_lost_ns = time.monotonic_ns()

    def _write(self, client: _Client) -> None:
        try:
            count = client.connection.send(client.unsent)
        except BlockingIOError:
            return
        except OSError as problem:
            self._drop(client, problem)
            return
        client.unsent = client.unsent[count:]

    def _read(self, client: _Client) -> None:
        try:
            data = client.connection.recv(RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError as problem:
            self._drop(client, problem)
            return
        if not data:
            self._drop(client)
            return
        for line in command_texts(client.splitter.split(data)):
            self._receive(line, client.address)

    def _drop(self, client: _Client, problem: OSError | None = None) -> None:
        if client in self._clients:
            if isinstance(problem, TimeoutError):
                self._count_disconnection()
            self._clients.remove(client)
            self._selector.unregister(client.connection)
            client.connection.close()


class SerialOutlet(Outlet):
    """A serial line; it accepts the next sentence when the previous sentence is nearly sent."""

    _port: serial.Serial | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        config = self._config
        self._splitter = LineSplitter()
        self._unsent = b""
        self._port = open_serial(config.device, config.baud, wait_s=0.0)
        selector.register(self._port.fileno(), selectors.EVENT_READ, self._read)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._port is not None
        if self._unsent:
            self._write()
        if self._unsent or self._port.out_waiting > self._config.baud / _BITS_PER_BYTE * _MAX_UNSENT_S:
            return False
        self._unsent = sentence
        self._write()
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._port is not None:
            # Closing would wait for unsent data of a lost line.
            with contextlib.suppress(OSError, termios.error):
                self._port.reset_output_buffer()
            with contextlib.suppress(OSError, termios.error):
                self._port.close()
            self._port = None

    def _write(self) -> None:
        assert self._port is not None
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._port.fileno(), self._unsent) :]

    def _read(self) -> None:
        assert self._port is not None
        data = os.read(self._port.fileno(), RECEIVE_BYTES)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        for line in command_texts(self._splitter.split(data)):
            self._receive(line, "")


class FileOutlet(Outlet):
    """A file to which whole sentences are appended."""

    _file: int | None = None

    def open(self, _selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        # Opening a pipe without O_NONBLOCK would wait for a reader.
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
        self._file = os.open(self._config.path, flags, 0o644)
        os.set_blocking(self._file, True)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._file is not None
        written = os.write(self._file, sentence)
        if written < len(sentence):
            # The disk is full: an incomplete sentence would precede the next sentence.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, os.fstat(self._file).st_size - written)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = None

"""Ways out of the machine, each worked by the thread of its sink alone: UDP, TCP server, serial line, file.

An outlet never waits, but for a file, whose disk may. It takes a sentence or says that it cannot now. What it hears
comes as whole lines. Where it fails it raises OSError, and is opened anew later.
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

from ship_nmea.line_splitter import LONGEST_LINE, LineSplitter
from ship_nmea.out.config import FILE, SERIAL, TCP_SERVER, UDP, SinkConfig
from ship_nmea.places import opened_serial

MOST_CLIENTS = 32
STALLED_S = 10.0
"""A client that takes nothing for so long is sent away, s."""

_RECEIVE_BYTES = 4096
_MOST_READ = 20
"""So many reads in one go: a flood of one client must not hold up the sentences."""
_SEND_BUFFER_BYTES = 4096
"""What waits in the kernel for a client that reads slowly is old when it reads it."""
_UNSENT_S = 0.1
"""A serial line takes the next sentence when what it has still to send takes no longer, s."""
_BITS_PER_BYTE = 10

Heard = Callable[[str], None]


class Outlet(ABC):
    """A way out.

    Attributes:
        place: what it is for people.
        lost_ns: when it last lost one of those who listen, by the steady clock; None if never.

    Args:
        config: of its sink.
        hear: takes each line that comes in.
    """

    def __init__(self, config: SinkConfig, hear: Heard) -> None:
        self._config, self._hear = config, hear
        self.lost_ns: int | None = None
        where = {
            UDP: f"{config.address}:{config.port}",
            TCP_SERVER: f"{config.address or '*'}:{config.port}",
            SERIAL: f"{config.device} at {config.baud} Bd",
            FILE: str(Path(config.path).absolute()),
        }
        self.place = f"{config.kind} {where[config.kind]}"

    @abstractmethod
    def open(self, selector: selectors.BaseSelector) -> None:
        """Open it; what it waits for is registered with a function to call.

        Raises:
            OSError: it cannot be opened now.
        """

    @abstractmethod
    def send(self, sentence: bytes) -> bool:
        """Whether it took a sentence; if not, it is to be offered again soon.

        Raises:
            OSError: the outlet is broken.
        """

    @abstractmethod
    def close(self) -> None:
        """Give it back; also where it could not be opened."""

    def note(self) -> str:
        """What else is to be said of it."""
        return ""


def command_texts(lines: Iterable[bytes]) -> list[str]:
    """Lines that came in as texts; one that was longer than a sentence can be is left out."""
    texts = [line.decode("ascii", errors="replace").strip() for line in lines if len(line) <= LONGEST_LINE]
    return [text for text in texts if text]


class UdpOutlet(Outlet):
    """To one host, to all of a network, or to a group; commands come to ``listen_port``."""

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
            pass  # of an earlier sentence: nobody listens there, now
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._socket is not None:
            self._socket.close()

    def _read(self) -> None:
        assert self._socket is not None
        for _ in range(_MOST_READ):
            try:
                data = self._socket.recv(_RECEIVE_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            for line in command_texts(LineSplitter().take(data + b"\n")):
                self._hear(line)


class _Client:
    """One who listens: what it has not taken yet of a sentence, and since when."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.splitter = LineSplitter()
        self.unsent = b""
        self.took_s = time.monotonic()


class TcpOutlet(Outlet):
    """A server; each client gets what it can take, and who takes nothing is sent away."""

    def __init__(self, config: SinkConfig, hear: Heard) -> None:
        super().__init__(config, hear)
        self._server: socket.socket | None = None
        self._clients: list[_Client] = []
        self._skipped = self._sent_away = 0

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
        """See :meth:`Outlet.send`; it takes everything, and skips the clients that do not."""
        for client in list(self._clients):
            if client.unsent:
                self._give(client)
            if client.unsent:
                self._skipped += 1
                if time.monotonic() - client.took_s > STALLED_S:
                    self._send_away()
                    self._drop(client)
            else:
                client.unsent = sentence
                self._give(client)
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        for client in list(self._clients):
            self._drop(client)
        if self._server is not None:
            self._server.close()

    def note(self) -> str:
        """See :meth:`Outlet.note`."""
        text = f"{len(self._clients)} clients"
        if self._skipped:
            text += f", {self._skipped} sentences skipped for clients that did not read"
        return text + (f", {self._sent_away} clients sent away" if self._sent_away else "")

    def _accept(self) -> None:
        assert self._server is not None
        try:
            connection, _ = self._server.accept()
        except OSError:
            return  # gone again, or too many files are open: the listener itself is well
        if len(self._clients) >= MOST_CLIENTS:
            connection.close()
            self._send_away()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        client = _Client(connection)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._read(client))

    def _send_away(self) -> None:
        self._sent_away += 1
        self.lost_ns = time.monotonic_ns()

    def _give(self, client: _Client) -> None:
        try:
            count = client.connection.send(client.unsent)
        except BlockingIOError:
            return
        except OSError:
            self._drop(client)
            return
        client.unsent = client.unsent[count:]
        client.took_s = time.monotonic()

    def _read(self, client: _Client) -> None:
        try:
            data = client.connection.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        for line in command_texts(client.splitter.take(data)):
            self._hear(line)

    def _drop(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.connection)
            client.connection.close()


class SerialOutlet(Outlet):
    """A serial line; it is told the next sentence only when it has nearly sent the one before."""

    _port: serial.Serial | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        config = self._config
        self._splitter = LineSplitter()
        self._unsent = b""
        self._port = opened_serial(config.device, config.baud, wait_s=0.0)
        selector.register(self._port.fileno(), selectors.EVENT_READ, self._read)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._port is not None
        if self._unsent:
            self._give()
        if self._unsent or self._port.out_waiting > self._config.baud / _BITS_PER_BYTE * _UNSENT_S:
            return False
        self._unsent = sentence
        self._give()
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._port is not None:
            # What is not sent of a line that is gone would be waited for.
            with contextlib.suppress(OSError, termios.error):
                self._port.reset_output_buffer()
            with contextlib.suppress(OSError, termios.error):
                self._port.close()
            self._port = None

    def _give(self) -> None:
        assert self._port is not None
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._port.fileno(), self._unsent) :]

    def _read(self) -> None:
        assert self._port is not None
        data = os.read(self._port.fileno(), _RECEIVE_BYTES)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        for line in command_texts(self._splitter.take(data)):
            self._hear(line)


class FileOutlet(Outlet):
    """A file that is appended to, whole sentences at a time."""

    _file: int | None = None

    def open(self, _selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        self._file = os.open(self._config.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._file is not None
        written = os.write(self._file, sentence)
        if written < len(sentence):
            # Of a full disk: what was begun would stand before the next sentence.
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


OUTLETS: dict[str, type[Outlet]] = {UDP: UdpOutlet, TCP_SERVER: TcpOutlet, SERIAL: SerialOutlet, FILE: FileOutlet}
"""Kind of a sink → its way out."""

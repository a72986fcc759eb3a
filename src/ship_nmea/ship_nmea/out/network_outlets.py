"""Outlets to the network: UDP datagrams, and a TCP server with its clients."""

import selectors
import socket
import time

from ship_nmea.line_splitter import LineSplitter
from ship_nmea.out.config import SinkConfig
from ship_nmea.out.outlet import RECEIVE_BYTES, LineReceiver, Outlet, command_texts

MAX_CLIENTS, MAX_CLIENTS_PER_HOST = 32, 8
"""Maximum number of clients, and of clients of one host, so that one host cannot shut out other hosts."""
CLIENT_TIMEOUT_S = 10.0
"""Time without acknowledgement of sent data after which a client is disconnected, s."""

_MAX_READS = 20
"""Maximum number of reads in a row: a flood of received datagrams must not delay the sentences."""
_SEND_BUFFER_BYTES = 4096
"""Size of the send buffer of a client: small, because data waiting for a slow client are old when they are read."""


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
        return text + (
            f", {self._disconnected} clients disconnected{self._host_limit_note}" if self._disconnected else ""
        )

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

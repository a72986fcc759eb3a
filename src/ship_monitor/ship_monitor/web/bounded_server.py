"""HTTP server with bounded connections, waiting times and memory, and the list of its allowed names and addresses.

A request with another Host or Origin is refused. A page of another site in a browser on this machine may have a name
that resolves to this server (DNS rebinding). The requests of this page contain its name, which is not in the list.
"""

import errno
import logging
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.iostream import IOStream
from tornado.netutil import bind_sockets

from ship_bags.errors import BadInput

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})


MAX_CONNECTIONS = 256
"""Maximum number of open connections, without websockets. Further connections are closed."""

REQUEST_TIMEOUT_S = 10.0
"""Time in which a client must have sent its request, s."""

MAX_BODY_BYTES = 65_536
"""Maximum size of a request body, bytes."""

MAX_MESSAGE_BYTES = 1_000_000
"""Maximum size of a websocket message, bytes."""

_LOG_PERIOD_S = 10.0


class OwnHosts:
    """Names of this machine, and names allowed by the user.

    Args:
        address: address of the server. The machine's host name is allowed unless ``address`` is a loopback address.
        allowed: further names or addresses.
    """

    def __init__(self, address: str, allowed: Sequence[str] = ()) -> None:
        machine = _normalised_host(socket.gethostname())
        own = set() if address in LOOPBACK else {machine, f"{machine}.local"}
        self._names = LOOPBACK | own | {_normalised_host(name) for name in allowed}

    def is_own_host(self, request: HTTPServerRequest) -> bool:
        """True if the Host of a request is in the list, or is the address at which the request arrived."""
        return self.is_own_origin(f"//{request.host}", request)

    def is_own_origin(self, origin: str, request: HTTPServerRequest) -> bool:
        """True if the host of an Origin is in the list, on any port, or is the address at which the request arrived."""
        name = host_of(origin)
        return name in self._names or name == _local_address(request)


def host_of(address: str) -> str | None:
    """Return the host in an address, without port, in lower case; None if the address has no host."""
    try:
        name = urlsplit(address).hostname
    except ValueError:
        return None
    return None if name is None else _normalised_host(name)


def _normalised_host(name: str) -> str:
    return name.strip("[]").rstrip(".").lower()


def _local_address(request: HTTPServerRequest) -> str | None:
    """Return the address of this machine at which a request arrived; None if unknown."""
    stream = getattr(request.connection, "stream", None)
    if stream is None or stream.socket is None:
        return None
    address = str(stream.socket.getsockname()[0])
    return address.partition("%")[0].removeprefix("::ffff:").lower()


class BoundedServer(HTTPServer):
    """Serves a tornado application; connections beyond the maximum are closed, with one line in the log."""

    def initialize(self, application: Any) -> None:  # type: ignore[override]
        """Initialise the server; called by the constructor with its arguments."""
        super().initialize(
            application,
            idle_connection_timeout=REQUEST_TIMEOUT_S,
            body_timeout=REQUEST_TIMEOUT_S,
            max_body_size=MAX_BODY_BYTES,
            max_buffer_size=2 * MAX_MESSAGE_BYTES,
        )
        self._count = 0
        limit_log_rate()

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection; close it if there are too many."""
        if self._count >= MAX_CONNECTIONS:
            text = "%s: connection closed: %d are open, the maximum"
            logging.getLogger("tornado.general").warning(text, address[0], self._count)
            stream.close()
            return
        self._count += 1
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """Reduce the count by a connection that has ended or has become a websocket."""
        self._count -= 1
        super().on_close(server_conn)


def listening_sockets(host: str, port: int, option: str) -> list[socket.socket]:
    """Return sockets bound to an address.

    Args:
        host: address to listen on.
        port: TCP port; 0 for a free port.
        option: command line option for the port, for the error text.

    Raises:
        BadInput: the port is in use, or the system does not allow to listen on the address and port.
    """
    try:
        return bind_sockets(port, host)
    except OSError as problem:
        if problem.errno == errno.EADDRINUSE:
            raise BadInput(f"port {port} of {host} is in use: choose another one with {option}") from problem
        raise BadInput(f"cannot listen on {host}, port {port}: {problem.strerror}") from problem


def address_in_url(host: str) -> str:
    """Return a host as in a URL: an IPv6 address is in brackets."""
    return f"[{host}]" if ":" in host else host


class _RateLimitFilter(logging.Filter):
    """Log filter that passes one line of each kind every ten seconds, so that repeated requests do not fill the log."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[tuple[Any, ...], float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """True if the line is written."""
        arguments = record.args if isinstance(record.args, tuple) else ()
        # The kind includes the status of an answer; all other arguments come from the client.
        kind = (record.msg if arguments else record.name, *(each for each in arguments[:1] if isinstance(each, int)))
        now_s = time.monotonic()
        if now_s - self._last_s.get(kind, -_LOG_PERIOD_S) < _LOG_PERIOD_S:
            return False
        self._last_s[kind] = now_s
        return True


def limit_log_rate() -> None:
    """Make tornado log refused and malformed requests, one line of each kind in ten seconds."""
    for name, level in (("tornado.access", logging.WARNING), ("tornado.general", logging.INFO)):
        logger = logging.getLogger(name)
        if not any(isinstance(each, _RateLimitFilter) for each in logger.filters):
            handler = logging.StreamHandler(sys.stderr)
            handler.setFormatter(logging.Formatter("monitor: %(message)s"))
            logger.addHandler(handler)
            logger.addFilter(_RateLimitFilter())
            logger.propagate = False
            logger.setLevel(level)

"""An HTTP server whose connections, waiting times and memory are bounded, whatever is sent to it."""

import errno
import logging
import socket
import sys
import time
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.netutil import bind_sockets

from ship_bags.errors import BadInput

MOST_CONNECTIONS = 256
"""Connections that are open at once, websockets not counted. The next one is closed."""

REQUEST_S = 10.0
"""Time that a connection has to send a request, s."""

MOST_BODY_BYTES = 65_536
MOST_MESSAGE_BYTES = 1_000_000
"""Size of a message on a websocket."""

_LINE_PERIOD_S = 10.0


class BoundedServer(HTTPServer):
    """Serves an application of tornado; what is beyond its bounds is closed, with one line in the log."""

    def initialize(self, application: Any) -> None:  # type: ignore[override]
        """Called by the constructor, with its arguments."""
        super().initialize(
            application,
            idle_connection_timeout=REQUEST_S,
            body_timeout=REQUEST_S,
            max_body_size=MOST_BODY_BYTES,
            max_buffer_size=2 * MOST_MESSAGE_BYTES,
        )
        self._count = 0
        log_sparsely()

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection, or close it where there are too many."""
        if self._count >= MOST_CONNECTIONS:
            text = "%s: connection closed: %d are open, the most that are served"
            logging.getLogger("tornado.general").warning(text, address[0], self._count)
            stream.close()
            return
        self._count += 1
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """Called when a connection has ended or has become a websocket."""
        self._count -= 1
        super().on_close(server_conn)


def listening_sockets(host: str, port: int, option: str) -> list[socket.socket]:
    """Bind an address.

    Args:
        host: address to listen on.
        port: TCP port; 0 takes any.
        option: that gives another port, as the user writes it.

    Raises:
        BadInput: the port is in use, or the address is not one of this machine.
    """
    try:
        return bind_sockets(port, host)
    except OSError as problem:
        if problem.errno == errno.EADDRINUSE:
            raise BadInput(f"port {port} of {host} is in use: give another one with {option}") from problem
        raise BadInput(f"cannot listen on {host}, port {port}: {problem.strerror}") from problem


def address_in_url(host: str) -> str:
    """Return a host as it stands in a URL: an address of IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


class _Sparse(logging.Filter):
    """Passes one line of each kind in ten seconds: who asks a thousand times does not fill the log."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[tuple[Any, ...], float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """True if the line is written."""
        arguments = record.args if isinstance(record.args, tuple) else ()
        # The status of an answer; everything else that varies is named by whoever asks.
        kind = (record.msg if arguments else record.name, *(each for each in arguments[:1] if isinstance(each, int)))
        now_s = time.monotonic()
        if now_s - self._last_s.get(kind, -_LINE_PERIOD_S) < _LINE_PERIOD_S:
            return False
        self._last_s[kind] = now_s
        return True


def log_sparsely() -> None:
    """Let tornado log refused requests, malformed ones too, one line of each kind in ten seconds."""
    for name, level in (("tornado.access", logging.WARNING), ("tornado.general", logging.INFO)):
        logger = logging.getLogger(name)
        if not any(isinstance(each, _Sparse) for each in logger.filters):
            handler = logging.StreamHandler(sys.stderr)
            handler.setFormatter(logging.Formatter("monitor: %(message)s"))
            logger.addHandler(handler)
            logger.addFilter(_Sparse())
            logger.propagate = False
            logger.setLevel(level)

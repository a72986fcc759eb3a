"""Server of the page: Bokeh on one address and port. All scripts, styles and fonts come from this server."""

import gc
import logging
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urlsplit

import matplotlib
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.ws import WSHandler
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.web import RequestHandler, StaticFileHandler

from ship_monitor.themes import THEMES
from ship_monitor.web.bounded_server import (
    MAX_MESSAGE_BYTES,
    BoundedServer,
    OwnHosts,
    address_in_url,
    listening_sockets,
)

TICK_MS = 250
"""Period of the server's tick."""

MAX_PAGES = 32
"""Maximum number of open pages: closing so many pages at once delays other pages by a second."""

_PAGES = "/", "/autoload.js"
"""Paths at which Bokeh makes a document."""


class _ErrorPage(RequestHandler):
    """Error page for unknown or refused requests, in the night theme: the bridge may be dark."""

    def initialize(self, status_code: int, reason: str | None = None) -> None:
        """Set the status; called by tornado with the arguments of the route."""
        self.set_status(status_code, reason)

    def prepare(self) -> None:
        """Answer every method with one line."""
        night, status = THEMES["night"], self.get_status()
        style = f"background:{night.background};color:{night.text}"
        self.finish(
            f'<!doctype html><html style="{style}"><title>{status}</title>'
            f'<p>{status}: {self._reason}. <a style="{style}" href="/?theme=night">Monitor</a></html>'
        )

    def check_xsrf_cookie(self) -> None:
        """Do nothing: the server changes nothing on a request."""


class _Health(RequestHandler):
    """Health check for pages that have lost their link."""

    def get(self) -> None:
        """Answer "alive"."""
        self.set_header("Cache-Control", "no-store")
        self.finish("alive")


class _Socket(WSHandler):
    """Bokeh connection that tolerates a session that is already closed.

    A tab closed while the server is busy leaves messages behind, and its end is detected several times: by a ping, by a
    write, by tornado. Bokeh asserts each time that the session still exists.
    """

    async def on_message(self, fragment: str | bytes) -> None:
        """Process a message if its page is still open."""
        if not self._is_session_closed():
            await super().on_message(fragment)

    def on_close(self) -> None:
        """Close the session, once."""
        if not self._is_session_closed():
            super().on_close()

    def _is_session_closed(self) -> bool:
        try:
            return self.connection is not None and self.connection.session is None
        except AssertionError:
            return True


class _Application(BokehTornado):
    """Bokeh application that answers only pages of its address.

    Requests of pages of other sites in the same browser are refused. The port in a request may differ from the server's
    port, because the page may be opened through an ssh tunnel.
    """

    def __init__(self, make: Callable[[Document], None], hosts: OwnHosts) -> None:
        self._hosts = hosts
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        super().__init__(
            {"/": make},
            # Origins are checked in find_handler, where the request's host is known.
            extra_websocket_origins=["*"],
            extra_patterns=[
                (r"/health", _Health),
                (r"/fonts/(DejaVuSans(?:-Bold)?\.ttf)", StaticFileHandler, {"path": str(fonts)}),
            ],
            use_index=False,
            # Only this server makes sessions: a websocket cannot open a session that is not counted.
            sign_sessions=True,
            secret_key=secrets.token_bytes(32),
            # A browser that reconnects gets a new session; the session of a closed page is removed soon.
            unused_session_lifetime_milliseconds=5000,
            check_unused_sessions_milliseconds=5000,
            # Updates that wait longer than this for a browser are useless.
            keep_alive_milliseconds=10000,
            websocket_max_message_size_bytes=MAX_MESSAGE_BYTES,
            default_handler_class=_ErrorPage,
            default_handler_args={"status_code": 404},
        )
        for rule in self.wildcard_router.rules:
            if rule.target is WSHandler:
                rule.target = _Socket

    def find_handler(self, request: HTTPServerRequest, **arguments: Any) -> Any:
        """Return the handler of a request: an error page for other sites, a NUL in the path, or too many open pages."""
        origin = request.headers.get("Origin")
        if not self._hosts.is_own_host(request) or (
            origin is not None and _host_and_port(origin) != request.host.lower()
        ):
            return self._error_handler(request, 403, "Host name not allowed: allow it with monitor --allow-host NAME")
        if b"\0" in unquote_to_bytes(request.path):
            return self._error_handler(request, 404)
        if request.path in _PAGES and len(self.get_sessions("/")) >= MAX_PAGES:
            return self._error_handler(request, 503, f"{MAX_PAGES} pages are open, the maximum")
        return super().find_handler(request, **arguments)

    def _error_handler(self, request: HTTPServerRequest, status_code: int, reason: str | None = None) -> Any:
        return self.get_handler_delegate(request, _ErrorPage, {"status_code": status_code, "reason": reason})


def _host_and_port(origin: str) -> str:
    """Return host and port of an origin; empty if the origin has no host."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


class PageServer:
    """Server of pages; it listens from its creation and serves while :meth:`run` runs.

    Attributes:
        address: address of the page for a browser.

    Args:
        make: fills the document of a browser.
        host: address to listen on; loopback serves this machine only.
        port: TCP port; 0 for a free port.
        tick: called four times a second, with or without a browser.
        allowed_hosts: further host names in the address of the page.

    Raises:
        BadInput: the port is in use, or the address does not belong to this machine.
    """

    def __init__(
        self,
        make: Callable[[Document], None],
        host: str,
        port: int,
        tick: Callable[[], None],
        allowed_hosts: Sequence[str] = (),
    ) -> None:
        sockets = listening_sockets(host, port, "--port")
        # Bokeh would log a closed browser once for each value that was being sent.
        logging.getLogger("bokeh").setLevel(logging.ERROR)
        self.address = f"http://{address_in_url(host)}:{sockets[0].getsockname()[1]}/"
        self._loop = IOLoop(make_current=True)
        application = _Application(make, OwnHosts(host, allowed_hosts))
        self._http = BoundedServer(application)
        self._http.add_sockets(sockets)
        self._server = BaseServer(self._loop, application, self._http)
        self._ticking = PeriodicCallback(tick, TICK_MS)

    def run(self) -> None:
        """Serve until :meth:`stop`."""
        self._server.start()
        # Bokeh collects garbage after each closed page; the objects made so far are excluded from the collection.
        gc.freeze()
        self._ticking.start()
        try:
            self._loop.start()
        finally:
            self._ticking.stop()
            self._server.stop()
            self._http.stop()

    def stop(self) -> None:
        """Request the end of :meth:`run`; a signal handler or another thread may call this."""
        self._loop.add_callback(self._loop.stop)

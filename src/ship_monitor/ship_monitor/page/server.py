"""The server of the page: Bokeh on one address and port; scripts, styles and fonts from itself alone."""

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

from ship_monitor.page.themes import THEMES
from ship_monitor.web.bounded_server import (
    MOST_MESSAGE_BYTES,
    BoundedServer,
    address_in_url,
    listening_sockets,
)
from ship_monitor.web.own_hosts import OwnHosts

TICK_MS = 250

MOST_BROWSERS = 32
"""Pages that are open at once: all others wait for one second while so many are left at the same time."""

_PAGES = "/", "/autoload.js"
"""Addresses at which Bokeh makes a document."""


class _Refusal(RequestHandler):
    """Answer for pages that do not exist or are refused, in the colours of the night: the bridge may be dark."""

    def initialize(self, status_code: int, reason: str | None = None) -> None:
        """Called by tornado with the arguments of the route."""
        self.set_status(status_code, reason)

    def prepare(self) -> None:
        """Answer every method alike, with one line."""
        night, status = THEMES["night"], self.get_status()
        style = f"background:{night.background};color:{night.text}"
        self.finish(
            f'<!doctype html><html style="{style}"><title>{status}</title>'
            f'<p>{status}: {self._reason}. <a style="{style}" href="/?theme=night">Monitor</a></html>'
        )

    def check_xsrf_cookie(self) -> None:
        """Nothing is changed here."""


class _Health(RequestHandler):
    """Answers while the server lives: a page that has lost its link asks."""

    def get(self) -> None:
        """Nothing but yes."""
        self.set_header("Cache-Control", "no-store")
        self.finish("alive")


class _Socket(WSHandler):
    """A connection of Bokeh that may have left its session already.

    A tab that is closed while the server is busy leaves messages behind, and its end is noticed more than once: by a
    ping, by a write, by tornado. Bokeh asserts at each that there is still a session.
    """

    async def on_message(self, fragment: str | bytes) -> None:
        """Take a message of a page that is still open."""
        if not self._has_left():
            await super().on_message(fragment)

    def on_close(self) -> None:
        """Leave the session, once."""
        if not self._has_left():
            super().on_close()

    def _has_left(self) -> bool:
        try:
            return self.connection is not None and self.connection.session is None
        except AssertionError:
            return True


class _Application(BokehTornado):
    """Bokeh's application, for pages of its own address only.

    A page of another site may be open in the same browser: its requests are refused. The port does not matter: the page
    opens through an ssh tunnel.
    """

    def __init__(self, make: Callable[[Document], None], hosts: OwnHosts) -> None:
        self._hosts = hosts
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        super().__init__(
            {"/": make},
            # Origins are looked at below, where the request's own host is known.
            extra_websocket_origins=["*"],
            extra_patterns=[
                (r"/health", _Health),
                (r"/fonts/(DejaVuSans(?:-Bold)?\.ttf)", StaticFileHandler, {"path": str(fonts)}),
            ],
            use_index=False,
            # Only this server makes documents: a websocket cannot ask for one that was not counted.
            sign_sessions=True,
            secret_key=secrets.token_bytes(32),
            # A browser that comes again gets a page of its own; what a closed one had goes soon.
            unused_session_lifetime_milliseconds=5000,
            check_unused_sessions_milliseconds=5000,
            # News that wait longer than this for a browser are of no use.
            keep_alive_milliseconds=10000,
            websocket_max_message_size_bytes=MOST_MESSAGE_BYTES,
            default_handler_class=_Refusal,
            default_handler_args={"status_code": 404},
        )
        for rule in self.wildcard_router.rules:
            if rule.target is WSHandler:
                rule.target = _Socket

    def find_handler(self, request: HTTPServerRequest, **arguments: Any) -> Any:
        """Return the handler of a request; one that refuses, of another site's, and of one page too many."""
        origin = request.headers.get("Origin")
        if not self._hosts.is_asked(request) or (origin is not None and _place(origin) != request.host.lower()):
            return self._refusal(request, 403, "Forbidden by this name: monitor --allow-host NAME allows it")
        if b"\0" in unquote_to_bytes(request.path):
            return self._refusal(request, 404)
        if request.path in _PAGES and len(self.get_sessions("/")) >= MOST_BROWSERS:
            return self._refusal(request, 503, f"{MOST_BROWSERS} pages are open, the most that are served")
        return super().find_handler(request, **arguments)

    def _refusal(self, request: HTTPServerRequest, status_code: int, reason: str | None = None) -> Any:
        return self.get_handler_delegate(request, _Refusal, {"status_code": status_code, "reason": reason})


def _place(origin: str) -> str:
    """Return host and port of an origin; empty where there are none."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


class PageServer:
    """Listens from the start, and serves pages while it runs.

    Attributes:
        address: of the page, as a browser takes it.

    Args:
        make: fills the document of each browser.
        host: address to listen on; loopback serves this machine alone.
        port: TCP port; 0 takes any.
        tick: called four times a second, whether anybody watches or not.
        allowed_hosts: names of this machine in the address of the page, beyond its own.

    Raises:
        BadInput: the port is in use, or the address is not one of this machine.
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
        # A browser that has gone is no news; and Bokeh would say it once for each value that was on its way.
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
        # Bokeh collects garbage for each page that was left; what is there already is none.
        gc.freeze()
        self._ticking.start()
        try:
            self._loop.start()
        finally:
            self._ticking.stop()
            self._server.stop()
            self._http.stop()

    def stop(self) -> None:
        """End soon; from a signal handler or another thread."""
        self._loop.add_callback(self._loop.stop)

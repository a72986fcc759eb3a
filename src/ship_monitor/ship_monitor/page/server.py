"""The server of the page: Bokeh on one address and port; scripts, styles and fonts from itself alone."""

import errno
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import matplotlib
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import ErrorHandler, RequestHandler, StaticFileHandler

from ship_bags.errors import BadInput
from ship_monitor.page.themes import THEMES

LOOPBACK = ("127.0.0.1", "localhost", "::1")
TICK_MS = 250


class _Refusal(ErrorHandler):
    """What is not there, or not for others: said in red light, because nobody knows how dark it is."""

    def write_error(self, status_code: int, **_: Any) -> None:
        """One line."""
        night = THEMES["night"]
        style = f"background:{night.background};color:{night.text}"
        self.finish(
            f'<!doctype html><html style="{style}"><title>{status_code}</title>'
            f'<p>{status_code}: {self._reason}. <a style="{style}" href="/?theme=night">Monitor</a></html>'
        )


class _Health(RequestHandler):
    """Answers while the server lives: a page that has lost its link asks."""

    def get(self) -> None:
        """Nothing but yes."""
        self.set_header("Cache-Control", "no-store")
        self.finish("alive")


class _Application(BokehTornado):
    """Bokeh's application, for pages of its own address only.

    A page of another site may be open in the same browser: what it asks for is refused. On loopback a name that
    somebody else's DNS points there is refused, too. The port does not matter: the page opens through an ssh tunnel.
    """

    def __init__(self, make: Callable[[Document], None], is_loopback: bool) -> None:
        self._is_loopback = is_loopback
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
            # A browser that comes again gets a page of its own; what a closed one had goes soon.
            unused_session_lifetime_milliseconds=5000,
            check_unused_sessions_milliseconds=5000,
            # News that wait longer than this for a browser are of no use.
            keep_alive_milliseconds=10000,
            default_handler_class=_Refusal,
            default_handler_args={"status_code": 404},
        )

    def find_handler(self, request: HTTPServerRequest, **arguments: Any) -> Any:
        """The handler of a request; of another site's, one that refuses."""
        origin = request.headers.get("Origin")
        is_other = origin is not None and urlsplit(origin).netloc.lower() != request.host.lower()
        name = urlsplit(f"//{request.host}").hostname
        if is_other or (self._is_loopback and name not in LOOPBACK):
            return self.get_handler_delegate(request, _Refusal, {"status_code": 403})
        return super().find_handler(request, **arguments)


class PageServer:
    """Listens from the start, and serves pages while it runs.

    Attributes:
        address: of the page, as a browser takes it.

    Args:
        make: fills the document of each browser.
        host: address to listen on; loopback serves this machine alone.
        port: TCP port; 0 takes any.
        tick: called four times a second, whether anybody watches or not.

    Raises:
        BadInput: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, make: Callable[[Document], None], host: str, port: int, tick: Callable[[], None]) -> None:
        try:
            sockets = bind_sockets(port, host)
        except OSError as problem:
            if problem.errno == errno.EADDRINUSE:
                raise BadInput(f"port {port} of {host} is in use: give another one with --port") from problem
            raise BadInput(f"cannot listen on {host}, port {port}: {problem.strerror}") from problem
        # A browser that has gone is no news; and Bokeh would say it once for each value that was on its way.
        logging.getLogger("bokeh").setLevel(logging.ERROR)
        name = f"[{host}]" if ":" in host else host
        self.address = f"http://{name}:{sockets[0].getsockname()[1]}/"
        self._loop = IOLoop(make_current=True)
        application = _Application(make, host in LOOPBACK)
        self._http = HTTPServer(application)
        self._http.add_sockets(sockets)
        self._server = BaseServer(self._loop, application, self._http)
        self._ticking = PeriodicCallback(tick, TICK_MS)

    def run(self) -> None:
        """Serve until :meth:`stop`."""
        self._server.start()
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

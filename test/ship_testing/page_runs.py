"""The page's server in a thread, with suite states set by a test."""

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from queue import Queue
from zoneinfo import ZoneInfo

from ship_monitor.page.app import page_maker
from ship_monitor.page.server import PageServer
from ship_testing import suite_states
from ship_watch.history.history import History
from ship_watch.suite_state import SuiteState

_END_S = 20.0


class StateSource:
    """Source of suite states: returns the state that was set last, with a time that advances."""

    label = "SIMULATED · bag"
    name = "demo"
    location = "namespace /demo, domain 0"

    def __init__(self) -> None:
        self.state = suite_states.suite_state()
        self.history = suite_states.history()
        self.fails = False
        self._start_s = time.monotonic()

    def current_state(self) -> SuiteState:
        """Return the state that was set last, with ``utc_ns`` later by the age of this source."""
        if self.fails:
            raise RuntimeError("no picture: requested by the test")
        return replace(self.state, utc_ns=self.state.utc_ns + round((time.monotonic() - self._start_s) * 1e9))

    def set(self, state: SuiteState, history: History | None = None) -> None:
        """Set another state."""
        self.state = state
        self.history = self.history if history is None else history

    def controls(self, _on_move: Callable[[], None]) -> None:
        """Return None: the source has no controls."""


@contextlib.contextmanager
def run_page_server(
    source: StateSource | None = None,
    port: int = 0,
    address: str = "127.0.0.1",
    allowed_hosts: Sequence[str] = (),
    zone: ZoneInfo | None = None,
) -> Iterator[PageServer]:
    """Run a server until the end of the ``with`` statement."""
    state_source = StateSource() if source is None else source
    made: Queue[PageServer | BaseException] = Queue()

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            server = PageServer(
                page_maker(lambda: state_source, "day", zone), address, port, lambda: None, allowed_hosts
            )
        except BaseException as problem:
            made.put(problem)
            raise
        made.put(server)
        server.run()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    server = made.get(timeout=_END_S)
    if isinstance(server, BaseException):
        raise server
    try:
        yield server
    finally:
        server.stop()
        thread.join(_END_S)

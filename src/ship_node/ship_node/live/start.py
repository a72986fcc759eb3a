"""How the executable of a node begins: it can be ended in order before it has read its libraries."""

import gc
import importlib
import os
import select
import signal
import sys
import time
from typing import NoReturn

from ship_bags.live.heartbeat import HEARTBEAT_PERIOD_NS, heartbeat

WAITS = "SHIP_NODE_WAITS"
"""Where the environment has this, a node reads its libraries and then waits for a line on stdin before it runs."""


def start_node(module: str, adapter: str) -> NoReturn:
    """Read a node's adapter and run it until it is told to stop.

    Reading the libraries takes up to a second, on a busy machine longer. A signal that ends the node meanwhile gives
    the same exit code as later. A process that is kept in reserve (:data:`WAITS`) has done this when it is needed; it
    is nobody in DDS yet, and has read no parameters.

    Args:
        module: that holds the adapter.
        adapter: name of its class.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        # Nothing runs yet that had to be closed; an exception could get lost in a library that is being read.
        signal.signal(number, lambda *_: os._exit(0))
    # Nothing that is read here is ever given back: to look for it meanwhile would take a tenth of the time, and to look
    # through it later would hold up an output now and then.
    gc.disable()
    adapter_class = getattr(importlib.import_module(module), adapter)
    from ship_node.live.node_shell import run

    gc.freeze()
    gc.enable()
    if os.environ.pop(WAITS, ""):
        _wait_for_begin()
    sys.exit(run(adapter_class))


def _wait_for_begin() -> None:
    """Wait for a line on stdin; a process that was stopped meanwhile is known by its missing signs of life."""
    stdin = select.poll()
    stdin.register(sys.stdin.fileno(), select.POLLIN)
    while not stdin.poll(HEARTBEAT_PERIOD_NS // 1_000_000):
        heartbeat().beat(time.monotonic_ns())
    if not os.read(sys.stdin.fileno(), 1):
        os._exit(0)  # the process that would start it is gone

"""Start of a node's executable. A signal ends the executable cleanly even before its libraries are imported."""

import gc
import importlib
import os
import select
import signal
import sys
import time
from typing import NoReturn

from ship_bags.live.heartbeat import HEARTBEAT_PERIOD_NS, heartbeat

WAIT_VARIABLE = "SHIP_NODE_WAITS"
"""Environment variable; if it is set, a node imports its libraries and waits for a line on stdin before it runs."""


def start_node(module: str, adapter: str) -> NoReturn:
    """Import a node's adapter and run it until a signal ends it.

    The import takes up to a second, on a busy computer longer. A signal during the import gives the same exit code as a
    later signal. A standby process (:data:`WAIT_VARIABLE`) has imported everything in advance, but it does not take
    part in DDS yet and has read no parameters.

    Args:
        module: module of the adapter.
        adapter: name of the adapter's class.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        # Nothing has to be closed yet; an exception could get lost in a library that is being imported.
        signal.signal(number, lambda *_: os._exit(0))
    # Imported objects are never freed. Garbage collection would take a tenth of the time of the imports, and scanning
    # these objects later would delay an output now and then.
    gc.disable()
    adapter_class = getattr(importlib.import_module(module), adapter)
    from ship_node.live.node_runtime import run

    gc.freeze()
    gc.enable()
    if os.environ.pop(WAIT_VARIABLE, ""):
        _wait_for_start()
    sys.exit(run(adapter_class))


def _wait_for_start() -> None:
    """Wait for a line on stdin and send heartbeats, so that a standby process that was stopped is detected."""
    stdin = select.poll()
    stdin.register(sys.stdin.fileno(), select.POLLIN)
    while not stdin.poll(HEARTBEAT_PERIOD_NS // 1_000_000):
        heartbeat().beat(time.monotonic_ns())
    if not os.read(sys.stdin.fileno(), 1):
        os._exit(0)  # the parent process is gone

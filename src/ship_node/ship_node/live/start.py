"""How the executable of a node begins: ready to be ended before anything else is read."""

import importlib
import os
import signal
import sys
from typing import NoReturn


def start_node(module: str, adapter: str) -> NoReturn:
    """Read a node's adapter and run it until it is told to stop.

    To read the libraries takes up to a second, on a busy machine longer. Who ends the node meanwhile gets the same
    exit code as ever.

    Args:
        module: that holds the adapter.
        adapter: name of its class.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        # Nothing runs yet that could go in order, and an exception could get lost in what is just being read.
        signal.signal(number, lambda *_: os._exit(0))
    adapter_class = getattr(importlib.import_module(module), adapter)
    from ship_node.live.node_shell import run

    sys.exit(run(adapter_class))

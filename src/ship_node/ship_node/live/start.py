"""Start of a node's executable. A signal ends the executable cleanly even before its libraries are imported."""

import gc
import importlib
import os
import signal
import sys
from typing import NoReturn


def start_node(module: str, adapter: str) -> NoReturn:
    """Import a node's adapter and run it until a signal ends it.

    The import takes up to a second, on a busy computer longer. A signal during the import gives the same exit code as a
    later signal.

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
    sys.exit(run(adapter_class))

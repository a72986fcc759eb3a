"""Functions that run a campaign's items; three of them kill their process, as the kernel does when memory is short."""

import os
import signal
import struct
import sys
from pathlib import Path

from ship_studies.campaign.items import Item, Result, failed_result

DEADLY_SEED = 2


def quick(item: Item, _folder: Path) -> Result:
    """Return a result at once."""
    return failed_result("") | {"error": None, "values": {"seed": float(item.seed or 0)}}


def dies_once(item: Item, folder: Path) -> Result:
    """Kill the process of one seed the first time."""
    mark = item.source.path.with_name("died")
    if item.seed == DEADLY_SEED and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(item, folder)


def dies_once_while_sending(item: Item, folder: Path) -> Result:
    """Kill the process of one seed the first time, after a part of its result has been sent."""
    mark = item.source.path.with_name("died")
    if item.seed == DEADLY_SEED and not mark.exists():
        mark.touch()
        connection = sys._getframe(1).f_locals["connection"]
        os.write(connection.fileno(), struct.pack("!i", 100) + b"half of it")
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(item, folder)


def dies_always(item: Item, folder: Path) -> Result:
    """Kill the process of one seed each time; before this, write the item's folder into ``deaths``."""
    if item.seed == DEADLY_SEED:
        with item.source.path.with_name("deaths").open("a", encoding="utf-8") as notes:
            notes.write(f"{folder}\n")
        (folder / "left_behind").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(item, folder)

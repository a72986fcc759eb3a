"""Executables that live in another package now: one line that says where, exit code 2."""

import sys
from pathlib import Path

PLACES = {"record": "ship_bags", "play": "ship_bags", "import_nmea": "ship_bags", "simulate": "ship_simulation"}
"""Executable → its package now."""


def say() -> int:
    """Tell where the executable that was called is."""
    name = Path(sys.argv[0]).name
    package = PLACES[name]
    print(f"{name} has moved from ship_replay to {package}: ros2 run {package} {name}", file=sys.stderr)
    return 2

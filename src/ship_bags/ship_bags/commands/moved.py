"""Executables that moved to another package: one line with the new place, exit code 2."""

import sys
from pathlib import Path

from ship_bags.command_line import launcher

PLACES = {"record": "ship_bags", "play": "ship_bags", "import_nmea": "ship_bags", "simulate": "ship_simulation"}
"""Executable → its present package."""


def main() -> int:
    """Print the package of the executable that was called."""
    name = Path(sys.argv[0]).name
    package = PLACES[name]
    print(f"{name} has moved from ship_replay to {package}: {launcher()} {package} {name}", file=sys.stderr)
    return 2

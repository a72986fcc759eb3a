"""Executables that moved to another package: one line with the new place, exit code 2."""

import sys
from pathlib import Path

from ship_bags.command_line import launcher

NEW_PACKAGE = "ship_studies"


def main() -> int:
    """Print the package of the executable that was called; its file is in a folder with the name of the old package."""
    called = Path(sys.argv[0])
    place = f"{launcher()} {NEW_PACKAGE} {called.name}"
    print(f"{called.name} has moved from {called.parent.name} to {NEW_PACKAGE}: {place}", file=sys.stderr)
    return 2

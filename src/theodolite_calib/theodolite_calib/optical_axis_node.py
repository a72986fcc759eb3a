"""The executable ``optical_axis``."""

import sys

from ship_node.node_shell import run
from theodolite_calib.adapter import OpticalAxisAdapter


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(OpticalAxisAdapter))

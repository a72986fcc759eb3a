"""The executable ``ship_attitude``."""

import sys

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_node.node_shell import run


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(ShipAttitudeAdapter))

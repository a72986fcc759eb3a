"""The executable ``star_attitude``."""

import sys

from ship_attitude_star.star_attitude_adapter import StarAttitudeAdapter
from ship_node.node_shell import run


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(StarAttitudeAdapter))

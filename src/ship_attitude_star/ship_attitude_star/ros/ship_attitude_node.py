"""The executable ``ship_attitude``."""

from ship_node.live.start import start_node


def main() -> None:
    """Run the node until it is told to stop."""
    start_node("ship_attitude_star.ros.ship_attitude_adapter", "ShipAttitudeAdapter")

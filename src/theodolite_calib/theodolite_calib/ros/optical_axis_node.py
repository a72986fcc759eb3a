"""The executable ``optical_axis``."""

from ship_node.live.start import start_node


def main() -> None:
    """Run the node until it is told to stop."""
    start_node("theodolite_calib.ros.optical_axis_adapter", "OpticalAxisAdapter")

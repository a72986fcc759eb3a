"""The executable ``optical_axis``."""

from ship_node.start import start_node


def main() -> None:
    """Run the node until it is told to stop."""
    start_node("theodolite_calib.adapter", "OpticalAxisAdapter")

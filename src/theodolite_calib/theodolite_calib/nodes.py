"""Executables ``optical_axis`` and ``triangulation``: each runs its node until it is stopped."""

from ship_node.live.start import start_node


def optical_axis() -> None:
    """Run ``optical_axis``."""
    start_node("theodolite_calib.adapters.optical_axis_adapter", "OpticalAxisAdapter")


def triangulation() -> None:
    """Run ``triangulation``."""
    start_node("theodolite_calib.adapters.triangulation_adapter", "TriangulationAdapter")

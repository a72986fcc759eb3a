"""Nodes of the suite that can be replayed."""

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.adapters.triangulation_adapter import TriangulationAdapter

ADAPTERS = (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter, TriangulationAdapter)
"""Adapters of these nodes. The first node, the main node, also runs if the configuration names no node."""

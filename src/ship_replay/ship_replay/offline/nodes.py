"""Nodes of the suite that can be replayed."""

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.ros.triangulation_adapter import TriangulationAdapter

ADAPTERS = (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter, TriangulationAdapter)
"""Adapters of these nodes. The first node, the main node, also runs if the configuration names no node."""

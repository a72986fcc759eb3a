"""Executables ``ship_attitude`` and ``star_attitude``: each runs its node until it is stopped."""

from ship_node.live.start import start_node


def ship_attitude() -> None:
    """Run ``ship_attitude``."""
    start_node("ship_attitude_star.adapters.ship_attitude_adapter", "ShipAttitudeAdapter")


def star_attitude() -> None:
    """Run ``star_attitude``."""
    start_node("ship_attitude_star.adapters.star_attitude_adapter", "StarAttitudeAdapter")

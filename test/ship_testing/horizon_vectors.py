"""Straight lines between positions on WGS 84: the reference for computations on the ellipsoid."""

from ship_geometry.earth.geodetic import GeodeticPosition, ecef_from_geodetic, rotation_horizon_from_ecef
from ship_geometry.rotations import FloatArray


def vector_between(start: GeodeticPosition, end: GeodeticPosition) -> FloatArray:
    """Return the straight line from ``start`` to ``end`` in the horizon of ``start``, metres, (..., 3)."""
    line_ecef_m = ecef_from_geodetic(end) - ecef_from_geodetic(start)
    rotation = rotation_horizon_from_ecef(start.latitude, start.longitude)
    return (rotation @ line_ecef_m[..., None])[..., 0]

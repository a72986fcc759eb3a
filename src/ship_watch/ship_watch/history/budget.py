"""Variance of each displayed angle by source of error.

An error budget contains covariances of a small rotation vector about East, North and Up. This module converts each
covariance to variances of heading, pitch and roll, or of azimuth and elevation of a line of sight.
"""

from collections.abc import Mapping

import numpy as np

from ship_geometry.frames import angle_errors_from_rotation_vector
from ship_geometry.ros_axes import horizon_covariance
from ship_geometry.rotations import FloatArray


def angle_variances(
    covariances: Mapping[str, FloatArray], azimuth: float, elevation: float, is_deck: bool
) -> dict[str, dict[str, float]]:
    """Return the variance of each displayed angle by source of error.

    Args:
        covariances: source of error → covariance of a small rotation vector about (East, North, Up), rad²,
            shape (3, 3).
        azimuth: azimuth of the line of sight, or heading of the deck, rad.
        elevation: elevation of the line of sight, or pitch of the deck, rad.
        is_deck: True for heading, pitch and roll, False for azimuth and elevation.

    Returns:
        Angle → source → variance, rad². The variance of the azimuth is multiplied by the squared cosine of the
        elevation. The variance is NaN if the budget is unknown, or if the line of sight points to the zenith.

    Example:
        A tilt about North by 1 mrad is pitch if the heading is East, and roll if the heading is North:

        >>> about_north = {"ins": np.diag([0.0, 1e-6, 0.0])}
        >>> east = angle_variances(about_north, np.pi / 2, 0.0, is_deck=True)
        >>> {angle: round(by_source["ins"] * 1e6, 6) for angle, by_source in east.items()}
        {'heading': 0.0, 'pitch': 1.0, 'roll': 0.0}
    """
    names = ("heading", "pitch", "roll") if is_deck else ("azimuth", "elevation")
    transport = angle_errors_from_rotation_vector(np.asarray(azimuth), np.asarray(elevation))
    if not is_deck:
        transport = transport * [[np.cos(elevation)], [1.0], [1.0]]
    found: dict[str, dict[str, float]] = {name: {} for name in names}
    for source, covariance in covariances.items():
        of_angles = transport @ horizon_covariance(covariance) @ transport.T
        for index, name in enumerate(names):
            found[name][source] = float(of_angles[index, index])
    return found

"""How much of the variance of each angle comes from each source of error.

An error budget tells covariances of a small rotation vector about East, North and Up. An officer asks about heading,
pitch and roll, or about azimuth and elevation of a line of sight.
"""

from collections.abc import Mapping

import numpy as np

from ship_geometry.frames import angle_errors_from_rotation_vector
from ship_geometry.ros_axes import horizon_covariance
from ship_geometry.rotations import FloatArray


def angle_variances(
    covariances: Mapping[str, FloatArray], azimuth: float, elevation: float, is_deck: bool
) -> dict[str, dict[str, float]]:
    """Variance of each shown angle by source.

    Args:
        covariances: by source of error, of a small rotation vector about (East, North, Up), rad², shape (3, 3).
        azimuth: of the line of sight, or the heading of the deck, rad.
        elevation: of the line of sight, or the pitch of the deck, rad.
        is_deck: whether the angles are heading, pitch and roll; else azimuth and elevation.

    Returns:
        By angle, then by source, rad²; that of the azimuth times the squared cosine of the elevation. NaN where the
        budget is not known, or where the line points to the zenith.

    Example:
        A tilt about North by 1 mrad is pitch on an eastern course, and roll on a northern:

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

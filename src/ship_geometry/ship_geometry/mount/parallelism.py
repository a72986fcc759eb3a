"""Parallelism of calibration telescope and main axis: attitude of the telescope from the attitude of the main frame.

    rotation_nm = rotation_nt · R(ΔA, ΔE, Δω)

The parallelism (ΔA, ΔE, Δω) is the attitude of the main frame in the telescope's frame. [W18] (24) is the first-order
form of this equation, with a misprint.
"""

from ship_geometry.frames import rotation_from_angles, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray


def telescope_rotation(parallelism: FloatArray, rotation_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the attitude of the telescope from the attitude of the main frame.

    Args:
        parallelism: azimuth, elevation and rotation of the main axis in the telescope, rad, shape (3,).
        rotation_nm: horizon from main frame, shape (3, 3).

    Returns:
        Horizon from telescope, shape (3, 3), and the derivative of its rotation vector in n with respect to the
            angles of the parallelism, shape (3, 3).

    Example:
        The main axis is 0.1 rad to the right in the telescope, so that the telescope points to its left:

        >>> import numpy as np
        >>> rotation_nt, _ = telescope_rotation(np.array([0.1, 0.0, 0.0]), np.eye(3))
        >>> print(rotation_nt[:, 0].round(3)[[0, 2]])  # forward, right
        [ 0.995 -0.1  ]
    """
    azimuth, elevation, rotation = parallelism
    rotation_nt = rotation_nm @ rotation_from_angles(azimuth, elevation, rotation).T
    return rotation_nt, -rotation_nt @ rotation_vector_from_angle_errors(azimuth, elevation)

"""The calibration telescope and the main axis that it is fixed to: from the attitude of one to that of the other.

    rotation_nm = rotation_nt · R(ΔA, ΔE, Δω)

with (ΔA, ΔE, Δω) the parallelism: the attitude of the main frame in the telescope's frame. [W18] (24) is its first
order, and is misprinted there.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray

SOURCE_PARALLELISM = "parallelism"


def telescope_from_main(parallelism: FloatArray, rotation_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The telescope's attitude by that of the main axis.

    Args:
        parallelism: azimuth, elevation and rotation of the main axis in the telescope, rad, shape (3,).
        rotation_nm: horizon from main frame, shape (3, 3).

    Returns:
        Horizon from telescope, shape (3, 3), and its rotation vector in n per angle of the parallelism, shape (3, 3).
    """
    azimuth, elevation, rotation = parallelism
    rotation_nt = rotation_nm @ rotation_from_angles(azimuth, elevation, rotation).T
    return rotation_nt, -rotation_nt @ rotation_vector_from_angle_errors(azimuth, elevation)


@dataclass(frozen=True)
class Parallelism:
    """Attitude of the main frame m in the telescope frame t.

    Attributes:
        angles: azimuth ΔA, elevation ΔE, rotation Δω of the main axis, rad, shape (3,).
        covariance: of the angles, rad², shape (3, 3).
    """

    angles: FloatArray
    covariance: FloatArray

    @property
    def rotation_tm(self) -> FloatArray:
        """Telescope from main frame, shape (3, 3)."""
        return rotation_from_angles(*self.angles)


def main_from_telescope(
    parallelism: Parallelism, rotation_nt: FloatArray, parts_n: Mapping[str, FloatArray]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Attitude of the main frame, "horizon from main", with its error budget.

    Args:
        parallelism: of the two axes.
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        parts_n: covariance of its rotation vector in n by source, rad², shape (..., 3, 3) each. A rotation vector in
            the parent frame is the same for all that is fixed to the telescope.

    Returns:
        rotation_nm, shape (..., 3, 3), and the covariance of its rotation vector in n by source.
    """
    azimuth, elevation, _ = parallelism.angles
    covariance_t = rotation_vector_covariance(parallelism.covariance, azimuth, elevation)
    own = rotation_nt @ covariance_t @ np.swapaxes(rotation_nt, -1, -2)
    return rotation_nt @ parallelism.rotation_tm, {**parts_n, SOURCE_PARALLELISM: own}

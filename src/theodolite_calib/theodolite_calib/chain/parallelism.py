"""From the calibration telescope to the main optical axis: exact composition with what the two differ by.

models.md §5: rotation_nm = rotation_nt · R(ΔA, ΔE, Δω); [W18] (24) is its first order, misprinted there.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance
from ship_geometry.rotations import FloatArray

SOURCE_PARALLELISM = "parallelism"


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

"""From the ship's attitude and the encoders to the main axis in the horizon, and from there to the telescope and back.

models.md §5, exact:

    rotation_nm = exp(a) R_ship · exp(e) · R(encoder; axis errors)
    rotation_nm = rotation_nt · R(ΔA, ΔE, Δω)

with a the ship's error, e the deformation, and (ΔA, ΔE, Δω) the parallelism: the attitude of the main frame in the
telescope's frame. [W18] (24) is the first order of the second line, and is misprinted there.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles, rotation_vector_covariance, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian
from theodolite_calib.chain.axes import AxisErrors, main_axis

CHAIN_BLOCKS = ("ship.attitude", "deformation", "axes", "ship.time_offset")
"""States that turn the main axis, in the order of :attr:`AxisChain.by_error`'s columns."""


SOURCE_PARALLELISM = "parallelism"


@dataclass(frozen=True)
class ChainErrors:
    """What is wrong, as now known.

    Attributes:
        ship_n: rotation vector a, shape (3,).
        deformation_d: rotation vector e, shape (3,).
        axes: in the order of theodolite_calib.chain.axes.NAMES, rad, shape (7,).
        ship_time_s: a sample of the ship's attitude is valid so much later than it was taken to be.
    """

    ship_n: FloatArray
    deformation_d: FloatArray
    axes: FloatArray
    ship_time_s: float


@dataclass(frozen=True)
class AxisChain:
    """The main axis at one moment.

    Attributes:
        rotation_nd: horizon from deck, corrected, shape (3, 3).
        rotation_dm: deck from main frame, deformation included, shape (3, 3).
        by_error: rotation vector of the main frame in n per error: ship (3), deformation (3), axes (7), time of the
            ship's attitude (1), shape (3, 14).
        by_encoder: the same per encoder angle, shape (3, 2).
    """

    rotation_nd: FloatArray
    rotation_dm: FloatArray
    by_error: FloatArray
    by_encoder: FloatArray

    @property
    def rotation_nm(self) -> FloatArray:
        """Horizon from main frame, shape (3, 3)."""
        return self.rotation_nd @ self.rotation_dm


def axis_chain(
    errors: ChainErrors, rotation_nd: FloatArray, rate_d: FloatArray, azimuth: float, elevation: float
) -> AxisChain:
    """The main axis by a measured attitude of the ship and the encoders.

    Args:
        errors: as now known.
        rotation_nd: measured attitude of the deck at the moment, shape (3, 3).
        rate_d: its angular velocity, rad/s, shape (3,).
        azimuth: of the encoder, rad.
        elevation: of the encoder, rad.
    """
    if errors.ship_time_s != 0.0:
        rotation_nd = rotation_nd @ exp_rotation(-errors.ship_time_s * rate_d)
    rotation_nd = exp_rotation(errors.ship_n) @ rotation_nd
    rotation_df = exp_rotation(errors.deformation_d)
    main = main_axis(AxisErrors.from_vector(errors.axes), azimuth, elevation)
    rotation_nf = rotation_nd @ rotation_df
    by_error = np.empty((3, 14))
    by_error[:, :3] = left_jacobian(errors.ship_n)
    by_error[:, 3:6] = rotation_nd @ left_jacobian(errors.deformation_d)
    by_error[:, 6:13] = rotation_nf @ main.by_error
    by_error[:, 13] = -(rotation_nd @ rate_d)
    return AxisChain(rotation_nd, rotation_df @ main.rotation_dm, by_error, rotation_nf @ main.by_encoder)


def telescope_from_main(
    parallelism: FloatArray, rotation_nm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The telescope that goes with a main axis.

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

"""From the ship's attitude and the encoders to the main axis in the horizon, and from there to the telescope and back.

The chain is exact:

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
from theodolite_calib.chain.axes import Angle, AxisErrors, main_axis

SHIP, DEFORMATION, AXES, SHIP_TIME = slice(0, 3), slice(3, 6), slice(6, 13), slice(13, 14)
"""Columns of :attr:`AxisChain.by_error`: the ship's error, the deformation, the axis errors, the ship's time."""

CHAIN_STATES = {"ship.attitude": SHIP, "deformation": DEFORMATION, "axes": AXES, "ship.time_offset": SHIP_TIME}
"""States of a filter that turn the main axis, each with its columns and in their order."""

SOURCE_PARALLELISM = "parallelism"


@dataclass(frozen=True)
class ChainErrors:
    """What is wrong with the chain, as now known.

    Attributes:
        ship_n: rotation vector a of the ship's error in n, rad, shape (..., 3).
        deformation_d: rotation vector e of the deformation in d, rad, shape (..., 3).
        axes: errors of the theodolite's axes.
        ship_time_s: the sample of the ship's attitude is valid so much later than it was taken to be.
    """

    ship_n: FloatArray
    deformation_d: FloatArray
    axes: AxisErrors
    ship_time_s: float


@dataclass(frozen=True)
class AxisChain:
    """The main axis at one moment, or at several.

    Attributes:
        rotation_nd: horizon from deck, corrected, shape (..., 3, 3).
        rotation_dm: deck from main frame, deformation included, shape (..., 3, 3).
        rotation_nm: horizon from main frame, shape (..., 3, 3).
        by_error: rotation vector of the main frame in n per error, shape (..., 3, 14); the columns are
            :data:`SHIP`, :data:`DEFORMATION`, :data:`AXES` and :data:`SHIP_TIME`.
        by_encoder: the same per encoder angle (azimuth, elevation), shape (..., 3, 2).
    """

    rotation_nd: FloatArray
    rotation_dm: FloatArray
    rotation_nm: FloatArray
    by_error: FloatArray
    by_encoder: FloatArray


def axis_chain(
    errors: ChainErrors, rotation_nd: FloatArray, rate_d: FloatArray, azimuth: Angle, elevation: Angle
) -> AxisChain:
    """The main axis by a measured attitude of the ship and the encoders; leading axes broadcast.

    Args:
        errors: as now known.
        rotation_nd: measured attitude of the deck at the moment, shape (..., 3, 3).
        rate_d: its angular velocity, rad/s, shape (..., 3).
        azimuth: of the encoder, rad, shape (...).
        elevation: of the encoder, rad, shape (...).
    """
    if errors.ship_time_s != 0.0:
        rotation_nd = rotation_nd @ exp_rotation(-errors.ship_time_s * rate_d)
    rotation_nd = exp_rotation(errors.ship_n) @ rotation_nd
    rotation_df = exp_rotation(errors.deformation_d)
    by_ship, by_deformation = left_jacobian(errors.ship_n), left_jacobian(errors.deformation_d)
    main = main_axis(errors.axes, azimuth, elevation)
    rotation_dm = rotation_df @ main.rotation_dm
    rotation_nm = rotation_nd @ rotation_dm
    rotation_nf = rotation_nd @ rotation_df
    by_error = np.empty((*rotation_nm.shape[:-1], SHIP_TIME.stop))
    by_error[..., SHIP] = by_ship
    by_error[..., DEFORMATION] = rotation_nd @ by_deformation
    by_error[..., AXES] = rotation_nf @ main.by_error
    by_error[..., SHIP_TIME] = -(rotation_nd @ rate_d[..., None])
    return AxisChain(rotation_nd, rotation_dm, rotation_nm, by_error, rotation_nf @ main.by_encoder)


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

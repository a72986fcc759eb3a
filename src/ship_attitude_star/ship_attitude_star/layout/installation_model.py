"""How errors of star sensors and of their installation reach the ship's attitude (models.md §3, [Z14]).

    R_ship = R(As, Es, roll_s) R(A0, E0, roll_0)^T         physical reading, [Z14] (4)
    R_ship = R(As, Es, roll_s) R(A0, E0, roll_0)           what [Z14] computed for its figures

To first order the error of heading, pitch and roll is ``J_s [dAs, dEs, droll_s] + J_0 [dA0, dE0, droll_0]``. Both
Jacobians follow from B of :mod:`ship_geometry.frames`, exactly, for every layout. Angles are arrays (..., 3) of
azimuth, elevation, roll (rad); all functions take leading dimensions, so that a sweep is one call.
"""

import enum
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import (
    angle_errors_from_rotation_vector,
    angles_from_rotation,
    rotation_from_angles,
    rotation_vector_from_angle_errors,
)
from ship_geometry.rotations import FloatArray


class Reading(enum.Enum):
    """What R(A0, E0, roll_0) stands for."""

    PHYSICAL = "physical"
    """Deck from sensor: the installation angles say where the boresight points in the ship."""
    PAPER = "paper"
    """Sensor from deck: how [Z14] used the same angles in its factors and figures, against its own (4)."""


@dataclass(frozen=True)
class ErrorModel:
    """First-order errors of the ship's attitude, NaN where heading and roll are not told apart.

    Attributes:
        ship_angles: heading, pitch, roll, shape (..., 3), rad.
        star: J_s, errors of the ship's angles per error of the sensor's horizon attitude, shape (..., 3, 3).
        installation: J_0, the same per error of the installation angles, shape (..., 3, 3).
    """

    ship_angles: FloatArray
    star: FloatArray
    installation: FloatArray

    def errors(self, star_errors: FloatArray, installation_errors: FloatArray) -> FloatArray:
        """Errors of heading, pitch, roll, shape (..., 3), in the unit of the errors given, signs kept."""
        star = (self.star @ np.asarray(star_errors)[..., None])[..., 0]
        return star + (self.installation @ np.asarray(installation_errors)[..., None])[..., 0]

    def covariance(self, star_covariance: FloatArray, installation_covariance: FloatArray) -> FloatArray:
        """Covariance of heading, pitch, roll, shape (..., 3, 3): J Sigma J^T, stars independent of installation."""
        return _transported(self.star, star_covariance) + _transported(self.installation, installation_covariance)


def linearise(
    star_angles: FloatArray, installation_angles: FloatArray, reading: Reading = Reading.PHYSICAL
) -> ErrorModel:
    """The error model of one sensor at its horizon attitude and installation, shapes (..., 3), rad."""
    star, installation = np.broadcast_arrays(
        np.asarray(star_angles, dtype=float), np.asarray(installation_angles, dtype=float)
    )
    rotation_ns = _rotation(star)
    ship_angles = angles_from_rotation(ship_rotation(star, installation, reading))
    to_ship_angles = angle_errors_from_rotation_vector(ship_angles[..., 0], ship_angles[..., 1])
    installation_vectors = _transport(installation)
    if reading is Reading.PHYSICAL:
        # exp(d_s) R_s (exp(d_0) R_0)^T = exp(d_s - R_ship d_0) R_ship
        rotation_nd = rotation_ns @ np.swapaxes(_rotation(installation), -1, -2)
        moved = -rotation_nd @ installation_vectors
    else:
        # exp(d_s) R_s exp(d_0) R_0 = exp(d_s + R_s d_0) R_s R_0
        moved = rotation_ns @ installation_vectors
    return ErrorModel(ship_angles, to_ship_angles @ _transport(star), to_ship_angles @ moved)


def ship_rotation(star_angles: FloatArray, installation_angles: FloatArray, reading: Reading) -> FloatArray:
    """Rotation "horizon from deck" that a sensor's horizon attitude stands for, shape (..., 3, 3)."""
    installation = _rotation(np.asarray(installation_angles, dtype=float))
    if reading is Reading.PHYSICAL:
        installation = np.swapaxes(installation, -1, -2)
    return _rotation(np.asarray(star_angles, dtype=float)) @ installation


@dataclass(frozen=True)
class Combination:
    """The best joint attitude of N sensors.

    Attributes:
        covariance: of the joint rotation vector, shape (..., 3, 3), rad².
        gains: joint error = sum over sensors of gain @ error of the sensor, shape (..., N, 3, 3).
    """

    covariance: FloatArray
    gains: FloatArray


def combine(
    covariances: FloatArray, common_effects: FloatArray | None = None, common_covariance: FloatArray | None = None
) -> Combination:
    """Best linear unbiased combination of N attitudes whose errors are ``own + effect @ common``.

    Without common terms this is the sum of the informations. What is common to all in the same way passes through
    undiminished; what acts on each sensor differently is in part told apart.

    Args:
        covariances: of each sensor's own error, rotation vectors in one frame, shape (..., N, 3, 3), regular, rad².
        common_effects: what each of k common errors does to each sensor, shape (..., N, 3, k).
        common_covariance: of the common errors, shape (k, k).
    """
    *leading, count, _, _ = covariances.shape
    stacked = np.zeros((*leading, count, 3, count, 3))
    each = np.arange(count)
    # Indices apart from each other put the sensors first.
    stacked[..., each, :, each, :] = np.moveaxis(covariances, -3, 0)
    joint = stacked.reshape(*leading, 3 * count, 3 * count)
    if common_effects is not None and common_covariance is not None:
        joint = joint + _transported(
            common_effects.reshape(*leading, 3 * count, common_effects.shape[-1]), common_covariance
        )
    same_attitude = np.broadcast_to(np.tile(np.eye(3), (count, 1)), (*leading, 3 * count, 3))
    weights = np.linalg.solve(joint, same_attitude)
    covariance = np.linalg.inv(weights.reshape(*leading, count, 3, 3).sum(axis=-3))
    gains = (covariance @ np.swapaxes(weights, -1, -2)).reshape(*leading, 3, count, 3)
    return Combination(covariance, np.moveaxis(gains, -2, -3))


def _rotation(angles: FloatArray) -> FloatArray:
    return rotation_from_angles(angles[..., 0], angles[..., 1], angles[..., 2])


def _transport(angles: FloatArray) -> FloatArray:
    return rotation_vector_from_angle_errors(angles[..., 0], angles[..., 1])


def _transported(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    return matrix @ covariance @ np.swapaxes(matrix, -1, -2)

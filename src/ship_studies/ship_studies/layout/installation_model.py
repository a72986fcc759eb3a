"""Error model of the ship's attitude by a star sensor and its installation, and the six figures of [Z14].

    R_ship = R(As, Es, roll_s) R(A0, E0, roll_0)^T         physical convention, [Z14] (4)
    R_ship = R(As, Es, roll_s) R(A0, E0, roll_0)           as computed by [Z14] for its figures

To first order the error of heading, pitch and roll is ``J_s [dAs, dEs, droll_s] + J_0 [dA0, dE0, droll_0]``. Both
Jacobians follow exactly from the matrix B of :mod:`ship_geometry.frames`, for every layout. Angles are arrays (..., 3)
of azimuth, elevation, roll (rad); all functions take leading dimensions, so that a sweep is one call. The model is
described in docs/how-to/mount_a_sensor.md. A sweep is one of the six figures: the errors while one angle varies and the
other angles stay fixed.
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
from ship_studies.layout.config import OperatingPoint

SHIP_ANGLES = ("heading", "pitch", "roll")
"""Names of the ship's angles, in the order of every array of their errors."""

CURVE_AZIMUTHS_DEG = (0.0, 90.0, 180.0, 270.0)
"""Installation azimuths A0 of the curves of each figure."""

STAR_ROLL_ONLY = np.array([0.0, 0.0, 1.0])

# Indices into (As, Es, roll_s, A0, E0, roll_0).
_STAR_AZIMUTH, _STAR_ELEVATION, _AZIMUTH, _ELEVATION, _ROLL = 0, 1, 3, 4, 5

SOURCES = ("ΔAs", "ΔEs", "Δγs", "ΔA0", "ΔE0", "Δγ0")
"""Error sources of [Z14], in the order of :func:`source_errors_arcsec`."""


class InstallationConvention(enum.Enum):
    """Convention of the rotation R(A0, E0, roll_0)."""

    PHYSICAL = "physical"
    """Deck from sensor: the installation angles are the direction of the boresight in the ship."""
    PAPER = "paper"
    """Sensor from deck, as in the factors and figures of [Z14], in contradiction to equation (4) of [Z14]."""


@dataclass(frozen=True)
class ErrorModel:
    """First-order errors of the ship's attitude; NaN if heading and roll are not separable.

    Attributes:
        ship_angles: heading, pitch, roll, shape (..., 3), rad.
        star: J_s, errors of the ship's angles per error of the sensor's horizon attitude, shape (..., 3, 3).
        installation: J_0, errors of the ship's angles per error of the installation angles, shape (..., 3, 3).
    """

    ship_angles: FloatArray
    star: FloatArray
    installation: FloatArray

    def errors(self, star_errors: FloatArray, installation_errors: FloatArray) -> FloatArray:
        """Return the signed errors of heading, pitch, roll, shape (..., 3), in the unit of the given errors."""
        star = (self.star @ np.asarray(star_errors)[..., None])[..., 0]
        return star + (self.installation @ np.asarray(installation_errors)[..., None])[..., 0]


def linearise(
    star_angles: FloatArray,
    installation_angles: FloatArray,
    convention: InstallationConvention = InstallationConvention.PHYSICAL,
) -> ErrorModel:
    """Return the error model of one sensor at its horizon attitude and installation.

    Args:
        star_angles: azimuth, elevation, roll of the sensor in the horizon, shape (..., 3), rad.
        installation_angles: azimuth, elevation, roll of the sensor in the deck, shape (..., 3), rad.
        convention: convention of the installation angles.
    """
    star, installation = np.broadcast_arrays(
        np.asarray(star_angles, dtype=float), np.asarray(installation_angles, dtype=float)
    )
    rotation_ns = rotations(star)
    ship_angles = angles_from_rotation(ship_rotation(star, installation, convention))
    to_ship_angles = angle_errors_from_rotation_vector(ship_angles[..., 0], ship_angles[..., 1])
    installation_vectors = _rotation_vector_jacobian(installation)
    if convention is InstallationConvention.PHYSICAL:
        # exp(d_s) R_s (exp(d_0) R_0)^T = exp(d_s - R_ship d_0) R_ship
        rotation_nd = rotation_ns @ np.swapaxes(rotations(installation), -1, -2)
        moved = -rotation_nd @ installation_vectors
    else:
        # exp(d_s) R_s exp(d_0) R_0 = exp(d_s + R_s d_0) R_s R_0
        moved = rotation_ns @ installation_vectors
    return ErrorModel(ship_angles, to_ship_angles @ _rotation_vector_jacobian(star), to_ship_angles @ moved)


def ship_rotation(
    star_angles: FloatArray, installation_angles: FloatArray, convention: InstallationConvention
) -> FloatArray:
    """Return the rotation "horizon from deck" computed from a sensor's horizon attitude, shape (..., 3, 3)."""
    installation = rotations(np.asarray(installation_angles, dtype=float))
    if convention is InstallationConvention.PHYSICAL:
        installation = np.swapaxes(installation, -1, -2)
    return rotations(np.asarray(star_angles, dtype=float)) @ installation


@dataclass(frozen=True)
class JointAttitude:
    """Errors of the best joint attitude of N sensors.

    Attributes:
        covariance: covariance of the joint rotation vector, shape (..., 3, 3), rad².
        gains: joint error = sum over sensors of gain @ error of the sensor, shape (..., N, 3, 3).
    """

    covariance: FloatArray
    gains: FloatArray


def combine_attitudes(
    covariances: FloatArray, common_effects: FloatArray | None = None, common_covariance: FloatArray | None = None
) -> JointAttitude:
    """Return the best linear unbiased combination of N attitudes whose errors are ``own + effect @ common``.

    Without common errors, the information of the joint attitude is the sum of the sensors' information. A common error
    with the same effect on all sensors is not reduced. A common error with different effects is observable in the
    differences of the sensors and partly reduced.

    Args:
        covariances: covariance of each sensor's own error, rotation vectors in one frame, rad², shape (..., N, 3, 3);
            not singular.
        common_effects: effects of each of k common errors on each sensor, shape (..., N, 3, k).
        common_covariance: covariance of the common errors, shape (k, k).
    """
    *leading, count, _, _ = covariances.shape
    stacked = np.zeros((*leading, count, 3, count, 3))
    each = np.arange(count)
    # numpy puts the dimension of separated index arrays, here the sensors, first.
    stacked[..., each, :, each, :] = np.moveaxis(covariances, -3, 0)
    joint = stacked.reshape(*leading, 3 * count, 3 * count)
    if common_effects is not None and common_covariance is not None:
        effects = common_effects.reshape(*leading, 3 * count, common_effects.shape[-1])
        joint = joint + effects @ common_covariance @ np.swapaxes(effects, -1, -2)
    same_attitude = np.broadcast_to(np.tile(np.eye(3), (count, 1)), (*leading, 3 * count, 3))
    weights = np.linalg.solve(joint, same_attitude)
    covariance = np.linalg.inv(weights.reshape(*leading, count, 3, 3).sum(axis=-3))
    gains = (covariance @ np.swapaxes(weights, -1, -2)).reshape(*leading, 3, count, 3)
    return JointAttitude(covariance, np.moveaxis(gains, -2, -3))


def rotations(angles: FloatArray) -> FloatArray:
    """Return the rotations by azimuth, elevation, roll, shape (..., 3) → (..., 3, 3)."""
    return rotation_from_angles(angles[..., 0], angles[..., 1], angles[..., 2])


def _rotation_vector_jacobian(angles: FloatArray) -> FloatArray:
    return rotation_vector_from_angle_errors(angles[..., 0], angles[..., 1])


@dataclass(frozen=True)
class Sweep:
    """One of the six figures.

    Attributes:
        number: number of the figure in [Z14].
        symbol: symbol of the swept angle.
        meaning: description of the swept angle.
        column: index of the swept angle in (As, Es, roll_s, A0, E0, roll_0).
        range_deg: least and greatest value of the swept angle.
        all_errors: True for all six errors added with their signs; False for the error of the star sensor's roll only.
    """

    number: int
    symbol: str
    meaning: str
    column: int
    range_deg: tuple[float, float]
    all_errors: bool


SWEEPS = (
    Sweep(1, "As", "azimuth of the sensor in the horizon", _STAR_AZIMUTH, (0.0, 360.0), False),
    Sweep(2, "Es", "elevation of the sensor in the horizon", _STAR_ELEVATION, (0.0, 90.0), False),
    Sweep(3, "E0", "installation elevation", _ELEVATION, (0.0, 90.0), False),
    Sweep(4, "A0", "installation azimuth", _AZIMUTH, (0.0, 360.0), True),
    Sweep(5, "γ0", "installation roll", _ROLL, (-90.0, 90.0), True),
    Sweep(6, "E0", "installation elevation", _ELEVATION, (0.0, 90.0), True),
)


@dataclass(frozen=True)
class Curve:
    """One curve of a figure.

    Attributes:
        sweep: figure to which the curve belongs.
        convention: convention of the installation angles.
        azimuth_deg: installation azimuth A0; None if A0 is the swept angle.
        swept_deg: values of the swept angle, shape (n,).
        errors_arcsec: signed errors of heading, pitch, roll, shape (n, 3); NaN at a pitch of ±90°.
    """

    sweep: Sweep
    convention: InstallationConvention
    azimuth_deg: float | None
    swept_deg: FloatArray
    errors_arcsec: FloatArray


def all_curves(point: OperatingPoint) -> list[Curve]:
    """Return every curve of every figure in both conventions, one point per degree."""
    return [
        _curve(point, sweep, reading, azimuth_deg)
        for sweep in SWEEPS
        for reading in InstallationConvention
        for azimuth_deg in ((None,) if sweep.column == _AZIMUTH else CURVE_AZIMUTHS_DEG)
    ]


def _curve(point: OperatingPoint, sweep: Sweep, convention: InstallationConvention, azimuth_deg: float | None) -> Curve:
    low, high = sweep.range_deg
    swept_deg = np.linspace(low, high, round(high - low) + 1)
    angles_deg = np.tile(point_angles_deg(point, azimuth_deg or 0.0), (swept_deg.size, 1))
    angles_deg[:, sweep.column] = swept_deg
    angles = np.deg2rad(angles_deg)
    model = linearise(angles[:, :3], angles[:, 3:], convention)
    if sweep.all_errors:
        errors = model.errors(point.star_errors_arcsec(), point.installation_errors_arcsec())
    else:
        errors = model.errors(point.star_errors_arcsec() * STAR_ROLL_ONLY, np.zeros(3))
    return Curve(sweep, convention, azimuth_deg, swept_deg, errors)


def point_angles_deg(point: OperatingPoint, azimuth_deg: float) -> FloatArray:
    """Return (As, Es, roll_s, A0, E0, roll_0) of the operating point, shape (6,)."""
    star = [point.star_azimuth_deg, point.star_elevation_deg, point.star_roll_deg]
    return np.array([*star, azimuth_deg, point.elevation_deg, point.roll_deg])


def source_errors_arcsec(point: OperatingPoint, azimuth_deg: float, convention: InstallationConvention) -> FloatArray:
    """Return the signed errors of heading, pitch, roll due to each of the six errors alone, shape (6, 3)."""
    angles = np.deg2rad(point_angles_deg(point, azimuth_deg))
    model = linearise(angles[:3], angles[3:], convention)
    factors = np.concatenate([model.star, model.installation], axis=-1)
    errors = np.concatenate([point.star_errors_arcsec(), point.installation_errors_arcsec()])
    by_source: FloatArray = (factors * errors).T
    return by_source

"""Errors of a layout: joint error of all sensors, by error source, and as a function of one sensor's mounting."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import (
    angle_covariance,
    angle_errors_from_rotation_vector,
    angles_from_rotation,
    rotation_from_angles,
    rotation_vector_from_angle_errors,
)
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.layout.config import MIN_ELEVATION_DEG, LayoutStudyConfig
from ship_studies.layout.installation_model import JointAttitude, combine_attitudes

_AXES = ("forward", "up", "right")
_COMMON = (
    ("horizon about North", "tilt"),
    ("horizon about the vertical", "heading"),
    ("horizon about East", "tilt"),
    ("refraction", "refraction"),
)
"""The errors that sensors share, as text and as parameter, in the order of ``Layout.common_sigmas``."""
_HEADING = 0.0
"""Heading of the ship, rad: no error depends on it."""


@dataclass(frozen=True)
class SourceError:
    """Effect of one sigma of one error source on the joint attitude.

    Attributes:
        sensor: sensor that has this error; "all" for an error that the sensors share.
        source: description of the source.
        key: parameter of the study that sets the size of the error, unless optics determine the noise.
        sigma_arcsec: standard deviation of the source.
        errors_arcsec: errors of heading, pitch, roll due to the source, shape (3,); the sum of their squares over all
            sources is the variance.
    """

    sensor: str
    source: str
    key: str
    sigma_arcsec: float
    errors_arcsec: FloatArray


@dataclass(frozen=True)
class Layout:
    """The sensors of a study as arrays.

    Attributes:
        names: names of the sensors.
        angles: installation azimuth, elevation, roll, shape (N, 3), rad.
        noise_sigmas: noise of each sensor about (forward, up, right), shape (N, 3), rad.
        installation_sigmas: error of each installation about (forward, up, right), shape (N, 3), rad.
        common_sigmas: errors that the sensors share: about North, Up, East, and of the refraction at 45°, shape (4,),
            rad.
        ship_angles: heading, pitch, roll, shape (3,), rad.
    """

    names: tuple[str, ...]
    angles: FloatArray
    noise_sigmas: FloatArray
    installation_sigmas: FloatArray
    common_sigmas: FloatArray
    ship_angles: FloatArray

    @classmethod
    def from_config(cls, config: LayoutStudyConfig) -> "Layout":
        """Return the layout of a study."""
        sensors, common = list(config.sensors.values()), config.common
        tilt = common.tilt_sigma_arcsec
        return cls(
            names=tuple(config.sensors),
            angles=np.array([sensor.angles() for sensor in sensors]),
            noise_sigmas=np.array([sensor.noise_sigmas() for sensor in sensors]),
            installation_sigmas=np.array([sensor.installation_sigmas() for sensor in sensors]),
            common_sigmas=ARCSEC * np.array([tilt, common.heading_sigma_arcsec, tilt, common.refraction_sigma_arcsec]),
            ship_angles=np.array([_HEADING, *np.deg2rad([config.ship_pitch_deg, config.ship_roll_deg])]),
        )

    def single_sensor(self, number: int) -> "Layout":
        """Return the layout of one of the sensors alone."""
        only = slice(number, number + 1)
        return Layout(
            self.names[only],
            self.angles[only],
            self.noise_sigmas[only],
            self.installation_sigmas[only],
            self.common_sigmas,
            self.ship_angles,
        )

    def sigmas_arcsec(self, angles: FloatArray | None = None) -> FloatArray:
        """Return sigma of heading, pitch, roll of the joint attitude, shape (..., 3).

        Args:
            angles: installation angles to use in place of the layout's own, shape (..., N, 3), rad.
        """
        own_angles = self.angles if angles is None else angles
        joint, _, _ = self._combined_attitude(own_angles)
        covariance = angle_covariance(joint.covariance, self.ship_angles[0], self.ship_angles[1])
        return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)) / ARCSEC

    def horizon_elevations_deg(self) -> FloatArray:
        """Return the elevation of each boresight above the horizon, with the ship's pitch and roll, shape (N,)."""
        return np.rad2deg(angles_from_rotation(self._rotations_ns(self.angles))[..., 1])

    def budget(self) -> list[SourceError]:
        """Return the joint error by sensor and source, without sources of size zero."""
        joint, rotations_ns, common_effects = self._combined_attitude(self.angles)
        to_angles = angle_errors_from_rotation_vector(self.ship_angles[0], self.ship_angles[1])
        sources = []
        for number, name in enumerate(self.names):
            per_axis = to_angles @ joint.gains[number] @ rotations_ns[number]
            for words, prefix, sigmas in (
                ("noise", "sigma", self.noise_sigmas),
                ("installation", "installation_sigma", self.installation_sigmas),
            ):
                for axis, axis_name in enumerate(_AXES):
                    sigma = sigmas[number, axis]
                    errors = per_axis[:, axis] * sigma / ARCSEC
                    where = "boresight" if axis == 0 else f"{axis_name} axis"
                    key = f"sensors.{name}.{prefix}_{axis_name}_arcsec"
                    sources.append(SourceError(name, f"{words} about the {where}", key, sigma / ARCSEC, errors))
        per_common = to_angles @ np.einsum("nij,njk->ik", joint.gains, common_effects)
        for number, (words, key) in enumerate(_COMMON):
            sigma = self.common_sigmas[number]
            errors = per_common[:, number] * sigma / ARCSEC
            sources.append(SourceError("all", words, f"common.{key}_sigma_arcsec", sigma / ARCSEC, errors))
        return [source for source in sources if source.sigma_arcsec > 0.0]

    def _rotations_ns(self, angles: FloatArray) -> FloatArray:
        rotation_nd = rotation_from_angles(*self.ship_angles)
        return rotation_nd @ rotation_from_angles(angles[..., 0], angles[..., 1], angles[..., 2])

    def _combined_attitude(self, angles: FloatArray) -> tuple[JointAttitude, FloatArray, FloatArray]:
        """Return joint attitude, rotations "horizon from sensor" (..., N, 3, 3), common effects (..., N, 3, 4)."""
        rotations_ns = self._rotations_ns(angles)
        # Noise and installation error turn about the same axes: R_star = R_ship R_0 exp(m) exp(n).
        variances = self.noise_sigmas**2 + self.installation_sigmas**2
        own = (rotations_ns * variances[..., None, :]) @ np.swapaxes(rotations_ns, -1, -2)
        effects = _common_effects(rotations_ns)
        return combine_attitudes(own, effects, np.diag(self.common_sigmas**2)), rotations_ns, effects


def _common_effects(rotations_ns: FloatArray) -> FloatArray:
    """Return the rotation vectors due to unit common errors, in the order of ``common_sigmas``, shape (..., N, 3, 4).

    The effect of refraction is NaN for a boresight below the minimum elevation.
    """
    star = angles_from_rotation(rotations_ns)
    azimuth, elevation = star[..., 0], star[..., 1]
    seen = np.rad2deg(elevation) >= MIN_ELEVATION_DEG - 1e-9
    cotangent = np.where(seen, 1.0 / np.tan(np.where(seen, elevation, 1.0)), np.nan)
    raising = rotation_vector_from_angle_errors(azimuth, elevation)[..., 1] * cotangent[..., None]
    horizon = np.broadcast_to(np.eye(3), (*azimuth.shape, 3, 3))
    return np.concatenate([horizon, raising[..., None]], axis=-1)


@dataclass(frozen=True)
class ErrorMap:
    """The joint error as a function of one sensor's mounting, with the other sensors fixed.

    Attributes:
        sensor: sensor that is moved.
        azimuths_deg: azimuths of the map, shape (a,).
        elevations_deg: elevations of the map, shape (e,).
        sigmas_arcsec: sigmas of heading, pitch, roll, shape (e, a, 3); NaN where the boresight is too low.
    """

    sensor: str
    azimuths_deg: FloatArray
    elevations_deg: FloatArray
    sigmas_arcsec: FloatArray

    def total_arcsec(self) -> FloatArray:
        """Return the root sum of squares of the three sigmas, shape (e, a)."""
        return total_arcsec(self.sigmas_arcsec)


def error_map(layout: Layout, number: int, step_deg: float = 2.5) -> ErrorMap:
    """Return the map of one sensor of a layout."""
    azimuths_deg = np.arange(0.0, 360.0 + step_deg / 2.0, step_deg)
    elevations_deg = np.arange(MIN_ELEVATION_DEG, 85.0 + step_deg / 2.0, step_deg)
    angles = np.tile(layout.angles, (elevations_deg.size, azimuths_deg.size, 1, 1))
    angles[:, :, number, 0] = np.deg2rad(azimuths_deg)
    angles[:, :, number, 1] = np.deg2rad(elevations_deg)[:, None]
    return ErrorMap(layout.names[number], azimuths_deg, elevations_deg, layout.sigmas_arcsec(angles))


def total_arcsec(sigmas_arcsec: FloatArray) -> FloatArray:
    """Return the figure of merit of a layout: root sum of squares of heading, pitch and roll."""
    total: FloatArray = np.sqrt(np.sum(sigmas_arcsec**2, axis=-1))
    return total

"""Error budget of a layout: joint error of all sensors, its parts by error source, and the maximum size of each error.

The joint error is also computed as a function of one sensor's mounting. The maximum size of an error is that for which
the requirement is met. If all errors are scaled by one factor, the joint error scales by the same factor, because the
best combination stays the same. *Together*, all errors meet the requirement if each is divided by the requirement use,
the ratio of sigma to limit of the worst angle. *Alone*, with the other errors unchanged, an error may grow until the
worst angle reaches its limit; the sensors are then combined with their new covariances. An error that another sensor
compensates may have any size.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

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
from ship_studies.layout.installation_model import JointAttitude, combine_attitudes, rotations

_AXES = ("forward", "up", "right")
_COMMON = (
    ("horizon about North", "tilt"),
    ("horizon about the vertical", "heading"),
    ("horizon about East", "tilt"),
    ("refraction", "refraction"),
)
"""The errors that sensors share, as text and as parameter, in the order of ``Layout.common_sigmas``."""
_COMMON_ERRORS = {"tilt": ("horizon", [0, 2]), "heading": ("clock", [1]), "refraction": ("refraction", [3])}
"""Parameter of a common error → its kind, and its indices in ``Layout.common_sigmas``."""
_HEADING = 0.0
"""Heading of the ship, rad: no error depends on it."""

MAX_ERROR_ARCSEC = 36_000.0
"""Largest error of a study, arcseconds; an error that is allowed to exceed this value may have any size."""
_MIN_NOISE_ARCSEC = 0.001
"""Minimum noise of a sensor, arcseconds: the covariance of zero noise is singular."""
_HALVINGS = 40


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
        return rotation_from_angles(*self.ship_angles) @ rotations(angles)

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


@dataclass(frozen=True)
class Allocation:
    """Maximum size of one error.

    Attributes:
        key: parameter of the study that sets the error.
        kind: "star noise", "installation", "refraction", "horizon" or "clock".
        sigma_arcsec: present size of the error.
        share: present fraction of the variance due to the error, for the angle that uses most of its limit.
        together_arcsec: maximum size of the error if all errors are scaled equally.
        alone_arcsec: maximum size of the error with the other errors unchanged; infinite if any size is allowed, NaN
            if the requirement is not met even without the error.
    """

    key: str
    kind: str
    sigma_arcsec: float
    share: float
    together_arcsec: float
    alone_arcsec: float


def requirement_use(sigmas_arcsec: FloatArray, limits_arcsec: FloatArray) -> FloatArray:
    """Return the ratio of sigma to limit of the worst angle, shape (...); NaN if a required angle is not known.

    Args:
        sigmas_arcsec: standard deviations of heading, pitch, roll, shape (..., 3).
        limits_arcsec: limits of these angles, shape (3,); infinite for an angle without requirement.
    """
    is_limited = np.isfinite(limits_arcsec)
    use: FloatArray = np.max(sigmas_arcsec[..., is_limited] / limits_arcsec[is_limited], axis=-1)
    return use


def binding_angle(sigmas_arcsec: FloatArray, limits_arcsec: FloatArray) -> int:
    """Return the index of the angle (heading, pitch, roll) that uses most of its limit."""
    return int(np.argmax(np.asarray(sigmas_arcsec) / limits_arcsec))


def allocate_errors(layout: Layout, limits_arcsec: FloatArray) -> list[Allocation]:
    """Return the maximum sizes of a layout's errors, the error with the largest share first.

    Args:
        layout: layout whose sigmas are known.
        limits_arcsec: maximum sigma of heading, pitch, roll, shape (3,); infinite for an angle without requirement.
    """
    sigmas = layout.sigmas_arcsec()
    use, angle = float(requirement_use(sigmas, limits_arcsec)), binding_angle(sigmas, limits_arcsec)
    shares: dict[str, float] = {}
    for source in layout.budget():
        part = float((source.errors_arcsec[angle] / sigmas[angle]) ** 2)
        shares[source.key] = shares.get(source.key, 0.0) + part
    rows = []
    for error in _errors(layout):
        sigma = error.sigma_arcsec(layout)
        alone = _max_alone_arcsec(layout, error, limits_arcsec)
        rows.append(Allocation(error.key, error.kind, sigma, shares.get(error.key, 0.0), sigma / use, alone))
    return sorted(rows, key=lambda row: -row.share)


@dataclass(frozen=True)
class _Error:
    """One error, with the field of a layout that contains the error, and the index in that field."""

    key: str
    kind: str
    field: str
    index: tuple[int | list[int], ...]
    least_arcsec: float

    def sigma_arcsec(self, layout: Layout) -> float:
        return float(np.max(getattr(layout, self.field)[self.index])) / ARCSEC

    def with_sigma(self, layout: Layout, sigma_arcsec: float) -> Layout:
        """Return the layout with another size of this error."""
        sigmas = getattr(layout, self.field).copy()
        sigmas[self.index] = ARCSEC * max(sigma_arcsec, self.least_arcsec)
        changed: Layout = replace(layout, **{self.field: sigmas})
        return changed


def _errors(layout: Layout) -> Iterator[_Error]:
    for number, name in enumerate(layout.names):
        for axis, axis_name in enumerate(_AXES):
            key = f"sensors.{name}.sigma_{axis_name}_arcsec"
            yield _Error(key, "star noise", "noise_sigmas", (number, axis), _MIN_NOISE_ARCSEC)
        for axis, axis_name in enumerate(_AXES):
            key = f"sensors.{name}.installation_sigma_{axis_name}_arcsec"
            yield _Error(key, "installation", "installation_sigmas", (number, axis), 0.0)
    for name, (kind, indices) in _COMMON_ERRORS.items():
        yield _Error(f"common.{name}_sigma_arcsec", kind, "common_sigmas", (indices,), 0.0)


def _max_alone_arcsec(layout: Layout, error: _Error, limits_arcsec: FloatArray) -> float:
    """Return the largest sigma of one error that meets the requirement; the joint error grows with this sigma.

    Infinite if any size meets the requirement, NaN if no size meets it.
    """

    def is_met(sigma_arcsec: float) -> bool:
        return bool(requirement_use(error.with_sigma(layout, sigma_arcsec).sigmas_arcsec(), limits_arcsec) <= 1.0)

    if not is_met(0.0):
        return float("nan")
    if is_met(MAX_ERROR_ARCSEC):
        return float("inf")
    low, high = 0.0, MAX_ERROR_ARCSEC
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_met(middle) else (low, middle)
    return low

"""Conversion of a star tracker's attitude against the ICRS into the horizon, with the same sky model as single stars.

A tracker matches the stars in its field with a catalogue and does not model the air. Refraction raises all its stars,
so its attitude is rotated the other way. The rotation by refraction at the boresight must therefore be added. The same
holds for aberration where the tracker does not correct it.

Refraction varies over the field. It compresses the image horizontally by ρ tan E and vertically by -dρ/dE, both in
radians per radian (ρ the refraction, E the elevation). No rotation represents a compression. The
residual error of the tracker's attitude depends on the positions of its stars, which the tracker does not report, and
lasts as long as they stay there. Each tracker therefore has a correlated error of its own.
"""

import numpy as np

from ship_attitude_star.measurements.readings import FieldOfView, InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement, SolvedAttitude
from ship_attitude_star.sky.sky_model import LocalSky, SkyModel
from ship_attitude_star.sky.solved_attitude import separate_shared_errors
from ship_estimation.rejections import Rejection
from ship_geometry.refraction import elevation_of, raising_axis
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation

_ASSUMED_STARS = 5
"""Assumed number of stars in an attitude, anywhere in the field; more stars would reduce the error."""

_MAX_ABERRATION = 20.5 * ARCSEC


def to_horizon_attitude(
    attitude: InertialAttitude | SolvedAttitude, sky_model: SkyModel
) -> AttitudeMeasurement | Rejection:
    """Return the attitude in the horizon, with the shared errors of refraction, Earth rotation and position.

    Args:
        attitude: against the ICRS, or already in the horizon as computed by a sensor.
        sky_model: the sky model.

    Returns:
        The rejection if no star can be placed at that time, or if the boresight is below the elevation range of the
        refraction model.
    """
    local_sky = sky_model.sky_at(attitude.time_ns)
    if isinstance(local_sky, Rejection):
        return local_sky
    return (
        separate_shared_errors(attitude, local_sky)
        if isinstance(attitude, SolvedAttitude)
        else _convert_to_horizon(attitude, local_sky)
    )


def _convert_to_horizon(inertial: InertialAttitude, local_sky: LocalSky) -> AttitudeMeasurement | Rejection:
    """Convert an attitude against the ICRS into the horizon."""
    field = inertial.field
    airless_ns = local_sky.rotation_horizon_from_icrs() @ inertial.rotation_cs
    if not field.aberration_removed:
        forward = airless_ns[:, 0]
        airless_ns = exp_rotation(np.cross(forward, local_sky.aberration_at(forward))) @ airless_ns
    forward = airless_ns[:, 0]
    elevation = float(elevation_of(forward))
    angle, sigma = local_sky.refraction_at(elevation)
    if not np.isfinite(angle):
        return local_sky.low_elevation_rejection(elevation)
    lift = raising_axis(forward)
    mean_extra_lift, common_n = _field_refraction(field, local_sky, elevation, angle, forward)
    shared_n = np.column_stack([sigma * lift, local_sky.sky_rotations().T])
    return AttitudeMeasurement(
        inertial.source,
        inertial.time_ns,
        exp_rotation((angle + mean_extra_lift) * lift) @ airless_ns,
        inertial.noise_s,
        common_n,
        covariance_known=inertial.covariance_known,
        shared_n=shared_n,
    )


def _field_refraction(
    field: FieldOfView, local_sky: LocalSky, elevation: float, angle: float, forward: FloatArray
) -> tuple[float, FloatArray]:
    """Return the effect of refraction on the attitude in addition to raising the boresight by ``angle``.

    The stars are assumed uniformly distributed over a disc of radius F. Each axis of a star's position then has the
    variance F²/4, and that of the mean of n stars F²/(4 n). The compression shifts the mean. It also rotates the field
    about the boresight where the stars lie along a diagonal: their Σxy/Σr² has the variance 1/(6 (n - 1)), for any F.

    Returns:
        Mean additional lift by the second derivative of refraction, rad; covariance of the remaining error, rotation
        vector in the horizon frame, rad², shape (3, 3).
    """
    if field.radius == 0.0:
        return 0.0, np.zeros((3, 3))
    slope, curvature = local_sky.refraction_slopes_at(elevation)
    # ρ tan E; at the zenith it equals -dρ/dE.
    sideways = angle * np.tan(elevation) if elevation < 0.5 * np.pi - 1e-6 else -slope
    middle = field.radius / (2.0 * np.sqrt(_ASSUMED_STARS))
    aberration = 0.0 if field.aberration_removed else _MAX_ABERRATION
    lift, about = raising_axis(forward), np.outer(forward, forward)
    common_n = (sideways**2 + aberration**2) * middle**2 * (np.eye(3) - about)
    mean_extra_lift = field.radius**2 / 8.0 * (curvature + 2.0 * angle)
    # dρ/dE also varies over the field; near the horizon the variation is as large as dρ/dE.
    uneven = (0.5 * field.radius * curvature) ** 2
    common_n += ((slope**2 + uneven - sideways**2) * middle**2 + mean_extra_lift**2 / _ASSUMED_STARS) * np.outer(
        lift, lift
    )
    common_n += ((slope + sideways) ** 2 + uneven) / (6.0 * (_ASSUMED_STARS - 1)) * about
    return mean_extra_lift, common_n

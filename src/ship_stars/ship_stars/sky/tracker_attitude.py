"""Conversion of a star tracker's attitude from the ICRS to the horizon, with the same sky model as for single stars.

A tracker matches the stars in its field with a catalogue and does not model the air. Refraction raises all stars, so
the attitude is rotated the other way. The rotation by refraction at the boresight must therefore be added, and likewise
the rotation by aberration if the tracker does not correct aberration.

Refraction varies over the field and compresses the image horizontally by ρ tan E and vertically by -dρ/dE, both in
radians per radian (ρ is the refraction, E the elevation). A rotation cannot correct this compression. The remaining
error of the attitude depends on the positions of the stars in the field, which the tracker does not report. This error
is constant while the stars stay in place, so each tracker has a correlated error.
"""

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_geometry.air.refraction import elevation_of, raising_axis
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_stars.samples.attitude_samples import AttitudeMeasurement, SolvedAttitude
from ship_stars.samples.readings import FieldOfView, InertialAttitude
from ship_stars.sky.sky_model import LocalSky, SkyModel
from ship_stars.sky.solved_attitude import separate_shared_errors

_ASSUMED_STARS = 5
"""Assumed number of stars in an attitude, anywhere in the field; more stars would reduce the error."""

_MAX_ABERRATION = 20.5 * ARCSEC


def to_horizon_attitude(
    attitude: InertialAttitude | SolvedAttitude, sky_model: SkyModel
) -> AttitudeMeasurement | Rejection:
    """Return the attitude in the horizon, with the shared errors of refraction, Earth rotation and position.

    Args:
        attitude: attitude in the ICRS, or attitude in the horizon computed by the sensor.
        sky_model: the sky model.

    Returns:
        The attitude, or a rejection if the sky model gives no directions at the time of the attitude. An attitude in
        the ICRS is also rejected if its boresight is below the elevation range of the refraction model.
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
    """Convert an attitude in the ICRS into an attitude in the horizon."""
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

    The stars are assumed to be uniformly distributed over a disc of radius F. Each coordinate of a star then has the
    variance F²/4, and the mean of n stars has the variance F²/(4 n). The compression shifts this mean. It also rotates
    the field about the boresight if the stars are along a diagonal; Σxy/Σr² of the stars has the variance
    1/(6 (n - 1)), for any F.

    Returns:
        Mean additional lift due to the second derivative of refraction, rad.
        Covariance of the remaining error, rotation vector in the horizon frame, rad², shape (3, 3). The covariance
            includes the variation of aberration over the field if the tracker does not correct aberration.
    """
    if field.radius == 0.0:
        return 0.0, np.zeros((3, 3))
    slope, curvature = local_sky.refraction_slopes_at(elevation)
    # Horizontal compression ρ tan E; at the zenith it is equal to -dρ/dE.
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

"""Attitudes solved by a sensor: conversion from the ICRS to the horizon, and separation of the shared errors.

A tracker matches the stars in its field with a catalogue and does not model the air. Refraction raises all stars, so
the attitude is rotated the other way. The rotation by refraction at the boresight must therefore be added, and likewise
the rotation by aberration if the tracker does not correct aberration.

Refraction varies over the field and compresses the image horizontally by ρ tan E and vertically by -dρ/dE, both in
radians per radian (ρ is the refraction, E the elevation). A rotation cannot correct this compression. The remaining
error of the attitude depends on the positions of the stars in the field, which the tracker does not report. This error
is constant while the stars stay in place, so each tracker has a correlated error.

A sensor that solves its attitude relative to the horizon computes the directions of its stars with the same fix, UT1
and air data as all other sensors on board. The errors of these data are part of the covariance in its message. As
errors of the sensor, these errors would seem to average over the sensors. Here they become errors common to all
sensors:

- An error of UT1 or of the position rotates the whole sky, whatever stars were observed
  (:meth:`LocalSky.sky_rotations`).
- An error of refraction raises the stars of a sensor, and rotates the attitude about the horizontal axis perpendicular
  to the boresight, and slightly about other axes if the stars are unevenly distributed. The part of the remaining
  covariance correlated with the rotation about that axis is attributed to refraction, up to a maximum.

The remainder is the error of the sensor itself. The covariance of the remainder is non-negative in every direction:
for a covariance C and a direction u, C - C u uᵀ C / (uᵀ C u) is C conditioned on the component along u.
"""

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_geometry.air.refraction import elevation_of, raising_axis, refraction_slopes
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_stars.attitude_samples import AttitudeMeasurement, FieldOfView, InertialAttitude, SolvedAttitude
from ship_stars.sky.sky_model import LocalSky, SkyModel

_ROUNDING_RATIO = 1e-9
"""Ratio of a variance to the total variance below which the variance is set to zero as a rounding error."""

_LOW_STARS_FACTOR = 1.5
"""Maximum ratio of the mean refraction error of a field's stars to the refraction error at the boresight.

The ratio is 1.4 for stars 10° below a boresight at 45°, and for stars 7° below a boresight at 25°.
"""

_ASSUMED_STARS = 5
"""Assumed number of stars in an attitude, anywhere in the field; more stars would reduce the error."""

_MAX_ABERRATION = 20.5 * ARCSEC


def separate_shared_errors(solved: SolvedAttitude, local_sky: LocalSky) -> AttitudeMeasurement:
    """Return the attitude with ``shared_n``; its noise and common error no longer contain the shared errors.

    If the message states noise and total error separately, the shared errors are part of the difference. If the message
    states one covariance, the shared errors are part of this covariance. If the message states no covariance, the
    noise is the configured noise, and ``shared_n`` contains the errors of the sky model.

    Args:
        solved: attitude computed by the sensor.
        local_sky: the sky at the time of the attitude.
    """
    rotation_ns, turns_n = solved.rotation_nv, local_sky.sky_rotations().T
    noise_n = rotation_ns @ solved.noise_v @ rotation_ns.T
    # The axis about which refraction raises the boresight; the sigma is NaN below the range of the refraction model.
    lift, sigma = raising_axis(rotation_ns[:, 0]), local_sky.refraction_at(float(elevation_of(rotation_ns[:, 0])))[1]
    if not solved.covariance_known:
        stated_n, lifted_n = np.zeros((3, 3)), (sigma if np.isfinite(sigma) else 0.0) * lift
    elif solved.has_noise_covariance:
        remaining_n = _without_sky_rotations(solved.common_n, turns_n)
        stated_n, lifted_n = _split_refraction(remaining_n, lift, _LOW_STARS_FACTOR * sigma)
    else:
        stated_n, lifted_n = _split_refraction(_without_sky_rotations(noise_n, turns_n), lift, sigma)
    has_one_covariance = solved.covariance_known and not solved.has_noise_covariance
    return AttitudeMeasurement(
        solved.source,
        solved.time_ns,
        rotation_ns,
        rotation_ns.T @ stated_n @ rotation_ns if has_one_covariance else solved.noise_v,
        np.zeros((3, 3)) if has_one_covariance else stated_n,
        covariance_known=solved.covariance_known,
        shared_n=np.column_stack([lifted_n, turns_n]),
    )


def _without_sky_rotations(stated_n: FloatArray, turns_n: FloatArray) -> FloatArray:
    """Return a stated covariance without given rotations of the whole sky; it is non-negative in every direction.

    Args:
        stated_n: stated covariance, rad², shape (3, 3).
        turns_n: rotation vectors by one sigma of each of n errors, as columns, rad, shape (3, n).
    """
    values, vectors = np.linalg.eigh(stated_n - turns_n @ turns_n.T)
    nonnegative = np.where(values > _ROUNDING_RATIO * np.trace(stated_n), values, 0.0)
    remaining: FloatArray = (vectors * nonnegative) @ vectors.T
    return remaining


def _split_refraction(stated_n: FloatArray, lift: FloatArray, most: float) -> tuple[FloatArray, FloatArray]:
    """Return the covariance without refraction, and the rotation vector by one sigma of refraction, rad.

    Args:
        stated_n: stated covariance, rad², shape (3, 3).
        lift: axis about which refraction raises the boresight, shape (3,).
        most: maximum component of the rotation vector along this axis, rad.
    """
    along = float(np.sqrt(max(float(lift @ stated_n @ lift), 0.0)))
    # ``most`` is NaN outside the model's range. The comparison is then False, and the refraction has no maximum.
    share = most / along if most < along else 1.0
    turn_n = stated_n @ lift * (share / along) if along > 0.0 else np.zeros(3)
    left_n = stated_n - np.outer(turn_n, turn_n)
    return 0.5 * (left_n + left_n.T), turn_n


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
    if isinstance(attitude, SolvedAttitude):
        return separate_shared_errors(attitude, local_sky)
    return _convert_to_horizon(attitude, local_sky)


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
    slope, curvature = refraction_slopes(local_sky.model, elevation, local_sky.air.weather, local_sky.wavelength_um)
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

"""The attitude of a star tracker against the ICRS → its attitude in the horizon, by the same sky as single stars.

A tracker compares the stars that it sees with a catalogue, and knows nothing of the air: a star that refraction lifts
looks to it like one that stands higher. The turn by refraction at the boresight must therefore be added. The same holds
for aberration where the tracker has not taken it out.

Refraction is not the same all over the field. It squeezes the picture, towards the vertical by ρ tan E and along the
vertical by -dρ/dE, both in radians per radian (ρ the refraction, E the elevation). No turn can follow a squeeze. What
of it remains in the tracker's attitude depends on where its stars happen to stand, which the tracker does not tell, and
lasts as long as they stand there: each tracker has a slow error of its own.
"""

import numpy as np

from ship_attitude_star.measurements.readings import FieldOfView, InertialAttitude
from ship_attitude_star.measurements.samples import AttitudeMeasurement, SolvedAttitude
from ship_attitude_star.sky.sky_watch import SkyMoment, SkyWatch
from ship_attitude_star.sky.solved_attitude import shared_told_apart
from ship_estimation.refusals import Refusal
from ship_geometry.refraction import elevation_of, lifting_axis
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation

_STARS = 5
"""Number of stars, anywhere in the field, that are taken to make an attitude; more stars would make the error less."""

_GREATEST_ABERRATION = 20.5 * ARCSEC


def in_horizon(attitude: InertialAttitude | SolvedAttitude, watch: SkyWatch) -> AttitudeMeasurement | Refusal:
    """The attitude in the horizon, with the errors of refraction, Earth rotation and position that it shares.

    Args:
        attitude: against the ICRS, or by a sensor that has found the horizon itself.
        watch: the sky.

    Returns:
        The refusal where no star can be placed at that moment, or the boresight is lower than the refraction model
        holds.
    """
    moment = watch.at(attitude.time_ns)
    if isinstance(moment, Refusal):
        return moment
    return shared_told_apart(attitude, moment) if isinstance(attitude, SolvedAttitude) else _turned(attitude, moment)


def _turned(inertial: InertialAttitude, moment: SkyMoment) -> AttitudeMeasurement | Refusal:
    """An attitude against the ICRS, turned into the horizon."""
    field = inertial.field
    bare_ns = moment.rotation_horizon_from_icrs() @ inertial.rotation_cs
    if not field.aberration_removed:
        forward = bare_ns[:, 0]
        bare_ns = exp_rotation(np.cross(forward, moment.aberration_at(forward))) @ bare_ns
    forward = bare_ns[:, 0]
    elevation = float(elevation_of(forward))
    angle, sigma = moment.refraction_at(elevation)
    if not np.isfinite(angle):
        return moment.too_low(elevation)
    lift = lifting_axis(forward)
    bent, common_n = _over_the_field(field, moment, elevation, angle, forward)
    shared_n = np.column_stack([sigma * lift, moment.turns().T])
    return AttitudeMeasurement(
        inertial.source,
        inertial.time_ns,
        exp_rotation((angle + bent) * lift) @ bare_ns,
        inertial.noise_s,
        common_n,
        covariance_known=inertial.covariance_known,
        shared_n=shared_n,
    )


def _over_the_field(
    field: FieldOfView, moment: SkyMoment, elevation: float, angle: float, forward: FloatArray
) -> tuple[float, FloatArray]:
    """What refraction does to the attitude beside lifting the boresight by ``angle``.

    The stars are taken to be spread evenly over a disc of radius F. Each axis of a star's place then has the variance
    F²/4, and that of the middle of n stars F²/(4 n). The squeeze moves the middle. It also turns the field about the
    boresight where the stars lie along a diagonal: their Σxy/Σr² has the variance 1/(6 (n - 1)), whatever F.

    Returns:
        How much more the lift is on the average, by the curvature of refraction, rad; and the covariance of the rest,
        rotation vector in the horizon frame, rad², shape (3, 3).
    """
    if field.radius == 0.0:
        return 0.0, np.zeros((3, 3))
    slope, curvature = moment.refraction_slopes_at(elevation)
    # ρ tan E; at the zenith the slope is as good.
    towards = angle * np.tan(elevation) if elevation < 0.5 * np.pi - 1e-6 else -slope
    middle = field.radius / (2.0 * np.sqrt(_STARS))
    left_in = 0.0 if field.aberration_removed else _GREATEST_ABERRATION
    lift, about = lifting_axis(forward), np.outer(forward, forward)
    common_n = (towards**2 + left_in**2) * middle**2 * (np.eye(3) - about)
    bent = field.radius**2 / 8.0 * (curvature + 2.0 * angle)
    # The slope itself changes over the field, near the horizon by as much as it is.
    uneven = (0.5 * field.radius * curvature) ** 2
    common_n += ((slope**2 + uneven - towards**2) * middle**2 + bent**2 / _STARS) * np.outer(lift, lift)
    common_n += ((slope + towards) ** 2 + uneven) / (6.0 * (_STARS - 1)) * about
    return bent, common_n

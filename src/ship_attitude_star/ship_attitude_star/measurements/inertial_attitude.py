"""The attitude of a star tracker against the ICRS → its attitude in the horizon, by the same sky as single stars.

A tracker compares the stars that it sees with a catalogue. Of the air it knows nothing: it takes a star that is seen
lifted for one that stands higher, so the turn by refraction at the boresight comes on top. Aberration does the same
where the tracker has not taken it out.

Refraction is not the same all over the field: it squeezes the picture, towards the vertical by ρ tan E and along it by
-dρ/dE, both in radians per radian. A turn cannot follow that. What stays in the tracker's attitude depends on where its
stars happen to stand, which it does not tell, and lasts as long as they stand there: a slow error of each tracker.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.sky.apparent_sky import Sky
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.surroundings import Air
from ship_attitude_star.stars.star_config import AT_BORESIGHT, FieldOfView
from ship_estimation.refusals import Refusal
from ship_geometry.refraction import elevation_of, lifting_axis
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation

_STARS = 5
"""So many stars, anywhere in the field, are taken to make an attitude: of more the error is less."""

_GREATEST_ABERRATION = 20.5 * ARCSEC


@dataclass(frozen=True)
class InertialAttitude:
    """What a star tracker puts out.

    Attributes:
        source: ``star.<id>``.
        time_ns: middle of the exposure, stamp of the sensor.
        rotation_cs: celestial (ICRS) axes from sensor (forward, up, right), shape (3, 3).
        noise_s: covariance of the error, rotation vector in the sensor frame, rad², shape (3, 3).
        covariance_known: False where the message gave none and the configured sigma stands in.
        field: through which it saw the stars.
    """

    source: str
    time_ns: int
    rotation_cs: FloatArray
    noise_s: FloatArray
    covariance_known: bool = True
    field: FieldOfView = AT_BORESIGHT

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.rotation_cs.tobytes() + self.noise_s.tobytes()


def in_horizon(inertial: InertialAttitude, watch: SkyWatch) -> AttitudeMeasurement | Refusal:
    """The same attitude in the horizon, with what refraction, Earth rotation and position may have wrong.

    Args:
        inertial: the attitude.
        watch: the sky.

    Returns:
        The refusal where there is no sky to compare with, or the boresight is lower than the refraction model holds.
    """
    time_ns, field = inertial.time_ns, inertial.field
    refusal = watch.reason_against(time_ns)
    if refusal is not None:
        return refusal
    place, air = watch.surroundings(time_ns)
    bare_ns = watch.sky.rotation_horizon_from_icrs(time_ns, place) @ inertial.rotation_cs
    if not field.aberration_removed:
        forward = bare_ns[:, 0]
        bare_ns = exp_rotation(np.cross(forward, watch.sky.aberration_at(forward, time_ns, place))) @ bare_ns
    forward = bare_ns[:, 0]
    elevation = float(elevation_of(forward))
    angle, sigma = watch.sky.refraction_at(elevation, air)
    if not np.isfinite(angle):
        return watch.sky.too_low(elevation)
    lift = lifting_axis(forward)
    bent, common_n = _over_the_field(field, watch.sky, air, elevation, angle, forward)
    shared_n = np.column_stack([sigma * lift, watch.sky.turns(time_ns, place).T])
    return AttitudeMeasurement(
        inertial.source,
        time_ns,
        exp_rotation((angle + bent) * lift) @ bare_ns,
        inertial.noise_s,
        common_n,
        covariance_known=inertial.covariance_known,
        shared_n=shared_n,
    )


def _over_the_field(
    field: FieldOfView, sky: Sky, air: Air, elevation: float, angle: float, forward: FloatArray
) -> tuple[float, FloatArray]:
    """What refraction does beside lifting the boresight by ``angle``.

    With stars spread evenly over a disc of radius F, each axis of a star's place has the variance F²/4, that of the
    middle of n stars F²/(4 n). The squeeze moves the middle; and it turns the field about the boresight where the
    stars lie across a diagonal: their Σxy/Σr² has the variance 1/(6 (n - 1)), whatever F.

    Returns:
        What the lift is more on the average, by its curvature, rad; and the covariance of the rest, rotation vector in
        the horizon frame, rad², shape (3, 3).
    """
    if field.radius == 0.0:
        return 0.0, np.zeros((3, 3))
    slope, curvature = sky.refraction_slopes_at(elevation, air)
    # ρ tan E, which at the zenith is as good as the slope.
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

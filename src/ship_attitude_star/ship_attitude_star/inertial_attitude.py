"""The attitude of a star tracker against the ICRS → its attitude in the horizon, by the same sky as single stars.

The tracker has taken annual aberration out (its quaternion is against the ICRS); the chain puts it back with everything
else between the catalogue and the horizon. Air lifts the boresight: refraction is a turn there, as the tracker's own
mean over its field sees it.
"""

from dataclasses import dataclass

import erfa
import numpy as np

from ship_attitude_star.samples import AttitudeMeasurement, Refusal
from ship_attitude_star.sky_watch import SkyWatch
from ship_geometry.refraction import elevation_of
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_geometry.star_directions import fixed_stars

# Of the second direction from the boresight, rad: small against the field in which aberration is a turn, large against
# rounding.
_APART = 1e-3


@dataclass(frozen=True)
class InertialAttitude:
    """What a star tracker puts out.

    Attributes:
        source: ``star.<id>``.
        time_ns: middle of the exposure, stamp of the sensor.
        rotation_cs: celestial (ICRS) axes from sensor (forward, up, right), shape (3, 3).
        noise_s: covariance of the error, rotation vector in the sensor frame, rad², shape (3, 3).
        covariance_known: False where the message gave none and the configured sigma stands in.
    """

    source: str
    time_ns: int
    rotation_cs: FloatArray
    noise_s: FloatArray
    covariance_known: bool = True

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.rotation_cs.tobytes() + self.noise_s.tobytes()


def in_horizon(inertial: InertialAttitude, watch: SkyWatch) -> AttitudeMeasurement | Refusal:
    """The same attitude in the horizon, with what refraction, Earth rotation and position may have wrong.

    Args:
        inertial: at a moment that the watch's ``reason_against`` has nothing against.
        watch: the sky.

    Returns:
        The refusal where the boresight is lower than the refraction model holds.
    """
    time_ns, rotation_cs = inertial.time_ns, inertial.rotation_cs
    place, air = watch.surroundings(time_ns)
    beside = rotation_cs[:, 0] + _APART * rotation_cs[:, 1]
    celestial = np.stack([rotation_cs[:, 0], beside / np.linalg.norm(beside)])
    forward, towards_up = watch.sky.without_air(fixed_stars(*erfa.c2s(celestial)), time_ns, place)
    elevation = float(elevation_of(forward))
    angle, sigma = watch.sky.refraction_at(elevation, air)
    if not np.isfinite(angle):
        return watch.sky.too_low(elevation)
    up = towards_up - (towards_up @ forward) * forward
    up /= np.linalg.norm(up)
    without_air_ns = np.stack([forward, up, np.cross(forward, up)], axis=-1)
    # Lifting turns about the level axis on the left of the direction: forward × Up.
    level = np.array([-forward[2], 0.0, forward[0]])
    lift = level / np.linalg.norm(level)
    shared_n = np.column_stack([sigma * lift, watch.sky.turns(time_ns, place).T])
    return AttitudeMeasurement(
        inertial.source,
        time_ns,
        exp_rotation(angle * lift) @ without_air_ns,
        inertial.noise_s,
        covariance_known=inertial.covariance_known,
        shared_n=shared_n,
    )

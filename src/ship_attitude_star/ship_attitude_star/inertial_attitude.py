"""The attitude of a star tracker against the ICRS → its attitude in the horizon, by the same sky as single stars.

The tracker has taken aberration out of what it sees: its quaternion turns bodies, so the Earth's rotation alone brings
it to the horizon. Of the air it knows nothing: it takes a star that is seen lifted for one that stands higher, so the
turn by refraction at the boresight comes on top.
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.samples import AttitudeMeasurement
from ship_attitude_star.sky_watch import SkyWatch
from ship_estimation.refusals import Refusal
from ship_geometry.refraction import elevation_of, lifting_axis
from ship_geometry.rotations import FloatArray, exp_rotation


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
    time_ns = inertial.time_ns
    place, air = watch.surroundings(time_ns)
    without_air_ns = watch.sky.rotation_horizon_from_icrs(time_ns, place) @ inertial.rotation_cs
    forward = without_air_ns[:, 0]
    elevation = float(elevation_of(forward))
    angle, sigma = watch.sky.refraction_at(elevation, air)
    if not np.isfinite(angle):
        return watch.sky.too_low(elevation)
    lift = lifting_axis(forward)
    shared_n = np.column_stack([sigma * lift, watch.sky.turns(time_ns, place).T])
    return AttitudeMeasurement(
        inertial.source,
        time_ns,
        exp_rotation(angle * lift) @ without_air_ns,
        inertial.noise_s,
        covariance_known=inertial.covariance_known,
        shared_n=shared_n,
    )

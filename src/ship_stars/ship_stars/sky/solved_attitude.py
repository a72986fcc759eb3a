"""Separation of the errors of refraction, UT1 and ship's position from a horizon attitude computed by a sensor.

Such a sensor computes the directions of its stars with the same fix, UT1 and air data as all other sensors on board.
The errors of these data are part of the covariance in its message. As errors of the sensor, these errors would seem to
average over the sensors. Here they become errors common to all sensors:

- An error of UT1 or of the position rotates the whole sky, whatever stars were observed
  (:meth:`LocalSky.sky_rotations`).
- An error of refraction raises the stars of a sensor, and rotates the attitude about the horizontal axis perpendicular
  to the boresight, and slightly about other axes if the stars are unevenly distributed. The part of the remaining
  covariance correlated with the rotation about that axis is attributed to refraction, up to a maximum.

The remainder is the error of the sensor itself. The covariance of the remainder is non-negative in every direction:
for a covariance C and a direction u, C - C u uᵀ C / (uᵀ C u) is C conditioned on the component along u.
"""

import numpy as np

from ship_geometry.air.refraction import elevation_of, raising_axis
from ship_geometry.rotations import FloatArray
from ship_stars.samples.attitude_samples import AttitudeMeasurement, SolvedAttitude
from ship_stars.sky.sky_model import LocalSky

_ROUNDING_RATIO = 1e-9
"""Ratio of a variance to the total variance below which the variance is set to zero as a rounding error."""

_LOW_STARS_FACTOR = 1.5
"""Maximum ratio of the mean refraction error of a field's stars to the refraction error at the boresight.

The ratio is 1.4 for stars 10° below a boresight at 45°, and for stars 7° below a boresight at 25°.
"""


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
    lift, sigma = _refraction_lift(rotation_ns, local_sky)
    if not solved.covariance_known:
        stated_n, lifted_n = np.zeros((3, 3)), (sigma if np.isfinite(sigma) else 0.0) * lift
    elif solved.has_noise_covariance:
        stated_n, lifted_n = _split_refraction(
            _without_sky_rotations(solved.common_n, turns_n), lift, _LOW_STARS_FACTOR * sigma
        )
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


def _refraction_lift(rotation_ns: FloatArray, local_sky: LocalSky) -> tuple[FloatArray, float]:
    """Return the axis about which refraction raises the boresight, and the sigma of refraction at the boresight, rad.

    The sigma is NaN below the elevation range of the refraction model.
    """
    forward_n = rotation_ns[:, 0]
    return raising_axis(forward_n), local_sky.refraction_at(float(elevation_of(forward_n)))[1]


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

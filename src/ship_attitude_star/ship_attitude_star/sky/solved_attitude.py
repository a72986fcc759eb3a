"""Separation of shared errors from a horizon attitude computed by a sensor: refraction, UT1, the ship's position.

Such a sensor computes the directions of its stars with the same fix, UT1 and air data as any other sensor on board. The
errors of these are part of the covariance that its message states. If they were treated as errors of the sensor, they
would seem to average over the sensors. Here they become errors common to all sensors:

- An error of UT1 or of the position rotates the whole sky, whatever stars were seen: :meth:`LocalSky.sky_rotations`.
- An error of refraction raises the stars of a sensor. It rotates the attitude about the axis across the boresight, and
  slightly about other axes if the stars are unevenly distributed. It is the part of the remaining covariance that is
  correlated with that axis.

The remainder is the sensor's own error. It is non-negative in every direction: for a matrix C and a direction u, C - C
u uᵀ C / (uᵀ C u) is the covariance C conditioned on u.
"""

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeMeasurement, SolvedAttitude
from ship_attitude_star.sky.sky_model import LocalSky
from ship_geometry.refraction import elevation_of, raising_axis
from ship_geometry.rotations import FloatArray

_ROUNDING_RATIO = 1e-9
"""Ratio to the total variance below which a variance is rounding error and set to zero."""

_LOW_STARS_FACTOR = 1.5
"""Maximum ratio of the refraction error averaged over a field's stars to that at the boresight.

The ratio is 1.4 for stars 10° below a boresight at 45°, and for stars 7° below one at 25°.
"""


def separate_shared_errors(solved: SolvedAttitude, local_sky: LocalSky) -> AttitudeMeasurement:
    """Return the attitude with ``shared_n``; its noise and common error no longer contain these errors.

    Where the message states noise and total error separately, the shared errors are part of the difference. Where it
    states one covariance, they are part of that. Where it states none, they are added to the configured noise.

    Args:
        solved: the attitude.
        local_sky: the sky at its time.
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
    """Return the axis about which refraction rotates the boresight upwards, and the error of refraction there, rad.

    The error is NaN below the elevation range of the refraction model.
    """
    forward_n = rotation_ns[:, 0]
    return raising_axis(forward_n), local_sky.refraction_at(float(elevation_of(forward_n)))[1]


def _without_sky_rotations(stated_n: FloatArray, turns_n: FloatArray) -> FloatArray:
    """Return a stated covariance without rotations of the whole sky (3, n); non-negative in every direction."""
    values, vectors = np.linalg.eigh(stated_n - turns_n @ turns_n.T)
    nonnegative = np.where(values > _ROUNDING_RATIO * np.trace(stated_n), values, 0.0)
    remaining: FloatArray = (vectors * nonnegative) @ vectors.T
    return remaining


def _split_refraction(stated_n: FloatArray, lift: FloatArray, most: float) -> tuple[FloatArray, FloatArray]:
    """Return the covariance without refraction, and the rotation by one sigma of refraction, rad.

    The component of the rotation along ``lift``, the axis about which refraction raises the boresight, is ``most`` at
    most.
    """
    along = float(np.sqrt(max(float(lift @ stated_n @ lift), 0.0)))
    # Written so that NaN, outside the model's range, uses the stated covariance.
    share = most / along if most < along else 1.0
    turn_n = stated_n @ lift * (share / along) if along > 0.0 else np.zeros(3)
    left_n = stated_n - np.outer(turn_n, turn_n)
    return 0.5 * (left_n + left_n.T), turn_n

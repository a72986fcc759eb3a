"""What an attitude that a sensor solved in the horizon shares with all others: refraction, UT1, the ship's position.

Such a sensor has placed its stars by the same fix, the same UT1 and the same air as any other aboard. These errors are
part of the covariance that its message states, and taken as its own they would seem to average over the sensors. Here
the sky tells them apart, so that each is one error for all:

- An error of UT1 or of the position turns the whole sky, whatever stars were seen: :meth:`SkyMoment.turns`.
- An error of refraction lifts the stars of a sensor, which turns its attitude about the axis across its boresight, and
  a little about others where the stars stand unevenly. Of what the message states beside the turns of the whole sky,
  it is the part that goes along with that axis.

What is left over is the sensor's own. It is at least zero in every direction: of a matrix C with a direction u,
C - C u uᵀ C / (uᵀ C u) is what remains of C when u is known.
"""

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeMeasurement, SolvedAttitude
from ship_attitude_star.sky.sky_watch import SkyMoment
from ship_geometry.refraction import elevation_of, lifting_axis
from ship_geometry.rotations import FloatArray

_NOTHING = 1e-9
"""A variance is zero that is this small a part of all that the message states: it is of rounding."""

_LOW_STARS = 1.5
"""How much more than at the boresight refraction may err in the mean of the stars of a field, where they stand low.

At 45° stars are 10° lower where it errs by 1.4 times as much, at 25° 7°."""


def shared_told_apart(solved: SolvedAttitude, moment: SkyMoment) -> AttitudeMeasurement:
    """The same attitude with ``shared_n``; noise and common error are without what is in it.

    Where the message tells noise and total error apart, the shared errors are part of the difference. Where it has one
    covariance for all, they are part of that. Where it has none, they come on top of the configured noise.

    Args:
        solved: the attitude.
        moment: the sky at that moment.
    """
    rotation_ns, turns_n = solved.rotation_nv, moment.turns().T
    noise_n = rotation_ns @ solved.noise_v @ rotation_ns.T
    lift, sigma = _lift(rotation_ns, moment)
    if not solved.covariance_known:
        stated_n, lifted_n = np.zeros((3, 3)), (sigma if np.isfinite(sigma) else 0.0) * lift
    elif solved.noise_told:
        stated_n, lifted_n = _by_refraction(_left_over(solved.common_n, turns_n), lift, _LOW_STARS * sigma)
    else:
        stated_n, lifted_n = _by_refraction(_left_over(noise_n, turns_n), lift, sigma)
    noise_is_left = solved.covariance_known and not solved.noise_told
    return AttitudeMeasurement(
        solved.source,
        solved.time_ns,
        rotation_ns,
        rotation_ns.T @ stated_n @ rotation_ns if noise_is_left else solved.noise_v,
        np.zeros((3, 3)) if noise_is_left else stated_n,
        covariance_known=solved.covariance_known,
        shared_n=np.column_stack([lifted_n, turns_n]),
    )


def _lift(rotation_ns: FloatArray, moment: SkyMoment) -> tuple[FloatArray, float]:
    """The axis about which refraction turns the boresight upwards, and the error of refraction there, rad.

    The error is NaN below the elevation that the refraction model holds for.
    """
    forward_n = rotation_ns[:, 0]
    return lifting_axis(forward_n), moment.refraction_at(float(elevation_of(forward_n)))[1]


def _left_over(stated_n: FloatArray, turns_n: FloatArray) -> FloatArray:
    """What a message states beside turns of the whole sky (3, n), at least zero in every direction."""
    values, vectors = np.linalg.eigh(stated_n - turns_n @ turns_n.T)
    kept = np.where(values > _NOTHING * np.trace(stated_n), values, 0.0)
    left: FloatArray = (vectors * kept) @ vectors.T
    return left


def _by_refraction(stated_n: FloatArray, lift: FloatArray, most: float) -> tuple[FloatArray, FloatArray]:
    """What is left without refraction, and the turn by one sigma of it, about ``lift`` at most by ``most``, rad."""
    along = float(np.sqrt(max(float(lift @ stated_n @ lift), 0.0)))
    # Written so that an elevation without a model leaves it to the message.
    share = most / along if most < along else 1.0
    turn_n = stated_n @ lift * (share / along) if along > 0.0 else np.zeros(3)
    left_n = stated_n - np.outer(turn_n, turn_n)
    return 0.5 * (left_n + left_n.T), turn_n

"""Propagation of an attitude over a short time after its sample, by measured rates or by differences of attitudes."""

import math

import numpy as np

from ship_geometry.rotations import FloatArray, exp_rotation
from ship_geometry.tracks.interpolation_error import ANY_DIRECTION, as_covariance
from ship_kernels import compiled_rotations

_WORST_OF_DIFFERENCED = 0.0962
"""Greatest value of s (1 - s) (1 - 2 s), 0 < s < 1.

The error of a cubic with differenced rates is at most this value times step³ times the third divided difference."""

LARGEST_VARIANCE = np.pi**2
"""Maximum variance of an estimated error, rad²; no attitude error exceeds half a turn."""


def propagate_by_rates(
    rotation_nd: FloatArray, rates_d: FloatArray, steps_s: FloatArray, ahead_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Propagate N samples by short times, with their rates and angular accelerations.

    Args:
        rotation_nd: attitudes of the samples, shape (N, 3, 3).
        rates_d: rates of each sample and of the samples before it, newest first, rad/s, shape (N, k, 3), k at least 2.
        steps_s: intervals between these samples, s, shape (N, k - 1).
        ahead_s: time after each sample, s, negative for a time before the sample, shape (N,).

    Returns:
        Attitudes, rates (rad/s) and error covariances (rad²) as in
        :class:`ship_geometry.tracks.attitude_track.InterpolatedAttitude`.

    Example:
        A sample propagated by 10 ms at a constant 0.1 rad/s:

        >>> rates_d, steps_s = np.full((1, 4, 3), [0.1, 0.0, 0.0]), np.full((1, 3), 0.01)
        >>> from ship_geometry.rotations import log_rotation
        >>> moved_nd, _, _ = propagate_by_rates(np.eye(3)[None], rates_d, steps_s, np.array([0.01]))
        >>> print(log_rotation(moved_nd[0]).round(6))
        [0.001 0.    0.   ]
    """
    found: tuple[FloatArray, FloatArray, FloatArray] = compiled_rotations.propagate_by_rates(
        rotation_nd, rates_d, steps_s, ahead_s, ANY_DIRECTION, LARGEST_VARIANCE
    )
    return found


def propagate_by_differences(
    rotation_nd: FloatArray, turns: FloatArray, nodes_s: FloatArray, ahead_s: float
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Propagate a sample by a parabola through it and the two samples before; by a constant rate if there is only one.

    Args:
        rotation_nd: attitude of the sample, shape (3, 3).
        turns: rotation vectors from the sample to itself and to earlier samples, rad, shape (n, 3), n at least 2.
        nodes_s: times of these samples relative to the sample, s, newest first, shape (n,).
        ahead_s: time after the sample, s, negative for a time before the sample.

    Returns:
        Attitude, rate (rad/s), noise gain and error covariance (rad²) as in
        :class:`ship_geometry.tracks.attitude_track.InterpolatedAttitude`.

    Example:
        The rate after two samples that are 1 s and 0.1 rad apart:

        >>> turns, nodes_s = np.array([[0.0, 0.0, 0.0], [-0.1, 0.0, 0.0]]), np.array([0.0, -1.0])
        >>> print(np.abs(propagate_by_differences(np.eye(3), turns, nodes_s, 0.5)[1]))
        [0.1 0.  0. ]
    """
    if len(nodes_s) == 2:
        rate = turns[1] / nodes_s[1]
        part = ahead_s / -nodes_s[1]
        error = as_covariance([0.5 * ahead_s * rate], LARGEST_VARIANCE)
        return rotation_nd @ exp_rotation(ahead_s * rate), rate, (1.0 + part) ** 2 + part**2, error
    to_nodes_s = ahead_s - nodes_s
    first = (turns[1:] - turns[:-1]) / (nodes_s[1:] - nodes_s[:-1])[:, None]
    second = (first[1:] - first[:-1]) / (nodes_s[2:] - nodes_s[:-2])[:, None]
    steady, bent = first[0], second[0]
    vector = ahead_s * (steady + to_nodes_s[1] * bent)
    rate = steady + (ahead_s + to_nodes_s[1]) * bent
    weight1 = ahead_s * to_nodes_s[2] / (nodes_s[1] * (nodes_s[1] - nodes_s[2]))
    weight2 = ahead_s * to_nodes_s[1] / (nodes_s[2] * (nodes_s[2] - nodes_s[1]))
    gain = (1.0 - weight1 - weight2) ** 2 + weight1**2 + weight2**2
    error = _error_by_differences(nodes_s, second, ahead_s)
    return rotation_nd @ exp_rotation(vector), rate, float(gain), error


def _error_by_differences(nodes_s: FloatArray, second: FloatArray, ahead_s: float) -> FloatArray:
    """Return the covariance of two errors: of a parabola, and of a clock offset estimated with interpolated attitudes.

    Both errors are computed from the root mean square of the third derivative of the motion over all samples, because
    in a wave the third derivative is zero at some phases.

    Without measured rates the interpolation error is proportional to the third derivative, which in a swell is
    proportional to the rate. The effect of a clock offset is proportional to the rate too. A filter that estimates the
    offset from interpolated attitudes cannot separate the two effects, so the estimated offset has the second error.

    Args:
        nodes_s: times of the samples relative to the newest sample, s, newest first, shape (n,).
        second: second divided differences of the attitudes at these times, rad/s², shape (n - 2, 3).
        ahead_s: time after the newest sample, s, to which the parabola through the first three samples is evaluated.
    """
    step_s = -float(nodes_s[1])
    if len(nodes_s) == 3:
        third, beyond_s = second / step_s, step_s
    else:
        third = (second[1:] - second[:-1]) / (nodes_s[3:] - nodes_s[:-3])[:, None]
        third, beyond_s = third / math.sqrt(len(third)), ahead_s - float(nodes_s[2])
    of_parabola = ahead_s * (ahead_s + step_s) * beyond_s
    of_offset = _WORST_OF_DIFFERENCED * step_s**3
    return as_covariance(math.hypot(of_parabola, of_offset) * third, LARGEST_VARIANCE)

"""Interpolation error as a covariance, estimated from the neighbouring samples, and propagation by differences.

Values between two samples are interpolated by a cubic. The error of the cubic is estimated from its differences to the
other neighbouring samples. With measured rates, the difference at one other sample is scaled to the requested time
(:func:`ship_kernels.compiled_rotations.interpolate_attitude`). Without measured rates, the cubic is compared with the
polynomial through all neighbouring samples (:func:`polynomial_errors`). After its newest sample an attitude is
propagated over a short time, by measured rates (:func:`ship_kernels.compiled_rotations.propagate_by_rates`) or by
differences of attitudes (:func:`propagate_by_differences`); the error is estimated in the same way.

Only a fraction of the noise of the samples enters the estimates, because no difference is divided by the time between
samples. At high sample rates the estimates are therefore small compared with the noise. Derivation and numbers:
docs/explanation/interpolation.md.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray, exp_rotation
from ship_kernels import compiled_tracks

MOST_SAMPLES = 5
"""Maximum number of samples for a polynomial; with more samples their noise dominates."""

NEXT_TERM_SHARE = 0.5
"""Assumed ratio of the missing terms of an interpolation error to the last known term.

In a wave the terms of successive orders are out of phase: if one term is zero, the next term is largest."""

ANY_DIRECTION = 0.3
"""Relative error of an estimated interpolation error, equal in all directions."""

LARGEST_VARIANCE = np.pi**2
"""Maximum variance of an estimated error, rad²; no attitude error exceeds half a turn."""

_WORST_OF_DIFFERENCED = 0.0962
"""Greatest value of s (1 - s) (1 - 2 s), 0 < s < 1.

The error of a cubic with differenced rates is at most this value times step³ times the third divided difference."""


def as_covariance(errors: Sequence[FloatArray] | FloatArray, largest: float = math.inf) -> FloatArray:
    """Return the covariance of an error from several estimates of the error, shape (k, k).

    The estimates are assumed to be independent. Each estimate also adds 0.3² times its square to every variance.

    Args:
        errors: one estimate in each row, shape (k,) each.
        largest: upper limit of the sum of the estimates' squares; a covariance with a larger sum is scaled down.

    Example:
        An estimated error of 2 along the first axis:

        >>> print(as_covariance([np.array([2.0, 0.0])]).round(2))
        [[4.36 0.  ]
         [0.   0.36]]
    """
    rows = np.asarray(errors)
    squares = float(np.vdot(rows, rows))
    covariance: FloatArray = rows.T.dot(rows)
    every_diagonal_element = slice(None, None, rows.shape[1] + 1)
    covariance.ravel()[every_diagonal_element] += ANY_DIRECTION**2 * squares
    return covariance if squares <= largest else covariance * (largest / squares)


def joint_covariance(errors: FloatArray, interval: NDArray[np.int64]) -> FloatArray:
    """Return the joint covariance of the errors of n interpolated values, from estimates of these errors.

    Within one interval the error is one curve: the errors of its values are correlated, and nearly equal at two close
    times. Errors in different intervals are treated as independent.

    Args:
        errors: signed estimates as for :func:`as_covariance`, shape (n, n_estimates, k); zero for an exact value.
        interval: index of the interval of each value, shape (n,).

    Returns:
        Joint covariance, shape (n, k, n, k).

    Example:
        Variance of the difference of two values with errors of 2 and 1.5, in one interval and in different intervals:

        >>> errors = np.array([[[2.0]], [[1.5]]])
        >>> for interval in ([0, 0], [0, 1]):
        ...     covariance = joint_covariance(errors, np.array(interval))[:, 0, :, 0]
        ...     print(round(float(np.array([1, -1]) @ covariance @ [1, -1]), 4))
        0.2725
        6.8125
    """
    products = np.einsum("irx,jry->ixjy", errors, errors)
    squares = np.trace(products, axis1=1, axis2=3)
    products += ANY_DIRECTION**2 * squares[:, None, :, None] * np.eye(errors.shape[-1])[:, None, :]
    covariance: FloatArray = products * (interval[:, None] == interval)[:, None, :, None]
    return covariance


def polynomial_errors(nodes: FloatArray, values: FloatArray, at: float, found: FloatArray) -> tuple[FloatArray, ...]:
    """Estimate the error of an interpolated value from the polynomial through all neighbouring samples.

    Args:
        nodes: times of the samples in units of the interval, shape (n,); the first two are the ends of the interval, 0
            and 1.
        values: values of the samples, shape (n, k).
        at: time of the interpolated value, in units of the interval.
        found: the interpolated value, shape (k,).

    Returns:
        Estimates for :func:`as_covariance`, shape (k,) each: the difference from the polynomial, and an estimate of the
        polynomial's missing terms. Two samples give one estimate, at most an eighth of the change between the samples.

    Example:
        The function t² is 0.25 at t = 0.5. Linear interpolation between t = 0 and t = 1 gives 0.5:

        >>> nodes = np.array([0.0, 1.0, -1.0])
        >>> error, _ = polynomial_errors(nodes, (nodes**2)[:, None], 0.5, np.array([0.5]))
        >>> print(error)
        [-0.25]
    """
    if len(nodes) == 2:
        # Without other samples: error of a straight line if the rate changes from 0.5 to 1.5 times its mean.
        return (0.5 * at * (1.0 - at) * (values[1] - values[0]),)
    # The missing terms are estimated as a share of the polynomial's last term, or as the whole term with fewer samples.
    next_term_share = NEXT_TERM_SHARE if len(nodes) == MOST_SAMPLES else 1.0
    error, missing_terms = compiled_tracks.polynomial_errors(nodes, values, at, found, next_term_share)
    return error, missing_terms


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

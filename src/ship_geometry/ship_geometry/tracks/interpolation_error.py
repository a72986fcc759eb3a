"""Interpolation error as a covariance, estimated from the neighbouring samples.

Values between two samples are interpolated by a cubic. The error of the cubic is estimated from its differences to the
other neighbouring samples. With measured rates, the difference at one other sample is scaled to the requested time
(:func:`ship_kernels.compiled_rotations.interpolate_attitude`). Without measured rates, the cubic is compared with the
polynomial through all neighbouring samples (:func:`polynomial_errors`).

Only a fraction of the noise of the samples enters the estimates, because no difference is divided by the time between
samples. At high sample rates the estimates are therefore small compared with the noise. Derivation and numbers:
docs/explanation/interpolation.md.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_tracks

MOST_SAMPLES = 5
"""Maximum number of samples for a polynomial; with more samples their noise dominates."""

NEXT_TERM_SHARE = 0.5
"""Assumed ratio of the missing terms of an interpolation error to the last known term.

In a wave the terms of successive orders are out of phase: if one term is zero, the next term is largest."""

ANY_DIRECTION = 0.3
"""Relative error of an estimated interpolation error, equal in all directions."""


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

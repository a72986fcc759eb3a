"""How far interpolation may be off, told from the samples around: an estimate of the error itself, as a covariance.

The samples do not fall on one cubic. How far another sample is from the cubic of an interval, or how far the polynomial
through all samples around is from it, is what the cubic lacks, and scales to the moment asked for. Divided differences
carry the noise of the samples as they are, never divided by a step, so that at high rates the estimate is a small part
of that noise. docs/explanation/interpolation.md has the derivation and the numbers.
"""

import math
from collections.abc import Sequence

import numpy as np

from ship_geometry.rotations import FloatArray

MOST_SAMPLES = 5
"""A polynomial through more samples would gain nothing over the noise of the samples."""

BESIDE = 0.5
"""Share of a term of another order, and so of another phase of the wave, by which an estimated error may be off."""

_ANY_DIRECTION = 0.3
"""Share of an estimated error by which it may be off, in any direction: the estimate lags and lacks higher orders."""


def as_covariance(errors: Sequence[FloatArray] | FloatArray, largest: float = math.inf) -> FloatArray:
    """Covariance of an error that is the sum of estimated ones, and of what these may lack, shape (k, k).

    Args:
        errors: shape (k,) each.
        largest: sum of their squares is taken for no more than this.

    Example:
        An estimated error of 2, which may be off by 0.3 of it in any direction:

        >>> print(as_covariance([np.array([2.0, 0.0])]).round(2))
        [[4.36 0.  ]
         [0.   0.36]]
    """
    rows = np.asarray(errors)
    squares = float(np.vdot(rows, rows))
    covariance: FloatArray = rows.T.dot(rows)
    covariance.ravel()[:: rows.shape[1] + 1] += _ANY_DIRECTION**2 * squares
    return covariance if squares <= largest else covariance * (largest / squares)


def by_miss(miss: FloatArray, missed_at: float, at: float) -> FloatArray:
    """Error of a cubic with the right values and slopes at 0 and 1, by another value that it misses.

    Args:
        miss: value minus cubic, shape (k,).
        missed_at: where that is, in intervals; not 0 or 1.
        at: where the error is wanted.

    Example:
        The cubic with the values 0, 1 and the slopes 0, 4 of t⁴ at 0 and 1 is 2 t³ - t². At -1 it is -3, which misses
        t⁴ by 4; at the middle it is off by 1/16:

        >>> print(by_miss(np.array([4.0]), -1.0, 0.5))
        [0.0625]
    """
    return miss * (at * (1.0 - at) / (missed_at * (1.0 - missed_at))) ** 2


def by_third_derivative(change: FloatArray, at: float) -> FloatArray:
    """The same by the cubic's own third derivative (per interval³), where no other sample tells: at most so much.

    Example:
        >>> print(by_third_derivative(np.array([384.0]), 0.5))
        [1.]
    """
    return change * (at * (1.0 - at)) ** 2 / 24.0


def divided_differences(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Coefficients of Newton's polynomial through ``values``, shape (n, k), at ``nodes``, shape (n,); shape (n, k).

    Example:
        >>> nodes = np.array([0.0, 1.0, 3.0])
        >>> print(divided_differences(nodes, (nodes**2)[:, None]).ravel())  # t² = 0 + 1 (t - 0) + 1 (t - 0) (t - 1)
        [0. 1. 1.]
    """
    coefficients = np.array(values)
    for order in range(1, len(nodes)):
        steps = nodes[order:] - nodes[:-order]
        coefficients[order:] = (coefficients[order:] - coefficients[order - 1 : -1]) / steps[:, None]
    return coefficients


def by_polynomial(nodes: FloatArray, values: FloatArray, at: float, found: FloatArray) -> tuple[FloatArray, ...]:
    """Errors of a value drawn between the first two of some samples, which add up, shape (k,) each.

    Args:
        nodes: where the samples are, the two around the value first: 0 and 1.
        values: the samples, shape (n, k).
        at: where the value is.
        found: the value, shape (k,).

    Example:
        Half way between the values 0 and 1 of t² at 0 and 1, a straight line gives 0.5; -0.25 of that is wrong:

        >>> nodes = np.array([0.0, 1.0, -1.0])
        >>> error, _ = by_polynomial(nodes, (nodes**2)[:, None], 0.5, np.array([0.5]))
        >>> print(error)
        [-0.25]
    """
    if len(nodes) == 2:
        # Nothing to tell it from: as if the whole change could begin, or end, within the interval.
        return (0.5 * at * (1.0 - at) * (values[1] - values[0]),)
    coefficients = divided_differences(nodes, values)
    products = np.cumprod(np.append(1.0, at - nodes[:-1]))
    terms = coefficients * products[:, None]
    error = terms.sum(axis=0) - found
    # The last term stands for the terms left out: the next one, or, of fewer samples, one as large as itself.
    return error, (BESIDE if len(nodes) == MOST_SAMPLES else 1.0) * terms[-1]

"""How far interpolation may be off, estimated from the samples around, as a covariance.

A cubic joins two samples. It misses the other samples around by some amount, and that amount tells what the cubic lacks
between the two. With measured rates the miss at one other sample is scaled to the moment asked for
(:func:`ship_geometry.compiled_rotations.between`). Without them the polynomial through all samples around is compared
with the cubic (:func:`by_polynomial`).

The noise of the samples is in these estimates, but it is never divided by a step. So at high rates the estimate is a
small part of the noise that the samples have anyway. docs/explanation/interpolation.md has derivation and numbers.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_geometry import compiled_polynomials
from ship_geometry.rotations import FloatArray

MOST_SAMPLES = 5
"""Most samples that a polynomial is drawn through: with more of them the samples' noise hides what is gained."""

BESIDE = 0.5
"""Share of the next term of the error that is added to an estimate.

In a wave the terms of successive orders are out of phase: where one happens to be zero, the next one is largest."""

ANY_DIRECTION = 0.3
"""Share of an estimated error by which the estimate itself may be off, in any direction."""


def as_covariance(errors: Sequence[FloatArray] | FloatArray, largest: float = math.inf) -> FloatArray:
    """Covariance of an error from estimates of it, shape (k, k).

    The estimates count as independent of one another, and each may itself be off, by a third, in any direction.

    Args:
        errors: one estimate a row, shape (k,) each.
        largest: bound of the sum of their squares; larger ones are scaled down to it.

    Example:
        An estimated error of 2, which may be off by 0.3 of it in any direction:

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
    """Covariance of the errors of several interpolated values together, from estimates of them.

    Within one interval the error is one curve: its values go together, and at two moments close to one another they are
    nearly the same. In different intervals they count as independent.

    Args:
        errors: signed estimates as :func:`as_covariance` takes them, shape (n, n_estimates, k); zero where there is no
            error.
        interval: number of the interval in which each value lies, shape (n,).

    Returns:
        Shape (n, k, n, k).

    Example:
        The difference of two values of one interval whose errors are 2 and 1.5; then of different intervals:

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


def by_polynomial(nodes: FloatArray, values: FloatArray, at: float, found: FloatArray) -> tuple[FloatArray, ...]:
    """Errors of a value that was interpolated between two samples, told by the polynomial through all samples around.

    Args:
        nodes: where the samples are, in units of the interval, its two ends first: 0 and 1; shape (n,).
        values: the samples, shape (n, k).
        at: where the value is, in units of the interval.
        found: the interpolated value, shape (k,).

    Returns:
        Estimates for :func:`as_covariance`, shape (k,) each: the difference from the polynomial, and what may stand
        for the terms that the polynomial lacks. Of two samples alone, half of the change between them at most.

    Example:
        Half way between the values 0 and 1 of t² at 0 and 1, a straight line gives 0.5; -0.25 of that is wrong:

        >>> nodes = np.array([0.0, 1.0, -1.0])
        >>> error, _ = by_polynomial(nodes, (nodes**2)[:, None], 0.5, np.array([0.5]))
        >>> print(error)
        [-0.25]
    """
    if len(nodes) == 2:
        # No other sample is there: as if the whole change could begin, or end, within the interval.
        return (0.5 * at * (1.0 - at) * (values[1] - values[0]),)
    # The last term stands for those left out: for a share of the next one, and with fewer samples for one like itself.
    beside = BESIDE if len(nodes) == MOST_SAMPLES else 1.0
    error, left_out = compiled_polynomials.errors_by_polynomial(nodes, values, at, found, beside)
    return error, left_out

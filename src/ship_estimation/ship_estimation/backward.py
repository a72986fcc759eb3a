"""One step back in time: an earlier state by a later one, and by all that was measured up to the earlier one.

Forward in time the filter goes from an estimate x of covariance P to the prediction of a later state y, of mean p and
covariance Q, with C the covariance between the two (C = P F^T where y = F x + noise). Then, for Gaussian errors,

    x = (mean + C Q^-1 (y - p)) + error of covariance (P - C Q^-1 C^T)

whatever is measured later. Applied from the last state to the first one this is the smoother of Rauch, Tung and
Striebel (AIAA Journal 3 (1965) 1445): what is known of y by all measurements tells what is known of x by all of them.
"""

from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray


class Known(NamedTuple):
    """An estimate of r quantities, or several such: shapes (..., r) and (..., r, r)."""

    mean: FloatArray
    covariance: FloatArray


class Backward(NamedTuple):
    """What r quantities at an earlier moment are by the n states at a later one; several such with (...) in front.

    Attributes:
        gain: shape (..., r, n).
        offset: shape (..., r).
        covariance: of the error that is left where the later states are known exactly, shape (..., r, r).
    """

    gain: FloatArray
    offset: FloatArray
    covariance: FloatArray

    def by(self, later: Known) -> Known:
        """The earlier quantities by what is known of the later states, of shapes (n,) and (n, n)."""
        gain = self.gain
        covariance = self.covariance + gain @ later.covariance @ np.swapaxes(gain, -1, -2)
        return Known(self.offset + gain @ later.mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


def backward(earlier: Known, cross: FloatArray, predicted: Known) -> Backward:
    """The step back from n predicted states to r earlier quantities, or to several such.

    Args:
        earlier: by the measurements up to the earlier moment, shapes (..., r) and (..., r, r).
        cross: covariance between them and the predicted states, shape (..., r, n).
        predicted: the later states as the same measurements predict them, shapes (n,) and (n, n).

    Example:
        A walk: the first position has the variance 1, the next one 1 more. Where the next one is known to be 4, the
        first one was about 2, and half of its variance is left:

        >>> first, second = Known(np.zeros(1), np.eye(1)), Known(np.zeros(1), 2.0 * np.eye(1))
        >>> found = backward(first, np.eye(1), second).by(Known(np.array([4.0]), np.zeros((1, 1))))
        >>> print(found.mean, found.covariance.round(12))
        [2.] [[0.5]]
    """
    gain = cross @ _inverse(predicted.covariance)
    left = earlier.covariance - gain @ predicted.covariance @ np.swapaxes(gain, -1, -2)
    return Backward(gain, earlier.mean - gain @ predicted.mean, left)


def _inverse(covariance: FloatArray) -> FloatArray:
    """The inverse where anything is uncertain; what is known exactly, or no more than rounding, tells nothing back."""
    sigma = np.sqrt(covariance.diagonal())
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, None] * scale))
    uncertain = values > len(values) * np.finfo(float).eps * values[-1]
    inverse = np.where(uncertain, 1.0 / np.where(uncertain, values, 1.0), 0.0)
    found: FloatArray = (vectors * inverse) @ vectors.T / (scale[:, None] * scale)
    return found

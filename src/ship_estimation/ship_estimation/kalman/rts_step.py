"""Backward step of the Rauch-Tung-Striebel smoother, from a later state to an earlier state.

Forward in time the filter goes from an estimate x of covariance P to the prediction of a later state y. The prediction
has the mean p and the covariance Q. C is the covariance between x and y (C = P F^T where y = F x + noise). Then, for
Gaussian errors,

    x = (mean + C Q^-1 (y - p)) + error of covariance (P - C Q^-1 C^T)

where the error is independent of later measurements. Applied from the last state to the first, this relation is the
smoother of Rauch, Tung and Striebel (AIAA Journal 3 (1965) 1445). The estimate of y by all measurements gives the
estimate of x by all measurements.
"""

from typing import NamedTuple

import numpy as np

from ship_geometry.rotations import FloatArray


class GaussianEstimate(NamedTuple):
    """A Gaussian estimate of r quantities, or several such estimates, with mean (..., r) and covariance (..., r, r)."""

    mean: FloatArray
    covariance: FloatArray


class SmootherStep(NamedTuple):
    """Linear relation of r quantities at an earlier time to n states at a later time, or several such relations.

    Attributes:
        gain: smoother gain, shape (..., r, n).
        offset: mean of the earlier quantities if all later states are zero, shape (..., r).
        covariance: covariance of the remaining error for exactly known later states, shape (..., r, r).
    """

    gain: FloatArray
    offset: FloatArray
    covariance: FloatArray

    def apply(self, later: GaussianEstimate) -> GaussianEstimate:
        """Return the estimate of the earlier quantities from an estimate of the later states."""
        gain = self.gain
        covariance = self.covariance + gain @ later.covariance @ np.swapaxes(gain, -1, -2)
        return GaussianEstimate(self.offset + gain @ later.mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


def smoother_step(earlier: GaussianEstimate, cross: FloatArray, predicted: GaussianEstimate) -> SmootherStep:
    """Return the backward step from n predicted states to r earlier quantities, or several such steps.

    Args:
        earlier: estimate by the measurements up to the earlier time, shapes (..., r) and (..., r, r).
        cross: covariance between these quantities and the predicted states, shape (..., r, n).
        predicted: prediction of the later states by the same measurements, shapes (n,) and (n, n).

    Example:
        In a random walk the first position has variance 1 and the next position variance 2. If the next position is
        known to be 4, the first position was about 2, with half of its variance:

        >>> first, second = GaussianEstimate(np.zeros(1), np.eye(1)), GaussianEstimate(np.zeros(1), 2.0 * np.eye(1))
        >>> found = smoother_step(first, np.eye(1), second).apply(GaussianEstimate(np.array([4.0]), np.zeros((1, 1))))
        >>> print(found.mean, found.covariance.round(12))
        [2.] [[0.5]]
    """
    gain = cross @ _inverse(predicted.covariance)
    left = earlier.covariance - gain @ predicted.covariance @ np.swapaxes(gain, -1, -2)
    return SmootherStep(gain, earlier.mean - gain @ predicted.mean, left)


def _inverse(covariance: FloatArray) -> FloatArray:
    """Return the pseudo-inverse, in which directions known exactly, or within rounding, have no effect."""
    sigma = np.sqrt(covariance.diagonal())
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, None] * scale))
    uncertain = values > len(values) * np.finfo(float).eps * values[-1]
    inverse = np.where(uncertain, 1.0 / np.where(uncertain, values, 1.0), 0.0)
    found: FloatArray = (vectors * inverse) @ vectors.T / (scale[:, None] * scale)
    return found

"""What a detector makes of a point that moves while it is exposed: the mean of its way, and a worse centroid along it.

Nothing here is the estimators' own: the mean is a Gauss–Legendre sum over the true motion.
"""

import math
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

_FEWEST_NODES, _NODES_PER_SECOND = 7, 5.0


@dataclass(frozen=True)
class ExposureTimes:
    """Moments of an exposure and their shares in its image.

    Attributes:
        since_middle_s: shape (m,).
        share: shape (m,); their sum is 1.
    """

    since_middle_s: FloatArray
    share: FloatArray


def exposure_times(exposure_s: float) -> ExposureTimes:
    """The moments of an exposure: the middle alone where its length is 0."""
    if exposure_s == 0.0:
        return ExposureTimes(np.zeros(1), np.ones(1))
    count = _FEWEST_NODES + math.ceil(_NODES_PER_SECOND * exposure_s)
    place, weight = np.polynomial.legendre.leggauss(count)
    return ExposureTimes(0.5 * exposure_s * place, 0.5 * weight)


def centroids(times: ExposureTimes, way: FloatArray, psf_sigma: float, sigma: float, noise: FloatArray) -> FloatArray:
    """Centroids of streaks, shape (..., 2).

    Args:
        times: of the exposure.
        way: where the point was at them, shape (m, ..., 2).
        psf_sigma: spread of its image at rest, each axis.
        sigma: error of the centroid of an image at rest, each axis.
        noise: standard normal numbers, shape (..., 2).
    """
    mean = np.tensordot(times.share, way, axes=1)
    if len(times.share) > 1:
        off = (way - mean) / psf_sigma
        spread = np.einsum("m,m...i,m...j->...ij", times.share, off, off)
        # The root whose square is what the light is spread by, in images of a point at rest.
        value, vector = np.linalg.eigh(np.eye(2) + np.where(np.isfinite(spread), spread, 0.0))
        noise = ((vector * np.sqrt(value)[..., None, :]) @ np.swapaxes(vector, -1, -2) @ noise[..., None])[..., 0]
    centroid: FloatArray = mean + sigma * noise
    return centroid

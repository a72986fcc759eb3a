"""Is a covariance honest? Normalised errors and their chi² bands (Bar-Shalom, Li, Kirubarajan 2001, §5.4)."""

import numpy as np
from scipy.stats import chi2

from ship_geometry.rotations import FloatArray


def normalized_error_squared(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """NEES, or NIS: error^T P^-1 error, shape (...), for errors (..., n) and covariances (..., n, n)."""
    solution = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.sum(error * solution, axis=-1)


def mean_nees_band(samples: int, degrees: int, probability: float = 0.999) -> tuple[float, float]:
    """Two-sided band of the mean of ``samples`` independent chi² values with ``degrees`` each."""
    tail = 0.5 * (1.0 - probability)
    total = samples * degrees
    return float(chi2.ppf(tail, total)) / samples, float(chi2.ppf(1.0 - tail, total)) / samples


def sigma_ratio_band(samples: int, probability: float = 0.999) -> tuple[float, float]:
    """Two-sided band of RMS error / predicted sigma over ``samples`` independent errors of one component."""
    low, high = mean_nees_band(samples, 1, probability)
    return float(np.sqrt(low)), float(np.sqrt(high))

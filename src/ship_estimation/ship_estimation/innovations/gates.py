"""Parameters of innovation gates, and NEES and NIS with their acceptance bands.

The filters compare with the gate and reject: ``ship_attitude/filter``, ``theodolite_calib/filter/sighting_gate``. All
checks of a measurement are listed in :mod:`ship_estimation.rejection_rules`. Source: Bar-Shalom, Li, Kirubarajan 2001,
§5.4.
"""

from dataclasses import dataclass

import numpy as np

from ship_estimation.innovations.chi_square import value_above, value_below
from ship_estimation.parameters.fields import parameter
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True, kw_only=True)
class GateConfig:
    """Parameters of the innovation gate, and of successive rejections of one source."""

    probability: float = parameter(
        0.9999, doc="a consistent measurement passes with this probability", minimum=0.5, maximum=0.999999999, live=True
    )
    conflict_after: int = parameter(
        10, doc="successive rejections of one source that are reported as a conflict", minimum=1, live=True
    )
    degraded_after: int = parameter(
        3,
        doc="successive rejections after which a source is inconsistent; if all sources are, the output is DEGRADED",
        minimum=1,
        maximum=1000,
        live=True,
    )
    reopen_after: int = parameter(
        0, doc="successive rejections of one source that inflate the covariance; 0 never", minimum=0, live=True
    )
    reopen_factor: float = parameter(
        100.0, doc="factor of this inflation of the covariance", minimum=1.0, maximum=1e9, live=True
    )


def chi_square_gate(probability: float, degrees: int) -> float:
    """Return the gate of the NIS, the quantile ``probability`` of chi² with ``degrees`` degrees of freedom.

    Example:
        With probability 99.99 % the NIS of a consistent attitude (three components) is below 21.1:

        >>> print(round(chi_square_gate(0.9999, 3), 2))
        21.11
    """
    return value_below(probability, degrees)


def normalized_error_squared(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return NEES or NIS, error^T P^-1 error, shape (...), for errors (..., n) and covariances (..., n, n).

    Example:
        Independent errors of 3″ and 4″ with predicted sigmas of 3″ and 2″:

        >>> print(normalized_error_squared(np.array([3.0, 4.0]), np.diag([9.0, 4.0])))
        5.0
    """
    solution = np.linalg.solve(covariance, error[..., None])[..., 0]
    squared: FloatArray = np.sum(error * solution, axis=-1)
    return squared


def mean_nees_band(samples: int, degrees: int, probability: float = 0.999) -> tuple[float, float]:
    """Return the two-sided band of the mean of ``samples`` independent chi² values with ``degrees`` degrees of freedom.

    Example:
        The mean NEES of 200 consistent attitudes, three angles each, is near 3:

        >>> low, high = mean_nees_band(samples=200, degrees=3)
        >>> print(f"{low:.2f} to {high:.2f}")
        2.46 to 3.60
    """
    tail, total = 0.5 * (1.0 - probability), samples * degrees
    return value_below(tail, total) / samples, value_above(tail, total) / samples


def sigma_ratio_band(samples: int, probability: float = 0.999) -> tuple[float, float]:
    """Return the two-sided band of RMS error / predicted sigma over ``samples`` independent errors of one component.

    Example:
        >>> low, high = sigma_ratio_band(samples=200)
        >>> print(f"RMS error / sigma of 200 consistent angles: {low:.2f} to {high:.2f}")
        RMS error / sigma of 200 consistent angles: 0.84 to 1.17
    """
    low, high = mean_nees_band(samples, 1, probability)
    return float(np.sqrt(low)), float(np.sqrt(high))

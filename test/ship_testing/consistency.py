"""Acceptance band of errors against their predicted sigma."""

import numpy as np

from ship_estimation.innovations.gates import mean_nees_band


def sigma_ratio_band(samples: int, probability: float = 0.999) -> tuple[float, float]:
    """Return the two-sided band of RMS error / predicted sigma over ``samples`` independent errors of one component.

    Example:
        >>> low, high = sigma_ratio_band(samples=200)
        >>> print(f"RMS error / sigma of 200 consistent angles: {low:.2f} to {high:.2f}")
        RMS error / sigma of 200 consistent angles: 0.84 to 1.17
    """
    low, high = mean_nees_band(samples, 1, probability)
    return float(np.sqrt(low)), float(np.sqrt(high))

"""Solution separations and protection levels of three independent states, which are also the output's components."""

from collections.abc import Sequence

import numpy as np

from ship_estimation.integrity.protection_levels import ProtectionLevels, SigmaMultipliers, protection_levels
from ship_geometry.rotations import FloatArray


def solution_separations(
    distance: FloatArray,
    variance: FloatArray,
    variance_0: FloatArray,
    k: SigmaMultipliers,
    subfilter_indices: Sequence[int] | None = None,
) -> ProtectionLevels:
    """Return the solution separations of the subfilters from the main filter, and the protection levels.

    Args:
        distance: solution separation of each subfilter in the three states, shape (h, 3).
        variance: variances of each subfilter, shape (h, 3).
        variance_0: variances of the main filter, shape (3,).
        k: sigma multipliers.
        subfilter_indices: indices of the tested subfilters; None for all.
    """
    subfilters = np.arange(len(distance)) if subfilter_indices is None else np.array(subfilter_indices, dtype=np.intp)
    components, of_all = np.eye(3), np.diag(variance_0)
    subfilter_covariances = variance[:, :, None] * components
    by_output = components, components, of_all
    return protection_levels(
        k, subfilters, np.arange(3), by_output, np.zeros(3), distance, of_all[None], subfilter_covariances
    )

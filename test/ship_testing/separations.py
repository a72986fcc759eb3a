"""Separations and levels of independent components: each is a state."""

from collections.abc import Sequence

import numpy as np

from ship_estimation.protection_levels import ProtectionLevels, SigmaMultipliers, protection_levels
from ship_geometry.rotations import FloatArray


def solution_separations(
    distance: FloatArray,
    variance: FloatArray,
    variance_0: FloatArray,
    k: SigmaMultipliers,
    subfilter_indices: Sequence[int] | None = None,
) -> ProtectionLevels:
    """Return the separations of estimates without one source from that by all, and the levels.

    Args:
        distance: of three components, shape (h, 3).
        variance: without each source, shape (h, 3).
        variance_0: by all sources, shape (3,).
        k: numbers of sigmas.
        subfilter_indices: hypotheses to be evaluated; None for all.
    """
    subfilters = np.arange(len(distance)) if subfilter_indices is None else np.array(subfilter_indices, dtype=np.intp)
    components, of_all = np.eye(3), np.diag(variance_0)
    subfilter_covariances = variance[:, :, None] * components
    by_output = components, components, of_all
    return protection_levels(
        k, subfilters, np.arange(3), by_output, np.zeros(3), distance, of_all[None], subfilter_covariances
    )

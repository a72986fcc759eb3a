"""States of a filter for the lasting errors of a camera over its field: of its optics, and field-spatial ones."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.stars.config import CameraConfig
from ship_attitude_star.stars.optics_errors import OPTICS_MODES, SOURCE_OPTICS
from ship_attitude_star.stars.spatial_errors import FIELD_MODES, SOURCE_FIELD
from ship_estimation.kalman import StateBlock, block

_WALK_PER_SQRT_S = 0.1 / 60.0
"""Random walk of the errors of optics by heat, in their sigmas: a tenth in an hour. A focal length changes by 1e-5 per
kelvin, and a night by some kelvin; the sigma of a surveyed one is 2e-4."""


def camera_blocks(name: str, camera: CameraConfig, has_focal_length: bool = True) -> list[StateBlock]:
    """State blocks ``<name>.optics`` and, where the camera has a field-spatial error, ``<name>.field``, in sigmas.

    Args:
        name: of the camera among the states.
        camera: its parameters.
        has_focal_length: whether the focal length is in ``<name>.optics``; False where another state holds it.
    """
    sigma = np.ones(OPTICS_MODES if has_focal_length else OPTICS_MODES - 1)
    blocks = [block(f"{name}.optics", sigma, SOURCE_OPTICS, walk=_WALK_PER_SQRT_S * sigma)]
    if camera.field_spatial_sigma_px > 0.0:
        blocks.append(block(f"{name}.field", np.ones(FIELD_MODES), SOURCE_FIELD))
    return blocks


def camera_rows(slices: Mapping[str, slice], name: str, focal_length: str = "") -> NDArray[np.intp] | None:
    """States of a camera's lasting errors, the focal length first; None where the filter has none for this camera.

    Args:
        slices: of the filter's states by block.
        name: of the camera among the states.
        focal_length: block that holds the focal length; empty where ``<name>.optics`` does.
    """
    blocks = [slices[block] for block in (focal_length, f"{name}.optics", f"{name}.field") if block in slices]
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in blocks]) if blocks else None

"""Filter states of a camera's correlated errors over its field: optics and field-spatial errors."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import StateBlock, block
from ship_stars.camera.config import CameraConfig
from ship_stars.camera.optics_errors import OPTICS_MODES, SOURCE_OPTICS
from ship_stars.camera.spatial_errors import FIELD_MODES, SOURCE_FIELD

_WALK_PER_SQRT_S = 0.1 / 60.0
"""Random walk of the optics errors due to temperature, in sigmas per √s; it is 0.1 sigma in an hour.

A focal length changes by 1e-5 per kelvin, and the temperature by some kelvin per night. The sigma of a surveyed focal
length is 2e-4.
"""


def camera_blocks(name: str, camera: CameraConfig, has_focal_length: bool = True) -> list[StateBlock]:
    """Return the blocks ``<name>.optics`` and, if the camera has a field-spatial error, ``<name>.field``.

    The states are in units of their standard deviations.

    Args:
        name: name of the camera in the names of the blocks.
        camera: parameters of the camera.
        has_focal_length: True if ``<name>.optics`` contains the focal length; False if another block contains it.
    """
    sigma = np.ones(OPTICS_MODES if has_focal_length else OPTICS_MODES - 1)
    blocks = [block(f"{name}.optics", sigma, SOURCE_OPTICS, walk=_WALK_PER_SQRT_S * sigma)]
    if camera.field_spatial_sigma_px > 0.0:
        blocks.append(block(f"{name}.field", np.ones(FIELD_MODES), SOURCE_FIELD))
    return blocks


def camera_state_indices(slices: Mapping[str, slice], name: str, focal_length: str = "") -> NDArray[np.intp] | None:
    """Return the state indices of a camera's correlated errors, focal length first; None without such states.

    Args:
        slices: slice of the filter's states for each block.
        name: name of the camera in the names of the blocks.
        focal_length: name of the block with the focal length; empty if ``<name>.optics`` contains it.
    """
    blocks = [slices[block] for block in (focal_length, f"{name}.optics", f"{name}.field") if block in slices]
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in blocks]) if blocks else None

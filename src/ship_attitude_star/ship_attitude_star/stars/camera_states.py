"""States of a filter for the lasting errors of a camera over its field: of its optics, and field-spatial ones."""

from collections.abc import Mapping

import numpy as np

from ship_attitude_star.stars.config import CameraConfig
from ship_attitude_star.stars.optics_errors import OPTICS_MODES, SOURCE_OPTICS
from ship_attitude_star.stars.spatial_errors import FIELD_MODES, SOURCE_FIELD
from ship_estimation.kalman import StateBlock, block


def camera_blocks(name: str, camera: CameraConfig) -> list[StateBlock]:
    """State blocks ``<name>.optics`` and, where the camera has a field-spatial error, ``<name>.field``, in sigmas."""
    blocks = [block(f"{name}.optics", np.ones(OPTICS_MODES), SOURCE_OPTICS)]
    if camera.field_spatial_sigma_px > 0.0:
        blocks.append(block(f"{name}.field", np.ones(FIELD_MODES), SOURCE_FIELD))
    return blocks


def camera_rows(slices: Mapping[str, slice], name: str) -> slice | None:
    """States of both blocks, which stand side by side; None where the filter has none for this camera."""
    optics = slices.get(f"{name}.optics")
    return None if optics is None else slice(optics.start, slices.get(f"{name}.field", optics).stop)

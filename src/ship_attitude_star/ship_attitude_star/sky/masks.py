"""Parameters of what stands on deck in the way of a star sensor; study, simulation and identification have the same."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ship_estimation.parameter_fields import parameter
from ship_estimation.parameters import ParameterError
from ship_geometry.deck_masks import DeckMasks


@dataclass(frozen=True, kw_only=True)
class MaskConfig:
    """What stands in the way: a polygon, its edges straight in azimuth and elevation of the deck."""

    azimuths_deg: tuple[float, ...] = parameter(
        doc="of the mask's corners, from the bow; below 0 or over 360 across the bow",
        unit="deg",
        minimum=-360.0,
        maximum=720.0,
    )
    elevations_deg: tuple[float, ...] = parameter(
        doc="of the mask's corners, over the deck", unit="deg", minimum=-90.0, maximum=90.0
    )


def deck_masks(masks: Mapping[str, MaskConfig], prefix: str) -> DeckMasks | None:
    """The masks by their parameters; None where there is none.

    Args:
        masks: by name.
        prefix: dotted name of the mapping, for the error message.

    Raises:
        ParameterError: a mask has too few corners, or not as many azimuths as elevations; its edge runs more than once
            round the ship.
    """
    for name, mask in masks.items():
        count = len(mask.azimuths_deg)
        if count < 3 or count != len(mask.elevations_deg):
            raise ParameterError(
                f"parameter '{prefix}.{name}': {count} azimuths and {len(mask.elevations_deg)} elevations are no "
                "polygon: expected as many of both, three at least",
                f"{prefix}.{name}",
            )
        if not max(mask.azimuths_deg) - min(mask.azimuths_deg) <= 360.0:
            raise ParameterError(
                f"parameter '{prefix}.{name}.azimuths_deg': from {min(mask.azimuths_deg):g} to "
                f"{max(mask.azimuths_deg):g} deg is more than once round the ship: expected 360 deg at most",
                f"{prefix}.{name}.azimuths_deg",
                value=mask.azimuths_deg,
            )
    if not masks:
        return None
    corners = [np.deg2rad(np.column_stack([mask.azimuths_deg, mask.elevations_deg])) for mask in masks.values()]
    return DeckMasks(tuple(masks), tuple(corners))

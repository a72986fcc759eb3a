"""Parameters of what stands on deck in the way of a star sensor; study, simulation and identification have the same."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ship_estimation.parameter_fields import parameter
from ship_estimation.parameters import ParameterError
from ship_geometry.deck_masks import DeckMasks, SensorMasks
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray


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


class MountedSensor(Protocol):
    """A star sensor, as suites and scenarios describe it: how it is bolted, and what stands in its way."""

    @property
    def azimuth_deg(self) -> float:
        """Of the boresight, from the bow."""

    @property
    def elevation_deg(self) -> float:
        """Of the boresight, over the deck."""

    @property
    def roll_deg(self) -> float:
        """About the boresight."""

    @property
    def masks(self) -> Mapping[str, MaskConfig]:
        """By name."""


def sensor_masks(sensor: MountedSensor, prefix: str) -> SensorMasks | None:
    """The masks of a sensor by its parameters; None where there is none.

    Args:
        sensor: its parameters.
        prefix: dotted name of these, for the error message.

    Raises:
        ParameterError: a mask is no polygon.
    """
    masks = deck_masks(sensor.masks, f"{prefix}.masks")
    if masks is None:
        return None
    angles = np.deg2rad([sensor.azimuth_deg, sensor.elevation_deg, sensor.roll_deg])
    return SensorMasks(masks, rotation_from_angles(*angles))


def refuse_covered(masks: SensorMasks, field_s: FloatArray, prefix: str) -> None:
    """Refuse masks that leave nothing of a field of view.

    Args:
        masks: of the sensor.
        field_s: directions all over its field, in the sensor frame, shape (n, 3).
        prefix: dotted name of the sensor's parameters, for the error message.

    Raises:
        ParameterError: they hide all of it; names them.
    """
    covering = masks.covering(field_s)
    if covering:
        raise ParameterError(
            f"parameter '{prefix}.masks': {', '.join(covering)} cover the whole field of view: no star is ever seen; "
            "check azimuths and elevations, which are the deck's as this sensor sees it",
            f"{prefix}.masks",
        )

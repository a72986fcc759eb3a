"""Parameters of obstructions on deck in the view of a star sensor, for layout study, simulation and identification."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ship_estimation.parameters.fields import parameter
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.rotations import FloatArray
from ship_stars.sky.deck_masks import DeckMasks, SensorMasks


@dataclass(frozen=True, kw_only=True)
class MaskConfig:
    """Obstruction as a polygon; its edges are straight lines in azimuth and elevation relative to the deck."""

    azimuths_deg: tuple[float, ...] = parameter(
        doc="azimuths of the mask's corners from the bow; below 0 or above 360 for a mask across the bow",
        unit="deg",
        minimum=-360.0,
        maximum=720.0,
    )
    elevations_deg: tuple[float, ...] = parameter(
        doc="elevations of the mask's corners above the deck", unit="deg", minimum=-90.0, maximum=90.0
    )


def deck_masks(masks: Mapping[str, MaskConfig], prefix: str) -> DeckMasks | None:
    """Return the masks that the parameters describe; None without parameters.

    Args:
        masks: mask parameters by name.
        prefix: dotted name of the mapping, for the error message.

    Raises:
        ParameterError: a mask has fewer than three corners, or different numbers of azimuths and elevations, or spans
            more than 360° of azimuth.
    """
    for name, mask in masks.items():
        count = len(mask.azimuths_deg)
        if count < 3 or count != len(mask.elevations_deg):
            raise ParameterError(
                f"parameter '{prefix}.{name}': {count} azimuths and {len(mask.elevations_deg)} elevations do not "
                "define a polygon: expected equal numbers of both, at least three",
                f"{prefix}.{name}",
            )
        if not max(mask.azimuths_deg) - min(mask.azimuths_deg) <= 360.0:
            raise ParameterError(
                f"parameter '{prefix}.{name}.azimuths_deg': from {min(mask.azimuths_deg):g} to "
                f"{max(mask.azimuths_deg):g} deg spans more than a full circle: expected at most 360 deg",
                f"{prefix}.{name}.azimuths_deg",
                value=mask.azimuths_deg,
            )
    if not masks:
        return None
    corners = [np.deg2rad(np.column_stack([mask.azimuths_deg, mask.elevations_deg])) for mask in masks.values()]
    return DeckMasks(tuple(masks), tuple(corners))


class MountedSensor(Protocol):
    """Mounting and obstructions of a star sensor, in the parameters of suites and scenarios."""

    @property
    def rotation_ds(self) -> FloatArray:
        """Rotation "deck from sensor", shape (3, 3)."""

    @property
    def masks(self) -> Mapping[str, MaskConfig]:
        """Obstructions by name."""


def sensor_masks(sensor: MountedSensor, prefix: str) -> SensorMasks | None:
    """Return the masks of a sensor; None for a sensor without masks.

    Args:
        sensor: parameters of the sensor.
        prefix: dotted name of the sensor's parameters, for the error message.

    Raises:
        ParameterError: a mask is not a valid polygon.
    """
    masks = deck_masks(sensor.masks, f"{prefix}.masks")
    return None if masks is None else SensorMasks(masks, sensor.rotation_ds)


def check_field_not_covered(masks: SensorMasks, field_s: FloatArray, prefix: str) -> None:
    """Check that masks leave part of a field of view free.

    Args:
        masks: masks of the sensor.
        field_s: grid of directions over the field of view, in the sensor frame, shape (n, 3).
        prefix: dotted name of the sensor's parameters, for the error message.

    Raises:
        ParameterError: the masks cover the whole field; the text names the masks.
    """
    covering = masks.covering_masks(field_s)
    if covering:
        raise ParameterError(
            f"parameter '{prefix}.masks': {', '.join(covering)} cover the whole field of view, so that no star is "
            "visible: check azimuths and elevations, which are relative to the deck",
            f"{prefix}.masks",
        )

"""Obstructions of a star sensor's field: masks on deck, and the horizon while the ship moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_stars.sky.deck_masks import DeckMasks, field_directions
from ship_stars.sky.masks import deck_masks
from ship_studies.layout.config import LayoutStudyConfig

_NO_MASKS = DeckMasks((), ())


@dataclass(frozen=True)
class Obstructions:
    """The masks and the horizon of a study.

    Attributes:
        masks: obstructions on deck.
        half_fields: for each sensor, tangents of half the field of view along its right and up axes, shape (N, 2).
        up_d: upward direction in the deck frame, for mean and extreme pitch and roll of the ship, shape (9, 3).
        clearance: required elevation of a field above the horizon, rad.
    """

    masks: DeckMasks
    half_fields: FloatArray
    up_d: FloatArray
    clearance: float

    @classmethod
    def from_config(cls, config: LayoutStudyConfig) -> "Obstructions":
        """Return the masks and the horizon of a study's file.

        Raises:
            ParameterError: a mask is not a valid polygon.
        """
        half = np.tan(np.deg2rad(config.field_of_view_deg) / 2.0)
        optics, horizon = config.optics, config.horizon
        half_fields = [optics[name].half_field() if name in optics else np.full(2, half) for name in config.sensors]
        pitch = np.deg2rad(config.ship_pitch_deg + horizon.pitch_deg * np.array([-1.0, 0.0, 1.0]))
        roll = np.deg2rad(config.ship_roll_deg + horizon.roll_deg * np.array([-1.0, 0.0, 1.0]))
        rotations_nd = rotation_from_angles(np.zeros((3, 3)), *np.broadcast_arrays(pitch[:, None], roll))
        return cls(
            masks=deck_masks(config.masks, "masks") or _NO_MASKS,
            half_fields=np.array(half_fields),
            up_d=rotations_nd[..., 1, :].reshape(-1, 3),
            clearance=float(np.deg2rad(horizon.clearance_deg)),
        )

    def masks_in_view(self, number: int, angles: FloatArray) -> list[str]:
        """Return the names of the masks in the field of a sensor mounted at (azimuth, elevation, roll), rad."""
        reaching = self.masks.masks_in_field(rotation_from_angles(*angles)[None], self.half_fields[number])
        return [name for name, reaches in zip(self.masks.names, reaching, strict=True) if reaches[0]]

    def is_clear(self, number: int, angles: FloatArray) -> NDArray[np.bool_]:
        """True if the field of a sensor is clear of all masks, for installation angles (n, 3), rad; shape (n,)."""
        reached: NDArray[np.bool_] = np.any(
            self.masks.masks_in_field(_rotations(angles), self.half_fields[number]), axis=0
        )
        return ~reached

    def horizon_margin(self, number: int, angles: FloatArray) -> FloatArray:
        """Return the lowest elevation of a field while the ship moves, minus the clearance, shape (n,), rad.

        Args:
            number: number of the sensor.
            angles: installation angles, shape (n, 3), rad.
        """
        field_d = field_directions(self.half_fields[number]) @ np.swapaxes(_rotations(angles), -1, -2)
        lowest: FloatArray = np.arcsin(np.min(field_d @ self.up_d.T, axis=(-2, -1)).clip(-1.0, 1.0))
        return lowest - self.clearance

    def is_unobstructed(self, number: int, angles: FloatArray) -> NDArray[np.bool_]:
        """True if a field is clear of masks and horizon, for installation angles (n, 3), rad; shape (n,)."""
        return self.is_clear(number, angles) & (self.horizon_margin(number, angles) >= 0.0)


def _rotations(angles: FloatArray) -> FloatArray:
    return rotation_from_angles(angles[..., 0], angles[..., 1], angles[..., 2])

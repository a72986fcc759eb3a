"""Deck masks: obstructions of the sky by structures on deck, as polygons in azimuth and elevation for one sensor.

Azimuth is counted from the bow, clockwise seen from above; elevation is counted from the deck plane. The edges of a
polygon are straight in azimuth and elevation. A polygon across the bow has azimuths below 0° or above 360°: (350°,
370°), because (350°, 10°) would be the long way round. Layout study, simulation and identification share the parameters
of the masks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ship_estimation.parameters.fields import parameter
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.rotations import FloatArray

EDGE_STEP = np.deg2rad(0.25)
"""Spacing of points on the edge of a mask, rad. A mask that enters a field by less than this step may be missed."""

BoolArray = NDArray[np.bool_]

_BATCH_SIZE = 500
_FIELD_POINTS = 21


@dataclass(frozen=True)
class DeckMasks:
    """Masks of the deck.

    Attributes:
        names: names of the masks.
        corners: azimuth and elevation of the corners of each mask, rad, shape (k, 2), k at least 3.

    Example:
        A funnel astern, 50° high, hides a star astern at 30° elevation, but not at 60°:

        >>> corners = np.deg2rad([[150.0, 0.0], [210.0, 0.0], [210.0, 50.0], [150.0, 50.0]])
        >>> masks = DeckMasks(("funnel",), (corners,))
        >>> elevation = np.deg2rad([30.0, 60.0])
        >>> masks.is_hidden(np.stack([-np.cos(elevation), np.sin(elevation), np.zeros(2)], axis=-1))
        array([ True, False])
    """

    names: tuple[str, ...]
    corners: tuple[FloatArray, ...]

    def hidden_by_mask(self, directions_d: FloatArray) -> BoolArray:
        """Return True for each mask that hides a direction, shape (masks, ...).

        Args:
            directions_d: directions (bow, up, starboard), shape (..., 3). A direction that is not finite counts as
                hidden by every mask.
        """
        azimuth = np.arctan2(directions_d[..., 2], directions_d[..., 0]) % (2.0 * np.pi)
        elevation = np.arctan2(directions_d[..., 1], np.hypot(directions_d[..., 0], directions_d[..., 2]))
        nowhere = ~np.isfinite(directions_d).all(axis=-1)
        inside = [_is_inside(corners, azimuth, elevation) | nowhere for corners in self.corners]
        return np.array(inside, dtype=bool).reshape(len(self.corners), *azimuth.shape)

    def is_hidden(self, directions_d: FloatArray, margin: float = 0.0) -> BoolArray:
        """Return True for each direction that a mask hides, shape (n,).

        Args:
            directions_d: unit vectors (bow, up, starboard), shape (n, 3).
            margin: minimum distance of a hidden direction from the edge of the mask, rad.
        """
        hidden = self.hidden_by_mask(directions_d)
        if margin > 0.0:
            for number in np.flatnonzero(hidden.any(axis=1)):
                within = hidden[number]
                nearest = np.max(directions_d[within] @ self._edges[number].T, axis=-1)
                # A place on the edge is up to half a step from the nearest edge point.
                within[within] = ~(nearest >= np.cos(min(margin + EDGE_STEP / 2.0, np.pi)))
        anywhere: BoolArray = np.any(hidden, axis=0)
        return anywhere

    def masks_in_field(self, rotations_ds: FloatArray, half_field: FloatArray) -> BoolArray:
        """Return True for each mask that reaches into a rectangular field of view, shape (masks, n).

        A mask reaches into a field if the edge of the mask enters the field, or if the whole field is inside the mask.

        Args:
            rotations_ds: deck from sensor (forward, up, right), for each of n mountings, shape (n, 3, 3).
            half_field: tangents of half the field to the right and up, shape (2,).
        """
        half_right, half_up = half_field
        reaches = self.hidden_by_mask(rotations_ds[..., :, 0])
        for reached, edge in zip(reaches, self._edges, strict=True):
            for first in range(0, len(rotations_ds), _BATCH_SIZE):
                forward, up, right = np.moveaxis(edge @ rotations_ds[first : first + _BATCH_SIZE], -1, 0)
                entered = (forward > 0.0) & (np.abs(up) <= half_up * forward) & (np.abs(right) <= half_right * forward)
                reached[first : first + _BATCH_SIZE] |= entered.any(axis=-1)
        return reaches

    def covering_masks(self, directions_d: FloatArray) -> list[str]:
        """Return the names of the masks that hide directions, shape (n, 3); an empty list if any direction is free."""
        hiding = self.hidden_by_mask(directions_d)
        if not hiding.any(axis=0).all():
            return []
        return [name for name, hides in zip(self.names, hiding, strict=True) if hides.any()]

    @cached_property
    def _edges(self) -> list[FloatArray]:
        """Points along the edges of each mask, unit vectors (bow, up, starboard), shape (m, 3)."""
        return [_edge_points(corners) for corners in self.corners]


@dataclass(frozen=True)
class SensorMasks:
    """Deck masks for directions in the frame of a star sensor.

    Attributes:
        masks: masks of the deck.
        rotation_ds: orientation of the sensor (deck from sensor), shape (3, 3).

    Example:
        A sensor looks over the port side, where a crane stands:

        >>> crane = np.deg2rad([[265.0, 0.0], [275.0, 0.0], [275.0, 60.0], [265.0, 60.0]])
        >>> port = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        >>> SensorMasks(DeckMasks(("crane",), (crane,)), port).is_hidden(np.array([[1.0, 0.0, 0.0], [0.8, 0.0, 0.6]]))
        array([ True, False])
    """

    masks: DeckMasks
    rotation_ds: FloatArray

    def is_hidden(self, directions_s: FloatArray, margin: float = 0.0) -> BoolArray:
        """Return :meth:`DeckMasks.is_hidden`, shape (n,), for directions in the sensor frame, shape (n, 3)."""
        return self.masks.is_hidden(directions_s @ self.rotation_ds.T, margin)

    def hiding_names(self, direction_s: FloatArray) -> str:
        """Return the names of the masks that hide a direction in the sensor frame, shape (3,), joined by commas."""
        hiding = self.masks.hidden_by_mask(direction_s @ self.rotation_ds.T)
        return ", ".join(name for name, hides in zip(self.masks.names, hiding, strict=True) if hides)


def field_directions(half_field: FloatArray) -> FloatArray:
    """Return a grid of directions (forward, up, right) over a rectangular field of view and its edge, shape (n, 3).

    Args:
        half_field: tangents of half the field to the right and up, shape (2,).

    Example:
        >>> print(field_directions(np.array([0.5, 0.25]))[:, 2].max().round(3))  # in the middle of the right edge
        0.447
    """
    right, up = np.meshgrid(*(np.linspace(-half, half, _FIELD_POINTS) for half in half_field))
    points = np.stack([np.ones(right.size), up.ravel(), right.ravel()], axis=-1)
    directions: FloatArray = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return directions


def _is_inside(corners: FloatArray, azimuth: FloatArray, elevation: FloatArray) -> BoolArray:
    """Return True for each direction inside a polygon: the ray upwards from it crosses an odd number of edges.

    Azimuths are compared modulo 360°.

    Args:
        corners: azimuth and elevation of the corners, rad, shape (k, 2).
        azimuth: azimuths of the directions in [0, 2 pi), rad, shape (...).
        elevation: elevations of the directions, rad, shape (...).
    """
    inside = np.zeros(np.shape(azimuth), dtype=bool)
    ends = np.roll(corners, -1, axis=0)
    turn = 2.0 * np.pi
    for number in range(int(corners[:, 0].min() // turn), int(corners[:, 0].max() // turn) + 1):
        turned = azimuth + number * turn
        odd = np.zeros(inside.shape, dtype=bool)
        for (from_azimuth, from_elevation), (to_azimuth, to_elevation) in zip(corners, ends, strict=True):
            if from_azimuth == to_azimuth:
                continue
            crossed = (from_azimuth <= turned) != (to_azimuth <= turned)
            slope = (to_elevation - from_elevation) / (to_azimuth - from_azimuth)
            odd ^= crossed & (from_elevation + slope * (turned - from_azimuth) > elevation)
        inside |= odd
    return inside


def _edge_points(corners: FloatArray) -> FloatArray:
    points = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = int(np.ceil(np.abs(end - start).max() / EDGE_STEP)) + 1
        points.append(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))
    azimuth, elevation = np.concatenate(points).T
    forward, right = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([forward, np.sin(elevation), right], axis=-1)


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
    covering = masks.masks.covering_masks(field_s @ masks.rotation_ds.T)
    if covering:
        raise ParameterError(
            f"parameter '{prefix}.masks': {', '.join(covering)} cover the whole field of view, so that no star is "
            "visible: check azimuths and elevations, which are relative to the deck",
            f"{prefix}.masks",
        )

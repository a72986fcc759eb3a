"""What stands in the way of a star sensor: polygons over azimuth and elevation, and clear fields."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.layout.config import Mask
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray

_EDGE_STEP_DEG = 0.25
"""Points on an edge of a mask are so near to each other; a field that an edge enters by less may count as clear."""


@dataclass(frozen=True)
class Obstructions:
    """The masks of a study.

    Attributes:
        names: of the masks.
        polygons_deg: corners (azimuth, elevation) of each, shape (k, 2); edges are straight in azimuth and elevation.
        half_fields: tangents of half the field of view to the right and up of each sensor, shape (N, 2).
    """

    names: tuple[str, ...]
    polygons_deg: tuple[FloatArray, ...]
    half_fields: FloatArray

    @classmethod
    def from_masks(cls, masks: Mapping[str, Mask], half_fields: FloatArray) -> "Obstructions":
        """The masks of a study's file."""
        return cls(tuple(masks), tuple(mask.corners_deg() for mask in masks.values()), half_fields)

    def in_view(self, number: int, angles: FloatArray) -> list[str]:
        """Names of the masks that reach into the field of a sensor bolted at (azimuth, elevation, roll), rad."""
        return [
            name
            for name, polygon_deg in zip(self.names, self.polygons_deg, strict=True)
            if self._reaches(polygon_deg, number, angles)
        ]

    def clear(self, number: int, angles: FloatArray) -> NDArray[np.bool_]:
        """Whether the field of a sensor is clear of all masks, for installation angles (n, 3), rad; shape (n,)."""
        return np.array([not self.in_view(number, each) for each in angles], dtype=bool)

    def _reaches(self, polygon_deg: FloatArray, number: int, angles: FloatArray) -> bool:
        """A mask meets a field if its edge enters the field, or if the whole field lies inside."""
        edge = _edge_points(polygon_deg) @ rotation_from_angles(*angles)
        half_right, half_up = self.half_fields[number]
        inside = (edge[:, 0] > 0.0) & (np.abs(edge[:, 1]) <= half_up * edge[:, 0])
        inside &= np.abs(edge[:, 2]) <= half_right * edge[:, 0]
        return bool(inside.any()) or _holds(polygon_deg, np.rad2deg(angles[:2]))


def _edge_points(polygon_deg: FloatArray) -> FloatArray:
    """Directions (bow, up, starboard) along the edges of a polygon, unit vectors, shape (n, 3)."""
    points = []
    for start, end in zip(polygon_deg, np.roll(polygon_deg, -1, axis=0), strict=True):
        count = int(np.ceil(np.abs(end - start).max() / _EDGE_STEP_DEG)) + 1
        points.append(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))
    azimuth, elevation = np.deg2rad(np.concatenate(points)).T
    forward, right = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([forward, np.sin(elevation), right], axis=-1)


def _holds(polygon_deg: FloatArray, direction_deg: FloatArray) -> bool:
    """Whether a direction lies in a polygon, whole turns aside: a ray upward meets an odd number of edges."""
    start, end = polygon_deg, np.roll(polygon_deg, -1, axis=0)
    for turn_deg in range(-720, 721, 360):
        azimuth_deg = direction_deg[0] + turn_deg
        crossed = (start[:, 0] <= azimuth_deg) != (end[:, 0] <= azimuth_deg)
        a, b = start[crossed], end[crossed]
        heights = a[:, 1] + (azimuth_deg - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
        if np.count_nonzero(heights > direction_deg[1]) % 2:
            return True
    return False

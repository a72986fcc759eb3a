"""Which part of the sky the sightings cover: how well they can tell axis errors apart hangs on it."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.sightings import Sightings


@dataclass(frozen=True)
class Coverage:
    """Where the sightings lie.

    Attributes:
        count: number of sightings.
        plunged: of these with the telescope tipped over the zenith.
        elevations: least and greatest true elevation, rad.
        azimuth_gap: from and to, clockwise, the widest range of azimuth without a sighting, rad.
    """

    count: int
    plunged: int
    elevations: tuple[float, float]
    azimuth_gap: tuple[float, float]

    @property
    def azimuth_gap_width(self) -> float:
        """Width of the gap, in (0, 2 pi], rad: the whole round where all sightings have one azimuth."""
        width = (self.azimuth_gap[1] - self.azimuth_gap[0]) % (2.0 * np.pi)
        return width if width > 0.0 else 2.0 * np.pi


def coverage(sightings: Sightings) -> Coverage:
    """Coverage of at least one sighting."""
    azimuth, elevation = azimuth_and_elevation(sightings.direction_d)
    ordered = np.sort(azimuth)
    following = np.roll(ordered, -1)
    widest = int(np.argmax((following - ordered) % (2.0 * np.pi)))
    return Coverage(
        count=len(sightings.labels),
        plunged=int(np.sum(np.cos(sightings.elevation) < 0.0)),
        elevations=(float(elevation.min()), float(elevation.max())),
        azimuth_gap=(float(ordered[widest]), float(following[widest])),
    )


def azimuth_and_elevation(direction_d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth in [0, 2 pi) and elevation of unit vectors, shape (n,), rad."""
    azimuth = np.arctan2(direction_d[..., 2], direction_d[..., 0]) % (2.0 * np.pi)
    return azimuth, np.arctan2(direction_d[..., 1], np.hypot(direction_d[..., 0], direction_d[..., 2]))

"""Positions of a drone within the limits, given by three box coordinates, each between 0 and 1.

At the theodolite a position has a range, an elevation e and an azimuth A + α; A and E are azimuth and elevation of the
telescope's axis. The position is in a field of the radius f if cos f ≤ sin e sin E + cos e cos E cos α. The allowed
elevations are therefore an interval, and so are the allowed azimuths at each elevation. All box coordinates meet
the limits on range, elevation and field; the separation of the drones must be checked.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import FloatArray, angle_between
from theodolite_calib.config import EscortConfig

_BOX_MARGIN = 1e-9
"""Margin of the box at each limit against rounding, as a ratio."""
_LIMIT_MARGIN = 1e-3
"""Distance from a limit up to which a position is at this limit: a ratio for lengths, radii of the field for angles."""
_POLE = 1e-12
_MIN_RANGE_M = 1.0
"""Minimum range of a beacon, m; a closer position is on board."""


@dataclass(frozen=True)
class AllowedPlaces:
    """Allowed positions of a drone for one direction of the telescope.

    Attributes:
        limits: configured limits.
        centre_n: vector from the ship's antenna to the theodolite (N, U, E), m, shape (3,).
        azimuth: azimuth of the telescope's axis in the horizon, rad.
        elevation: elevation of the telescope's axis in the horizon, rad.
        least_elevation: least elevation of a drone within limits and field, rad.
        greatest_elevation: greatest elevation of a drone, rad; less than ``least_elevation`` if no position is allowed.
    """

    limits: EscortConfig
    centre_n: FloatArray
    azimuth: float
    elevation: float
    least_elevation: float
    greatest_elevation: float

    @classmethod
    def around_axis(cls, limits: EscortConfig, centre_n: FloatArray, rotation_nt: FloatArray) -> "AllowedPlaces":
        """Return the allowed positions around the telescope's axis.

        Args:
            limits: configured limits.
            centre_n: vector from the ship's antenna to the theodolite (N, U, E), m, shape (3,).
            rotation_nt: horizon from telescope, shape (3, 3).
        """
        azimuth, elevation, _ = angles_from_rotation(rotation_nt).tolist()
        field = np.deg2rad(limits.field_deg) * (1.0 - _BOX_MARGIN)
        least = max(float(np.deg2rad(limits.elevation_min_deg)), elevation - field)
        greatest = min(float(np.deg2rad(limits.elevation_max_deg)), elevation + field, 0.5 * np.pi)
        return cls(limits, centre_n, azimuth, elevation, least, greatest)

    @property
    def unmet_limit(self) -> str:
        """Elevation limit that no position in the field meets; empty if a position meets both limits."""
        if self.least_elevation <= self.greatest_elevation:
            return ""
        low = self.elevation < np.deg2rad(self.limits.elevation_min_deg)
        return "elevation_min_deg" if low else "elevation_max_deg"

    def places_n(self, box: FloatArray) -> FloatArray:
        """Return positions from the ship's antenna (N, U, E), m, shape (..., 3).

        Args:
            box: elevation, azimuth and logarithm of the range as fractions of their allowed intervals, shape (..., 3).
        """
        inside = np.clip(box, _BOX_MARGIN, 1.0 - _BOX_MARGIN)
        elevation = self.least_elevation + inside[..., 0] * (self.greatest_elevation - self.least_elevation)
        azimuth = self.azimuth + (2.0 * inside[..., 1] - 1.0) * self._half_width(elevation)
        near, far = self.limits.range_min_m, self.limits.range_max_m
        range_m = near * (far / near) ** inside[..., 2]
        level = np.cos(elevation)
        direction_n = np.stack([level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)], axis=-1)
        places_n: FloatArray = self.centre_n + range_m[..., None] * direction_n
        return places_n

    def nearest_box(self, places_n: FloatArray) -> FloatArray:
        """Return the box coordinates of positions, clipped to the limits, shape (N, 3)."""
        path_n = places_n - self.centre_n
        range_m, elevation = self._range_and_elevation(places_n)
        range_m = np.clip(range_m, self.limits.range_min_m, self.limits.range_max_m)
        elevation = np.clip(elevation, self.least_elevation, self.greatest_elevation)
        offset = np.angle(np.exp(1j * (np.arctan2(path_n[:, 2], path_n[:, 0]) - self.azimuth)))
        near, far = self.limits.range_min_m, self.limits.range_max_m
        box = np.stack(
            [
                _ratio(elevation - self.least_elevation, self.greatest_elevation - self.least_elevation),
                0.5 + 0.5 * _ratio(offset, self._half_width(elevation)),
                _ratio(np.log(range_m / near), np.log(far / near)),
            ],
            axis=-1,
        )
        nearest: FloatArray = np.clip(box, 0.0, 1.0)
        return nearest

    def is_in_field(self, place_n: FloatArray) -> bool:
        """True if a beacon at a position (N, U, E), m, shape (3,), is in the field of the telescope."""
        range_m, _ = self._range_and_elevation(place_n[None])
        if not range_m[0] >= _MIN_RANGE_M:
            return False
        return bool(self._angles_off_axis(place_n[None])[0] <= np.deg2rad(self.limits.field_deg))

    def separations_m(self, places_n: FloatArray) -> FloatArray:
        """Return the distances between all pairs of drones, m, shape (N (N - 1) / 2,)."""
        first, second = np.triu_indices(len(places_n), k=1)
        separations_m: FloatArray = np.linalg.norm(places_n[first] - places_n[second], axis=-1)
        return separations_m

    def limits_reached(self, names: tuple[str, ...], places_n: FloatArray) -> list[str]:
        """Return the limits that positions reach: ``name: parameter``; for separations ``name, name: parameter``."""
        limits = self.limits
        (range_m, elevation), off = self._range_and_elevation(places_n), self._angles_off_axis(places_n)
        field = np.deg2rad(limits.field_deg)
        reached = []
        for number, name in enumerate(names):
            at = {
                "range_min_m": range_m[number] < limits.range_min_m * (1.0 + _LIMIT_MARGIN),
                "range_max_m": range_m[number] > limits.range_max_m * (1.0 - _LIMIT_MARGIN),
                "elevation_min_deg": elevation[number] < np.deg2rad(limits.elevation_min_deg) + _LIMIT_MARGIN * field,
                "elevation_max_deg": elevation[number] > np.deg2rad(limits.elevation_max_deg) - _LIMIT_MARGIN * field,
                "field_deg": off[number] > field * (1.0 - _LIMIT_MARGIN),
            }
            reached += [f"{name}: {limit}" for limit, is_at in at.items() if is_at]
        close = self.separations_m(places_n) < limits.separation_min_m * (1.0 + _LIMIT_MARGIN)
        for first, second, is_at in zip(*np.triu_indices(len(names), k=1), close, strict=True):
            if is_at:
                reached.append(f"{names[first]}, {names[second]}: separation_min_m")
        return reached

    def _range_and_elevation(self, places_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the range of positions, m, and their elevation, rad, shape (N,) each."""
        path_n = places_n - self.centre_n
        range_m = np.linalg.norm(path_n, axis=-1)
        elevation = np.arctan2(path_n[:, 1], np.hypot(path_n[:, 0], path_n[:, 2]))
        return range_m, elevation

    def _angles_off_axis(self, places_n: FloatArray) -> FloatArray:
        """Return the angles of positions from the telescope's axis, rad, shape (N,)."""
        axis_n = rotation_from_angles(self.azimuth, self.elevation, 0.0)[:, 0]
        return angle_between(places_n - self.centre_n, axis_n)

    def _half_width(self, elevation: FloatArray) -> FloatArray:
        """Return the greatest azimuth difference α from the axis that is in the field at an elevation, rad."""
        field = np.deg2rad(self.limits.field_deg) * (1.0 - _BOX_MARGIN)
        # cos f = cos(e - E) - cos e cos E (1 - cos α) is solved for α by half angles, accurate for small fields too.
        product = np.sin(0.5 * (field - elevation + self.elevation)) * np.sin(
            0.5 * (field + elevation - self.elevation)
        )
        level = np.maximum(np.cos(elevation) * np.cos(self.elevation), _POLE)
        width: FloatArray = 2.0 * np.arcsin(np.sqrt(np.clip(product / level, 0.0, 1.0)))
        return width


def _ratio(part: FloatArray, whole: FloatArray | float) -> FloatArray:
    """Return the ratio of a part to the whole; 0 if the whole is 0."""
    share: FloatArray = part / np.where(np.asarray(whole) == 0.0, np.inf, whole)
    return share

"""Where the main axis looks: a stabilised mount holds its line over the ship's motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.theodolite_scenario import Programme
from ship_simulation.theodolite.flight import FlightPath, direction, smooth_step, sweep_angles

_RAMP_S = 20.0
"""From following the lights to the sweep."""


@dataclass(frozen=True)
class Aim:
    """The line of the main axis.

    Attributes:
        programme: the sweep, and whether the lights are followed.
        paths: of the drones.
        gone_s: when the last of them has left.
    """

    programme: Programme
    paths: Sequence[FlightPath]
    gone_s: float

    def direction_n(self, t_s: FloatArray) -> FloatArray:
        """Unit vectors of the wanted line in (North, Up, East), shape (k, 3)."""
        if not (self.programme.follows_lights and self.paths):
            return direction(*sweep_angles(self.programme, t_s))
        following = t_s <= self.gone_s
        directions_n = np.empty((t_s.size, 3))
        directions_n[following] = self._middle_of_lights(t_s[following])
        directions_n[~following] = direction(*self._angles_after(t_s[~following]))
        return directions_n

    def _middle_of_lights(self, t_s: FloatArray) -> FloatArray:
        """Of all drones, also of one that left before the others: the line does not jump."""
        places = np.stack([path(t_s) for path in self.paths])
        summed = np.sum(places / np.linalg.norm(places, axis=-1, keepdims=True), axis=0)
        return summed / np.linalg.norm(summed, axis=-1, keepdims=True)

    def _angles_after(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The sweep, from where the lights were last."""
        left_n = self._middle_of_lights(np.array([self.gone_s]))[0]
        since_s = t_s - self.gone_s
        swept_s = np.where(since_s < _RAMP_S, 0.5 * since_s**2 / _RAMP_S, since_s - 0.5 * _RAMP_S)
        azimuth = np.arctan2(left_n[2], left_n[0]) + np.deg2rad(self.programme.azimuth_rate_deg_per_s) * swept_s
        _, elevation = sweep_angles(self.programme, t_s)
        left_elevation = np.arcsin(left_n[1])
        return azimuth, left_elevation + smooth_step(since_s / _RAMP_S) * (elevation - left_elevation)

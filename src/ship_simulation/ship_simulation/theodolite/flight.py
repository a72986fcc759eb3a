"""Paths of drones and targets, attitudes of drones, and pointing of the main axis.

Positions are relative to the intersection of the theodolite's axes, in (North, Up, East), m. The line of sight is
stabilised against the ship's motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.theodolite_scenario import Course, Escort, Flight, Hover, Orbit, Programme, Waypoint
from ship_simulation.ship.motion import HarmonicMotion

FlightPath = Callable[[FloatArray], FloatArray]
"""Times in seconds after the start, shape (k,) → positions in m, shape (k, 3)."""

_RAMP_S = 20.0
"""Duration of the transition from following the lights to the sweep, s."""


def flight_path(course: Course, programme: Programme) -> FlightPath:
    """Return the path of a drone or a target; an escort follows ``programme``."""
    paths: dict[str, FlightPath] = {
        "escort": lambda t_s: _escort_path(course.escort, programme, t_s),
        "hover": lambda t_s: _hover_path(course.hover, t_s),
        "orbit": lambda t_s: _orbit_path(course.orbit, t_s),
        "legs": lambda t_s: _leg_path(list(course.waypoints.values()), t_s),
    }
    return paths[course.kind]


def sway_motion(flight: Flight, rng: np.random.Generator) -> HarmonicMotion:
    """Return the attitude of a drone (nose, up, right): constant yaw, and a sway in pitch and roll."""
    mean = np.array([np.deg2rad(flight.yaw_deg), 0.0, 0.0])
    phasor = np.zeros((2, 3), dtype=complex)
    phasor[[0, 1], [1, 2]] = np.deg2rad(flight.sway_deg) * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, 2))
    return HarmonicMotion(mean, np.full(2, 2.0 * np.pi / flight.sway_period_s), phasor)


def sweep_angles(programme: Programme, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth, not wrapped, and elevation of the programme's line of sight, rad."""
    azimuth_deg = programme.azimuth_deg + programme.azimuth_rate_deg_per_s * t_s
    least, greatest = programme.least_elevation_deg, programme.greatest_elevation_deg
    turned = 2.0 * np.pi * t_s / programme.elevation_period_s
    elevation_deg = 0.5 * (least + greatest) - 0.5 * (greatest - least) * np.cos(turned)
    return np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)


def smooth_step(x: FloatArray) -> FloatArray:
    """Return a step from 0 (at 0) to 1 (at 1), with zero rate and acceleration at both ends, constant outside."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def direction(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return unit vectors (North, Up, East), shape (..., 3)."""
    return np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)], axis=-1
    )


def _escort_path(escort: Escort, programme: Programme, t_s: FloatArray) -> FloatArray:
    azimuth, elevation = sweep_angles(programme, t_s)
    offset = np.array([1.0, np.tan(np.deg2rad(escort.up_deg)), np.tan(np.deg2rad(escort.right_deg))])
    upright = rotation_from_angles(azimuth, elevation, np.zeros_like(azimuth))
    place: FloatArray = upright @ (escort.distance_m * offset / np.linalg.norm(offset))
    return place


def _hover_path(hover: Hover, t_s: FloatArray) -> FloatArray:
    drift_m_per_s = np.array([hover.north_m_per_s, hover.up_m_per_s, hover.east_m_per_s])
    return _position(hover.azimuth_deg, hover.elevation_deg, hover.distance_m) + drift_m_per_s * t_s[:, None]


def _orbit_path(orbit: Orbit, t_s: FloatArray) -> FloatArray:
    azimuth_deg = orbit.azimuth_deg + orbit.rate_deg_per_s * t_s
    return _position(azimuth_deg, np.full_like(t_s, orbit.elevation_deg), orbit.distance_m)


def _leg_path(waypoints: list[Waypoint], t_s: FloatArray) -> FloatArray:
    """Return positions on straight legs with a stop at each waypoint, constant before the first and after the last."""
    waypoints = sorted(waypoints, key=lambda waypoint: waypoint.time_s)
    moments_s = np.array([waypoint.time_s for waypoint in waypoints])
    places = np.array([_position(w.azimuth_deg, w.elevation_deg, w.distance_m) for w in waypoints])
    leg = np.clip(np.searchsorted(moments_s, t_s, side="right") - 1, 0, len(waypoints) - 2)
    flown = smooth_step((t_s - moments_s[leg]) / (moments_s[leg + 1] - moments_s[leg]))
    place: FloatArray = places[leg] + flown[:, None] * (places[leg + 1] - places[leg])
    return place


def _position(azimuth_deg: FloatArray | float, elevation_deg: FloatArray | float, distance_m: float) -> FloatArray:
    return distance_m * direction(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg))


@dataclass(frozen=True)
class Aim:
    """The line of sight of the main axis.

    Attributes:
        programme: sweep of the main axis, and the choice whether the lights are followed.
        paths: paths of the drones.
        last_departure_s: time when the last drone leaves.
    """

    programme: Programme
    paths: Sequence[FlightPath]
    last_departure_s: float

    def direction_n(self, t_s: FloatArray) -> FloatArray:
        """Return unit vectors of the required line of sight in (North, Up, East), shape (k, 3)."""
        if not (self.programme.follows_lights and self.paths):
            return direction(*sweep_angles(self.programme, t_s))
        following = t_s <= self.last_departure_s
        directions_n = np.empty((t_s.size, 3))
        directions_n[following] = self._middle_of_beacons(t_s[following])
        directions_n[~following] = direction(*self._sweep_angles_after(t_s[~following]))
        return directions_n

    def _middle_of_beacons(self, t_s: FloatArray) -> FloatArray:
        """Return unit vectors to the middle of all drones; drones that have left are included to avoid jumps."""
        places = np.stack([path(t_s) for path in self.paths])
        summed = np.sum(places / np.linalg.norm(places, axis=-1, keepdims=True), axis=0)
        middle_n: FloatArray = summed / np.linalg.norm(summed, axis=-1, keepdims=True)
        return middle_n

    def _sweep_angles_after(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return azimuth and elevation of the sweep that starts at the last direction of the lights, rad."""
        left_n = self._middle_of_beacons(np.array([self.last_departure_s]))[0]
        since_s = t_s - self.last_departure_s
        swept_s = np.where(since_s < _RAMP_S, 0.5 * since_s**2 / _RAMP_S, since_s - 0.5 * _RAMP_S)
        north, up, east = left_n
        azimuth = np.arctan2(east, north) + np.deg2rad(self.programme.azimuth_rate_deg_per_s) * swept_s
        _, elevation = sweep_angles(self.programme, t_s)
        left_elevation = np.arcsin(up)
        return azimuth, left_elevation + smooth_step(since_s / _RAMP_S) * (elevation - left_elevation)

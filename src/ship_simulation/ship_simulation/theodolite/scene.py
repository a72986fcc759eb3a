"""True theodolite, drones, lights and targets at any time, from which the measurements are computed.

Positions are relative to the intersection of the theodolite's axes, in (North, Up, East), m. The line of sight is
stabilised against the ship's motion. The constants of the theodolite are drawn once per run about the scenario's known
values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ship_bags.errors import BadInput
from ship_estimation.parameters.theodolite_devices import LeverConfig
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import NAMES, AxisErrors, encoder_angles, main_axis_rotation
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_simulation.random_draws import CorrelatedError, Draws, is_outside, random_stream
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.scenario.theodolite_scenario import (
    Axes,
    Beacon,
    Course,
    Escort,
    Flight,
    Hover,
    Orbit,
    Programme,
    Target,
    Theodolite,
    Waypoint,
)
from ship_simulation.ship.motion import Carrier, HarmonicMotion

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


@dataclass(frozen=True)
class TrueTheodolite:
    """The constants of the theodolite.

    Attributes:
        axis_errors: errors of the theodolite's axes.
        parallelism: azimuth, elevation and rotation of the main axis in the telescope frame, rad, shape (3,).
        focal_length_m: focal length of the telescope.
        lever_d: vector from the ship's antenna to the intersection of the axes, m, shape (3,).
        lens_m: vector from this intersection to the principal point N' of the telescope's lens, main frame, m, shape
            (3,).
    """

    axis_errors: AxisErrors
    parallelism: FloatArray
    focal_length_m: float
    lever_d: FloatArray
    lens_m: FloatArray


def draw_theodolite(config: Theodolite, seed: int) -> TrueTheodolite:
    """Return the true constants: the known constants plus drawn errors. ``lens_m`` also contains ``lens_untold``."""
    telescope, off = config.telescope, config.telescope.lens_untold
    angle_errors = random_stream(seed, "theodolite.parallelism").standard_normal(3)
    focal_error = random_stream(seed, "theodolite.focal_length").standard_normal()
    return TrueTheodolite(
        axis_errors=AxisErrors.from_vector(_draw_axis_errors(config.axes, seed)),
        parallelism=telescope.parallelism + telescope.parallelism_sigma * angle_errors,
        focal_length_m=telescope.focal_length_m + telescope.focal_length_sigma_m * focal_error,
        lever_d=draw_lever(config.lever, "theodolite.lever", seed),
        lens_m=draw_lever(telescope.lens, "theodolite.lens", seed) + np.array([off.forward_m, off.up_m, off.right_m]),
    )


def draw_lever(lever: LeverConfig, name: str, seed: int) -> FloatArray:
    """Return the true vector, m, shape (3,): the surveyed vector plus a drawn error."""
    return lever.vector_m + lever.sigma_m * random_stream(seed, name).standard_normal(3)


def _draw_axis_errors(axes: Axes, seed: int) -> FloatArray:
    known, sigma = axes.values, axes.sigma
    rng = random_stream(seed, "theodolite.axes")
    if axes.spread == "uniform":
        # Uniform distribution with the same sigma.
        return known + sigma * rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), len(NAMES))
    return known + sigma * rng.standard_normal(len(NAMES))


@dataclass(frozen=True)
class ObservedBody:
    """A body that the theodolite observes.

    Attributes:
        config: part of the scenario for the body.
        path: path of the body, relative to the intersection of the theodolite's axes.
        refraction: additional error of the refraction coefficient k on the line of sight to the body, one component.
    """

    config: Beacon | Target
    path: FlightPath
    refraction: CorrelatedError

    def is_visible(self, t_s: FloatArray) -> np.ndarray:
        """True if the body is present and not hidden, shape (k,)."""
        shown: np.ndarray = (t_s < self.config.leaves_s) & is_outside(t_s, self.config.hidden)
        return shown


@dataclass(frozen=True)
class TrueBeacon(ObservedBody):
    """A drone with its light; ``path`` is the path of its antenna.

    Attributes:
        config: part of the scenario for the drone.
        attitude: attitude of the drone (nose, up, right).
        lever_b: vector from the drone's antenna to its light, in the axes of the drone, m, shape (3,).
    """

    config: Beacon
    attitude: Carrier
    lever_b: FloatArray


@dataclass(frozen=True)
class MountState:
    """The mount at given times.

    Attributes:
        azimuth: true angle of the azimuth encoder, rad, 0 to 2 pi, shape (k,).
        elevation: true angle of the elevation encoder, rad, shape (k,).
        deformation_d: rotation vector of the theodolite's base against the deck, rad, shape (k, 3).
        rotation_nd: horizon from deck, shape (k, 3, 3).
        rotation_nm: horizon from main frame, shape (k, 3, 3).
    """

    azimuth: FloatArray
    elevation: FloatArray
    deformation_d: FloatArray
    rotation_nd: FloatArray
    rotation_nm: FloatArray


@dataclass(frozen=True)
class Scene:
    """True theodolite, lights and air of one run.

    Attributes:
        carrier: motion of the ship.
        theodolite: constants of the theodolite.
        deformation: rotation vector of the theodolite's base against the deck, rad.
        aim: required line of sight of the main axis.
        beacons: id → drone with a light, in the order of ids.
        refraction: the error of k that is common to all lights and targets, one component.
        coefficient: known value of the refraction coefficient k.
    """

    carrier: Carrier
    theodolite: TrueTheodolite
    deformation: CorrelatedError
    aim: Aim
    beacons: dict[str, TrueBeacon]
    refraction: CorrelatedError
    coefficient: float

    def mount(self, t_s: FloatArray) -> MountState:
        """Return the mount at times of shape (k,).

        Raises:
            BadInput: the line of sight is outside the range of the axes, or a recorded motion does not cover the times.
        """
        rotation_nd = self.carrier.attitude(t_s)
        deformation_d = self.deformation.values_at(t_s)
        rotation_nf = rotation_nd @ exp_rotation(deformation_d)
        wanted_f = (self.aim.direction_n(t_s)[:, None, :] @ rotation_nf)[:, 0, :]
        errors = self.theodolite.axis_errors
        azimuth, elevation = encoder_angles(errors, wanted_f)
        if not np.all(np.isfinite(azimuth)):
            late = t_s[~np.isfinite(azimuth)][0]
            raise BadInput(f"at {late:.2f} s the theodolite would point along its vertical axis: reduce its elevation")
        rotation_nm = rotation_nf @ main_axis_rotation(errors, azimuth, elevation)
        return MountState(azimuth, elevation, deformation_d, rotation_nd, rotation_nm)

    def rotation_nt(self, mount: MountState) -> FloatArray:
        """Return horizon from telescope, shape (k, 3, 3)."""
        rotation_nt: FloatArray = mount.rotation_nm @ rotation_from_angles(*self.theodolite.parallelism).T
        return rotation_nt

    def directions_n(self, t_s: FloatArray, mount: MountState) -> FloatArray:
        """Return unit vectors along which the lights are observed, shape (k, N, 3)."""
        lens_n = mount.rotation_nm @ self.theodolite.lens_m
        common = self.coefficient + self.refraction.values_at(t_s)[:, 0]
        seen = [
            refracted_directions(
                light.path(t_s) + light.attitude.attitude(t_s) @ light.lever_b - lens_n,
                common + light.refraction.values_at(t_s)[:, 0],
            )
            for light in self.beacons.values()
        ]
        return np.stack(seen, axis=1) if seen else np.empty((t_s.size, 0, 3))


def refracted_directions(path_n: FloatArray, coefficient: FloatArray) -> FloatArray:
    """Return unit vectors along the vectors ``path_n``, raised by ``coefficient`` · (horizontal distance) / (2 R)."""
    north_m, up_m, east_m = path_n.T
    horizontal_m = np.hypot(north_m, east_m)
    elevation = np.arctan2(up_m, horizontal_m) + coefficient * horizontal_m / (2.0 * EARTH_RADIUS_M)
    return direction(np.arctan2(east_m, north_m), elevation)


def draw_scene(scenario: Scenario, carrier: Carrier, draws: Draws) -> Scene:
    """Return the true quantities of one run of a scenario."""
    config, duration_s, seed = scenario.theodolite, scenario.duration_s, draws.seed
    beacons = {
        key: TrueBeacon(
            config=beacon,
            path=flight_path(beacon.flight, config.programme),
            attitude=sway_motion(beacon.flight, random_stream(seed, f"beacon.{key}.sway")),
            lever_b=draw_lever(beacon.light, f"beacon.{key}.light", seed),
            refraction=draws.correlated_error(
                f"beacon.{key}.refraction", duration_s, np.array([config.air.light_sigma]), config.air.time_s
            ),
        )
        for key, beacon in sorted(scenario.beacons.items())
    }
    return Scene(
        carrier=carrier,
        theodolite=draw_theodolite(config, seed),
        deformation=draws.correlated_error(
            "theodolite.deformation",
            duration_s,
            np.full(3, np.deg2rad(config.deformation.sigma_arcsec / 3600.0)),
            config.deformation.time_s,
        ),
        aim=Aim(
            programme=config.programme,
            paths=[light.path for light in beacons.values()],
            last_departure_s=max((light.config.leaves_s for light in beacons.values()), default=0.0),
        ),
        beacons=beacons,
        refraction=draws.correlated_error(
            "theodolite.refraction", duration_s, np.array([config.air.sigma]), config.air.time_s
        ),
        coefficient=config.air.coefficient,
    )

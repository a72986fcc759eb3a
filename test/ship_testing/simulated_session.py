"""Simulated session with a theodolite: sightings for the filter, computed without tracks, messages or scenario.

True values are drawn with the sigmas of the configuration unless given: deformation and ship's error are Gauss–Markov,
axis errors uniform in size and of either sign. Two lights at 2 km are at (3°, 2°) and (-2°, -3°) from the axis of the
calibration telescope, [W18].
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ship_estimation.parameters.schema import build, nest
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.mount.image import Image
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M, BeaconPoses
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.samples.tracks import EncoderAt, ShipAt

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
BEACONS_DEG = {"alpha": (3.0, 2.0), "bravo": (-2.0, -3.0)}
DISTANCE_M = 2000.0
AXIS_SIGMA_ARCSEC = 26.5
"""RMS of a size drawn between 10" and 40"."""

SHIP_SIGMA_N = ARCSEC * np.array([1.4, 1.8, 1.4])
"""Standard deviations of a fused attitude about North, Up, East: models.md §2, eight stars in each of two sensors."""


def config(**changes) -> OpticalAxisConfig:
    """Return the configuration of the session, with dotted parameters changed (``__`` for the dot)."""
    axes = {f"axes.{name}_sigma_arcsec": AXIS_SIGMA_ARCSEC for name in ("g", "h", "c", "I", "beta_x", "beta_y")}
    values = {
        "telescope.telescope_id": "main",
        "telescope.focal_length_m": 0.1,
        "telescope.focal_length_sigma_m": 1e-4,
        "telescope.sigma_m": 0.65e-6,
        "lever.forward_m": 12.0,
        "lever.up_m": 3.0,
        "lever.right_m": -2.0,
        "ship_antenna.sigma_m": 0.0,
        "air.sigma": 0.0,
        "air.light_sigma": 0.0,
        **axes,
        **{f"beacons.{name}.rtk.bias_sigma_m": 0.0 for name in BEACONS_DEG},
    }
    return build(OpticalAxisConfig, nest({**values, **{name.replace("__", "."): v for name, v in changes.items()}}))


def gauss_markov(rng, times_s: FloatArray, sigma: FloatArray, time_s: float) -> FloatArray:
    """Return a Gauss–Markov process at increasing times, shape (k, n); values are independent if ``time_s`` is 0."""
    values = np.empty((len(times_s), len(sigma)))
    value, last_s = sigma * rng.standard_normal(len(sigma)), times_s[0]
    for index, now_s in enumerate(times_s):
        decay = np.exp(-(now_s - last_s) / time_s) if time_s > 0.0 else float(now_s == last_s)
        value = decay * value + np.sqrt(1.0 - decay**2) * sigma * rng.standard_normal(len(sigma))
        values[index], last_s = value, now_s
    return values


@dataclass(frozen=True)
class Session:
    """True values at some times, and the device measurements.

    Attributes:
        times_s: shape (k,).
        axes: true axis errors, rad, shape (7,).
        rotation_nm: true rotation to the horizon from the main frame, shape (k, 3, 3).
        sightings: inputs of the filter, one at each time.
        parallelism: true parallelism of the calibration telescope, rad, shape (3,).
        focal_length_m: true focal length of the calibration telescope.
    """

    times_s: FloatArray
    axes: FloatArray
    rotation_nm: FloatArray
    sightings: list[Sighting]
    parallelism: FloatArray
    focal_length_m: float


def sweep(times_s: FloatArray, low_deg: float = 10.0, high_deg: float = 70.0) -> FloatArray:
    """Return azimuth and elevation, rad: once round in five minutes, up and down four times, shape (k, 2)."""
    middle, half = 0.5 * (low_deg + high_deg), 0.5 * (high_deg - low_deg)
    return np.deg2rad(
        np.stack([1.2 * times_s + 5.0, middle - half * np.cos(2.0 * np.pi * times_s / 75.0)], axis=-1)
    )


def session(
    settings: OpticalAxisConfig,
    seed: int,
    times_s: FloatArray,
    encoder: FloatArray,
    ship_sigma_n: FloatArray = SHIP_SIGMA_N,
    motion_scale: float = 1.0,
    lens_error_m: FloatArray | None = None,
    beacons_deg: Mapping[str, tuple[float, float]] = MappingProxyType(BEACONS_DEG),
    distance_m: FloatArray | None = None,
    focal_length_m: float | None = None,
) -> Session:
    """Return a session with the errors of a configuration, drawn by a seed.

    Args:
        settings: configuration, with the sigmas of the errors.
        seed: seed of all errors.
        times_s: of the sightings, shape (k,).
        encoder: true angles of the encoders, rad, shape (k, 2).
        ship_sigma_n: standard deviations of the ship's correlated error about North, Up and East, rad, shape (3,).
        motion_scale: factor of the ship's pitch and roll; 0 for a ship without motion.
        lens_error_m: error of the configured principal point N', shape (3,); None for a drawn error.
        beacons_deg: name → angles to the right of and above the axis of the calibration telescope.
        distance_m: of the lights at each time, shape (k,); None for 2 km.
        focal_length_m: true focal length of the calibration telescope; None for a drawn value.
    """
    rng = np.random.default_rng(seed)
    names, count = list(beacons_deg), len(times_s)
    sigma_axes = settings.axes.sigma
    size = rng.uniform(10.0, 40.0, 7) * rng.choice([-1.0, 1.0], 7) * sigma_axes / AXIS_SIGMA_ARCSEC
    axes = settings.axes.values + size
    deformation = gauss_markov(
        rng, times_s, np.full(3, settings.deformation.sigma_arcsec * ARCSEC), settings.deformation.time_s
    )
    ship_error = gauss_markov(rng, times_s, ship_sigma_n, settings.ship.slow_time_s)
    antenna = gauss_markov(rng, times_s, np.full(3, settings.ship_antenna.sigma_m), settings.ship_antenna.time_s)
    common_k = gauss_markov(rng, times_s, np.array([settings.air.sigma]), settings.air.time_s)
    own_k = gauss_markov(rng, times_s, np.full(len(names), settings.air.light_sigma), settings.air.time_s)
    beacons = [settings.beacons[name].rtk for name in names]
    rtk = [gauss_markov(rng, times_s, np.full(3, beacon.bias_sigma_m), beacon.bias_time_s) for beacon in beacons]
    rtk_noise = np.array([beacon.sigma_m for beacon in beacons])
    lever_d = settings.lever.vector_m + settings.lever.sigma_m * rng.standard_normal(3)
    drawn_m = settings.telescope.lens.sigma_m * rng.standard_normal(3)
    lens_m = settings.telescope.lens.vector_m + (drawn_m if lens_error_m is None else lens_error_m)
    parallelism = settings.telescope.parallelism + settings.telescope.parallelism_sigma * rng.standard_normal(3)
    drawn_length_m = settings.telescope.focal_length_m + settings.telescope.focal_length_sigma_m * rng.standard_normal()
    if focal_length_m is None:
        focal_length_m = drawn_length_m
    white = settings.ship.white_sigma_arcsec * ARCSEC
    encoder_sigma = settings.encoder.sigma_arcsec * ARCSEC

    # If the ship's attitude comes from the INS, the filter uses the configured covariance.
    stated_n = np.diag(ship_sigma_n**2) if settings.ship.source == "ship/attitude" else None

    pitch, roll = (
        motion_scale * 0.02 * np.sin(2 * np.pi * times_s / 7.0),
        motion_scale * 0.05 * np.sin(2 * np.pi * times_s / 11.0),
    )
    rotation_nd = rotation_from_angles(np.full(count, 0.7), pitch, roll)
    rotation_nm = (
        rotation_nd
        @ exp_rotation(deformation)
        @ main_axis_rotation(AxisErrors.from_vector(axes), encoder[:, 0], encoder[:, 1])
    )
    rotation_nt = rotation_nm @ rotation_from_angles(*parallelism).T
    right, up = np.tan(np.deg2rad(np.array(list(beacons_deg.values())))).T
    around_t = np.stack([np.ones_like(up), up, right], axis=-1)
    around_t /= np.linalg.norm(around_t, axis=-1, keepdims=True)
    direction_n = around_t @ np.swapaxes(rotation_nt, -1, -2)

    sightings = []
    distances_m = np.full(count, DISTANCE_M) if distance_m is None else distance_m
    for k, away_m in enumerate(distances_m):
        light_n = away_m * direction_n[k]
        lens_n = rotation_nd[k] @ lever_d + rotation_nm[k] @ lens_m
        baseline_n = light_n + lens_n
        coefficient = settings.air.coefficient + common_k[k] + own_k[k]
        seen_n = light_n + (coefficient * away_m**2 / (2 * EARTH_RADIUS_M))[:, None] * np.array([0.0, 1.0, 0.0])
        seen_t = seen_n @ rotation_nt[k]
        point_m = -focal_length_m * seen_t[:, [2, 1]] / seen_t[:, :1]
        point_m += settings.telescope.sigma_m * rng.standard_normal((len(names), 2))
        measured_n = baseline_n - antenna[k] - np.array([bias[k] for bias in rtk])
        measured_n += rtk_noise[:, None] * rng.standard_normal((len(names), 3))
        turn = ship_error[k] + white * rng.standard_normal(3)
        sightings.append(
            Sighting(
                START_NS + round(times_s[k] * SECOND_NS),
                tuple(names),
                Image(point_m, np.full(len(names), settings.telescope.sigma_m)),
                BeaconPoses(
                    measured_n,
                    rtk_noise[:, None, None] ** 2 * np.eye(3),
                    np.broadcast_to(np.eye(3), (len(names), 3, 3)),
                    np.zeros((len(names), 3, 3)),
                ),
                ShipAt(exp_rotation(turn).T @ rotation_nd[k], np.zeros(3), stated_n, white**2),
                EncoderAt(*(encoder[k] + encoder_sigma * rng.standard_normal(2)).tolist(), encoder_sigma**2),
            )
        )
    return Session(times_s, axes, rotation_nm, sightings, parallelism, focal_length_m)

"""Samples of an INS: waves, turns, noise, rounding, rates with errors; and steps added to them."""

from dataclasses import replace

import numpy as np

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample

Angles = tuple[float, float, float]

CALM, SWELL, STORM = (0.05, 0.1, 0.2), (0.5, 2.0, 4.0), (5.0, 8.0, 25.0)
"""Amplitudes of heading, pitch and roll, deg."""
PERIODS_S = (30.0, 8.0, 11.0)


def attitudes(t_s: FloatArray, amplitude_deg: Angles, turn_deg_per_s: float = 0.0) -> FloatArray:
    """Return horizon from deck, shape (n, 3, 3)."""
    swing = np.sin(2.0 * np.pi * t_s[:, None] / np.array(PERIODS_S) + np.array([0.0, 0.0, 0.3]))
    mean_deg = np.array([34.0, 0.0, 0.0]) + turn_deg_per_s * t_s[:, None] * np.array([1.0, 0.0, 0.0])
    return rotation_from_angles(*np.deg2rad(mean_deg + np.array(amplitude_deg) * swing).T)


def stream(
    duration_s: float,
    rate_hz: float,
    amplitude_deg: Angles = SWELL,
    printed_deg: float = 0.0,
    white_arcsec: float = 1.0,
    rate_noise_arcsec_per_s: float = 0.0,
    bias_arcsec_per_s: float = 0.0,
    rate_factor: float = 1.0,
    rate_delay_s: float = 0.0,
    turn_deg_per_s: float = 0.0,
    earth_n: FloatArray | None = None,
    seed: int = 7,
) -> list[AttitudeSample]:
    """Return the samples in order; ``earth_n`` (North, Up, East), rad/s, is added to the rates."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    noise = ARCSEC * rng.standard_normal((2, t_s.size, 3))
    motion = amplitude_deg, turn_deg_per_s
    before, after = (attitudes(t_s - rate_delay_s + step_s, *motion) for step_s in (-1e-4, 1e-4))
    true_nd = attitudes(t_s, *motion)
    rate_d = rate_factor * log_rotation(np.swapaxes(before, 1, 2) @ after) / 2e-4
    rate_d += rate_noise_arcsec_per_s * noise[0] + bias_arcsec_per_s * ARCSEC
    if earth_n is not None:
        rate_d += earth_n @ true_nd
    rotation_nd = exp_rotation(white_arcsec * noise[1]) @ true_nd
    if printed_deg:
        angles = angles_from_rotation(rotation_nd)
        rotation_nd = rotation_from_angles(*(np.round(angles / np.deg2rad(printed_deg)) * np.deg2rad(printed_deg)).T)
    times_ns = 10**18 + np.rint(1e9 * t_s).astype(int)
    return [AttitudeSample(*values) for values in zip(times_ns.tolist(), rotation_nd, rate_d, strict=True)]


def with_step(
    samples: list[AttitudeSample], first: int, arcsec_n: Angles, last: int | None = None
) -> list[AttitudeSample]:
    """Return the samples with attitudes ``first`` to ``last`` - 1 rotated about North, Up and East."""
    step = exp_rotation(np.array(arcsec_n) * ARCSEC)
    end = len(samples) if last is None else last
    turned = [replace(sample, rotation_nd=step @ sample.rotation_nd) for sample in samples[first:end]]
    return [*samples[:first], *turned, *samples[end:]]

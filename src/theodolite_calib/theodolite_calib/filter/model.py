"""Which states the calibration filter has, built from its configuration (models.md §5).

=========================  =========  =================================================================================
state                      frame      meaning; errors are true minus used
=========================  =========  =================================================================================
ship.attitude (3)          horizon    slow error a of the ship's attitude: R_true = exp(a) R
ship.time_offset (1)                  a sample of the INS is valid at its stamp + this; only with the INS as source
deformation (3)            deck       e: the theodolite's base is turned by exp(e) against the deck
axes (7)                              axis errors in the order of theodolite_calib.chain.axes.NAMES
focal_length (1)                      m
parallelism (3)                       azimuth, elevation, rotation of the main axis in the telescope
ship_antenna (3)           horizon    error of all baselines, m; this and the following only where they have a sigma
lever (3)                  deck       from the ship's antenna to the theodolite, m
lens (3)                   main       from the crossing of the axes to N', m
refraction (1)                        of the coefficient k, the same for all lights
light.<id>.rtk (3)         horizon    slow error of this baseline, m
light.<id>.lever (3)       drone      from the drone's antenna to its light, m
light.<id>.attitude (3)    horizon    of the drone's attitude, rad
light.<id>.refraction (1)             what k differs by on the way to this light
=========================  =========  =================================================================================
"""

from dataclasses import dataclass

import numpy as np

from ship_estimation.state import StateBlock, StateModel, block
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.config import BeaconConfig, OpticalAxisConfig

SOURCE_SHIP = "ship_attitude"
SOURCE_SHIP_NOISE = "ship_noise"
SOURCE_SHIP_TIME = "ship_time_offset"
SOURCE_DEFORMATION = "deformation"
SOURCE_AXES = "axis_errors"
SOURCE_FOCAL_LENGTH = "focal_length"
SOURCE_PARALLELISM = "parallelism"
SOURCE_RTK = "rtk"
SOURCE_LEVERS = "lever_arms"
SOURCE_LENS = "principal_point"
SOURCE_REFRACTION = "refraction"
SOURCE_DRONE = "drone_attitude"
SOURCE_IMAGE = "image"
SOURCE_ENCODER = "encoder"
SOURCE_SAVED = "saved_calibration"

COMMON_TERMS = {
    "rtk_base": "ship_antenna",
    "theodolite_lever": "lever",
    "principal_point": "lens",
    "refraction": "refraction",
}
"""Error term of all lines of sight (:mod:`theodolite_calib.lights.line_of_sight`) → its state."""

OWN_TERMS = {
    "rtk_bias": "rtk",
    "light_lever": "lever",
    "drone_attitude": "attitude",
    "light_refraction": "refraction",
}
"""Error term of one line of sight → its state, after ``light.<id>.``."""

_AT_ONCE = 2.0


def state_model(config: OpticalAxisConfig) -> StateModel:
    """All states of a configuration, and the sources of error of its budget."""
    blocks = [*_ship_blocks(config), *_theodolite_blocks(config), *_path_blocks(config)]
    for id_, beacon in config.beacons.items():
        blocks += _light_blocks(id_, beacon, config)
    known = {"ship.attitude", "deformation", "axes", "focal_length", "parallelism"}
    used = [entry for entry in blocks if entry.name in known or np.any(entry.sigma > 0.0)]
    noise_sources = [SOURCE_SHIP_NOISE, SOURCE_ENCODER, SOURCE_IMAGE, SOURCE_RTK, SOURCE_SAVED]
    return StateModel(used, noise_sources)


def _ship_blocks(config: OpticalAxisConfig) -> list[StateBlock]:
    if config.ship.source == "ship/attitude":
        # Its size comes with the messages, so it starts without any.
        return [block("ship.attitude", [0.0] * 3, SOURCE_SHIP, time_s=config.ship.slow_time_s)]
    ins = config.ins
    tilt, heading = ins.tilt_sigma_arcsec * ARCSEC, ins.heading_sigma_arcsec * ARCSEC
    time_s = [ins.tilt_time_s, ins.heading_time_s, ins.tilt_time_s]
    return [
        block("ship.attitude", [tilt, heading, tilt], SOURCE_SHIP, time_s=time_s),
        block("ship.time_offset", [ins.time_offset_sigma_s], SOURCE_SHIP_TIME),
    ]


def _theodolite_blocks(config: OpticalAxisConfig) -> list[StateBlock]:
    telescope, deformation = config.telescope, config.deformation
    deformation_sigma = [deformation.sigma_arcsec * ARCSEC] * 3
    return [
        block("deformation", deformation_sigma, SOURCE_DEFORMATION, time_s=deformation.time_s),
        block("axes", config.axes.sigma, SOURCE_AXES),
        block("focal_length", [telescope.focal_length_sigma_m], SOURCE_FOCAL_LENGTH),
        block("parallelism", telescope.parallelism_sigma, SOURCE_PARALLELISM),
    ]


def _path_blocks(config: OpticalAxisConfig) -> list[StateBlock]:
    """What all lines of sight have in common."""
    antenna, air = config.ship_antenna, config.air
    return [
        block("ship_antenna", [antenna.sigma_m] * 3, SOURCE_RTK, time_s=antenna.time_s),
        block("lever", [config.lever.sigma_m] * 3, SOURCE_LEVERS),
        block("lens", [config.telescope.lens.sigma_m] * 3, SOURCE_LENS),
        block("refraction", [air.sigma], SOURCE_REFRACTION, time_s=air.time_s),
    ]


def _light_blocks(id_: str, beacon: BeaconConfig, config: OpticalAxisConfig) -> list[StateBlock]:
    tilt, heading = np.deg2rad([beacon.imu.tilt_sigma_deg, beacon.imu.heading_sigma_deg])
    # A light at the antenna is where it is, however the drone stands.
    turns = bool(np.any(beacon.light.vector_m))
    attitude = [tilt, heading, tilt] if turns else [0.0] * 3
    rtk, air = beacon.rtk, config.air
    return [
        block(f"light.{id_}.rtk", [rtk.bias_sigma_m] * 3, SOURCE_RTK, time_s=rtk.bias_time_s),
        block(f"light.{id_}.lever", [beacon.light.sigma_m] * 3, SOURCE_LEVERS),
        block(f"light.{id_}.attitude", attitude, SOURCE_DRONE, time_s=beacon.imu.time_s),
        block(f"light.{id_}.refraction", [air.light_sigma], SOURCE_REFRACTION, time_s=air.time_s),
    ]


@dataclass(frozen=True)
class ShipErrorStep:
    """What happens to the error at once.

    Attributes:
        kept: share of each component that is left, shape (3,).
        new_n: covariance of what comes anew, rad², shape (3, 3).
    """

    kept: FloatArray
    new_n: FloatArray


def ship_error_step(followed_n: FloatArray, now_n: FloatArray) -> ShipErrorStep | None:
    """The step from one stated covariance to another, rad², shape (3, 3) each; None where there is none."""
    old, new = np.diagonal(followed_n), np.diagonal(now_n)
    if np.all(new <= _AT_ONCE * old) and np.all(old <= _AT_ONCE * new):
        return None
    kept = np.where(old > 0.0, np.minimum(new / np.where(old > 0.0, old, 1.0), 1.0), 1.0)
    left_n = now_n - followed_n * np.outer(kept, kept)
    # Not all changes of a matrix are such a step in each axis: what would be negative is none.
    values, vectors = np.linalg.eigh(0.5 * (left_n + left_n.T))
    return ShipErrorStep(kept, (vectors * np.maximum(values, 0.0)) @ vectors.T)


def with_step(
    mean: FloatArray, parts: FloatArray, rows: slice, source_index: int, step: ShipErrorStep
) -> tuple[FloatArray, FloatArray]:
    """State and covariance parts after the step; the arguments are left as they are.

    Args:
        mean: shape (n,).
        parts: shape (n_sources, n, n).
        rows: where the ship's error is.
        source_index: of its source.
        step: what happens.
    """
    mean, parts = mean.copy(), parts.copy()
    mean[rows] *= step.kept
    parts[:, rows, :] *= step.kept[:, None]
    parts[:, :, rows] *= step.kept
    parts[source_index, rows, rows] += step.new_n
    return mean, parts

"""The states of the calibration filter, built from its configuration, and how the ship's error evolves.

=========================  =========  =================================================================================
state                      frame      meaning; errors are true minus used
=========================  =========  =================================================================================
ship.attitude (3)          horizon    slow error a of the ship's attitude: R_true = exp(a) R
ship.time_offset (1)                  a sample of the INS is valid at its stamp + this; only with the INS as source
deformation (3)            deck       e: the theodolite's base is turned by exp(e) against the deck
axes (7)                              axis errors in the order of theodolite_calib.chain.axes.NAMES
focal_length (1)                      m; of the calibration telescope, for lights and for stars seen through it
parallelism (3)                       azimuth, elevation, rotation of the main axis in the telescope
ship_antenna (3)           horizon    error of all baselines, m; this and the following only where they have a sigma
lever (3)                  deck       from the ship's antenna to the theodolite, m
lens (3)                   main       from the crossing of the axes to N', m
telescope.<id>.parallelism            as parallelism, of another camera that sees stars (3)
telescope.<id>.optics (4)             errors of the optics of a camera that sees stars: focal length, principal
                                      point (u, v) and k1, in their sigmas; 3 in the calibration telescope, whose
                                      focal length is the one above
telescope.<id>.field (18)             field-spatial error of a camera that sees stars, in sigmas
sky.<cause>                           what all stars share, in sigmas (ship_attitude_star.sky.shared_states); only where
                                      there are such cameras
refraction (1)                        of the coefficient k, the same for all lights
light.<id>.rtk (3)         horizon    slow error of this baseline, m
light.<id>.lever (3)       drone      from the drone's antenna to its light, m
light.<id>.attitude (3)    horizon    of the drone's attitude, rad
light.<id>.refraction (1)             further error of k on the way to this light
=========================  =========  =================================================================================
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.sky.shared_states import sky_blocks
from ship_attitude_star.stars.camera_states import camera_blocks
from ship_attitude_star.stars.residuals import SOURCE_STAR_NOISE
from ship_attitude_star.stars.spatial_errors import SOURCE_PIXEL
from ship_estimation.kalman import StateBlock, StateModel, block, lasting, slow_error_later
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.chain.axes import CHAIN_STATES
from theodolite_calib.config import BeaconConfig, OpticalAxisConfig, StarCameraConfig

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
"""A stated variance that changes by more than this factor has changed at once."""


def state_model(config: OpticalAxisConfig) -> StateModel:
    """All states of a configuration, and the sources of error of its budget."""
    blocks = [*_ship_blocks(config), *_theodolite_blocks(config), *_path_blocks(config)]
    for id_, camera in config.telescopes.items():
        blocks += _camera_blocks(id_, camera, config)
    for id_, beacon in config.beacons.items():
        blocks += _light_blocks(id_, beacon, config)
    known = {"ship.attitude", "deformation", "axes", "focal_length", "parallelism"}
    known |= {parallelism_block(id_, config) for id_ in config.telescopes}
    used = [entry for entry in blocks if entry.name in known or np.any(entry.sigma > 0.0)]
    noise_sources = [SOURCE_SHIP_NOISE, SOURCE_ENCODER, SOURCE_IMAGE, SOURCE_RTK, SOURCE_SAVED]
    if config.telescopes:
        used += sky_blocks(config.sky)
        noise_sources.append(SOURCE_STAR_NOISE)
    if any(one.camera.pixel_spatial_sigma_px > 0.0 for one in config.telescopes.values()):
        noise_sources.append(SOURCE_PIXEL)
    return StateModel(used, noise_sources)


def chain_rows(model: StateModel) -> NDArray[np.intp]:
    """Where the states that turn the main axis are, in the order of CHAIN_STATES."""
    return np.concatenate([model.rows(name) for name in CHAIN_STATES if name in model.slices])


def parallelism_block(id_: str, config: OpticalAxisConfig) -> str:
    """Name of the states of a star camera's parallelism; the calibration telescope has one by lights and by stars."""
    return "parallelism" if id_ == config.telescope.telescope_id else f"telescope.{id_}.parallelism"


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
    """States of errors that all lines of sight have in common."""
    antenna, air = config.ship_antenna, config.air
    return [
        block("ship_antenna", [antenna.sigma_m] * 3, SOURCE_RTK, time_s=antenna.time_s),
        block("lever", [config.lever.sigma_m] * 3, SOURCE_LEVERS),
        block("lens", [config.telescope.lens.sigma_m] * 3, SOURCE_LENS),
        block("refraction", [air.sigma], SOURCE_REFRACTION, time_s=air.time_s),
    ]


def _camera_blocks(id_: str, camera: StarCameraConfig, config: OpticalAxisConfig) -> list[StateBlock]:
    if id_ == config.telescope.telescope_id:
        return camera_blocks(f"telescope.{id_}", camera.camera, has_focal_length=False)
    parallelism = block(parallelism_block(id_, config), camera.parallelism_sigma, SOURCE_PARALLELISM)
    return [parallelism, *camera_blocks(f"telescope.{id_}", camera.camera)]


def _light_blocks(id_: str, beacon: BeaconConfig, config: OpticalAxisConfig) -> list[StateBlock]:
    tilt, heading = np.deg2rad([beacon.imu.tilt_sigma_deg, beacon.imu.heading_sigma_deg])
    # The place of a light at the antenna does not depend on the drone's attitude.
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
    """What happens to the ship's error at once, where its stated covariance changes by much; at one moment, or at N.

    Attributes:
        kept: share of each component that is left, shape (3,) or (N, 3).
        new_n: covariance of what is new, rad², shape (3, 3) or (N, 3, 3).
    """

    kept: FloatArray
    new_n: FloatArray


class ShipErrorProcess:
    """How the ship's attitude error evolves, whose size is stated by the messages and may change at once.

    Between two messages the error is a Gauss–Markov process with the steady covariance that the messages state. Where
    that covariance changes by more than a factor of two, more has happened than the process allows: stars came, or
    another system took over. Then a step follows, axis by axis (:func:`ship_error_step`).

    Args:
        config: the node's parameters.
        model: states of the filter.

    Attributes:
        columns: where the error is in the state.
        source_index: of its source of error.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel) -> None:
        self.columns = model.slices["ship.attitude"]
        self.source_index = model.sources.index(SOURCE_SHIP)
        # The error of the INS alone may have jumped: what is far beyond its sigma does not die out.
        by_ins = config.ship.source == "ins/imu"
        self._sigma = model.blocks["ship.attitude"].sigma if by_ins else None

    def later(self, error_n: FloatArray, decay: FloatArray) -> FloatArray:
        """The error after some time, rotation vector in n, rad, shape (..., 3).

        Args:
            error_n: before, shape (..., 3).
            decay: of the process over the time, shape (3,).
        """
        return decay * error_n if self._sigma is None else slow_error_later(error_n, decay, self._sigma)

    def lasting(self, error_n: FloatArray) -> NDArray[np.bool_]:
        """Which components of the error do not die out, shape (3,)."""
        return np.zeros(3, dtype=bool) if self._sigma is None else lasting(error_n, self._sigma)

    def carried(
        self,
        mean: FloatArray,
        parts: FloatArray,
        columns: slice,
        decay: FloatArray,
        steady_n: FloatArray | None,
        now_n: FloatArray | None,
        source_index: int | None = None,
    ) -> tuple[FloatArray, FloatArray, ShipErrorStep | None]:
        """State and covariance parts with what the messages state, and the step where that changes at once.

        Args:
            mean: the state, shape (..., n).
            parts: shape (..., n_sources, n, n), decayed and without the noise of the ship's error; changed in place.
            columns: where the ship's error is in these two.
            decay: of the error over the time, shape (3,).
            steady_n: stated covariance that the error has followed, rad², shape (3, 3); None where none was stated.
            now_n: that is stated now; None where none is.
            source_index: of the ship's error in ``parts``; None where these are those of the filter.
        """
        source_index = self.source_index if source_index is None else source_index
        add_steady_noise(parts, columns, source_index, decay, steady_n)
        step = ship_error_step(steady_n, now_n)
        if step is not None:
            mean, parts = with_step(mean, parts, columns, source_index, step)
        return mean, parts, step


def add_steady_noise(
    parts: FloatArray, columns: slice, source_index: int, decay: FloatArray, steady_n: FloatArray | None
) -> None:
    """Add in place the noise that keeps the ship's error at its stated covariance.

    Args:
        parts: shape (..., n_sources, n, n), decayed already.
        columns: where the ship's error is in them.
        source_index: of the ship's error.
        decay: of the error over the time, shape (3,).
        steady_n: the stated covariance, rad², shape (3, 3); None where none is stated.
    """
    if steady_n is not None:
        parts[..., source_index, columns, columns] += (1.0 - decay[0] ** 2) * steady_n


def ship_error_step(followed_n: FloatArray | None, now_n: FloatArray | None) -> ShipErrorStep | None:
    """The step from one stated covariance to another, rad², shape (3, 3) each; None where there is none.

    Args:
        followed_n: that the error has followed; None where none was stated.
        now_n: that is stated now; None where none is, and nothing happens.
    """
    if now_n is None:
        return None
    steps = ship_error_steps(followed_n, now_n[None])
    return None if steps is None else ShipErrorStep(steps.kept[0], steps.new_n[0])


def ship_error_steps(followed_n: FloatArray | None, now_n: FloatArray) -> ShipErrorStep | None:
    """The steps from one stated covariance to each of N others; None where there is none to any of them.

    Where the variance shrank, the share new / old of the old error is left: a Kalman update that reduced the variance
    by as much would leave the same. Where the variance grew, all of the old error is left. The rest is new.

    Args:
        followed_n: that the error has followed, rad², shape (3, 3); None where none was stated.
        now_n: that is stated at each moment, shape (N, 3, 3).

    Returns:
        A step whose fields have a leading axis of N; where nothing happens all is left, and nothing is new.
    """
    if followed_n is None:
        followed_n = np.zeros((3, 3))
    old, new = followed_n.diagonal(), now_n.diagonal(axis1=1, axis2=2)
    near = np.logical_and(new <= _AT_ONCE * old, old <= _AT_ONCE * new)
    if near.all():
        return None
    stays = np.all(near, axis=1)
    kept = np.where(old > 0.0, np.minimum(new / np.where(old > 0.0, old, 1.0), 1.0), 1.0)
    left_n = now_n - followed_n * (kept[:, :, None] * kept[:, None, :])
    # Not every change of a matrix is such a step in each axis: a negative variance is taken for zero.
    values, vectors = np.linalg.eigh(0.5 * (left_n + left_n.swapaxes(1, 2)))
    new_n = (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.swapaxes(1, 2)
    return ShipErrorStep(np.where(stays[:, None], 1.0, kept), np.where(stays[:, None, None], 0.0, new_n))


def with_step(
    mean: FloatArray, parts: FloatArray, columns: slice, source_index: int, step: ShipErrorStep
) -> tuple[FloatArray, FloatArray]:
    """State and covariance parts after the step; the arguments are left as they are.

    Args:
        mean: shape (..., n).
        parts: shape (..., n_sources, n, n).
        columns: where the ship's error is.
        source_index: of its source.
        step: what happens.
    """
    mean, parts = mean.copy(), parts.copy()
    mean[..., columns] *= step.kept
    parts[..., columns, :] *= step.kept[:, None]
    parts[..., columns] *= step.kept
    parts[..., source_index, columns, columns] += step.new_n
    return mean, parts

"""States of the calibration filter, determined by its configuration, and the process of the ship's error.

=========================  =========  =================================================================================
state                      frame      meaning; errors are true minus used
=========================  =========  =================================================================================
ship.attitude (3)          horizon    correlated error a of the ship's attitude: R_true = exp(a) R
ship.time_offset (1)                  true minus stated time of INS samples, s; only with the INS as source
deformation (3)            deck       e: the theodolite's base is rotated by exp(e) relative to the deck
axes (7)                              axis errors in the order of ship_geometry.mount.axes.NAMES
focal_length (1)                      error of the calibration telescope's focal length, for beacons and stars, m
parallelism (3)                       errors of azimuth, elevation and rotation of the main axis in the telescope
ship_antenna (3)           horizon    error common to all baselines, m; from here on, states exist only with a sigma
lever (3)                  deck       error of the vector from the ship's antenna to the theodolite, m
lens (3)                   main       error of the vector from the intersection of the axes to N', m
telescope.<id>.parallelism            errors of another star camera's parallelism (3); these exist without a sigma too
telescope.<id>.optics (4)             errors of the optics of a star camera: focal length, principal point (u, v) and
                                      k1, in their sigmas; calibration telescope: 3, without the focal length
telescope.<id>.field (18)             field-spatial error of a star camera, in sigmas
sky.<cause>                           errors common to all stars, in sigmas (ship_stars.sky.sky_model);
                                      only with star cameras
refraction (1)                        error of the refraction coefficient k, common to all beacons
light.<id>.rtk (3)         horizon    correlated error of this light's baseline, m
light.<id>.lever (3)       drone      error of the vector from the drone's antenna to its light, m
light.<id>.attitude (3)    horizon    error of the drone's attitude, rad
light.<id>.refraction (1)             further error of k on the path to this light
=========================  =========  =================================================================================
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import (
    StateBlock,
    StateModel,
    block,
    exceeds_model,
    propagate_correlated_error,
)
from ship_geometry.mount.axes import AXES, DEFORMATION, SHIP, SHIP_TIME
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_from_stars.residuals import SOURCE_STAR_NOISE
from ship_stars.camera.config import camera_blocks
from ship_stars.camera.errors import SOURCE_PIXEL
from ship_stars.sky.sky_model import sky_blocks
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
"""State of each error term common to all lines of sight (:mod:`ship_geometry.mount.line_of_sight`)."""

OWN_TERMS = {
    "rtk_bias": "rtk",
    "light_lever": "lever",
    "drone_attitude": "attitude",
    "light_refraction": "refraction",
}
"""State of each error term of one line of sight, without the prefix ``light.<id>.``."""

AXIS_STATES = {"ship.attitude": SHIP, "deformation": DEFORMATION, "axes": AXES, "ship.time_offset": SHIP_TIME}
"""Filter states that rotate the main axis, with their columns of ``by_error``, in order."""

_STEP_RATIO = 2.0
"""Factor by which a stated variance may increase or decrease without a step of the error."""


def state_model(config: OpticalAxisConfig) -> StateModel:
    """Return all states and error sources of a configuration."""
    blocks = [*_ship_blocks(config), *_theodolite_blocks(config), *_path_blocks(config)]
    for id_, camera in config.telescopes.items():
        blocks += _camera_blocks(id_, camera, config)
    for id_, beacon in config.beacons.items():
        blocks += _beacon_blocks(id_, beacon, config)
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


def axis_state_indices(model: StateModel) -> NDArray[np.intp]:
    """Return the indices of the states that rotate the main axis, in the order of AXIS_STATES."""
    return np.concatenate([model.state_indices(name) for name in AXIS_STATES if name in model.slices])


def parallelism_block(id_: str, config: OpticalAxisConfig) -> str:
    """Return the name of a star camera's parallelism states; for the calibration telescope ``parallelism``."""
    return "parallelism" if id_ == config.telescope.telescope_id else f"telescope.{id_}.parallelism"


def _ship_blocks(config: OpticalAxisConfig) -> list[StateBlock]:
    if config.ship.source == "ship/attitude":
        # The messages state the covariance of this error; its initial covariance is zero.
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
    """Return the states of errors common to all lines of sight."""
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


def _beacon_blocks(id_: str, beacon: BeaconConfig, config: OpticalAxisConfig) -> list[StateBlock]:
    tilt, heading = np.deg2rad([beacon.imu.tilt_sigma_deg, beacon.imu.heading_sigma_deg])
    # The position of a light at the antenna does not depend on the drone's attitude.
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
    """Step of the ship's error due to a large change of its stated covariance, at one time or at N times.

    Attributes:
        retained: factor on each component of the old error, shape (3,) or (N, 3).
        added_n: covariance of the added error, rad², shape (3, 3) or (N, 3, 3).
    """

    retained: FloatArray
    added_n: FloatArray


class ShipErrorProcess:
    """Process of the ship's attitude error; the messages or, for the INS, the configuration state its covariance.

    Between two messages the error is a Gauss–Markov process with the stated covariance as its stationary covariance. If
    a stated variance changes by more than a factor of two, for example because stars became available, the error has a
    step, axis by axis (:func:`ship_error_steps`).

    Args:
        config: parameters of the node.
        model: states of the filter.

    Attributes:
        columns: slice of the ship's error in the state.
        source_index: index of the error source.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel) -> None:
        self.columns = model.slices["ship.attitude"]
        self.source_index = model.sources.index(SOURCE_SHIP)
        # The error of the INS alone may have jumped; a component far beyond its sigma then does not decay.
        by_ins = config.ship.source == "ins/imu"
        self._sigma = model.blocks["ship.attitude"].sigma if by_ins else None

    def propagate(self, error_n: FloatArray, decay: FloatArray) -> FloatArray:
        """Propagate the error, a rotation vector in n, rad, shape (..., 3).

        Args:
            error_n: error before propagation, shape (..., 3).
            decay: decay factors of the process over the propagation time, shape (3,).
        """
        return decay * error_n if self._sigma is None else propagate_correlated_error(error_n, decay, self._sigma)

    def exceeds_model(self, error_n: FloatArray) -> NDArray[np.bool_]:
        """True for each component of the error that exceeds the model and so does not decay, shape (3,)."""
        return np.zeros(3, dtype=bool) if self._sigma is None else exceeds_model(error_n, self._sigma)

    def apply_stated_covariance(
        self,
        mean: FloatArray,
        parts: FloatArray,
        decay: FloatArray,
        previous_n: FloatArray | None,
        stated_n: FloatArray | None,
        source_index: int | None = None,
    ) -> ShipErrorStep | None:
        """Apply the stated covariance to a propagated state, in place; return the step of the error, or None.

        Args:
            mean: mean of the state, shape (..., n).
            parts: covariance by source, shape (..., n_sources, n, n), decayed and without the noise of the ship's
                error.
            decay: decay factors of the error over the propagation time, shape (3,).
            previous_n: previously stated covariance, rad², shape (3, 3); None adds no noise.
            stated_n: newly stated covariance; None gives no step.
            source_index: index of the ship's error source in ``parts``; None for the filter's ``source_index``.
        """
        columns, source_index = self.columns, self.source_index if source_index is None else source_index
        if previous_n is not None:
            parts[..., source_index, columns, columns] += (1.0 - decay[0] ** 2) * previous_n
        steps = None if stated_n is None else ship_error_steps(previous_n, stated_n[None])
        if steps is None:
            return None
        (retained,), (added_n,) = steps.retained, steps.added_n
        mean[..., columns] *= retained
        parts[..., columns, :] *= retained[:, None]
        parts[..., columns] *= retained
        parts[..., source_index, columns, columns] += added_n
        return ShipErrorStep(retained, added_n)


def ship_error_steps(previous_n: FloatArray | None, stated_n: FloatArray) -> ShipErrorStep | None:
    """Return the steps from one stated covariance to each of N stated covariances; None if no step occurs.

    If a variance decreased, the factor on the old error is the ratio of the new to the old variance, as after a Kalman
    update with the same decrease. If the variance increased, the whole old error remains. The rest of the new
    covariance is added as a new error.

    Args:
        previous_n: previously stated covariance, rad², shape (3, 3); None counts as zero.
        stated_n: covariances stated at N times, shape (N, 3, 3).

    Returns:
        Step whose fields have a leading axis of N; without a step the factor is 1 and the added covariance is 0.
    """
    if previous_n is None:
        previous_n = np.zeros((3, 3))
    old, new = previous_n.diagonal(), stated_n.diagonal(axis1=1, axis2=2)
    is_similar = np.logical_and(new <= _STEP_RATIO * old, old <= _STEP_RATIO * new)
    if is_similar.all():
        return None
    has_no_step = np.all(is_similar, axis=1)
    retained = np.where(old > 0.0, np.minimum(new / np.where(old > 0.0, old, 1.0), 1.0), 1.0)
    remaining_n = stated_n - previous_n * (retained[:, :, None] * retained[:, None, :])
    # The remaining covariance need not be positive semidefinite; its negative eigenvalues are set to zero.
    values, vectors = np.linalg.eigh(0.5 * (remaining_n + remaining_n.swapaxes(1, 2)))
    new_n = (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.swapaxes(1, 2)
    return ShipErrorStep(
        np.where(has_no_step[:, None], 1.0, retained), np.where(has_no_step[:, None, None], 0.0, new_n)
    )

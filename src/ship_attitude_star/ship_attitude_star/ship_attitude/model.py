"""State vector of the ship-attitude filter.

The model is described in docs/explanation/filter.md.

==============================  =======  ====================================================================
state                           frame    meaning
==============================  =======  ====================================================================
ins.attitude (3)                horizon  correlated error a: R_true = exp(a) exp(w) R_ins
gravity.deflection (2)                   deflection of the vertical, which is then part of a; only with
                                         gravity.deflection, or if ins.model is schuler and
                                         gravity.unknown_sigma_arcsec is above 0
ins.velocity (2)                horizon  velocity error of the INS (North, East), m/s; this and the next three states
                                         only if ins.model is schuler
ins.latitude (1)                         latitude error of the INS, rad
ins.gyro_drift (3)              horizon  drift of the INS gyroscopes, rad/s
ins.accelerometer_bias (2)      horizon  bias of the INS accelerometers (North, East), m/s²
ins.noise (3)                   horizon  white error w of the INS at the time of the measurement
ins.time_offset (1)                      tau: an INS sample is valid at its stamp + tau
star.<id>.installation (3)      sensor   m: R(sensor -> deck) = R(A0, E0, roll0) exp(m)
star.<id>.common (3)            horizon  error common to successive solutions: R_measured = exp(c) R_true ...
star.<id>.time_offset (1)                offset: a message is valid at its stamp + offset; only with a sigma
star.<id>.flexure (3)           deck     hull flexure between INS and sensor; only with a sigma
star.<id>.optics (4)                     errors of focal length, principal point (u, v) and k1, in their own sigmas;
                                         only of a sensor with single-star messages
star.<id>.field (18)                     field-spatial error of the sensor, coefficients in their own sigmas; only
                                         of a sensor with single-star messages and such an error
sky.refraction (1)                       error of refraction, in its own sigmas; this and the next two states only if
                                         the messages of a sensor depend on the sky model
sky.earth_rotation (1)                   error of UT1, in its own sigmas
sky.position (2)                         error of the ship's position, in its own sigmas
sky.utc (1)                              error of UTC, in its own sigmas; only with a sigma
sky.common (3)                           error common to messages of several sensors, in its own sigmas; only if a
                                         sensor shares its messages' errors
reference.<name>.installation   device   as for a star sensor, from the INS's deck axes
reference.<name>.slow           device   correlated error; only with a sigma
baseline.installation           baseline as for a star sensor, about the two transverse axes of the baseline;
                                         only with a ship_baseline
baseline.common                 horizon  error common to successive solutions; only with a sigma
reference.<name>.time_offset             stamp of the reference - stamp of the INS for the same attitude
==============================  =======  ====================================================================

With R_i the attitude of the INS at the time of a measurement, a device measures

    R_measured = exp(-z) exp(c) exp(a) exp(w) R_i exp(f) R0 exp(m) exp(s) exp(noise)        horizon from device

where c is the common error of a star sensor, f its flexure, m the installation error and s the correlated error of a
reference. All star sensors share z, the rotation of the sky, which is a sum over its causes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ins_errors.gauss_markov import GaussMarkovIns
from ship_attitude_star.ins_errors.process import InsProcess
from ship_attitude_star.ins_errors.schuler import SchulerIns
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.devices import SOURCE_STAR_COMMON, InsConfig
from ship_attitude_star.ship_attitude.measurements.kind import SOURCE_INTERPOLATION, Device
from ship_estimation.kalman.kalman_filter import StateBlock, StateModel, block
from ship_estimation.parameters.ins_errors import SCHULER, SchulerConfig
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.samples.attitude_samples import SHARED_BY_MESSAGES
from ship_stars.sky.shared_states import sky_blocks

SOURCE_INS = "ins_drift"
SOURCE_INS_NOISE = "ins_noise"
SOURCE_DEFLECTION = "deflection"
SOURCE_INS_TIME = "ins_time_offset"
SOURCE_SAVED_ALIGNMENT = "saved_alignment"

_IDENTITY = np.eye(3)


@dataclass(frozen=True)
class RotationChain:
    """Chain of rotations from a device to the horizon, for :func:`ship_kernels.compiled_rotations.composed_attitude`.

    Attributes:
        links: index of the first state of each rotation, from the device outwards, shape (k,).
        fixed: constant rotation to the left of each link, shape (k, 3, 3).
        hull_link: index of the last link of the hull; the INS attitude is to the left of this link.
        noise_link: index of the link of the white INS noise.
        clock_states: indices of the states that shift the INS time, shape (c,).
        clock_signs: signs of these states, shape (c,).
    """

    links: NDArray[np.intp]
    fixed: FloatArray
    hull_link: int
    noise_link: int
    clock_states: NDArray[np.intp]
    clock_signs: FloatArray


class ShipStateModel(StateModel):
    """The state vector of a configuration.

    Attributes:
        rotation_chains: chain of rotations of each device, by name.
        ins_attitude_block: standard deviation and correlation time of the INS attitude error.
        ins_process: error process of the INS; None if each axis is a first-order Gauss-Markov process.
        process_indices: indices of the states of ``ins_process``, or of ``ins.attitude`` without a process.
    """

    def __init__(self, config: ShipAttitudeConfig) -> None:
        blocks, devices = _ins_blocks(config.ins), config.devices.values()
        self.ins_attitude_block, self.ins_process = blocks[0], _ins_process(config, blocks[0])
        if self.ins_process is not None:
            # The process propagates these states; as a block they are constant.
            blocks[0] = block("ins.attitude", self.ins_attitude_block.sigma, SOURCE_INS)
        if config.models_deflection:
            blocks.append(block("gravity.deflection", [0.0, 0.0], SOURCE_DEFLECTION))
        if config.ins.model == SCHULER:
            blocks += _schuler_blocks(config.ins.schuler)
        for device in devices:
            blocks += device.blocks if device.is_star else ()
        if any(star.needs_sky for star in config.star_sensors.values()):
            blocks += sky_blocks(config.sky)
        sharing = [star for star in config.star_sensors.values() if star.shared_error == SHARED_BY_MESSAGES]
        if sharing:
            time_s = max(star.common_time_s for star in sharing)
            blocks.append(block("sky.common", [1.0] * 3, SOURCE_STAR_COMMON, time_s=time_s))
        for device in devices:
            blocks += () if device.is_star else device.blocks
        noise_sources = [name for device in devices for name in device.noise_sources]
        super().__init__(blocks, [SOURCE_INTERPOLATION, *noise_sources, SOURCE_SAVED_ALIGNMENT])
        process_blocks = ("ins.attitude",) if self.ins_process is None else self.ins_process.blocks
        self.process_indices = np.concatenate([self.state_indices(name) for name in process_blocks])
        self.rotation_chains = {device.name: self._rotation_chain(device) for device in devices}

    def _rotation_chain(self, device: Device) -> RotationChain:
        """Return the chain of rotations of a device, from the device outwards."""
        fixed_rotations = {
            f"{device.name}.slow": _IDENTITY,
            f"{device.name}.installation": device.rotation_dv0,
            f"{device.name}.flexure": _IDENTITY,
            "ins.noise": _IDENTITY,
            "ins.attitude": _IDENTITY,
            f"{device.name}.common": _IDENTITY,
        }
        links = [name for name in fixed_rotations if name in self.slices]
        white = links.index("ins.noise")
        return RotationChain(
            links=np.array([self.slices[name].start for name in links], dtype=np.intp),
            fixed=np.array([fixed_rotations[name] for name in links]),
            hull_link=white - 1,
            noise_link=white,
            clock_states=np.array([self.slices[name].start for name, _ in device.ins_time_states], dtype=np.intp),
            clock_signs=np.array([sign for _, sign in device.ins_time_states]),
        )


def _ins_process(config: ShipAttitudeConfig, ins_attitude: StateBlock) -> InsProcess | None:
    """Return the error process of the INS; None if each axis is a first-order Gauss-Markov process."""
    length_m = config.gravity.correlation_length_m if config.models_deflection else None
    if config.ins.model == SCHULER:
        return SchulerIns(config.ins.schuler, ins_attitude.sigma, length_m)
    return None if length_m is None else GaussMarkovIns(ins_attitude, length_m)


def _schuler_blocks(schuler: SchulerConfig) -> list[StateBlock]:
    return [
        block("ins.velocity", [schuler.velocity_sigma_m_per_s] * 2, SOURCE_INS),
        block("ins.latitude", [schuler.latitude_sigma], SOURCE_INS),
        block("ins.gyro_drift", [schuler.gyro_drift] * 3, SOURCE_INS),
        block("ins.accelerometer_bias", [schuler.accelerometer_bias_sigma_m_per_s2] * 2, SOURCE_INS),
    ]


def _ins_blocks(ins: InsConfig) -> list[StateBlock]:
    tilt, heading, white = (
        sigma * ARCSEC for sigma in (ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.white_sigma_arcsec)
    )
    tilt_time, heading_time = ins.tilt_time_s, ins.heading_time_s
    return [
        block("ins.attitude", [tilt, heading, tilt], SOURCE_INS, time_s=[tilt_time, heading_time, tilt_time]),
        block("ins.noise", [white] * 3, SOURCE_INS_NOISE, time_s=0.0),
        block("ins.time_offset", [ins.time_offset_sigma_s], SOURCE_INS_TIME),
    ]

"""State vector of the ship-attitude filter, and the subfilters, which each exclude one source or two sources.

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

The main filter uses all sources that are not excluded. Each subfilter excludes one more source; with
``integrity.pairs`` some subfilters exclude two sources. A subfilter without the INS treats the correlated error of the
INS as unknown, and still uses the change of the INS attitude between measurements. A ship with a single source besides
the INS has no subfilter without the INS.
"""

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ins_errors.process import GaussMarkovIns, InsProcess
from ship_attitude_star.ins_errors.schuler import SchulerIns
from ship_attitude_star.ship_attitude.config import SOURCE_STAR_COMMON, InsConfig, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.measurements.device import SOURCE_INTERPOLATION, Device
from ship_estimation.fault_detection.common_error import common_threshold
from ship_estimation.fault_detection.subfilters import SubfilterTable
from ship_estimation.integrity.protection_levels import SigmaMultipliers, sigma_multipliers
from ship_estimation.kalman.kalman_filter import StateBlock, StateModel, block
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.parameters.ship_devices import SCHULER, SchulerConfig
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_samples import SHARED_BY_MESSAGES
from ship_stars.sky.sky_model import sky_blocks

SOURCE_INS = "ins_drift"
SOURCE_INS_NOISE = "ins_noise"
SOURCE_DEFLECTION = "deflection"
SOURCE_INS_TIME = "ins_time_offset"
SOURCE_SAVED_ALIGNMENT = "saved_alignment"

_IDENTITY = np.eye(3)

INS = "ins"

ALL_STARS = "all_stars"
"""Name of the hypothesis of an error that all star sensors share."""

MIN_SOURCES_FOR_PAIRS = 3
"""Minimum number of sources besides the INS for subfilters without two sources.

A subfilter without two of three sources uses the third source and the INS, which check each other. A subfilter without
one of three sources and the INS uses the two other sources.
"""

_MIN_FOR_CROSS_CHECK = 2
"""Minimum number of sources besides the INS that check one another."""


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


class RelevantHypotheses(NamedTuple):
    """Fault hypotheses of an attitude that is computed from some of the sources.

    Attributes:
        indices: indices of the hypotheses, shape (h,); index 0 is the first subfilter.
        names: names of the hypotheses.
        is_cross_checked: True if at least two sources of the attitude besides the INS are in use, one of them a star
            sensor.
    """

    indices: NDArray[np.intp]
    names: tuple[str, ...]
    is_cross_checked: bool


class ShipSubfilters(SubfilterTable):
    """The h filters of a configuration (the main filter first), for s sources of n states.

    Args:
        config: configuration of the node.
        model: state vector.
        devices: sources by name.

    Attributes:
        stars: names of the star sensors.
        ins_subfilters: indices of the subfilters that exclude the INS.
        used_by: for each source, True for the filters that use the source, if no source is excluded, shape (h,).
        own_states: for each source, True for the states that belong to the source alone, shape (n,).
        updatable_states: for each source, True for the states that each filter updates with measurements of the source,
            if no source is excluded, shape (h, n).
        k: sigma multipliers K of the protection levels.
        common_k_md: multiplier K_md (missed detection) for the hypothesis of an error that all star sensors share.
        common_threshold: threshold of the sum of the star corrections, in standard deviations; above this threshold all
            stars contradict the INS.

    Raises:
        ParameterError: there are more filters than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        one = (*devices, INS) if len(devices) > 1 else tuple(devices)
        with_pairs = config.integrity.pairs and len(devices) >= MIN_SOURCES_FOR_PAIRS
        two = itertools.combinations(one, 2) if with_pairs else ()
        prior = config.integrity.prior_per_h
        prior_per_h = {name: prior.star_sensor if one.is_star else prior.reference for name, one in devices.items()}
        prior_per_h[INS] = prior.ins
        super().__init__(tuple(devices), (*((name,) for name in one), *two), prior_per_h, config.integrity)
        self._check_count(config.integrity.max_hypotheses)
        self.ins_subfilters = tuple(row for row, names in enumerate(self.excluded_sources, start=1) if INS in names)
        self.used_by = {name: self.uses[:, index].copy() for index, name in enumerate(self.sources)}
        self.own_states = {name: _own_states(model, name) for name in self.sources}
        self.updatable_states = {
            name: self.uses[:, index, None] | self.own_states[name] for index, name in enumerate(self.sources)
        }
        k = sigma_multipliers(config.integrity, [*self.priors_per_h, prior.all_stars])
        self.k: SigmaMultipliers = replace(k, missed_detection=k.missed_detection[:-1])
        self.common_k_md = float(k.missed_detection[-1])
        self.common_threshold = common_threshold(config.integrity)
        self.stars = frozenset(name for name, one in devices.items() if one.is_star)
        self._relevant: dict[tuple[tuple[str, ...], tuple[str, ...]], RelevantHypotheses] = {}

    def relevant_pairs(self, in_use: Collection[str], excluded: Collection[str]) -> list[int]:
        """Return the subfilters that exclude two sources in use; none for fewer than three sources besides the INS.

        The result is empty while the INS is excluded: if two pairs of sensors contradict each other without the INS,
        neither pair is isolated as faulty.

        Args:
            in_use: sources in use, without the INS.
            excluded: names of the excluded sources, the INS included.
        """
        if INS in excluded or len(in_use) < MIN_SOURCES_FOR_PAIRS:
            return []
        sources = {INS, *in_use}
        return [row for row in self.pair_subfilters if sources.issuperset(self.excluded_sources[row - 1])]

    def can_show_ins_fault(self, in_use: Collection[str]) -> bool:
        """True if two or more sources are in use and at least one of them is not a star sensor.

        Star sensors alone cannot show a fault of the INS, because an error of position, UTC or refraction rotates all
        star sensors equally.
        """
        return len(in_use) >= _MIN_FOR_CROSS_CHECK and not self.stars.issuperset(in_use)

    def relevant_hypotheses(self, sources: tuple[str, ...], excluded: Collection[str]) -> RelevantHypotheses:
        """Return the fault hypotheses of an attitude; results are cached.

        Args:
            sources: sources of the attitude, the INS included.
            excluded: names of the excluded sources, the INS included.
        """
        key = sources, tuple(excluded)
        if key not in self._relevant:
            others = [name for name in sources if name in self.sources and name not in excluded]
            hypotheses = [row - 1 for row in self.single_subfilters if self.names[row - 1] not in excluded]
            hypotheses += [row - 1 for row in self.relevant_pairs(others, excluded)]
            names = tuple(self.names[number] for number in hypotheses)
            is_cross_checked = len(others) >= _MIN_FOR_CROSS_CHECK and not self.stars.isdisjoint(others)
            indices = np.array(hypotheses, dtype=np.intp)
            self._relevant[key] = RelevantHypotheses(indices, names, is_cross_checked)
        return self._relevant[key]

    def _check_count(self, most: int) -> None:
        if self.count > most:
            reason = f"parameter 'integrity.max_hypotheses' = {most} is less than the {self.count} for these sources: "
            reason += ", ".join(self.names)
            if len(self.excluded_sources[-1]) > 1:
                reason += f"; set it to {self.count}, or 'integrity.pairs' to false"
            raise ParameterError(reason, "integrity.max_hypotheses", value=most)


def _own_states(model: ShipStateModel, source: str) -> NDArray[np.bool_]:
    """Return a mask of the states that belong to one source alone, shape (n,)."""
    own = np.zeros(model.size, dtype=bool)
    for name, rows in model.slices.items():
        own[rows] = name.startswith(f"{source}.")
    return own

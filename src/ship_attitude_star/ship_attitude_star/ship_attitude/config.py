"""Parameters of the ``ship_attitude`` node and its sensors, with unit, range and meaning; names are dotted.

The parameters of a sensor also give its device, and its states and noise sources in the filter.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ship_attitude_star.ship_attitude.measurements.device import Device
from ship_attitude_star.ship_attitude.measurements.devices import (
    BASELINE,
    BaselineDevice,
    ReferenceDevice,
    StarCameraDevice,
    TrackerDevice,
)
from ship_attitude_star.vertical.deflection import GravityConfig
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_estimation.kalman.kalman_filter import block
from ship_estimation.parameters.fields import (
    FrameNames,
    accept_unset_covariance,
    arcsec,
    autosave_period,
    mapping_of,
    parameter,
    publish_tf,
    saved_age,
    section,
    sources_off,
    stamp_age,
)
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.parameters.ship_devices import (
    SCHULER,
    BaselineSurvey,
    InsCorrelationTimes,
    InsErrorModel,
    ReferenceErrors,
    StarInsConfig,
    StarSensorErrors,
)
from ship_estimation.recovery.recovery import RecoveryConfig
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_from_stars.residuals import SOURCE_STAR_NOISE
from ship_stars.attitude_samples import SHARED_BY_MESSAGES, SHARED_BY_SKY
from ship_stars.camera.config import CameraConfig, MountingConfig, StarSensorsById, camera_blocks
from ship_stars.camera.errors import SOURCE_PIXEL
from ship_stars.sky.config import InertialConfig, SkyConfig

SOURCE_INSTALLATION = "installation"
SOURCE_STAR_COMMON = "star_common"
SOURCE_STAR_TIME = "star_time_offset"
SOURCE_FLEXURE = "flexure"
SOURCE_REFERENCE = "reference_installation"
SOURCE_REFERENCE_NOISE = "reference_noise"
SOURCE_REFERENCE_SLOW = "reference_slow_error"
SOURCE_REFERENCE_TIME = "reference_time_offset"
SOURCE_BASELINE = "baseline_installation"
SOURCE_BASELINE_NOISE = "baseline_noise"
SOURCE_BASELINE_COMMON = "baseline_common"

FIX_TYPES = ("float", "fixed")
"""RTK solution types from which a direction is computed."""

BY_INPUT = "by_input"
"""Value of ``shared`` with which the parameter ``input`` determines the shared error."""

_MIN_BASELINE_M = 0.3
"""Minimum baseline length, m; at this length an error of 1 cm is 2°."""

_SQRT_HOUR = 60.0

GEODETIC, GRAVITY = "geodetic", "gravity"

_SOLVED_INPUTS = ("solution", "horizon_attitude")
"""Inputs that are attitudes relative to the horizon."""


@dataclass(frozen=True, kw_only=True)
class InsConfig(InsErrorModel, InsCorrelationTimes, StarInsConfig):
    """Parameters of the inertial navigation system."""

    silence_s: float = parameter(
        1.0,
        doc="timeout: without usable samples for this long there is no INS attitude",
        unit="s",
        minimum=0.05,
        maximum=60.0,
    )


@dataclass(frozen=True, kw_only=True)
class StarSensorConfig(StarSensorErrors, MountingConfig):
    """Parameters of a star sensor: mounting, uncertainty of the mounting, noise and clock."""

    input: str = parameter(
        "horizon_attitude",
        doc="topic under star/<id>/ that the filter uses",
        choices=("horizon_attitude", "solution", "observations", "inertial_attitude"),
    )
    shared: str = parameter(
        BY_INPUT,
        doc="part of a message's correlated error that other sensors share; none: no part; sky: the part by refraction,"
        " UT1 and gnss/fix; message: all of it; by_input: none for input horizon_attitude, else sky",
        choices=(BY_INPUT, "none", SHARED_BY_MESSAGES, SHARED_BY_SKY),
    )
    camera: CameraConfig = section(CameraConfig)
    inertial: InertialConfig = section(InertialConfig)
    serial: str = parameter("", doc="serial number; a saved alignment of another serial number is not used")
    installation_walk_forward_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the boresight", unit="arcsec/sqrt(h)", minimum=0.0
    )
    installation_walk_up_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the up axis", unit="arcsec/sqrt(h)", minimum=0.0
    )
    installation_walk_right_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the right axis", unit="arcsec/sqrt(h)", minimum=0.0
    )

    @cached_property
    def shared_error(self) -> str:
        """Error shared with other sensors: SHARED_BY_SKY, SHARED_BY_MESSAGES or "none"."""
        if self.shared != BY_INPUT:
            return self.shared
        return "none" if self.input == "horizon_attitude" else SHARED_BY_SKY

    @property
    def needs_sky(self) -> bool:
        """True if the messages of the sensor are used with the sky model."""
        return self.shared_error == SHARED_BY_SKY

    def device(self, id_: str, ins: InsConfig) -> Device:
        """Return the sensor as a device."""
        source, time_states = f"star.{id_}", [("ins.time_offset", -1.0)]
        walk = [
            self.installation_walk_forward_arcsec_per_sqrt_h,
            self.installation_walk_up_arcsec_per_sqrt_h,
            self.installation_walk_right_arcsec_per_sqrt_h,
        ]
        walk_per_sqrt_s = np.array(walk) * ARCSEC / _SQRT_HOUR
        blocks = [
            block(f"{source}.installation", self.installation_sigma_s, SOURCE_INSTALLATION, walk=walk_per_sqrt_s),
            # The covariance of this error is taken from the messages (ShipFilter) and therefore starts at zero.
            block(f"{source}.common", [0.0] * 3, SOURCE_STAR_COMMON, time_s=self.common_time_s),
        ]
        if self.time_offset_sigma_s > 0.0:
            blocks.append(block(f"{source}.time_offset", [self.time_offset_sigma_s], SOURCE_STAR_TIME))
            time_states.append((f"{source}.time_offset", 1.0))
        if self.flexure_sigma_arcsec > 0.0:
            sigma_flexure = [self.flexure_sigma_arcsec * ARCSEC] * 3
            blocks.append(block(f"{source}.flexure", sigma_flexure, SOURCE_FLEXURE, time_s=self.flexure_time_s))
        kind: type[Device] = TrackerDevice
        noise_sources: tuple[str, ...] = (SOURCE_STAR_NOISE,)
        if self.input == "observations":
            kind = StarCameraDevice
            blocks += camera_blocks(source, self.camera)
            if self.camera.pixel_spatial_sigma_px > 0.0:
                noise_sources += (SOURCE_PIXEL,)
        return kind(
            name=source,
            parameters=f"star_sensors.{id_}",
            heading_parameter=f"star_sensors.{id_}.azimuth_deg",
            rotation_dv0=self.rotation_ds,
            ins_time_s=self.time_offset_s - ins.time_offset_s,
            ins_time_states=tuple(time_states),
            noise_sources=noise_sources,
            blocks=tuple(blocks),
            time_offset_s=self.time_offset_s,
        )


@dataclass(frozen=True, kw_only=True)
class ReferenceConfig(ReferenceErrors):
    """Parameters of another attitude system: mounting, noise and clock offset relative to the INS."""

    convention: str = parameter(
        "enu_flu", doc="axes of the messages: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that its messages must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    installation_walk_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the three angles", unit="arcsec/sqrt(h)", minimum=0.0
    )
    slow_sigma_roll_arcsec: float = arcsec(0.0, doc="correlated error in roll")
    slow_sigma_pitch_arcsec: float = arcsec(0.0, doc="correlated error in pitch")
    slow_sigma_heading_arcsec: float = arcsec(0.0, doc="correlated error in heading; 0 for all three: not modelled")
    slow_time_s: float = parameter(
        300.0, doc="correlation time of the correlated error", unit="s", minimum=0.1, maximum=1e7
    )

    def device(self, name: str) -> Device:
        """Return the system as a device."""
        source = f"reference.{name}"
        walk = self.installation_walk_arcsec_per_sqrt_h * ARCSEC / _SQRT_HOUR
        blocks = [
            block(f"{source}.installation", self.installation_sigma_r, SOURCE_REFERENCE, walk=walk),
            block(f"{source}.time_offset", [self.time_offset_sigma_s], SOURCE_REFERENCE_TIME),
        ]
        slow = [self.slow_sigma_roll_arcsec, self.slow_sigma_heading_arcsec, self.slow_sigma_pitch_arcsec]
        if any(slow):
            slow_sigma = np.array(slow) * ARCSEC
            blocks.append(block(f"{source}.slow", slow_sigma, SOURCE_REFERENCE_SLOW, time_s=self.slow_time_s))
        return ReferenceDevice(
            name=source,
            parameters=f"references.{name}",
            heading_parameter=f"references.{name}.heading_deg",
            rotation_dv0=self.rotation_dr,
            ins_time_s=-self.time_offset_s,
            ins_time_states=((f"{source}.time_offset", -1.0),),
            noise_sources=(SOURCE_REFERENCE_NOISE,),
            blocks=tuple(blocks),
            time_offset_s=self.time_offset_s,
        )


@dataclass(frozen=True, kw_only=True)
class ShipBaselineConfig(BaselineSurvey):
    """Parameters of the baseline between two antennas aboard; the three components are 0 without a baseline."""

    frame_id: str = parameter("", doc="frame_id that ship/baseline must carry; empty accepts any")
    base_id: str = parameter("", doc="base_id required in the messages; empty accepts any")
    rover_id: str = parameter("", doc="rover_id required in the messages; empty accepts any")
    least_fix: str = parameter(
        "fixed", doc="lowest fix type that is used; with float the messages must contain sigmas", choices=FIX_TYPES
    )
    noise_sigma_m: float = parameter(
        0.01, doc="noise of each solution, each axis, if the message contains none", unit="m",
        minimum=1e-4, maximum=100.0, live=True,
    )  # fmt: skip
    bias_sigma_m: float = parameter(
        0.005, doc="correlated error, each axis, for example by multipath", unit="m", minimum=0.0, maximum=1000.0
    )
    bias_time_s: float = parameter(300.0, doc="correlation time of bias_sigma_m", unit="s", minimum=0.1, maximum=1e7)

    @property
    def rotation_dv(self) -> FloatArray:
        """Rotation deck from baseline, with forward along the baseline and no roll, shape (3, 3)."""
        azimuth = math.atan2(self.right_m, self.forward_m)
        elevation = math.atan2(self.up_m, math.hypot(self.right_m, self.forward_m))
        return rotation_from_angles(azimuth, elevation, 0.0)

    def __post_init__(self) -> None:
        """Check the length of the baseline.

        Raises:
            ParameterError: the baseline is shorter than 0.3 m.
        """
        if self.is_aboard and not self.length_m >= _MIN_BASELINE_M:
            name = "ship_baseline.forward_m"
            text = f"the baseline is {self.length_m:.3g} m long: expected at least {_MIN_BASELINE_M:g} m"
            raise ParameterError(f"parameter '{name}': {text}", name, value=self.forward_m)

    def device(self, ins: InsConfig) -> Device:
        """Return the baseline as a device, with stamps in satellite time."""
        # A rotation about the baseline itself is not observable.
        across = self.sigma_m / self.length_m
        blocks = [block(f"{BASELINE}.installation", [0.0, across, across], SOURCE_BASELINE)]
        if self.bias_sigma_m > 0.0:
            sigma = [self.bias_sigma_m / self.length_m] * 3
            blocks.append(block(f"{BASELINE}.common", sigma, SOURCE_BASELINE_COMMON, time_s=self.bias_time_s))
        return BaselineDevice(
            name=BASELINE,
            parameters="ship_baseline",
            heading_parameter="ship_baseline.forward_m and right_m",
            rotation_dv0=self.rotation_dv,
            ins_time_s=-ins.time_offset_s,
            ins_time_states=(("ins.time_offset", -1.0),),
            noise_sources=(SOURCE_BASELINE_NOISE,),
            blocks=tuple(blocks),
            length_m=self.length_m,
            length_sigma_m=math.hypot(self.sigma_m, self.bias_sigma_m),
        )


@dataclass(frozen=True, kw_only=True)
class ShipSensors(StarSensorsById):
    """Parameters of the INS and of all sensors that are compared with the INS."""

    ins: InsConfig = section(InsConfig)
    star_sensors: dict[str, StarSensorConfig] = mapping_of("star sensors by id")
    references: dict[str, ReferenceConfig] = mapping_of("other attitude systems by name")
    ship_baseline: ShipBaselineConfig = section(ShipBaselineConfig)

    @cached_property
    def devices(self) -> dict[str, Device]:
        """Devices of all sensors by source name, the star sensors first."""
        found = [star.device(id_, self.ins) for id_, star in self.star_sensors.items()]
        found += [reference.device(name) for name, reference in self.references.items()]
        if self.ship_baseline.is_aboard:
            found.append(self.ship_baseline.device(self.ins))
        return {device.name: device for device in found}


@dataclass(frozen=True, kw_only=True)
class ShipIntegrityConfig(IntegrityConfig):
    """Parameters of protection levels and fault exclusion of a ship."""

    pairs: bool = parameter(
        False,
        doc="detect two faulty sources at a time: one subfilter more for each pair of sources, the INS included, if"
        " three other sources are in use",
    )


@dataclass(frozen=True, kw_only=True)
class ShipAttitudeConfig(ShipSensors):
    """All parameters of ``ship_attitude``."""

    gravity: GravityConfig = section(GravityConfig)
    horizon: str = parameter(
        GEODETIC,
        doc="horizon of the published attitude: that of the ellipsoid, or of gravity (needs gravity.deflection)",
        choices=(GEODETIC, GRAVITY),
    )
    gate: GateConfig = section(GateConfig)
    integrity: ShipIntegrityConfig = section(ShipIntegrityConfig)
    recovery: RecoveryConfig = section(RecoveryConfig)
    sky: SkyConfig = section(SkyConfig)
    lag_s: float = parameter(
        2.0, doc="measurements up to this lag are applied at their own stamp", unit="s", minimum=0.0, maximum=600.0
    )
    smoothing_lag_s: float = parameter(
        0.0,
        doc="ship/attitude_smoothed is published this long after the stamp of each attitude, smoothed with all"
        " measurements until then, not before lag_s and ins.max_gap_s; 0: not published",
        unit="s",
        minimum=0.0,
        maximum=600.0,
    )
    coasting_after_s: float = parameter(
        2.0, doc="without stars for this long the status is COASTING", unit="s", minimum=0.1, maximum=3600.0, live=True
    )
    frames: FrameNames = section(FrameNames)
    publish_tf: bool = publish_tf()
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of budget, alignment, error and health topics", unit="s", minimum=0.1, maximum=60.0
    )
    alignment_file: str = parameter("", doc="file of the saved alignment, read at the start if it exists")
    alignment_autosave_s: float = autosave_period()
    alignment_max_age_d: float = saved_age("alignment")

    @property
    def models_deflection(self) -> bool:
        """True if the deflection of the vertical is a state.

        This is due to gravity.deflection, or to ins.model schuler with gravity.unknown_sigma_arcsec above 0.
        """
        drives_ins = self.ins.model == SCHULER and self.gravity.unknown_sigma_arcsec > 0.0
        return self.gravity.is_modelled or drives_ins

    @property
    def needs_vertical(self) -> bool:
        """True if the INS error model depends on the ship's position."""
        return self.models_deflection or self.ins.model == SCHULER

    def __post_init__(self) -> None:
        """Check parameters that depend on each other.

        Raises:
            ParameterError: two parameters contradict each other.
        """
        super().__post_init__()
        if self.horizon == GRAVITY and not self.gravity.is_modelled:
            text = "parameter 'horizon' = gravity: set gravity.deflection, otherwise both horizons are the same"
            raise ParameterError(text, "horizon")
        for id_, star in self.star_sensors.items():
            if star.shared != BY_INPUT and star.input not in _SOLVED_INPUTS:
                name = f"star_sensors.{id_}.shared"
                text = f"'{star.shared}' needs input: solution or horizon_attitude; '{star.input}' shares sky errors"
                raise ParameterError(f"parameter '{name}': {text}", name)

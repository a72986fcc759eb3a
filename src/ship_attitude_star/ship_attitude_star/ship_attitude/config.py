"""Parameters of the ``ship_attitude`` node, with unit, range and meaning; parameter names are dotted."""

import math
from dataclasses import dataclass
from functools import cached_property

from ship_attitude_star.vertical.config import GravityConfig
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_estimation.parameters.fields import (
    accept_unset_covariance,
    arcsec,
    autosave_period,
    mapping_of,
    parameter,
    section,
    sources_off,
    stamp_age,
)
from ship_estimation.parameters.frame_names import FrameNames, publish_tf
from ship_estimation.parameters.ins import StarInsConfig
from ship_estimation.parameters.ins_errors import SCHULER, InsCorrelationTimes, InsErrorModel
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.parameters.ship_devices import BaselineSurvey, ReferenceErrors, StarSensorErrors
from ship_estimation.recovery.config import RecoveryConfig
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_stars.camera.config import CameraConfig, MountingConfig, StarSensorsById
from ship_stars.samples.attitude_samples import SHARED_BY_MESSAGES, SHARED_BY_SKY
from ship_stars.sky.config import InertialConfig, SkyConfig

GEODETIC, GRAVITY = "geodetic", "gravity"

FIX_TYPES = ("float", "fixed")
"""RTK solution types from which a direction is computed."""

BY_INPUT = "by_input"
"""Value of ``shared`` with which the parameter ``input`` determines the shared error."""

_MIN_BASELINE_M = 0.3
"""Minimum baseline length, m; at this length an error of 1 cm is 2°."""

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
    slow_sigma_heading_arcsec: float = arcsec(
        0.0, doc="correlated error in heading; 0 for all three: not modelled"
    )
    slow_time_s: float = parameter(
        300.0, doc="correlation time of the correlated error", unit="s", minimum=0.1, maximum=1e7
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


@dataclass(frozen=True, kw_only=True)
class ShipIntegrityConfig(IntegrityConfig):
    """Parameters of protection levels and fault exclusion of a ship."""

    pairs: bool = parameter(
        False,
        doc="detect two faulty sources at a time: one subfilter more for each pair of sources, the INS included, if"
        " three other sources are in use",
    )


@dataclass(frozen=True, kw_only=True)
class ShipAttitudeConfig(StarSensorsById):
    """All parameters of ``ship_attitude``."""

    ins: InsConfig = section(InsConfig)
    gravity: GravityConfig = section(GravityConfig)
    horizon: str = parameter(
        GEODETIC,
        doc="horizon of the published attitude: that of the ellipsoid, or of gravity (needs gravity.deflection)",
        choices=(GEODETIC, GRAVITY),
    )
    star_sensors: dict[str, StarSensorConfig] = mapping_of("star sensors by id")
    references: dict[str, ReferenceConfig] = mapping_of("other attitude systems by name")
    ship_baseline: ShipBaselineConfig = section(ShipBaselineConfig)
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
    alignment_max_age_d: float = parameter(
        30.0, doc="age above which the configured uncertainty is added to a saved alignment",
        unit="d", minimum=0.0, maximum=36500.0,
    )

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

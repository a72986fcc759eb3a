"""Parameters of the ``optical_axis`` node, each with unit, range and meaning; names are dotted."""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
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
from ship_estimation.parameters.ship_devices import InsCorrelationTimes, StarInsConfig
from ship_estimation.parameters.theodolite_devices import (
    AirConfig,
    AxesConfig,
    BaselineErrors,
    DeformationConfig,
    DroneAttitudeErrors,
    LeverConfig,
    MainAxisInCamera,
    MainDetectorOptics,
    ShipAntennaConfig,
    TelescopeOptics,
)
from ship_estimation.recovery.recovery import RecoveryConfig
from ship_stars.camera.config import RequiredCameraConfig
from ship_stars.sky.config import SkyConfig

_SHORTEST_FOCAL_LENGTH_M = 0.001

_SAME_TOLERANCE = 1e-9
"""Relative difference up to which two parameters count as equal, because the conversion of their units rounds."""


@dataclass(frozen=True, kw_only=True)
class ShipConfig:
    """Source of the ship's attitude, and its error model."""

    source: str = parameter(
        "ship/attitude",
        doc="topic of the ship's attitude: the fused one, or the INS alone with the errors stated under ins",
        choices=("ship/attitude", "ins/imu"),
    )
    frame_id: str = parameter("", doc="frame_id that ship/attitude must carry; empty accepts any")
    slow_time_s: float = parameter(
        1800.0, doc="correlation time of the error of ship/attitude", unit="s", minimum=1.0, maximum=1e7
    )
    white_sigma_arcsec: float = arcsec(
        1.0, doc="white error of ship/attitude from sample to sample, each axis", live=True
    )
    max_gap_s: float = parameter(
        0.5, doc="samples of ship/attitude further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class InsSourceConfig(InsCorrelationTimes, StarInsConfig):
    """INS as the only source of the ship's attitude."""


@dataclass(frozen=True, kw_only=True)
class EncoderConfig:
    """Encoders of the two axes."""

    frame_id: str = parameter("", doc="frame_id that theodolite/encoder must carry; empty accepts any")
    sigma_arcsec: float = arcsec(1.0, doc="noise of each reading if the message states none", live=True)
    max_acceleration_deg_per_s2: float = parameter(
        100.0,
        doc="maximum acceleration of an axis: a reading that needs more is rejected (fast tracking mounts reach 60)",
        unit="deg/s^2",
        minimum=0.1,
        maximum=1e6,
        live=True,
    )
    max_gap_s: float = parameter(
        0.2, doc="readings further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class TelescopeConfig(TelescopeOptics):
    """Calibration telescope, its detector, and its parallelism to the main axis."""

    telescope_id: str = parameter(doc="telescope_id of its images")
    frame_id: str = parameter("", doc="frame_id that theodolite/beacons must carry; empty accepts any")


@dataclass(frozen=True, kw_only=True)
class StarCameraConfig(MainAxisInCamera):
    """Star camera fixed to the theodolite.

    If the calibration telescope is a star camera, its id is ``telescope.telescope_id``.
    """

    frame_id: str = parameter("", doc="frame_id that theodolite/<id>/stars must carry; empty accepts any")
    camera: RequiredCameraConfig = section(RequiredCameraConfig)


@dataclass(frozen=True, kw_only=True)
class MainDetectorConfig(MainDetectorOptics):
    """Detector in the main tube, for images of targets; a focal length of 0 means no detector."""

    frame_id: str = parameter("", doc="frame_id that theodolite/target must carry; empty accepts any")

    def __post_init__(self) -> None:
        if 0.0 < self.focal_length_m < _SHORTEST_FOCAL_LENGTH_M:
            text = f"expected metres, {_SHORTEST_FOCAL_LENGTH_M:g} at least, or 0 without a main detector"
            raise _refusal("main_detector.focal_length_m", self.focal_length_m, text)


@dataclass(frozen=True, kw_only=True)
class RtkConfig(BaselineErrors):
    """Baseline from the ship's antenna to the drone's antenna."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/baseline must carry; empty accepts any")
    base_id: str = parameter("", doc="base_id required in the messages; empty accepts any")
    rover_id: str = parameter("", doc="rover_id required in the messages; empty accepts any")
    max_gap_s: float = parameter(
        0.5, doc="solutions further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class DroneImuConfig(DroneAttitudeErrors):
    """Attitude of the drone, used only if the light has a lever from the drone's antenna."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/imu must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    convention: str = parameter(
        "enu_flu", doc="axes of the messages: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class BeaconConfig:
    """One drone with its light."""

    light: LeverConfig = section(LeverConfig)
    rtk: RtkConfig = section(RtkConfig)
    imu: DroneImuConfig = section(DroneImuConfig)


@dataclass(frozen=True, kw_only=True)
class EscortConfig:
    """Advice for the drones, with the limits of their positions relative to the theodolite."""

    enabled: bool = parameter(False, doc="publish advised positions of the drones on theodolite/escort")
    period_s: float = parameter(10.0, doc="period of the advice, in slow topics", unit="s", minimum=1.0, maximum=3600.0)
    range_min_m: float = parameter(
        500.0, doc="least distance of a drone from the theodolite", unit="m", minimum=1.0, maximum=50_000.0
    )
    range_max_m: float = parameter(
        3000.0, doc="greatest distance of a drone from the theodolite", unit="m", minimum=1.0, maximum=50_000.0
    )
    separation_min_m: float = parameter(
        20.0, doc="least distance between any two drones", unit="m", minimum=0.0, maximum=50_000.0
    )
    elevation_min_deg: float = parameter(
        0.5, doc="least elevation of a drone at the theodolite", unit="deg", minimum=-10.0, maximum=90.0
    )
    elevation_max_deg: float = parameter(
        85.0, doc="greatest elevation of a drone at the theodolite", unit="deg", minimum=-10.0, maximum=90.0
    )
    field_deg: float = parameter(
        3.5, doc="greatest angle of a light from the axis of the telescope", unit="deg", minimum=0.001, maximum=60.0
    )
    exposures: int = parameter(
        1, doc="number of exposures at a position over which white errors are averaged", minimum=1, maximum=1_000_000
    )

    def __post_init__(self) -> None:
        """Refuse limits that leave no position.

        Raises:
            ParameterError: names the limit that cannot be met together with another.
        """
        for name, unit in (("range", "m"), ("elevation", "deg")):
            least, greatest = getattr(self, f"{name}_min_{unit}"), getattr(self, f"{name}_max_{unit}")
            if not least <= greatest:
                text = f"expected at most escort.{name}_max_{unit} = {greatest:g} {unit}"
                raise _refusal(f"escort.{name}_min_{unit}", least, text, unit)
        near, far, field = self.range_min_m, self.range_max_m, np.deg2rad(self.field_deg)
        # The largest distance is across the whole field, between two far positions, or a near and a far position.
        same_range_m, different_range_m = 2.0 * far * np.sin(field), abs(far - near * np.exp(2j * field))
        widest_m = float(max(same_range_m, different_range_m))
        if not self.separation_min_m <= widest_m:
            text = (
                "no two positions in the field and range of escort.field_deg, escort.range_min_m and "
                f"escort.range_max_m are more than {widest_m:.1f} m apart"
            )
            raise _refusal("escort.separation_min_m", self.separation_min_m, text, "m")


@dataclass(frozen=True, kw_only=True)
class OpticalAxisConfig:
    """All parameters of ``optical_axis``."""

    serial: str = parameter("", doc="serial number of the theodolite; a saved calibration of another one is not used")
    ship: ShipConfig = section(ShipConfig)
    ins: InsSourceConfig = section(InsSourceConfig)
    encoder: EncoderConfig = section(EncoderConfig)
    axes: AxesConfig = section(AxesConfig)
    deformation: DeformationConfig = section(DeformationConfig)
    lever: LeverConfig = section(LeverConfig)
    telescope: TelescopeConfig = section(TelescopeConfig)
    main_detector: MainDetectorConfig = section(MainDetectorConfig)
    air: AirConfig = section(AirConfig)
    ship_antenna: ShipAntennaConfig = section(ShipAntennaConfig)
    beacons: dict[str, BeaconConfig] = mapping_of("drones with a light, by beacon_id")
    telescopes: dict[str, StarCameraConfig] = mapping_of("star cameras on the theodolite, by sensor_id")
    sky: SkyConfig = section(SkyConfig)
    escort: EscortConfig = section(EscortConfig)
    gate: GateConfig = section(GateConfig)
    integrity: IntegrityConfig = section(IntegrityConfig)
    recovery: RecoveryConfig = section(RecoveryConfig)
    least_fix: str = parameter(
        "fixed", doc="minimum fix of a baseline; others are rejected", choices=("fixed", "float"), live=True
    )
    lag_s: float = parameter(
        2.0, doc="measurements up to this lag are applied at their own stamp", unit="s", minimum=0.0, maximum=600.0
    )
    lights_recent_s: float = parameter(
        3.0,
        doc="maximum age of lights and stars that determine the mode",
        unit="s",
        minimum=0.1,
        maximum=3600.0,
        live=True,
    )
    frames: FrameNames = section(FrameNames)
    publish_tf: bool = publish_tf()
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of budget, calibration, error and health topics", unit="s", minimum=0.1, maximum=60.0
    )
    calibration_file: str = parameter("", doc="file of the saved calibration, read at the start if it exists")
    alignment_autosave_s: float = autosave_period()
    calibration_max_age_d: float = saved_age("calibration")

    def __post_init__(self) -> None:
        # One hypothesis per filter: the main filter, and subfilters without one drone, the encoders or the ship's
        # attitude.
        hypotheses, most = 3 + len(self.beacons), self.integrity.max_hypotheses
        if hypotheses > most:
            text = f"{len(self.beacons)} beacons, the encoders and the ship's attitude make {hypotheses} hypotheses"
            raise _refusal("integrity.max_hypotheses", most, text)
        if self.telescope.telescope_id in self.telescopes:
            self._refuse_another_telescope(self.telescope.telescope_id)
        if self.escort.enabled and not self.beacons:
            raise ParameterError(
                "parameter 'escort.enabled' = true: expected a drone under beacons", "escort.enabled", value=True
            )

    def star_camera(self, id_: str) -> RequiredCameraConfig:
        """Return the camera ``telescopes.<id>``.

        The calibration telescope gets ``telescope.focal_length_sigma_m`` unless this is 0.
        """
        camera, sigma_m = self.telescopes[id_].camera, self.telescope.focal_length_sigma_m
        if id_ != self.telescope.telescope_id or not sigma_m:
            return camera
        return replace(camera, focal_length_sigma_m=sigma_m)

    def _refuse_another_telescope(self, id_: str) -> None:
        """Refuse a calibration telescope whose focal length or parallelism differs between beacons and stars."""
        telescope, camera = self.telescope, self.telescopes[id_]
        lens, length_m, sigma_m = camera.camera, telescope.focal_length_m, telescope.focal_length_sigma_m
        duplicates = [("camera.focal_length_m", lens.focal_length_m, "focal_length_m", length_m)]
        if lens.focal_length_sigma_m:
            own_sigma_m = lens.focal_length_sigma_m
            duplicates.append(("camera.focal_length_sigma_m", own_sigma_m, "focal_length_sigma_m", sigma_m))
        for name, of_telescope in (("azimuth", "azimuth"), ("elevation", "elevation"), ("roll", "rotation")):
            telescope_arcsec = getattr(telescope, f"{of_telescope}_arcsec")
            telescope_sigma_arcsec = getattr(telescope, f"{of_telescope}_sigma_arcsec")
            own_sigma = getattr(camera, f"{name}_sigma_arcsec")
            duplicates += [
                (f"{name}_deg", getattr(camera, f"{name}_deg"), f"{of_telescope}_arcsec", telescope_arcsec / 3600.0),
                (f"{name}_sigma_arcsec", own_sigma, f"{of_telescope}_sigma_arcsec", telescope_sigma_arcsec),
            ]
        for name, value, other, expected in duplicates:
            if not abs(value - expected) <= _SAME_TOLERANCE * max(abs(expected), 1.0):
                text = f"'{id_}' is the calibration telescope: expected telescope.{other} = {expected:g}"
                raise _refusal(f"telescopes.{id_}.{name}", value, text)


def _refusal(name: str, value: float, expected: str, unit: str = "") -> ParameterError:
    """Return the error of a parameter that contradicts a limit or other parameters."""
    return ParameterError(f"parameter '{name}' = {value:g}{unit and ' ' + unit}: {expected}", name, value=value)

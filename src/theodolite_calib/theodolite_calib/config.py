"""Parameters of the ``optical_axis`` node, each with unit, range and meaning; names are dotted."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_estimation.parameters.fields import (
    accept_unset_covariance,
    arcsec,
    autosave_period,
    degrees,
    mapping_of,
    parameter,
    section,
    sources_off,
    stamp_age,
)
from ship_estimation.parameters.frame_names import FrameNames, publish_tf
from ship_estimation.parameters.ins import InsErrorConfig, StarInsConfig
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.recovery.config import RecoveryConfig
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.camera.config import RequiredCameraConfig
from ship_stars.sky.config import SkyConfig
from theodolite_calib.axis_geometry.axes import NAMES

_MAX_LEVER_M = 200.0
"""Largest lever of any ship, m; a larger number is in millimetres, or wrong."""

_SHORTEST_FOCAL_LENGTH_M = 0.001

_SAME_TOLERANCE = 1e-9
"""Relative difference up to which two parameters count as equal, because the conversion of their units rounds."""


def _axis_error(doc: str) -> Any:
    """Return the field of the prior value of an axis error, within ±1°; larger zero points need ``fit_axes``."""
    return parameter(0.0, doc=doc, unit="arcsec", minimum=-3600.0, maximum=3600.0)


def _axis_sigma(default: float = 30.0) -> Any:
    return parameter(default, doc="uncertainty of this error; 0 fixes it", unit="arcsec", minimum=0.0, maximum=3600.0)


def _telescope_angle(doc: str) -> Any:
    return parameter(0.0, doc=doc, unit="arcsec", minimum=-36_000.0, maximum=36_000.0)


def _sigma_deg(default: float, doc: str) -> Any:
    return parameter(default, doc=doc, unit="deg", minimum=0.0, maximum=90.0)


@dataclass(frozen=True, kw_only=True)
class LeverConfig:
    """Surveyed vector in the axes (forward, up, right) of the ship, drone or theodolite."""

    forward_m: float = parameter(
        0.0, doc="component along forward (bow)", unit="m", minimum=-_MAX_LEVER_M, maximum=_MAX_LEVER_M
    )
    up_m: float = parameter(0.0, doc="component along up", unit="m", minimum=-_MAX_LEVER_M, maximum=_MAX_LEVER_M)
    right_m: float = parameter(
        0.0, doc="component along right (starboard)", unit="m", minimum=-_MAX_LEVER_M, maximum=_MAX_LEVER_M
    )
    sigma_m: float = parameter(
        0.0, doc="standard deviation of the survey, each axis", unit="m", minimum=0.0, maximum=10.0
    )

    @property
    def vector_m(self) -> FloatArray:
        """Vector in metres, shape (3,)."""
        return np.array([self.forward_m, self.up_m, self.right_m])


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
class InsSourceConfig(StarInsConfig, InsErrorConfig):
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
class AxesConfig:
    """Prior of the axis errors."""

    g_arcsec: float = _axis_error("zero point of the azimuth encoder; the axis points at A - g")
    g_sigma_arcsec: float = _axis_sigma()
    h_arcsec: float = _axis_error("zero point of the elevation encoder; the axis points at E - h")
    h_sigma_arcsec: float = _axis_sigma()
    c_arcsec: float = _axis_error("collimation of the optical axis, to the left")
    c_sigma_arcsec: float = _axis_sigma()
    I_arcsec: float = _axis_error("non-perpendicularity: tilt of the horizontal axis, right end up")
    I_sigma_arcsec: float = _axis_sigma()
    beta_x_arcsec: float = _axis_error("tilt of the vertical axis towards the bow")
    beta_x_sigma_arcsec: float = _axis_sigma()
    beta_y_arcsec: float = _axis_error("tilt of the vertical axis towards starboard")
    beta_y_sigma_arcsec: float = _axis_sigma()
    flexure_arcsec: float = _axis_error("bending of the tube; it raises the axis by this times cos E")
    flexure_sigma_arcsec: float = _axis_sigma(0.0)

    @property
    def values(self) -> FloatArray:
        """Prior values, in the order of :data:`theodolite_calib.axis_geometry.axes.NAMES`, rad, shape (7,)."""
        return ARCSEC * np.array([getattr(self, f"{name}_arcsec") for name in NAMES])

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of the prior values, rad, shape (7,)."""
        return ARCSEC * np.array([getattr(self, f"{name}_sigma_arcsec") for name in NAMES])


@dataclass(frozen=True, kw_only=True)
class DeformationConfig:
    """Deformation of the hull between INS and theodolite, about bow, up and starboard."""

    sigma_arcsec: float = arcsec(20.0, doc="standard deviation, each axis")
    time_s: float = parameter(600.0, doc="correlation time", unit="s", minimum=1.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class TelescopeConfig:
    """Calibration telescope, its detector, and its parallelism to the main axis."""

    telescope_id: str = parameter(doc="telescope_id of its images")
    frame_id: str = parameter("", doc="frame_id that theodolite/beacons must carry; empty accepts any")
    focal_length_m: float = parameter(doc="focal length, in metres", unit="m", minimum=0.001, maximum=10.0)
    focal_length_sigma_m: float = parameter(
        0.0001, doc="uncertainty of the focal length; 0 fixes it", unit="m", minimum=0.0, maximum=0.1
    )
    principal_x_m: float = parameter(
        0.0, doc="detector point of the telescope's axis, along right", unit="m", minimum=-0.1, maximum=0.1
    )
    principal_z_m: float = parameter(
        0.0, doc="detector point of the telescope's axis, along up", unit="m", minimum=-0.1, maximum=0.1
    )
    sigma_m: float = parameter(
        1e-6,
        doc="error of x and of z of a light's image if the message states none",
        unit="m",
        minimum=1e-9,
        maximum=0.001,
        live=True,
    )
    psf_sigma_m: float = parameter(
        5.2e-6,
        doc="spread of the image of a light at rest, each axis; the error along a longer streak is larger",
        unit="m",
        minimum=1e-7,
        maximum=0.001,
    )
    azimuth_arcsec: float = _telescope_angle("azimuth of the main axis in the telescope")
    azimuth_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the azimuth")
    elevation_arcsec: float = _telescope_angle("elevation of the main axis in the telescope")
    elevation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the elevation")
    rotation_arcsec: float = _telescope_angle("rotation of the main image in the telescope")
    rotation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the rotation")
    lens: LeverConfig = section(LeverConfig)

    @property
    def principal_point_m(self) -> FloatArray:
        """Detector point of the telescope's axis, shape (2,)."""
        return np.array([self.principal_x_m, self.principal_z_m])

    @property
    def parallelism(self) -> FloatArray:
        """Azimuth, elevation and rotation of the main axis in the telescope, rad, shape (3,)."""
        return ARCSEC * np.array([self.azimuth_arcsec, self.elevation_arcsec, self.rotation_arcsec])

    @property
    def parallelism_sigma(self) -> FloatArray:
        """Standard deviations of the parallelism, rad, shape (3,)."""
        return ARCSEC * np.array(
            [self.azimuth_sigma_arcsec, self.elevation_sigma_arcsec, self.rotation_sigma_arcsec]
        )


@dataclass(frozen=True, kw_only=True)
class StarCameraConfig:
    """Star camera fixed to the theodolite, and the orientation of the main axis in the camera.

    The main frame is the camera's frame rotated by R(azimuth, elevation, roll), with the signs of
    ``telescope.azimuth_arcsec``, ``elevation_arcsec`` and ``rotation_arcsec``. If the calibration telescope is a star
    camera, its id is ``telescope.telescope_id``.
    """

    frame_id: str = parameter("", doc="frame_id that theodolite/<id>/stars must carry; empty accepts any")
    azimuth_deg: float = degrees(doc="azimuth of the main axis in the camera")
    azimuth_sigma_arcsec: float = arcsec(1.0, doc="uncertainty of the azimuth")
    elevation_deg: float = parameter(
        doc="elevation of the main axis in the camera", unit="deg", minimum=-89.0, maximum=89.0
    )
    elevation_sigma_arcsec: float = arcsec(1.0, doc="uncertainty of the elevation")
    roll_deg: float = degrees(doc="rotation of the main image in the camera")
    roll_sigma_arcsec: float = arcsec(20.0, doc="uncertainty of the rotation")
    camera: RequiredCameraConfig = section(RequiredCameraConfig)

    @property
    def parallelism(self) -> FloatArray:
        """Azimuth, elevation and roll of the main axis in the camera, rad, shape (3,)."""
        return np.deg2rad([self.azimuth_deg, self.elevation_deg, self.roll_deg])

    @property
    def parallelism_sigma(self) -> FloatArray:
        """Standard deviations of the parallelism, rad, shape (3,)."""
        return ARCSEC * np.array([self.azimuth_sigma_arcsec, self.elevation_sigma_arcsec, self.roll_sigma_arcsec])


@dataclass(frozen=True, kw_only=True)
class MainDetectorConfig:
    """Detector in the main tube, for images of targets; a focal length of 0 means no detector."""

    frame_id: str = parameter("", doc="frame_id that theodolite/target must carry; empty accepts any")
    focal_length_m: float = parameter(
        0.0,
        doc="focal length of the main tube, in metres; 0: no main detector, its images are rejected",
        unit="m",
        minimum=0.0,
        maximum=100.0,
    )
    focal_length_sigma_m: float = parameter(
        0.0, doc="uncertainty of the focal length", unit="m", minimum=0.0, maximum=1.0
    )
    principal_x_m: float = parameter(
        0.0, doc="detector point of the main axis, along right", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_z_m: float = parameter(
        0.0, doc="detector point of the main axis, along up", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_sigma_m: float = parameter(
        0.0, doc="uncertainty of the detector point, each axis", unit="m", minimum=0.0, maximum=0.1
    )
    sigma_m: float = parameter(
        1e-6,
        doc="error of x and of z of a target's image if the message states none",
        unit="m",
        minimum=1e-9,
        maximum=0.001,
        live=True,
    )
    rotation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of detector_rotation as the message gives it")

    def __post_init__(self) -> None:
        if 0.0 < self.focal_length_m < _SHORTEST_FOCAL_LENGTH_M:
            raise ParameterError(
                f"parameter 'main_detector.focal_length_m' = {self.focal_length_m:g}: expected metres, "
                f"{_SHORTEST_FOCAL_LENGTH_M:g} at least, or 0 without a main detector",
                "main_detector.focal_length_m",
                value=self.focal_length_m,
            )

    @property
    def principal_point_m(self) -> FloatArray:
        """Detector point of the main axis, shape (2,)."""
        return np.array([self.principal_x_m, self.principal_z_m])


@dataclass(frozen=True, kw_only=True)
class AirConfig:
    """Coefficient k of terrestrial refraction on the paths to beacons and to a target with a range."""

    coefficient: float = parameter(0.13, doc="k near the sea", minimum=-5.0, maximum=5.0)
    sigma: float = parameter(0.06, doc="error of k, common to all lights", minimum=0.0, maximum=5.0)
    light_sigma: float = parameter(0.02, doc="further error of k on the path to each light", minimum=0.0, maximum=5.0)
    time_s: float = parameter(3600.0, doc="correlation time of both errors", unit="s", minimum=0.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class ShipAntennaConfig:
    """Antenna aboard from which all baselines start, so that its error is common to all baselines."""

    sigma_m: float = parameter(0.01, doc="correlated error, each axis", unit="m", minimum=0.0, maximum=10.0)
    time_s: float = parameter(300.0, doc="correlation time of the error", unit="s", minimum=0.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class RtkConfig:
    """Baseline from the ship's antenna to the drone's antenna."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/baseline must carry; empty accepts any")
    base_id: str = parameter("", doc="base_id required in the messages; empty accepts any")
    rover_id: str = parameter("", doc="rover_id required in the messages; empty accepts any")
    sigma_m: float = parameter(
        0.02,
        doc="noise of each solution, each axis, if the message states none",
        unit="m",
        minimum=1e-4,
        maximum=100.0,
        live=True,
    )
    bias_sigma_m: float = parameter(
        0.01, doc="correlated error, each axis, in addition to the stated one", unit="m", minimum=0.0, maximum=100.0
    )
    bias_time_s: float = parameter(300.0, doc="correlation time of bias_sigma_m", unit="s", minimum=0.0, maximum=1e7)
    max_gap_s: float = parameter(
        0.5, doc="solutions further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class DroneImuConfig:
    """Attitude of the drone, used only if the light has a lever from the drone's antenna."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/imu must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    convention: str = parameter(
        "enu_flu", doc="axes of the messages: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    tilt_sigma_deg: float = _sigma_deg(0.3, "correlated error in tilt, each axis")
    heading_sigma_deg: float = _sigma_deg(1.0, "correlated error in heading")
    time_s: float = parameter(300.0, doc="correlation time of both errors", unit="s", minimum=0.0, maximum=1e7)
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
                raise ParameterError(
                    f"parameter 'escort.{name}_min_{unit}' = {least:g} {unit}: expected at most "
                    f"escort.{name}_max_{unit} = {greatest:g} {unit}",
                    f"escort.{name}_min_{unit}",
                    value=least,
                )
        near, far, field = self.range_min_m, self.range_max_m, np.deg2rad(self.field_deg)
        # The largest distance is across the whole field, between two far positions, or a near and a far position.
        same_range_m, different_range_m = 2.0 * far * np.sin(field), abs(far - near * np.exp(2j * field))
        widest_m = float(max(same_range_m, different_range_m))
        if not self.separation_min_m <= widest_m:
            raise ParameterError(
                f"parameter 'escort.separation_min_m' = {self.separation_min_m:g} m: no two positions in the field and "
                f"range of escort.field_deg, escort.range_min_m and escort.range_max_m are more than {widest_m:.1f} m "
                "apart",
                "escort.separation_min_m",
                value=self.separation_min_m,
            )


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
    calibration_max_age_d: float = parameter(
        30.0,
        doc="age above which the configured uncertainty is added to a saved calibration",
        unit="d",
        minimum=0.0,
        maximum=36500.0,
    )

    def __post_init__(self) -> None:
        # One hypothesis per filter: the main filter, and subfilters without one drone, the encoders or the ship's
        # attitude.
        hypotheses, most = 3 + len(self.beacons), self.integrity.max_hypotheses
        if hypotheses > most:
            raise ParameterError(
                f"parameter 'integrity.max_hypotheses' = {most}: {len(self.beacons)} beacons, the encoders and the "
                f"ship's attitude make {hypotheses} hypotheses",
                "integrity.max_hypotheses",
                value=most,
            )
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
        duplicates = [
            ("camera.focal_length_m", camera.camera.focal_length_m, "focal_length_m", telescope.focal_length_m)
        ]
        own_m = camera.camera.focal_length_sigma_m
        if own_m:
            duplicates.append(
                ("camera.focal_length_sigma_m", own_m, "focal_length_sigma_m", telescope.focal_length_sigma_m)
            )
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
                raise ParameterError(
                    f"parameter 'telescopes.{id_}.{name}' = {value:g}: '{id_}' is the calibration telescope: expected "
                    f"telescope.{other} = {expected:g}",
                    f"telescopes.{id_}.{name}",
                    value=value,
                )

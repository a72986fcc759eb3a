"""Parameters of a scenario file: the voyage, the devices, their errors, and faults.

Each field has a unit, a range and a description. Errors are drawn with the sigmas of the scenario. The suite file in
the bag gives the same sigmas to the estimators (:mod:`ship_simulation.suite_file`).
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timezone

import numpy as np

from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterDescription, describe
from ship_estimation.parameters.ship_devices import (
    SCHULER,
    InsCorrelationTimes,
    InsErrorModel,
    InsErrors,
    InsRateErrors,
    ReferenceErrors,
    StarSensorErrors,
    StarSensorMounting,
)
from ship_estimation.parameters.theodolite_devices import MainAxisInCamera
from ship_geometry.air.refraction import MODELS
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.motion_scenario import (
    ANGLE,
    CORRELATION,
    DEFLECTION,
    DELAY,
    EXPOSURE,
    RATE,
    SIGMA,
    TIME,
    CarrierMotion,
    Outage,
)
from ship_simulation.scenario.theodolite_scenario import Beacon, ShipBaseline, Target, Theodolite
from ship_stars.camera.config import CameraConfig
from ship_stars.sky.deck_masks import MaskConfig, SensorMasks, sensor_masks

_START_PATTERN = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z")

_FIELD_POINTS = 21

STAR_OUTPUTS = ("horizon_attitude", "observations", "inertial_attitude")
"""Outputs of a star sensor, which are also the names of its topic under ``star/<id>/``."""

DEFLECTION_CHOICES = ("none", "unknown", "constant", "table", "topic")
"""Ways in which the suite receives the deflection: the choices of its parameter ``gravity.deflection``."""


@dataclass(frozen=True, kw_only=True)
class Ins(InsErrorModel, InsCorrelationTimes, InsRateErrors, InsErrors):
    """The inertial navigation system."""

    rate_hz: float = parameter(100.0, doc="samples per second", **RATE)
    latency_s: float = parameter(0.002, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    rate_bias_sigma_arcsec_per_s: float = parameter(
        0.0, doc="correlated error of the angular rate, each axis", unit="arcsec/s", minimum=0.0, maximum=3600.0
    )
    rate_bias_time_s: float = parameter(3600.0, doc="correlation time of that error", **CORRELATION)


@dataclass(frozen=True, kw_only=True)
class Detector(CameraConfig):
    """A camera that gives single stars, with the size of its detector."""

    width_px: int = parameter(0, doc="columns; 0: not given", unit="px", minimum=0, maximum=100_000)
    height_px: int = parameter(0, doc="rows; 0: not given", unit="px", minimum=0, maximum=100_000)

    @property
    def edges_px(self) -> FloatArray:
        """Least and greatest (u, v) on the detector, shape (2, 2); integers are the centres of pixels."""
        return np.array([[0.0, 0.0], [self.width_px, self.height_px]]) - 0.5

    def field_directions(self, prefix: str) -> FloatArray:
        """Return directions covering the detector in the sensor frame, shape (n, 3).

        Args:
            prefix: name of this section of the scenario, for the error message.
        """
        least, greatest = self.edges_px
        columns, rows = np.linspace(least, greatest, _FIELD_POINTS).T
        return self.camera(prefix).directions(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))

    def contains(self, pixels: FloatArray) -> np.ndarray:
        """True where pixels (u, v), shape (..., 2), are on the detector; False for NaN."""
        least, greatest = self.edges_px
        inside: np.ndarray = np.all((pixels >= least) & (pixels < greatest), axis=-1)
        return inside


@dataclass(frozen=True, kw_only=True)
class StarImaging:
    """Imaging of stars of the real sky, by a star sensor that gives single stars or by a camera on the theodolite.

    For a star sensor with another output, the rate, times and delays of the exposures apply to its messages.
    """

    rate_hz: float = parameter(5.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="first exposure after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    outages: dict[str, Outage] = mapping_of("times without stars, by name")
    sun_limit_deg: float = parameter(
        -6.0, doc="no stars while the Sun is higher than this", unit="deg", minimum=-90.0, maximum=90.0
    )
    camera: Detector = section(Detector)
    magnitude_limit: float = parameter(6.0, doc="faintest detected star, Hp", minimum=-2.0, maximum=14.0)
    most_stars: int = parameter(20, doc="maximum number of stars in an exposure", minimum=1, maximum=1000)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: stars are streaks, centroids the mean of the path; 0: points, length not stated",
        **EXPOSURE,
    )
    identified: bool = parameter(True, doc="true: the sensor identifies the stars")
    direction_given: bool = parameter(False, doc="identify stars by their directions, not by HIP numbers")
    false_stars: float = parameter(
        0.0, doc="mean number of false spots in an exposure", minimum=0.0, maximum=1000.0
    )
    swapped_probability: float = parameter(
        0.0, doc="share of the exposures in which the identities of two stars are swapped", minimum=0.0, maximum=1.0
    )

    @property
    def sight_masks(self) -> SensorMasks | None:
        """Obstructions in the field of view; None if there are none."""
        return None


@dataclass(frozen=True, kw_only=True)
class StarTelescope(MainAxisInCamera, StarImaging):
    """A star camera fixed to the theodolite: known orientation of the main axis in the camera, and imaging."""


@dataclass(frozen=True, kw_only=True)
class StarSensor(StarSensorErrors, StarSensorMounting, StarImaging):
    """A star sensor: mounting, output and errors.

    A horizon attitude is the true attitude with errors. Observations and inertial attitudes come from the real sky over
    the ship. :data:`ship_simulation.scenario.scenario_file.FIELDS_OF_OUTPUTS` lists the fields of each output.
    """

    output: str = parameter("horizon_attitude", doc="published output", choices=STAR_OUTPUTS)
    common_sigma_arcsec: float = parameter(0.0, doc="correlated error that all stars share, each axis", **SIGMA)
    star_count: int = parameter(8, doc="number of stars in each solution", minimum=1, maximum=1000)
    masks: dict[str, MaskConfig] = mapping_of("obstructions in its view, by name; they hide stars")

    @property
    def sight_masks(self) -> SensorMasks | None:
        """Obstructions in the sensor's field of view; None if there are none."""
        return sensor_masks(self, "star_sensors")


@dataclass(frozen=True, kw_only=True)
class Reference(ReferenceErrors):
    """Another attitude system."""

    rate_hz: float = parameter(1.0, doc="samples per second", **RATE)
    phase_s: float = parameter(0.0, doc="first sample after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)


@dataclass(frozen=True)
class FusedAttitude:
    """``ship/attitude`` as fused from INS and stars, for a voyage without the node ``ship_attitude``."""

    written: bool = parameter(False, doc="true: the bag contains the topic")
    rate_hz: float = parameter(20.0, doc="messages per second", **RATE)
    phase_s: float = parameter(0.0, doc="first message after the start", **TIME)
    latency_s: float = parameter(0.005, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    tilt_sigma_arcsec: float = parameter(1.45, doc="correlated error in tilt, each axis", **SIGMA)
    heading_sigma_arcsec: float = parameter(1.75, doc="correlated error in heading", **SIGMA)
    time_s: float = parameter(600.0, doc="correlation time of both", **CORRELATION)
    white_sigma_arcsec: float = parameter(1.0, doc="noise of each message, each axis", **SIGMA)


@dataclass(frozen=True)
class Position:
    """Position of the ship at the start, its velocity, and its satellite receiver."""

    latitude_deg: float = parameter(0.0, doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(0.0, doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(20.0, doc="height above the ellipsoid", unit="m", minimum=-500.0, maximum=9000.0)
    speed_m_per_s: float = parameter(0.0, doc="speed over ground", unit="m/s", minimum=0.0, maximum=50.0)
    course_deg: float = parameter(0.0, doc="course over ground, from North clockwise", **ANGLE)
    sigma_m: float = parameter(2.0, doc="noise of a fix, each axis", unit="m", minimum=0.0, maximum=1000.0)
    slow_sigma_m: float = parameter(0.0, doc="correlated error of fixes, each axis", unit="m", minimum=0.0, maximum=1e4)
    slow_time_s: float = parameter(600.0, doc="correlation time of that error", **CORRELATION)
    rate_hz: float = parameter(1.0, doc="fixes per second", **RATE)


@dataclass(frozen=True)
class Gravity:
    """Deflection of the vertical along the ship's track: a part known from maps, and a drawn part that is not known.

    Devices that level themselves, the INS and references, follow gravity.
    """

    xi_arcsec: float = parameter(0.0, doc="northward deflection at the start, known from maps", **DEFLECTION)
    eta_arcsec: float = parameter(0.0, doc="eastward deflection at the start, known from maps", **DEFLECTION)
    change_xi_arcsec: float = parameter(0.0, doc="change of the northward deflection along the track", **DEFLECTION)
    change_eta_arcsec: float = parameter(0.0, doc="change of the eastward deflection along the track", **DEFLECTION)
    change_start_m: float = parameter(0.0, doc="distance where the change begins", unit="m", minimum=0.0, maximum=1e7)
    change_length_m: float = parameter(
        50_000.0, doc="length of the change, half a period of a cosine", unit="m", minimum=100.0, maximum=1e7
    )
    sigma_arcsec: float = parameter(0.0, doc="deflection that maps do not contain, each component", **SIGMA)
    correlation_length_m: float = parameter(
        30_000.0, doc="correlation length of that deflection", unit="m", minimum=100.0, maximum=1e6
    )
    told: str = parameter(
        "none", doc="how the suite receives the deflection known from maps", choices=DEFLECTION_CHOICES
    )
    told_unknown_sigma_arcsec: float = parameter(
        7.7, doc="the suite's standard deviation of an unknown deflection, each component", **SIGMA
    )
    table_step_m: float = parameter(2000.0, doc="distance of the table's rows", unit="m", minimum=10.0, maximum=1e5)
    rate_hz: float = parameter(0.1, doc="messages per second if a topic publishes it", **RATE)

    @property
    def is_level(self) -> bool:
        """True if gravity is everywhere normal to the ellipsoid, and the suite receives no deflection."""
        known_arcsec = (self.xi_arcsec, self.eta_arcsec, self.change_xi_arcsec, self.change_eta_arcsec)
        return not any((*known_arcsec, self.sigma_arcsec)) and self.told == "none"


@dataclass(frozen=True)
class WeatherStation:
    """Values of the weather station, their errors, and the refraction model."""

    pressure_hpa: float = parameter(1013.25, doc="air pressure", unit="hPa", minimum=800.0, maximum=1100.0)
    temperature_c: float = parameter(15.0, doc="air temperature", unit="°C", minimum=-60.0, maximum=60.0)
    humidity_percent: float = parameter(70.0, doc="relative humidity", unit="%", minimum=0.0, maximum=100.0)
    pressure_sigma_hpa: float = parameter(
        0.5, doc="error of the measured pressure", unit="hPa", minimum=0.0, maximum=50.0
    )
    temperature_sigma_k: float = parameter(
        1.0, doc="error of the measured temperature", unit="K", minimum=0.0, maximum=50.0
    )
    refraction_model: str = parameter("erfa", doc="model of refraction", choices=MODELS)
    rate_hz: float = parameter(0.5, doc="messages per second", **RATE)


@dataclass(frozen=True)
class Scenario:
    """A simulated voyage."""

    carrier: CarrierMotion
    start_utc: str = parameter(doc="start, ISO 8601 with the letter Z, for example 2014-07-09T11:50:07.8Z")
    duration_s: float = parameter(doc="duration", unit="s", minimum=1.0, maximum=1e6)
    description: str = parameter("", doc="description of the scenario")
    ins: Ins = section(Ins)
    star_sensors: dict[str, StarSensor] = mapping_of("star sensors by id")
    references: dict[str, Reference] = mapping_of("other attitude systems by name")
    ship_baseline: ShipBaseline = section(ShipBaseline)
    fused_attitude: FusedAttitude = section(FusedAttitude)
    theodolite: Theodolite = section(Theodolite)
    beacons: dict[str, Beacon] = mapping_of("drones with lights by id")
    targets: dict[str, Target] = mapping_of("bodies observed by the main tube, by id")
    telescopes: dict[str, StarTelescope] = mapping_of("star cameras on the theodolite, by id")
    position: Position = section(Position)
    gravity: Gravity = section(Gravity)
    weather: WeatherStation = section(WeatherStation)
    earth_rotation_sigma_s: float = parameter(
        0.0, doc="error of UT1 - UTC; 0: that of the Earth orientation table", unit="s", minimum=0.0, maximum=1.0
    )
    faults: dict[str, Fault] = mapping_of("faults by name")

    @property
    def needs_sky(self) -> bool:
        """True if a star sensor observes the real sky, so that the suite needs the sky for the ship's attitude."""
        return any(sensor.output != "horizon_attitude" for sensor in self.star_sensors.values())

    @property
    def has_sky(self) -> bool:
        """True if any device observes the real sky."""
        return self.needs_sky or bool(self.telescopes)

    @property
    def needs_position(self) -> bool:
        """True if the suite needs the ship's position."""
        return self.needs_sky or self.gravity.told != "none" or self.ins.model == SCHULER


def scenario_keys() -> Iterator[ParameterDescription]:
    """Yield the descriptions of all keys of a scenario file; ``live`` applies to nodes only, and is False."""
    return (replace(key, live=False) for key in describe(Scenario))


def start_time_ns(start_utc: str) -> int:
    """Return POSIX nanoseconds of a time such as ``2014-07-09T11:50:07.8Z``.

    Raises:
        ValueError: the text is not such a time.
    """
    match = _START_PATTERN.fullmatch(start_utc)
    if match is None:
        raise ValueError("expected YYYY-MM-DDThh:mm:ss, at most nine decimals, and the letter Z")
    whole = datetime.fromisoformat(match[1]).replace(tzinfo=timezone.utc)
    return round(whole.timestamp()) * SECOND_NS + int(f"{match[2] or '0':0<9}")

"""Parameters of the theodolite in a scenario file, and of the drones and targets that it observes.

Vectors of devices are (forward, up, right). Positions of drones and targets are relative to the intersection of the
theodolite's axes.
"""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters.fields import changed_parameter, mapping_of, parameter, section
from ship_estimation.parameters.ship_devices import BaselineSurvey
from ship_estimation.parameters.theodolite_devices import (
    AirConfig,
    AxesConfig,
    BaselineErrors,
    DeformationConfig,
    DroneAttitudeErrors,
    LeverConfig,
    MainDetectorOptics,
    ShipAntennaConfig,
    TelescopeOptics,
)
from ship_simulation.scenario.motion_scenario import (
    ANGLE,
    CORRELATION,
    DELAY,
    EXPOSURE,
    MIN_CORRELATION_S,
    RATE,
    SIGMA,
    TIME,
    Outage,
)

_METRES: dict[str, Any] = {"unit": "m", "minimum": -200.0, "maximum": 200.0}

_ELEVATION: dict[str, Any] = {"unit": "deg", "minimum": -89.0, "maximum": 89.0}
_DISTANCE: dict[str, Any] = {"unit": "m", "minimum": 10.0, "maximum": 50_000.0}
_OFFSET: dict[str, Any] = {"unit": "deg", "minimum": -45.0, "maximum": 45.0}
_SPEED: dict[str, Any] = {"unit": "m/s", "minimum": -100.0, "maximum": 100.0}
_SIGMA_M: dict[str, Any] = {"unit": "m", "minimum": 0.0, "maximum": 100.0}
_SIGMA_DEG: dict[str, Any] = {"unit": "deg", "minimum": 0.0, "maximum": 90.0}

SECTIONS_OF_COURSE = {"escort": "escort", "hover": "hover", "orbit": "orbit", "legs": "waypoints"}
"""Kind of course → parameter group that it uses."""


@dataclass(frozen=True)
class SurveyError:
    """Error of a survey in the axes of the device: part of the truth, and unknown to the suite."""

    forward_m: float = parameter(0.0, doc="error of the survey along forward, unknown to the suite", **_METRES)
    up_m: float = parameter(0.0, doc="error of the survey along up, unknown to the suite", **_METRES)
    right_m: float = parameter(0.0, doc="error of the survey along right, unknown to the suite", **_METRES)


@dataclass(frozen=True)
class Encoder:
    """The encoders of the two axes."""

    rate_hz: float = parameter(100.0, doc="readings per second", **RATE)
    phase_s: float = parameter(0.0, doc="first reading after the start", **TIME)
    latency_s: float = parameter(0.002, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    sigma_arcsec: float = parameter(1.0, doc="noise of a reading, each axis", **SIGMA)


def _exact(name: str) -> Any:
    """Return the field of the sigma of an axis error, whose default in a scenario is 0."""
    return changed_parameter(AxesConfig, name, default=0.0)


@dataclass(frozen=True, kw_only=True)
class Axes(AxesConfig):
    """Axis errors: known values, and standard deviations of the true values about the known values."""

    spread: str = parameter("normal", doc="distribution of the errors, sigma unchanged", choices=("normal", "uniform"))
    g_sigma_arcsec: float = _exact("g_sigma_arcsec")
    h_sigma_arcsec: float = _exact("h_sigma_arcsec")
    c_sigma_arcsec: float = _exact("c_sigma_arcsec")
    I_sigma_arcsec: float = _exact("I_sigma_arcsec")
    beta_x_sigma_arcsec: float = _exact("beta_x_sigma_arcsec")
    beta_y_sigma_arcsec: float = _exact("beta_y_sigma_arcsec")


@dataclass(frozen=True, kw_only=True)
class Telescope(TelescopeOptics):
    """The calibration telescope, its detector, and its parallelism to the main axis."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **TIME)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: lights are streaks, points the mean of the path; 0: points, not stated",
        **EXPOSURE,
    )
    focal_length_m: float = changed_parameter(TelescopeOptics, "focal_length_m", default=0.1, minimum=0.01)
    sigma_m: float = changed_parameter(TelescopeOptics, "sigma_m", default=6.5e-7)
    width_m: float = parameter(0.014, doc="width of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.014, doc="height of the detector", unit="m", minimum=1e-4, maximum=1.0)
    lens_untold: SurveyError = section(SurveyError)


@dataclass(frozen=True, kw_only=True)
class MainDetector(MainDetectorOptics):
    """The detector in the main tube, which images targets; there is none if its focal length is 0."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **TIME)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0, doc="length of an exposure: a target's point is the mean of its path; 0: not stated", **EXPOSURE
    )
    width_m: float = parameter(0.02, doc="width of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.02, doc="height of the detector", unit="m", minimum=1e-4, maximum=1.0)
    rotation_deg: float = parameter(0.0, doc="rotation about the main axis at the start, right down", **ANGLE)
    rotation_rate_deg_per_s: float = parameter(
        0.0, doc="rotation rate of the detector", unit="deg/s", minimum=-60.0, maximum=60.0
    )


@dataclass(frozen=True)
class Programme:
    """Pointing of the main axis: constant azimuth rate, periodic elevation, stabilised against the ship's motion."""

    azimuth_deg: float = parameter(0.0, doc="azimuth at the start, from North", **ANGLE)
    azimuth_rate_deg_per_s: float = parameter(1.2, doc="azimuth rate", unit="deg/s", minimum=-60.0, maximum=60.0)
    least_elevation_deg: float = parameter(10.0, doc="elevation at the start", unit="deg", minimum=-10.0, maximum=85.0)
    greatest_elevation_deg: float = parameter(
        70.0, doc="elevation after half a period", unit="deg", minimum=-10.0, maximum=85.0
    )
    elevation_period_s: float = parameter(110.0, doc="period of the elevation", unit="s", minimum=1.0, maximum=1e6)
    follows_lights: bool = parameter(
        False, doc="point at the middle of the lights, and sweep from there when all have left"
    )


@dataclass(frozen=True, kw_only=True)
class TerrestrialRefraction(AirConfig):
    """Refraction on the path to the lights: its coefficient k is a Gauss–Markov process about the known value."""

    sigma: float = changed_parameter(AirConfig, "sigma", default=0.0)
    light_sigma: float = changed_parameter(AirConfig, "light_sigma", default=0.0)
    time_s: float = changed_parameter(AirConfig, "time_s", minimum=MIN_CORRELATION_S)


@dataclass(frozen=True, kw_only=True)
class ShipAntenna(ShipAntennaConfig):
    """The antenna on board that is the base of all baselines, which share its error."""

    sigma_m: float = changed_parameter(ShipAntennaConfig, "sigma_m", default=0.0)
    time_s: float = changed_parameter(ShipAntennaConfig, "time_s", minimum=MIN_CORRELATION_S)


@dataclass(frozen=True)
class Theodolite:
    """The theodolite, its position on board, and its equipment."""

    aboard: bool = parameter(False, doc="true: the ship has a theodolite")
    encoder: Encoder = section(Encoder)
    axes: Axes = section(Axes)
    deformation: DeformationConfig = section(DeformationConfig)
    lever: LeverConfig = section(LeverConfig)
    telescope: Telescope = section(Telescope)
    main_detector: MainDetector = section(MainDetector)
    programme: Programme = section(Programme)
    air: TerrestrialRefraction = section(TerrestrialRefraction)
    ship_antenna: ShipAntenna = section(ShipAntenna)


@dataclass(frozen=True)
class Escort:
    """Course of a drone or target that follows the programme's sweep with a constant offset."""

    right_deg: float = parameter(0.0, doc="offset to the right of the line of sight", **_OFFSET)
    up_deg: float = parameter(0.0, doc="offset above the line of sight", **_OFFSET)
    distance_m: float = parameter(2000.0, doc="distance from the theodolite", **_DISTANCE)


@dataclass(frozen=True)
class Hover:
    """Course of a drone or target that hovers, or drifts in a straight line."""

    azimuth_deg: float = parameter(0.0, doc="azimuth at the start, from North", **ANGLE)
    elevation_deg: float = parameter(30.0, doc="elevation at the start", **_ELEVATION)
    distance_m: float = parameter(2000.0, doc="distance at the start", **_DISTANCE)
    north_m_per_s: float = parameter(0.0, doc="drift relative to the ship, northward", **_SPEED)
    up_m_per_s: float = parameter(0.0, doc="drift relative to the ship, upward", **_SPEED)
    east_m_per_s: float = parameter(0.0, doc="drift relative to the ship, eastward", **_SPEED)


@dataclass(frozen=True)
class Orbit:
    """Course of a drone or target that circles the theodolite."""

    azimuth_deg: float = parameter(0.0, doc="azimuth at the start, from North", **ANGLE)
    elevation_deg: float = parameter(30.0, doc="constant elevation", **_ELEVATION)
    distance_m: float = parameter(2000.0, doc="constant distance", **_DISTANCE)
    rate_deg_per_s: float = parameter(0.3, doc="azimuth rate", unit="deg/s", minimum=-60.0, maximum=60.0)


@dataclass(frozen=True)
class Waypoint:
    """A point where a drone or target on straight legs stops for an instant."""

    time_s: float = parameter(doc="time after the start", **TIME)
    azimuth_deg: float = parameter(doc="azimuth from North", **ANGLE)
    elevation_deg: float = parameter(doc="elevation above the horizon", **_ELEVATION)
    distance_m: float = parameter(doc="distance from the theodolite", **_DISTANCE)


@dataclass(frozen=True)
class Course:
    """Course of a body relative to the theodolite."""

    kind: str = parameter("hover", doc="kind of the course", choices=("escort", "hover", "orbit", "legs"))
    escort: Escort = section(Escort)
    hover: Hover = section(Hover)
    orbit: Orbit = section(Orbit)
    waypoints: dict[str, Waypoint] = mapping_of("ends of straight legs, two or more, by name")


@dataclass(frozen=True)
class Flight(Course):
    """Flight of a drone, with its sway."""

    yaw_deg: float = parameter(0.0, doc="heading of the nose, from North", **ANGLE)
    sway_deg: float = parameter(2.0, doc="amplitude of pitch and of roll", unit="deg", minimum=0.0, maximum=45.0)
    sway_period_s: float = parameter(4.0, doc="period of both", unit="s", minimum=0.1, maximum=1000.0)


@dataclass(frozen=True, kw_only=True)
class Rtk(BaselineErrors):
    """Satellite positioning between two antennas."""

    rate_hz: float = parameter(10.0, doc="solutions per second", **RATE)
    phase_s: float = parameter(0.0, doc="first solution after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    sigma_m: float = changed_parameter(BaselineErrors, "sigma_m", default=0.015)
    bias_sigma_m: float = changed_parameter(BaselineErrors, "bias_sigma_m", default=0.0)
    bias_time_s: float = changed_parameter(BaselineErrors, "bias_time_s", minimum=MIN_CORRELATION_S)
    float_sigma_m: float = parameter(0.3, doc="further correlated error of FLOAT, in the message sigma", **_SIGMA_M)
    float_time_s: float = parameter(60.0, doc="correlation time of the error", **CORRELATION)
    float_times: dict[str, Outage] = mapping_of("times with the fix FLOAT, by name")
    no_solution_times: dict[str, Outage] = mapping_of("times with the fix NONE, by name")
    outages: dict[str, Outage] = mapping_of("times without messages, by name")


@dataclass(frozen=True, kw_only=True)
class ShipBaseline(BaselineSurvey):
    """Two antennas on board with satellite positioning between them; there are none if the three lengths are 0."""

    rtk: Rtk = section(Rtk)


@dataclass(frozen=True, kw_only=True)
class DroneImu(DroneAttitudeErrors):
    """Attitude published by the drone."""

    rate_hz: float = parameter(20.0, doc="samples per second", **RATE)
    phase_s: float = parameter(0.0, doc="first sample after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    time_s: float = changed_parameter(DroneAttitudeErrors, "time_s", minimum=MIN_CORRELATION_S)
    white_sigma_deg: float = parameter(0.05, doc="noise of each sample, each axis", **_SIGMA_DEG)


@dataclass(frozen=True)
class Beacon:
    """A drone with a light."""

    flight: Flight = section(Flight)
    leaves_s: float = parameter(1e6, doc="time when it leaves, with its light and its messages", **TIME)
    hidden: dict[str, Outage] = mapping_of("times in which its light is hidden, by name")
    light: LeverConfig = section(LeverConfig)
    rtk: Rtk = section(Rtk)
    imu: DroneImu = section(DroneImu)


@dataclass(frozen=True)
class Target:
    """A body observed by the main tube."""

    course: Course = section(Course)
    leaves_s: float = parameter(1e6, doc="time when it leaves", **TIME)
    hidden: dict[str, Outage] = mapping_of("times in which it is hidden, by name")
    range_sigma_m: float = parameter(
        0.0, doc="noise of the range stated in its images; 0: no range", unit="m", minimum=0.0, maximum=1e4
    )

"""Parameters of the theodolite in a scenario file, and of the drones and targets that it observes.

Vectors of devices are (forward, up, right). Positions of drones and targets are relative to the intersection of the
theodolite's axes.
"""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S
from ship_simulation.scenario.motion_scenario import ANGLE, CORRELATION, DELAY, RATE, SIGMA, TIME, Outage

_AXIS_ERROR: dict[str, Any] = {"unit": "arcsec", "minimum": -3600.0, "maximum": 3600.0}
_AXIS_SIGMA: dict[str, Any] = {"unit": "arcsec", "minimum": 0.0, "maximum": 3600.0}
_PARALLELISM: dict[str, Any] = {"unit": "arcsec", "minimum": -36_000.0, "maximum": 36_000.0}
_METRES: dict[str, Any] = {"unit": "m", "minimum": -200.0, "maximum": 200.0}
_SMALL_METRES: dict[str, Any] = {"unit": "m", "minimum": 0.0, "maximum": 10.0}

_ELEVATION: dict[str, Any] = {"unit": "deg", "minimum": -89.0, "maximum": 89.0}
_DISTANCE: dict[str, Any] = {"unit": "m", "minimum": 10.0, "maximum": 50_000.0}
_OFFSET: dict[str, Any] = {"unit": "deg", "minimum": -45.0, "maximum": 45.0}
_SPEED: dict[str, Any] = {"unit": "m/s", "minimum": -100.0, "maximum": 100.0}
_LENGTH_M: dict[str, Any] = {"unit": "m", "minimum": -1000.0, "maximum": 1000.0}
_SIGMA_M: dict[str, Any] = {"unit": "m", "minimum": 0.0, "maximum": 100.0}
_SIGMA_DEG: dict[str, Any] = {"unit": "deg", "minimum": 0.0, "maximum": 90.0}


@dataclass(frozen=True)
class Lever:
    """A surveyed vector in the axes of the device on which it is mounted."""

    forward_m: float = parameter(0.0, doc="surveyed component along forward (bow)", **_METRES)
    up_m: float = parameter(0.0, doc="surveyed component along up", **_METRES)
    right_m: float = parameter(0.0, doc="surveyed component along right (starboard)", **_METRES)
    sigma_m: float = parameter(0.0, doc="standard deviation of the survey, each axis", **_SMALL_METRES)


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


@dataclass(frozen=True)
class Axes:
    """Axis errors: known values, and standard deviations of the true values about the known values."""

    spread: str = parameter("normal", doc="distribution of the errors, sigma unchanged", choices=("normal", "uniform"))
    g_arcsec: float = parameter(0.0, doc="known zero point of the azimuth encoder", **_AXIS_ERROR)
    g_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    h_arcsec: float = parameter(0.0, doc="known zero point of the elevation encoder", **_AXIS_ERROR)
    h_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    c_arcsec: float = parameter(0.0, doc="known collimation of the optical axis, to the left", **_AXIS_ERROR)
    c_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    I_arcsec: float = parameter(
        0.0, doc="known non-perpendicularity: tilt of the horizontal axis, right end up", **_AXIS_ERROR
    )
    I_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    beta_x_arcsec: float = parameter(0.0, doc="known tilt of the vertical axis to the bow", **_AXIS_ERROR)
    beta_x_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    beta_y_arcsec: float = parameter(0.0, doc="known tilt of the vertical axis to starboard", **_AXIS_ERROR)
    beta_y_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)
    flexure_arcsec: float = parameter(0.0, doc="known bending of the tube, up at elevation 0", **_AXIS_ERROR)
    flexure_sigma_arcsec: float = parameter(0.0, doc="standard deviation of this error", **_AXIS_SIGMA)


@dataclass(frozen=True)
class Deformation:
    """Rotation of the hull between INS and theodolite: Gauss–Markov about bow, up and starboard."""

    sigma_arcsec: float = parameter(20.0, doc="standard deviation, each axis", **SIGMA)
    time_s: float = parameter(600.0, doc="correlation time", unit="s", minimum=1.0, maximum=1e7)


@dataclass(frozen=True)
class Telescope:
    """The calibration telescope, its detector, and its parallelism to the main axis."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **TIME)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: lights are streaks, points the mean of the path; 0: points, not stated",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_EXPOSURE_S,
    )
    focal_length_m: float = parameter(0.1, doc="known focal length", unit="m", minimum=0.01, maximum=10.0)
    focal_length_sigma_m: float = parameter(0.0001, doc="error of the focal length", unit="m", minimum=0.0, maximum=0.1)
    principal_x_m: float = parameter(
        0.0, doc="detector point of the axis, along right", unit="m", minimum=-0.1, maximum=0.1
    )
    principal_z_m: float = parameter(
        0.0, doc="detector point of the axis, along up", unit="m", minimum=-0.1, maximum=0.1
    )
    width_m: float = parameter(0.014, doc="width of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.014, doc="height of the detector", unit="m", minimum=1e-4, maximum=1.0)
    sigma_m: float = parameter(6.5e-7, doc="noise of an image point, each axis", unit="m", minimum=1e-9, maximum=0.001)
    psf_sigma_m: float = parameter(
        5.2e-6, doc="sigma of the image of a light at rest, each axis", unit="m", minimum=1e-7, maximum=0.001
    )
    azimuth_arcsec: float = parameter(0.0, doc="known azimuth of the main axis in the telescope", **_PARALLELISM)
    azimuth_sigma_arcsec: float = parameter(0.0, doc="error of the azimuth", **SIGMA)
    elevation_arcsec: float = parameter(0.0, doc="known elevation of the main axis in the telescope", **_PARALLELISM)
    elevation_sigma_arcsec: float = parameter(0.0, doc="error of the elevation", **SIGMA)
    rotation_arcsec: float = parameter(0.0, doc="known rotation of the main image in the telescope", **_PARALLELISM)
    rotation_sigma_arcsec: float = parameter(0.0, doc="error of the rotation", **SIGMA)
    lens: Lever = section(Lever)
    lens_untold: SurveyError = section(SurveyError)


@dataclass(frozen=True)
class MainDetector:
    """The detector in the main tube, which images targets; there is none if its focal length is 0."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **TIME)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: a target's point is the mean of its path; 0: not stated",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_EXPOSURE_S,
    )
    focal_length_m: float = parameter(
        0.0, doc="known focal length of the main tube; 0: no main detector", unit="m", minimum=0.0, maximum=100.0
    )
    focal_length_sigma_m: float = parameter(0.0, doc="error of the focal length", unit="m", minimum=0.0, maximum=0.1)
    principal_x_m: float = parameter(
        0.0, doc="known detector point of the main axis, along right", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_z_m: float = parameter(
        0.0, doc="known detector point of the main axis, along up", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_sigma_m: float = parameter(0.0, doc="error of this point, each axis", unit="m", minimum=0.0, maximum=0.1)
    width_m: float = parameter(0.02, doc="width of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.02, doc="height of the detector", unit="m", minimum=1e-4, maximum=1.0)
    sigma_m: float = parameter(
        1e-6, doc="noise of an image point, each axis", unit="m", minimum=1e-9, maximum=0.001
    )
    rotation_deg: float = parameter(0.0, doc="rotation about the main axis at the start, right down", **ANGLE)
    rotation_rate_deg_per_s: float = parameter(
        0.0, doc="rotation rate of the detector", unit="deg/s", minimum=-60.0, maximum=60.0
    )
    rotation_sigma_arcsec: float = parameter(0.0, doc="error of the rotation stated in the images", **SIGMA)


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


@dataclass(frozen=True)
class TerrestrialRefraction:
    """Refraction on the path to the lights: its coefficient k is a Gauss–Markov process about the known value."""

    coefficient: float = parameter(0.13, doc="known value of k", minimum=-5.0, maximum=5.0)
    sigma: float = parameter(0.0, doc="error of k common to all lights", minimum=0.0, maximum=5.0)
    light_sigma: float = parameter(0.0, doc="additional error of k for each light", minimum=0.0, maximum=5.0)
    time_s: float = parameter(3600.0, doc="correlation time of both errors", **CORRELATION)


@dataclass(frozen=True)
class ShipAntenna:
    """The antenna on board that is the base of all baselines, which share its error."""

    sigma_m: float = parameter(0.0, doc="correlated error, each axis", **_SMALL_METRES)
    time_s: float = parameter(300.0, doc="correlation time of the error", **CORRELATION)


@dataclass(frozen=True)
class Theodolite:
    """The theodolite, its position on board, and its equipment."""

    aboard: bool = parameter(False, doc="true: the ship has a theodolite")
    encoder: Encoder = section(Encoder)
    axes: Axes = section(Axes)
    deformation: Deformation = section(Deformation)
    lever: Lever = section(Lever)
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


SECTIONS_OF_COURSE = {"escort": "escort", "hover": "hover", "orbit": "orbit", "legs": "waypoints"}
"""Kind of course → parameter group that it uses."""


@dataclass(frozen=True)
class Rtk:
    """Satellite positioning between two antennas."""

    rate_hz: float = parameter(10.0, doc="solutions per second", **RATE)
    phase_s: float = parameter(0.0, doc="first solution after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    sigma_m: float = parameter(
        0.015, doc="noise of each solution, each axis; the message's sigma", unit="m", minimum=1e-4, maximum=100.0
    )
    bias_sigma_m: float = parameter(0.0, doc="correlated error of its own, each axis", **_SIGMA_M)
    bias_time_s: float = parameter(300.0, doc="correlation time of the error", **CORRELATION)
    float_sigma_m: float = parameter(0.3, doc="further correlated error of FLOAT, in the message sigma", **_SIGMA_M)
    float_time_s: float = parameter(60.0, doc="correlation time of the error", **CORRELATION)
    float_times: dict[str, Outage] = mapping_of("times with the fix FLOAT, by name")
    no_solution_times: dict[str, Outage] = mapping_of("times with the fix NONE, by name")
    outages: dict[str, Outage] = mapping_of("times without messages, by name")


@dataclass(frozen=True)
class ShipBaseline:
    """Two antennas on board with satellite positioning between them; there are none if the three lengths are 0."""

    forward_m: float = parameter(0.0, doc="from the base to the rover antenna, toward the bow", **_LENGTH_M)
    up_m: float = parameter(0.0, doc="from the base to the rover antenna, upward", **_LENGTH_M)
    right_m: float = parameter(0.0, doc="from the base to the rover antenna, to starboard", **_LENGTH_M)
    sigma_m: float = parameter(0.005, doc="standard deviation of the survey, each component", **_SIGMA_M)
    rtk: Rtk = section(Rtk)

    @property
    def is_aboard(self) -> bool:
        """True if the ship has the two antennas."""
        return any((self.forward_m, self.up_m, self.right_m))


@dataclass(frozen=True)
class DroneImu:
    """Attitude published by the drone."""

    rate_hz: float = parameter(20.0, doc="samples per second", **RATE)
    phase_s: float = parameter(0.0, doc="first sample after the start", **TIME)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="additional delay, uniform between 0 and this", **DELAY)
    tilt_sigma_deg: float = parameter(0.3, doc="correlated error in tilt, each axis", **_SIGMA_DEG)
    heading_sigma_deg: float = parameter(1.0, doc="correlated error in heading", **_SIGMA_DEG)
    time_s: float = parameter(300.0, doc="correlation time of both errors", **CORRELATION)
    white_sigma_deg: float = parameter(0.05, doc="noise of each sample, each axis", **_SIGMA_DEG)


@dataclass(frozen=True)
class Beacon:
    """A drone with a light."""

    flight: Flight = section(Flight)
    leaves_s: float = parameter(1e6, doc="time when it leaves, with its light and its messages", **TIME)
    hidden: dict[str, Outage] = mapping_of("times in which its light is hidden, by name")
    light: Lever = section(Lever)
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

"""The part of a scenario file that describes the theodolite, and the drones whose lights it sees.

Vectors of devices are (forward, up, right). Places of drones are seen from the crossing of the theodolite's axes.
"""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameter_fields import mapping_of, parameter, section
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S
from ship_simulation.scenario.motion_scenario import ANGLE, CORRELATION, DELAY, MOMENT, RATE, SIGMA, Outage

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
    """A surveyed vector in the axes of the device that carries it."""

    forward_m: float = parameter(0.0, doc="surveyed component along forward (bow)", **_METRES)
    up_m: float = parameter(0.0, doc="surveyed component along up", **_METRES)
    right_m: float = parameter(0.0, doc="surveyed component along right (starboard)", **_METRES)
    sigma_m: float = parameter(0.0, doc="error of the survey, each axis", **_SMALL_METRES)


@dataclass(frozen=True)
class UntoldVector:
    """What a survey missed, in the axes of the device that carries it: true, and told to nobody."""

    forward_m: float = parameter(0.0, doc="component along forward that nobody surveyed", **_METRES)
    up_m: float = parameter(0.0, doc="component along up that nobody surveyed", **_METRES)
    right_m: float = parameter(0.0, doc="component along right that nobody surveyed", **_METRES)


@dataclass(frozen=True)
class Encoder:
    """The encoders of the two axes."""

    rate_hz: float = parameter(100.0, doc="readings per second", **RATE)
    phase_s: float = parameter(0.0, doc="first reading after the start", **MOMENT)
    latency_s: float = parameter(0.002, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    sigma_arcsec: float = parameter(1.0, doc="noise of a reading, each axis", **SIGMA)


@dataclass(frozen=True)
class Axes:
    """Axis errors: what is known of each, and how far the true one may be from that."""

    spread: str = parameter("normal", doc="distribution of that, sigma the same", choices=("normal", "uniform"))
    g_arcsec: float = parameter(0.0, doc="zero point of the azimuth encoder as known", **_AXIS_ERROR)
    g_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    h_arcsec: float = parameter(0.0, doc="zero point of the elevation encoder as known", **_AXIS_ERROR)
    h_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    c_arcsec: float = parameter(0.0, doc="collimation as known, to the left", **_AXIS_ERROR)
    c_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    I_arcsec: float = parameter(0.0, doc="tilt of the horizontal axis as known, right end up", **_AXIS_ERROR)
    I_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    beta_x_arcsec: float = parameter(0.0, doc="tilt of the vertical axis to the bow as known", **_AXIS_ERROR)
    beta_x_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    beta_y_arcsec: float = parameter(0.0, doc="tilt of the vertical axis to starboard as known", **_AXIS_ERROR)
    beta_y_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)
    flexure_arcsec: float = parameter(0.0, doc="bending of the tube as known, up at elevation 0", **_AXIS_ERROR)
    flexure_sigma_arcsec: float = parameter(0.0, doc="its error", **_AXIS_SIGMA)


@dataclass(frozen=True)
class Deformation:
    """How the hull turns between INS and theodolite: Gauss–Markov about bow, up and starboard."""

    sigma_arcsec: float = parameter(20.0, doc="each axis", **SIGMA)
    time_s: float = parameter(600.0, doc="correlation time", unit="s", minimum=1.0, maximum=1e7)


@dataclass(frozen=True)
class Telescope:
    """The calibration telescope, its detector, and how parallel it is to the main axis."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **MOMENT)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: lights are streaks, with the mean of their way as point; 0: points, and not told",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_EXPOSURE_S,
    )
    focal_length_m: float = parameter(0.1, doc="as known", unit="m", minimum=0.01, maximum=10.0)
    focal_length_sigma_m: float = parameter(0.0001, doc="its error", unit="m", minimum=0.0, maximum=0.1)
    principal_x_m: float = parameter(
        0.0, doc="detector point of the axis, along right", unit="m", minimum=-0.1, maximum=0.1
    )
    principal_z_m: float = parameter(
        0.0, doc="detector point of the axis, along up", unit="m", minimum=-0.1, maximum=0.1
    )
    width_m: float = parameter(0.014, doc="of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.014, doc="of the detector", unit="m", minimum=1e-4, maximum=1.0)
    sigma_m: float = parameter(6.5e-7, doc="noise of an image point, each axis", unit="m", minimum=1e-9, maximum=0.001)
    psf_sigma_m: float = parameter(
        5.2e-6, doc="spread of the image of a light at rest, each axis", unit="m", minimum=1e-7, maximum=0.001
    )
    azimuth_arcsec: float = parameter(0.0, doc="of the main axis in the telescope, as known", **_PARALLELISM)
    azimuth_sigma_arcsec: float = parameter(0.0, doc="its error", **SIGMA)
    elevation_arcsec: float = parameter(0.0, doc="of the main axis in the telescope, as known", **_PARALLELISM)
    elevation_sigma_arcsec: float = parameter(0.0, doc="its error", **SIGMA)
    rotation_arcsec: float = parameter(0.0, doc="of the main image in the telescope, as known", **_PARALLELISM)
    rotation_sigma_arcsec: float = parameter(0.0, doc="its error", **SIGMA)
    lens: Lever = section(Lever)
    lens_untold: UntoldVector = section(UntoldVector)


@dataclass(frozen=True)
class MainDetector:
    """The detector in the main tube, on which targets are seen; there is none where it has no focal length."""

    rate_hz: float = parameter(10.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="middle of the first exposure after the start", **MOMENT)
    latency_s: float = parameter(0.05, doc="from stamp (middle of the exposure) to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: a target's point is the mean of its way; 0: none, and not told",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_EXPOSURE_S,
    )
    focal_length_m: float = parameter(
        0.0, doc="of the main tube, as known; 0: there is no main detector", unit="m", minimum=0.0, maximum=100.0
    )
    focal_length_sigma_m: float = parameter(0.0, doc="its error", unit="m", minimum=0.0, maximum=0.1)
    principal_x_m: float = parameter(
        0.0, doc="detector point of the main axis, along right, as known", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_z_m: float = parameter(
        0.0, doc="detector point of the main axis, along up, as known", unit="m", minimum=-0.5, maximum=0.5
    )
    principal_sigma_m: float = parameter(0.0, doc="error of that point, each axis", unit="m", minimum=0.0, maximum=0.1)
    width_m: float = parameter(0.02, doc="of the detector", unit="m", minimum=1e-4, maximum=1.0)
    height_m: float = parameter(0.02, doc="of the detector", unit="m", minimum=1e-4, maximum=1.0)
    sigma_m: float = parameter(
        1e-6, doc="noise of an image point, each axis", unit="m", minimum=1e-9, maximum=0.001
    )
    rotation_deg: float = parameter(0.0, doc="of the detector about the main axis at the start, right down", **ANGLE)
    rotation_rate_deg_per_s: float = parameter(
        0.0, doc="how fast it is turned", unit="deg/s", minimum=-60.0, maximum=60.0
    )
    rotation_sigma_arcsec: float = parameter(0.0, doc="error of the rotation that the images tell", **SIGMA)


@dataclass(frozen=True)
class Programme:
    """Where the main axis looks: a steady sweep in azimuth, up and down in elevation; over the ship's motion."""

    azimuth_deg: float = parameter(0.0, doc="at the start, from North", **ANGLE)
    azimuth_rate_deg_per_s: float = parameter(1.2, doc="of the sweep", unit="deg/s", minimum=-60.0, maximum=60.0)
    least_elevation_deg: float = parameter(10.0, doc="at the start", unit="deg", minimum=-10.0, maximum=85.0)
    greatest_elevation_deg: float = parameter(
        70.0, doc="after half a period", unit="deg", minimum=-10.0, maximum=85.0
    )
    elevation_period_s: float = parameter(110.0, doc="from least to least", unit="s", minimum=1.0, maximum=1e6)
    follows_lights: bool = parameter(
        False, doc="looks at the middle of the lights, and sweeps from there when all have left"
    )


@dataclass(frozen=True)
class TerrestrialRefraction:
    """Refraction on the way to the lights: its coefficient k is a Gauss–Markov process about what is known."""

    coefficient: float = parameter(0.13, doc="k as known", minimum=-5.0, maximum=5.0)
    sigma: float = parameter(0.0, doc="error of k, the same for all lights", minimum=0.0, maximum=5.0)
    light_sigma: float = parameter(0.0, doc="further error of k at each light", minimum=0.0, maximum=5.0)
    time_s: float = parameter(3600.0, doc="correlation time of both", **CORRELATION)


@dataclass(frozen=True)
class ShipAntenna:
    """The antenna aboard from which all baselines begin: its error is in all of them."""

    sigma_m: float = parameter(0.0, doc="slow error, each axis", **_SMALL_METRES)
    time_s: float = parameter(300.0, doc="its correlation time", **CORRELATION)


@dataclass(frozen=True)
class Theodolite:
    """The theodolite, where it stands, and what it is used with."""

    aboard: bool = parameter(False, doc="whether there is one")
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
    """Flies with the sweep of the theodolite's programme, at a steady place beside its line."""

    right_deg: float = parameter(0.0, doc="to the right of the line", **_OFFSET)
    up_deg: float = parameter(0.0, doc="above the line", **_OFFSET)
    distance_m: float = parameter(2000.0, doc="from the theodolite", **_DISTANCE)


@dataclass(frozen=True)
class Hover:
    """Stays, or drifts in a straight line."""

    azimuth_deg: float = parameter(0.0, doc="at the start, from North", **ANGLE)
    elevation_deg: float = parameter(30.0, doc="at the start", **_ELEVATION)
    distance_m: float = parameter(2000.0, doc="at the start", **_DISTANCE)
    north_m_per_s: float = parameter(0.0, doc="drift against the ship", **_SPEED)
    up_m_per_s: float = parameter(0.0, doc="drift against the ship", **_SPEED)
    east_m_per_s: float = parameter(0.0, doc="drift against the ship", **_SPEED)


@dataclass(frozen=True)
class Orbit:
    """Circles round the theodolite."""

    azimuth_deg: float = parameter(0.0, doc="at the start, from North", **ANGLE)
    elevation_deg: float = parameter(30.0, doc="all along", **_ELEVATION)
    distance_m: float = parameter(2000.0, doc="all along", **_DISTANCE)
    rate_deg_per_s: float = parameter(0.3, doc="of the azimuth", unit="deg/s", minimum=-60.0, maximum=60.0)


@dataclass(frozen=True)
class Waypoint:
    """A place where a drone on straight legs comes to rest for a moment."""

    time_s: float = parameter(doc="when, after the start", **MOMENT)
    azimuth_deg: float = parameter(doc="from North", **ANGLE)
    elevation_deg: float = parameter(doc="over the horizon", **_ELEVATION)
    distance_m: float = parameter(doc="from the theodolite", **_DISTANCE)


@dataclass(frozen=True)
class Course:
    """How a body moves, seen from the theodolite."""

    kind: str = parameter("hover", doc="what it does", choices=("escort", "hover", "orbit", "legs"))
    escort: Escort = section(Escort)
    hover: Hover = section(Hover)
    orbit: Orbit = section(Orbit)
    waypoints: dict[str, Waypoint] = mapping_of("ends of straight legs, two or more, by name")


@dataclass(frozen=True)
class Flight(Course):
    """How a drone flies, and how it sways."""

    yaw_deg: float = parameter(0.0, doc="where the nose points, from North", **ANGLE)
    sway_deg: float = parameter(2.0, doc="amplitude of pitch and of roll", unit="deg", minimum=0.0, maximum=45.0)
    sway_period_s: float = parameter(4.0, doc="period of both", unit="s", minimum=0.1, maximum=1000.0)


SECTIONS_OF_COURSE = {"escort": "escort", "hover": "hover", "orbit": "orbit", "legs": "waypoints"}
"""The group that each kind of course uses."""


@dataclass(frozen=True)
class Rtk:
    """Satellite positioning between two antennas."""

    rate_hz: float = parameter(10.0, doc="solutions per second", **RATE)
    phase_s: float = parameter(0.0, doc="first solution after the start", **MOMENT)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    sigma_m: float = parameter(
        0.015, doc="noise of each solution, each axis; the message's sigma", unit="m", minimum=1e-4, maximum=100.0
    )
    bias_sigma_m: float = parameter(0.0, doc="slow error of its own, each axis", **_SIGMA_M)
    bias_time_s: float = parameter(300.0, doc="its correlation time", **CORRELATION)
    float_sigma_m: float = parameter(0.3, doc="further slow error while FLOAT, in the message's sigma", **_SIGMA_M)
    float_time_s: float = parameter(60.0, doc="its correlation time", **CORRELATION)
    float_times: dict[str, Outage] = mapping_of("times with the fix FLOAT, by name")
    no_solution_times: dict[str, Outage] = mapping_of("times with the fix NONE, by name")
    outages: dict[str, Outage] = mapping_of("times without messages, by name")


@dataclass(frozen=True)
class ShipBaseline:
    """Two antennas aboard, and satellite positioning between them; none where the three lengths are 0."""

    forward_m: float = parameter(0.0, doc="from the base to the rover antenna, toward the bow", **_LENGTH_M)
    up_m: float = parameter(0.0, doc="the same, upward", **_LENGTH_M)
    right_m: float = parameter(0.0, doc="the same, to starboard", **_LENGTH_M)
    sigma_m: float = parameter(0.005, doc="how far off they were surveyed, each", **_SIGMA_M)
    rtk: Rtk = section(Rtk)

    @property
    def is_aboard(self) -> bool:
        """Whether the ship has one."""
        return any((self.forward_m, self.up_m, self.right_m))


@dataclass(frozen=True)
class DroneImu:
    """What the drone says of its own attitude."""

    rate_hz: float = parameter(20.0, doc="samples per second", **RATE)
    phase_s: float = parameter(0.0, doc="first sample after the start", **MOMENT)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    tilt_sigma_deg: float = parameter(0.3, doc="slow error in tilt, each axis", **_SIGMA_DEG)
    heading_sigma_deg: float = parameter(1.0, doc="slow error in heading", **_SIGMA_DEG)
    time_s: float = parameter(300.0, doc="their correlation time", **CORRELATION)
    white_sigma_deg: float = parameter(0.05, doc="noise of each sample, each axis", **_SIGMA_DEG)


@dataclass(frozen=True)
class Beacon:
    """A drone with a light."""

    flight: Flight = section(Flight)
    leaves_s: float = parameter(1e6, doc="when it is gone, with its light and its messages", **MOMENT)
    hidden: dict[str, Outage] = mapping_of("times in which its light is not seen, by name")
    light: Lever = section(Lever)
    rtk: Rtk = section(Rtk)
    imu: DroneImu = section(DroneImu)


@dataclass(frozen=True)
class Target:
    """A body that the main tube looks at."""

    course: Course = section(Course)
    leaves_s: float = parameter(1e6, doc="when it is gone", **MOMENT)
    hidden: dict[str, Outage] = mapping_of("times in which it is not seen, by name")
    range_sigma_m: float = parameter(
        0.0, doc="noise of the range that its images tell; 0: they tell none", unit="m", minimum=0.0, maximum=1e4
    )

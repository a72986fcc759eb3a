"""What a scenario file may say: the voyage, the devices, their errors, what goes wrong.

Each field states its unit, its range and its meaning. Sigmas are what the errors are drawn with, and what the
suite file in the bag tells the estimators (:mod:`ship_simulation.suite.suite`).
"""

import re
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np

from ship_attitude_star.ins_errors.config import GAUSS_MARKOV, SCHULER, SchulerConfig
from ship_attitude_star.sky.masks import MaskConfig, sensor_masks
from ship_attitude_star.stars.config import CameraConfig
from ship_estimation.parameter_fields import mapping_of, parameter, section
from ship_geometry.deck_masks import SensorMasks
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S
from ship_geometry.refraction import MODELS
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.motion_scenario import (
    ANGLE,
    CORRELATION,
    DEFLECTION,
    DELAY,
    MOMENT,
    RATE,
    SIGMA,
    CarrierMotion,
    Outage,
)
from ship_simulation.scenario.theodolite_scenario import Beacon, ShipBaseline, Target, Theodolite

_MOMENT = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z")

_FIELD_POINTS = 21
_OFFSET_SIGMA: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": 1.0}


@dataclass(frozen=True)
class Ins:
    """The inertial navigation system."""

    model: str = parameter(
        GAUSS_MARKOV,
        doc="how its error goes on: it dies out (tilt_time_s, heading_time_s), or oscillates as free sensors do",
        choices=(GAUSS_MARKOV, SCHULER),
    )
    schuler: SchulerConfig = section(SchulerConfig)
    rate_hz: float = parameter(100.0, doc="samples per second", **RATE)
    latency_s: float = parameter(0.002, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    tilt_sigma_arcsec: float = parameter(10.0, doc="slow error in tilt, each axis", **SIGMA)
    tilt_time_s: float = parameter(1800.0, doc="correlation time of the tilt error", **CORRELATION)
    heading_sigma_arcsec: float = parameter(72.0, doc="slow error in heading", **SIGMA)
    heading_time_s: float = parameter(10800.0, doc="correlation time of the heading error", **CORRELATION)
    white_sigma_arcsec: float = parameter(1.0, doc="noise of each sample, each axis", **SIGMA)
    rate_sigma_arcsec_per_s: float = parameter(
        0.0, doc="noise of the angular rate, each axis", unit="arcsec/s", minimum=0.0, maximum=3600.0
    )
    rate_bias_sigma_arcsec_per_s: float = parameter(
        0.0, doc="slow error of the angular rate, each axis of the deck", unit="arcsec/s", minimum=0.0, maximum=3600.0
    )
    rate_bias_time_s: float = parameter(3600.0, doc="correlation time of that error", **CORRELATION)
    rate_has_earth_rate: bool = parameter(False, doc="the angular rate contains the Earth's turn, as gyroscopes do")
    time_offset_s: float = parameter(
        0.0, doc="mean of: a sample is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(0.005, doc="spread of the time offset", **_OFFSET_SIGMA)


@dataclass(frozen=True, kw_only=True)
class Detector(CameraConfig):
    """The camera of a star sensor that gives single stars, with the size of its detector."""

    width_px: int = parameter(0, doc="columns; 0: not given", unit="px", minimum=0, maximum=100_000)
    height_px: int = parameter(0, doc="rows; 0: not given", unit="px", minimum=0, maximum=100_000)

    @property
    def edges_px(self) -> FloatArray:
        """Least and greatest (u, v) on the detector, shape (2, 2): whole numbers are the pixels' centres."""
        return np.array([[0.0, 0.0], [self.width_px, self.height_px]]) - 0.5

    def field_directions(self, prefix: str) -> FloatArray:
        """Directions all over the detector in the sensor frame, shape (n, 3).

        Args:
            prefix: name of this section of the scenario, for the error message.
        """
        least, greatest = self.edges_px
        columns, rows = np.linspace(least, greatest, _FIELD_POINTS).T
        return self.camera(prefix).directions(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))

    def holds(self, pixels: FloatArray) -> np.ndarray:
        """Whether pixels (u, v), shape (..., 2), lie on the detector; NaN does not."""
        least, greatest = self.edges_px
        inside: np.ndarray = np.all((pixels >= least) & (pixels < greatest), axis=-1)
        return inside


@dataclass(frozen=True, kw_only=True)
class StarImaging:
    """How stars of the real sky are taken: by a star sensor that gives single stars, or by a camera on the theodolite.

    The fields that other star sensors have too say when they look.
    """

    rate_hz: float = parameter(5.0, doc="exposures per second", **RATE)
    phase_s: float = parameter(0.0, doc="first exposure after the start", **MOMENT)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    outages: dict[str, Outage] = mapping_of("times without stars, by name")
    sun_limit_deg: float = parameter(
        -6.0, doc="no stars while the Sun stands higher than this", unit="deg", minimum=-90.0, maximum=90.0
    )
    camera: Detector = section(Detector)
    magnitude_limit: float = parameter(6.0, doc="faintest star that it sees, Hp", minimum=-2.0, maximum=14.0)
    most_stars: int = parameter(20, doc="stars in an exposure at most, the brightest", minimum=1, maximum=1000)
    exposure_s: float = parameter(
        0.0,
        doc="length of an exposure: stars are streaks, with the mean of their way as centroid; 0: points, and not told",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_EXPOSURE_S,
    )
    identified: bool = parameter(True, doc="whether the sensor says which stars they are")
    direction_given: bool = parameter(False, doc="it says so by their directions, not by their HIP numbers")
    false_stars: float = parameter(
        0.0, doc="mean number of spots in an exposure that are no stars", minimum=0.0, maximum=1000.0
    )
    swapped_probability: float = parameter(
        0.0, doc="share of the exposures in which two stars bear each other's identity", minimum=0.0, maximum=1.0
    )

    @property
    def sight_masks(self) -> SensorMasks | None:
        """What stands in the way; None where nothing does."""
        return None


@dataclass(frozen=True, kw_only=True)
class StarTelescope(StarImaging):
    """A camera fixed to the theodolite that sees stars: how the main axis stands in it, as known, and its stars."""

    azimuth_deg: float = parameter(doc="azimuth of the main axis in the camera, as known", **ANGLE)
    azimuth_sigma_arcsec: float = parameter(1.0, doc="its error", **SIGMA)
    elevation_deg: float = parameter(
        doc="elevation of the main axis in the camera, as known", unit="deg", minimum=-89.0, maximum=89.0
    )
    elevation_sigma_arcsec: float = parameter(1.0, doc="its error", **SIGMA)
    roll_deg: float = parameter(doc="rotation of the main image in the camera, as known", **ANGLE)
    roll_sigma_arcsec: float = parameter(20.0, doc="its error", **SIGMA)


STAR_OUTPUTS = ("horizon_attitude", "observations", "inertial_attitude")
"""What a star sensor may send: the topic's name under ``star/<id>/``."""


@dataclass(frozen=True)
class StarSensor(StarImaging):
    """A star sensor: where it is bolted, what it sends and how good that is.

    A horizon attitude is the true one with errors; observations and inertial attitudes come from the real sky over the
    ship. Which fields belong to which output: :data:`ship_simulation.scenario.scenario_file.FIELDS_OF_OUTPUTS`.
    """

    azimuth_deg: float = parameter(doc="installation azimuth of the boresight in the deck", **ANGLE)
    elevation_deg: float = parameter(
        doc="installation elevation of the boresight over the deck", unit="deg", minimum=-90.0, maximum=90.0
    )
    roll_deg: float = parameter(0.0, doc="installation roll about the boresight, right side down", **ANGLE)
    output: str = parameter("horizon_attitude", doc="what it sends", choices=STAR_OUTPUTS)
    installation_sigma_forward_arcsec: float = parameter(20.0, doc="installation error about the boresight", **SIGMA)
    installation_sigma_up_arcsec: float = parameter(1.0, doc="installation error about the up axis", **SIGMA)
    installation_sigma_right_arcsec: float = parameter(1.0, doc="installation error about the right axis", **SIGMA)
    sigma_forward_arcsec: float = parameter(100.0, doc="noise about the boresight", **SIGMA)
    sigma_up_arcsec: float = parameter(3.0, doc="noise about the up axis", **SIGMA)
    sigma_right_arcsec: float = parameter(3.0, doc="noise about the right axis", **SIGMA)
    common_sigma_arcsec: float = parameter(0.0, doc="slow error that all stars share, each axis", **SIGMA)
    common_time_s: float = parameter(3600.0, doc="correlation time of that error", **CORRELATION)
    flexure_sigma_arcsec: float = parameter(0.0, doc="hull flexure between INS and sensor, each axis", **SIGMA)
    flexure_time_s: float = parameter(10.0, doc="correlation time of the flexure", **CORRELATION)
    time_offset_s: float = parameter(
        0.0, doc="mean of: a message is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(0.0, doc="spread of the time offset", **_OFFSET_SIGMA)
    star_count: int = parameter(8, doc="stars in each solution", minimum=1, maximum=1000)
    masks: dict[str, MaskConfig] = mapping_of("what stands on deck in its way, by name: no star is seen through it")

    @property
    def sight_masks(self) -> SensorMasks | None:
        """What stands in its way."""
        return sensor_masks(self, "star_sensors")


@dataclass(frozen=True)
class Reference:
    """Another attitude system."""

    rate_hz: float = parameter(1.0, doc="samples per second", **RATE)
    phase_s: float = parameter(0.0, doc="first sample after the start", **MOMENT)
    latency_s: float = parameter(0.1, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    heading_deg: float = parameter(0.0, doc="mean of: its heading minus that of the INS", **ANGLE)
    pitch_deg: float = parameter(0.0, doc="mean of: its pitch minus that of the INS", **ANGLE)
    roll_deg: float = parameter(0.0, doc="mean of: its roll minus that of the INS", **ANGLE)
    installation_sigma_arcsec: float = parameter(7200.0, doc="spread of the three angles", **SIGMA)
    sigma_roll_arcsec: float = parameter(60.0, doc="noise about its forward axis", **SIGMA)
    sigma_pitch_arcsec: float = parameter(60.0, doc="noise about its right axis", **SIGMA)
    sigma_heading_arcsec: float = parameter(60.0, doc="noise about its up axis", **SIGMA)
    time_offset_s: float = parameter(
        0.0, doc="mean of: its stamp minus the INS's for the same attitude", unit="s", minimum=-10.0, maximum=10.0
    )
    time_offset_sigma_s: float = parameter(0.2, doc="spread of the time offset", unit="s", minimum=0.0, maximum=10.0)


@dataclass(frozen=True)
class FusedAttitude:
    """``ship/attitude`` as INS and stars together would give it, for a voyage without ``ship_attitude``."""

    written: bool = parameter(False, doc="whether the bag holds it")
    rate_hz: float = parameter(20.0, doc="messages per second", **RATE)
    phase_s: float = parameter(0.0, doc="first message after the start", **MOMENT)
    latency_s: float = parameter(0.005, doc="from stamp to arrival", **DELAY)
    jitter_s: float = parameter(0.0, doc="further delay, uniform between 0 and this", **DELAY)
    tilt_sigma_arcsec: float = parameter(1.45, doc="slow error in tilt, each axis", **SIGMA)
    heading_sigma_arcsec: float = parameter(1.75, doc="slow error in heading", **SIGMA)
    time_s: float = parameter(600.0, doc="correlation time of both", **CORRELATION)
    white_sigma_arcsec: float = parameter(1.0, doc="noise of each message, each axis", **SIGMA)


@dataclass(frozen=True)
class Position:
    """Where the ship is at the start, how it moves on, and its satellite receiver."""

    latitude_deg: float = parameter(0.0, doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(0.0, doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(20.0, doc="height over the ellipsoid", unit="m", minimum=-500.0, maximum=9000.0)
    speed_m_per_s: float = parameter(0.0, doc="speed over ground", unit="m/s", minimum=0.0, maximum=50.0)
    course_deg: float = parameter(0.0, doc="course over ground, from North clockwise", **ANGLE)
    sigma_m: float = parameter(2.0, doc="noise of a fix, each axis", unit="m", minimum=0.0, maximum=1000.0)
    slow_sigma_m: float = parameter(0.0, doc="slow error of the fixes, each axis", unit="m", minimum=0.0, maximum=1e4)
    slow_time_s: float = parameter(600.0, doc="correlation time of that error", **CORRELATION)
    rate_hz: float = parameter(1.0, doc="fixes per second", **RATE)


DEFLECTION_TOLD = ("none", "unknown", "constant", "table", "topic")
"""What the suite is told of the deflection: the choices of its parameter ``gravity.deflection``."""


@dataclass(frozen=True)
class Gravity:
    """The deflection of the vertical along the way: a part that maps know, and one, drawn, that they do not.

    Whatever levels itself, the INS and references, follows gravity.
    """

    xi_arcsec: float = parameter(0.0, doc="deflection northward at the start, as maps know it", **DEFLECTION)
    eta_arcsec: float = parameter(0.0, doc="deflection eastward at the start, as maps know it", **DEFLECTION)
    change_xi_arcsec: float = parameter(0.0, doc="change of the northward deflection on the way", **DEFLECTION)
    change_eta_arcsec: float = parameter(0.0, doc="change of the eastward deflection on the way", **DEFLECTION)
    change_start_m: float = parameter(0.0, doc="where on the way the change begins", unit="m", minimum=0.0, maximum=1e7)
    change_length_m: float = parameter(
        50_000.0, doc="over what way it changes, as half a wave of a cosine", unit="m", minimum=100.0, maximum=1e7
    )
    sigma_arcsec: float = parameter(0.0, doc="deflection that no map knows, each component", **SIGMA)
    correlation_length_m: float = parameter(
        30_000.0, doc="way on which that changes", unit="m", minimum=100.0, maximum=1e6
    )
    told: str = parameter("none", doc="what the suite is told of what maps know", choices=DEFLECTION_TOLD)
    told_unknown_sigma_arcsec: float = parameter(
        7.7, doc="what the suite takes the deflection for where it is not told, each component", **SIGMA
    )
    table_step_m: float = parameter(2000.0, doc="way between rows of the table", unit="m", minimum=10.0, maximum=1e5)
    rate_hz: float = parameter(0.1, doc="messages per second where a topic tells it", **RATE)

    @property
    def is_level(self) -> bool:
        """Whether gravity is everywhere normal to the ellipsoid, and the suite is told nothing of it."""
        knows = (self.xi_arcsec, self.eta_arcsec, self.change_xi_arcsec, self.change_eta_arcsec)
        return not any((*knows, self.sigma_arcsec)) and self.told == "none"


@dataclass(frozen=True)
class WeatherStation:
    """What the weather station says, how wrong it is, and how the air bends light."""

    pressure_hpa: float = parameter(1013.25, doc="air pressure", unit="hPa", minimum=800.0, maximum=1100.0)
    temperature_c: float = parameter(15.0, doc="air temperature", unit="°C", minimum=-60.0, maximum=60.0)
    humidity_percent: float = parameter(70.0, doc="relative humidity", unit="%", minimum=0.0, maximum=100.0)
    pressure_sigma_hpa: float = parameter(
        0.5, doc="error of the pressure told: the true one is this far off", unit="hPa", minimum=0.0, maximum=50.0
    )
    temperature_sigma_k: float = parameter(
        1.0, doc="error of the temperature told", unit="K", minimum=0.0, maximum=50.0
    )
    refraction_model: str = parameter("erfa", doc="model of refraction", choices=MODELS)
    rate_hz: float = parameter(0.5, doc="messages per second", **RATE)


@dataclass(frozen=True)
class Scenario:
    """A simulated voyage."""

    carrier: CarrierMotion
    start_utc: str = parameter(doc="start, ISO 8601 with the letter Z, for example 2014-07-09T11:50:07.8Z")
    duration_s: float = parameter(doc="length", unit="s", minimum=1.0, maximum=1e6)
    description: str = parameter("", doc="what the scenario shows")
    ins: Ins = section(Ins)
    star_sensors: dict[str, StarSensor] = mapping_of("star sensors by id")
    references: dict[str, Reference] = mapping_of("other attitude systems by name")
    ship_baseline: ShipBaseline = section(ShipBaseline)
    fused_attitude: FusedAttitude = section(FusedAttitude)
    theodolite: Theodolite = section(Theodolite)
    beacons: dict[str, Beacon] = mapping_of("drones with lights by id")
    targets: dict[str, Target] = mapping_of("bodies that the main tube looks at by id")
    telescopes: dict[str, StarTelescope] = mapping_of("cameras on the theodolite that see stars by id")
    position: Position = section(Position)
    gravity: Gravity = section(Gravity)
    weather: WeatherStation = section(WeatherStation)
    earth_rotation_sigma_s: float = parameter(
        0.0, doc="error of UT1 - UTC; 0: that of the table of Earth orientation", unit="s", minimum=0.0, maximum=1.0
    )
    faults: dict[str, Fault] = mapping_of("faults by name")

    @property
    def needs_sky(self) -> bool:
        """Whether the suite's attitude of the ship needs the sky: a star sensor looks at the real one."""
        return any(sensor.output != "horizon_attitude" for sensor in self.star_sensors.values())

    @property
    def has_sky(self) -> bool:
        """Whether anything looks at the real sky."""
        return self.needs_sky or bool(self.telescopes)

    @property
    def needs_place(self) -> bool:
        """Whether the suite must know where the ship is."""
        return self.needs_sky or self.gravity.told != "none" or self.ins.model == SCHULER


def start_of(start_utc: str) -> int:
    """POSIX nanoseconds of a moment such as ``2014-07-09T11:50:07.8Z``.

    Raises:
        ValueError: it is no such moment.
    """
    found = _MOMENT.fullmatch(start_utc)
    if found is None:
        raise ValueError("expected YYYY-MM-DDThh:mm:ss, at most nine decimals, and the letter Z")
    whole = datetime.fromisoformat(found[1]).replace(tzinfo=timezone.utc)
    return round(whole.timestamp()) * SECOND_NS + int(f"{found[2] or '0':0<9}")

"""The part of a scenario file that describes the drones with their lights. Places are seen from the theodolite."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters import mapping_of, parameter, section
from ship_simulation.scenario.scenario_units import ANGLE, CORRELATION, DELAY, MOMENT, RATE, Outage
from ship_simulation.scenario.theodolite_scenario import Lever

_ELEVATION: dict[str, Any] = {"unit": "deg", "minimum": -89.0, "maximum": 89.0}
_DISTANCE: dict[str, Any] = {"unit": "m", "minimum": 10.0, "maximum": 50_000.0}
_OFFSET: dict[str, Any] = {"unit": "deg", "minimum": -45.0, "maximum": 45.0}
_SPEED: dict[str, Any] = {"unit": "m/s", "minimum": -100.0, "maximum": 100.0}
_SIGMA_M: dict[str, Any] = {"unit": "m", "minimum": 0.0, "maximum": 100.0}
_SIGMA_DEG: dict[str, Any] = {"unit": "deg", "minimum": 0.0, "maximum": 90.0}


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
class Flight:
    """How a drone flies, and how it sways."""

    kind: str = parameter("hover", doc="what it does", choices=("escort", "hover", "orbit", "legs"))
    escort: Escort = section(Escort)
    hover: Hover = section(Hover)
    orbit: Orbit = section(Orbit)
    waypoints: dict[str, Waypoint] = mapping_of("ends of straight legs, two or more, by name")
    yaw_deg: float = parameter(0.0, doc="where the nose points, from North", **ANGLE)
    sway_deg: float = parameter(2.0, doc="amplitude of pitch and of roll", unit="deg", minimum=0.0, maximum=45.0)
    sway_period_s: float = parameter(4.0, doc="period of both", unit="s", minimum=0.1, maximum=1000.0)


SECTIONS_OF_FLIGHT = {"escort": "escort", "hover": "hover", "orbit": "orbit", "legs": "waypoints"}
"""The group that each kind of flight uses."""


@dataclass(frozen=True)
class Rtk:
    """The baseline from the ship's antenna to the drone's."""

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
